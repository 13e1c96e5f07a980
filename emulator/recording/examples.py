"""Small MCAP files that hold, for fuzzing and tests: as we write them, and with chunks as other tools would."""

from __future__ import annotations

import io
import json

from mcap.writer import CompressionType, Writer

from emulator.recording import layout


def example_mcaps() -> tuple[bytes, ...]:
    """One as we write it, and with chunks, plain and compressed, as other tools would."""
    found = []
    for chunks, compression in (
        (False, CompressionType.NONE),
        (True, CompressionType.NONE),
        (True, CompressionType.LZ4),
        (True, CompressionType.ZSTD),
    ):
        stream = io.BytesIO()
        writer = Writer(stream, use_chunking=chunks, compression=compression)
        writer.start("", "fuzz")
        writer.add_metadata(layout.META_NAME, {"layout": str(layout.VERSION), "version": "0"})
        wire = writer.register_schema("lidaremu.Wire", "text", b"x")
        event = writer.register_schema("lidaremu.Event", "jsonschema", b"{}")
        about = {
            "sensor": "front",
            "link": "0",
            "kind": "serial",
            "url": "pty:./x",
            "direction": "tx",
            "peer": "0",
            "baud": "9600",
        }
        first = writer.register_channel("/front/0/tx", layout.WIRE_ENCODING, wire, about)
        second = writer.register_channel("/front/event", layout.EVENT_ENCODING, event, {"sensor": "front"})
        writer.add_message(first, 1, b"\x02\x80\x03", 2, 1)
        writer.add_message(second, 3, json.dumps({"event": "x"}).encode(), 3)
        writer.finish()  # type: ignore[no-untyped-call]
        found.append(stream.getvalue())
    return tuple(found)
