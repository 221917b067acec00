"""The plan of a batch: its settings, the images with their cameras, and the pairs; `plan.json`."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.batch.matches_file import group_name
from dgc_pose.batch.source import PLAN, FileState
from dgc_pose.cameras.calibration import camera_data, parse_camera_data
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import ArgumentName, InputError, reason, shortened
from dgc_pose.files.json_files import read_json
from dgc_pose.files.outputs import write_text

_VERSION = 6
_RESUME = ArgumentName("resume")


@dataclass(frozen=True)
class Plan:
    """The work of a batch."""

    root: Path  # of the image names
    cameras: Mapping[str, Camera]  # by name, with the image's size; absent for bad images
    bad: Mapping[str, str]  # the reason by name, of images that are not matched
    states: Mapping[str, FileState]  # of the photographs' files, by name
    names: tuple[str, ...]
    pairs: np.ndarray  # (P, 2) int64, indices of `names`
    settings: Mapping[str, Any]  # all that the result depends on besides; JSON

    # The cameras with the focal lengths that all pairs determine; None before the result is there,
    # and where all cameras are exact.
    pooled: Mapping[str, Camera] | None = None

    @property
    def uncertain(self) -> bool:
        """Whether a part of a camera is estimated from the pairs."""
        return any(not camera.exact for camera in self.cameras.values())

    @property
    def final_cameras(self) -> Mapping[str, Camera]:
        """The cameras that the poses of the result are of."""
        return {**self.cameras, **(self.pooled or {})}

    def pair(self, index: int) -> tuple[str, str]:
        """The names of a pair."""
        first, second = self.pairs[index]
        return self.names[first], self.names[second]

    def same_files(self, names: Iterable[str], states: Mapping[str, FileState]) -> bool:
        """Whether the photographs of these names are in these states."""
        return all(self.states.get(name) == states.get(name) for name in names)


def write_plan(out: Path, plan: Plan) -> None:
    """Write `plan.json`, making the folder. Raises InputError if two pairs would share a group of
    the matches file."""
    groups: dict[str, tuple[str, str]] = {}
    for index in range(len(plan.pairs)):
        pair = plan.pair(index)
        other = groups.setdefault(group_name(*pair), pair)
        if other != pair:
            raise InputError(f"{' '.join(pair)} and {' '.join(other)} have one name in HDF5")
    out.mkdir(parents=True, exist_ok=True)
    pooled = plan.pooled or {}
    data = {
        "version": _VERSION,
        "root": str(plan.root.resolve()),
        "settings": dict(plan.settings),
        "images": [
            {
                "name": name,
                "camera": camera_data(plan.cameras[name]) if name in plan.cameras else None,
                "pooled": camera_data(pooled[name]) if name in pooled else None,
                "bad": plan.bad.get(name),
                "state": plan.states.get(name),
            }
            for name in plan.names
        ],
        "pairs": plan.pairs.tolist(),
    }
    write_text(out / PLAN, json.dumps(data, allow_nan=False) + "\n")


def read_plan(out: Path) -> Plan:
    """The plan of a folder. Raises InputError, with the path, if there is none or it is broken."""
    path = out / PLAN
    if not path.is_file():
        raise InputError(f"{out}: no folder of `dgc-pose batch` (it has no {PLAN})")
    data = read_json(path, "the plan of a batch")
    try:
        if data["version"] != _VERSION:
            raise ValueError(f"of version {data['version']}, and this is version {_VERSION}")
        cameras, pooled, bad, states = (
            {image["name"]: image[key] for image in data["images"] if image[key] is not None}
            for key in ("camera", "pooled", "bad", "state")
        )
        plan = Plan(
            Path(data["root"]),
            {name: parse_camera_data(values) for name, values in cameras.items()},
            bad,
            parse_states(states),
            tuple(image["name"] for image in data["images"]),
            np.array(data["pairs"], dtype=np.int64).reshape(-1, 2),
            dict(data["settings"]),
            {name: parse_camera_data(values) for name, values in pooled.items()} or None,
        )
        if not all(isinstance(name, str) for name in (*plan.names, *plan.bad.values())):
            raise ValueError("names that are no texts")
        if len(plan.pairs) and not 0 <= plan.pairs.min() <= plan.pairs.max() < len(plan.names):
            raise ValueError("pairs of images that are not listed")
        return plan
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError) as error:
        raise InputError(f"{path}: not the plan of a batch ({reason(error)})") from None


def parse_states(data: Mapping[str, Any]) -> dict[str, FileState]:
    """States of photographs from JSON; those that are null are absent."""
    return {name: tuple(map(int, state)) for name, state in data.items() if state is not None}


def continued(before: Plan, now: Plan, out: Path) -> Plan:
    """The plan `now` with the pairs of the batch `before`, which is to be resumed in `out`.

    Photographs may have changed: their pairs are matched again.

    Raises InputError, naming what differs, if the batch had other settings, images, pairs, or other
    cameras of photographs that have not changed.
    """
    changed = sorted({*now.names} ^ {*before.names})
    if changed and now.root == before.root:
        what = "is new" if changed[0] in now.names else "has gone"
        raise InputError(
            f"{now.root / changed[0]} {what} since that batch:", _RESUME, "needs the same"
        )
    unchanged = [name for name in now.names if now.same_files([name], before.states)]
    old, new = (_facts(plan, unchanged, pairs=len(now.pairs) > 0) for plan in (before, now))
    for what in {**old, **new}:
        if old.get(what) != new.get(what):
            had, has = (shortened(json.dumps(facts.get(what))) for facts in (old, new))
            differs = f"{out / PLAN}: that batch had {what} {had}, not {has}:"
            raise InputError(differs, _RESUME, "needs the same")
    bad = {name: before.bad[name] for name in unchanged if name in before.bad}
    return replace(now, names=before.names, pairs=before.pairs, bad=bad | dict(now.bad))


def _facts(plan: Plan, names: Iterable[str], *, pairs: bool) -> dict[str, Any]:
    """The facts that must be the same to go on with a batch, by their names in an error.

    names: of the images whose cameras count; pairs: whether the pairs do.
    """
    facts: dict[str, Any] = {"the folder": str(plan.root)}
    for name, value in json.loads(json.dumps(plan.settings)).items():
        inner = value if isinstance(value, dict) else {"": value}
        facts |= {f"the option {name} {key}".rstrip(): inner[key] for key in inner}
    if pairs:
        facts |= {f"the pair {i + 1}": list(plan.pair(i)) for i in range(len(plan.pairs))}
    for name in names:
        camera = plan.cameras.get(name)
        data = {} if camera is None else camera_data(camera)
        facts |= {f"of {name} the {key}": data[key] for key in data if key != "warnings"}
    return facts
