"""What a slice of each Velodyne costs to measure: processor time a beam, and beside it the cast of as many rays alone.

    python tests/benchmarks/bench_layers.py [SLICES]

Scenario `velodyne_street`, everything moving, clear, in fog and rain with sun, and clear with one ray a beam. Processor
time of this process, the best of five runs of each slice: it bears a machine with other work on it. Arrays alone are
measured in clear air. The cast is that of `Caster`, of rays along the axes: not Embree's own. The receiver is what is
left of the whole without what comes back (`Measure.view`).
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from emulator.casting.raycast import Caster  # noqa: E402
from emulator.compiled import switch  # noqa: E402
from emulator.runtime import assembly  # noqa: E402
from emulator.scenario import scenario  # noqa: E402
from emulator.sensing.view import View  # noqa: E402
from emulator.sensors.spec import load_spec  # noqa: E402
from emulator.world import scene  # noqa: E402
from protocols import family  # noqa: E402
from protocols.scan import Scan, ScanPlan  # noqa: E402
from protocols.session import Address, LinkKind  # noqa: E402

MODELS = "velodyne-vlp-16", "velodyne-hdl-32e", "velodyne-vlp-32c", "velodyne-vls-128"
WET = "weather: {fog: {visibility_m: 500}, rain: {rate_mm_h: 10}, sun: {azimuth_deg: 60, elevation_deg: 30}}\n"
ONE_RAY = "    physics: {rule: axis}\n"
STREET = ROOT / "scenarios" / "velodyne_street.yaml"


def plans_of(model: str, count: int) -> list[ScanPlan]:
    """Slices that a device asks for, one after another, and the turn that they are part of."""
    session = family("velodyne").new_session({"boot_s": 0.0, "spin_up_s": 0.0}, load_spec(model).device)
    session.connected(0, Address(0, 0), LinkKind.DATAGRAM)
    session.power_on(0)
    plans: list[ScanPlan] = []
    while len(plans) < count:
        session.advance(plans[-1].start_ns if plans else 0)
        plan = session.next_plan()
        assert plan is not None
        n = len(plan)
        nothing = np.full((n, 1), np.nan), np.ones((n, 1)), np.zeros(n, np.uint8), np.full((n, 1), -1, np.int32)
        session.submit(Scan(plan, *nothing))
        plans.append(plan)
    return plans


def best_s(action: object, *given: object) -> float:
    """Processor time, the best of five."""
    took = []
    for _ in range(5):
        begin = time.process_time()
        action(*given)  # type: ignore[operator]
        took.append(time.process_time() - begin)
    return min(took)


def cast_again(caster: Caster, view: View) -> None:
    """As many first rays as the slice needed, each along its beam's axis: nothing but the cast."""
    times = round(view.cast / len(view.rays.beam))
    caster.first_hits(*(one.repeat(times, axis=0) for one in (view.rays.origin_m, view.rays.direction, view.rays.t_s)))


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    print(
        "model; case; form; beams/s measured; share of real time; rays/beam; us/beam; receiver us/beam;"
        " raw cast us/beam; whole/raw"
    )
    for model in MODELS:
        plans = plans_of(model, count)
        period_s = 1e-9 * (plans[-1].start_ns - plans[0].start_ns) / (count - 1)
        for case in ("clear", "fog, rain, sun", "one ray, clear"):
            text = STREET.read_text(encoding="utf-8").replace("velodyne-vlp-16", model)
            text = text + WET if case.startswith("fog") else text
            text = text.replace("    mount:", ONE_RAY + "    mount:") if case.startswith("one") else text
            loaded = scenario.loads(text, STREET, [])
            caster = Caster(scene.build(loaded))
            arrays = (False,) if case == "clear" or switch.kernels() is None else ()
            for loops in (*arrays, True) if switch.kernels() is not None else arrays:
                with switch.switched(loops):
                    measure = assembly.build_measures(loaded)["roof"]
                    measure(plans[0])
                    whole = [best_s(measure, plan) for plan in plans]
                    seen = [best_s(measure.view, plan) for plan in plans]
                    views = [measure.view(plan) for plan in plans[::4]]
                    raw = [best_s(cast_again, caster, view) for view in views]
                beams = len(plans[0])
                each, cast = float(np.mean(whole)) / beams, float(np.mean(raw)) / beams
                rays = float(np.mean([view.cast for view in views])) / beams
                print(
                    f"{model}; {case}; {'loops' if loops else 'arrays'}; {1 / each:.3g};"
                    f" {period_s / (each * beams):.2f}; {rays:.1f}; {1e6 * each:.2f};"
                    f" {1e6 * (each - float(np.mean(seen)) / beams):.2f}; {1e6 * cast:.2f}; {each / cast:.1f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
