"""0x5E4 to 0x5E8 of the ESR, read at the bits of Apollo's parsers.

Source of every position: ApolloAuto/apollo, modules/drivers/delphi_esr/protocol/esr_status5_5e4.cc to
esr_status9_5e8.cc (`Byte(bytes + n).get_byte(start, length)`); delphi_esr_message_manager.h publishes on 0x5E5.
"""

from __future__ import annotations

from typing import Any

import pytest

from tests.protocols.can_objects.rig import MS, start, thing

RADIATE, VEHICLE = "4F1 00 64 00 00 00 00 BF 2C", "4F0 14 00 00 00 00 00 00 00"


def byte(data: bytes, index: int, first: int, length: int) -> int:
    """`Byte t(bytes + index); t.get_byte(first, length)` of Apollo."""
    return data[index] >> first & (1 << length) - 1


def signed(value: int, bits: int) -> int:
    return value - (1 << bits) if value >> bits - 1 else value


def apollo(data: dict[int, bytes]) -> dict[str, float]:
    """What Apollo's message has of the five frames."""
    five, six, seven, eight, nine = (data[0x5E4 + k] for k in range(5))
    names = "swbatt ignp temp1 temp2 supply_5va supply_5vdx supply_3p3v supply_10v"
    found: dict[str, float] = {name: byte(five, k, 0, 8) for k, name in enumerate(names.split())}
    found |= {name: byte(six, k, 0, 8) for k, name in enumerate(("supply_1p8v", "supply_n5v", "wave_diff"))}
    found |= {
        "system_power_mode": byte(six, 3, 0, 3),
        "vertical_align_updated": byte(six, 3, 3, 1),
        "factory_align_status_2": byte(six, 4, 0, 3),
        "factory_align_status_1": byte(six, 4, 3, 3),
        "found_target": byte(six, 4, 7, 1),
        "factory_misalignment": signed(byte(six, 5, 0, 8), 8) * 0.0625,
        "vertical_misalignment": signed(byte(six, 7, 0, 8), 8) * 0.0625,
        "avg_pwr_cwblkg": byte(nine, 0, 0, 8) << 4 | byte(nine, 1, 4, 4),
        "sideslip_angle": signed(byte(nine, 1, 0, 2) << 8 | byte(nine, 2, 0, 8), 10) * 0.125,
        "serial_num_3rd_byte": byte(nine, 3, 0, 8),
        "water_spray_target_id": byte(nine, 4, 1, 7),
        "filtered_xohp_acc_cipv": signed(byte(nine, 4, 0, 1) << 8 | byte(nine, 5, 0, 8), 9) * 0.03125,
        "path_id_acc_2": byte(nine, 6, 0, 8),
        "path_id_acc_3": byte(nine, 7, 0, 8),
    }
    found |= {f"active_fault_{k}": byte(seven, k, 0, 8) for k in range(8)}
    return found | {f"history_fault_{k}": byte(eight, k, 0, 8) for k in range(8)}


def cycles(objects: Any, *said: str, **device: Any) -> list[dict[str, float]]:
    rig = start({"format": "esr", **device}, objects)
    rig.session.advance(rig.now_ns)
    for frame in said:
        rig.hear(frame)
    rig.run(0.24)
    found: list[dict[int, bytes]] = []
    for emission in rig.sent:
        assert emission.address is not None
        if emission.address.peer == 0x5E4:
            found.append({})
        if 0x5E4 <= emission.address.peer <= 0x5E8:
            found[-1][emission.address.peer] = emission.payload
    return [apollo(one) for one in found if len(one) == 5]


def test_apollo_gets_a_publishing_frame_behind_all_tracks_of_each_cycle() -> None:
    rig = start({"format": "esr", "radiate": "always"}, [thing(1, 20.0, 0.0)])
    peers = [(e.address.peer, e.due_ns) for e in rig.run(0.5) if e.address]
    published = [due_ns for peer, due_ns in peers if peer == 0x5E5]
    tracks = [due_ns for peer, due_ns in peers if peer == 0x53F]
    assert len(published) >= 9
    assert all(0 < late - track < 10 * MS for track, late in zip(tracks, published, strict=False))


def test_power_mode_tells_whether_it_radiates() -> None:
    assert {one["system_power_mode"] for one in cycles([])} == {1}  # CAN_TX_SYSTEM_POWER_MODE_RADIATE_OFF
    assert {one["system_power_mode"] for one in cycles([], RADIATE, VEHICLE)} == {2}  # ..._RADIATE_ON


def test_the_tracks_ahead_are_told_in_their_order_and_the_first_ones_offset() -> None:
    # 10 m/s: what stands over ground comes nearer at that speed; these four move
    ahead = [thing(k, 20.0 + 10 * k, y, velocity_m_s=(0.0, 0.0, 0.0)) for k, y in ((1, 0.5), (2, 0.0), (3, -1.0))]
    beside = thing(4, 15.0, 6.0)
    found = cycles([beside, *ahead], RADIATE, VEHICLE)[-1]
    # numbers go to the nearest first: beside is 1, then 2, 3, 4
    assert (found["path_id_acc_2"], found["path_id_acc_3"]) == (3, 4)
    assert found["filtered_xohp_acc_cipv"] == pytest.approx(-0.5)  # to the left, clockwise positive
    alone = cycles([beside], RADIATE, VEHICLE)[-1]
    assert (alone["path_id_acc_2"], alone["path_id_acc_3"], alone["filtered_xohp_acc_cipv"]) == (0, 0, 0.0)


def test_counts_faults_and_the_serial_number_are_those_of_the_scenario() -> None:
    counts, active, past = list(range(11)), list(range(20, 28)), list(range(30, 38))
    device = {"analogue": counts, "active_faults": active, "past_faults": past, "serial_number": 0xAB1234}
    found = cycles([], **device)[0]
    names = "swbatt ignp temp1 temp2 supply_5va supply_5vdx supply_3p3v supply_10v supply_1p8v supply_n5v wave_diff"
    assert [found[name] for name in names.split()] == counts
    assert [found[f"active_fault_{k}"] for k in range(8)] == active
    assert [found[f"history_fault_{k}"] for k in range(8)] == past
    assert found["serial_num_3rd_byte"] == 0xAB
    rest = "vertical_align_updated factory_align_status_1 factory_align_status_2 found_target factory_misalignment"
    rest += " vertical_misalignment avg_pwr_cwblkg sideslip_angle water_spray_target_id"
    assert {found[name] for name in rest.split()} == {0}
