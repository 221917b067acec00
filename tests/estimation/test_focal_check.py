"""K that is stated against the focal lengths that the matches suggest."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import SceneKind, TwoViewScene, camera_scene, pinhole, two_view_scene

from dgc_pose.estimation import RelativePose
from dgc_pose.estimation.probability import shipped_models

SIZE = (1536, 1024)
CAMERA = pinhole(1300, SIZE)
NETWORK = min(shipped_models().weights)  # of which a probability is known
# Motions whose optical axes do not meet, so that the matches tell the focal lengths.
MOTIONS = {
    "aside": {},
    "far": {"turn_deg": (4.0, 22.0, 15.0), "centre": (2.5, 1.5, 0.5)},
    "near": {"turn_deg": (-6.0, 9.0, -10.0), "centre": (1.0, -1.0, 0.4)},
}


def _of_K(pose: RelativePose) -> list[str]:
    return [w for w in pose.warnings if w.startswith("the matches suggest f = ")]


@pytest.mark.parametrize("motion", ["aside", "far"])
@pytest.mark.parametrize("seed", range(4))
def test_a_zoom_of_image_2_with_the_K_of_image_1(motion: str, seed: int) -> None:
    """The check has one factor of both focal lengths: of some other motions it tells nothing."""
    factor = 1.5
    zoomed = pinhole(1300 * factor, SIZE)
    scene = camera_scene(CAMERA, zoomed, seed=seed, weights=NETWORK, **MOTIONS[motion])
    pose = scene.estimate(CAMERA, CAMERA, seed=seed)
    assert not pose.success or pose.probability < 0.5, (scene.errors_deg(pose), pose.warnings)
    if pose.status in ("ok", "planar", "improbable", "undetermined"):
        assert _of_K(pose), pose
    right = scene.estimate(*scene.cameras, seed=seed)
    assert right.success and max(scene.errors_deg(right)) < 1 and not _of_K(right)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("factor", [0.8, 1.6])
@pytest.mark.parametrize("seed", range(2))
def test_a_K_that_is_wrong_for_both_images(motion: str, factor: float, seed: int) -> None:
    scene = camera_scene(CAMERA, CAMERA, seed=seed, weights=NETWORK, **MOTIONS[motion])
    pose = scene.estimate(*(2 * [CAMERA.with_focal(1300 * factor)]), seed=seed)
    (warning,) = _of_K(pose)
    suggested = float(warning.split("=")[1].split()[0])
    assert suggested == pytest.approx(1300, rel=0.05)
    assert f"K says {1300 * factor:.0f}" in warning
    assert not pose.success or max(scene.errors_deg(pose)) < 10 or pose.probability < 0.5


@pytest.mark.parametrize("kind", ["general", "skew", "orbit", "planar", "forward"])
def test_a_right_K_is_never_contradicted(kind: SceneKind) -> None:
    for seed in range(20):
        scene = two_view_scene(kind, seed=seed, count=400, outliers=0.3)
        matches = replace(scene.matches, weights=NETWORK)
        pose = TwoViewScene(matches, scene.cameras, scene.R, scene.t, scene.true).estimate(
            *scene.cameras, seed=seed
        )
        assert not _of_K(pose), (seed, pose.warnings)
        check = pose.evidence.focal_check
        assert check is None or abs(np.log(check.factor)) < max(0.08, 4 * check.std)
