"""The images that were sent: files under names of ours, in a folder that goes with the server.

The browser gets our pixels, not the file, which may be a TIFF. They are upright: an EXIF
orientation is applied.
"""

import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from dgc_pose.errors import DgcPoseError, ImageError, InputError
from dgc_pose.images.image import image_size, load_image, picture_url
from dgc_pose.viz.figure import shrunk


@dataclass(frozen=True)
class StoredImage:
    """An image that could be read."""

    path: Path
    name: str  # of the client; for texts alone, never opened


class Gone(InputError):
    """An image that the server has dropped, or never had."""

    status = 410  # of HTTP: the page sends the image again


class SentImages:
    """The last images in the folder. What a client says is a key of a dictionary and never part of
    a path."""

    def __init__(self, folder: Path, most: int) -> None:
        self.folder, self._most = folder, most
        self._images: dict[str, StoredImage] = {}  # those used last are the last ones

    def keep(self, image: StoredImage) -> str:
        """Keep an image, and drop the oldest if there are too many. Returns its identifier."""
        identifier = secrets.token_urlsafe(16)
        self._images[identifier] = image
        if len(self._images) > self._most:
            self._images.pop(next(iter(self._images))).path.unlink(missing_ok=True)
        return identifier

    def get(self, identifier: object) -> StoredImage:
        """An image by its identifier. Raises Gone if there is none."""
        image = self._images.pop(str(identifier), None)
        if image is None:
            raise Gone("the image is no longer there: send it again")
        self._images[str(identifier)] = image
        return image


def preview(path: Path, max_pixels: int) -> dict[str, Any]:
    """Size (width, height) of an upright image, and a picture for the browser.

    Raises ImageError, without the path, if it cannot be read or has too many pixels.
    """
    try:
        width, height = image_size(path)
        if width * height > max_pixels:  # before they are decoded
            raise ImageError(
                f"{path} is too large: {width} x {height}, at most {max_pixels} pixels are read "
                "(--max-megapixels of dgc-pose serve)"
            )
        image = load_image(path)
    except DgcPoseError as error:
        # The path is none of the client's business.
        raise ImageError(str(error).replace(str(path), "the file")) from None
    return {
        "size": list(image.size),
        "picture": picture_url(shrunk(image.pixels), "jpeg", cv2.IMWRITE_JPEG_QUALITY, 88),
    }
