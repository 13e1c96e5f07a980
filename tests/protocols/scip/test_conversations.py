"""Conversations in virtual time: start-ups of drivers, every command in every state, times of replies and scans."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.scip.commands import COMMANDS
from protocols.scip.device import UNSTABLE, VERIFY_NS
from protocols.scip.models import MODELS
from protocols.session import Address, Dropped, DropReason, LinkKind
from tests.protocols.scip.rig import LINE, MS, SECOND, Rig, number, read

FULL = "0000108001"
ONE, TWO = Address(0, 1), Address(0, 2)
REPLY_NS = MS


def test_worked_exchanges_of_the_specification() -> None:
    rig = Rig()
    rig.session.clock = rig.session.clock.set_to(rig.now_ns, 0)
    assert rig.status("BM") == "00"
    rig.put("GD0000000301\n")
    rig.run(60 * MS)
    text = rig.raw().decode()
    assert text.startswith("GD0000000301\n00P\n00")
    assert text.endswith("\n0?X0?]0?b0?gj\n\n")
    rig.put("GE0000000101\n")
    rig.run(60 * MS)
    assert rig.raw().endswith(b"\n0?X0O@0?]0OAB\n\n")
    rig.put("MD0000000301001\n")
    rig.run(60 * MS)
    text = rig.raw().decode()
    assert text.startswith("MD0000000301001\n00P\n\nMD0000000301000\n99b\n")
    assert text.endswith("\n0?X0?]0?b0?gj\n\n")
    rig.put("XX\n")
    rig.run(2 * MS)
    assert rig.raw() == b"XX\n0Ee\n\n"


def test_a_whole_scan_has_51_lines_of_which_the_last_is_short() -> None:
    rig = Rig()
    rig.put(f"MD{FULL}001\n")
    rig.run(60 * MS)
    lines = rig.raw().split(b"\n\n")[1].split(b"\n")
    assert lines[3] == b"0?X0?]0?b0?g0?l0@10@60@;0@@0@E0@J0@O0@T0@Y0@^0@c0@h0@m0A20A70A<0`"
    assert len(lines) == 3 + 51
    assert (len(lines[-1]), lines[-1][-1:]) == (44, b"k")


URG_C = ["QT", "PP", "VV", "II", "TM0", "TM1", "TM2", "BM", f"GD{FULL}", f"MD{FULL}003", "QT", f"MD{FULL}100", "QT",
         f"ME{FULL}000", "QT", "MD0360072003002", "QT"]  # fmt: skip
URG_NODE = ["QT", "PP", f"ME{FULL}000", "QT", "VV", "II", *["VV"] * 8, "II", "II", f"ME{FULL}000", "QT"]
CALIBRATED = ["QT", "PP", *["TM0", "TM1", "TM2", f"ME{FULL}000", "QT"] * 10]
MULTI_ECHO = ["QT", "PP", f"ND{FULL}000", "QT", f"NE{FULL}000", "QT"]
MRPT = [*["QT", "QT", "SCIP2.0", "BM", "HS0", "PP", "VV", f"MD{FULL}000"] * 2, "QT", "QT"]
MRPT_SERIAL = ["QT", "QT", "SCIP2.0", "SS115200", "SCIP2.0", "BM", "HS0", "PP", "VV", f"MD{FULL}000", "QT", "QT"]


@pytest.mark.parametrize("trace", [URG_C, URG_NODE, CALIBRATED, MRPT, MRPT_SERIAL], ids=str)
@pytest.mark.parametrize("chunk", [1, 5, 100])
def test_start_ups_of_drivers_are_answered_in_order(trace: list[str], chunk: int) -> None:
    rig = Rig()
    for command in trace:
        text = command + "\n"
        for at in range(0, len(text), chunk):
            rig.put(text[at : at + chunk])
        rig.run(100 * MS)
        first, *blocks = rig.take()
        assert first.echo == command
        assert first.status in ("00", *{"SCIP2.0": ["0E"], "HS0": ["03"], "SS115200": ["04"]}.get(command, [])), command
        assert bool(blocks) == (command[0] == "M"), command
        for block in blocks:
            assert (block.status, block.echo[:13]) == ("99", command[:-2])
            steps = 1 + int(command[6:10]) - int(command[2:6])
            assert len(block.data) == -(-steps // int(command[10:12])) * (6 if command[1] == "E" else 3)


def test_urg_node_s_start_up_with_several_echoes() -> None:
    rig = Rig("hokuyo-utm-30lx-ew", kind=LinkKind.STREAM)
    rig.session.connected(0, ONE, LinkKind.STREAM)
    for command in MULTI_ECHO:
        rig.put(command + "\n", ONE)
        rig.run(100 * MS)
        first, *blocks = rig.take(ONE)
        assert (first.echo, first.status) == (command, "00")
        assert bool(blocks) == (command[0] == "N")
    plain = Rig()
    assert plain.status(f"ND{FULL}000") == "0E", "urg_c falls back at this status"


def test_the_count_goes_down_and_the_laser_stays_on() -> None:
    rig = Rig()
    rig.put(f"MD{FULL}005;tag\n")
    rig.run(SECOND)
    assert [(one.echo, one.status) for one in rig.take()] == [
        (f"MD{FULL}005;tag", "00"),
        *((f"MD{FULL}0{left:02d};tag", "99") for left in (4, 3, 2, 1, 0)),
    ]
    assert rig.status("BM") == "02"


@pytest.mark.parametrize(("skip", "period_ms"), [(0, 25), (1, 50), (9, 250)])
def test_stamps_and_instants_of_scans_follow_the_turns(skip: int, period_ms: int) -> None:
    rig = Rig()
    rig.put(f"MS0000108004{skip}00\n")
    rig.run(3 * SECOND)
    scans = rig.take()[1:]
    assert len(scans) == pytest.approx(3000 / period_ms, abs=2)
    for one, other in pairwise(scans):
        assert other.stamp - one.stamp == period_ms
        assert other.due_ns - one.due_ns == period_ms * MS
    # the block leaves after step 1080 of 1440, which is 18.75 ms after the stamp
    assert 18.75 <= scans[0].due_ns / MS - scans[0].stamp <= 20.5
    assert len(scans[0].data) == 2 * 271


def test_time_stamps_wrap_at_24_bits() -> None:
    rig = Rig()
    rig.session.clock = rig.session.clock.set_to(rig.now_ns, (2**24 - 100) * MS)
    rig.put("MD0000000001000\n")
    rig.run(SECOND)
    reported = [one.reported for one in rig.sent if one.reported is not None]
    assert {one.bits for one in reported} == {24}
    stamps = [one.stamp for one in rig.take()[1:]]
    assert [one.ticks for one in reported] == stamps
    assert max(stamps) < 2**24
    assert {(other - one) % 2**24 for one, other in pairwise(stamps)} == {25}
    assert any(other < one for one, other in pairwise(stamps))


def test_time_mode() -> None:
    rig = Rig()
    assert [rig.status(one) for one in ("TM1", "TM2", "TM3", "TM", "TM00")] == ["04", "03", "01", "0C", "0C"]
    assert rig.status("BM") == "00"
    assert rig.status("TM0") == "00"
    assert rig.status("TM0") == "02"
    rig.run(17 * MS)
    asked_ns = rig.now_ns
    assert number(rig.ask("TM1").lines[0]) == (asked_ns + REPLY_NS) // MS
    assert [rig.status(one) for one in ("QT", "BM", f"MD{FULL}000")] == ["0E"] * 3
    assert rig.status("II") == rig.status("TM2") == "00"
    assert rig.status(f"GD{FULL}") == "10", "the laser is off since TM0"


def test_wrong_parameters_have_the_statuses_of_the_specification() -> None:
    rig = Rig()
    cases = {
        "MDx000108001000": "01", "MD0000x08001000": "02", "MD00001080x1000": "03", "MD0000108101000": "04",
        "MD0100009901000": "05", "MD0000108001x00": "06", "MD00001080010x0": "07", "MD000010800100": "0C",
        "MD00001080010000": "0C", "GD000010800": "0C", "SS12a400": "01", "BMx": "0C", "HS2": "03", "CR05": "03",
        "DBxx": "01", "%XX": "0E", "m": "0E", "$IP": "0E", f"VV;{'x' * 17}": "0H",
    }  # fmt: skip
    for command, wanted in cases.items():
        assert rig.status(command) == wanted, command
    assert rig.status(f"VV;{'x' * 16}") == "00"
    new = Rig("hokuyo-ust-10lx")
    assert [new.status(one) for one in ("MD0", "BMx", f"VV;{'x' * 17}")] == ["0H", "0D", "0G"]


def test_a_second_measurement_replaces_the_first_and_one_scan_comes_beside_it() -> None:
    rig = Rig()
    rig.put(f"MD{FULL}000\n")
    rig.run(200 * MS)
    rig.take()
    rig.put("GE0000000101\n")
    rig.run(100 * MS)
    echoes = [one.echo for one in rig.take()]
    assert echoes.count("GE0000000101") == 1
    assert echoes.count(f"MD{FULL}000") >= 3
    rig.put("MS0000000301000\n")
    rig.run(200 * MS)
    echoes = [one.echo for one in rig.take()]
    assert f"MD{FULL}000" not in echoes[echoes.index("MS0000000301000") :]


def test_a_counted_measurement_keeps_its_count_when_one_scan_is_asked_beside_it() -> None:
    rig = Rig()
    rig.put(f"MD{FULL}020\n")
    rig.run(130 * MS)  # several scans are measured ahead, and withdrawn by what follows
    rig.put("GD0000000301\n")
    rig.run(SECOND)
    left = [int(one.echo[-2:]) for one in rig.take() if one.status == "99"]
    assert left == list(range(19, -1, -1))


@pytest.mark.parametrize("asked_ms", [0, 13, 26, 60, 99])
def test_one_scan_asked_beside_it_does_not_disturb_a_measurement_that_skips(asked_ms: int) -> None:
    rig = Rig()
    rig.put("MD0000000301300\n")
    rig.run(500 * MS + asked_ms * MS)
    rig.put("GD0000000301\n")
    rig.run(SECOND)
    found = rig.take()
    scans = [one for one in found if one.status == "99"]
    assert {later.stamp - one.stamp for one, later in pairwise(scans)} == {100}
    assert len(scans) in (15, 16)
    (single,) = [one for one in found if one.echo[:2] == "GD"]
    assert single.status == "00"
    assert single.due_ns - (500 + asked_ms) * MS - 10 * MS < 60 * MS, "the next turn is taken"
    assert "no measurement" not in {one.detail for one in rig.events if isinstance(one, Dropped)}


def test_quitting_withdraws_what_has_not_begun() -> None:
    rig = Rig()
    rig.put(f"MD{FULL}000\n")
    rig.run(500 * MS)
    rig.take()
    rig.put("QT\n")
    rig.run(SECOND)
    assert [(one.echo, one.status) for one in rig.take()] == [("QT", "00")]
    assert DropReason.STALE in rig.dropped()
    assert rig.session.next_plan() is None


def test_restarts() -> None:
    rig = Rig(device={"boot_s": 1.0, "spin_up_s": 2.0})
    rig.run(4 * SECOND)
    assert rig.status("BM") == "00"
    assert rig.status("RB") == "01"
    rig.run(1100 * MS)
    assert rig.status("RB") == "01", "the second came too late"
    assert rig.status("RB") == "00"
    rig.put("VV\n")
    rig.run(900 * MS)
    assert rig.take() == []
    rig.run(200 * MS)
    assert rig.status("BM") == "01", "its motor is not at speed"
    reply = rig.ask("II")
    assert "LASR:OFF;" in reply.lines
    assert "STAT:Unstable 000 no error.;" in reply.lines
    rig.put(f"MD{FULL}001\n")
    rig.run(2 * SECOND)
    first, scan = rig.take()
    assert (first.status, scan.status) == ("00", "99")
    assert scan.stamp >= 2000


def test_resets_set_laser_and_time() -> None:
    rig = Rig()
    rig.run(SECOND)
    rig.status("BM")
    assert rig.status("RT") == "00"
    assert rig.status(f"GD{FULL}") == "10"
    rig.status("TM0")
    assert number(rig.ask("TM1").lines[0]) > 1000, "SCIP 2.0: RT keeps the time"
    assert rig.status("RS") == "00"
    rig.status("TM0")
    assert number(rig.ask("TM1").lines[0]) < 10


def test_bit_rates_change_behind_the_reply_on_rs232() -> None:
    rig = Rig("hokuyo-urg-04lx", {"port": "rs232"})
    assert [one.line_speed for one in rig.sent] == [19_200]
    rig.sent.clear()
    rig.put("SS115200\n")
    rig.run(2 * MS)
    (emission,) = rig.sent
    assert (emission.payload, emission.line_speed) == (b"SS115200\n00P\n\n", 115_200)
    rig.sent.clear()
    assert [rig.status(one) for one in ("SS115200", "SS123456", "SSabcdef")] == ["03", "02", "01"]
    assert "SBPS:115200[bps];" in rig.ask("II").lines
    rig.put("RS\n")
    rig.run(2 * MS)
    assert rig.sent[-1].line_speed == 19_200


def test_a_line_slower_than_the_scans_skips_scans_and_reports_them() -> None:
    rig = Rig("hokuyo-urg-04lx", {"port": "rs232"})
    rig.put("MD0044072501000\n")
    rig.run(20 * SECOND)
    sent, size = rig.take()[1:], 2170
    assert len(sent) == pytest.approx(20 * 1920 / size, abs=2)
    busy = sum(one.count for one in rig.events if isinstance(one, Dropped) and one.reason is DropReason.LINE_BUSY)
    assert busy + len(sent) == pytest.approx(200 + 2, abs=4)


def test_scip_1_1_and_the_way_out_of_it() -> None:
    rig = Rig("hokuyo-urg-04lx", {"protocol": "SCIP1.1"})

    def said(command: str, within_ns: int = 2 * MS) -> bytes:
        rig.put(command + "\n")
        rig.run(within_ns)
        return rig.raw()

    assert said("QT") == b"QT\nE\n\n"
    assert said("VV") == b"VV\nE\n\n"
    version = said("V")
    assert version.startswith(b"V\n0\nVEND:Hokuyo")
    assert b"\nPROT:SCIP 1.1\n" in version
    data = said("G04472501", 300 * MS).split(b"\n")
    assert data[:2] == [b"G04472501", b"0"]
    assert [len(line) for line in data[2:-2]] == [64] * 21 + [20]
    assert number(data[2][:2].decode()) == 1000
    wide = b"".join(said("G00076801", 300 * MS).split(b"\n")[2:])
    assert len(wide) == 2 * 769, "Player's urglaser asks for all of them"
    assert wide[:88] == b"0" * 88
    assert number(wide[88:90].decode()) == 1000
    assert [said(one) for one in ("L0", "L2", "G04472501", "G0")] == [
        b"L0\n0\n\n", b"L2\n1\n\n", b"G04472501\n6\n\n", b"G0\n3\n\n"]  # fmt: skip
    assert said("SCIP2.0") == b"SCIP2.0\n0\n\n"
    assert said("SCIP2.0") == b"SCIP2.0\n0Ee\n\n"
    assert read(said("QT"))[0].status == "00"


def test_sleep_and_its_states() -> None:
    rig = Rig("hokuyo-ust-10lx", {"spin_up_s": 0.2})
    rig.run(SECOND)
    states = [rig.ask("%ST").lines]
    for command in ("BM", f"MD{FULL}000", "QT", "TM0", "TM2", "%SL", "QT"):
        rig.put(command + "\n")
        rig.run(30 * MS)
        rig.take()
        rig.put("%ST\n")
        rig.run(2 * MS)
        states.append(next(one for one in rig.take() if one.echo == "%ST").lines)
    assert [one for (one,) in states] == ["000", "003", "004", "000", "002", "000", "005", "100"]
    rig.run(SECOND)
    assert rig.ask("%ST").lines == ["000"]
    assert rig.ask("%SL").status == "00"
    assert rig.status("BM") == "01"
    assert rig.status(f"MD{FULL}000") == "10"
    assert Rig().status("%SL") == "0E"


@pytest.mark.parametrize("model", ["hokuyo-utm-30lx", "hokuyo-ust-10lx"])
def test_a_motor_that_stops_interrupts_and_at_last_fails(model: str) -> None:
    rig = Rig(model)
    rig.put(f"MD{FULL}000\n")
    rig.run(200 * MS)
    rig.take()
    assert rig.session.impair(rig.now_ns, "motor stopped", 1.0)
    rig.run(SECOND)
    assert [one.status for one in rig.take()] == [UNSTABLE[MODELS[model].protocol]]
    assert rig.session.next_plan() is None
    assert rig.session.impair(rig.now_ns, "motor stopped", 0.0)
    rig.run(SECOND)
    again = [one.status for one in rig.take()]
    assert again.count("99") == pytest.approx(40, abs=2)
    assert (again[0] == "98") == (model == "hokuyo-utm-30lx")
    rig.session.impair(rig.now_ns, "motor stopped", 1.0)
    rig.run(VERIFY_NS + SECOND)
    errors = MODELS[model].errors
    assert rig.take()[-1].status == errors["abnormal"]
    assert rig.status(f"MD{FULL}000") == errors["abnormal"]
    assert rig.status("BM") == "01"
    assert "STAT:Abnormal 900 abnormal condition.;" in rig.ask("II").lines
    rig.status("RB")
    assert rig.status("RB") == "00"


def test_faults_of_the_motor_hold_each_by_itself_and_over_a_restart() -> None:
    rig = Rig()
    for what, degree in (("motor speed", 0.5), ("motor stopped", 1.0), ("motor stopped", 0.0)):
        assert rig.session.impair(rig.now_ns, what, degree)
    assert rig.ask("II").lines[3] == "MESM:100 Idle;", "it is free again, and still too slow"
    rig.session.impair(rig.now_ns, "motor speed", 1.0)
    assert rig.ask("II").lines[3] == "MESM:000 Idle;"
    rig.session.impair(rig.now_ns, "motor stopped", 1.0)
    assert [rig.status("RB"), rig.status("RB")] == ["01", "00"]
    rig.run(SECOND)
    assert rig.ask("II").lines[3] == "MESM:100 Idle;", "it starts with a motor that stands"
    rig.run(2 * SECOND)
    assert rig.ask("II").lines[3] == "MESM:900 Error detected;"


def test_a_simulated_malfunction_ends_with_a_reset() -> None:
    rig = Rig()
    rig.put(f"MD{FULL}000\n")
    rig.run(100 * MS)
    rig.take()
    rig.put("DB05\n")
    rig.run(2 * MS)
    assert sorted((one.echo[:2], one.status) for one in rig.take()) == [("DB", "00"), ("MD", "50")]
    assert rig.status(f"GD{FULL}") == "50"
    assert rig.status("RS") == "00"
    assert rig.status("BM") == "00"
    ill = Rig(device={"condition": "abnormal"})
    assert [ill.status(one) for one in ("BM", "RS", "BM")] == ["01", "00", "01"]


def test_motor_speed_and_sensitivity() -> None:
    rig = Rig("hokuyo-urg-04lx")
    assert [rig.status(one) for one in ("CR05", "CR05", "CR11", "HS1", "HS1", "HSx")] == [
        "00",
        "02",
        "01",
        "00",
        "02",
        "01",
    ]
    rig.put("MD0044072501000\n")
    rig.run(2 * SECOND)
    scans = rig.take()[1:]
    assert scans[-1].stamp - scans[0].stamp == pytest.approx((len(scans) - 1) * 100 / 0.95, abs=1)
    assert rig.session.next_plan().gain == 2.0  # type: ignore[union-attr]
    rig.status("QT")
    assert [rig.status(one) for one in ("CR99", "RS", "CR99")] == ["00", "00", "02"]


def test_ethernet_serves_one_client_and_the_next_when_it_has_gone() -> None:
    rig = Rig("hokuyo-ust-10lx", kind=LinkKind.STREAM)
    for one in (ONE, TWO):
        rig.session.connected(rig.now_ns, one, LinkKind.STREAM)
    rig.put(f"MD{FULL}000\n", ONE)
    rig.put("VV\n", TWO)
    rig.run(200 * MS)
    assert rig.take(TWO) == []
    assert len(rig.take(ONE)) > 5
    rig.session.disconnected(rig.now_ns, ONE)
    rig.run(200 * MS)
    assert rig.take(ONE) == []
    assert [one.echo for one in rig.take(TWO)] == ["VV"]
    assert rig.session.next_plan() is None


def test_a_client_that_connects_during_the_boot_is_served_after_it() -> None:
    rig = Rig("hokuyo-ust-10lx", {"boot_s": 1.0, "spin_up_s": 2.0}, kind=LinkKind.STREAM)
    rig.session.connected(rig.now_ns, ONE, LinkKind.STREAM)
    rig.put("V", ONE)
    rig.put("V\n%ST\n" + "x" * 2000, ONE)
    rig.run(1900 * MS)
    assert rig.take() == []
    assert rig.dropped() == [DropReason.BUSY]
    rig.run(200 * MS)
    replies = rig.take(ONE)
    assert [(one.echo, one.due_ns) for one in replies] == [(one, 2 * SECOND + REPLY_NS) for one in ("VV", "%ST")]
    assert replies[1].lines == ["000"], "it waits for its motor before it answers"
    line = Rig(device={"boot_s": 2.0})
    line.put("VV\n")
    line.run(3 * SECOND)
    assert line.take() == [], "no one keeps the input of a serial line"


@given(
    st.binary(max_size=60).filter(lambda data: b"\n" not in data and b"\r" not in data),
    st.sampled_from("\n \r \r\n".split(" ")),
)
def test_garbage_before_and_behind_a_request_costs_one_line(noise: bytes, end: str) -> None:
    rig = Rig()
    rig.session.receive(noise + b"\n", rig.now_ns, LINE)
    rig.put("VV" + end)
    rig.session.receive(noise + b"\n", rig.now_ns, LINE)
    rig.run(3 * SECOND)
    assert rig.raw().count(b"VV\n00P\nVEND:") >= 1


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("state", ["idle", "laser", "stream", "time", "sleep", "abnormal", "starting"])
def test_every_command_in_every_state_has_one_reply(model: str, state: str) -> None:
    device = {"condition": "abnormal"} if state == "abnormal" else {"spin_up_s": 5.0} if state == "starting" else {}
    first, last = MODELS[model].first, MODELS[model].last
    steps = f"{first:04d}{last:04d}01"
    before = {"laser": "BM", "stream": f"MD{steps}000", "time": "TM0", "sleep": "%SL"}.get(state)
    for code in (code.decode() for code in COMMANDS if not code.startswith(b"1.1")):
        rig = Rig(model, device)
        rig.run(5 * SECOND if MODELS[model].protocol == "SCIP 2.2" and state == "starting" else 0)
        if before:
            rig.put(before + "\n")
            rig.run(30 * MS)
            rig.take()
        more = {"SS": "115200", "TM": "0", "CR": "01", "HS": "1", "DB": "01"}.get(code, "")
        more = steps if code[0] in "GH" else steps + "001" if code[0] in "MN" else more
        rig.put(f"{code}{more}\n")
        rig.run(400 * MS)
        replies = [one for one in rig.take() if one.echo == code + more and one.status not in ("99", "50", "0L")]
        refused = state == "abnormal" or code == "DB"
        assert len(replies) == 1 or refused, (code, replies)
