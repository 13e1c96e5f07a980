"""What a slice of a lidar of many layers costs: to measure, processor time a beam, and to encode and send, a packet.

    python tests/benchmarks/bench_layers.py [SLICES [MODEL ...]]
    python tests/benchmarks/bench_layers.py drive [MODEL ...]
    python tests/benchmarks/bench_layers.py raw [MODEL ...]

Measuring: scenario `velodyne_street`, everything moving, clear, in fog and rain with sun, and clear with one ray a
beam. Processor time of this process, the best of five runs of each slice: it bears a machine with other work on it.
Arrays alone are measured in clear air. The receiver is what is left of the whole without what comes back
(`Measure.view`).

Casts beside it: rays of the same slices, one a beam, all from where the sensor is at the first instant, on triangles
as they stand then: by `Caster`, for which they go on moving, and by embreex, Open3D and MuJoCo, for which they rest.
One thread each; compared is the share of rays of which the distance is that of `Caster` within a millimetre.

Packets: of what one ray a beam has measured, by profile or return mode. Encoding is all that a session does between a
scan and its emissions: choosing returns, units, instants, and packing: bytes and checks; the best slice. As in the
sending process nothing is measured meanwhile: a scan comes out of a pickle, as through a worker's pipe. Sending is that
of the UDP link, to a socket of this machine.

Drive: slices of the whole scenario, a hundred of them at even distances, the best of five runs of each: the cost
changes with what is near, so its mean over the drive says whether a sensor keeps up, not that of the first slices.

Raw: the same slices in clear air, whole, and casts of the very rays that were cast for them, probes, bundles, and those
that go on from panes and mirrors: by `Caster`, for which bodies move meanwhile, and by embreex, Open3D and MuJoCo on
the triangles as they stand when the slice begins. All in turns, the best of five each; the ratio is that of the sums
over the drive. MuJoCo casts from one place alone, which is that of the first ray.

Split: wall time of slices, handed to one measuring process and to two; of a quiet machine with a core for each.
"""

from __future__ import annotations

import pickle
import socket
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from emulator.casting.raycast import Caster  # noqa: E402
from emulator.compiled import switch  # noqa: E402
from emulator.measuring.supervision import Workers  # noqa: E402
from emulator.runtime import assembly  # noqa: E402
from emulator.scenario import scenario  # noqa: E402
from emulator.sensors.spec import load_spec  # noqa: E402
from emulator.transports.udp_sender import open_link_udp  # noqa: E402
from emulator.world import scene  # noqa: E402
from protocols import family  # noqa: E402
from protocols.ouster.codec import PROFILES  # noqa: E402
from protocols.scan import Scan, ScanPlan  # noqa: E402
from protocols.session import Address, LinkKind  # noqa: E402
from tests.benchmarks.other_casts import OTHERS, agreeing, finer  # noqa: E402

MODELS: Mapping[str, str] = {
    "velodyne-vlp-16": "{boot_s: 0.0, spin_up_s: 0.0}",
    "velodyne-hdl-32e": "{boot_s: 0.0, spin_up_s: 0.0}",
    "velodyne-vlp-32c": "{boot_s: 0.0, spin_up_s: 0.0}",
    "velodyne-vls-128": "{boot_s: 0.0, spin_up_s: 0.0}",
    "ouster-os1-128": "{boot_s: 0.0, init_s: 0.0, spin_up_s: 0.0, config: {lidar_mode: 1024x10}}",
    "hesai-ot128": "{boot_s: 0.0, spin_up_s: 0.0}",
}
"Model -> its device table."
WET = "weather: {fog: {visibility_m: 500}, rain: {rate_mm_h: 10}, sun: {azimuth_deg: 60, elevation_deg: 30}}\n"
CASES = CLEAR, WETTEST, ONE_RAY = "clear", "fog, rain, sun", "one ray, clear"
STREET = ROOT / "scenarios" / "velodyne_street.yaml"
THEIRS = "device: {boot_s: 0.2, spin_up_s: 0.5, pps: true, nmea: true}"
DATA = ("lidar", "data")
"Labels of packets that carry measurements."
OFTEN = 20
"Slices that are encoded, of each profile."
OF_A_DRIVE = 100
"Slices of a drive that are measured."
FINE = 100_000
"Triangles at least of the finer street."


def street(model: str, case: str) -> scenario.Scenario:
    """The street, with a model on the roof; the case: see `CASES`."""
    text = STREET.read_text(encoding="utf-8").replace("velodyne-vlp-16", model)
    text = text.replace(THEIRS, "device: " + MODELS[model])
    if case == WETTEST:
        text += WET
    elif case == ONE_RAY:
        text = text.replace("    mount:", "    physics: {rule: axis}\n    mount:")
    return scenario.loads(text, STREET, [])


def forms(model: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Profiles or return modes, and what of the device table gives them."""
    quick: dict[str, Any] = {"boot_s": 0.0, "spin_up_s": 0.0}
    if model.startswith("ouster"):
        for name in PROFILES:
            config = {"lidar_mode": "1024x10", "udp_profile_lidar": name}
            yield name, quick | {"init_s": 0.0, "config": config}
    elif model.startswith("hesai"):
        for returns in ("last", "dual"):
            for high in (False, True):
                yield f"{returns}{', high resolution' if high else ''}", quick | {
                    "returns": returns, "high_resolution": high,
                }  # fmt: skip
    else:
        for returns in ("strongest", "dual"):
            yield returns, quick | {"returns": returns}


def powered(model: str, device: dict[str, Any]) -> Any:
    """A session that asks for slices."""
    session = family(model.partition("-")[0]).new_session(device, load_spec(model).device)
    session.connected(0, Address(0, 0), LinkKind.DATAGRAM)
    session.power_on(0)
    return session


def planned(session: Any) -> ScanPlan:
    """The slice that it asks for next."""
    while (plan := session.next_plan()) is None:
        session.advance(session.next_deadline())
    return plan  # type: ignore[no-any-return]


def plans_of(model: str, count: int, device: dict[str, Any] | None = None) -> list[ScanPlan]:
    """Slices that a device asks for, one after another."""
    session = powered(model, device or next(forms(model))[1])
    plans: list[ScanPlan] = []
    while len(plans) < count:
        plans.append(planned(session))
        session.submit(Scan.empty(plans[-1]))
        session.advance(plans[-1].start_ns)
    return plans


def packets(model: str) -> None:
    """Print what a packet costs, by profile."""
    measure = assembly.build_measures(street(model, ONE_RAY))["roof"]
    codec, packing = import_module(f"protocols.{model.partition('-')[0]}.codec"), [0.0]
    encode = codec.encode

    def timed(*given: Any) -> Any:
        begin = time.process_time()
        made = encode(*given)
        packing[0] = time.process_time() - begin
        return made

    codec.encode = timed
    for name, device in forms(model):
        session, took = powered(model, device), []
        measured = [pickle.dumps(measure(plan)) for plan in plans_of(model, OFTEN, device)]
        for one in measured:
            plan, scan = planned(session), replace(pickle.loads(one), plan=planned(session))
            begin = time.process_time()
            session.submit(scan)
            spent = time.process_time() - begin
            session.advance(plan.start_ns)
            made = [one.payload for one in session.take_emissions(session.next_plan().start_ns) if one.label in DATA]
            if made:
                took.append((spent / len(made), packing[0] / len(made), len(made), len(made[-1])))
        best_s, _, count, size = min(took)
        packed_s = min(one[1] for one in took)
        print(
            f"{model}; {name}; {size} bytes; {count} packets; encode {1e6 * best_s:.0f} us,"
            f" of it packing {1e6 * packed_s:.0f} us; send {1e6 * sending_s(bytes(size)):.0f} us",
            flush=True,
        )
    codec.encode = encode


def sending_s(payload: bytes) -> float:
    """Processor time of a datagram, the best of many."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("127.0.0.1", 0))
        link = open_link_udp(f"udp:127.0.0.1:{host.getsockname()[1]}", serial_line=False)
        took = []
        for _ in range(200):
            begin = time.process_time()
            link.send(payload, 0)
            link.flush(0)
            took.append(time.process_time() - begin)
            host.recv(65_535)
        link.close()
    return min(took)


def best_s(action: object, *given: object) -> float:
    """Processor time, the best of five."""
    took = []
    for _ in range(5):
        begin = time.process_time()
        action(*given)  # type: ignore[operator]
        took.append(time.process_time() - begin)
    return min(took)


def in_turns(actions: Mapping[str, Any]) -> dict[str, float]:
    """Processor time of each, the best of five; one after another, so that all have the same machine."""
    took = {name: np.inf for name in actions}
    for _ in range(5):
        for name, action in actions.items():
            begin = time.process_time()
            action()
            took[name] = min(took[name], time.process_time() - begin)
    return took


def rays_cast(measure: Any, plan: ScanPlan) -> tuple[Any, Any, Any]:
    """Origins and directions (m, 3) and instants (m,) of all rays that are cast for a slice: as with arrays."""
    cast, found, within = Caster.first_hits, [], [False]

    def noted(self: Caster, origin_m: Any, direction: Any, t_s: Any, **more: Any) -> Any:
        if within[0]:
            return cast(self, origin_m, direction, t_s, **more)
        shape = direction.shape
        found.append((np.broadcast_to(origin_m, shape), direction, np.broadcast_to(t_s, shape[:1])))
        within[0] = True
        try:
            return cast(self, origin_m, direction, t_s, **more)
        finally:
            within[0] = False

    Caster.first_hits = noted  # type: ignore[method-assign]
    try:
        with switch.switched(False):
            measure.view(plan)
    finally:
        Caster.first_hits = cast  # type: ignore[method-assign]
    origin_m, direction, t_s = (np.concatenate(columns) for columns in zip(*found, strict=True))
    return origin_m, direction, t_s


def measuring(model: str, count: int) -> None:
    """Print what a beam costs, by case."""
    plans = plans_of(model, count)
    period_s = 1e-9 * (plans[-1].start_ns - plans[0].start_ns) / (count - 1)
    for case in CASES:
        loaded = street(model, case)
        arrays = (False,) if case == CLEAR or switch.kernels() is None else ()
        for loops in (*arrays, True) if switch.kernels() is not None else arrays:
            with switch.switched(loops):
                measure = assembly.build_measures(loaded)["roof"]
                measure(plans[0])
                whole = [best_s(measure, plan) for plan in plans]
                seen = [best_s(measure.view, plan) for plan in plans]
                views = [measure.view(plan) for plan in plans[::4]]
            beams = len(plans[0])
            each = float(np.mean(whole)) / beams
            rays = float(np.mean([view.cast for view in views])) / beams
            print(
                f"{model}; {case}; {'loops' if loops else 'arrays'}; {1 / each:.3g};"
                f" {period_s / (each * beams):.2f}; {rays:.1f}; {1e6 * each:.2f};"
                f" {1e6 * (each - float(np.mean(seen)) / beams):.2f}",
                flush=True,
            )


def of_the_drive(model: str) -> tuple[list[ScanPlan], float]:
    """Slices at even distances, and how long each lasts. [s]"""
    period_ns = np.diff([one.start_ns for one in plans_of(model, 2)])[0]
    plans = plans_of(model, int(1e9 * scenario.load(str(STREET)).duration_s / period_ns))
    period_s = 1e-9 * (plans[-1].start_ns - plans[0].start_ns) / (len(plans) - 1)
    return plans[:: max(1, len(plans) // OF_A_DRIVE)], period_s


def driving(model: str) -> None:
    """Print what slices of the whole drive cost, with loops where there are any."""
    chosen, period_s = of_the_drive(model)
    for case in (CLEAR, WETTEST):
        measure = assembly.build_measures(street(model, case))["roof"]
        measure(chosen[0])
        took = 1e3 * np.array([best_s(measure, plan) for plan in chosen])
        print(
            f"{model}; {case}; {1e3 * period_s:.2f}; {took.mean():.2f}; {np.median(took):.2f};"
            f" {np.percentile(took, 90):.2f}; {took.max():.2f}; {1e3 * period_s / took.mean():.2f};"
            f" {1e3 * took.mean() / len(chosen[0]):.2f}",
            flush=True,
        )


def over_raw(model: str) -> None:
    """Print what slices of the drive cost over casts of the rays that were cast for them."""
    loaded = street(model, CLEAR)
    world, measure = scene.build(loaded), assembly.build_measures(loaded)["roof"]
    caster, took, rays, missing = Caster(world), dict[str, float](), 0, set[str]()
    chosen, _ = of_the_drive(model)
    measure(chosen[0])
    for plan in chosen:
        origin_m, direction, t_s = rays_cast(measure, plan)
        casts: dict[str, Any] = {
            "whole": partial(measure, plan), "ours": partial(caster.first_hits, origin_m, direction, t_s),
        }  # fmt: skip
        for name, made in OTHERS.items():
            try:
                start_m = origin_m[0] if name == "mujoco" else origin_m
                casts[name] = made(world, float(t_s[0]), start_m, direction)[0]
            except ImportError:
                missing.add(name)
        rays += len(direction)
        for name, best in in_turns(casts).items():
            took[name] = took.get(name, 0.0) + best
    for name, whole_s in took.items():
        print(
            f"{model}; {name}; {rays / len(chosen):.0f}; {1e3 * whole_s / len(chosen):.2f}; {1e6 * whole_s / rays:.3f};"
            f" {took['whole'] / whole_s:.2f}",
            flush=True,
        )
    for name in sorted(missing):
        print(f"{model}; {name}: not installed", flush=True)


def beside(model: str, count: int) -> None:
    """Print what a cast of the same rays costs with other libraries, in the street and in one of `FINE` triangles."""
    loaded = street(model, ONE_RAY)
    coarse, measure = scene.build(loaded), assembly.build_measures(loaded)["roof"]
    views = [measure.view(plan) for plan in plans_of(model, count)]
    t_s, origin_m = float(views[0].rays.t_s[0]), np.array(views[0].rays.origin_m[0])
    direction = np.concatenate([view.rays.direction for view in views])
    origins_m, rays = np.broadcast_to(origin_m, direction.shape).copy(), len(direction)
    for world in (coarse, finer(coarse, FINE)):
        caster, triangles = Caster(world), sum(len(body.faces) for body in world.bodies)
        ours_m = caster.first_hits(origins_m, direction, t_s).range_m
        took = {"ours": (best_s(caster.first_hits, origins_m, direction, t_s), 1.0)}
        for name, made in OTHERS.items():
            try:
                cast, ranges_m = made(world, t_s, origin_m, direction)
            except ImportError:
                print(f"{model}; {name}: not installed", flush=True)
                continue
            took[name] = best_s(cast), agreeing(ours_m, ranges_m(cast()))
        for name, (each_s, agree) in took.items():
            print(
                f"{model}; {name}; {triangles}; {rays}; {1e6 * each_s / rays:.3f}; {rays / each_s:.3g};"
                f" {took['ours'][0] / each_s:.2f}; {100 * agree:.3f} %",
                flush=True,
            )


def splitting(model: str, count: int) -> None:
    """Print how long slices take on the wall clock, measured by one process and by two."""
    plans = plans_of(model, count)
    period_s = 1e-9 * (plans[-1].start_ns - plans[0].start_ns) / (count - 1)
    alone_s = 0.0
    for processes in (1, 2):
        pool = Workers(partial(assembly.build_measures, street(model, CLEAR)), ["roof"], processes, shared=["roof"])
        took = []
        for _ in range(4):  # the first fills tables
            begin = time.perf_counter()
            for plan in plans:
                pool.request("roof", plan)
            pool.settle()
            took.append(time.perf_counter() - begin)
            assert len(pool.collect("roof")) == count
        shares = [row["measured"] for row in pool.rows()]
        pool.close()
        best = min(took[1:])
        alone_s = alone_s or best
        print(
            f"{model}; {processes}; {1e3 * best / count:.1f} ms; {alone_s / best:.2f};"
            f" {period_s * count / best:.2f}; {shares}",
            flush=True,
        )


def main() -> None:
    if sys.argv[1:2] == ["drive"]:
        print("drive: model; case; slice ms; mean ms; median; 90 %; worst; share of real time; us/beam")
        for model in sys.argv[2:] or list(MODELS):
            driving(model)
        return
    if sys.argv[1:2] == ["raw"]:
        print("raw: model; what; rays a slice; ms a slice; us a ray; whole over it")
        for model in sys.argv[2:] or list(MODELS):
            over_raw(model)
        return
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    models = sys.argv[2:] or list(MODELS)
    print("packets: model; profile or return mode; size; packets; processor time of a packet, the best")
    for model in models:
        packets(model)
    print("beams: model; case; form; beams/s measured; share of real time; rays/beam; us/beam; receiver us/beam")
    for model in models:
        measuring(model, count)
    print("casts beside it: model; caster; triangles; rays; us/ray; rays/s; ours/it; agree within 1 mm with ours")
    for model in models:
        beside(model, count)
    print("split: model; processes; wall time of a slice; times as fast as one; share of real time; slices of each")
    for model in models:
        splitting(model, max(count, 20))


if __name__ == "__main__":
    main()
