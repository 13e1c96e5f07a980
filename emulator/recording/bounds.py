"""Limits on what a recording may ask of memory, and the reading that keeps them; the file is untrusted.

Belongs here: sizes, and what is packed (chunks of MCAP, containers of BLF). Not: what the records mean (reader).
"""

from __future__ import annotations

import errno
import os
import stat
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    Schema,
)

from emulator.config.budgets import RECORDING, TooMuch

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


class Altered(ValueError):
    """Bytes of a file are not those that were written; the text says where."""


class Ends(ValueError):
    """A file ends before its end."""


READ: dict[int, Callable[[ReadDataStream, int], McapRecord]] = {
    Opcode.HEADER: lambda stream, length: Header.read(stream),
    Opcode.FOOTER: lambda stream, length: Footer.read(stream),
    Opcode.SCHEMA: lambda stream, length: Schema.read(stream),
    Opcode.CHANNEL: lambda stream, length: Channel.read(stream),
    Opcode.MESSAGE: Message.read,
    Opcode.CHUNK: lambda stream, length: Chunk.read(stream),
    Opcode.MESSAGE_INDEX: lambda stream, length: MessageIndex.read(stream),
    Opcode.ATTACHMENT: lambda stream, length: Attachment.read(stream),
    Opcode.METADATA: lambda stream, length: Metadata.read(stream),
    Opcode.DATA_END: lambda stream, length: DataEnd.read(stream),
}
"How the library reads what stands in the data; the summary repeats it."
IN_CHUNKS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
PRIVATE = 0x80
"Opcodes from here on are other tools' own."
_HEAD = struct.Struct("<BQ")
MAGIC = b"\x89MCAP0\r\n"


def mcap_records(file: BinaryIO, most: int | None = None) -> Iterator[McapRecord]:
    """Records of an MCAP file, those in chunks too, each chunk after its checksum was found right.

    `Ends` where the file was cut, as by a run that was killed; `Altered` where its bytes are not those that were
    written. What has no checksum, as in files of older versions, is taken as it stands. `most`: bytes of all chunks
    when unpacked, of a reader that keeps them.
    """
    count = size = 0
    for record, at in _records(file):
        size += record.uncompressed_size if isinstance(record, Chunk) else 0
        if most is not None and size > most:
            raise TooLarge(f"more than {most} bytes when unpacked; want a shorter recording")
        for item in _within(record, at) if isinstance(record, Chunk) else (record,):
            count += 1
            if count > MOST_RECORDS:
                raise TooLarge(f"more than {MOST_RECORDS} records; want a shorter recording")
            yield item


def _records(file: BinaryIO) -> Iterator[tuple[McapRecord, int]]:
    """Records of the data as they lie in the file, with their places."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - len(MAGIC)))
    finished = size > 2 * len(MAGIC) and file.read() == MAGIC
    file.seek(0)
    crc = zlib.crc32(_exactly(file, len(MAGIC)))
    summary = False
    while True:
        at = file.tell()
        try:
            head = _exactly(file, _HEAD.size)
            kind, length = _HEAD.unpack(head)
            if length > MOST_RECORD:
                raise ValueError(f"a length of {length} bytes; want at most {MOST_RECORD}")
            body = _exactly(file, length)
            record = None if summary and kind != Opcode.FOOTER else _record(kind, body, finished)
        except BROKEN as error:
            raise _verdict(file, at, size, finished, error) from None
        if isinstance(record, Footer):
            if summary and record.summary_crc not in (0, zlib.crc32(head + body[:-4], crc)):
                raise Altered(f"CRC of the summary, before byte {at}")
            if file.read(len(MAGIC) + 1) != MAGIC:
                raise Altered(f"not the end behind byte {file.tell()}") if finished else Ends(ENDS)
            return
        if isinstance(record, DataEnd):
            if record.data_section_crc not in (0, crc):
                raise Altered(f"CRC of everything before byte {at}")
            summary, crc = True, 0
            continue
        if isinstance(record, Attachment) and int.from_bytes(body[-4:], "little") not in (0, zlib.crc32(body[:-4])):
            raise Altered(f"CRC of the attachment at byte {at}")
        crc = zlib.crc32(body, zlib.crc32(head, crc))
        if record is not None:
            yield record, at


def _record(kind: int, body: bytes, finished: bool) -> McapRecord | None:
    """One record; `ValueError` for what nobody writes there, and where no sum over all will tell, for any doubt."""
    reader = READ.get(kind)
    if reader is None:
        if finished and kind >= PRIVATE:
            return None
        raise ValueError(f"a record of kind {kind}; want one of the data")
    stream = ReadDataStream(BytesIO(body))
    record = reader(stream, len(body))
    if stream.count != len(body) and not finished:
        raise ValueError(f"{len(body)} bytes for a {type(record).__name__} of {stream.count}")
    return record


ENDS = "the file ends within a record"
BROKEN = (McapError, struct.error, ValueError, LookupError, OverflowError, TypeError)
SOUGHT = 1 << 26
"Bytes behind a broken record in which a whole one is looked for."


def _exactly(file: BinaryIO, size: int) -> bytes:
    data = file.read(size)
    if len(data) < size:
        raise Ends(ENDS)
    return data


def _verdict(file: BinaryIO, at: int, size: int, finished: bool, error: Exception) -> Exception:
    """What a broken record means: a file that was cut there, or one that was altered.

    A run that was killed leaves a piece of a record at the end, or zeros where the power failed. Where the file has its
    end, or a whole chunk comes after, something else has happened.
    """
    reported = ENDS if isinstance(error, Ends | struct.error | EndOfFile) else str(error) or type(error).__name__
    if finished:
        return Altered(f"the record at byte {at}: {reported}")
    file.seek(at)
    rest = file.read(SOUGHT)
    if not any(rest):
        return Ends(f"nothing but zeros from byte {at} on") if rest else Ends(ENDS)
    place = rest.find(b"\x06", 1)
    while place >= 0:
        if _is_chunk(rest, place):
            return Altered(f"the record at byte {at}: {reported}; a whole chunk comes after it")
        place = rest.find(b"\x06", place + 1)
    return Ends(reported)


def _is_chunk(data: bytes, at: int) -> bool:
    """Whether a whole chunk with a right checksum stands there."""
    if at + _HEAD.size > len(data):
        return False
    length = _HEAD.unpack_from(data, at)[1]
    if not 40 <= length <= len(data) - at - _HEAD.size:
        return False
    try:
        body = data[at + _HEAD.size : at + _HEAD.size + length]
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        crc: int = chunk.uncompressed_crc
        return crc != 0 and zlib.crc32(unpacked(chunk.compression, chunk.data)) == crc
    except BROKEN:
        return False


def _within(chunk: Chunk, at: int) -> Iterator[McapRecord]:
    """Records of a chunk that lies at that place."""
    try:
        data = unpacked(chunk.compression, chunk.data)
    except TooLarge:
        raise
    except ValueError as error:
        raise Altered(f"the chunk at byte {at}: {error}") from None
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise Altered(f"CRC of the chunk at byte {at}")
    if len(data) != chunk.uncompressed_size:
        raise Altered(f"the chunk at byte {at}: {len(data)} bytes; want {chunk.uncompressed_size}")
    place = 0
    while place < len(data):
        if place + _HEAD.size > len(data):
            raise ValueError(f"the chunk at byte {at} ends within a record")
        kind, length = _HEAD.unpack_from(data, place)
        place += _HEAD.size
        if length > len(data) - place:
            raise ValueError(f"the chunk at byte {at}: a record of {length} bytes; {len(data) - place} are left")
        if kind in IN_CHUNKS:
            yield READ[kind](ReadDataStream(BytesIO(data[place : place + length])), length)
        place += length


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
        raise ValueError(f"compression {compression} needs its library") from None
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
