"""The images that were sent: files under names of ours, in a folder that goes with the server."""

import secrets
from dataclasses import dataclass
from pathlib import Path

from dgc_pose.errors import InputError


@dataclass(frozen=True)
class StoredImage:
    """An image that could be read."""

    path: Path
    name: str  # of the client; for texts alone, never opened


class Gone(InputError):
    """An image that the server has dropped, or never had."""

    status = 410  # of HTTP: the page sends the image again


class ImageStore:
    """The last images. What a client says is a key of a dictionary and never part of a path."""

    def __init__(self, folder: Path, most: int) -> None:
        self._folder, self._most = folder, most
        self._images: dict[str, StoredImage] = {}  # those used last are the last ones
        self._bundled: dict[str, StoredImage] = {}

    def new_path(self) -> Path:
        """A path for the next upload, of random letters."""
        return self._folder / secrets.token_hex(16)

    def keep(self, image: StoredImage) -> str:
        """Keep an image, and drop the oldest if there are too many. Returns its identifier."""
        identifier = secrets.token_urlsafe(16)
        self._images[identifier] = image
        if len(self._images) > self._most:
            self._images.pop(next(iter(self._images))).path.unlink(missing_ok=True)
        return identifier

    def keep_bundled(self, image: StoredImage) -> str:
        """Keep an image of the package, which is never dropped. Returns its identifier."""
        identifier = secrets.token_urlsafe(16)
        self._bundled[identifier] = image
        return identifier

    def get(self, identifier: object) -> StoredImage:
        """An image by its identifier. Raises Gone if there is none."""
        key = str(identifier)
        if key in self._bundled:
            return self._bundled[key]
        if key not in self._images:
            raise Gone("the image is no longer there: send it again")
        self._images[key] = image = self._images.pop(key)
        return image
