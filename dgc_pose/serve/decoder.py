"""An image that was sent, read and made a picture that a browser shows.

The browser gets our pixels, not the file: it could not read a TIFF, and would apply an orientation
tag that the pose does not.
"""

import base64
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from dgc_pose.errors import DgcPoseError, ImageError
from dgc_pose.images.image import image_size, load_image, resize_by

SHOWN_SIDE = 1200  # longest side of a picture for the browser, pixels


def preview(path: Path, max_pixels: int) -> dict[str, Any]:
    """Size (width, height) and EXIF orientation of an image, and a picture for the browser.

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
        "orientation": image.orientation,
    }


def shrunk(pixels: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) of at most `SHOWN_SIDE` pixels a side."""
    return resize_by(pixels, min(1.0, SHOWN_SIDE / max(pixels.shape[:2])))


def picture_url(pixels: np.ndarray, kind: Literal["jpeg", "webp"], *settings: int) -> str:
    """An image (H, W, 3 or 4) uint8, RGB or RGBA, as text that a page shows."""
    order = [2, 1, 0, 3][: pixels.shape[2]]
    done, data = cv2.imencode(f".{kind}", np.ascontiguousarray(pixels[..., order]), list(settings))
    assert done
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode()}"
