"""Damage to files as a strategy: bytes anywhere, and words and members where a format has them, so
that the damage gets past compression."""

import io
import re
import zipfile

from hypothesis import strategies as st

_NUMBERS = (0, 1, 255, 256, 30_000, 65_535, 10**6, 2**31 - 10, 2**31 - 1, 2**31, 2**32 - 1)
_WORDS = (
    'nan inf -inf 1e400 -1 0 -0.0 1e-320 1e308 0x10 1_000 ٣ ¼ 1,5 true null None {} [] "x" - . ../b'
).split() + ["", "9" * 5000, "\0", "\ufeff", "é" * 300, '"' + "x" * 140_000, "[" * 2000, "\n\r"]


@st.composite
def damaged(draw: st.DrawFn, data: bytes) -> bytes:
    """The data with damage of the kinds that their format allows, now and then none."""
    kinds = [lambda: data, lambda: _edited(draw, data), lambda: _edited(draw, _edited(draw, data))]
    if data.startswith(b"PK"):
        kinds += 3 * [lambda: _members(draw, data)]
    elif b"\0" not in data:
        kinds += 3 * [lambda: _words(draw, data)]
    return draw(st.sampled_from(kinds))()


def _edited(draw: st.DrawFn, data: bytes) -> bytes:
    """Some bytes are replaced, missing, or come several times; mostly in the header."""
    start = draw(st.integers(0, min(256, len(data))) | st.integers(0, len(data)))
    end = draw(st.integers(start, min(start + 64, len(data))) | st.just(len(data)))
    order = draw(st.sampled_from(("little", "big")))
    new = draw(
        st.binary(max_size=64)
        | st.sampled_from(_NUMBERS).map(lambda number: number.to_bytes(4, order))
        | st.integers(2, 400).map(lambda times: data[start:end][:10_000] * times)
    )
    return data[:start] + new + data[end:]


def _words(draw: st.DrawFn, data: bytes) -> bytes:
    """Words of a text, or what parts them, become others."""
    parts = re.split(rb"([\s,:]+)", data)
    for place in draw(st.lists(st.integers(0, len(parts) - 1), min_size=1, max_size=3)):
        parts[place] = draw(st.sampled_from(_WORDS)).encode()
    return b"".join(parts)


def _members(draw: st.DrawFn, data: bytes) -> bytes:
    """A member of a ZIP archive is damaged or missing, all packed or none."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = draw(st.sampled_from([*members]))
    body = _edited(draw, members.pop(name))
    members |= {name: body} if draw(st.booleans()) else {}
    stream = io.BytesIO()
    packing = draw(st.sampled_from((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))
    with zipfile.ZipFile(stream, "w", packing) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()
