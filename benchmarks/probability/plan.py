"""What a fit is made of: entries, each with the part that it plays, listed in a JSON file.

    {"name": "hololens", "part": "fit", "kind": "list", "path": "rgbd/hololens"}

Paths are relative to the data folder. A scene plays one part alone, so that pairs of one place are
never on both sides. Kinds:

- `list`: the pairs of `lists/NAME.txt.gz` beside the plan, in SuperGlue's format; `path` is the
  folder that their images are relative to.
- `pasted`: the same, of which image 2 keeps a part and has other surroundings: two places that have
  it alike, and no pose in common.
- `zoomed`: the same as `list`, of which both images are zoomed in, as by a longer lens; of every
  fourth pair image 2 alone is, as by a zoom that no file states.
- `unrelated`: two photographs of different places; the names of such a list alone.
- `rendered`: `path` is a folder of photographs as textures.
- `planes`: the same, of planes with a relief, whose homographies have two poses.
- `textureless`: drawn images without structure, alone and beside photographs of `path`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from dgc_pose.errors import InputError, reason
from dgc_pose.system.options import check_options, option
from dgc_pose.system.texts import read_json

Part = Literal["fit", "report"]
EntryKind = Literal["list", "pasted", "zoomed", "unrelated", "rendered", "planes", "textureless"]
DEFAULT_PLAN = Path(__file__).with_name("plan.json")


@dataclass(frozen=True)
class PlanEntry:
    """One line of a plan."""

    name: str  # of the entry's files; the scene too, but for lists of several
    part: Part = option()
    kind: EntryKind = option()
    path: Path = Path()  # within the data folder
    pairs: int = option(60, min=1)  # of the kinds without a list
    seed: int = option(0, min=0)
    scene_by_folder: bool = False  # of a list: the scene is the first folder of an image's name
    altered: bool = False  # whether each pair is altered, see `planned.py`
    # Scenes whose true poses are a tracker's, off by a degree or more: they part right from wrong,
    # but not how accurate a pose is.
    rough: Sequence[str] = ()
    # Whether its pairs are estimated without K, too. A plane has no focal length: many of them
    # would teach little but that.
    withheld: bool = True

    def __post_init__(self) -> None:
        check_options(self)


def read_plan(path: Path) -> list[PlanEntry]:
    """The entries of a plan.

    Raises InputError, with the path, for a file that is no plan and for a name that is there twice.
    """
    data = read_json(path, "a plan")
    try:
        entries = [PlanEntry(**{**values, "path": Path(values.get("path", ""))}) for values in data]
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: not a plan ({reason(error)})") from None
    names = {entry.name for entry in entries}
    if len(names) < len(entries):
        raise InputError(f"{path}: two entries have one name")
    return entries
