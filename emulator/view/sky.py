"""Weather as the page's sliders have it, and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from emulator.output.sanitizing import html

CLEAR_M, THICK_M = 10_000.0, 1.0
"Visibility from which the field says that there is no fog, and the thickest that it takes."
FOG_CHOICES: Mapping[str, float] = MappingProxyType(
    {"clear": CLEAR_M, "1 km": 1000.0, "200 m": 200.0, "50 m": 50.0, "10 m": 10.0}
)
"Buttons below the field, and the visibility that each sets. [m]"


def fog_table(visibility_m: float) -> dict[str, float] | None:
    """The order's `fog` for a number in the field; None: no fog."""
    if not visibility_m < CLEAR_M:
        return None
    return {"visibility_m": max(THICK_M, float(visibility_m))}


def visibility_m(weather: Mapping[str, Any]) -> float | None:
    """The shortest of the air, of fog, dust and smoke; None: nothing says so."""
    fogs = [weather.get(name) or {} for name in ("fog", "dust", "smoke")]
    found = [weather.get("visibility_m"), *(table.get("visibility_m") or table.get("mor_m") for table in fogs)]
    return min((float(one) for one in found if one), default=None)


def fog_field_m(weather: Mapping[str, Any]) -> float:
    """What the field shows: the visibility of the fog or of the whole air, at most `CLEAR_M`."""
    fog = weather.get("fog") or {}
    seen = fog.get("visibility_m") or fog.get("mor_m") or weather.get("visibility_m")
    return float(f"{min(CLEAR_M, float(seen)) if seen else CLEAR_M:.6g}")


def reported(weather: Mapping[str, Any]) -> str:
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
