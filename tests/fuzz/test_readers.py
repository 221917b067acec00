"""Every reader answers a damaged file with its value or with one line of error: no other exception,
no hang, no memory without bound, nothing printed, changed or left."""

import io
import re
import resource
import shutil
import zipfile
from pathlib import Path

import cv2
import pytest
from fuzz.readers import READERS
from hypothesis import given, settings
from hypothesis import strategies as st

from dgc_pose.errors import DgcPoseError

pytestmark = pytest.mark.slow

MEMORY = 2**30  # bytes that one file may take
NUMBERS = (0, 1, 255, 256, 30_000, 65_535, 10**6, 2**31 - 10, 2**31 - 1, 2**31, 2**32 - 1)
WORDS = (
    'nan inf -inf 1e400 -1 0 -0.0 1e-320 1e308 0x10 1_000 ٣ ¼ 1,5 true null None {} [] "x" - . ../b'
).split() + ["", "9" * 5000, "\0", "\ufeff", "é" * 300, '"' + "x" * 140_000, "[" * 2000, "\n\r"]


PRINTING = {".jpg", ".jpeg", ".png"}  # libjpeg and libpng tell what is damaged


@st.composite
def damaged(draw: st.DrawFn, data: bytes) -> bytes:
    """The data with damage, now and then none: to bytes anywhere, and to words and to members where
    a format has them, so that it gets past compression."""

    def edited(data: bytes) -> bytes:
        """Some bytes are replaced, missing, or come several times; mostly in the header."""
        start = draw(st.integers(0, min(256, len(data))) | st.integers(0, len(data)))
        end = draw(st.integers(start, min(start + 64, len(data))) | st.just(len(data)))
        order = draw(st.sampled_from(("little", "big")))
        new = draw(
            st.binary(max_size=64)
            | st.sampled_from(NUMBERS).map(lambda number: number.to_bytes(4, order))
            | st.integers(2, 400).map(lambda times: data[start:end][:10_000] * times)
        )
        return data[:start] + new + data[end:]

    def words(data: bytes) -> bytes:
        """Words of a text, or what parts them, become others."""
        parts = re.split(rb"([\s,:]+)", data)
        for place in draw(st.lists(st.integers(0, len(parts) - 1), min_size=1, max_size=3)):
            parts[place] = draw(st.sampled_from(WORDS)).encode()
        return b"".join(parts)

    def members(data: bytes) -> bytes:
        """A member of a ZIP archive is damaged or missing, all packed or none."""
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            contents = {name: archive.read(name) for name in archive.namelist()}
        name = draw(st.sampled_from([*contents]))
        body = edited(contents.pop(name))
        contents |= {name: body} if draw(st.booleans()) else {}
        stream = io.BytesIO()
        packing = draw(st.sampled_from((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))
        with zipfile.ZipFile(stream, "w", packing) as archive:
            for name, content in contents.items():
                archive.writestr(name, content)
        return stream.getvalue()

    ways = [lambda data: data, edited, lambda data: edited(edited(data))]
    if data.startswith(b"PK"):
        ways += 3 * [members]
    elif b"\0" not in data:
        ways += 3 * [words]
    return draw(st.sampled_from(ways))(data)


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
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
