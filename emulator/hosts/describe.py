"""Telegrams decoded field by field, for people. `describe` never raises, whatever the bytes are.

Belongs here: names, values and units of what goes over a wire, both ways, from the decoders and tables of the
protocols. What no table knows is shown as hex with the reason. Not: scans (the hosts), layouts (protocols).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from emulator.hosts import describe_cola
from emulator.hosts.families import BUILT_IN, found_at
from emulator.hosts.rplidar_reading import Reader, distances
from emulator.hosts.scip import ReplyReader
from emulator.hosts.scip_reading import decode_number, decode_values, joined
from protocols.ld.packages import Package, PackageReader
from protocols.ld.profiles import RANGE_LSB_PER_M, Field
from protocols.ld.sectors import TICKS
from protocols.ld.services import COMMANDS as LD_COMMANDS
from protocols.ld.telegrams import REPLY_BIT, SERVICE_FAILURE, Mode, Motor, words_of
from protocols.ld.usp import UspReader
from protocols.lms2xx import commands as lms
from protocols.lms2xx.telegrams import Telegram, open_frame, read_values
from protocols.lms2xx.values import COUNTS_PER_METRE, MEASURING_MODES
from protocols.rplidar import commands as rplidar
from protocols.rplidar.codec import EXPRESS, FORMS, HQ, STANDARD, ULTRA_DENSE
from protocols.scip import commands as scip
from protocols.skeleton.descriptors import REPLY_SYNC

FIRST = 8
"Numbers of a row that are shown before it is cut."
MOST_BYTES = 64
"Of what no table knows."
MOST_FIELDS = 200
LD_LONGEST = 65_536
DEGREES_PER_TICK = 360.0 / TICKS


class Described(NamedTuple):
    """One field."""

    name: str
    value: str
    unit: str = ""


@dataclass(frozen=True)
class Speaker:
    """Whose wire it is."""

    family: str
    "Anything but a built-in one speaks nothing that is known."
    facts: Mapping[str, Any] = field(default_factory=dict)
    "The model's `device` table."
    device: Mapping[str, Any] = field(default_factory=dict)
    "The scenario's."


def describe(speaker: Speaker, data: bytes, kind: str = "serial", peer: int = 0, sent: bool = True) -> list[Described]:
    """The fields of one payload, in the order of its bytes.

    Parameters
    ----------
    speaker : who speaks there.
    data : one payload as it was on the wire.
    kind : `serial`, `stream`, `datagram` or `can`; how the family frames it.
    peer : identifier of a CAN frame.
    sent : by the device; False: by a host.
    """
    if not data:
        return [Described("nothing", "", "no byte")]
    try:
        if speaker.family in BUILT_IN:
            found: list[Described] = found_at(BUILT_IN[speaker.family].fields)(speaker, data, kind, peer, sent)
        else:
            found = [unknown(data, "unknown protocol")]
    except (ValueError, IndexError, KeyError, OverflowError, OSError) as error:
        found = [unknown(data, f"cannot be read: {error}")]
    return found[:MOST_FIELDS]


def unknown(data: bytes, reason: str) -> Described:
    """Bytes as they are, and why no more is said."""
    return Described("bytes", data[:MOST_BYTES].hex(" ") + (" …" if len(data) > MOST_BYTES else ""), reason)


def row_of(values: Sequence[float] | np.ndarray[Any, Any], digits: int = 0) -> str:
    """The first of many numbers, and how many there are."""
    shown = " ".join(f"{value:.{digits}f}" for value in list(values[:FIRST]))
    return shown + (f" … ({len(values)})" if len(values) > FIRST else "")


# ---------------------------------------------------------------- SCIP


def _scip(data: bytes, sent: bool) -> list[Described]:
    if not sent:
        return [Described("command", repr(data)[2:-1])]
    found: list[Described] = []
    for reply in ReplyReader().feed(data):
        found += [Described("echo", repr(reply.echo)[2:-1]), Described("status", repr(reply.status)[2:-1])]
        lines = list(reply.lines)
        form = scip.MEASURES.get(reply.echo[:2])
        if form is not None and len(lines) > 1:
            found.append(Described("time stamp", str(decode_number(joined(lines[:1]))), "ms"))
            range_m, strength = decode_values(joined(lines[1:]), form)
            found.append(Described("distances", row_of(range_m[:, 0], 3), "m"))
            if form.intensity:
                found.append(Described("intensities", row_of(strength[:, 0])))
            lines = []
        found += [Described("line", repr(line)[2:-1]) for line in lines]
    return found or [unknown(data, "no whole reply")]


# ---------------------------------------------------------------- RPLIDAR


def _rplidar(data: bytes, sent: bool) -> list[Described]:
    if not sent:
        code = rplidar.COMMANDS.get(data[1:2]) if data[:1] == b"\xa5" else None
        return [unknown(data, "no request") if code is None else Described(code.name, data[3:-1].hex(" "))]
    if data[:2] == REPLY_SYNC and len(data) >= 7:
        return [Described("type", f"{data[6]:02X}"), Described("data", data[7:].hex(" "))]
    for form in FORMS.values():
        if form.kind == EXPRESS and any(data[8::5]):  # a dense capsule has the same size, and no offsets that are 0
            continue
        if form.kind not in (STANDARD, HQ) and len(data) == form.size and data[0] >> 4 == 0xA:
            angle = int.from_bytes(data[8:10] if form.kind == ULTRA_DENSE else data[2:4], "little")
            rows = np.frombuffer(data, np.uint8)[None]
            return [
                Described("start angle", f"{(angle & 0x7FFF) / 64.0:.3f}", "deg"),
                Described("distances", row_of(distances(form, rows, rows)[0]), "mm"),
            ]
    nodes = next(iter(Reader().feed_nodes(data)), None) if len(data) % 5 == 0 else None
    if nodes is None:
        return [unknown(data, "no reply")]
    return [Described("angles", row_of(nodes[0], 2), "deg"), Described("distances", row_of(nodes[1]), "mm")]


# ---------------------------------------------------------------- LMS2xx

LMS_REPLIES = {
    0x90: "power-on message",
    0x91: "reset, confirmed",
    0x92: "not acknowledged: command incorrect",
    0xA0: "mode, line speed: answer",
    0xB0: "measured values",
    0xB1: "status",
    0xB6: "means of several scans",
    0xB7: "values of a sub-range",
    0xBF: "means of a sub-range",
    0xBA: "type of the device",
    0xBB: "variant: answer",
    0xC4: "values and reflectivity",
    0xF4: "configuration",
    0xF5: "values and intensity",
    0xF7: "configuration: answer",
}
LMS_UNITS = {0: "cm", 1: "mm", 2: "dm"}
SUCCESS = {0: "done", 1: "refused: wrong password", 2: "refused: fault in the device"}


def _lms2xx(data: bytes, sent: bool) -> list[Described]:
    if sent and data in (b"\x06", b"\x15"):
        return [Described("acknowledge", f"{data[0]:02X}", "ACK" if data == b"\x06" else "NAK: not understood")]
    found: list[Described] = []
    while data:
        if data[0] != 2 or len(data) < 7:
            found.append(unknown(data, "no start of a telegram"))
            break
        size = 6 + int.from_bytes(data[2:4], "little")
        if len(data) < size:
            found.append(unknown(data, f"{len(data)} bytes; the length field says {size}"))
            break
        found += _lms_telegram(data[:size], sent)
        data = data[size:]
    return found


def _lms_telegram(whole: bytes, sent: bool) -> list[Described]:
    address, size = whole[1], int.from_bytes(whole[2:4], "little")
    found = [
        Described("start", f"{whole[0]:02X}", "STX"),
        Described("address", f"{address:02X}", "from the device" if address & 0x80 else "to the device"),
        Described("length", str(size), "bytes"),
    ]
    crc = int.from_bytes(whole[-2:], "little")
    telegram = open_frame(whole)
    if telegram is None:
        return [*found, unknown(whole[4:-2], "wrong checksum"), Described("CRC", f"{crc:04X}", "wrong")]
    found += _lms_reply(telegram) if sent else _lms_request(telegram)
    return [*found, Described("CRC", f"{crc:04X}", "right")]


def _lms_request(telegram: Telegram) -> list[Described]:
    code, data = telegram.command, telegram.data
    row = lms.COMMANDS.get(code)
    if code == 0x20 and data:
        mode = lms.SWITCHES.get(data[0])
        return [
            Described("command", f"20 {data[0]:02X}", mode.name if mode else "unknown mode"),
            *([Described("data", data[1:].hex(" "))] if data[1:] else []),
        ]
    found = [Described("command", f"{code:02X}", row.name if row else "unknown")]
    return [*found, *([Described("data", data[:MOST_BYTES].hex(" "))] if data else [])]


def _lms_reply(telegram: Telegram) -> list[Described]:
    code, data = telegram.command, telegram.data
    found = [Described("response", f"{code:02X}", LMS_REPLIES.get(code, "unknown"))]
    values = read_values(telegram)
    if values is not None:
        unit = LMS_UNITS.get(values.header.unit, "units")
        part = values.header.partial
        if values.scans > 1:
            found.append(Described("scans averaged", str(values.scans)))
        found += [
            Described("values", str(values.header.count)),
            Described("first beam", str(values.first)),
            Described("part", "whole scan" if part is None else f"x.{25 * part:02d}", "" if part is None else "deg"),
            Described("distances", row_of(values.values & 0x1FFF), f"{unit}, of 13 bits"),
        ]
        counts = values.values & 0x1FFF
        near = counts[counts < 0x1FF7]
        if len(near):
            scale = COUNTS_PER_METRE.get(values.header.unit, 100)
            nearest, farthest = near.min() / scale, near.max() / scale
            found.append(Described("nearest, farthest", f"{nearest:.2f}, {farthest:.2f}", "m"))
        found.append(Described("no distance", str(len(counts) - len(near)), "beams: too far, dazzled, fault"))
        if len(values.extra):
            found.append(Described("intensity", row_of(values.extra)))
        if values.indices is not None:
            found.append(Described("scan, telegram index", f"{values.indices[0]}, {values.indices[1]}"))
        return [*found, _lms_status(values.status)]
    body, status = data[:-1], data[-1] if data else 0
    if code == 0xA0 and body:
        found.append(Described("result", str(body[0]), SUCCESS.get(body[0], "")))
    elif code in (0x90, 0xBA):
        found.append(Described("text", body.decode("ascii", "replace").strip()))
    elif code == 0xB1 and len(body) >= 120:
        found += _lms_block(body)
    elif code == 0xBB and len(body) >= 5:
        field_deg, step = int.from_bytes(body[1:3], "little"), int.from_bytes(body[3:5], "little")
        found += [
            Described("result", str(body[0]), "set" if body[0] == 1 else "refused"),
            Described("field", str(field_deg), "deg"),
            Described("step", f"{step / 100:g}", "deg"),
        ]
    elif body:
        found.append(unknown(body, "no known field"))
    return [*found, _lms_status(status)] if data else found


def _lms_block(body: bytes) -> list[Described]:
    mode = MEASURING_MODES.get(body[101])
    return [
        Described("firmware", body[:7].decode("ascii", "replace").strip()),
        Described("operating mode", f"{body[7]:02X}"),
        Described("measuring mode", f"{body[101]:02X}", mode.name if mode else "unknown"),
        Described("field", str(int.from_bytes(body[106:108], "little")), "deg"),
        Described("step", f"{int.from_bytes(body[108:110], 'little') / 100:g}", "deg"),
        Described("address", f"{body[119]:02X}"),
        Described("unit", str(body[121]), LMS_UNITS.get(body[121], "")),
        unknown(body[8:101], "not decoded"),
    ]


def _lms_status(status: int) -> Described:
    level = ("no fault", "information", "warning", "fault", "fatal fault")[min(4, status & 7)]
    return Described("status", f"{status:02X}", level + (", window polluted" if status & 0x80 else ""))


# ---------------------------------------------------------------- LD


def _ld(data: bytes, kind: str, sent: bool) -> list[Described]:
    if kind == "serial":
        if data in (b"\x15", b"\x06"):
            return [Described("acknowledge", f"{data[0]:02X}", "NAK" if data == b"\x15" else "ACK")]
        found: list[Described] = []
        for package in PackageReader().feed(data):
            if not isinstance(package, Package):
                found.append(unknown(data, package.reason.value))
                continue
            number = int.from_bytes(package.body[:2], "big")
            found += [Described("address", f"{package.address:04X}", "to, from" if not sent else "from, to")]
            found.append(Described("package", f"{number:04X}", "the only one" if not number else "of several"))
            found += _ld_message(words_of(package.body[2:])) if not number else [unknown(package.body[2:], "a part")]
        return found or [unknown(data, "no whole package")]
    found = []
    for payload in UspReader(LD_LONGEST).feed(data):
        if isinstance(payload, bytes):
            found += [Described("start", data[:4].hex(" "), "STX USP"), Described("length", str(len(payload)), "bytes")]
            found += _ld_message(words_of(payload))
            found.append(Described("check", "right", "XOR"))
        else:
            found.append(unknown(data, payload.reason.value))
    return found or [unknown(data, "no whole frame")]


def _ld_message(words: Sequence[int]) -> list[Described]:
    if not words:
        return [Described("service", "none", "an empty message")]
    code = words[0]
    if code == SERVICE_FAILURE:
        return [Described("service", f"{code:04X}", "SERVICE_FAILURE"), *_ld_status(words[1:3])]
    row = LD_COMMANDS.get(code & ~REPLY_BIT)
    reported = (row.name if row else "unknown") + (", reply" if code & REPLY_BIT else "")
    found = [Described("service", f"{code:04X}", reported)]
    if code == 0x0301 | REPLY_BIT and len(words) > 2:
        return found + _ld_profile(words)
    if code == 0x0101 | REPLY_BIT and len(words) >= 7:
        text = b"".join(word.to_bytes(2, "big") for word in words[1:7]).partition(b"\0")[0]
        return [*found, Described("text", text.decode("ascii", "replace")), *_ld_status(words[7:9])]
    if code in (0x0102 | REPLY_BIT, 0x0402 | REPLY_BIT, 0x0403 | REPLY_BIT, 0x0404 | REPLY_BIT) and len(words) >= 3:
        rest = [Described("data", " ".join(f"{word:04X}" for word in words[3:]))] if words[3:] else []
        return [*found, *_ld_status(words[1:3]), *rest]
    if words[1:]:
        cut = " …" if len(words) > 33 else ""
        found.append(Described("data", " ".join(f"{word:04X}" for word in words[1:33]) + cut, "words"))
    return found


def _ld_status(words: Sequence[int]) -> list[Described]:
    if len(words) < 2:
        return []
    mode, motor = words[1] & 0xF, words[1] >> 4 & 0xF
    return [Described("sensor status", f"{words[1]:04X}", f"{_named(Mode, mode)}, motor {_named(Motor, motor)}")]


def _named(kind: type[IntEnum], code: int) -> str:
    try:
        return kind(code).name.lower().replace("_", " ")
    except ValueError:
        return f"code {code:X}"


def _ld_profile(words: Sequence[int]) -> list[Described]:
    form, sectors, at = words[1], words[2] & 0xFF, 3
    found = [Described("format", f"{form:04X}"), Described("sectors", str(sectors))]

    def take(kind: Field, name: str, unit: str = "", scale: float = 1.0) -> None:
        nonlocal at
        if form & kind:
            found.append(Described(name, f"{words[at] * scale:g}", unit))
            at += 1

    take(Field.PROFILESENT, "profiles sent")
    take(Field.PROFILECOUNT, "profile count")
    take(Field.LAYERNUM, "layer")
    kinds = [one for one in (Field.DISTANCE, Field.DIRECTION, Field.ECHO) if form & one]
    for _ in range(sectors):
        take(Field.SECTORNUM, "sector")
        take(Field.DIRSTEP, "step", "deg", DEGREES_PER_TICK)
        points = words[at] if form & Field.POINTNUM else 0
        take(Field.POINTNUM, "points")
        take(Field.TSTART, "first direction at", "ms")
        take(Field.STARTDIR, "first direction", "deg", DEGREES_PER_TICK)
        block = np.array(words[at : at + points * len(kinds)], np.float64)
        if len(block) < points * len(kinds):
            return [*found, Described("cut", f"{len(words)} words", "the format has more")]
        at += len(block)
        if points and kinds:
            columns = block.reshape(points, len(kinds))
            for place, one in enumerate(kinds):
                name, unit, scale = {
                    Field.DISTANCE: ("distances", "m", 1.0 / RANGE_LSB_PER_M),
                    Field.DIRECTION: ("directions", "deg", DEGREES_PER_TICK),
                    Field.ECHO: ("echoes", "amplitude", 1.0),
                }[one]
                found.append(Described(name, row_of(columns[:, place] * scale, 0 if one is Field.ECHO else 2), unit))
        take(Field.TEND, "last direction at", "ms")
        take(Field.ENDDIR, "last direction", "deg", DEGREES_PER_TICK)
    if form & Field.SENSTAT:
        found += _ld_status(words[at : at + 2])
        at += 2
    return [*found, *([Described("more", f"{len(words) - at} words", "beyond the format")] if len(words) > at else [])]


# ---------------------------------------------------------------- CAN


LEDDAR_DETECTIONS = {"leddar_vu8": "Detection", "leddar_m16": "Detections"}
"Format -> what comes on identifiers that count up: one for each detection of a list."


def _can(speaker: Speaker, data: bytes, peer: int) -> list[Described]:
    from protocols.can_objects.layout import load

    wanted = {**speaker.facts, **speaker.device}
    layout = load(f"{wanted.get('format')}.dbc")
    number = peer & 0x1FFFFFFF
    name = layout.name_of(number - _shift(wanted, layout.identifier)) or layout.name_of(number)
    if name is None and wanted.get("format") == "ars408":  # its sensor id may have been changed by a host
        name = next((one for k in range(8) if (one := layout.name_of(number - 0x10 * k))), None)
    if name is None and wanted.get("format") in LEDDAR_DETECTIONS:
        shifted = number - _shift(wanted, layout.identifier)
        name = LEDDAR_DETECTIONS[wanted["format"]] if 0x752 <= shifted < 0x752 + 96 else None
    head = [Described("identifier", f"{number:03X}", name or "no message of this format")]
    if name is None:
        return [*head, unknown(data, "not in the format's DBC")]
    found = [Described(one.name, one.value, one.unit) for one in layout.decoded_signals(name, data)]
    short = layout.length(name) - len(data)
    return head + found + ([Described("length", f"{len(data)}", f"{short} bytes short")] if short > 0 else [])


def _shift(table: Mapping[str, Any], identifier: Callable[[str], int]) -> int:
    if table.get("format") == "ars408":
        return 0x10 * int(table.get("sensor_id", 0))
    if table.get("format") == "ldmrs":
        return int(table.get("base_id", 0x500)) - identifier("ListHeader")
    if table.get("format") in LEDDAR_DETECTIONS:
        return int(table.get("tx_base_id", 0x750)) - 0x750
    return 0


# ---------------------------------------------------------------- one for each family, as the table of families has it


def lms2xx(speaker: Speaker, data: bytes, kind: str, peer: int, sent: bool) -> list[Described]:
    """Of an LMS2xx telegram."""
    return _lms2xx(data, sent)


def ld(speaker: Speaker, data: bytes, kind: str, peer: int, sent: bool) -> list[Described]:
    """Of a message of an LD."""
    return _ld(data, kind, sent)


def cola(speaker: Speaker, data: bytes, kind: str, peer: int, sent: bool) -> list[Described]:
    """Of CoLa telegrams."""
    return [Described(*row) for row in describe_cola.rows(data, row_of, unknown)]


def scip_reply(speaker: Speaker, data: bytes, kind: str, peer: int, sent: bool) -> list[Described]:
    """Of SCIP replies."""
    return _scip(data, sent)


def rplidar_reply(speaker: Speaker, data: bytes, kind: str, peer: int, sent: bool) -> list[Described]:
    """Of an RPLIDAR's replies and groups of samples."""
    return _rplidar(data, sent)


def can_objects(speaker: Speaker, data: bytes, kind: str, peer: int, sent: bool) -> list[Described]:
    """Of a CAN frame."""
    return _can(speaker, data, peer)
