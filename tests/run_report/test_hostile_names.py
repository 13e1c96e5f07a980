"""A recording whose names and texts are hostile: text on the page, no formulas in tables, letters in figures."""

from __future__ import annotations

import csv
import json
from html.parser import HTMLParser
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from emulator.commands.cli import main

EVIL = '=<img src=x onerror="alert(1)">$\\frac{$[x](javascript:y)`\x1b[2J\u202e'


def renamed(source: Path, target: Path) -> None:
    """The recording with another name for its sensor, and that name as the text of every event."""
    with source.open("rb") as stream, target.open("wb") as out:
        reader = make_reader(stream)
        writer = Writer(out, use_chunking=False, compression=CompressionType.NONE)
        writer.start("", "test")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for one in reader.iter_metadata():
            values = {EVIL: next(iter(one.metadata.values()))} if one.name == "lidaremu.end" else one.metadata
            writer.add_metadata(one.name, values)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                about = channel.metadata | {"sensor": EVIL} | ({"url": EVIL} if "url" in channel.metadata else {})
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id], about
                )
            data = message.data
            if channel.topic.endswith("/event"):
                reported = json.loads(data)
                data = json.dumps(
                    {
                        key: EVIL if isinstance(reported[key], str) and key != "event" else reported[key]
                        for key in reported
                    }
                ).encode()
            writer.add_message(channels[channel.id], message.log_time, data, message.publish_time, message.sequence)
        writer.finish()  # type: ignore[no-untyped-call]


class Elements(HTMLParser):
    """What a browser would make of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.names: set[str] = set()
        self.handlers: list[str] = []
        self.sources: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.add(tag)
        self.handlers += [key for key, _ in attrs if key.startswith("on")]
        self.sources += [value or "" for key, value in attrs if key in ("src", "href")]


def test_a_report_of_hostile_names_is_text(wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    renamed(wall / "run.mcap", tmp_path / "run.mcap")
    page, tables = tmp_path / "page.html", tmp_path / "tables"
    assert main(["report", str(tmp_path), "--out", str(page), "--figures", str(tables)]) == 0
    text = page.read_text(encoding="utf-8")
    seen = Elements()
    seen.feed(text)
    assert "&lt;img src=x" in text
    assert not {"script", "iframe", "object", "svg"} & seen.names
    assert not seen.handlers
    assert all(one.startswith(("data:image/png;base64,", "#")) for one in seen.sources)
    assert "\x1b" not in text
    assert "\u202e" not in text
    assert (tables / "overview.csv").is_file()
    for table in tables.glob("*.csv"):
        with table.open(encoding="utf-8", newline="") as file:
            for row in csv.reader(file):
                assert all(not one.lstrip().startswith(("=", "+", "@")) and one.isprintable() for one in row), row
                assert all(float(one) is not None for one in row if one.startswith("-"))
    out = "".join(capsys.readouterr())
    assert all(line.isprintable() for line in out.split("\n"))


@pytest.mark.parametrize("command", [["replay"], ["diff"]])
def test_other_commands_tell_them_as_text(
    command: list[str], wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    renamed(wall / "run.mcap", tmp_path / "run.mcap")
    more = [str(wall)] if command == ["diff"] else ["--link", "x=y"]
    assert main([*command, str(tmp_path), *more]) in (1, 2)
    seen = "".join(capsys.readouterr())
    assert "onerror" in seen
    assert all(line.isprintable() for line in seen.split("\n"))
