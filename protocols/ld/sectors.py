"""Sectors of a revolution: their table, where each begins and ends, and which combinations the device measures.

Directions are encoder ticks of 1/16 degree, growing clockwise seen from above, as on the wire.
Sources: sicktoolbox `SickLD.cc` (geometry, limits), Stanford `ldlrs`, Fawkes, Miro.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

TICKS = 5760
"Encoder ticks of a revolution."

TABLE_SIZE = 8
MAX_MEASURING = 4
MAX_PULSE_HZ = 14400
MAX_MEAN_PULSE_HZ = 10800
MIN_MOTOR_HZ, MAX_MOTOR_HZ = 5, 20


class Function(IntEnum):
    """What the device does in a sector."""

    NOT_INITIALISED = 0
    "This sector and all higher ones do not exist."
    NO_MEASUREMENT = 1
    NORMAL = 3
    REFERENCE = 4
    "Reported like a normal sector: no source has a difference on the wire."


MEASURING = (Function.NORMAL, Function.REFERENCE)


class MeasureError(IntEnum):
    """Error word of TRANS_MEASURE."""

    OK = 0
    MAX_PULSE = 1
    MEAN_PULSE = 2
    BORDERS = 3
    NOT_MULTIPLE = 4


@dataclass(frozen=True)
class Sector:
    """One entry of the table; a sector is given by its stop alone."""

    function: Function = Function.NOT_INITIALISED
    stop: int = 0


Table = tuple[Sector, ...]
EMPTY: Table = (Sector(),) * TABLE_SIZE


@dataclass(frozen=True)
class Span:
    """A sector with its place in the revolution; both borders are directions that are measured."""

    number: int
    function: Function
    start: int
    stop: int
    offset: int
    "Ticks from the beginning of the revolution to `start`."
    length: int
    "Ticks from `start` to `stop`."
    points: int
    "0 in a sector that does not measure."


def with_sector(table: Table, number: int, sector: Sector) -> Table:
    """The table after SET_FUNCTION; function 0 clears the higher sectors, and the stop given with it is kept."""
    if sector.function is Function.NOT_INITIALISED:
        return (*table[:number], sector, *EMPTY[number + 1 :])
    return (*table[:number], sector, *table[number + 1 :])


def initialised(table: Table) -> Table:
    """The sectors that exist: those before the first that is not initialised."""
    for number, sector in enumerate(table):
        if sector.function is Function.NOT_INITIALISED:
            return table[:number]
    return table


def is_step(step: int) -> bool:
    """Whether the device takes an angle step: a divisor of the revolution, above one tick."""
    return step > 1 and TICKS % step == 0


def check(table: Table, hz: int, step: int) -> MeasureError:
    """The error of TRANS_MEASURE for a speed, a step and a table."""
    if TICKS * hz > MAX_PULSE_HZ * step:
        return MeasureError.MAX_PULSE
    sectors = initialised(table)
    widths = _widths(sectors)
    active = [sector.function in MEASURING for sector in sectors]
    if not 1 <= sum(active) <= MAX_MEASURING or sum(widths) != TICKS or min(widths) < step:
        return MeasureError.BORDERS
    for sector, width, measures in zip(sectors, widths, active, strict=True):
        if measures and (sector.stop % step or width % step):
            return MeasureError.NOT_MULTIPLE
    arcs = sum(width - step for width, measures in zip(widths, active, strict=True) if measures)
    return MeasureError.MEAN_PULSE if hz * arcs > MAX_MEAN_PULSE_HZ * step else MeasureError.OK


def spans(table: Table, step: int) -> tuple[Span, ...]:
    """All initialised sectors of a table that `check` has passed, in order from the beginning of the revolution."""
    sectors = initialised(table)
    found = []
    offset = 0
    for number, (sector, width) in enumerate(zip(sectors, _widths(sectors), strict=True)):
        start = (sector.stop - width + step) % TICKS
        points = width // step if sector.function in MEASURING else 0
        found.append(Span(number, sector.function, start, sector.stop, offset, width - step, points))
        offset += width
    return tuple(found)


def _widths(sectors: Table) -> list[int]:
    """Ticks from each stop back to the one before it (the first: to the last); a stop met twice has none."""
    if len(sectors) == 1:
        return [TICKS]
    return [(sector.stop - sectors[number - 1].stop) % TICKS for number, sector in enumerate(sectors)]


def table_of(sectors: Sequence[Sector]) -> Table:
    """A full table from its leading sectors."""
    return (*sectors, *EMPTY[len(sectors) :])


def table_of_arcs(arcs: Sequence[tuple[int, int]], step: int) -> Table:
    """The table that sicktoolbox writes for measured arcs in ascending order; `ValueError` when they do not fit in.

    Each gap between arcs becomes a sector without measurement that ends one step before the next arc.
    """
    sectors = []
    for index, (_, stop) in enumerate(arcs):
        sectors.append(Sector(Function.NORMAL, stop % TICKS))
        gap_end = (arcs[(index + 1) % len(arcs)][0] - step) % TICKS
        if gap_end != stop % TICKS:
            sectors.append(Sector(Function.NO_MEASUREMENT, gap_end))
    if len(sectors) > TABLE_SIZE:
        raise ValueError(f"{len(sectors)} sectors with the gaps between them; the table has {TABLE_SIZE}")
    return table_of(sectors)
