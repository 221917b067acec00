"""The images that were sent: files under names of ours, in a folder that goes with the server."""

from __future__ import annotations

import secrets
import threading
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

from dgc_pose.errors import InputError


@dataclass(frozen=True)
class StoredImage:
    """An image that could be read."""

    path: Path
    name: str  # of the client; for texts alone, never opened
    size: tuple[int, int]  # (width, height), pixels


class ImageStore:
    """The last images. What a client says is a key of a dictionary and never part of a path."""

    def __init__(self, folder: Path, most: int) -> None:
        self._folder, self._most = folder, most
        self._images: OrderedDict[str, StoredImage] = OrderedDict()
        self._lock = threading.Lock()

    def new_path(self) -> Path:
        """A path for the next upload, of random letters."""
        return self._folder / secrets.token_hex(16)

    def keep(self, image: StoredImage) -> str:
        """Keep an image, and drop the oldest if there are too many. Returns its identifier."""
        identifier = secrets.token_urlsafe(16)
        with self._lock:
            self._images[identifier] = image
            dropped = [
                self._images.popitem(last=False)[1] for _ in range(len(self._images) - self._most)
            ]
        for old in dropped:
            if old.path.parent == self._folder:
                old.path.unlink(missing_ok=True)
        return identifier

    def get(self, identifier: object) -> StoredImage:
        """An image by its identifier. Raises InputError if there is none."""
        with self._lock:
            image = self._images.get(identifier) if isinstance(identifier, str) else None
            if image is None:
                raise InputError("the image is no longer there: send it again")
            self._images.move_to_end(str(identifier))
        return image
