"""A server's estimator without a network, and what a user does on the page, for tests."""

import dense_scene
from chromium import Page

from dgc_pose.cameras.pair_list import rendered_pair
from dgc_pose.matching import Matcher
from dgc_pose.serve.estimator import Estimator


def map_matcher() -> Matcher:
    """Gives the true map of the dense scene."""
    return dense_scene.MapMatcher(dense_scene.true_map(error_px=0.2))


def estimator() -> Estimator:
    return Estimator(map_matcher(), None)


DONE = "document.querySelector('#progress').textContent.startsWith('done')"


def estimate_rendered(page: Page) -> None:
    """Have the page estimate the pose of the rendered pair, with its K."""
    pair = rendered_pair()
    page.click("[value=k]")
    for field, camera in (("#k1", pair.camera1), ("#k2", pair.camera2)):
        K = ",".join(map(str, camera.K[(0, 1, 0, 1), (0, 1, 2, 2)]))
        page.evaluate(f"document.querySelector('{field}').value = '{K}'")
    page.choose("#file1", pair.path1, pair.path2)
    page.wait(DONE)
