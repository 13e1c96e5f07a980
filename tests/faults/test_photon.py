"""Faults of light as hosts read them: by the lidar equation, by counting, by what the device tells of itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from emulator.casting.raycast import Caster
from emulator.faults.catalogue import kinds
from emulator.hosts.scans import HostScan
from emulator.measuring.conditions import ActiveFault, Conditions
from emulator.physics import background
from emulator.scenario import scenario
from emulator.sensing.faulty.light import seen_share
from emulator.sensing.measure import build as build_measure
from emulator.sensing.model import sensor_model
from emulator.sensing.table import table_plan
from emulator.sensors.physics_options import PhysicsOptions
from emulator.sensors.spec import load_spec
from emulator.world.scene import build as build_scene
from protocols.lms2xx.telegrams import open_frame, read_values, request
from protocols.scan import Scan
from tests.faults.devices import device
from tests.faults.runs import BEGIN_S, END_S, Run, heals, ranges, run, same

DARK = "  - {plane: {size_m: [6, 60]}, at_m: [5, 0, 1], pitch_deg: -90, material: asphalt}\n"


def held(one: Run) -> list[int]:
    """Sweeps under the fault."""
    return [sweep for sweep, (at_ns, _) in one.scans.items() if BEGIN_S <= at_ns * 1e-9 < END_S - 1e-6]


def light(faulty: Run, healthy: Run) -> np.ndarray:
    """(sweeps, beams) amplitudes on the wire of an LD under the fault over those without it; NaN without an echo."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rows = []
        bad, good = faulty.echoes(), healthy.echoes()
        for sweep in held(faulty):
            whole = (good[sweep] > 100.0) & (good[sweep] < 65_000.0) & (bad[sweep] < 65_000.0)
            rows.append(np.where(whole & (bad[sweep] > 0), bad[sweep] / good[sweep], np.nan))
    return np.array(rows)


def azimuth_deg(one: Run) -> np.ndarray:
    scan = one.scans[held(one)[0]][1]
    return (np.degrees(scan.azimuth_rad) + 180.0) % 360.0 - 180.0


@pytest.fixture(scope="module")
def top() -> Run:
    return run(on="top", world=DARK)


def top_with(fault: str) -> Run:
    return run(fault, on="top", world=DARK)


def test_dirt_takes_its_share_twice_where_it_is(top: Run) -> None:
    faulty = top_with("do: dirty_window, transmission: 0.6, from_deg: 5, to_deg: 40, edge_deg: 0.5")
    ratio, azimuth = light(faulty, top), azimuth_deg(faulty)
    inside, outside = (azimuth >= 5) & (azimuth <= 40), (azimuth < 4) | (azimuth > 41)
    assert np.nanmax(np.abs(ratio[:, inside] - 0.36)) < 0.01
    bad, good = faulty.echoes(), top.echoes()
    assert all(np.all(np.abs(bad[sweep] - good[sweep])[outside] <= 1.0) for sweep in held(faulty))  # a word of the wire
    assert np.count_nonzero(~np.isnan(ratio[0, inside])) > 10
    assert heals(faulty, top)


def test_the_lms_tells_of_its_dirty_window_in_every_telegram() -> None:
    faulty, healthy = run("do: dirty_window, transmission: 0.6"), run()
    status = [(one.start_ns * 1e-9, one.data[-3]) for one in faulty.payloads if one.sweep is not None]
    assert {byte for at_s, byte in status if BEGIN_S + 0.03 < at_s < END_S - 0.01} == {0x92}  # pollution, warning
    assert {byte for at_s, byte in status if at_s > END_S + 0.02} == {0x10}
    worse = run("do: dirty_window, transmission: 0.3")
    assert {one.data[-3] for one in worse.payloads if one.sweep is not None and 0.6 < one.start_ns * 1e-9 < 0.78} == {
        0x93
    }
    unreported = run("do: dirty_window, transmission: 0.3, told: false")
    assert {one.data[-3] for one in unreported.payloads if one.sweep is not None} == {0x10}
    assert heals(faulty, healthy)


def test_dirt_that_scatters_into_the_receiver_is_an_echo_at_the_window() -> None:
    faulty = run("do: dirty_window, transmission: 0.5, stray: 0.2, window_m: 0.05")
    seen = np.concatenate([scan.range_m for scan in faulty.part(BEGIN_S, END_S - 1e-6)])
    assert np.nanmax(seen) < 0.1
    assert np.nanmin(seen) == pytest.approx(0.05, abs=0.02)


def test_drops_dim_the_beams_that_look_through_them_and_wander(top: Run) -> None:
    fault = "do: wet_window, coverage: 0.4, drop_deg: 6, drop_transmission: 0.5, film_transmission: 0.9, renews_s: 0.1"
    faulty = top_with(fault)
    ratio = light(faulty, top)
    known = ratio[~np.isnan(ratio)]
    film, drop = np.abs(known - 0.81) < 0.01, np.abs(known - 0.2025) < 0.01
    assert np.all(film | drop)
    assert 0.1 < np.mean(drop) < 0.8
    patches = {tuple(row[~np.isnan(row)] < 0.5) for row in ratio}
    assert len(patches) == 3  # new drops every 0.1 s
    assert heals(faulty, top)


def test_without_a_laser_nothing_is_left_but_noise() -> None:
    faulty, healthy = run("do: dead_laser", quiet=False), run(quiet=False)
    seen = [np.count_nonzero(~np.isnan(scan.range_m)) for scan in faulty.part(BEGIN_S, END_S - 1e-6)]
    assert max(seen) <= 2  # false alarms
    assert heals(faulty, healthy)
    noisy = "do: dead_laser}\n  - {on: front, at_s: 0.5, for_s: 0.3, do: receiver_noise, factor: 2.0"
    alarms = run(noisy, quiet=False)
    seen = [np.count_nonzero(~np.isnan(scan.range_m)) for scan in alarms.part(BEGIN_S, END_S - 1e-6)]
    assert sum(seen) > 20


@pytest.mark.parametrize("power", [0.5, 0.1])
def test_a_weak_laser_gives_weaker_echoes_in_proportion(power: float, top: Run) -> None:
    faulty = top_with(f"do: weak_laser, power: {power}")
    assert light(faulty, top)[~np.isnan(light(faulty, top))] == pytest.approx(power, abs=0.01)
    assert heals(faulty, top)


def test_a_laser_that_ages_loses_a_half_each_time(top: Run) -> None:
    faulty = top_with("do: weak_laser, power: 1.0, halves_in_s: 0.1")
    for sweep, row in zip(held(faulty), light(faulty, top), strict=True):
        since_s = faulty.scans[sweep][0] * 1e-9 - BEGIN_S
        assert np.nanmean(row) == pytest.approx(0.5 ** (since_s / 0.1), abs=0.01)


def test_a_lamp_dazzles_the_beams_that_look_into_it() -> None:
    # two beams of the LMS see it whole: 15 mrad field of view, a lamp of 3 deg
    irradiance = 50.0
    faulty, healthy = (
        run(f"do: blinding, azimuth_deg: 20, width_deg: 3, irradiance_w_m2: {irradiance}"),
        run(),
    )
    model = sensor_model(load_spec("sick-lms291-s05"), PhysicsOptions(), "operational")
    collected = irradiance * np.pi * model.aperture_radius_m**2 * model.efficiency
    field, lamp = 0.5 * model.receiver.field_of_view_rad, np.radians(1.5)
    # closed form: within the lamp's disc the share of it in the field of view
    assert collected * (field / lamp) ** 2 * model.receiver.responsivity_a_w * model.receiver.gain > (
        model.receiver.saturation_a
    )
    words = {}
    for one in faulty.payloads:
        telegram = open_frame(one.data) if one.sweep is not None else None
        values = None if telegram is None else read_values(telegram)
        if values is not None and one.sweep in held(faulty):
            words[one.sweep] = values.values
    assert len(words) > 8
    for sweep, row in words.items():
        azimuth = np.degrees(faulty.scans[sweep][1].azimuth_rad)
        dazzled = (row & 0x1FFF) == 0x1FFE
        assert np.all(row[dazzled] & 0x8000)  # and bit 15 in the measuring mode of the factory
        assert np.all(dazzled[np.abs(azimuth - 20.0) <= 1.0])
        assert not np.any(dazzled[np.abs(azimuth - 20.0) > 4.0])
    assert heals(faulty, healthy)


def test_background_of_a_lamp_is_what_the_formula_says() -> None:
    power = background.background_sun(10.0, 1.0, 0.02, 0.005, 0.5, np.array([0.0]), 0.05)
    assert power[0] == pytest.approx(10.0 * np.pi * 0.02**2 * 0.5 * 0.01, rel=1e-12)


def test_foreign_pulses_are_echoes_at_random_ranges() -> None:
    fault = "do: interference, echoes_per_beam: 0.2, strength: 20.0"
    faulty, healthy = run(fault), run()
    early, beams = [], 0
    for a, b in faulty.pairs(healthy, BEGIN_S, END_S - 1e-6):
        hit = a.range_m < b.range_m - 0.05
        assert np.allclose(a.range_m[~hit], b.range_m[~hit], atol=0.05)
        early += list(a.range_m[hit] / b.range_m[hit])
        beams += len(a.range_m)
    # of 0.2 a beam over the gate of 82 m those count that come before the wall and pass the threshold, which is
    # higher near by; their amplitudes follow an exponential law
    model = sensor_model(load_spec("sick-lms291-s05"), PhysicsOptions(), "operational")
    wall = healthy.part(BEGIN_S, END_S)[0].range_m
    share = np.linspace(0.005, 0.995, 100)
    place = share[:, None] * wall
    least = np.maximum(1.0, model.floor_m2 / model.threshold / place**2)
    density = 0.2 / model.gate_m * np.exp(-least / 20.0) * wall
    expected = beams * float(density.mean())
    assert len(early) == pytest.approx(expected, abs=4.0 * np.sqrt(expected))
    assert np.mean(early) == pytest.approx(float((density * share[:, None]).mean() / density.mean()), abs=0.12)
    assert heals(faulty, healthy)
    run.cache_clear()
    assert run(fault).sha256 == faulty.sha256


def test_crosstalk_brings_the_post_into_the_beams_beside_it() -> None:
    faulty, healthy = run("do: crosstalk, share: 0.5, reach: 2"), run()

    def width(scan: HostScan) -> int:
        return int(np.count_nonzero(scan.range_m < 3.2))

    for a, b in faulty.pairs(healthy):
        assert width(a) == width(b) + 4
    assert heals(faulty, healthy)


def test_a_receiver_that_looks_beside_the_beam_sees_its_edge(top: Run) -> None:
    faulty = top_with("do: misalignment, angle_mrad: 2.5")
    model = sensor_model(load_spec("sick-ld-lrs1000"), PhysicsOptions(), "operational")
    half = np.sqrt(model.beam.half_angle_x_rad * model.beam.half_angle_y_rad)
    field = 0.5 * model.receiver.field_of_view_rad
    # the integral over the field of view, by brute force
    grid = np.linspace(-field, field, 801)
    x, y = np.meshgrid(grid, grid)
    disc = np.hypot(x, y) <= field
    on, off = (np.exp(-2.0 * ((x - d) ** 2 + y**2) / half**2)[disc].sum() for d in (0.0, 2.5e-3))
    assert seen_share(half, field, 2.5e-3) == pytest.approx(off / on, rel=0.01)
    ratio = light(faulty, top)
    assert np.nanmean(ratio) == pytest.approx(off / on, rel=0.03)
    assert heals(faulty, top)


def test_a_detector_with_less_gain_gives_weaker_echoes(top: Run) -> None:
    faulty = top_with("do: detector_gain, factor: 0.5")
    assert np.nanmean(light(faulty, top)) == pytest.approx(0.5, abs=0.01)
    assert heals(faulty, top)


def test_a_noisier_receiver_scatters_more_and_its_ranges_stay_right() -> None:
    faulty, healthy = run("do: receiver_noise, factor: 3.0", world=DARK, quiet=False), run(world=DARK, quiet=False)
    worse = ranges(faulty.part(BEGIN_S, END_S - 1e-6), 40.0)
    usual = ranges(healthy.part(0.0, 2.0), 40.0)
    worse = worse[np.abs(worse - np.median(usual)) < 0.5]  # false alarms apart
    assert len(worse) > 10
    assert np.std(worse) > 1.2 * np.std(usual)
    assert np.median(worse) == pytest.approx(np.median(usual), abs=0.03)
    assert heals(faulty, healthy)


def test_fog_behind_a_half_dirty_window_is_dimmed_with_it() -> None:
    fog = "weather:\n  fog: {visibility_m: 15}\n"
    fault = "do: dirty_window, transmission: 0.02, from_deg: 0, to_deg: 60"
    faulty, healthy = run(fault, more=fog), run(more=fog)
    a, b = faulty.pairs(healthy)[3]
    azimuth = np.degrees(a.azimuth_rad)
    assert np.all(b.range_m[azimuth > 5] < 7.9)
    assert np.count_nonzero(~np.isnan(a.range_m[azimuth > 5])) < 0.5 * np.count_nonzero(azimuth > 5)
    clean = azimuth < -5
    assert np.allclose(a.range_m[clean], b.range_m[clean], atol=0.3)
    assert heals(faulty, healthy)


def test_two_faults_at_once_do_both() -> None:
    both = (
        "do: range_offset, offset_m: 0.3}\n  - {on: front, at_s: 0.5, for_s: 0.3, do: encoder_offset, azimuth_deg: 1.0"
    )
    faulty, healthy = run(both), run()
    for a, b in faulty.pairs(healthy):
        assert np.allclose(a.range_m[1:-2], b.range_m[2:-1] + 0.3, atol=0.003)
    assert not any(same(a, b) for a, b in faulty.pairs(healthy))
    assert heals(faulty, healthy)


def test_two_dirty_windows_are_dirtier_and_one_that_is_cleaned_leaves_the_other() -> None:
    second = "{on: front, at_s: 0.6, for_s: 0.4, do: dirty_window, transmission: 0.6"
    faulty = run(f"do: dirty_window, transmission: 0.6}}\n  - {second}")
    status = [(one.start_ns * 1e-9, one.data[-3]) for one in faulty.payloads if one.sweep is not None]

    def reported(from_s: float, to_s: float) -> set[int]:
        return {byte for at_s, byte in status if from_s < at_s < to_s}

    assert reported(0.53, 0.6) == {0x92}
    assert reported(0.63, 0.8) == {0x93}  # 0.36: too dirty
    assert reported(0.83, 1.0) == {0x92}
    assert reported(1.03, 2.0) == {0x10}


def test_the_lms_tells_what_is_wrong_when_it_is_asked() -> None:
    made = device("lms2xx")
    made.session.impair(0, "window", 0.5)
    made.session.impair(0, "motor speed", 0.9)
    made.session.impair(0, "motor status", -1.0)

    def ask(payload: bytes) -> bytes:
        made.put(request(payload))
        found = [open_frame(one.payload) for one in made.run(made.now_ns * 1e-9 + 0.5) if len(one.payload) > 6]
        telegram = found[-1]
        assert telegram is not None
        return telegram.data

    assert ask(b"\x32")[:-1] == bytes([2, 18, 3, 29])  # dirt on a channel (a warning), motor revolutions (an error)
    status = ask(b"\x31")
    assert [int.from_bytes(status[at : at + 2], "little") for at in (18, 32, 34, 66)] == [250, 250, 600, 164]
    made.session.impair(made.now_ns, "window", 1.0)
    made.session.impair(made.now_ns, "motor status", 0.0)
    assert ask(b"\x32")[:-1] == b""


def test_photons_counted_behind_a_dirty_window_are_fewer() -> None:
    text = (
        "schema: 1\nseed: 1\nworld:\n"
        "  - {plane: {size_m: [6, 60]}, at_m: [20, 0, 0], pitch_deg: -90, material: asphalt}\n"
        "sensors:\n  - {id: eye, model: paper-905nm, physics: {photons: {}}}\n"
    )
    loaded = scenario.loads(text, Path("case.yaml"))
    scene = build_scene(loaded)
    measure = build_measure(loaded, scene, Caster(scene), "eye")
    plan = table_plan(load_spec("paper-905nm"), 3)
    dirt = ActiveFault("eye", "weak_laser", 0, 0, None, (("power", 0.2),))
    noisy = ActiveFault("eye", "receiver_noise", 1, 0, None, (("factor", 3.0),))
    assert isinstance(measure(plan), Scan)
    bright, dim = measure(plan), measure(plan, Conditions(None, (dirt,)))
    both = measure(plan, Conditions(None, (dirt, noisy)))
    seen = ~np.isnan(bright.range_m[:, 0])
    assert np.any(seen)
    weaker = np.nan_to_num(dim.intensity[seen, 0])
    assert np.all(weaker < bright.intensity[seen, 0])
    assert np.nansum(both.intensity) < np.nansum(bright.intensity)


def test_every_kind_of_these_layers_is_tried_on_the_wire() -> None:
    tried = "".join(path.read_text(encoding="utf-8") for path in sorted(Path(__file__).parent.glob("test_*.py")))
    wanted = [one.name for one in kinds().values() if one.layer in ("photon", "mechanics", "measurement", "clock")]
    assert len(wanted) == 39
    assert [name for name in wanted if f"do: {name}" not in tried and f'run("{name}, ' not in tried] == []
