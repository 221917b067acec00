"""The plan of a batch: its settings, the images with their cameras, and the pairs."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.batch.source import STORE, FileState
from dgc_pose.cameras.calibration import camera_data, parse_camera_data
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import ArgumentName, InputError, shortened

_VERSION = 8
_BY_PHOTOGRAPHS = ("K", "focal_std", "focal_source")
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


def plan_data(plan: Plan) -> dict[str, Any]:
    """A plan as values of JSON."""
    cameras, pooled = (
        {name: camera_data(camera) for name, camera in (of or {}).items()}
        for of in (plan.cameras, plan.pooled)
    )
    return {
        "version": _VERSION,
        "root": str(plan.root.resolve()),
        "settings": dict(plan.settings),
        "names": plan.names,
        "cameras": cameras,
        "pooled": pooled,
        "bad": dict(plan.bad),
        "states": dict(plan.states),
        "pairs": plan.pairs.tolist(),
    }


def parse_plan(data: Mapping[str, Any]) -> Plan:
    """The plan of `plan_data`. Raises anything for other data."""
    if data["version"] != _VERSION:
        raise ValueError(f"of version {data['version']}, and this is version {_VERSION}")
    cameras, pooled = (
        {name: parse_camera_data(values) for name, values in data[key].items()}
        for key in ("cameras", "pooled")
    )
    plan = Plan(
        Path(data["root"]),
        cameras,
        dict(data["bad"]),
        {name: tuple(map(int, state)) for name, state in data["states"].items()},
        tuple(map(str, data["names"])),
        np.array(data["pairs"], dtype=np.int64).reshape(-1, 2),
        dict(data["settings"]),
        pooled or None,
    )
    if len(plan.pairs) and not 0 <= plan.pairs.min() <= plan.pairs.max() < len(plan.names):
        raise ValueError("pairs of images that are not listed")
    return plan


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
    unchanged = [n for n in now.names if now.states.get(n) == before.states.get(n)]
    old, new = (_facts(plan, unchanged, pairs=len(now.pairs) > 0) for plan in (before, now))
    for what in {**old, **new}:
        if old.get(what) != new.get(what):
            had, has = (shortened(json.dumps(facts.get(what))) for facts in (old, new))
            differs = f"{out / STORE}: that batch had {what} {had}, not {has}:"
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
        # What no K states is of the photographs, and the lines of one count for all of a camera.
        open_ = data.get("focal_source") != "given"
        left_out = {"warnings", *(_BY_PHOTOGRAPHS if open_ else ())}
        facts |= {f"of {name} the {key}": data[key] for key in data if key not in left_out}
    return facts
