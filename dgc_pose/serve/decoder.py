"""What the first worker does: read an image that was sent, and make a picture that a browser shows.

The browser gets our pixels, not the file: it could not read a TIFF, and would apply an orientation
tag that the pose does not.
"""

from __future__ import annotations

import base64
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from dgc_pose.errors import DgcPoseError, ImageError, ImageSizeError
from dgc_pose.images.image import MAX_PIXELS_VARIABLE, load_image, resize_by
from dgc_pose.serve.worker import Report

SHOWN_SIDE = 1200  # longest side of a picture for the browser, pixels
THE_FILE = "the file"  # what errors call it: its path is none of the client's business


@dataclass(frozen=True)
class ImageDecoder:
    """Reads images of at most so many pixels."""

    max_pixels: int

    def preview(self, report: Report, path: Path) -> dict[str, Any]:
        """Size (width, height) and EXIF orientation of an image, and a picture for the browser.

        Raises ImageError, without the path, if it cannot be read.
        """
        os.environ[MAX_PIXELS_VARIABLE] = str(self.max_pixels)  # of this process alone
        try:
            image = load_image(path)
        except DgcPoseError as error:
            option = " (--max-megapixels of dgc-pose serve)"
            text = str(error).replace(str(path), THE_FILE)
            raise ImageError(text + option * isinstance(error, ImageSizeError)) from None
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
