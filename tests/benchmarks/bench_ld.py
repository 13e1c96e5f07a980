"""What a profile costs the sender: `python tests/benchmarks/bench_ld.py`. Prints; nothing fails."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np

from emulator.runtime import assembly
from emulator.scenario import scenario
from protocols.ld import FAMILY
from protocols.ld.packages import encode_packages
from protocols.ld.profiles import Revolution, distance_words, echo_words, encode_profile, layout
from protocols.ld.sectors import Function, Sector, spans, table_of
from protocols.ld.segments import encode_segments
from protocols.ld.usp import encode_frame
from protocols.scan import Scan
from protocols.session import Address, LinkKind

STEP = 2
POINTS = 5760 // STEP


def median_us(work: Callable[[], object], rounds: int = 400) -> float:
    """Median duration of one call. [us]"""
    times = []
    for _ in range(rounds):
        begun = time.perf_counter_ns()
        work()
        times.append(time.perf_counter_ns() - begun)
    return float(np.median(times)) / 1000


def encoders() -> None:
    """Encoding of a full circle at 0.125 degrees by format and link."""
    sectors = spans(table_of([Sector(Function.NORMAL, 5760 - STEP)]), STEP)
    values = np.random.default_rng(1)
    range_m, intensity = values.uniform(1, 260, POINTS), values.uniform(1, 5000, POINTS)
    words = distance_words(range_m, 250.0)
    revolution = Revolution(1, words, echo_words(intensity, words), [0], [199], (0, 3))
    print(f"profile of {POINTS} points; aim: <= 200 us with its checksum")
    for form in (0x39FF, 0x3DFF, 0x3FFF, 0x0100):
        form_layout = layout(form, sectors, STEP)
        encode = median_us(lambda form_layout=form_layout: encode_frame(encode_profile(form_layout, 1, revolution)))
        print(f"  {form:04X}: encode and frame for TCP {encode:7.1f} us ({form_layout.size + 9} bytes)")

    def all_steps() -> bytes:
        found = distance_words(range_m, 250.0)
        now = Revolution(1, found, echo_words(intensity, found), [0], [199], (0, 3))
        return encode_frame(encode_profile(everything, 1, now))

    everything = layout(0x3FFF, sectors, STEP)
    print(f"  3FFF: from float64 ranges and intensities to the frame {median_us(all_steps):7.1f} us")
    payload = encode_profile(everything, 1, revolution)
    print(f"  3FFF: serial packages with their CRC {median_us(lambda: encode_packages(payload, 0x1014)):7.1f} us")
    print(f"  3FFF: CAN segments {median_us(lambda: encode_segments(payload, 3), 50):7.1f} us")


def share_of_a_core() -> None:
    """One sensor streaming to one host: session only, the scans come ready."""
    for hz, step_deg in ((5, 0.1875), (10, 0.375), (10, 0.5), (20, 0.75)):
        device = {"motor_hz": hz, "step_deg": step_deg, "mode": "measure", "delays": "fast"}
        session = FAMILY.new_session(device, {"model": "sick-ld-oem1000"})
        session.power_on(0)
        session.connected(0, Address(0, 1), LinkKind.STREAM)
        session.receive(encode_frame(bytes.fromhex("030100003fff")), 0, Address(0, 1))
        profiles, now_ns = 0, 0
        begun = time.perf_counter()
        while profiles < 20 * hz:
            plan = session.next_plan()
            if plan is not None and plan.start_ns <= now_ns + 250_000_000:
                ones, flags = np.ones((len(plan), 1)), np.zeros(len(plan), np.uint8)
                session.submit(Scan(plan, 10 * ones, ones, flags, ones.astype(np.int32)))
                continue
            deadline = session.next_deadline()
            now_ns = min(when for when in (deadline, plan and plan.start_ns - 250_000_000) if when is not None)
            profiles += len(session.take_emissions(now_ns))
            session.take_events()
        took = time.perf_counter() - begun
        print(f"  {hz:2d} Hz, {step_deg} deg, {int(360 / step_deg)} points: {took / 20:.4%} of a core")


def share_with_measuring(name: str = "bumper", seconds: int = 10) -> None:
    """The LD of a shipped scenario streaming 3FFF over its whole run, everything measured in place."""
    loaded = scenario.load(name)
    index = [sensor.id for sensor in loaded.sensors].index("ld")
    session = assembly.new_session(loaded, index)
    measure = assembly.build_measures(loaded)["ld"]
    host = Address(0, 1)
    session.power_on(0)
    session.connected(0, host, LinkKind.STREAM)
    session.receive(encode_frame(bytes.fromhex("04030000")), 0, host)
    session.receive(encode_frame(bytes.fromhex("0404")), 0, host)
    now_ns, spent, measured, profiles, asked, points = 0, 0.0, 0.0, 0, False, 0
    while now_ns < seconds * 1_000_000_000:
        begun = time.perf_counter()
        profiles += sum(sent.sweep is not None for sent in session.take_emissions(now_ns))
        session.take_events()
        plan = session.next_plan()
        deadline = session.next_deadline()
        spent += time.perf_counter() - begun
        if not asked and deadline is None:  # it measures now
            session.receive(encode_frame(bytes.fromhex("030100003fff")), now_ns, host)
            asked = True
            continue
        if plan is not None and plan.start_ns <= now_ns + 250_000_000:
            begun = time.perf_counter()
            scan = measure(plan)
            middle = time.perf_counter()
            session.submit(scan)
            measured += middle - begun
            spent += time.perf_counter() - middle
            points = len(plan)
            continue
        now_ns = min(when for when in (deadline, plan and plan.start_ns - 250_000_000) if when is not None)
    rate_hz = profiles / seconds
    print(f"  {name}: {profiles} profiles of {points} points in {seconds} s ({rate_hz:.1f}/s, spin-up included)")
    per_profile = 1000 / profiles
    print(f"    measuring {measured * per_profile:6.2f} ms a profile, conversation {spent * per_profile:6.3f} ms")
    share = 10 * (measured + spent) / profiles
    print(f"    {share:.2%} of a core at 10 Hz")


def main() -> int:
    encoders()
    print("conversation and encoding of one sensor streaming 3FFF on TCP, ray casting apart")
    share_of_a_core()
    print("the same with everything measured: scene, footprints, materials, sun, receiver")
    share_with_measuring()
    return 0


if __name__ == "__main__":
    sys.exit(main())
