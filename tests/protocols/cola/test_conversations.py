"""Start-up conversations of public drivers, with their limits, under the virtual clock.

Requests as the specification has them (sections 4.1 to 4.6 of sick_cola.md, 2 of sick_cola_models.md: received from
unmodified drivers). Replies are judged as the drivers do.
"""

from __future__ import annotations

from itertools import pairwise

import pytest

from protocols.session import DropReason
from tests.protocols.cola.reader import read, read_a, read_b
from tests.protocols.cola.rig import MS, SECOND, Rig


def until_seven(rig: Rig, limit_ns: int) -> None:
    """Poll STlms once a second; the character behind the name must become 7."""
    until = rig.now_ns + limit_ns
    while rig.a("sRN STlms")[10] != "7":
        assert rig.now_ns < until
        rig.run(SECOND)


def test_clearpath_connects_while_the_device_starts_and_gets_every_scan() -> None:
    """CLP: asks for the login every second until something comes; 100 ms without data count as a miss."""
    rig = Rig(up=False)
    for _ in range(10):
        rig.put(b"\x02sMN SetAccessMode 03 F4724744\x03")
        rig.run(SECOND)
        if any(one.payload for one in rig.sent):
            break
    assert rig.next()[1] == b"sAN SetAccessMode 1"
    rig.run(100 * MS)
    rig.sent.clear()
    for asked, wanted in [
        ("sRN LMPscancfg", "sRA LMPscancfg 1388 1 1388 FFF92230 225510"),
        ("sRN LMPoutputRange", "sRA LMPoutputRange 1 1388 FFF92230 225510"),
        ("sWN LMDscandatacfg 01 00 1 1 0 00 00 0 0 0 0 +1", "sWA LMDscandatacfg"),
        ("sMN LMCstartmeas", "sAN LMCstartmeas 0"),
    ]:
        reported = rig.a(asked)
        assert reported == wanted
        assert len(reported) < 100
    until_seven(rig, 60 * SECOND)
    assert rig.a("sMN Run") == "sAN Run 1"
    assert rig.a("sEN LMDscandata 1") == "sEA LMDscandata 1"
    for _ in range(100):
        scan = rig.scan(within_ns=100 * MS)
        assert len(scan.mm()) == len(scan.mm("RSSI1")) == 541 <= 1082
    # reconfiguration
    rig.forget()
    rig.a("sEN LMDscandata 0")
    rig.log_in()
    assert rig.a("sMN mLMPsetscancfg 9C4 +1 9C4 FFF92230 225510") == "sAN mLMPsetscancfg 0 9C4 1 9C4 FFF92230 225510"
    assert rig.a("sMN mEEwriteall") == "sAN mEEwriteall 1"
    rig.a("sEN LMDscandata 1")
    first = rig.scan(within_ns=30 * SECOND)
    begun = rig.now_ns
    for _ in range(25):
        assert len(rig.scan(within_ns=100 * MS).mm()) == 1081
    assert len(first.mm()) == 1081
    assert rig.now_ns - begun == pytest.approx(SECOND, rel=1e-6)
    assert rig.a_last("sEN LMDscandata 0") == "sEA LMDscandata 0"
    assert rig.a("sMN LMCstopmeas") == "sAN LMCstopmeas 0"
    rig.forget()
    rig.run(SECOND)
    assert not rig.sent


XD_LMS1XX = [
    ("sRN SCdevicestate", "", None),
    ("sMN SetAccessMode", "03f4724744", b"sAN SetAccessMode \x01"),
    ("sWN EIHstCola", "01", b"sWA EIHstCola "),
    ("sRN FirmwareVersion", "", b"sRA FirmwareVersion \x00\x05V1.80"),
    ("sRN SCdevicestate", "", None),
    ("sRN ODoprh", "", None),
    ("sRN ODpwrc", "", None),
    ("sRN LocationName", "", b"sRA LocationName \x00\x0bnot defined"),
    ("sRN LMPoutputRange", "", b"sRA LMPoutputRange " + bytes.fromhex("000100001388fff9223000225510")),
    ("sWN LMPoutputRange", "000100001388fff922330022550d", b"sWA LMPoutputRange "),
    ("sRN LMPoutputRange", "", b"sRA LMPoutputRange " + bytes.fromhex("000100001388fff922330022550d")),
    *[(f"sRN field{number:03d}", "", None) for number in range(30)],
    ("sRN LIDinputstate", "", None),
    ("sWN LMDscandatacfg", "01000000000000000000010001", b"sWA LMDscandatacfg "),
    ("sRN LMDscandatacfg", "", b"sRA LMDscandatacfg " + bytes.fromhex("01000000000000000000010001")),
    ("sMN mLMPsetscancfg", "00001388000100001388fff9223000225510",
     b"sAN mLMPsetscancfg " + bytes.fromhex("0000001388000100001388fff9223000225510")),
    ("sRN LMPscancfg", "", b"sRA LMPscancfg " + bytes.fromhex("00001388000100001388fff9223000225510")),
    ("sEN LFErec", "01", b"sEA LFErec \x01"),
    ("sEN LIDoutputstate", "01", b"sEA LIDoutputstate \x01"),
    ("sEN LIDinputstate", "01", b"sEA LIDinputstate \x01"),
    ("sMN LMCstartmeas", "", b"sAN LMCstartmeas \x00"),
    ("sMN Run", "", b"sAN Run \x01"),
]  # fmt: skip


def ask_all(rig: Rig, trace: list[tuple[str, str, bytes | None]]) -> None:
    for name, data, wanted in trace:
        reported = rig.b(name, data)
        assert not reported.startswith(b"sFA"), name
        assert reported.split(b" ")[1] == name.split(" ")[1].encode()
        if wanted is not None:
            assert reported == wanted


def ready(rig: Rig) -> None:
    """XD polls SCdevicestate every second, at most 45 times, until it is 1."""
    for _ in range(45):
        if rig.b("sRN SCdevicestate") == b"sRA SCdevicestate \x01":
            return
        rig.run(SECOND)
    raise AssertionError("never ready")


@pytest.mark.parametrize("up", [True, False])
def test_the_vendors_driver_starts_an_lms1xx(up: bool) -> None:
    rig = Rig(up=up)
    rig.run(2 * SECOND)
    ask_all(rig, XD_LMS1XX)
    ready(rig)
    assert rig.b("sEN LMDscandata", "01") == b"sEA LMDscandata \x01"
    for _ in range(100):
        scan = rig.scan(within_ns=100 * MS)
        assert len(scan.mm()) == 541, "float-rounded limits are snapped to the grid"
        assert scan.channels["DIST1"][2] == -450_000
    assert scan.time is not None


def test_the_vendors_driver_in_cola_a_and_its_broken_command() -> None:
    rig = Rig()
    assert rig.a("sMN SetAccessMode 3 F4724744") == "sAN SetAccessMode 1"
    assert rig.a("sWN EIHstCola 0") == "sWA EIHstCola"
    assert rig.a("sWN LMPoutputRange 1 1388 FFF92233 22550D") == "sWA LMPoutputRange"
    assert rig.a("sWN LMDscandatacfg 1 0 0 0 0 0 0 0 0 0 1 1") == "sWA LMDscandatacfg"
    broken = r"sMN mLMPsetscancfg \x00\x00\x13\x88\x00\x01\x00\x00\x13\x88\xff\xf9\x22\x30\x00\x22\x55\x10"
    assert rig.a(broken) == "sFA 11"
    assert rig.a("sEN LMDscandata 1") == "sEA LMDscandata 1"
    assert read_a(rig.next()[1]).layer == 0


XD_TIM = [
    ("sRN SCdevicestate", "", b"sRA SCdevicestate \x00"),
    ("sMN SetAccessMode", "03f4724744", b"sAN SetAccessMode \x01"),
    ("sWN EIHstCola", "01", b"sWA EIHstCola "),
    ("sRN FirmwareVersion", "", None), ("sRN ODoprh", "", None), ("sRN ODpwrc", "", None),
    ("sRN LocationName", "", None), ("sRN LMPoutputRange", "", None),
    ("sWN LMPoutputRange", "000100000d05fff9223000225510", b"sWA LMPoutputRange "),
    ("sRN LMPoutputRange", "", b"sRA LMPoutputRange " + bytes.fromhex("000100000d05fff9223000225510")),
    ("sWN LMDscandatacfg", "01000101000000000000010001", b"sWA LMDscandatacfg "),
    ("sRN LMDscandatacfg", "", b"sRA LMDscandatacfg " + bytes.fromhex("01000101000000000000010001")),
    ("sMN LMCstartmeas", "", b"sAN LMCstartmeas \x00"),
    ("sMN Run", "", b"sAN Run \x01"),
    ("sEN LMDscandata", "01", b"sEA LMDscandata \x01"),
]  # fmt: skip


@pytest.mark.parametrize(("model", "points"), [("sick-tim551", 271), ("sick-tim561", 811), ("sick-tim571", 811),
                                               ("sick-tim781", 811)])  # fmt: skip
def test_the_vendors_driver_starts_a_tim(model: str, points: int) -> None:
    rig = Rig(model)
    if model == "sick-tim781":
        rig.log_in()
        for number in range(48):
            assert rig.b(f"sRN field{number:03d}").startswith(b"sRA")
    step = "00002710" if points == 271 else "00000d05"
    ask_all(rig, [(name, data.replace("00000d05", step), want and want.replace(b"\0\0\x0d\x05", bytes.fromhex(step)))
                  for name, data, want in XD_TIM])  # fmt: skip
    begun = rig.now_ns
    for _ in range(15):
        scan = read_b(rig.next()[1])
        assert len(scan.mm()) == len(scan.mm("RSSI1")) == points
        assert set(scan.wide) == {"DIST1", "RSSI1"}
        assert (scan.scan_frequency, scan.measuring_frequency) == (1500, 54 if points == 271 else 162)
        assert scan.sent_us - scan.scan_us == 6_300
    assert rig.now_ns - begun < SECOND + 120 * MS


def test_a_tim781_ships_with_one_degree() -> None:
    rig = Rig("sick-tim781")
    rig.b("sEN LMDscandata", "01")
    scan = rig.scan()
    assert len(scan.mm()) == 271
    assert scan.channels["DIST1"][3] == 10_000


XD_MRS = [
    ("sRN SCdevicestate", "", None), ("sMN SetAccessMode", "03f4724744", None), ("sWN EIHstCola", "01", None),
    ("sMN LMCstopmeas", "", b"sAN LMCstopmeas \x00"),
    ("sRN SetActiveApplications", "", b"sRA SetActiveApplications \x00\x01RANG\x01"),
    ("sRN DeviceIdent", "", b"sRA DeviceIdent \x00\x08MRS1xxxx\x00\x081.4.0.0R"),
    ("sWN SetActiveApplications", "0001" + b"FEVL".hex() + "00", None),
    ("sWN SetActiveApplications", "0001" + b"RANG".hex() + "01", None),
    ("sRN SerialNumber", "", None), ("sRN FirmwareVersion", "", None),
    ("sRN LocationName", "", b"sRA LocationName \x00\x0bSN 12345678"),
    ("sWN ScanLayerFilter", "000401010101", b"sWA ScanLayerFilter "),
    ("sMN Run", "", b"sAN Run \x01"), ("sMN SetAccessMode", "03f4724744", None),
    ("sRN LMPoutputRange", "", b"sRA LMPoutputRange " + bytes.fromhex("0001000009c4fff8c0880022b6b8")),
    ("sWN LMPoutputRange", "0001000009c4fff8c0880022b6b8", None),
    ("sWN LMDscandatacfg", "07000300000000000000010001", None),
    ("sWN FREchoFilter", "01", b"sWA FREchoFilter "),
    ("sMN LMCstartmeas", "", b"sAN LMCstartmeas \x00"), ("sMN Run", "", None),
]  # fmt: skip


def test_the_vendors_driver_starts_an_mrs1000() -> None:
    rig = Rig("sick-mrs1104")
    ask_all(rig, XD_MRS)
    ready(rig)
    assert rig.b("sEN LMDscandata", "01") == b"sEA LMDscandata \x01"
    assert rig.b_last("sEN InertialMeasurementUnit", "01") == b"sEA InertialMeasurementUnit \x01"
    rig.forget()
    scans, imu = [], 0
    while len(scans) < 9:
        dialect, payload = rig.next()
        if b"InertialMeasurementUnit" in payload:
            imu += 1
            assert len(payload) == 88
        else:
            scans.append(read(dialect, payload))
    layers = [scan.layer for scan in scans]
    at = layers.index(0)
    assert layers[at : at + 4] == [0, -250, 250, -500]
    assert all(len(scan.mm(f"DIST{echo}")) == 1101 for scan in scans for echo in (1, 2, 3))
    assert set(scans[0].wide) == {"DIST1", "DIST2", "DIST3", "ANGL1"}
    assert (scans[0].scan_frequency, scans[0].measuring_frequency) == (5000, 180)
    assert scans[1].scan_us - scans[0].scan_us == 20_000
    assert imu >= 15


XD_LMS5XX = [
    ("sRN SCdevicestate", "", None),
    ("sMN SetAccessMode", "03f4724744", b"sAN SetAccessMode \x01"),
    ("sWN EIHstCola", "01", b"sWA EIHstCola "),
    ("sRN FirmwareVersion", "", None), ("sRN SCdevicestate", "", None), ("sRN ODoprh", "", None),
    ("sRN ODpwrc", "", None), ("sRN LocationName", "", None),
    ("sRN LMPoutputRange", "", b"sRA LMPoutputRange " + bytes.fromhex("000100001388ffff3cb0001c3a90")),
    ("sWN LMPoutputRange", "000100001388ffff3cb0001c3a90", b"sWA LMPoutputRange "),
    ("sRN LMPoutputRange", "", b"sRA LMPoutputRange " + bytes.fromhex("000100001388ffff3cb0001c3a90")),
    *[(f"sRN field{number:03d}", "", None) for number in range(30)],
    ("sRN LIDinputstate", "", None),
    ("sWN LMDscandatacfg", "CONTENT", b"sWA LMDscandatacfg "),
    ("sRN LMDscandatacfg", "", None),
]  # fmt: skip
XD_LMS5XX_PAIR = [
    ("sMN Run", "", b"sAN Run \x01"),
    ("sMN SetAccessMode", "03f4724744", b"sAN SetAccessMode \x01"),
    ("sMN mLMPsetscancfg", "PAIR", None),
    ("sRN LMPscancfg", "", None),
]
XD_LMS5XX_END = [
    ("sWN FREchoFilter", "FILTER", b"sWA FREchoFilter "),
    ("sEN LFErec", "01", b"sEA LFErec \x01"),
    ("sEN LIDoutputstate", "01", b"sEA LIDoutputstate \x01"),
    ("sEN LIDinputstate", "01", b"sEA LIDinputstate \x01"),
    ("sMN LMCstartmeas", "", b"sAN LMCstartmeas \x00"),
    ("sMN Run", "", b"sAN Run \x01"),
]


def with_words(trace: list[tuple[str, str, bytes | None]], **words: str) -> list[tuple[str, str, bytes | None]]:
    return [(name, words.get(data, data), wanted) for name, data, wanted in trace]


@pytest.mark.parametrize(
    ("pair", "points", "hertz"),
    [(None, 381, 50), ("000009c4000100000683ffff3cb0001c3a90", 1141, 25),
     ("00002710000100001a0bffff3cb0001c3a90", 286, 100),
     ("00000dac0001000009c4ffff3cb0001c3a90", 761, 35)],
)  # fmt: skip
@pytest.mark.parametrize("echoes", [1, 5])
def test_the_vendors_driver_starts_an_lms5xx(pair: str | None, points: int, hertz: int, echoes: int) -> None:
    rig = Rig("sick-lms511")
    ask_all(rig, with_words(XD_LMS5XX, CONTENT=("01" if echoes == 1 else "1f") + "000100000000000000010001"))
    if pair is not None:
        ask_all(rig, with_words(XD_LMS5XX_PAIR, PAIR=pair))
        assert rig.b("sRN LMPscancfg") == b"sRA LMPscancfg " + bytes.fromhex(pair)
    ask_all(rig, with_words(XD_LMS5XX_END, FILTER="02" if echoes == 1 else "01"))
    assert rig.b("sEN LMDscandata", "01") == b"sEA LMDscandata \x01"
    begun = None
    for number in range(hertz + 1):
        scan = rig.scan(within_ns=5 * SECOND if number == 0 else 100 * MS)
        begun = rig.now_ns if begun is None else begun
        names = [f"DIST{one + 1}" for one in range(echoes)]
        assert [name for name in scan.channels if name.startswith("DIST")] == names
        assert all(len(scan.mm(name)) == points for name in names)
        assert scan.channels["DIST1"][2] == -50_000
        assert scan.scan_frequency == 100 * hertz
    assert begun is not None
    assert rig.now_ns - begun == pytest.approx(SECOND, rel=1e-6)


def test_aria_sets_up_an_lms5xx() -> None:
    """ARI needs 1, 0, 1 as results, exactly sEA and then sSN, and eight characters of scale and start angle."""
    rig = Rig("sick-lms511")
    rig.log_in()
    assert rig.a("sMN mLMPsetscancfg +7500 +1 +10000 -50000 +1850000")[19] == "0"
    assert rig.a("sRN LMPscancfg") == "sRA LMPscancfg 1D4C 1 2710 FFFF3CB0 1C3A90"
    assert rig.a("sMN LSPsetdatetime +2026 +11 +21 0 +37 +20 0") == "sAN LSPsetdatetime 1"
    assert rig.a("sWN LMDscandatacfg 1 0 0 0 0 0 0 0 0 0 1 +8") == "sWA LMDscandatacfg"
    assert rig.a("sWN LMPoutputRange +1 +10000 -50000 +1850000") == "sWA LMPoutputRange"
    assert rig.a("sWN FREchoFilter 0") == "sWA FREchoFilter"
    assert rig.a("sMN mEEwriteall") == "sAN mEEwriteall 1"
    rig.run(3 * SECOND)
    assert rig.a("sMN Run") == "sAN Run 1"
    until_seven(rig, 30 * SECOND)
    assert rig.a("sEN LMDscandata 1") == "sEA LMDscandata 1"
    scans = [rig.scan() for _ in range(4)]
    assert [len(scan.mm()) for scan in scans] == [191] * 4
    assert [two.scans - one.scans for one, two in pairwise(scans)] == [8, 8, 8]
    assert [two.telegrams - one.telegrams for one, two in pairwise(scans)] == [1, 1, 1]
    assert scans[0].time is not None
    assert scans[0].time[:5] == (2026, 11, 21, 0, 37)


def test_sicktoolbox_finds_what_it_reads_at_fixed_places() -> None:
    rig = Rig()
    assert rig.a("sRN LMPscancfg")[15:] == "1388 1 1388 FFF92230 225510"
    assert rig.a("sMN SetAccessMode 03 F4724744")[18] == "1"
    assert rig.a("sMN mLMPsetscancfg +2500 +1 +2500 -450000 +2250000")[19] == "0"
    rig.run(3 * SECOND)
    assert rig.a("sRN STlms")[10:13] == "7 0"
    assert rig.a("sMN LMCstartmeas")[17] == "0"
    rig.put(b"\x02sEN LMDscandata 1\x03")
    assert rig.next()[1].startswith(b"sEA")
    assert len(rig.scan().mm()) == 1081


def test_mrpt_polls_with_forty_milliseconds_of_patience() -> None:
    rig = Rig()
    rig.log_in()
    rig.a("sMN mLMPsetscancfg +2500 +1 +2500 -450000 +2250000")
    assert rig.a("sWN LMDscandatacfg 01 00 0 1 0 00 00 0 0 0 0 +1") == "sWA LMDscandatacfg"
    assert rig.a("sMN LMCstartmeas") == "sAN LMCstartmeas 0"
    assert rig.a("sRN STlms")[10] != "7"
    rig.run(10 * SECOND)
    assert rig.a("sRN STlms")[10] == "7"
    seen = []
    for _ in range(20):
        words = rig.a("sRN LMDscandata", within_ns=40 * MS).split(" ")
        assert (words[0], words[20], words[25]) == ("sRA", "DIST1", "439")
        seen.append(int(words[7], 16))
        rig.run(40 * MS)
    assert len(set(seen)) >= 19
    assert all(reason is DropReason.KEPT or reason is DropReason.STALE for reason in rig.dropped())
    rig.run(20 * SECOND)
    rig.forget()
    plans = len(rig.plans)
    rig.run(SECOND)
    assert len(rig.plans) == plans, "nobody asks any more"
