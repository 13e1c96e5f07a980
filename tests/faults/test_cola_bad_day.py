"""A bad day of an LMS111: one fault after the other on its TCP link, and a host that has its scans again after each."""

from __future__ import annotations

from functools import reduce
from typing import Any

import pytest

from tests.faults.bench import Bench

DAY: tuple[tuple[float, dict[str, Any]], ...] = (
    (4, {"do": "wrong_length", "of": "scans", "count": 3}),
    (6, {"do": "bad_checksum", "of": "scans", "count": 3}),
    (8, {"do": "truncate_telegram", "of": "scans", "keep_bytes": 700, "count": 1}),
    (8.1, {"do": "hang", "for_s": 1.5}),
    (12, {"do": "device_busy", "for_s": 1}),
    (14, {"do": "refuse_login", "for_s": 1}),
    (16, {"do": "lose_reply", "count": 1}),
    (16.5, {"do": "reset_connections"}),
    (20, {"do": "half_open", "for_s": 2}),
    (25, {"do": "reboot"}),
    (32, {"do": "power_cycle", "off_s": 2}),
    (39, {"do": "dirty_window", "transmission": 0.5, "for_s": 1}),
)
CALM_S = (3.2, 5.0, 7.0, 11.5, 13.5, 15.5, 19.0, 24.0, 31.0, 38.0, 41.5)
"By then the fault before is over, and a host has scans again."


@pytest.fixture(scope="module")
def day() -> Bench:
    return Bench("cola", *({**fault, "at_s": at_s} for at_s, fault in DAY)).until(43.0)


@pytest.mark.parametrize("calm_s", CALM_S)
def test_after_every_fault_all_scans_come_again(day: Bench, calm_s: float) -> None:
    assert day.decoded(calm_s, calm_s + 0.4) == pytest.approx(20, abs=2)


def test_every_fault_has_happened_and_every_scan_is_accounted(day: Bench) -> None:
    assert {row["do"]: row["hits"] > 0 or row["begun"] > 0 for row in day.faults.rows()} == {
        fault["do"]: True for _, fault in DAY
    }
    account = day.instrument.ledger.account()
    assert account["unaccounted"] == 0
    assert account["sent"] > 1200


def test_the_damage_is_that_of_the_wire(day: Bench) -> None:
    """Length field, sum byte and cut, byte by byte, with no help of the product."""
    kinds = {"good": 0, "length": 0, "sum": 0, "cut": 0}
    for one in day.sent(3.0, 9.0, "LMDscandata"):
        data = one.data
        size, payload = int.from_bytes(data[4:8], "big"), data[8:-1]
        if len(data) == 700:
            kinds["cut"] += 1
        elif size != len(payload):
            kinds["length"] += 1
            assert reduce(int.__xor__, payload) == data[-1]
        elif reduce(int.__xor__, payload) != data[-1]:
            kinds["sum"] += 1
        else:
            kinds["good"] += 1
    assert (kinds["length"], kinds["sum"], kinds["cut"]) == (3, 3, 1)
    assert kinds["good"] > 200


def test_a_busy_device_refuses_and_scans_go_on_and_a_silent_one_keeps_its_port(day: Bench) -> None:
    assert day.decoded(12.1, 12.9) > 35
    assert day.decoded(8.4, 9.5) == 0
    assert day.decoded(20.1, 21.9) == 0
