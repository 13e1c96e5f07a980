"""A recording as versions before chunks wrote it: every message a record of its own, no checksum over the data."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from emulator.recording.bounds import mcap_records


def write_older(source: Path, target: Path, change: Callable[[bytes], bytes] = lambda scenario: scenario) -> None:
    """The same records into another file; `change` is applied to the scenario within."""
    with source.open("rb") as file, target.open("wb") as out:
        writer = Writer(out, use_chunking=False, compression=CompressionType.NONE)
        writer.start("", "lidaremu of before")
        for record in mcap_records(file):
            if isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
            elif isinstance(record, Attachment):
                writer.add_attachment(0, 0, record.name, record.media_type, change(record.data))
            elif isinstance(record, Schema):
                assert writer.register_schema(record.name, record.encoding, record.data) == record.id
            elif isinstance(record, Channel):
                about = record.metadata
                assert (
                    writer.register_channel(record.topic, record.message_encoding, record.schema_id, about) == record.id
                )
            elif isinstance(record, Message):
                number, sequence = record.channel_id, record.sequence
                writer.add_message(number, record.log_time, record.data, record.publish_time, sequence)
        writer.finish()  # type: ignore[no-untyped-call]
