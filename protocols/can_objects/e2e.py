"""AUTOSAR end-to-end protection of single messages, off unless a scenario asks for it.

Belongs here: where the check header lies and which library call writes it. The formats themselves have no such header;
it goes into bytes that the message leaves free, or behind its end where it is shorter than eight bytes. Messages that
fill all eight bytes have no room and are refused when the device is built.

    e2e:
      profile: p05                      # p01 | p02 | p05 | p06 | p11
      messages:
        ListTrailer: {data_id: 0x1234, offset_bytes: 4}
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

from protocols.can_objects.layout import Layout
from protocols.errors import DeviceSettingError
from protocols.skeleton.keys import DeviceKeys

HEADER_BYTES = {"p01": 2, "p02": 2, "p05": 3, "p06": 5, "p11": 2}
"""CRC-8 and counter; CRC-8 and counter; CRC-16 and counter; CRC-16, length and counter; CRC-8 and counter. Profiles 4
and 7 have headers of 12 and 20 bytes, longer than a classic frame."""

MODES = {"p01": ("both", "alternating", "low", "nibble"), "p11": ("both", "nibble")}
"How the data id enters the CRC of profiles 1 and 11."

COUNTS = {"p01": 15, "p02": 16, "p11": 15}
"How far the counter goes, where that is not a byte. It is the header's last byte, or the low half of it."
COUNTER_MASK = {"p01": 0x0F, "p02": 0x0F, "p11": 0x0F}

_MODE_NAMES = {"both": "BOTH", "alternating": "ALT", "low": "LOW", "nibble": "NIBBLE"}


@dataclass(frozen=True)
class _Entry:
    length: int
    "Bytes of the frame with its header."
    apply: Callable[[bytearray], None]
    "Counts on and writes the header in place."


class Protection:
    """Header of every protected message, with one counter a message."""

    def __init__(self, table: Mapping[str, Any], layout: Layout) -> None:
        keys = DeviceKeys(table, {}, prefix="e2e.")
        self._profile = keys.choice("profile", "AUTOSAR profile", "", tuple(HEADER_BYTES))
        messages = keys.table("messages", "message -> {data_id, offset_bytes}")
        mode = keys.choice(
            "data_id_mode", "how the data id enters the checksum", "both", MODES.get(self._profile, ("both",))
        )
        keys.finish()
        if not self._profile:
            raise DeviceSettingError("e2e.profile", None, " | ".join(HEADER_BYTES))
        if not messages:
            raise DeviceSettingError("e2e.messages", messages, "a table: message name -> {data_id, offset_bytes}")
        try:
            module = import_module(f"e2e.{self._profile}")
        except ImportError:
            raise DeviceSettingError("e2e.profile", self._profile, "the extra `e2e` to be installed") from None
        self._entries = {name: self._entry(name, entry, layout, module, mode) for name, entry in messages.items()}
        self._header: dict[str, bytes] = {}
        self._offsets = {name: _offset(messages[name]) for name in messages}

    def reset(self) -> None:
        """Counters as after power-on."""
        self._header.clear()

    def protect(self, name: str, payload: bytes) -> bytes:
        """The frame with its header; unprotected messages come back as they are."""
        entry = self._entries.get(name)
        if entry is None:
            return payload
        frame = bytearray(payload.ljust(entry.length, b"\0"))
        offset, width = self._offsets[name], HEADER_BYTES[self._profile]
        # the library counts on from what the last frame carried
        frame[offset : offset + width] = self._header.get(name, bytes(width))
        entry.apply(frame)
        self._header[name] = bytes(frame[offset : offset + width])
        return bytes(frame)

    # for faults on the wire

    def covers(self, name: str, payload: bytes) -> bool:
        """Whether that frame has a header: its message is protected, and it is whole."""
        entry = self._entries.get(name)
        return entry is not None and len(payload) >= entry.length

    def offset(self, name: str) -> int:
        """First byte of the header, which is the checksum's."""
        return self._offsets[name]

    def counter(self, name: str, payload: bytes) -> int:
        """What the header of a frame counts."""
        return payload[self._counter_at(name)] & COUNTER_MASK.get(self._profile, 0xFF)

    def counted(self, name: str, payload: bytes, header_of: bytes, change: int) -> bytes:
        """The frame with the counter of `header_of` and `change` more, and the checksum that belongs to it."""
        count = COUNTS.get(self._profile, 256)
        wanted = (self.counter(name, header_of) + change) % count
        frame = bytearray(payload)
        at, mask = self._counter_at(name), COUNTER_MASK.get(self._profile, 0xFF)
        # the library counts on from what the frame carries
        frame[at] = frame[at] & ~mask & 0xFF | (wanted - 1) % count
        self._entries[name].apply(frame)
        return bytes(frame)

    def _counter_at(self, name: str) -> int:
        return self._offsets[name] + HEADER_BYTES[self._profile] - 1

    def _entry(self, name: str, raw: Any, layout: Layout, module: Any, mode: str) -> _Entry:
        prefix = f"e2e.messages.{name}"
        if name not in layout.messages:
            raise DeviceSettingError(prefix, raw, f"one of {', '.join(layout.messages)}")
        if not isinstance(raw, Mapping):
            raise DeviceSettingError(prefix, raw, "a table {data_id, offset_bytes}")
        keys = DeviceKeys(raw, {}, prefix=prefix + ".")
        width = HEADER_BYTES[self._profile]
        offset = keys.integer("offset_bytes", "where the header begins", 0, 0, 8 - width)
        protect = getattr(module, f"e2e_{self._profile}_protect")
        apply: Callable[[bytearray], None]
        if self._profile == "p02":
            if offset:
                raise DeviceSettingError(prefix + ".offset_bytes", offset, "0: profile 2 has its header in front")
            apply = partial(
                protect, data_id_list=bytes(keys.integers("data_ids", "one for each counter", [0] * 16, 0, 255))
            )
        else:
            apply = partial(protect, data_id=keys.integer("data_id", "of this message", 0, 0, 0xFFFF), offset=offset)
            if self._profile in MODES:
                constant = f"E2E_{self._profile.upper()}_DATAID_{_MODE_NAMES[mode]}"
                apply = partial(apply, data_id_mode=getattr(module, constant))
        keys.finish()
        message = layout[name]
        taken = sorted(message.used_bytes.intersection(range(offset, offset + width)))
        if taken:
            free = sorted(set(range(8)) - message.used_bytes)
            room = f"free bytes are {free}" if free else "it has none"
            raise DeviceSettingError(prefix + ".offset_bytes", offset, f"{width} bytes that {name} leaves free; {room}")
        return _Entry(max(message.length, offset + width), apply)


def _offset(raw: Mapping[str, Any]) -> int:
    return int(raw.get("offset_bytes", 0))
