"""CoLa telegrams field by field, for `describe`: names and layouts are the protocol's own tables.

Belongs here: what a person is shown. Not: layouts (protocols.cola). Raises ValueError for what cannot be read.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from protocols.cola.commands import METHODS, VARIABLES
from protocols.cola.layouts import LAYOUT
from protocols.skeleton.cola_frames import ColaSplitter
from protocols.skeleton.cola_values import ASCII, Code, Rejected, decode
from protocols.skeleton.receiving import Fault

Row = tuple[str, str, str]
"Name, value, unit or remark."

LONGEST = 1 << 19
HEADS = {
    "sRN": "read", "sRA": "value", "sWN": "write", "sWA": "written", "sMN": "call", "sAN": "result",
    "sEN": "subscribe", "sEA": "subscribed", "sSN": "event", "sRI": "read by index", "sFA": "refused",
}  # fmt: skip
SCAN_HEAD = (
    "version", "device", "serial number", "", "status", "telegram counter", "scan counter", "time of the scan",
    "time of transmission", "", "inputs", "", "outputs", "layer", "scan frequency", "measuring frequency",
)  # fmt: skip
UNITS = {"time of the scan": "us", "time of transmission": "us", "layer": "1/100 deg", "scan frequency": "1/100 Hz",
         "measuring frequency": "100 Hz"}  # fmt: skip


def rows(data: bytes, row_of: Callable[[Any], str], unread: Callable[[bytes, str], Row]) -> list[Row]:
    """The fields of every telegram in one payload."""
    splitter, found = ColaSplitter(LONGEST), []
    at = 0
    for item in splitter.feed(data):
        if isinstance(item, Fault):
            found.append(unread(data[at : at + item.count], item.reason.value))
            at += item.count
            continue
        at += len(item) - 1 + (2 if item[:1] == ASCII else 9)
        found += _telegram(item[:1], item[1:], row_of, unread)
    if splitter:
        found.append(unread(data[at:], "no whole telegram"))
    return found


def _telegram(
    dialect: bytes, payload: bytes, row_of: Callable[[Any], str], unread: Callable[[bytes, str], Row]
) -> list[Row]:
    head = payload[:3].decode("ascii", "replace")
    found: list[Row] = [("dialect", "CoLa-" + dialect.decode(), ""), ("type", head, HEADS.get(head, "unknown"))]
    rest = payload[3:].removeprefix(b" ")
    if head == "sFA":
        code = int(rest, 16) if dialect == ASCII else int.from_bytes(rest, "big")
        name = Code(code).name.lower().replace("_", " ") if code in list(Code) else "unknown"
        return [*found, ("error", f"{code:X}", name)]
    raw, _, data = rest.partition(b" ")
    name = raw.decode("ascii", "replace")
    found.append(("name", name, ""))
    try:
        if name == "LMDscandata" and head in ("sSN", "sRA"):
            return found + _scan(decode(LAYOUT, dialect, data), row_of)
        text = _layout(head, name)
        if text is not None and data:
            return [*found, ("values", " ".join(str(one) for one in decode(text, dialect, data)), "")]
    except Rejected as rejected:
        return [*found, unread(data, f"cannot be read: {rejected}")]
    return [*found, unread(data, "no known layout")] if data else found


def _layout(head: str, name: str) -> str | None:
    if head in ("sEN", "sEA"):
        return "u8"
    if name in METHODS:
        return METHODS[name].arguments if head == "sMN" else METHODS[name].result
    known = VARIABLES.get(name)
    return known.layout if known is not None and isinstance(known.layout, str) else None


def _scan(values: list[Any], row_of: Callable[[Any], str]) -> list[Row]:
    found = [(name, str(value), UNITS.get(name, "")) for name, value in zip(SCAN_HEAD, values, strict=False) if name]
    for name, scale, offset, start, step, words in [*values[17], *values[18]]:
        found.append((f"{name} from", f"{start / 1e4:g}, step {step / 1e4:g}", "deg"))
        found.append((name, row_of(words), f"times {scale:g}, {offset:+g}"))
    found += [(kind, str(one[0]), "") for kind, part in (("name", 20), ("comment", 21)) for one in values[part]]
    found += [("date", "-".join(map(str, one[:3])) + " " + ":".join(map(str, one[3:6])), "") for one in values[22]]
    return found
