import numpy as np

from dgc_pose.estimation.model import Model
from dgc_pose.estimation.refine import best_planar_model, planar_share
from dgc_pose.geometry.homography import fit_homography
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from two_view import two_view_scene


def test_one_homography_explains_a_plane_and_not_a_solid():
    for kind, low, high in (("planar", 0.9, 1.0), ("general", 0.0, 0.5)):
        scene = two_view_scene(kind, count=500, sigma_px=0.5, outliers=0.4)
        problem = scene.problem()
        share, H = planar_share(problem, Model.of_pose(problem, scene.R, scene.t))
        assert low <= share <= high
        assert H is not None


def test_a_plane_brings_a_wrong_pose_back_to_a_right_one():
    scene = two_view_scene("planar", count=500, sigma_px=0.2, outliers=0.3)
    problem = scene.problem()
    right = problem.subset(scene.true)
    H = fit_homography(right.points1, right.points2, problem.threshold)
    wrong = Model.of_pose(problem, np.eye(3), np.array([0.0, 0, 1]))
    for refined in (False, True):
        model = best_planar_model(problem, wrong, H, refined)
        assert rotation_error_deg(model.R, scene.R) < 1
        assert translation_error_deg(model.t, scene.t) < 2
