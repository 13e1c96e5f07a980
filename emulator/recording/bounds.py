"""Limits on what a recording may ask of memory, and the reading that keeps them; a stranger may have made the file.

Belongs here: sizes, and what is packed (chunks of MCAP, containers of BLF). Not: what the records mean (reader).
"""

from __future__ import annotations

import errno
import os
import stat
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from mcap.records import Chunk, McapRecord
from mcap.stream_reader import StreamReader

from emulator.budgets import RECORDING, TooMuch

MOST_BYTES, MOST_RECORDS, MOST_RECORD = RECORDING.bytes, RECORDING.records, RECORDING.record_bytes
MOST_UNPACKED = RECORDING.unpacked_bytes
BLF_OBJECT_HEAD, BLF_CONTAINER_HEAD, BLF_CONTAINER, ZLIB = 16, 32, 10, 2


TooLarge = TooMuch


def regular(path: Path) -> None:
    """A regular file, or `TooLarge`: whoever opened a pipe would wait for ever. `OSError` where there is nothing."""
    mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(mode):
        raise TooLarge("not a regular file; want one")


def bearable(path: Path) -> None:
    """A regular file that can be kept in memory, or `TooLarge`; `OSError` where there is nothing."""
    regular(path)
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise TooLarge(f"{size} bytes; want at most {MOST_BYTES}")


class _Bounded:
    """A stream that makes no room for more than a record can hold: lengths inside records are a stranger's, too."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def read(self, size: int = -1) -> bytes:
        """As of a file."""
        if not 0 <= size <= MOST_RECORD:
            raise ValueError(f"a length of {size} bytes; want at most {MOST_RECORD}")
        return self._stream.read(size)


def mcap_records(file: BinaryIO) -> Iterator[McapRecord]:
    """Records of an MCAP file, those in chunks too."""
    count = 0
    reader: Any = _Bounded(file)
    for record in StreamReader(reader, record_size_limit=MOST_RECORD, emit_chunks=True).records:
        for item in _chunk(record) if isinstance(record, Chunk) else (record,):
            count += 1
            if count > MOST_RECORDS:
                raise TooLarge(f"more than {MOST_RECORDS} records; want a shorter recording")
            yield item


def _chunk(chunk: Chunk) -> Iterator[McapRecord]:
    data = unpacked(chunk.compression, chunk.data)
    inner: Any = _Bounded(BytesIO(data))
    records = StreamReader(inner, skip_magic=True, record_size_limit=MOST_RECORD).records
    while inner._stream.tell() < len(data):
        record = next(records, None)
        if record is None:  # a footer within a chunk ends it
            return
        yield record


def unpacked(compression: str, data: bytes) -> bytes:
    """What was packed; `TooLarge` beyond `MOST_UNPACKED`, `ValueError` for what is broken or unknown."""
    if compression == "":
        return data
    try:
        if compression == "zstd":
            import zstandard

            with zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(data) as stream:
                out: bytes = stream.read(MOST_UNPACKED + 1)
        elif compression == "lz4":
            import lz4.frame

            out = lz4.frame.LZ4FrameDecompressor().decompress(data, MOST_UNPACKED + 1)
        else:
            raise ValueError(f"compression {compression!r}; want none, zstd or lz4")
    except ImportError:
        raise ValueError(f"compression {compression} wants its library") from None
    except (RuntimeError, EOFError) as error:
        raise ValueError(f"broken {compression}: {error}") from None
    except Exception as error:
        if isinstance(error, ValueError) or not type(error).__module__.startswith(("zstandard", "backend_c")):
            raise
        raise ValueError(f"broken zstd: {error}") from None
    if len(out) > MOST_UNPACKED:
        raise TooLarge(f"a chunk of more than {MOST_UNPACKED} bytes; want smaller chunks")
    return out


def check_blf(data: bytes) -> None:
    """Containers of a BLF file stay within `MOST_UNPACKED`, or `TooLarge`; `ValueError` for an object without length.

    python-can unpacks containers without looking, and stays for ever at an object of length 0.
    """
    at = int.from_bytes(data[4:8], "little") if data[:4] == b"LOGG" else len(data)
    tail = b""
    while at + BLF_OBJECT_HEAD <= len(data) and data[at : at + 4] == b"LOBJ":
        size, kind = (int.from_bytes(data[at + first : at + first + 4], "little") for first in (8, 12))
        if kind == BLF_CONTAINER:
            body = data[at + BLF_CONTAINER_HEAD : at + max(size, BLF_CONTAINER_HEAD)]
            method = int.from_bytes(data[at + BLF_OBJECT_HEAD : at + BLF_OBJECT_HEAD + 2], "little")
            tail = _check_objects(tail + _container(body, method))
        if size < BLF_OBJECT_HEAD:
            raise ValueError(f"an object of {size} bytes at {at}; want at least {BLF_OBJECT_HEAD}")
        at += size + size % 4


def _container(body: bytes, method: int) -> bytes:
    if method != ZLIB:
        return body
    try:
        out = zlib.decompressobj().decompress(body, MOST_UNPACKED + 1)
    except zlib.error:
        return b""
    if len(out) > MOST_UNPACKED:
        raise TooLarge(f"a container of more than {MOST_UNPACKED} bytes; want smaller ones")
    return out


def _check_objects(data: bytes) -> bytes:
    """Look at the length of every object; what belongs to the next container."""
    at = 0
    while (found := data.find(b"LOBJ", at, at + 8)) >= 0 and found + BLF_OBJECT_HEAD <= len(data):
        size = int.from_bytes(data[found + 8 : found + 12], "little")
        if size < BLF_OBJECT_HEAD:
            raise ValueError(f"an object of {size} bytes within a container; want at least {BLF_OBJECT_HEAD}")
        if found + size > len(data):
            break
        at = found + size
    return data[at:] if len(data) - at <= MOST_UNPACKED else b""
