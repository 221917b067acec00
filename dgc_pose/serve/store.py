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
    """The last images in the folder, and any from elsewhere, which are never dropped.

    What a client says is a key of a dictionary and never part of a path.
    """

    def __init__(self, folder: Path, most: int) -> None:
        self.folder, self._most = folder, most
        self._images: dict[str, StoredImage] = {}  # those used last are the last ones

    def keep(self, image: StoredImage) -> str:
        """Keep an image, and drop the oldest if there are too many. Returns its identifier."""
        identifier = secrets.token_urlsafe(16)
        self._images[identifier] = image
        sent = [key for key, kept in self._images.items() if kept.path.parent == self.folder]
        if len(sent) > self._most:
            self._images.pop(sent[0]).path.unlink(missing_ok=True)
        return identifier

    def get(self, identifier: object) -> StoredImage:
        """An image by its identifier. Raises Gone if there is none."""
        key = str(identifier)
        if key not in self._images:
            raise Gone("the image is no longer there: send it again")
        self._images[key] = image = self._images.pop(key)
        return image
