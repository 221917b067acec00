"""DTU on a user's disk, in any of its layouts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from dgc_pose.benchmarks.dtu import mvsnet, neus, raw
from dgc_pose.benchmarks.dtu.scene import LIGHTS, Scene, SceneReader, read_scene
from dgc_pose.errors import InputError

Layout = Literal["raw", "mvsnet", "neus"]

_EXPECTED: dict[Layout, str] = {
    "raw": raw.EXPECTED,
    "mvsnet": mvsnet.EXPECTED,
    "neus": neus.EXPECTED,
}


@dataclass(frozen=True)
class Dataset:
    """The scenes that have two views or more."""

    root: Path  # what the names of images are relative to
    layout: Layout
    scenes: tuple[Scene, ...]  # by number, ascending
    left_out: tuple[int, ...]  # numbers of scenes with a folder, but fewer than two views

    def scene(self, number: int) -> Scene:
        """A scene by its number. Raises InputError if it is missing."""
        for scene in self.scenes:
            if scene.number == number:
                return scene
        raise InputError(
            f"scan{number} is not there: found {_names([one.number for one in self.scenes])} "
            f"under {self.root}"
        )


def open_dataset(
    root: str | Path,
    *,
    layout: Layout | None = None,
    scenes: Sequence[int] | None = None,
    light: int | str = 3,
) -> Dataset:
    """Find scenes and their views.

    Args:
        root: the folder of the data set.
        layout: None to find it by looking.
        scenes: their numbers; None for all that are there.
        light: 0 to 6, or "max"; test sets of MVSNet and NeuS hold one light alone.

    Raises:
        InputError: with the path and what was expected, if the layout or a scene that was asked
            for is missing, or a calibration is malformed.
        ImageError: for a file that is no image.
        OSError: if a file cannot be read.
    """
    root = Path(root)
    if str(light) not in LIGHTS:
        raise InputError(f"light must be one of {', '.join(LIGHTS)}, not {light}")
    if not root.is_dir():
        raise InputError(f"{root}: no such folder; expected DTU there")
    found, reader = _find_layout(root, layout, str(light))
    numbers = reader.numbers() if scenes is None else sorted(set(scenes))
    opened = [read_scene(reader, number) for number in numbers]
    short = [scene for scene in opened if len(scene.views) < 2]
    if short and (scenes is not None or len(short) == len(opened)):
        raise InputError(f"{reader.root}: {_shortage(short[0], found)}")
    if not opened:
        raise InputError(f"{reader.root}: no scene, expected {_EXPECTED[found]}")
    return Dataset(
        root=reader.root,
        layout=found,
        scenes=tuple(scene for scene in opened if len(scene.views) >= 2),
        left_out=tuple(scene.number for scene in short),
    )


def _find_layout(root: Path, layout: Layout | None, light: str) -> tuple[Layout, SceneReader]:
    readers: dict[Layout, SceneReader | None] = {
        "raw": raw.find(root, light),
        "mvsnet": mvsnet.find(root, light),
        "neus": neus.find(root, light),
    }
    if layout is not None:
        reader = readers[layout]
        if reader is None:
            raise InputError(f"{root}: not in the {layout} layout, expected {_EXPECTED[layout]}")
        return layout, reader
    found = [(name, reader) for name, reader in readers.items() if reader is not None]
    if len(found) > 1:
        names = " and ".join(name for name, _ in found)
        raise InputError(f"{root}: DTU in the layouts {names}: say which by --layout")
    if not found:
        expected = "; ".join(f"{name}: {files}" for name, files in _EXPECTED.items())
        raise InputError(f"{root}: DTU in no known layout, expected one of {expected}")
    return found[0]


def _shortage(scene: Scene, layout: Layout) -> str:
    """Why a scene of fewer than two views cannot be used."""
    count = len(scene.views)
    return (
        f"{count or 'no'} view{'s' * (count != 1)} of {scene.name} in the {layout} layout, and two "
        f"are needed: expected {next(iter(scene.missing.values()))}"
    )


def _names(numbers: Sequence[int]) -> str:
    shown = ", ".join(f"scan{number}" for number in numbers[:5])
    return f"{shown} and {len(numbers) - 5} more" if len(numbers) > 5 else shown
