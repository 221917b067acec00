"""Images of a folder by name, kept in memory for the pairs that they belong to."""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from dgc_pose.geometry.pixels import Size
from dgc_pose.images.image import Image, load_image, resize
from dgc_pose.images.maps import mask_file, masked, resized_mask


class ImageStore:
    """Loads images with their masks, and keeps those that were asked for last.

    Args:
        root: Folder that the names are relative to.
        masks: Folder of the masks, see `mask_file`; None without masks.
        limit_bytes: Of the pixels that are kept; the latest image always is.
        beside_bytes: Memory that an image takes elsewhere, which counts with its pixels.
        size: (width, height) that images are brought to; None leaves them as they are.
        dropped: Called with an image that is kept no more.
    """

    def __init__(
        self,
        root: Path,
        masks: str | Path | None = None,
        limit_bytes: int = 2**29,
        *,
        beside_bytes: int = 0,
        size: Size | None = None,
        dropped: Callable[[Image], None] = lambda image: None,
    ) -> None:
        self._root, self._masks, self.limit_bytes = root, masks, limit_bytes
        self._beside_bytes, self._size, self._dropped = beside_bytes, size, dropped
        self._kept: OrderedDict[str, Image] = OrderedDict()

    def get(self, name: str) -> Image:
        """An image by name. Raises ImageError and InputError as `load_image` and `masked` do."""
        if name in self._kept:
            self._kept.move_to_end(name)
            return self._kept[name]
        image = masked(load_image(self._root / name), mask_file(self._masks, name))
        if self._size is not None:
            mask = None if image.mask is None else resized_mask(image.mask, self._size)
            pixels = resize(image.pixels, self._size)
            image = replace(image, pixels=pixels, mask=mask, stored_size=image.size)
        self._kept[name] = image
        while len(self._kept) > 1 and self._kept_bytes() > self.limit_bytes:
            self._dropped(self._kept.popitem(last=False)[1])
        return image

    def _kept_bytes(self) -> int:
        return sum(image.pixels.nbytes + self._beside_bytes for image in self._kept.values())
