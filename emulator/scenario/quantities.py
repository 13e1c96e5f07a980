"""The names that expressions over a run may have, as `front.nearest_m`: what each means, and where it may stand.

`QUANTITIES` is the only list of them: it checks and is shown to users; `series.VALUES` computes each. Not here: the
language itself (expressions), values (series), the verdict (expectations).
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from emulator.config.expressions import ExpressionError, Name, evaluate, names, parse, truth
from emulator.faults.catalogue import kinds


@dataclass(frozen=True)
class Quantity:
    """One name behind `SENSOR.`."""

    help: str
    wants: str = ""
    "`actor`, `angle`, `box` or `fault` in parentheses."


QUANTITIES: Mapping[str, Quantity] = {
    "scans_per_s": Quantity("scans sent per second, from the first to the last; a silence at the end counts"),
    "scans_sent": Quantity("scans handed to the first link"),
    "scans_read": Quantity("scans that the built-in host decoded"),
    "scans_measured": Quantity("sweeps measured and accepted by the device"),
    "scans_dropped": Quantity("scans dropped; whole run"),
    "input_dropped": Quantity("input dropped; whole run"),
    "replies_sent": Quantity("replies; whole run"),
    "restarts": Quantity("power-ons and resets; whole run"),
    "faults": Quantity("hits of the faults of that name; whole run", "fault"),
    "bytes_out": Quantity("bytes sent; whole run"),
    "bytes_in": Quantity("bytes received; whole run"),
    "lateness_us": Quantity(
        "series: actual minus scheduled time of each send; under a virtual clock only the grouping of bytes"
    ),
    "gap_s": Quantity("series: time from scan to scan, and a silence at the end; its maximum is the recovery time"),
    "silent_s": Quantity("time without a scan at the end although a host waits for scans; 0: not silent"),
    "first_scan_s": Quantity("when the first scan left"),
    "points": Quantity("series: beams with an echo"),
    "points_on": Quantity("series: beams whose first echo is that actor's", "actor"),
    "points_in": Quantity("series: beams whose first echo is in that box", "box"),
    "layers_on": Quantity("series: layers of which a first echo is that actor's", "actor"),
    "coverage": Quantity("series: share of the beams with an echo"),
    "dazzled": Quantity("series: beams blinded by light from outside"),
    "nearest_m": Quantity("series: shortest range"),
    "nearest_on": Quantity("series: shortest range to that actor [m]", "actor"),
    "nearest_in": Quantity("series: shortest range in that box [m]", "box"),
    "turns_per_s": Quantity("whole turns measured per second, of sensors that measure in slices; else sweeps"),
    "clock_error_s": Quantity("series: device time in its telegrams, unwrapped, minus run time"),
    "clock_ticks": Quantity("series: the same time in ticks, as on the wire"),
    "objects": Quantity("series: objects in the list"),
    "object": Quantity("series: objects that are that actor", "actor"),
    "object_range_m": Quantity(
        "series: distance of the object that is that actor; missing in lists without it", "actor"
    ),
    "object_speed_m_s": Quantity("series: its speed against the sensor", "actor"),
    "object_existence": Quantity("series: its probability of existence", "actor"),
    "object_coasting_s": Quantity("series: time since its last echo", "actor"),
    "object_from_s": Quantity("instant of the first list that has that actor", "actor"),
    "object_until_s": Quantity("instant of the last list that has that actor", "actor"),
    "visible_share": Quantity("series: share of the beams towards that actor that reach it, beside a list", "actor"),
    "visible_until_s": Quantity("instant of the last list for which a beam saw that actor", "actor"),
    "object_precision": Quantity("share of the listed objects that are real"),
    "object_recall": Quantity("share of the visible actors that are listed"),
    "object_position_error_m": Quantity("root mean square, of matched objects"),
    "object_size_error_m": Quantity("mean of length and width, of matched objects"),
    "object_speed_error_m_s": Quantity("root mean square, of matched objects"),
    "range_at": Quantity("series: range that the host read nearest to that azimuth [deg]", "angle"),
    "range_error_m": Quantity("series: largest difference between the ranges that the host read and those measured"),
}

LIVE = (
    "points",
    "points_on",
    "points_in",
    "layers_on",
    "coverage",
    "dazzled",
    "nearest_m",
    "nearest_on",
    "nearest_in",
    "objects",
    "object",
    "object_range_m",
    "object_speed_m_s",
    "object_existence",
    "object_coasting_s",
    "visible_share",
    "scans_dropped",
    "input_dropped",
    "replies_sent",
    "restarts",
    "faults",
)
"Quantities with a value for one scan, and counters of the run so far."


BOX_FORM = 'a box in the sensor\'s frame, x, y and z from:to in metres, as "2:10, -1:1, -1.5:" (an end left out: none)'
Box = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


def box_of(text: str) -> Box:
    """Least and greatest x, y and z of a box. [m] `ValueError` for a text that is none."""
    axes = []
    for part in text.split(","):
        low, high = part.split(":")
        ends = float(low) if low.strip() else -math.inf, float(high) if high.strip() else math.inf
        if not ends[0] < ends[1]:  # NaN too
            raise ValueError(part)
        axes.append(ends)
    x, y, z = axes
    return x, y, z


def check_name(name: Name, sensors: Sequence[str], actors: Sequence[str]) -> None:
    """`ExpressionError` for a name that means nothing in this scenario."""
    if name.parts == ("duration_s",) and name.argument is None:
        return
    if len(name.parts) != 2:
        near = _one_of(name.parts[0], sensors)
        raise ExpressionError(f"{name}; want SENSOR.QUANTITY or duration_s, SENSOR being {near}")
    sensor, quantity = name.parts
    if sensor not in sensors:
        raise ExpressionError(f"sensor {sensor!r}; want {_one_of(sensor, sensors)}")
    known = QUANTITIES.get(quantity)
    if known is None:
        raise ExpressionError(f"{sensor}.{quantity}; want {_one_of(quantity, tuple(QUANTITIES))}")
    if known.wants == "actor" and name.argument not in actors:
        raise ExpressionError(f"{name}: actor {name.argument!r}; want {_one_of(str(name.argument), actors)}")
    if known.wants == "fault":
        if name.argument not in kinds():
            raise ExpressionError(
                f"{name}: fault {name.argument!r}; want {_one_of(str(name.argument), tuple(kinds()))}"
            )
    if known.wants == "angle" and not isinstance(name.argument, float):
        raise ExpressionError(f"{name}: {name.argument!r}; want an azimuth in degrees, as {quantity}(0)")
    if known.wants == "box":
        try:
            box_of(str(name.argument))
        except ValueError:
            raise ExpressionError(f"{name}: {name.argument!r}; want {BOX_FORM}") from None
    if not known.wants and name.argument is not None:
        raise ExpressionError(f"{name}: {quantity} takes nothing in parentheses")


def _one_of(found: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(found, known, n=1)
    return (f"{near[0]} or another of " if near else "one of ") + (", ".join(known) or "none: the list is empty")


def check_expression(text: str, sensors: Sequence[str], actors: Sequence[str]) -> None:
    """`ExpressionError` for a `when` that means nothing in this scenario."""
    tree = parse(text)
    found = list(names(tree))
    for name in found:
        check_name(name, sensors, actors)
        if name.parts[-1] not in LIVE:
            raise ExpressionError(f"{name}: known only at the end of a run; want one of {', '.join(LIVE)}")
    if not found:
        raise ExpressionError("no sensor named; want something like front.nearest_m < 10")
    truth(evaluate(tree, lambda name: np.zeros(1)))
