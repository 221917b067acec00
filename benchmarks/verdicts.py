"""Can success be trusted, and the error that it names? `python -m dgc_pose.benchmarks.verdicts`.

Unrelated pairs must get no pose, true ones must get one. The pairs fall into two halves by a hash
of their names: gates are chosen on one half, and what they do is reported on the other.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np
from tqdm import tqdm

from dgc_pose.benchmarks.methods import load_methods
from dgc_pose.benchmarks.pairs import pose_errors
from dgc_pose.benchmarks.table import aligned
from dgc_pose.benchmarks.verdict_cases import (
    CaseKind,
    VerdictCase,
    listed,
    misleading,
    rendered,
    unrelated_photos,
    unrelated_scenes,
)
from dgc_pose.errors import DgcPoseError, InputError
from dgc_pose.estimation import EstimationOptions, RelativePose, VerdictOptions, estimate_pose
from dgc_pose.estimation.verdict import Evidence, judge
from dgc_pose.matching import DEFAULT_WEIGHTS, Matcher, MatchingOptions
from dgc_pose.metrics import rotation_error_deg
from dgc_pose.refinement import RefinementOptions

FAR_OFF_DEG = 10.0  # a pose with a larger error in R or t is wrong
FALSE_TARGET, MISSED_TARGET = 0.01, 0.05  # of unrelated pairs called a success, of true ones missed
_MIN_INLIERS = (15, 30, 60, 100)
_MIN_RATIOS = (0.15, 0.25, 0.35, 0.5)
_MIN_PLACES = (20, 1, 10, 15, 17, 25, 30, 35)


@dataclass(frozen=True)
class Judged:
    """What came of one pair, with the evidence, so that other gates can be tried on it."""

    name: str
    group: str
    kind: CaseKind
    status: str
    success: bool
    num_inliers: int
    evidence: Evidence | None  # None where there were too few matches, or no model
    rotation_deg: float  # error; infinite without a pose, NaN for unrelated images
    translation_deg: float  # error, 0 to 180; infinite or NaN likewise
    rotation_90_deg: float  # what the pose says of its own error; NaN where it says nothing
    translation_90_deg: float

    @property
    def chooses(self) -> bool:
        """Whether the pair is of the half that gates are chosen on."""
        return hashlib.sha256(self.name.encode()).digest()[0] % 2 == 0

    @property
    def far_off(self) -> bool:
        """Whether there is a pose, and a wrong one."""
        return self.success and max(self.rotation_deg, self.translation_deg) > FAR_OFF_DEG


def judge_case(case: VerdictCase, matcher: Matcher, options: EstimationOptions) -> Judged:
    """Match a pair and estimate its pose."""
    matches = matcher.match(case.image1, case.image2).matches
    pose = estimate_pose(matches, case.camera1, case.camera2, options)
    rotation, translation = _errors(case, pose)
    return Judged(
        case.name,
        case.group,
        case.kind,
        pose.status,
        pose.success,
        pose.num_inliers,
        pose.evidence,
        rotation,
        translation,
        _number(pose.rotation_error_90_deg),
        _number(pose.translation_error_90_deg),
    )


def succeeds(judged: Judged, gates: VerdictOptions) -> bool:
    """Whether the pair would be a success with these gates."""
    if judged.evidence is None:
        return False
    return judge(judged.evidence, judged.num_inliers, gates)[0] in ("ok", "planar")


def rates(judged: Sequence[Judged], gates: VerdictOptions) -> tuple[float, float]:
    """The shares of unrelated pairs called a success, and of true ones called a failure.

    NaN where there are no such pairs.
    """
    unrelated = [succeeds(one, gates) for one in judged if one.kind == "unrelated"]
    true = [succeeds(one, gates) for one in judged if one.kind == "true"]
    return _mean(unrelated), _mean([not success for success in true])


def candidates() -> Iterator[VerdictOptions]:
    """The gates to choose among, the defaults first."""
    default = VerdictOptions()
    yield default
    for inliers, ratio, places in itertools.product(_MIN_INLIERS, _MIN_RATIOS, _MIN_PLACES):
        yield replace(default, min_inliers=inliers, min_inlier_ratio=ratio, min_places=places)


def choose_gates(judged: Sequence[Judged]) -> VerdictOptions:
    """The gates with the smallest sum of both rates, each over its target; of equals the first.

    Raises InputError where there are no unrelated or no true pairs to choose on.
    """
    kinds = {one.kind for one in judged}
    if not {"unrelated", "true"} <= kinds:
        raise InputError("gates need unrelated and true pairs to be chosen on; take more pairs")

    def loss(gates: VerdictOptions) -> float:
        false, missed = rates(judged, gates)
        return false / FALSE_TARGET + missed / MISSED_TARGET

    return min(candidates(), key=loss)


def groups_table(judged: Sequence[Judged]) -> str:
    """One row a group: what was called what, and whether 90 % means 90 %."""
    rows = [
        (
            "pairs",
            "number",
            "a pose",
            "wrong",
            "no pose",
            "R med",
            "t med",
            "R in 90 %",
            "t in 90 %",
            "statuses",
        )
    ]
    for group in dict.fromkeys(one.group for one in judged):
        own = [one for one in judged if one.group == group]
        poses = [one for one in own if one.success]
        known = own[0].kind != "unrelated"
        statuses = sorted({one.status for one in own})
        rows.append(
            (
                group,
                str(len(own)),
                str(len(poses)),
                str(sum(one.far_off for one in poses)) if own[0].kind == "true" else "-",
                str(len(own) - len(poses)),
                f"{np.median([one.rotation_deg for one in own]):.2f}" if known else "-",
                f"{np.median([one.translation_deg for one in own]):.2f}"
                if own[0].kind == "true"
                else "-",
                *coverage(own),
                ", ".join(f"{s} {sum(one.status == s for one in own)}" for s in statuses),
            )
        )
    return aligned(rows)


def coverage(judged: Sequence[Judged]) -> tuple[str, str]:
    """How often the errors of R and of t are within what the pose said, "k of n"."""
    true = [one for one in judged if one.kind == "true" and np.isfinite(one.rotation_90_deg)]
    if not true:
        return "-", "-"
    R = sum(one.rotation_deg <= one.rotation_90_deg for one in true)
    t = sum(one.translation_deg <= one.translation_90_deg for one in true)
    return f"{R} of {len(true)}", f"{t} of {len(true)}"


def gates_table(judged: Sequence[Judged]) -> str:
    """The default gates and those chosen on one half, on both halves."""
    halves = {
        "choosing": [one for one in judged if one.chooses],
        "reporting": [one for one in judged if not one.chooses],
    }
    try:
        chosen = choose_gates(halves["choosing"])
    except InputError as error:  # no reason to lose the other table
        return f"no gates: {error}"
    rows = [
        ("gates", "half", "unrelated", "a pose", "share", "true", "missed", "share"),
    ]
    for name, gates in (("default", VerdictOptions()), ("chosen", chosen)):
        for half, own in halves.items():
            unrelated = sum(one.kind == "unrelated" for one in own)
            true = sum(one.kind == "true" for one in own)
            false, missed = rates(own, gates)
            rows.append(
                (
                    name,
                    half,
                    str(unrelated),
                    f"{false * unrelated:.0f}",
                    f"{100 * false:.1f} %",
                    str(true),
                    f"{missed * true:.0f}",
                    f"{100 * missed:.1f} %",
                )
            )
    gates_line = (
        f"chosen: min_inliers {chosen.min_inliers}, min_inlier_ratio "
        f"{chosen.min_inlier_ratio:g}, min_places {chosen.min_places}"
    )
    return f"{aligned(rows)}\n{gates_line}"


@click.command()
@click.option("--photos", required=True, type=click.Path(path_type=Path), help="As for training.")
@click.option(
    "--scene",
    "scenes",
    multiple=True,
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Photographs of one scene; pairs of different folders are unrelated. Twice at least.",
)
@click.option(
    "--list",
    "lists",
    multiple=True,
    metavar="LIST[,ROOT]",
    help="True pairs, in SuperGlue's format, with the folder of the images.",
)
@click.option("--limit", type=click.IntRange(1), help="Pairs of each list at most.")
@click.option("--unrelated", default=200, show_default=True, help="Pairs of photographs.")
@click.option("--unrelated-scenes", "between", default=100, show_default=True)
@click.option("--pairs", default=100, show_default=True, help="Rendered true pairs.")
@click.option("--misleading", "hard", default=10, show_default=True, help="Pairs of each kind.")
@click.option("--method", default=DEFAULT_WEIGHTS, show_default=True, help="Or a path, or sift.")
@click.option("--refine/--no-refine", default=True, show_default=True)
@click.option("--seed", default=11, show_default=True)
@click.option("--threads", type=click.IntRange(min=1), help="Of torch; by default its own choice.")
def main(
    photos: Path,
    scenes: tuple[Path, ...],
    lists: tuple[str, ...],
    limit: int | None,
    unrelated: int,
    between: int,
    pairs: int,
    hard: int,
    method: str,
    refine: bool,
    seed: int,
    threads: int | None,
) -> None:
    """Print two tables: what each kind of pair was called, and the gates on both halves."""
    if threads is not None:
        import torch

        torch.set_num_threads(threads)
    try:
        matcher = load_methods(
            [method],
            device="auto",
            options=MatchingOptions(),
            refinement=RefinementOptions() if refine else None,
        )[method]
        cases: list[Iterable[VerdictCase]] = [unrelated_photos(photos, unrelated, seed)]
        if scenes:
            cases.append(unrelated_scenes(scenes, between, seed))
        cases.append(rendered(photos, pairs, seed))
        for entry in lists:
            pair_list, _, root = entry.partition(",")
            cases.append(listed(Path(pair_list), Path(root) if root else None, limit))
        options = EstimationOptions()
        judged = [
            judge_case(case, matcher, options)
            for case in tqdm(itertools.chain(*cases), unit=" pairs", disable=None, leave=False)
        ]
        gates = gates_table(judged)
        mislead = [
            judge_case(case, matcher, options)
            for case in tqdm(misleading(photos, hard, seed), unit=" pairs", disable=None)
        ]
    except DgcPoseError as error:
        raise click.ClickException(str(error)) from error
    except OSError as error:
        raise click.ClickException(f"{error.filename}: {error.strerror}") from error
    click.echo(f"{groups_table([*judged, *mislead])}\n\n{gates}")


def _errors(case: VerdictCase, pose: RelativePose) -> tuple[float, float]:
    """Errors of R and t in degrees; of R alone where the camera only turned."""
    if case.R is None:
        return np.nan, np.nan
    if case.t is not None:
        return pose_errors(pose, case.R, case.t)
    if pose.R is None:
        return np.inf, np.nan
    return rotation_error_deg(pose.R, case.R), np.nan


def _mean(flags: Sequence[bool]) -> float:
    return float(np.mean(flags)) if flags else float("nan")


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


if __name__ == "__main__":
    main()
