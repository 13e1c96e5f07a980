"""The configuration blocks of SET_CONFIG and GET_CONFIG: their words, what each may be, and what the factory sets.

Sources: the maker's listing 8011576 (p. 19-21), sicktoolbox `SickLD.cc` (0005, 0010), COMTEST (0001, 0002, 0005, 0010),
Fawkes (lengths), `sickld.c`, a port of sicktoolbox to C (0011).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from protocols.ld.sectors import MAX_MOTOR_HZ, MIN_MOTOR_HZ, is_step

SERIAL, CAN, ARCNET, ETHERNET, GLOBAL, INTERLACE = 0x0001, 0x0002, 0x0004, 0x0005, 0x0010, 0x0011

Config = Mapping[int, tuple[int, ...]]
"Item -> its words. Replaced as a whole; kept over power-off."

BAUD_CODES = {1: 4800, 2: 9600, 3: 19200, 4: 38400, 5: 57600, 6: 115200}
PARITY_CODES = {0: "none", 1: "even", 2: "odd"}
CAN_RATE_CODES = {0: 10, 1: 20, 2: 50, 3: 125, 4: 250, 5: 500, 6: 1000}
"kbit/s"

MAX_CAN_ID = 0x7FF
NO_BROADCAST = 0xFFFF
BROADCASTS = frozenset((*range(MAX_CAN_ID + 1), NO_BROADCAST))


@dataclass(frozen=True)
class Item:
    """One configuration block."""

    name: str
    words: int
    allows: Callable[[tuple[int, ...]], bool]
    "Whether words of the right number are taken."


def _serial(words: tuple[int, ...]) -> bool:
    baud, parity, stop_bits, data_bits = words
    return baud in BAUD_CODES and parity in PARITY_CODES and stop_bits in (1, 2) and 1 <= data_bits <= 8


def _can(words: tuple[int, ...]) -> bool:
    rate, *identifiers, broadcast = words
    return rate in CAN_RATE_CODES and max(identifiers) <= MAX_CAN_ID and broadcast in BROADCASTS


def _ethernet(words: tuple[int, ...]) -> bool:
    return max(words[:12]) <= 255


def _global(words: tuple[int, ...]) -> bool:
    sensor_id, hz, step = words
    return 1 <= sensor_id <= 254 and MIN_MOTOR_HZ <= hz <= MAX_MOTOR_HZ and is_step(step)


ITEMS = {
    SERIAL: Item("RS-232/RS-422", 4, _serial),
    CAN: Item("CAN", 5, _can),
    ARCNET: Item("ARCNET", 2, lambda words: True),
    ETHERNET: Item("Ethernet", 14, _ethernet),
    GLOBAL: Item("global", 3, _global),
    INTERLACE: Item("interlace mode", 1, lambda words: words[0] in (0, 1)),
}
"0000 (historic ARCNET) and 0003 (SPI) have no known words: refused."

FACTORY: Config = {
    SERIAL: (6, 0, 1, 8),
    # Example of the listing (p. 53-55): identifier 2AB is host 3, the sensor's 710
    CAN: (6, 0x2A8, 0x003, 0x700, NO_BROADCAST),
    ARCNET: (0, 0),
    # 192.168.1.10, 255.255.255.0, no gateway, node 1, transparent port 49152
    ETHERNET: (192, 168, 1, 10, 255, 255, 255, 0, 0, 0, 0, 0, 1, 49152),
    # sensor 16, 10 Hz, 0.5 degrees: a full circle at the default speed that all pulse limits allow
    GLOBAL: (16, 10, 8),
    INTERLACE: (0,),
}
