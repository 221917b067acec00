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
from dgc_pose.images.image import load_image, resize
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
class Decoder:
    """Reads images of at most so many pixels."""

    max_pixels: int

    def preview(self, report: Report, path: Path) -> Preview:
        """Read the image. Raises ImageError, without the path, if it cannot be read."""
        # Read by `load_image`, which refuses by the header, before it decodes.
        os.environ["DGC_POSE_MAX_PIXELS"] = str(self.max_pixels)
        try:
            image = load_image(path)
        except DgcPoseError as error:
            raise ImageError(str(error).replace(str(path), THE_FILE)) from None
        width, height = image.size
        if width * height > self.max_pixels:
            raise ImageError(f"{THE_FILE} is too large: {width} x {height}")
        warnings = tuple(text.replace(str(path), THE_FILE) for text in image.warnings)
        return Preview(jpeg(shrunk(image.pixels)), image.size, warnings)


def shrunk(pixels: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) of at most `SHOWN_SIDE` pixels a side."""
    height, width = pixels.shape[:2]
    scale = min(1.0, SHOWN_SIDE / max(width, height))
    return resize(pixels, (max(1, round(width * scale)), max(1, round(height * scale))))


def jpeg(pixels: np.ndarray) -> bytes:
    """An RGB image (H, W, 3) uint8 as a JPEG file."""
    return _encoded(".jpg", pixels[..., ::-1], cv2.IMWRITE_JPEG_QUALITY, 88)


def webp(pixels: np.ndarray) -> bytes:
    """An RGBA image (H, W, 4) uint8 as a WebP file."""
    return _encoded(".webp", pixels[..., [2, 1, 0, 3]], cv2.IMWRITE_WEBP_QUALITY, 85)


def _encoded(ending: str, pixels: np.ndarray, *settings: int) -> bytes:
    done, data = cv2.imencode(ending, np.ascontiguousarray(pixels), list(settings))
    assert done
    return data.tobytes()


def data_url(data: bytes, kind: str) -> str:
    """A file of a media type such as image/jpeg as text that a page shows."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
