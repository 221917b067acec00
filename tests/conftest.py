"""How often hypothesis draws: always the same in the suite, anew in each round of `make fuzz`;
the browser of the tests of pages; the second matcher; and signals as a terminal's shell leaves
them."""

import signal
import sys
from pathlib import Path

import pytest
from chromium import chromium_page, find_chromium
from hypothesis import HealthCheck, settings

settings.register_profile(
    "suite",
    deadline=None,  # on any processor
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
settings.register_profile(
    "fuzz", settings.get_profile("suite"), derandomize=False, max_examples=1200
)
settings.load_profile("suite")


@pytest.fixture(scope="module")
def browser():
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium on this machine: install it, or name one in $CHROMIUM")
    with chromium_page(executable) as page:
        yield page


@pytest.fixture(scope="module")
def lightglue():
    """ALIKED with LightGlue, which the environment of the tests lacks as a user's does, can be
    imported in the module's tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).resolve().parents[1] / "lightglue")
        yield
    sys.modules.pop("dgc_pose_lightglue", None)


@pytest.fixture
def default_signals():
    """SIGINT and SIGTERM do in the test, and in the processes it starts, what they do by default.

    A script that runs `make test &` starts it with SIGINT ignored, which processes inherit.
    """
    defaults = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in defaults.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)
