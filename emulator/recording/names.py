"""What files of a recording are called: one a bus, one a sensor, and no two the same on any file system.

Belongs here: names from links and sensors. Not: making the files (folder).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from emulator.transports.urls import LinkUrl, parse_url

SCENARIO_NAME = "scenario.yaml"
LONGEST = 100
"Letters of a name: with an ending every file system takes it."
LOG_ENDINGS = (".log", ".blf", ".asc")
CAPTURE_ENDING = ".pcapng"


@dataclass(frozen=True)
class BusName:
    """Of a CAN bus."""

    stem: str
    "Of its files, without the ending."
    channel: str
    "As hosts know it; stands in every line of the log."


def plain(text: str, otherwise: str) -> str:
    """A text as part of a file name: letters and digits of ASCII, `-`, `_` and, but not first, the dot."""
    name = "".join(letter if letter.isascii() and (letter.isalnum() or letter in "-_.") else "_" for letter in text)
    name = name[:LONGEST]
    return f"_{name[1:]}" if name.startswith(".") else name or otherwise


def distinct(names: Sequence[str]) -> list[str]:
    """The same names, those that come again numbered from 2; capital letters make no difference."""
    taken = {name.casefold() for name in names}
    given: set[str] = set()
    found = []
    for name in names:
        number, reported = 1, name
        while reported.casefold() in given or (number > 1 and reported.casefold() in taken):
            number += 1
            reported = f"{name}-{number}"
        given.add(reported.casefold())
        found.append(reported)
    return found


def bus_names(texts: Mapping[str, str]) -> dict[str, BusName]:
    """A name for each bus, by its address: of the channel, and where that comes again with what distinguishes them.

    `texts`: address -> the link as the scenario has it, whose port may be 0. In the scenario's order.
    """
    parts = {bus: parse_url(text) for bus, text in texts.items()}
    channels = {bus: plain(_channel(one), "can") for bus, one in parts.items()}
    stems = dict(channels)
    for channel in {name.casefold() for name in channels.values()}:
        same = [bus for bus, name in channels.items() if name.casefold() == channel]
        marks = [plain(_mark(parts[bus]), "") for bus in same]
        if len(same) > 1 and all(marks) and len({mark.casefold() for mark in marks}) == len(same):
            stems |= {bus: f"{channels[bus]}-{mark}" for bus, mark in zip(same, marks, strict=True)}
    unique = distinct(list(stems.values()))
    return {bus: BusName(stem, channels[bus]) for bus, stem in zip(stems, unique, strict=True)}


def _channel(url: LinkUrl) -> str:
    return url.target.rpartition("/")[2].rpartition(":")[2]


def _mark(url: LinkUrl) -> str:
    """What distinguishes links of the same channel: port, interface, or the folder of a terminal."""
    if url.scheme == "socketcand":
        port = url.target.partition("/")[0].rpartition(":")[2]
        return "" if port == "0" else port
    if url.scheme == "can":
        return url.target.partition(":")[0]
    return url.target.rpartition("/")[0].rpartition("/")[2].strip(".")


def planned(stems: Sequence[str], sensors: Sequence[str]) -> list[str]:
    """Every file that a recording of those buses and sensors may write, but the first."""
    logs = [stem + ending for stem in stems for ending in LOG_ENDINGS]
    return [SCENARIO_NAME, *(name + CAPTURE_ENDING for name in sensors), *logs]
