"""Normalised map coordinates and pixels: both of torch's align_corners conventions."""

from torch import Tensor


def to_pixels(normalised: Tensor, size: tuple[int, int], align_corners: bool) -> Tensor:
    """Pixels of an image of `size` (width, height) from normalised (..., 2) coordinates.

    With align_corners, -1 is the centre of pixel 0 and +1 that of the last; without, they are the
    outer edges of those pixels. Pixel (0, 0) is the centre of the top-left pixel either way.
    """
    extent = normalised.new_tensor(size)
    if align_corners:
        return (normalised + 1) * (extent - 1) / 2
    return ((normalised + 1) * extent - 1) / 2


def to_normalised(pixels: Tensor, size: tuple[int, int], align_corners: bool) -> Tensor:
    """The inverse of `to_pixels`: (..., 2) pixels to normalised coordinates."""
    extent = pixels.new_tensor(size)
    if align_corners:
        return 2 * pixels / (extent - 1) - 1
    return (2 * pixels + 1) / extent - 1
