"""Photographs that batches share."""

import pytest
from batch_runs import run_sift, view_folder


@pytest.fixture(scope="package")
def views(tmp_path_factory):
    """A folder of four rendered views, to read."""
    folder = tmp_path_factory.mktemp("views")
    view_folder(folder, 4)
    return folder


@pytest.fixture(scope="package")
def whole(views, tmp_path_factory):
    """The result of a batch over all pairs of them, uninterrupted."""
    return run_sift(views, tmp_path_factory.mktemp("whole") / "out").folder
