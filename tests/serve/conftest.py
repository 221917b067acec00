import dense_scene
import pytest


@pytest.fixture(scope="session")
def map_matcher():
    """Gives the true map of the dense scene."""
    return dense_scene.MapMatcher(dense_scene.true_map(error_px=0.2))


@pytest.fixture(scope="session")
def pictures(tmp_path_factory):
    return dense_scene.write_pictures(tmp_path_factory.mktemp("pictures"))
