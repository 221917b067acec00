"""Bundle adjustment with priors, on points and pictures whose truth is known."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation
from worlds import look_at

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.prior import auto_camera
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.images.decoding import Header
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg
from dgc_pose.rigs.adjustment import bundle_camera
from dgc_pose.rigs.bundle import Bundle, Matched, NormalEquations, Observed, adjusted_bundle

SIZE = (800, 600)
CAMERA = Camera(np.array([700.0, 700, 399.5, 299.5]), SIZE)
ASSUMED = replace(auto_camera(Header("", SIZE)), focal_prior=None)
NOISE_PX = 0.3


def world(
    seed: int, own: Camera | None, lower: bool = False, points: int = 300
) -> tuple[Bundle, np.ndarray, np.ndarray]:
    """Six pictures of a walk, and one of a camera, which starts at `own` (None: of the walk), with
    errors; the true rotations and centres. lower: whether the camera sees points only in the lower
    half of its picture."""
    rng = np.random.default_rng(seed)
    xyz = rng.uniform((-2, -1.5, 4), (2, 1.5, 7), (points, 3))
    centres = np.column_stack([np.linspace(-1.5, 1.5, 7), rng.uniform(-0.4, 0.4, (7, 2))])
    R = np.stack([look_at(centre, np.array([0, 0, 5.5])) for centre in centres])
    starts = [CAMERA, own or CAMERA]
    camera_of = [0] * 6 + [0 if own is None else 1]
    observed, pixels = [], []
    for image in range(7):
        local = (xyz - centres[image]) @ R[image].T
        seen = CAMERA.project(local[:, :2] / local[:, 2:]) + rng.normal(0, NOISE_PX, (points, 2))
        pixels.append(seen)
        inside = ((seen > 0) & (seen < SIZE)).all(1)
        if lower and image == 6:
            inside &= seen[:, 1] > 0.55 * SIZE[1]
        which = np.flatnonzero(inside)
        start = starts[camera_of[image]]
        observed.append(Observed(image, which, start.normalise(seen[which]), 8 / start.focal))
    both = np.intersect1d(observed[2].points, observed[6].points)
    matches = Matches(pixels[2][both], pixels[6][both], np.ones(len(both)), 0.5)
    problem = TwoViewProblem.of(matches, CAMERA, starts[camera_of[6]])
    turns = Rotation.from_rotvec(rng.normal(0, 1e-3, (7, 3))).as_matrix()
    bundle = Bundle(
        [bundle_camera(CAMERA, CAMERA), bundle_camera(starts[1], own or CAMERA)],
        camera_of,
        turns @ R,
        centres + rng.normal(0, 3e-3, (7, 3)),
        xyz + rng.normal(0, 3e-3, xyz.shape),
        observed,
        [Matched((2, 6), problem)],
        range(6),
    )
    return bundle, R, centres


def off_truth(bundle: Bundle, R: np.ndarray, centres: np.ndarray) -> tuple[float, float]:
    """The errors of the last picture, degrees and units, in the frame of the walk."""
    walk, true = bundle.centres[:6], centres[:6]
    turn = Rotation.from_matrix(bundle.R[:6].transpose(0, 2, 1) @ R[:6]).mean().as_matrix()
    scale = np.linalg.norm(walk - walk.mean(0)) / np.linalg.norm(true - true.mean(0))
    expected = walk.mean(0) + scale * turn @ (centres[6] - true.mean(0))
    shift = float(np.linalg.norm(bundle.centres[6] - expected)) / scale
    return rotation_error_deg(bundle.R[6] @ turn, R[6]), shift


@pytest.mark.parametrize("own", [None, CAMERA, ASSUMED.with_focal(690.0)])
def test_the_gradient_is_that_of_the_cost(own: Camera | None) -> None:
    bundle = world(0, own)[0]
    normal = NormalEquations(bundle.with_inliers(bundle))
    for _ in range(40):  # to the points that fit these cameras
        normal = normal.moved(np.zeros(len(normal.slopes.gradient)))
    rng = np.random.default_rng(1)
    for _ in range(5):
        step = 1e-5 * rng.standard_normal(len(normal.slopes.gradient))
        ahead, behind = (normal.moved(sign * step).slopes.cost for sign in (1, -1))
        assert (ahead - behind) / 2 == pytest.approx(normal.slopes.gradient @ step, rel=1e-2)


def test_exact_cameras_agree_with_colmaps_adjustment() -> None:
    """Both minimise reprojection errors; ours are robust, and it has the matches too."""
    bundle, R, centres = world(0, CAMERA)
    fit = adjusted_bundle(replace(bundle, matched=[])).bundle
    theirs = pycolmap.Reconstruction()
    theirs.add_camera_with_trivial_rig(
        pycolmap.Camera.create_from_model_name(1, "PINHOLE", 700, *SIZE)
    )
    for image, (turn, centre) in enumerate(zip(bundle.R, bundle.centres, strict=True), start=1):
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turn), -turn @ centre)
        new = pycolmap.Image(name=str(image), camera_id=1)
        new.image_id = image
        theirs.add_image_with_trivial_frame(new, pose)
    keys = [theirs.add_point3D(xyz, pycolmap.Track()) for xyz in bundle.points]
    for part in bundle.observed:
        image = theirs.images[part.image + 1]
        pixels = CAMERA.project(part.seen) + 0.5
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(pixel) for pixel in pixels])
        for index, point in enumerate(part.points):
            element = pycolmap.TrackElement(image.image_id, index)
            theirs.add_observation(keys[point], element)
    config = pycolmap.BundleAdjustmentConfig()
    for image in theirs.images:
        config.add_image(image)
    config.set_constant_cam_intrinsics(1)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    pycolmap.create_default_bundle_adjuster(options, config, theirs).solve()
    poses = [theirs.images[number].cam_from_world().matrix() for number in range(1, 8)]
    other = np.stack(poses)
    turns = other[:, :, :3]
    places = -np.einsum("nji,nj->ni", turns, other[:, :, 3])
    turn_off, shift_off = off_truth(fit, turns, places)
    own_turn, own_shift = off_truth(fit, R, centres)
    assert turn_off < 0.5 * own_turn and shift_off < 0.5 * own_shift


@pytest.mark.parametrize("lower", [False, True])
def test_the_stated_errors_hold(lower: bool) -> None:
    """Also of a camera whose points lie on one side: its focal length is then hardly known. Its
    pixels stay square."""
    within, stated = [], []
    for seed in range(10):
        start = ASSUMED.with_focal(690.0)
        bundle, R, centres = world(seed, start, lower)
        normal = adjusted_bundle(bundle)
        pose = normal.bundle.columns[6]
        covariance = normal.covariance()[np.ix_(pose, pose)]
        turn, shift = off_truth(normal.bundle, R, centres)
        turn_std, shift_std = (
            np.sqrt(np.trace(covariance[at, at])) for at in (np.s_[:3], np.s_[3:])
        )
        within.append([np.radians(turn) < 2 * turn_std, shift < 2 * shift_std])
        stated.append([turn_std, shift_std])
        assert normal.bundle.cameras[1].parameters[5] == 0
    assert np.mean(within, axis=0).min() >= 0.9
    assert np.median(stated, axis=0)[1] < (0.5 if lower else 0.1)


def test_a_picture_that_hardly_a_point_places_leaves_the_others() -> None:
    """Neither their poses nor their errors know of it; its own errors are large."""
    bundle, R, centres = world(0, ASSUMED.with_focal(690.0))
    few = [
        replace(part, points=part.points[:5], seen=part.seen[:5]) if part.image == 3 else part
        for part in bundle.observed
    ]
    stds = []
    for observed in (bundle.observed, few):
        normal = adjusted_bundle(replace(bundle, observed=observed))
        before, after = (off_truth(each, R, centres) for each in (bundle, normal.bundle))
        assert max(np.divide(after, before)) < 0.9
        variances = normal.covariance().diagonal()
        stds.append([np.sqrt(variances[columns].sum()) for columns in normal.bundle.columns[:7]])
    grown = np.divide(*stds[::-1])
    assert grown[3] > 1000 and np.delete(grown, 3).max() < 1.5


def test_a_camera_that_nothing_places_has_large_errors() -> None:
    bundle, *_ = world(0, ASSUMED.with_focal(690.0))
    observed = [part for part in bundle.observed if part.image < 6]
    normal = adjusted_bundle(replace(bundle, observed=observed, matched=[]))
    variances = normal.covariance().diagonal()
    stds = [np.sqrt(variances[columns].sum()) for columns in normal.bundle.columns[:7]]
    assert stds[6] > 100 and max(stds[:6]) < 0.02
    np.testing.assert_array_equal(normal.bundle.R[6], bundle.R[6])


@pytest.mark.parametrize(
    ("stated", "rows"),
    [
        (CAMERA, []),
        (replace(CAMERA, lens_std=0.1), [3, 4]),
        (replace(CAMERA, focal_std=0.1), [0]),
        (replace(CAMERA, aspect_std=0.1), [5]),
        (ASSUMED, [0, 1, 2, 3, 4]),
    ],
)
def test_only_what_is_uncertain_is_open(stated: Camera, rows: list[int]) -> None:
    camera = bundle_camera(CAMERA, stated)
    assert np.flatnonzero(camera.basis.any(axis=1)).tolist() == rows
    assert camera.basis.shape[1] == len(rows)
