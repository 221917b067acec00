"""DTU on a user's disk, in any of its layouts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from dgc_pose.benchmarks.dtu import layouts
from dgc_pose.benchmarks.dtu.scene import LIGHTS, DtuScene, SceneReader, read_scene
from dgc_pose.errors import ArgumentName, InputError

Layout = Literal["raw", "mvsnet"]
Find = Callable[[Path, str], SceneReader | None]

# How each layout is found, and what is expected of it.
_LAYOUTS: dict[Layout, tuple[Find, str]] = {
    "raw": (layouts.find_raw, layouts.RAW),
    "mvsnet": (layouts.find_mvsnet, layouts.MVSNET),
}


@dataclass(frozen=True)
class Dataset:
    """The scenes that have two views or more."""

    root: Path  # what the names of images are relative to
    layout: Layout
    scenes: tuple[DtuScene, ...]  # by number, ascending
    left_out: tuple[int, ...]  # numbers of scenes with a folder, but fewer than two views

    def scene(self, number: int) -> DtuScene:
        """A scene by its number. Raises InputError if it is missing."""
        for scene in self.scenes:
            if scene.number == number:
                return scene
        names = [scene.name for scene in self.scenes]
        more = f" and {len(names) - 5} more" if len(names) > 5 else ""
        raise InputError(
            f"scan{number} is not there: found {', '.join(names[:5])}{more} under {self.root}"
        )


def open_dataset(
    root: str | Path,
    *,
    layout: Layout | None = None,
    scenes: Sequence[int] | None = None,
    light: int | str = 3,
) -> Dataset:
    """Find scenes and their views; without `scenes`, their numbers, all that are there.

    light: 0 to 6, or "max"; test sets of MVSNet hold one light alone. Raises InputError,
    with the path and what was expected, if the layout or one of `scenes` is missing or a
    calibration is malformed; ImageError for a file that is no image; OSError.
    """
    root = Path(root)
    if str(light) not in LIGHTS:
        raise InputError(f"light must be one of {', '.join(LIGHTS)}, not {light}")
    if not root.is_dir():
        raise InputError(f"{root}: no such folder; expected DTU there")
    layout, reader = _find_layout(root, layout, str(light))
    numbers = reader.numbers() if scenes is None else sorted(set(scenes))
    opened = [read_scene(reader, number) for number in numbers]
    short = [scene for scene in opened if len(scene.views) < 2]
    if short and (scenes is not None or len(short) == len(opened)):
        scene, count = short[0], len(short[0].views)
        raise InputError(
            f"{reader.root}: {count or 'no'} view{'s' * (count != 1)} of {scene.name} in the "
            f"{layout} layout, and two are needed: expected {next(iter(scene.missing.values()))}"
        )
    if not opened:
        raise InputError(f"{reader.root}: no scene, expected {_LAYOUTS[layout][1]}")
    return Dataset(
        root=reader.root,
        layout=layout,
        scenes=tuple(scene for scene in opened if len(scene.views) >= 2),
        left_out=tuple(scene.number for scene in short),
    )


def _find_layout(root: Path, layout: Layout | None, light: str) -> tuple[Layout, SceneReader]:
    readers = {
        name: reader
        for name, (find, _) in _LAYOUTS.items()
        if layout in (None, name) and (reader := find(root, light)) is not None
    }
    if len(readers) > 1:
        names = " and ".join(readers)
        raise InputError(f"{root}: DTU in the layouts {names}: choose by", ArgumentName("layout"))
    if readers:
        return next(iter(readers.items()))
    if layout is not None:
        raise InputError(f"{root}: not in the {layout} layout, expected {_LAYOUTS[layout][1]}")
    expected = "; ".join(f"{name}: {files}" for name, (_, files) in _LAYOUTS.items())
    raise InputError(f"{root}: DTU in no known layout, expected one of {expected}")
