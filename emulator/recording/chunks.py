"""`run.mcap` as it is written: chunks with a checksum each, an index, a summary.

Belongs here: MCAP's records in their order. Not: what the messages hold (layout), nor who writes when (writing).

The library's own writer turns every message into records and files each chunk at once. Here a message costs its sender
two entries of a list; packing, checksums and the disk are the business of whoever is given the finished chunk. The
records themselves are the library's. Source: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import sys
import zlib
from array import array
from collections import Counter
from collections.abc import Callable, Mapping
from tempfile import TemporaryFile
from typing import IO

import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from emulator.recording.folder import RecordingFile

MAGIC = b"\x89MCAP0\r\n"
COMPRESSION = "lz4"
"A third of the bytes for what writing them would cost; zstd saves a sixth more at five times that. [measured]"
KEPT_INDEX = 1 << 20
"Bytes of the index that are kept in memory; a week of chunks makes 80 MB."

_MESSAGE = struct.Struct("<BQHIQQ")
_INDEX = struct.Struct("<BQHI")


class OpenChunk:
    """Messages that wait to be written together."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.size = 0
        self.first_ns = 0
        self.last_ns = 0
        self.index: dict[int, array[int]] = {}
        "Channel -> instant and place of each of its messages, one behind the other."

    def message(self, channel: int, log_ns: int, data: bytes, publish_ns: int, sequence: int) -> None:
        """One more; instants at least 0."""
        if not self.index:
            self.first_ns = self.last_ns = log_ns
        elif log_ns < self.first_ns:
            self.first_ns = log_ns
        elif log_ns > self.last_ns:
            self.last_ns = log_ns
        places = self.index.get(channel)
        if places is None:
            places = self.index[channel] = array("Q")
        places.append(log_ns)
        places.append(self.size)
        self.parts += (_MESSAGE.pack(5, 22 + len(data), channel, sequence, log_ns, publish_ns), data)
        self.size += 31 + len(data)

    def record(self, record: McapRecord) -> None:
        """A schema or a channel."""
        data = bytes_of(record)
        self.parts.append(data)
        self.size += len(data)


def bytes_of(*records: McapRecord) -> bytes:
    """Records as they stand in a file."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


class McapFile:
    """The file, from its first byte to its last; used by one thread at a time."""

    def __init__(self, file: RecordingFile, library: str) -> None:
        self._file = file
        self._crc = 0
        self._index = bytearray()
        self._spilt: IO[bytes] | None = None
        "Of the index, what is too much to be kept in memory."
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: Counter[int] = Counter()
        self._span: tuple[int, int] | None = None
        self._chunks = 0
        self._put(MAGIC)
        self._put(bytes_of(Header("", library)))

    def _put(self, *parts: bytes) -> None:
        for data in parts:
            self._crc = zlib.crc32(data, self._crc)
        self._file.write(parts[0] if len(parts) == 1 else b"".join(parts))

    def metadata(self, name: str, table: Mapping[str, str]) -> None:
        """Names and texts."""
        data = bytes_of(Metadata(name=name, metadata=dict(table)))
        self._metadata.append(MetadataIndex(offset=self._file.written, length=len(data), name=name))
        self._put(data)

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """A file within the file."""
        record = bytes_of(Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data))
        self._attachments.append(
            AttachmentIndex(self._file.written, len(record), 0, 0, len(data), name, media_type)
        )  # fmt: skip
        self._put(record)

    def chunk(self, chunk: OpenChunk) -> None:
        """Pack and write it, and its index behind it."""
        plain = b"".join(chunk.parts)
        packed: bytes = lz4.frame.compress(plain, store_size=False)
        name = struct.pack("<I", len(COMPRESSION)) + COMPRESSION.encode() + struct.pack("<Q", len(packed))
        crc = zlib.crc32(plain)
        length = 28 + len(name) + len(packed)
        head = struct.pack("<BQQQQI", 6, length, chunk.first_ns, chunk.last_ns, len(plain), crc) + name
        at = self._file.written
        index_at = at + len(head) + len(packed)
        offsets: dict[int, int] = {}
        parts: list[bytes] = []
        size = 0
        for channel, places in chunk.index.items():
            offsets[channel] = index_at + size
            rows = _little(places)
            parts += (_INDEX.pack(7, 6 + len(rows), channel, len(rows)), rows)
            size += _INDEX.size + len(rows)
        self._put(head, packed, *parts)
        index = ChunkIndex(
            chunk_length=index_at - at,
            chunk_start_offset=at,
            compression=COMPRESSION,
            compressed_size=len(packed),
            message_end_time=chunk.last_ns,
            message_index_length=size,
            message_index_offsets=offsets,
            message_start_time=chunk.first_ns,
            uncompressed_size=len(plain),
        )
        self._keep(bytes_of(index))
        self._chunks += 1
        self._counts.update({channel: len(places) // 2 for channel, places in chunk.index.items()})
        if chunk.index:
            first_ns, last_ns = self._span or (chunk.first_ns, chunk.last_ns)
            self._span = min(first_ns, chunk.first_ns), max(last_ns, chunk.last_ns)

    def _keep(self, index: bytes) -> None:
        self._index += index
        if len(self._index) > KEPT_INDEX:
            if self._spilt is None:
                self._spilt = TemporaryFile()
            self._spilt.write(self._index)
            self._index.clear()

    def finish(self, schemas: list[Schema], channels: list[Channel]) -> None:
        """The end of the data with its checksum, the summary with its own."""
        self._put(bytes_of(DataEnd(self._crc)))
        start = at = self._file.written
        crc, offsets = 0, []

        def put(data: bytes) -> None:
            nonlocal crc
            crc = zlib.crc32(data, crc)
            self._file.write(data)

        groups: list[tuple[Opcode, Callable[[], None]]] = [
            (Opcode.SCHEMA, lambda: put(bytes_of(*schemas))),
            (Opcode.CHANNEL, lambda: put(bytes_of(*channels))),
            (Opcode.STATISTICS, lambda: put(bytes_of(self._statistics(schemas, channels)))),
            (Opcode.CHUNK_INDEX, lambda: self._copy_indices(put)),
            (Opcode.ATTACHMENT_INDEX, lambda: put(bytes_of(*self._attachments))),
            (Opcode.METADATA_INDEX, lambda: put(bytes_of(*self._metadata))),
        ]
        for opcode, write in groups:
            write()
            if self._file.written > at:
                offsets.append(SummaryOffset(opcode, at, self._file.written - at))
            at = self._file.written
        put(bytes_of(*offsets))
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, at)
        self._file.write(bytes_of(Footer(start, at, zlib.crc32(footer, crc))) + MAGIC)

    def _copy_indices(self, put: Callable[[bytes], None]) -> None:
        if self._spilt is not None:
            self._spilt.seek(0)
            while data := self._spilt.read(KEPT_INDEX):
                put(data)
        put(bytes(self._index))

    def _statistics(self, schemas: list[Schema], channels: list[Channel]) -> Statistics:
        first_ns, last_ns = self._span or (0, 0)
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunks,
            message_count=sum(self._counts.values()),
            message_end_time=last_ns,
            message_start_time=first_ns,
            metadata_count=len(self._metadata),
            schema_count=len(schemas),
        )

    def close(self) -> None:
        """Let go of what was kept for the summary."""
        if self._spilt is not None:
            self._spilt.close()


def _little(places: array[int]) -> bytes:
    if sys.byteorder == "big":
        places = array("Q", places)
        places.byteswap()
    return places.tobytes()
