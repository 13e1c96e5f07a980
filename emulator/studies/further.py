"""Published values of other sources beside what the product computes, each with its deviation and how much it proves.

Belongs here: numbers that somebody else printed. Not: the base paper's own (ranges, points, braking).
"""

from __future__ import annotations

import math

import numpy as np

from emulator.physics import atmosphere, background, brdf, precipitation, sunlight
from emulator.physics.constants import LN_50
from emulator.sensors.spec import load_spec
from emulator.studies import measured, mie
from emulator.studies.effort import Effort
from emulator.studies.facts import KINDS, Fact
from emulator.studies.points import LD_LRS, LMS291
from emulator.studies.report import Column, Section, Table
from emulator.studies.stage import Stage, plate
from protocols import lms2xx
from protocols.scan import ScanPlan

PAPERS_HALF_ANGLE_RAD = math.radians(0.035)
START_STREAM = bytes.fromhex("0200020020243408")
"LMS2xx: send all scans; printed in every listing of the protocol."


def droplet_facts(effort: Effort) -> list[Fact]:
    """Light and droplets: Mie series over spectra against laws and lidar ratios."""
    spectra = [mie.MODERATE_FOG, mie.CHU_HOGG, mie.STRONG_SPRAY] + ([mie.STRONG_FOG] if effort.every == 1 else [])
    connor = "O'Connor, Illingworth, Hogan 2004, J. Atmos. Oceanic Technol. 21"
    facts = [
        Fact(f"lidar ratio at 905 nm, {one.name}", "sr", connor, "read, abstract", 18.8, one.optics(905)[1], "computed",
             "printed 18.8 +- 0.8; Mie sum over Rasshofer's spectrum")
        for one in spectra
    ]  # fmt: skip
    at = {nm: mie.MODERATE_FOG.optics(nm)[0] for nm in (550, 785, 905, 1550)}
    visibility_m = LN_50 / at[550]
    naboulsi = atmosphere.fog_naboulsi_advection
    facts += [
        Fact("extinction in fog, 1550 over 785 nm", "1", "Kim, McArthur, Korevaar 2001", "read, abstract", 1.0,
             at[1550] / at[785], "computed", "\"attenuated equally by fog\"; Mie sum, moderate advection fog"),
        Fact("extinction in fog, 1550 over 905 nm", "1", "Al Naboulsi, Sizun, de Fornel 2004", "quoted",
             float(naboulsi(200.0, 1550e-9) / naboulsi(200.0, 905e-9)), at[1550] / at[905], "computed",
             "advection fog law against the Mie sum"),
        Fact(f"extinction at 905 nm where V = {visibility_m:.0f} m", "1/km", "Kim et al. 2001, law", "quoted",
             1e3 * float(atmosphere.fog_kim(visibility_m, 905e-9)), 1e3 * at[905], "computed",
             "Mie sum; V from the same spectrum at 550 nm"),
        Fact("fog backscatter times MOR", "1/sr", "Hahner et al. 2021, source code", "read", 0.046,
             math.log(20.0) / atmosphere.fog_lidar_ratio(400.0), "differs",
             "theirs is the lidar ratio of haze, 65 sr; ours that of droplets"),
    ]  # fmt: skip
    return facts


def rain_facts() -> list[Fact]:
    """Rain: extinction integrated over drop sizes against laws fitted to measurements."""
    facts = [
        Fact("rain 10 mm/h", "dB/km", "Japan law, 1.58 R^0.63", "quoted", 1.58 * 10.0**0.63,
             db(float(atmosphere.rain_marshall_palmer(10.0))), "computed",
             "drop sizes of Marshall and Palmer 1948, Q = 2; the same at any rate")
    ]  # fmt: skip
    for rate in (10.0, 70.0):
        kept = atmosphere.forward_scatter_factor(rate, 905e-9, PAPERS_HALF_ANGLE_RAD)
        ours = db(kept * float(atmosphere.rain_marshall_palmer(rate)))
        note = "the same, light diffracted into the paper's beam kept"
        facts += [
            Fact(f"rain {rate:g} mm/h", "dB/km", "Carbonneau, Wisely 1998, 1.076 R^0.67", "quoted", 1.076 * rate**0.67,
                 ours, "computed", note),
            Fact(f"rain {rate:g} mm/h", "dB/km", "ITU-R P.1814-1 (2025), 1.2924 R^0.6436", "quoted",
                 1.2924 * rate**0.6436, ours, "computed", note),
        ]  # fmt: skip
    facts += [
        Fact(f"rain {rate:g} mm/h", "dB/km", "Ulbrich, Atlas 1985, J. Atmos. Oceanic Technol. 2, eq. 8: 1.45 R^0.64",
             "quoted", 1.45 * rate**0.64, db(float(atmosphere.rain_marshall_palmer(rate))), "computed",
             "drop sizes of Marshall and Palmer 1948, Q = 2; the print is a fit to observed sizes")
        for rate in (5.0, 20.0)
    ]  # fmt: skip
    facts += [
        Fact(f"rain that drops of {rate:g} mm/h carry", "mm/h", "Marshall, Palmer 1948; Atlas et al. 1973", "quoted",
             rate, carried_mm_h(rate), "computed", "sizes of one source falling with the speeds of the other")
        for rate in (10.0, 35.0)
    ]  # fmt: skip
    facts.append(
        Fact("backscatter of a drop over diameter squared", "1/sr", "LISA 2021, source code", "quoted", 0.00495,
             float(precipitation.drop_backscatter(1.327)), "computed",
             "theirs is Fresnel alone; ours has the back face")
    )  # fmt: skip
    return facts


def carried_mm_h(rate_mm_h: float) -> float:
    """Rain rate of drops with the sizes of Marshall and Palmer and the fall speeds of Atlas et al."""
    diameter_mm = np.linspace(0.11, 8.0, 4000)
    number = 8000.0 * np.exp(-4.1 * rate_mm_h**-0.21 * diameter_mm)
    flux = number * math.pi / 6.0 * diameter_mm**3 * np.maximum(atmosphere.fall_speed_atlas(diameter_mm), 0.0)
    return 3.6e-3 * float(np.sum(flux)) * float(diameter_mm[1] - diameter_mm[0])


def surface_facts() -> list[Fact]:
    """Sun and glass."""
    astm = "ASTM G173-03, outside the atmosphere, mean over 40 nm"
    glass = "Hecht, Optics: glass of index 1.5"
    return [
        Fact("sunlight at 905 nm", "W/m²/nm", astm, "read", 0.906,
             1e-9 * float(background.solar_blackbody(905e-9, 1366.1)), "computed",
             "black body of 5772 K with the table's total"),
        Fact("sunlight at 1550 nm", "W/m²/nm", astm, "read", 0.271,
             1e-9 * float(background.solar_blackbody(1550e-9, 1366.1)), "computed",
             "the real sun is brighter there: H⁻ is clearest at 1.6 µm"),
        Fact("reflection of one face at 0 deg", "%", glass, "memory", 4.0,
             100.0 * float(brdf.fresnel_unpolarised(1.5, 0.0)), "computed"),
        Fact("transmission of a pane at 0 deg", "%", glass, "memory", 92.0,
             100.0 * float(brdf.pane_transmission(1.5, 0.0)), "computed", "all reflections inside the pane"),
    ]  # fmt: skip


def sun_facts() -> list[Fact]:
    """A low sun, twilight, haze; and how often beams of two scanners meet."""
    astm, nautical = "ASTM G173-03, direct, mean over 40 nm", "Explanatory Supplement 1992, sec. 8.3; civil twilight"
    facts = [
        Fact(f"air mass at {h:g} deg", "1", "Bemporad 1904, in Allen, Astrophysical Quantities", "memory", printed,
             float(sunlight.air_mass(h)), "computed", "Kasten and Young 1989, from another atmosphere")
        for h, printed in ((10.0, 5.60), (5.0, 10.39), (1.0, 26.96))
    ]  # fmt: skip
    clear = 0.906 * math.exp(
        -1.5 * (sunlight.rayleigh_depth(905e-9) + sunlight.aerosol_depth(905e-9, sunlight.TABLE_BETA))
    )
    tilt, h = math.radians(37.0), 41.8
    direct = float(sunlight.direct_normal(h, sunlight.TABLE_BETA, 905e-9, 1366.1))
    sky = sunlight.sky_radiance(h, sunlight.TABLE_BETA, 905e-9, 1366.1)
    both = math.pi * float(sunlight.lit_radiance(direct, sky, 1.0, math.sin(math.radians(h) + tilt), math.cos(tilt)))
    return [
        *facts,
        Fact("direct sun at the ground, 905 nm", "W/m²/nm", astm, "read", 0.700, clear, "differs",
             "air and haze on the light outside the atmosphere, no water lines; the product starts from the print"),
        Fact("sun and sky on a plane tilted by 37 deg, 905 nm", "W/m²/nm", "ASTM G173-03, global", "read", 0.749,
             1e-9 * both, "follows", "from the direct print and our radiance of the sky; the print has lit ground too"),
        Fact("twilight on level ground, sun at -6 deg", "lx", nautical, "quoted", 3.4,
             sunlight.illuminance_lx(-6.0), "follows", "the polynomials of Janiczek and DeYoung 1987"),
        Fact("Linke turbidity of a clear sky", "1", "Kasten 1996; Ineichen, Perez 2002", "memory", 3.0,
             sunlight.linke_of_beta(sunlight.CLEAR_BETA), "computed",
             "clear sites 2.5 to 3.5; of the default haze, Ineichen 2008"),
        Fact("time for which beams of two scanners cross", "1", "Popko, Gaylord, Valenta, SPIE", "read, abstract",
             0.25, crossing_share(), "computed",
             "\"most configurations near 1/4\"; 75 and 47 Hz, geometry alone: how seldom, not how strong"),
    ]  # fmt: skip


def crossing_share() -> float:
    """Share of the time in which the beams of two scanners that turn in one plane cross in front of both."""
    t_s = np.linspace(0.0, 2.0, 200_001)
    one, two = 2.0 * math.pi * 75.0 * t_s, 2.0 * math.pi * 47.0 * (1.0 + 20e-6) * t_s
    # both on one side of the line between them, and leaning towards each other
    lean = np.sin(two - one)
    return float(np.mean((np.sin(two) * lean > 0.0) & (np.sin(one) * lean > 0.0)))


# ------------------------------------------------------------------------------- scanners
def scanner_facts() -> list[Fact]:
    """Rated ranges and timing of the SICK scanners, from their own sessions and through the path."""
    box = "sicktoolbox, source code"
    facts = []
    stage = Stage(plate(4.0, 4.0, 0.1), LMS291.model, physics={"noise": False})
    for name, printed in (("standard", 30.0), ("medium", 25.0), ("low", 20.0), ("high", 42.0)):
        plan = lms_plan({"sensitivity": name})
        note = "K is set from it" if name == "standard" else "the setting's gain is set from it"
        facts.append(
            Fact(f"LMS291, 10 % target, sensitivity {name}", "m", box, "read", printed,
                 stage.farthest_m(printed, plan.gain), "calibrated", note + "; extinction of the air is on top")
        )  # fmt: skip
    bright = Stage(plate(8.0, 8.0, 0.9), LMS291.model, physics={"noise": False})
    facts.append(
        Fact("LMS291, largest range, white target", "m", "MAVS, source code; format limit 81.9 m", "read", 80.0,
             bright.farthest_m(80.0), "calibrated", "K would allow 90 m; the gate, set from this print, ends it")
    )  # fmt: skip
    far = Stage(plate(8.0, 8.0, 0.1), LD_LRS.model, physics={"noise": False})
    facts.append(
        Fact("LD-LRS1000, 10 % target", "m", "data sheet", "memory", 80.0, far.farthest_m(80.0), "calibrated",
             "K is set from it; extinction of the air is on top")
    )  # fmt: skip
    for step, field, printed in ((1.0, 180, 13.33), (0.5, 180, 26.67), (0.25, 100, 53.33)):
        plan = lms_plan({"resolution_deg": step, "field_deg": field})
        facts.append(
            Fact(f"LMS291, scan of {step:g} deg", "ms", "Player, source code", "read", printed, 1e3 * plan.duration_s,
                 "follows", "the session's own plan: 75 turns per second, interlaced combs")
        )  # fmt: skip
    return facts


def lms_plan(device: dict[str, object]) -> ScanPlan:
    """The sweep that an LMS291 wants after it was ordered to send all scans."""
    session = lms2xx.FAMILY.new_session(device, load_spec(LMS291.model).device)
    now_ns = 0
    session.power_on(now_ns)
    session.receive(START_STREAM, now_ns)
    for _ in range(100):
        plan = session.next_plan()
        if plan is not None:
            return plan
        now_ns = max(now_ns + 1, session.next_deadline() or 0)
        session.advance(now_ns)
        session.take_emissions(now_ns)
    raise RuntimeError("the LMS291 wants no sweep")


def db(extinction_per_m: float) -> float:
    """In dB/km."""
    return float(atmosphere.db_per_km(extinction_per_m))


def values(effort: Effort) -> Section:
    """All of them."""
    facts = all_facts(effort)
    computed = [fact for fact in facts if fact.kind == "computed"]
    off = [fact for fact in facts if not fact.agrees]
    beyond = "; ".join(f"{fact.quantity} ({fact.source.split(',')[0]}): {fact.off_percent:+.0f} %" for fact in off)
    table = Table(
        "further_values",
        "Published values of other sources",
        (
            Column("quantity", "quantity"),
            Column("unit", "unit"),
            Column("source", "source"),
            Column("seen", "print known from"),
            Column("printed", "printed", ".4g"),
            Column("ours", "ours", ".4g"),
            Column("off_percent", "off (%)", "+.1f"),
            Column("verdict", "verdict"),
            Column("kind", "kind"),
            Column("note", "note"),
        ),
        tuple(
            (fact.quantity, fact.unit, fact.source, fact.seen, fact.printed, fact.ours,
             fact.off_percent, fact.verdict, fact.kind, fact.note)
            for fact in facts
        ),
        "Agrees: within 10 %, within the print's own spread where it has one, or below it where it is a limit. Kinds: "
        + "; ".join(f"{kind}: {meaning}" for kind, meaning in KINDS.items()) + ".",
    )  # fmt: skip
    return Section(
        "Further published values",
        (
            f"{len(facts)} values of {len({fact.source.split(',')[0] for fact in facts})} sources; {len(computed)} are "
            f"computed from first principles or from other sources than the print, "
            f"{sum(fact.agrees for fact in computed)} of these agree." + (f" Differ: {beyond}." if beyond else ""),
            "The Mie sums are made by a series of this study alone (droplet spectra of Rasshofer et al. 2011 as the "
            "source of LISA has them); the product itself takes the laws and lidar ratios that they judge.",
            "Snow, rain, receivers, sheeting and gaps between leaves are measured by sensors in scenes. No public "
            "number was found for rain echoes against distance of a scanner that is modelled here, for how wide a "
            "retroreflector blooms, or for how many beams the sun blinds; those have closed forms in the tests alone.",
        ),
        tables=(table,),
    )


def all_facts(effort: Effort) -> list[Fact]:
    """Every value."""
    return [
        *droplet_facts(effort), *rain_facts(), *surface_facts(), *sun_facts(), *scanner_facts(),
        *measured.facts(effort),
    ]  # fmt: skip
