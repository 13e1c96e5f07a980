"""Cost of an LMS2xx telegram: values, CRC, whole telegram, whole session. Prints, does not judge.

python tests/benchmarks/bench_lms2xx.py
"""

from __future__ import annotations

import timeit
from collections.abc import Callable

import numpy as np

from protocols.checksums import crc16_lms, crc16_lms_by_steps
from protocols.lms2xx import FAMILY
from protocols.lms2xx.outputs import ALL, Format, Measured, Output, encode
from protocols.lms2xx.telegrams import reply, request
from protocols.lms2xx.values import MEASURING_MODES
from protocols.scan import Scan, ScanPlan

ROUNDS = 2000


def microseconds(call: Callable[[], object]) -> float:
    """Best of five, per call."""
    call()
    return min(timeit.repeat(call, number=ROUNDS, repeat=5)) / ROUNDS * 1e6


def streamed(seconds: int) -> float:
    """Microseconds of session work per streamed scan of 361 points at 500 kBd, measuring left out."""
    session = FAMILY.new_session({"baud": 500_000}, {"model": "sick-lms291-s05"})
    session.power_on(0)
    session.receive(request(b"\x20\x24"), 0)
    array = np.full((361, 1), 12.34)
    zeros = np.zeros(361, np.uint8)
    actor = np.zeros((361, 1), np.int32)

    def scan(plan: ScanPlan) -> Scan:
        return Scan(plan, array, array, zeros, actor)

    sent, now_ns = 0, 0
    begin = timeit.default_timer()
    while now_ns < seconds * 1_000_000_000:
        while (plan := session.next_plan()) is not None:
            session.submit(scan(plan))
        sent += len(session.take_emissions(now_ns))
        now_ns = max(now_ns + 1, session.next_deadline() or 0)
    return (timeit.default_timer() - begin) / sent * 1e6


def main() -> None:
    generator = np.random.default_rng(1)
    range_m = generator.uniform(0.0, 90.0, 361)
    measured = Measured(range_m, np.full(361, 3.0), np.zeros(361, np.uint8))
    plain = Format(MEASURING_MODES[0], 0, False, 9000.0)
    reflector = Format(MEASURING_MODES[1], 0, False, 9000.0)
    telegram = reply(encode(Output(ALL), measured, plain, None), 0x10)
    body = telegram[:-2]
    print(f"CRC of {len(body)} bytes by table        {microseconds(lambda: crc16_lms(body)):8.1f} us")
    print(f"CRC of {len(body)} bytes by steps        {microseconds(lambda: crc16_lms_by_steps(body)):8.1f} us")
    for name, form in (("plain", plain), ("with reflectivity", reflector)):
        cost = microseconds(lambda form=form: reply(encode(Output(ALL), measured, form, None), 0x10))  # type: ignore[misc]
        print(f"telegram of {len(telegram)} bytes, {name:18}{cost:8.1f} us")
    print(f"session, each streamed scan         {streamed(20):8.1f} us")


if __name__ == "__main__":
    main()
