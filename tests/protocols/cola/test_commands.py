"""Variables, methods and events: published frames, access, refusals, what power-off keeps, states over time."""

from __future__ import annotations

import hashlib
from typing import Any

import pytest

from protocols.cola import FAMILY
from protocols.cola.answers import challenge_of, long_hash, response
from protocols.cola.commands import EVENTS, METHODS, VARIABLES, codes
from protocols.cola.models import MODELS
from protocols.errors import DeviceSettingError
from protocols.session import LinkKind
from protocols.skeleton.cola_values import short_hash
from tests.protocols.cola.reader import ask_b
from tests.protocols.cola.rig import ONE, SECOND, TWO, Rig

WORKED = [
    ("sRN SCdevicestate", "", "73524120534364657669636573746174652001"),
    ("sMN SetAccessMode", "03f4724744", "73414e205365744163636573734d6f64652001"),
    ("sWN EIHstCola", "01", "735741204549487374436f6c6120"),
    ("sRN LMPoutputRange", "", "735241204c4d506f757470757452616e676520000100001388fff9223000225510"),
    ("sMN mLMPsetscancfg", "00001388000100001388fff9223000225510",
     "73414e206d4c4d507365747363616e636667200000001388000100001388fff9223000225510"),
    ("sRN LMPscancfg", "", "735241204c4d507363616e6366672000001388000100001388fff9223000225510"),
    ("sWN LMDscandatacfg", "01000100000000000000010001", "735741204c4d447363616e6461746163666720"),
    ("sRN LocationName", "", "735241204c6f636174696f6e4e616d6520000b6e6f7420646566696e6564"),
    ("sRN field010", "", "735241206669656c643031302000"),
    ("sMN LMCstartmeas", "", "73414e204c4d4373746172746d6561732000"),
    ("sMN Run", "", "73414e2052756e2001"),
    ("sEN LMDscandata", "01", "734541204c4d447363616e646174612001"),
    ("sRN NoSuchThing", "", "7346410003"),
    ("sRN LCMstate", "", "735241204c434d73746174652000"),
]  # fmt: skip
"Sections 1.5 and 8 of the specification; sFA without the blank, as real LMS send it."


def test_worked_frames_are_answered_as_they_are_printed() -> None:
    rig = Rig()
    for name, data, wanted in WORKED:
        assert rig.b(name, data) == bytes.fromhex(wanted), name


def test_an_empty_field_and_stlms_are_those_of_recordings() -> None:
    rig = Rig()
    wanted = bytes.fromhex("3f800000 00000000 00001388 fff92230 02 00 0000 0000 0000 0000 0001 0000 0000")
    assert rig.b("sRN field000") == b"sRA field000 " + wanted
    reported = rig.b("sRN STlms")
    assert reported[:16] == b"sRA STlms " + bytes.fromhex("0007 00 0008") + b"0"
    assert len(reported) == 0x2D


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("dialect", "AB")
def test_every_name_is_answered_once_in_every_model_logged_in_or_not(model: str, dialect: str) -> None:
    for access in (False, True):
        rig = Rig(model, login="challenge 2")
        for code in codes():
            if access:
                rig.b("sMN SetAccessMode", "0481be23aa")
            rig.session._unsubscribe(rig.now_ns, ONE)
            rig.session._listeners = {name: set() for name in EVENTS}
            rig.sent.clear()
            before = dict(rig.session.values)
            reported = rig.a(code).encode() if dialect == "A" else rig.b(code)
            assert reported[:3] in (b"sRA", b"sWA", b"sAN", b"sEA", b"sFA"), code
            if reported[:3] == b"sFA" and code != "sMN mSCloadfacdef":
                assert rig.session.values == before
            if code == "sMN mSCreboot" and reported[:3] == b"sAN":
                rig.run(12 * SECOND)


def test_the_table_is_the_coverage_page_and_the_dispatcher() -> None:
    rows = {row.code for row in FAMILY.commands()}
    for name in (*VARIABLES, *METHODS, *EVENTS):
        shown = "field000..047" if name.startswith("field") else name
        assert any(code.endswith(f" {shown}") for code in rows), name


# ---------------------------------------------------------------- access


def test_passwords_become_the_words_of_the_wire() -> None:
    assert [short_hash(text) for text in ("client", "main", "servicelevel", "SICKSAFE")] == [
        0xF4724744, 0xB21ACE26, 0x81BE23AA, 0x6FD62C05,
    ]  # fmt: skip


def test_writes_need_a_login_of_their_own_connection() -> None:
    rig = Rig()
    assert rig.a("sWN EIHstCola 1") == "sFA A"
    assert rig.a("sMN mEEwriteall") == "sFA 1"
    assert rig.a("sMN SetAccessMode 03 12345678") == "sAN SetAccessMode 0"
    assert rig.a("sWN EIHstCola 1") == "sFA A"
    rig.log_in()
    assert rig.a("sWN EIHstCola 1") == "sWA EIHstCola"
    assert rig.a("sWN EIHstCola 1", to=TWO) == "sFA A"
    assert rig.a("sMN SetPassword 3 12345678") == "sFA 1"
    assert rig.a("sMN Run") == "sAN Run 1"
    assert rig.a("sWN EIHstCola 1") == "sFA A"
    rig.log_in()
    rig.session.disconnected(rig.now_ns, ONE)
    rig.session.connected(rig.now_ns, ONE, LinkKind.STREAM)
    assert rig.a("sWN EIHstCola 1") == "sFA A"
    assert Rig(access="open").a("sWN EIHstCola 1") == "sWA EIHstCola"


def test_another_password_is_kept_only_when_it_is_stored() -> None:
    rig = Rig()
    for stored in (False, True):
        assert rig.a("sMN SetAccessMode 4 81BE23AA") == "sAN SetAccessMode 1"
        assert rig.a("sMN SetPassword 3 12345678") == "sAN SetPassword 1"
        if stored:
            assert rig.a("sMN mEEwriteall") == "sAN mEEwriteall 1"
        assert rig.a("sMN CheckPassword 3 12345678") == "sAN CheckPassword 1"
        rig.session.power_on(rig.now_ns)
        rig.run(12 * SECOND)
        rig.sent.clear()
        assert rig.a("sMN CheckPassword 3 12345678") == f"sAN CheckPassword {int(stored)}"


@pytest.mark.parametrize(("version", "level", "password"), [(1, 3, "client"), (2, 3, "client"), (2, 4, "servicelevel")])
def test_login_by_challenge(version: int, level: int, password: str) -> None:
    rig = Rig(login=f"challenge {version}")
    if version == 2:
        assert rig.b("sMN GetChallenge") == b"sFA\x00\x08"
    reported = rig.b("sMN GetChallenge", bytes([level]) if version == 2 else b"")
    drawn, salt = reported[18:34], reported[34:]
    assert (reported[:18], len(drawn), len(salt)) == (b"sAN GetChallenge \x00", 16, 16 * (version - 1))
    text = b"%s:SICK Sensor:%s" % ({3: b"AuthorizedClient", 4: b"Service"}[level], password.encode())
    kept = hashlib.sha256(text + (b":" + salt if salt else b"")).digest()
    answer = hashlib.sha256(kept + drawn).digest() + bytes([level])
    assert rig.b("sMN SetUserLevel", answer) == b"sAN SetUserLevel \x00"
    assert rig.b("sWN EIHstCola", "01") == b"sWA EIHstCola "
    assert rig.b("sMN SetUserLevel", answer) == b"sAN SetUserLevel \x03", "a challenge serves once"
    rig.b("sMN GetChallenge", bytes([level]) if version == 2 else b"")
    assert rig.b("sMN SetUserLevel", answer) == b"sAN SetUserLevel \x02"


def test_published_challenges_of_the_specification() -> None:
    drawn, salt = bytes(range(0x10, 0x20)), bytes(range(0xA0, 0xB0))
    two, one = long_hash(3, "client", salt), long_hash(3, "client")
    assert two.hex() == "55e162c52518e110edbf987eebb737de0395dc19ec336a07e9932e13b048a1ef"
    assert response(two, drawn).hex() == "f613840064d990c67cfedd8f77161775e54495181c58171f45804e292b43b6d8"
    assert one.hex() == "8859435235bac0579ef1cb588ecd723b67e41361760dad8d17f27f4bfd48830a"
    assert response(one, drawn).hex() == "32664f279a4d248fa309268001fab34a823e85fdfdac95208691da42ef4daf02"
    assert challenge_of("1", 1, 0) != challenge_of("1", 2, 0)


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("asked", "code"),
    [
        ("sRN NoSuchThing", "3"), ("sWN NoSuchThing 1", "3"), ("sMN NoSuchThing", "2"), ("sEN NoSuchThing 1", "F"),
        ("sXY LMPscancfg", "C"), ("hello", "C"), ("sRN", "C"), ("sRI 7", "E"),
        ("sMN mLMPsetscancfg 1388", "8"), ("sMN mLMPsetscancfg 1388 1 1388 FFF92230 225510 1", "7"),
        ("sWN LMPoutputRange 1 1388 225510 FFF92230", "4"), ("sWN LMPoutputRange 2 1 0 1 1 0 1", "5"),
        ("sWN LMDscandatacfg 00 00 1 1 0 00 00 0 0 0 0 +1", "4"),
        ("sWN LMDscandatacfg 01 00 1 1 0 00 00 0 0 0 0 0", "4"),
        ("sWN LMDscandatacfg 100 00 1 1 0 00 00 0 0 0 0 1", "10"), ("sWN EIHstCola x", "11"), ("sWN EIHstCola 7", "4"),
        ("sWN SerialNumber 1 1", "A"), ("sWN LMPscancfg 1388", "A"), ("sWN FREchoFilter 1", "3"),
        ("sWN field010 0", "A"),
        ("sWN ActiveFieldSet 99", "E"), ("sMN GetChallenge", "2"), ("sEN LMDscandata 2", "4"), ("sMN MMTechoes", "2"),
    ],
)  # fmt: skip
def test_a_refusal_has_its_code_and_changes_nothing(asked: str, code: str) -> None:
    rig = Rig()
    rig.log_in()
    before = dict(rig.session.values)
    assert rig.a(asked) == f"sFA {code}"
    assert rig.session.values == before


@pytest.mark.parametrize(
    ("model", "asked", "status"),
    [
        ("sick-lms111", "+5000 +1 +5000", 0), ("sick-lms111", "+7500 +1 +5000", 1),
        ("sick-lms111", "+5000 +1 +2500", 2),
        ("sick-lms111", "+1 +1 +1", 3), ("sick-mrs1104", "+5000 +1 +625", 2), ("sick-lms511", "+10000 +1 +1667", 0),
        ("sick-lms511", "+10000 +1 +6667", 0), ("sick-tim571", "+1500 +1 +3333", 0),
        ("sick-tim571", "+2500 +1 +3333", 1),
    ],
)  # fmt: skip
def test_scan_configurations_are_judged_by_the_pairs_of_the_model(model: str, asked: str, status: int) -> None:
    rig = Rig(model)
    rig.log_in()
    reported = rig.a(f"sMN mLMPsetscancfg {asked} -450000 +2250000").split(" ")
    assert reported[2] == str(status)
    frequency, _, step = (int(word) for word in asked.split(" "))
    assert (int(reported[3], 16), int(reported[5], 16)) == (frequency, step)


def test_an_old_lms100_refuses_the_output_range_and_is_busy_after_a_login() -> None:
    rig = Rig("sick-lms100", firmware="V1.23     ")
    assert rig.a("sRN SCdevicestate") == "sRA SCdevicestate 1"
    rig.log_in()
    assert rig.a("sRN SCdevicestate") == "sRA SCdevicestate 0"
    assert rig.b("sWN LMPoutputRange", "000100001388fff9223000225510") == b"sFA\x00\x0a"


def test_a_device_set_to_one_dialect_is_deaf_to_the_other() -> None:
    rig = Rig(dialect="host")
    rig.log_in()
    rig.put(ask_b("sRN SCdevicestate"))
    rig.run(SECOND)
    assert not rig.sent
    assert rig.a("sWN EIHstCola 1") == "sWA EIHstCola"
    rig.put(b"\x02sRN SCdevicestate\x03")
    rig.run(SECOND)
    assert not rig.sent
    assert rig.b("sRN SCdevicestate") == b"sRA SCdevicestate \x01"


def test_a_login_by_index_of_the_name() -> None:
    rig = Rig("sick-tim561", firmware="V2.51-21.08.15")
    assert rig.a("sRI 0") == "sRA 0 6 TiM561 E V2.51-21.08.15"
    assert rig.b("sRI", "0000").startswith(b"sRA \x00\x00\x00\x06TiM561\x00\x0eV2.51")


# ---------------------------------------------------------------- state over power and time


def test_power_off_keeps_what_was_stored_and_nothing_else() -> None:
    rig = Rig()
    rig.log_in()
    rig.a("sWN LocationName 5 porch")
    rig.a("sMN mLMPsetscancfg +2500 +1 +2500 -450000 +2250000")
    rig.a("sMN mEEwriteall")
    rig.a("sWN LocationName 4 door")
    rig.a("sMN mLMPsetscancfg +5000 +1 +5000 -450000 +2250000")
    count = int(rig.a("sRN ODpwrc").split(" ")[2], 16)
    rig.session.power_on(rig.now_ns)
    rig.run(12 * SECOND)
    rig.sent.clear()
    assert rig.a("sRN LocationName") == "sRA LocationName 5 porch"
    assert rig.a("sRN LMPscancfg") == "sRA LMPscancfg 9C4 1 9C4 FFF92230 225510"
    assert int(rig.a("sRN ODpwrc").split(" ")[2], 16) == count + 1
    assert rig.a("sWN LocationName 4 door") == "sFA A", "the login is gone"
    rig.log_in()
    assert rig.a("sMN mSCloadfacdef") == "sAN mSCloadfacdef"
    assert rig.a("sRN LocationName") == "sRA LocationName B not defined"
    assert rig.a("sMN mSCreboot") == "sAN mSCreboot"
    rig.run(12 * SECOND)
    rig.sent.clear()
    assert rig.a("sRN LocationName") == "sRA LocationName 5 porch"


def test_a_cold_start_goes_through_the_states_of_the_manual() -> None:
    rig = Rig(up=False)
    seen: list[int] = []
    busy: set[str] = set()
    for _ in range(110):
        rig.run(SECOND // 10)
        rig.sent.clear()
        if rig.session.is_up:
            seen.append(int(rig.a("sRN STlms").split(" ")[2]))
            if seen[-1] != 7:
                busy.add(rig.a("sRN SCdevicestate")[-1])
    assert sorted(set(seen)) == sorted(seen[i] for i in range(len(seen)) if i == 0 or seen[i] != seen[i - 1])
    assert list(dict.fromkeys(seen)) == [1, 4, 5, 6, 7]
    assert busy == {"0"}
    rig.log_in()
    rig.a("sMN LMCstopmeas")
    assert rig.a("sRN STlms").split(" ")[2] == "3"
    rig.a("sMN LMCstartmeas")
    assert rig.a("sRN STlms").split(" ")[2] == "4"
    rig.run(3 * SECOND)
    assert rig.a("sRN STlms").split(" ")[2] == "7"


def test_a_dirty_window_and_a_standing_motor_are_told() -> None:
    rig = Rig("sick-lms511")
    states = {}
    for share in (1.0, 0.6, 0.3, 0.1):
        assert rig.session.impair(rig.now_ns, "window", share)
        states[share] = rig.a("sRN LCMstate")[-1], rig.a("sRN SCdevicestate")[-1]
    assert states == {1.0: ("0", "1"), 0.6: ("1", "1"), 0.3: ("2", "2"), 0.1: ("3", "2")}
    rig.session.impair(rig.now_ns, "window", 0.6)
    rig.a("sEN LMDscandata 1")
    assert rig.scan().status == (0, 2)
    rig.forget()
    rig.session.impair(rig.now_ns, "motor stopped", 1.0)
    rig.run(SECOND)
    assert not rig.sent
    assert rig.a("sRN SCdevicestate")[-1] == "2"
    rig.session.impair(rig.now_ns, "motor stopped", 0.0)
    assert rig.scan().scan_frequency == 5000


@pytest.mark.parametrize(
    ("device", "text"),
    [({"step_deg": 0.1}, "step_deg"), ({"frequency_hz": 33}, "frequency_hz"), ({"acces": "open"}, "no such key"),
     ({"ready_s": 0}, "ready_s"), ({"serial_number": -1}, "serial_number")],
)  # fmt: skip
def test_device_keys_are_judged(device: dict[str, Any], text: str) -> None:
    with pytest.raises(DeviceSettingError, match=text):
        FAMILY.new_session(device, {"model": "sick-lms111"})


def test_a_busy_device_refuses_every_request_and_goes_on_sending_scans() -> None:
    rig = Rig()
    rig.a("sEN LMDscandata 1")
    assert rig.session.impair(rig.now_ns, "busy", 1.0)
    rig.forget()
    for asked in ("sRN SCdevicestate", "sMN SetAccessMode 03 F4724744", "sWN EIHstCola 1", "sEN LMDscandata 0"):
        assert rig.a(asked, to=TWO) == "sFA D"
    assert rig.scan().scan_frequency == 5000
    rig.session.impair(rig.now_ns, "busy", 0.0)
    assert rig.a("sRN SCdevicestate", to=TWO) == "sRA SCdevicestate 1"


@pytest.mark.parametrize("login", ["classic", "challenge 1"])
def test_a_device_that_refuses_logins_keeps_those_that_it_has_granted(login: str) -> None:
    rig = Rig(login=login)
    rig.log_in()
    assert rig.session.impair(rig.now_ns, "login", 1.0)
    assert rig.a("sMN SetAccessMode 03 F4724744", to=TWO) == "sAN SetAccessMode 0"
    assert rig.a("sWN EIHstCola 1", to=TWO) == "sFA A"
    if login != "classic":
        drawn = rig.b("sMN GetChallenge", to=TWO)[18:34]
        answer = response(long_hash(3, "client"), drawn) + b"\x03"
        assert rig.b("sMN SetUserLevel", answer, to=TWO) == b"sAN SetUserLevel \x02"
    assert rig.a("sWN EIHstCola 0") == "sWA EIHstCola", "this host was logged in before"
    rig.session.impair(rig.now_ns, "login", 0.0)
    assert rig.a("sMN SetAccessMode 03 F4724744", to=TWO) == "sAN SetAccessMode 1"


def test_keys_of_a_model_are_its_own() -> None:
    keys = {one.name: one for one in FAMILY.keys_of_model({"model": "sick-tim571"})}
    assert "15" in keys["frequency_hz"].allowed
    assert "50" not in keys["frequency_hz"].allowed
    assert keys["ready_s"].default.startswith("3")
