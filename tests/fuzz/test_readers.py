"""Every reader answers a damaged file with its value or with one line of error: no other exception,
no hang, no memory without bound, nothing printed, changed or left."""

import shutil
from pathlib import Path

import cv2
import pytest
from fuzz.damage import damaged
from fuzz.readers import READERS
from hypothesis import given, settings
from hypothesis import strategies as st

from dgc_pose.errors import DgcPoseError

pytestmark = pytest.mark.slow

MEMORY = 2**30  # bytes that one file may take
PRINTING = {".jpg", ".jpeg", ".png"}  # libjpeg and libpng tell what is damaged


@pytest.fixture(scope="module", params=READERS)
def reader(request, tmp_path_factory):
    """A folder, the contents of its good files, and what reads them, as it read all of them."""
    make, *reads = READERS[request.param]
    folder = tmp_path_factory.mktemp("reader")
    make(folder)
    shutil.rmtree(folder / "views", ignore_errors=True)  # the photographs of a batch
    good = {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
    for path in good:
        for read in reads:
            if path.suffix != ".pth":  # a part of a network
                read(path)
    before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # as the command
    yield folder, good, reads
    cv2.utils.logging.setLogLevel(before)


@pytest.mark.filterwarnings("error")
@settings(max_examples=settings.default.max_examples // 2)
@given(data=st.data())
def test_damaged_files_are_read_or_refused_in_one_line(reader, data, capfd, begin_anew):
    folder, good, reads = reader
    path, read = data.draw(st.sampled_from([*good])), data.draw(st.sampled_from(reads))
    content = data.draw(damaged(good[path]))
    before = set(folder.rglob("*"))
    path.write_bytes(content)
    Path("/proc/self/clear_refs").write_text("5")  # forgets the peak
    memory = peak_memory()
    begin_anew()
    try:
        read(path)
    except DgcPoseError as error:
        assert str(error) and "\n" not in str(error)
    except OSError as error:
        assert error.filename is not None and error.strerror
    finally:
        read_again = path.read_bytes()
        path.write_bytes(good[path])
    assert peak_memory() - memory < MEMORY
    assert (read_again, set(folder.rglob("*"))) == (content, before)
    out, err = capfd.readouterr()
    assert not out and (not err or path.suffix in PRINTING)


def peak_memory():
    """Bytes that this process has held at once."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (line,) = (line for line in lines if line.startswith("VmHWM"))
    return int(line.split()[1]) * 1024
