"""What the page says in HTML and SVG: polar plot, state of links, telegrams field by field. Text in, text out."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from emulator.hosts.describe import Described
from emulator.output.sanitizing import html
from emulator.view.frames import Frame, ShownScan, ShownSensor, ShownTelegram
from emulator.view.points import colours_of
from protocols.scan import points_of

RINGS = 4
SIZE = 300.0
MONO = "font-family:ui-monospace,Consolas,monospace;font-size:11px"
MOST_HEX = 48
"Bytes of a telegram in hex before it is cut."


def nice_radius(range_m: float) -> float:
    """1, 2, 4 or 8 times a power of ten, not less than `range_m`: so that four rings are round numbers."""
    if not range_m > 0.0:
        return 8.0
    power = 10.0 ** math.floor(math.log10(range_m))
    return next(power * step for step in (1.0, 2.0, 4.0, 8.0, 10.0, 20.0) if power * step >= range_m * (1 - 1e-9))


def polar(scan: ShownScan | None, colouring: str, radius_m: float | None = None) -> str:
    """First and further echoes, and boxes of objects, seen from above, straight ahead up; as SVG."""
    half = SIZE / 2.0
    parts = [
        f'<svg viewBox="{-half:g} {-half:g} {SIZE:g} {SIZE:g}" width="100%" role="img" aria-label="polar plot"'
        ' style="background:#10151c;border-radius:6px;display:block;max-width:280px;margin:0 auto 4px">'
    ]
    found = None if scan is None else np.isfinite(scan.range_m)
    largest = 0.0 if scan is None or found is None or not found.any() else float(scan.range_m[found].max())
    if scan is not None:
        largest = max([largest, *(math.hypot(*item["position_m"][:2]) for item in scan.objects)])
    radius_m = radius_m or nice_radius(largest)
    scale = (half - 14.0) / radius_m
    for ring in range(1, RINGS + 1):
        far = radius_m * ring / RINGS
        parts.append(f'<circle r="{far * scale:.1f}" fill="none" stroke="#2c3846" stroke-width="0.6"/>')
        parts.append(f'<text x="2" y="{-far * scale + 8:.1f}" fill="#8193a8" font-size="8">{far:g} m</text>')
    for degrees in range(0, 180, 30):
        dx, dy = math.sin(math.radians(degrees)) * radius_m * scale, math.cos(math.radians(degrees)) * radius_m * scale
        parts.append(f'<path d="M{-dx:.1f} {dy:.1f}L{dx:.1f} {-dy:.1f}" stroke="#212b36" stroke-width="0.5"/>')
    if scan is not None and found is not None:
        beam, echo = np.nonzero(found)
        range_m = scan.range_m[beam, echo]
        begun = None if scan.origin_m is None else scan.origin_m[beam]
        ahead, left, _ = scale * points_of(scan.azimuth_rad[beam], scan.elevation_rad[beam], range_m, begun).T
        x, y = -left, -ahead
        colours = colours_of(colouring, range_m, scan.intensity[beam, echo], scan.actor[beam, echo])
        groups: dict[tuple[int, ...], list[str]] = {}
        for place, colour in enumerate((colours // 16 * 16).tolist()):  # few colours, few elements
            groups.setdefault(tuple(colour), []).append(f"M{x[place]:.1f} {y[place]:.1f}h0")
        for (red, green, blue), moves in groups.items():
            parts.append(
                f'<path d="{"".join(moves)}" stroke="rgb({red + 15},{green + 15},{blue + 15})" stroke-width="2.4"'
                ' stroke-linecap="round"/>'
            )
    for item in () if scan is None else scan.objects:
        parts.append(_box(item, scale))
    parts.append('<path d="M0 -5L3.5 4L-3.5 4Z" fill="#eceff1"/></svg>')
    return "".join(parts)


def _box(item: Mapping[str, Any], scale: float) -> str:
    """One object of a list from above, with its number."""
    (x, y), (length, width) = item["position_m"][:2], item["size_m"][:2]
    cos, sin = math.cos(item["yaw_rad"]), math.sin(item["yaw_rad"])
    corners = [(a * length / 2.0, b * width / 2.0) for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
    path = "L".join(
        f"{-(y + sin * a + cos * b) * scale:.1f} {-(x + cos * a - sin * b) * scale:.1f}" for a, b in corners
    )
    return (
        f'<path class="view-object" d="M{path}Z" fill="none" stroke="#ff4081" stroke-width="1.6"/>'
        f'<text x="{-y * scale + 5:.1f}" y="{-x * scale - 4:.1f}" fill="#ff80ab" font-size="9">'
        f"{int(item['track'])}</text>"
    )


def inset(text: str) -> str:
    """A text of the page, off the edge of its panel."""
    return f'<div style="padding:0 0.75em">{text}</div>' if text else ""


def state(
    frame: Frame,
    models: dict[str, str],
    points: dict[str, int],
    recorded: bool = False,
    lists: Collection[str] = (),
) -> str:
    """Time, and what each sensor does, as HTML; `lists`: sensors that tell objects, not points."""
    clock = "recording" if recorded else "virtual clock" if frame.virtual else "real clock"
    speed = "as fast as hosts read" if frame.speed is None else f"{frame.speed:g} x real time"
    what = "ended" if frame.ended or frame.stands else "paused" if frame.paused else "runs"
    rows = [
        f'<div style="font-size:13px;line-height:1.5"><b id="view-time" data-now="{frame.now_s:.3f}">'
        f"{frame.now_s:.2f} s</b> · {what} · {clock}, {speed}"
    ]
    if frame.ended:
        rows.append(f'<div style="color:#e57373">{html(frame.ended)}</div>')
    elif frame.stands:
        rows.append(f'<div style="color:#ffb74d">{html(frame.stands)}</div>')
    for name, sensor in frame.sensors.items():
        rows.append(_sensor(name, models.get(name, ""), sensor, points.get(name, 0), frame, recorded, name in lists))
    if frame.telegrams_missed:
        rows.append(f"<div>{frame.telegrams_missed} telegrams not shown: more than the page requests</div>")
    rows.append("</div>")
    return "".join(rows)


def _sensor(name: str, model: str, sensor: ShownSensor, points: int, frame: Frame, recorded: bool, lists: bool) -> str:
    rate = "no scans" if sensor.rate_hz is None else f"{sensor.rate_hz:.2f} scans/s"
    scan = frame.scans.get(name)
    what = f"<b>{len(scan.objects)}</b> objects" if lists and scan is not None else f"<b>{points}</b> points"
    parts = [f"{rate}, {sensor.scans_sent} sent, {what}"]
    if sensor.late_median_us is not None and sensor.late_worst_us is not None:
        parts.append(f"late {_us(sensor.late_median_us)} (worst {_us(sensor.late_worst_us)})")
    elif frame.virtual and not recorded:
        parts.append("lateness: only with a real clock")
    if scan is not None and scan.every > 1:
        parts.append(f"one of {scan.every} beams is shown")
    for word, counts in (("dropped", sensor.dropped), ("input dropped", sensor.input_dropped)):
        if counts:
            parts.append(f"{word}: " + ", ".join(f"{count} {html(reason)}" for reason, count in counts.items()))
    for link in sensor.links:
        dot, reported = {True: ("#66bb6a", "host"), False: ("#9e9e9e", "no host"), None: ("#90a4ae", "recorded")}[
            link.host
        ]
        lost = f", {link.bytes_lost} lost" if link.bytes_lost else ""
        parts.append(
            f'<span style="color:{dot}">●</span> '
            f'<span style="{MONO};word-break:break-all">{html(link.url)}</span><br>'
            f"{reported}, {_bytes(link.bytes_out)} out, {_bytes(link.bytes_in)} in{lost}"
        )
    body = "<br>".join(parts)
    return (
        f'<div class="view-sensor" data-sensor="{html(name)}" data-points="{points}" data-sent="{sensor.scans_sent}"'
        f' style="margin-top:6px;padding-left:8px;border-left:3px solid #607d8b">'
        f"<b>{html(name)}</b> <small>{html(model)}</small><br>{body}</div>"
    )


def _us(value: float) -> str:
    return f"{value:.0f} us" if value < 10_000 else f"{value * 1e-3:.1f} ms"


def _bytes(count: int) -> str:
    return (
        f"{count} B" if count < 10_000 else f"{count * 1e-3:.1f} kB" if count < 10_000_000 else f"{count * 1e-6:.1f} MB"
    )


def telegram_list(rows: Sequence[ShownTelegram], most: int = 6) -> str:
    """The last telegrams, newest first, one line each."""
    lines = []
    for row in reversed(rows[-most:]):
        way = "&rarr;" if row.sent else "&larr;"
        start = row.data[:7].hex(" ")
        more = " …" if len(row.data) > 7 else ""
        peer = f" {row.peer & 0x1FFFFFFF:X}" if row.peer else ""
        colour = "inherit" if row.sent else "#ffb74d"
        lines.append(
            f'<tr style="color:{colour}"><td>{row.at_s:.4f}</td><td>{way}{peer}</td><td>{html(row.label)}</td>'
            f"<td>{len(row.data) + row.cut}</td><td>{start}{more}</td></tr>"
        )
    head = "<tr><th>s</th><th></th><th></th><th>bytes</th><th>begins</th></tr>"
    style = f"{MONO};width:100%;text-align:left;white-space:nowrap;line-height:1.35"
    return f'<table title="&rarr; to the host, &larr; from the host" style="{style}">{head}{"".join(lines)}</table>'


def telegram_fields(row: ShownTelegram | None, fields: Sequence[Described]) -> str:
    """One telegram field by field."""
    if row is None:
        return "<i>nothing sent yet</i>"
    lines = "".join(
        f"<tr><td>{html(one.name)}</td><td>{html(one.value)}</td><td>{html(one.unit)}</td></tr>" for one in fields
    )
    reported = f"{row.at_s:.4f} s, {len(row.data) + row.cut} bytes {'to' if row.sent else 'from'} the host"
    dump = row.data[:MOST_HEX].hex(" ") + (" …" if len(row.data) > MOST_HEX else "")
    return (
        f'<div id="view-telegram" style="{MONO};line-height:1.35"><b>{reported}</b>'
        f'<table style="width:100%">{lines}</table>'
        f'<div style="word-break:break-all;opacity:.7;margin-top:4px">{dump}</div></div>'
    )


def notes(rows: Sequence[str]) -> str:
    """What happened last."""
    if not rows:
        return "<small>no events yet</small>"
    return f'<div style="{MONO}">' + "<br>".join(html(row) for row in reversed(rows)) + "</div>"
