"""What a fit is made of: scenes, each with the part that it plays, listed in a JSON file.

    {"name": "hololens", "part": "fit", "kind": "rgbd", "path": "rgbd/hololens", "pairs": 120}

Paths are relative to the data folder. A scene plays one part alone, so that pairs of one place are
never on both sides. Kinds:

- `list`: a pair list in SuperGlue's format; with `scene_by_folder` the scene of a pair is the first
  folder of its image's name.
- `rgbd`: a folder of posed RGB-D frames; pairs are drawn from it (`drawn.py`).
- `sparse`: a COLMAP text model with its images.
- `posed`: a folder of posed scenes as `dgc-pose train` has them; `pairs` of each at most.
- `dtu`: a folder of DTU; pairs up to 60 degrees apart.
- `rendered`: `path` is a folder of photographs as textures.
- `planes`: the same, of planes with a relief, whose homographies have two poses.
- `unrelated`: `path` is a list of folders; two photographs of different places.
- `textureless`: drawn images without structure, alone and beside photographs of `path`.
"""

import json
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, get_args

from dgc_pose.errors import InputError, reason
from dgc_pose.files.inputs import read_text
from dgc_pose.system.options import check_options, option

Part = Literal["fit", "report"]
EntryKind = Literal[
    "list", "rgbd", "sparse", "posed", "dtu", "rendered", "planes", "unrelated", "textureless"
]
DEFAULT_PLAN = "plan.json"  # beside this file


@dataclass(frozen=True)
class PlanEntry:
    """One line of a plan."""

    name: str  # of the entry's files; the scene too, but for lists of several
    part: Part = option()
    kind: EntryKind = option()
    path: tuple[Path, ...] = ()  # within the data folder
    pairs: int = option(60, min=1)  # at most
    seed: int = option(0, min=0)
    scene_by_folder: bool = False  # of a list: the scene is the first folder of an image's name
    without: tuple[str, ...] = ()  # of posed scenes: those left out
    altered: bool = False  # whether each pair is altered, see `altered.py`
    # Scenes whose true poses are a tracker's, off by a degree or more: they part right from wrong,
    # but not how accurate a pose is.
    rough: tuple[str, ...] = ()
    # Whether its pairs are estimated without K, too. A plane has no focal length: many of them
    # would teach little but that.
    withheld: bool = True

    def __post_init__(self) -> None:
        check_options(self)
        if self.name in ("", ".", "..") or Path(self.name).name != self.name or "\0" in self.name:
            raise InputError(f"name must be that of a file, not {self.name!r}")


def read_plan(path: Path | None) -> list[PlanEntry]:
    """The entries of a plan; None for the one that the project's model is fitted by.

    Raises InputError, with the path, for a file that is no plan and for a scene with two parts.
    """
    text = (
        files("dgc_pose.benchmarks.probability").joinpath(DEFAULT_PLAN).read_text("utf-8")
        if path is None
        else read_text(path, "a plan")
    )
    where = path or DEFAULT_PLAN
    try:
        entries = [_entry(values) for values in json.loads(text)]
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputError(f"{where}: not a plan ({reason(error)})") from None
    names = [entry.name for entry in entries]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise InputError(f"{where}: {', '.join(sorted(twice))} twice")
    missing = set(get_args(Part)) - {entry.part for entry in entries}
    if missing:
        raise InputError(f"{where}: no scene to {' or '.join(sorted(missing))}")
    return entries


def _entry(values: dict[str, Any]) -> PlanEntry:
    path = values.get("path", [])
    tuples: dict[str, Any] = {"path": tuple(map(Path, [path] if isinstance(path, str) else path))}
    tuples |= {name: tuple(map(str, values.get(name, []))) for name in ("without", "rough")}
    return PlanEntry(**{**values, **tuples})
