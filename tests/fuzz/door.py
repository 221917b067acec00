"""A door: one kind of file, and how it is read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fuzz import mutators


@dataclass(frozen=True)
class Door:
    """One kind of file, and how it is read."""

    name: str
    make: Callable[[Path], None]  # writes the good files
    read: Callable[[Path, Path], object]  # of the folder and the damaged file within it
    mutators: Mapping[str, Sequence[mutators.Mutator]]  # by the endings of the files to damage
    weight: float = 1.0  # share of the trial; less for a slow reader

    def files(self, folder: Path) -> list[Path]:
        """The files that the trial damages."""
        found = [path for path in folder.rglob("*") if path.suffix in self.mutators]
        return sorted(path for path in found if path.is_file())
