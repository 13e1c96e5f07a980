"""Weather as the page's sliders have it, and in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from emulator.output.sanitizing import html

CLEAR_M, THICK_M = 10_000.0, 10.0
FOG_MARKS = ((0, "clear"), (33, "1 km"), (67, "100 m"), (100, "10 m"))
"Share of the slider and its visibility, three decades in all."


def fog_visibility_m(share: float) -> float:
    """Visibility of the fog slider, 0 clear to 100 thick; three figures."""
    visibility = CLEAR_M * (THICK_M / CLEAR_M) ** (share / 100.0)
    return float(f"{visibility:.3g}")


def fog_share(visibility_m: float | None) -> int:
    """Place of the slider for a visibility; 0 without fog."""
    if not visibility_m:
        return 0
    share = 100.0 * math.log(visibility_m / CLEAR_M) / math.log(THICK_M / CLEAR_M)
    return round(min(100.0, max(0.0, share)))


def told(weather: Mapping[str, Any]) -> str:
    """What holds, in a line of HTML."""
    parts = []
    if weather.get("visibility_m"):
        parts.append(f"visibility {weather['visibility_m']:g} m")
    for name in ("fog", "dust", "smoke"):
        table = weather.get(name)
        if table:
            seen = table.get("visibility_m") or table.get("mor_m")
            parts.append(f"{name} {seen:g} m" if seen else name)
    for name in ("rain", "snow"):
        table = weather.get(name)
        if table:
            parts.append(f"{name} {table.get('rate_mm_h', 0.0):g} mm/h")
    sun = weather.get("sun")
    if sun:
        parts.append(f"sun {sun.get('elevation_deg', 45.0):g} deg high")
    parts += [name for name in ("spray", "layers", "plumes") if weather.get(name)]
    return f'<div style="font-size:12px">{html(", ".join(parts)) or "clear, no sun"}</div>'


def faults_of(faults: Sequence[Mapping[str, Any]]) -> str:
    """Faults of a run that are not over, a line of HTML each."""
    lines = []
    for row in faults:
        if row["state"] != "over":
            until = "" if row["until_s"] is None else f", until {row['until_s']:.2f} s"
            hits = f", {row['hits']} hits" if row["hits"] else ""
            text = f"{row['number']} {row['on']}: {row['do']} {row['state']}{hits}{until}"
            lines.append(f'<div class="view-fault" style="color:#ef9a9a;font-size:12px">● {html(text)}</div>')
    return "".join(lines)
