"""Damage to files, drawn by a seed: bytes anywhere, and tokens, chunks and members where a format
has them, so that the damage gets past checksums and compression."""

from __future__ import annotations

import io
import json
import re
import sqlite3
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

_MOST = 2**22  # bytes of a damaged file
Mutator = Callable[[bytes, np.random.Generator], bytes]

_NUMBERS = (0, 1, 2, 3, 127, 128, 255, 256, 32767, 32768, 65535, 65536, 2**24, 2**31 - 1, 2**31)
_NUMBERS += (2**31 - 10, 2**32 - 1, 10**6, 30_000, 100_000)
_TOKENS = (
    'nan inf -inf 1e400 -1 0 -0.0 1e-320 1e308 0x10 1_000 ٣ ¼ 1,5 true null None {} [] "x" - .'
).split() + ["", "9" * 30, "9" * 5000, "\0", "\ufeff", "é" * 300, "a/../b", "%s", "$x$", "\x1b[31m"]


def flip(data: bytes, rng: np.random.Generator) -> bytes:
    """Single bits."""
    found = bytearray(data)
    for _ in range(1 + int(rng.exponential(4))):
        if found:
            found[rng.integers(len(found))] ^= 1 << int(rng.integers(8))
    return bytes(found)


def overwrite(data: bytes, rng: np.random.Generator) -> bytes:
    """Random bytes in place of some."""
    start, end = _range(data, rng)
    return data[:start] + rng.bytes(end - start) + data[end:]


def remove(data: bytes, rng: np.random.Generator) -> bytes:
    """A part is missing."""
    start, end = _range(data, rng)
    return data[:start] + data[end:]


def repeat(data: bytes, rng: np.random.Generator) -> bytes:
    """A part comes several times."""
    start, end = _range(data, rng)
    return data[:end] + data[start:end] * int(rng.integers(1, 20)) + data[end:]


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    """The end is missing."""
    return data[: int(rng.integers(len(data) + 1))]


def extend(data: bytes, rng: np.random.Generator) -> bytes:
    """Junk before or after."""
    junk = rng.bytes(int(rng.integers(1, 300)))
    return junk + data if rng.random() < 0.3 else data + junk


def number(data: bytes, rng: np.random.Generator) -> bytes:
    """An integer of 2 or 4 bytes becomes an extreme one; mostly in the header."""
    value = _NUMBERS[rng.integers(len(_NUMBERS))]
    form = ("<I", ">I", "<H", ">H")[rng.integers(4)]
    packed = struct.pack(form, value % (2**32 if form[1] == "I" else 2**16))
    reach = min(len(data), 256) if rng.random() < 0.7 else len(data)
    place = int(rng.integers(max(reach, 1)))
    return data[:place] + packed + data[place + len(packed) :]


def nothing(data: bytes, rng: np.random.Generator) -> bytes:
    """The file as it is: readers must accept their own seeds too."""
    return data


def tokens(data: bytes, rng: np.random.Generator) -> bytes:
    """Words of a text become others."""
    parts = re.split(rb"([\s,:]+)", data)
    for _ in range(1 + int(rng.exponential(1.5))):
        token = _TOKENS[rng.integers(len(_TOKENS))].encode("utf-8", "surrogateescape")
        parts[2 * int(rng.integers((len(parts) + 1) // 2))] = token
    return b"".join(parts)


def lines(data: bytes, rng: np.random.Generator) -> bytes:
    """Lines of a text are dropped, repeated, exchanged, or end otherwise."""
    found = data.split(b"\n")
    place = int(rng.integers(len(found)))
    kind = rng.integers(6)
    if kind == 0:
        del found[place]
    elif kind == 1:
        found[place:place] = [found[place]] * _times(found[place], int(rng.integers(1, 50)))
    elif kind == 2:
        rng.shuffle(found)
    elif kind == 3:
        found[place] = found[place] * _times(found[place], int(rng.integers(2, 400)))
    elif kind == 4:
        found[place] += b'"' if rng.random() < 0.5 else b"\0"
    joint = (b"\n", b"\r\n", b"\r", b"\n\n", b" ")[rng.integers(5)]
    return (b"\xef\xbb\xbf" if rng.random() < 0.1 else b"") + joint.join(found)


def _times(part: bytes, wanted: int) -> int:
    """How often a part is repeated, so that the file stays small."""
    return max(1, min(wanted, _MOST // max(1, len(part))))


def nested(data: bytes, rng: np.random.Generator) -> bytes:
    """JSON far deeper than a parser's stack, or one of its values exchanged."""
    if rng.random() < 0.3:
        depth = int(rng.integers(900, 200_000))
        return b"[" * depth + b"]" * depth
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        return tokens(data, rng)
    return json.dumps(_exchanged(content, rng)).encode()


def _exchanged(content: Any, rng: np.random.Generator) -> Any:
    """A value of JSON, at any depth, becomes another or is missing."""
    if isinstance(content, dict | list) and content and rng.random() < 0.8:
        keys: list[Any] = list(content) if isinstance(content, dict) else [*range(len(content))]
        key = keys[rng.integers(len(keys))]
        if rng.random() < 0.1:
            del content[key]
        else:
            content[key] = _exchanged(content[key], rng)
        return content
    odd = (None, [], {}, "x", -1, 1e308, [[1]], True, [float("nan")], 10**40, "../x", 0.5, "\ud800")
    return odd[rng.integers(len(odd))]


def sql(data: bytes, rng: np.random.Generator) -> bytes:
    """A value of an SQLite database becomes another, or a table a view, the file whole."""
    connection = sqlite3.connect(":memory:")
    try:
        connection.deserialize(data)
        tables = [row[0] for row in connection.execute("SELECT name FROM sqlite_master")]
        names = [name for name in tables if not name.startswith("sqlite_")]
        table = names[rng.integers(len(names))]
        columns = [row[1] for row in connection.execute(f"PRAGMA table_info([{table}])")]
        column = columns[rng.integers(len(columns))]
        kind = rng.integers(12)
        if kind == 0:
            connection.execute(f"DROP TABLE [{table}]")
        elif kind == 1:
            connection.execute(f"ALTER TABLE [{table}] RENAME COLUMN [{column}] TO other")
        elif kind == 2:
            connection.execute(f"ALTER TABLE [{table}] RENAME TO other")
            connection.execute(f"CREATE VIEW [{table}] AS SELECT * FROM other")
        else:
            odd = (None, "x", "", -1, 0, 2**31, 2**62, 1e308, b"", b"\0" * 7, rng.bytes(40), "\0a")
            value = odd[rng.integers(len(odd))]
            connection.execute(f"UPDATE [{table}] SET [{column}] = ?", (value,))
        connection.commit()
        return bytes(connection.serialize())
    except (sqlite3.Error, ValueError, MemoryError, OverflowError):
        return flip(data, rng)  # damaged already
    finally:
        connection.close()


def png_chunk(data: bytes, rng: np.random.Generator) -> bytes:
    """The content of a chunk is damaged, its checksum right."""
    if not data.startswith(b"\x89PNG"):
        return flip(data, rng)
    chunks, place = [], 8
    while place + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, place)
        chunks.append((kind, data[place + 8 : place + 8 + length]))
        place += 12 + length
    if not chunks:
        return flip(data, rng)
    chosen = int(rng.integers(len(chunks)))
    kind, body = chunks[chosen]
    if kind == b"IDAT" and rng.random() < 0.5:
        with suppress(zlib.error):  # damaged already
            body = zlib.compress(_any(zlib.decompress(body), rng))
    else:
        body = _any(body, rng)
    if rng.random() < 0.2:
        kind = (b"tRNS", b"PLTE", b"iCCP", b"zTXt", b"eXIf", b"acTL", b"fcTL", b"gAMA")[
            rng.integers(8)
        ]
        chunks.insert(chosen, (kind, body))
    else:
        chunks[chosen] = (kind, body)
    found = data[:8]
    for kind, body in chunks:
        found += struct.pack(">I", len(body)) + kind + body
        found += struct.pack(">I", zlib.crc32(kind + body))
    return found


def member(data: bytes, rng: np.random.Generator) -> bytes:
    """A member of a ZIP archive is damaged, renamed, dropped or packed, the archive whole."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    except Exception:
        members = []
    if not members:
        return flip(data, rng)
    chosen = int(rng.integers(len(members)))
    name, body = members[chosen]
    kind = rng.integers(5)
    if kind == 0:
        members[chosen] = (name + "x", body)
    elif kind == 1:
        del members[chosen]
    elif kind == 2:
        members.append(("../" + name, body))
    else:
        members[chosen] = (name, _any(body, rng))
    stream = io.BytesIO()
    packing = zipfile.ZIP_DEFLATED if rng.random() < 0.2 else zipfile.ZIP_STORED
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", packing) as archive:
        warnings.simplefilter("ignore")  # of a name that comes twice
        for name, body in members:
            archive.writestr(name, body)
    return stream.getvalue()


BYTES: Sequence[Mutator] = (flip, overwrite, remove, repeat, cut, extend, number, nothing)
TEXT: Sequence[Mutator] = (*BYTES, tokens, tokens, tokens, lines, lines)
JSON: Sequence[Mutator] = (*TEXT, nested, nested, nested)
PNG: Sequence[Mutator] = (*BYTES, png_chunk, png_chunk, png_chunk, png_chunk)
SQL: Sequence[Mutator] = (*BYTES, sql, sql, sql, sql, sql, sql, sql, sql)
ZIP: Sequence[Mutator] = (*BYTES, member, member, member, member)


def mutated(data: bytes, mutators: Sequence[Mutator], rng: np.random.Generator) -> bytes:
    """Damage by one to three of the mutators."""
    most = max(_MOST, len(data))
    for _ in range(1 + int(rng.integers(3))):
        data = mutators[rng.integers(len(mutators))](data, rng)
    return data[:most]


def _any(data: bytes, rng: np.random.Generator) -> bytes:
    return BYTES[rng.integers(len(BYTES) - 1)](data, rng)


def _range(data: bytes, rng: np.random.Generator) -> tuple[int, int]:
    start = int(rng.integers(len(data) + 1))
    return start, min(len(data), start + 1 + int(rng.exponential(16)))
