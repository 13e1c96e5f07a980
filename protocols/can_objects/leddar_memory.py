"""The memory of a Vu8 that hosts read and write by address: banks open to the public, byte by byte.

Belongs here: addresses. Not: limits of what is written (leddar_holding), requests (leddar_vu8).
Source: LeddarTech user guide 54A0028, section 5.1.3, and the maker's `registerMap.h` (bank addresses, structures).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from typing import Protocol

from protocols.can_objects.leddar_holding import VU8_SEGMENTS, Holding

CONFIGURATION, PRODUCT_CONFIGURATION, INFORMATION, PRODUCT_INFORMATION = 0x000000, 0x200000, 0x400000, 0x440000
STATUS, PRODUCT_STATUS, DETECTIONS, TRANSACTION = 0x480000, 0x4C0000, 0x500000, 0xFFFB00
NAME_BYTES, CONFIGURATION_BYTES, INFORMATION_BYTES, STATUS_BYTES = 32, 0x52, 0x189, 79
RAW_PER_COUNT_64 = 8192
"Amplitudes and the threshold in memory: 2^19 a count, those of a CAN frame 2^6."
DISTANCE_SCALE = 1 << 16
TEMPERATURE_BITS, TEMPERATURE_C = 16, 30
MOST_ECHOES = 6 * VU8_SEGMENTS
INVALID_ADDRESS, WRITE_IS_DISABLED, FAILED, BAD_PACKET = 1 << 1, 1 << 3, 1 << 5, 1 << 6
"Bits of the status word of the last transaction."

NUMBERS: tuple[tuple[int, str, str], ...] = (
    (0x20, "B", "accumulation_exp"),
    (0x21, "B", "oversampling_exp"),
    (0x22, "B", "base_points"),
    (0x23, "<I", "segments_off"),
    (0x43, "b", "smoothing"),
    (0x47, "<i", "threshold"),
    (0x4B, "B", "light_power"),
    (0x4D, "<H", "auto_frames"),
    (0x4F, "B", "auto_echoes"),
)
"Configuration data: offset, form, name in the holding data."
OPTION_BITS: tuple[tuple[int, int, int], ...] = (
    (CONFIGURATION, 0x4C, 0),
    (CONFIGURATION, 0x50, 1),
    (CONFIGURATION, 0x51, 2),
    (CONFIGURATION, 0x44, 3),
    (CONFIGURATION, 0x45, 4),
    (CONFIGURATION, 0x46, 5),
    (PRODUCT_CONFIGURATION, 0x01, 7),
    (PRODUCT_CONFIGURATION, 0x00, 8),
)
"Bank, offset of a byte that is 0 or 1, bit of the acquisition options."
FREE = range(0x27, 0x43)
"Rate of the reference pulse and the pose, floats: kept as they are written."


class Facts(Protocol):
    """Facts of the module from the scenario that its memory has."""

    @property
    def serial_number(self) -> str: ...
    @property
    def device_name(self) -> str: ...
    @property
    def hardware_part(self) -> str: ...
    @property
    def software_part(self) -> str: ...
    @property
    def fpga(self) -> int: ...
    @property
    def firmware(self) -> tuple[int, ...]: ...
    @property
    def bootloader(self) -> tuple[int, ...]: ...


class Memory:
    """Banks made of the values in force; what is written comes back as values to be checked."""

    def __init__(self, holding: Holding, facts: Facts) -> None:
        self._holding = holding
        self._facts = facts
        self._information = _information(facts)
        self.clear()
        self.reset()

    def clear(self) -> None:
        """As after power-on: no list, no transaction."""
        self._detections = bytes(12 + 12 * MOST_ECHOES)
        self._outcome = 0

    def reset(self) -> None:
        """Default configuration."""
        self.device_name = self._facts.device_name.encode("ascii").ljust(NAME_BYTES, b"\0")
        self._free = bytes(len(FREE))

    def listed(self, rows: Iterable[tuple[int, int, float]], ticks: int, power: int) -> None:
        """A list was made: segment, distance in the unit set, amplitude in counts."""
        scale = DISTANCE_SCALE / self._holding["units_per_m"]
        packed = b"".join(
            struct.pack("<IIHH", round(far * scale), min(round(high * 64 * RAW_PER_COUNT_64), 0xFFFFFFFF), segment, 1)
            for segment, far, high in rows
        )
        options = self._holding["acquisition_options"]
        head = struct.pack("<IHHI", ticks, len(packed) // 12, power, options)
        self._detections = (head + packed).ljust(12 + 12 * MOST_ECHOES, b"\0")

    def read(self, address: int, size: int) -> bytes | str:
        """1, 2 or 4 bytes; a text says why not."""
        if size not in (1, 2, 4):
            return self._refuse(BAD_PACKET, f"{size} bytes; want 1, 2 or 4")
        place = self._place(address, size)
        if place is None:
            return self._refuse(INVALID_ADDRESS, f"address {address:#x} is in no bank")
        image, offset = place[1], place[2]
        found = image[offset : offset + size]
        self._outcome = 0
        return found

    def write(self, address: int, size: int, data: bytes, enabled: bool) -> dict[str, int] | str:
        """Values that the bytes ask for, checked; a text says why not."""
        if size not in (1, 2, 4):
            return self._refuse(BAD_PACKET, f"{size} bytes; want 1, 2 or 4")
        place = self._place(address, size)
        if place is None:
            return self._refuse(INVALID_ADDRESS, f"address {address:#x} is in no bank")
        bank, image, offset = place
        if bank not in (CONFIGURATION, PRODUCT_CONFIGURATION):
            return self._refuse(1, f"address {address:#x} can only be read")
        if not enabled:
            return self._refuse(WRITE_IS_DISABLED, "writing is not enabled")
        fresh = image[:offset] + data[:size] + image[offset + size :]
        asked = self._asked(bank, image, fresh)
        if isinstance(asked, str):
            return self._refuse(FAILED, asked)
        if bank == CONFIGURATION:
            self.device_name = fresh[:NAME_BYTES]
            self._free = fresh[FREE.start : FREE.stop]
        self._outcome = 0
        return asked

    def _refuse(self, outcome: int, why: str) -> str:
        self._outcome = outcome
        return why

    def _asked(self, bank: int, before: bytes, fresh: bytes) -> dict[str, int] | str:
        """Values whose bytes differ, checked."""
        numbers: dict[str, int] = {}
        for offset, form, name in NUMBERS if bank == CONFIGURATION else ():
            (number,) = struct.unpack_from(form, fresh, offset)
            if number != struct.unpack_from(form, before, offset)[0]:
                numbers[name] = number // RAW_PER_COUNT_64 if name == "threshold" else number
        options = self._holding["acquisition_options"]
        for of_bank, offset, bit in OPTION_BITS:
            if of_bank == bank:
                if fresh[offset] > 1:
                    return f"option at {offset:#x}: {fresh[offset]}; want 0 or 1"
                options = options & ~(1 << bit) | fresh[offset] << bit
        if options != self._holding["acquisition_options"]:
            numbers["acquisition_options"] = options
        return self._holding.checked(numbers)

    def _place(self, address: int, size: int) -> tuple[int, bytes, int] | None:
        """Bank, its bytes, and where in it."""
        images: Mapping[int, bytes] = self._images()
        for bank, image in images.items():
            if bank <= address and address + size <= bank + len(image):
                return bank, image, address - bank
        return None

    def _images(self) -> dict[int, bytes]:
        values, options = self._holding, self._holding["acquisition_options"]
        configuration, product = bytearray(CONFIGURATION_BYTES), bytearray(2)
        configuration[:NAME_BYTES] = self.device_name
        configuration[FREE.start : FREE.stop] = self._free
        for offset, form, name in NUMBERS:
            number = values[name] * RAW_PER_COUNT_64 if name == "threshold" else values[name]
            struct.pack_into(form, configuration, offset, number)
        for bank, offset, bit in OPTION_BITS:
            (configuration if bank == CONFIGURATION else product)[offset] = options >> bit & 1
        return {
            CONFIGURATION: bytes(configuration),
            PRODUCT_CONFIGURATION: bytes(product),
            INFORMATION: self._information,
            PRODUCT_INFORMATION: bytes((TEMPERATURE_BITS,)),
            STATUS: b"\1".ljust(STATUS_BYTES, b"\0"),  # detections are ready
            PRODUCT_STATUS: struct.pack("<I", TEMPERATURE_C << TEMPERATURE_BITS),
            DETECTIONS: self._detections,
            # secure transactions, free run, check of the last transaction, how it went, detections decide
            TRANSACTION: struct.pack("<BBHHB", 1, 0, 0, self._outcome, 1),
        }


def _information(facts: Facts) -> bytes:
    """Device information and constants: ten texts, then numbers (user guide, tables 19 and 20)."""
    versions = [".".join(map(str, version)) for version in (facts.firmware, facts.bootloader)]
    texts = (
        facts.hardware_part,
        facts.software_part,
        facts.serial_number,
        "LeddarTech",
        "",
        "",
        *versions,
        "",
        str(facts.fpga),
    )
    image = bytearray(INFORMATION_BYTES)
    for k, text in enumerate(texts):
        image[32 * k : 32 * k + 32] = text.encode("ascii")[:32].ljust(32, b"\0")
    # type, internal; accumulations, oversamplings, base points from and to; segments: vertical, horizontal, reference
    struct.pack_into("<HI6BHHH", image, 0x140, 13, 0, 0, 10, 0, 5, 2, 128, 1, VU8_SEGMENTS, 1)
    struct.pack_into("<I", image, 0x156, 1 << VU8_SEGMENTS)
    image[0x161] = MOST_ECHOES // VU8_SEGMENTS
    struct.pack_into("<IBI", image, 0x162, DISTANCE_SCALE, 6, 64)
    struct.pack_into("<hh", image, 0x16B, -16, 16)
    struct.pack_into("<ii", image, 0x16F, -5 << 19, 100 << 19)
    struct.pack_into("<BHHBBBB", image, 0x177, 5, 1, 8192, 6, 100, 0, 8)
    struct.pack_into("<I", image, 0x185, 1 << TEMPERATURE_BITS)
    return bytes(image)
