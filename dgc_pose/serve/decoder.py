"""What the first worker does: read an image that was sent, and make a picture that a browser shows.

The browser gets our pixels, not the file: it could not read a TIFF, and would apply an orientation
tag that the pose does not.
"""

from __future__ import annotations

import base64
import os
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.errors import DgcPoseError, ImageError
from dgc_pose.images.image import MAX_PIXELS_VARIABLE, load_image, resize_by
from dgc_pose.serve.worker import Report

SHOWN_SIDE = 1200  # longest side of a picture for the browser, pixels
THE_FILE = "the file"  # what errors call it: its path is none of the client's business


@dataclass(frozen=True)
class Preview:
    """An image as the browser shows it."""

    jpeg: bytes
    size: tuple[int, int]  # (width, height) of the image itself, pixels
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class ImageDecoder:
    """Reads images of at most so many pixels."""

    max_pixels: int

    def preview(self, report: Report, path: Path) -> Preview:
        """Read the image. Raises ImageError, without the path, if it cannot be read."""
        os.environ[MAX_PIXELS_VARIABLE] = str(self.max_pixels)  # of this process alone
        try:
            image = load_image(path)
        except DgcPoseError as error:
            raise ImageError(str(error).replace(str(path), THE_FILE)) from None
        warnings = tuple(text.replace(str(path), THE_FILE) for text in image.warnings)
        jpeg = encoded(".jpg", shrunk(image.pixels), cv2.IMWRITE_JPEG_QUALITY, 88)
        return Preview(jpeg, image.size, warnings)


def shrunk(pixels: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) of at most `SHOWN_SIDE` pixels a side."""
    return resize_by(pixels, min(1.0, SHOWN_SIDE / max(pixels.shape[:2])))


def encoded(ending: str, pixels: np.ndarray, *settings: int) -> bytes:
    """An image (H, W, 3 or 4) uint8, RGB or RGBA, as a file of OpenCV's format of this ending."""
    order = [2, 1, 0, 3][: pixels.shape[2]]
    done, data = cv2.imencode(ending, np.ascontiguousarray(pixels[..., order]), list(settings))
    assert done
    return data.tobytes()


def data_url(data: bytes, kind: str) -> str:
    """A file of a media type such as image/jpeg as text that a page shows."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
