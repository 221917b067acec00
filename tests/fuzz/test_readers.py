"""Every reader answers a damaged file with its value or with one line of error: no other exception,
no hang, no memory without bound, nothing printed, changed or left."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest
from fuzz.damage import damaged
from fuzz.hang import no_hang
from fuzz.readers import READERS, Read
from hypothesis import given, settings
from hypothesis import strategies as st

from dgc_pose.errors import DgcPoseError

pytestmark = pytest.mark.slow

HANG_S = 120  # of one file, on a busy machine
MEMORY = 2**30  # bytes that one file may take
PRINTING = {".jpg", ".jpeg", ".png"}  # libjpeg and libpng tell what is damaged
Reader = tuple[Path, dict[Path, bytes], Read]


@pytest.fixture(scope="module", autouse=True)
def _quiet_opencv() -> Iterator[None]:
    """OpenCV's own log is off, as in the command."""
    logging = cv2.utils.logging
    before = logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    yield
    logging.setLogLevel(before)


@pytest.fixture(scope="module", params=READERS)
def reader(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Reader:
    """A folder, the contents of its good files, and what reads them."""
    make, read = READERS[request.param]
    folder = tmp_path_factory.mktemp("reader")
    make(folder)
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return folder, {path: path.read_bytes() for path in files}, read


def test_the_good_files_are_accepted(reader: Reader) -> None:
    """But for weights, which are those of a part of a network."""
    folder, good, read = reader
    for path in good:
        if path.suffix != ".pth":
            read(folder, path)


@pytest.mark.filterwarnings("error")
@settings(max_examples=settings.default.max_examples // 4)
@given(data=st.data())
def test_damaged_files_are_read_or_refused_in_one_line(
    reader: Reader, data: st.DataObject, capfd: pytest.CaptureFixture[str]
) -> None:
    folder, good, read = reader
    path = data.draw(st.sampled_from([*good]))
    content = data.draw(damaged(good[path]))
    before = set(folder.rglob("*"))
    path.write_bytes(content)
    Path("/proc/self/clear_refs").write_text("5")  # forgets the peak
    memory = resident("VmHWM")
    try:
        with no_hang(HANG_S):
            read(folder, path)
    except DgcPoseError as error:
        assert str(error) and "\n" not in str(error)
    except OSError as error:
        assert error.filename is not None and error.strerror
    finally:
        read_again = path.read_bytes()
        path.write_bytes(good[path])
    assert resident("VmHWM") - memory < MEMORY
    assert (read_again, set(folder.rglob("*"))) == (content, before)
    out, err = capfd.readouterr()
    assert not out and (not err or path.suffix in PRINTING)


def resident(name: str) -> int:
    """Bytes of this process, by the name of Linux."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (line,) = (line for line in lines if line.startswith(name))
    return int(line.split()[1]) * 1024
