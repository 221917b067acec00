"""Photographs that batches share."""

import pytest
from batch_runs import view_folder


@pytest.fixture(scope="package")
def views(tmp_path_factory):
    """A folder of four rendered views, to read."""
    folder = tmp_path_factory.mktemp("views")
    view_folder(folder, 4)
    return folder
