"""The steps of the search for a pose, and the rule that decides on each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from dgc_pose.estimation import RelativePose
from dgc_pose.estimation.camera_model import OF_STATED
from dgc_pose.estimation.options import Effort

# What is done for a pose, in this order, as far as the matcher has the step, see `solve_pair`:
# - coarse: a pass over small images, which is enough for an easy pair
# - refine: more accurate matches by the map of the coarse step, for a pose that is certain
# - full: all that `Matcher.match` does
# - guided: matches of squeezed images and near epipolar lines, pooled with those that are there
# - mirrored: without a pose, a coarse pass over image 1 and the mirror image of image 2
Step = Literal["coarse", "refine", "full", "guided", "mirrored"]
STEPS: Mapping[Effort, Sequence[Step]] = {
    "fast": ("coarse", "full", "mirrored"),
    "auto": ("coarse", "refine", "full", "guided", "mirrored"),
    "thorough": ("full", "guided", "mirrored"),
}
# Probabilities that a pose or an alternative is right beyond which no more is searched, and the
# share of the pose that this needs.
_MIN_SEARCHED, _MAX_SEARCHED, _CLEAR_SHARE = 0.005, 0.99, 0.95
# Image 2 is mirrored if its mirror image has a pose that is so probable, and no less than its own.
LIKELY = 0.9
_DOUBT = -1.0  # log-odds of another camera by the matches, which more of them confirm or not
_ACCURATE_DEG = 1.0  # expected errors below which the pose of a coarse pass is kept
_LOOSE_DEG = 5.0  # and above which a pose that is certain is searched too


def may_change(step: Step, pose: RelativePose | None, effort: Effort) -> bool:
    """Whether a step may change the answer. pose: after the steps before it, if there is one.

    A coarse pass has few matches, which distinguish a wrong camera from a right one less than many
    do: they are refined if the pose hangs on it.
    """
    if pose is None:
        return step in ("coarse", "full")
    if step == "refine":
        return certain(pose) and not (accurate(pose) and agrees_on_cameras(pose))
    if step == "full":
        return effort != "fast" and not certain(pose)
    if step == "mirrored":
        if pose.any_probability is None or pose.success:
            return False
        known = pose.evidence is None or pose.evidence.camera_model not in OF_STATED
        return known and pose.status not in ("rotation_only", "same_picture")
    limit_deg = _ACCURATE_DEG if effort == "thorough" else _LOOSE_DEG
    return in_doubt(pose) or (pose.success and not accurate(pose, limit_deg))


def certain(pose: RelativePose) -> bool:
    """Whether it is nearly certain that the pose is right."""
    return pose.success and _is_clear(pose)


def _is_clear(pose: RelativePose) -> bool:
    """Whether a hypothesis is nearly certain to be right, and which one."""
    likely = (pose.any_probability or 0.0) >= _MAX_SEARCHED
    return likely and pose.hypotheses[0].share >= _CLEAR_SHARE


def accurate(pose: RelativePose, limit_deg: float = _ACCURATE_DEG) -> bool:
    """Whether the expected errors of the pose are known, and below a limit."""
    errors = pose.rotation_error_90_deg, pose.translation_error_90_deg
    return all(error is not None and error < limit_deg for error in errors)


def agrees_on_cameras(pose: RelativePose) -> bool:
    """Whether the pose hardly depends on whether other cameras than the assumed ones are right."""
    evidence = pose.evidence
    if evidence is None or evidence.camera_model != "assumed":
        return False
    return evidence.camera_agreement >= _MAX_SEARCHED and evidence.camera_doubt < _DOUBT


def in_doubt(pose: RelativePose) -> bool:
    """Whether more matches may change the answer: it is neither certain nor hopeless."""
    likely = pose.any_probability
    if likely is None or not pose.hypotheses:
        return False
    share = pose.hypotheses[0].share
    of_others = likely * (1 - share) if pose.status == "rotation_only" else likely
    return of_others > _MIN_SEARCHED and not _is_clear(pose)
