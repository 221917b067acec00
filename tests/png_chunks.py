"""PNG files with a chunk that Pillow does not write, or not there."""

import struct
import zlib


def with_chunk(png: bytes, kind: bytes, content: bytes, *, behind: bool = False) -> bytes:
    """A PNG with one chunk more, behind its first chunk or behind its pixels."""
    chunk = struct.pack(">I", len(content)) + kind + content
    chunk += struct.pack(">I", zlib.crc32(kind + content))
    at = len(png) - 12 if behind else 33
    return png[:at] + chunk + png[at:]
