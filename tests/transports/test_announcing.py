"""What is announced by mDNS, and what cannot be."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from importlib import util

import pytest

from emulator.errors import LinkError
from emulator.transports import announcing
from emulator.transports.announcing import Announcer, services
from protocols.session import Announcement
from tests.protocols.ouster.rig import Rig

ONE = Announcement("_ouster-lidar._tcp", "Ouster Sensor 7", "os-7", 80, {"sn": "7"})


def test_services_by_interface_as_drivers_resolve_them() -> None:
    rows = [
        {"address": host, "kind": ONE.kind, "name": ONE.name, "host": ONE.host, "port": 80, "text": dict(ONE.text)}
        for host in ("127.0.0.2", "10.1.2.3")
    ]
    found = services(rows)
    assert list(found) == ["127.0.0.1", "10.1.2.3"]
    (info,) = found["127.0.0.1"]
    assert (info.type, info.name) == ("_ouster-lidar._tcp.local.", "Ouster Sensor 7._ouster-lidar._tcp.local.")
    assert (info.server, info.port, info.parsed_addresses()) == ("os-7.local.", 80, ["127.0.0.2"])
    assert info.decoded_properties == {"sn": "7"}


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "localhost"])
def test_a_device_without_an_address_of_its_own_is_refused(host: str) -> None:
    with pytest.raises(LinkError, match="want one at the address of an interface"):
        Announcer([(host, ONE)])


def test_without_the_library_its_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(announcing, "find_spec", lambda name: None if name == "zeroconf" else util.find_spec(name))
    with pytest.raises(LinkError, match=r"lidaremu\[mdns\]"):
        Announcer([("127.0.0.2", ONE)])


def test_an_ouster_announces_itself_by_its_firmware_and_only_when_wanted() -> None:
    assert Rig().session.announced is None
    new, old = (Rig({"mdns": True, "firmware": one}).session.announced for one in ("3.1.0", "3.0.1"))
    assert new is not None
    assert old is not None
    assert (new.kind, new.host, new.port) == ("_ouster-lidar._tcp", "os-122322000614", 80)
    assert new.text["path"] == "/api/v1"
    assert (old.kind, old.port, old.text["sn"]) == ("_roger._tcp", 7501, "122322000614")


@pytest.fixture
def announcer(monkeypatch: pytest.MonkeyPatch) -> Iterator[Announcer]:
    """Whose process announces nothing, but lives as the real one."""
    monkeypatch.setattr(Announcer, "command", (sys.executable, "-c", "import sys; sys.stdin.read()"))
    made = Announcer([("127.0.0.2", ONE)])
    yield made
    made.close()
    assert made.pid is None


def struck(announcer: Announcer, number: signal.Signals) -> int:
    """Its process has got that signal, and it has worked."""
    pid = announcer.pid
    assert pid is not None
    os.kill(pid, number)
    os.waitid(os.P_PID, pid, os.WEXITED | os.WSTOPPED | os.WNOWAIT)
    return pid


@pytest.mark.parametrize(("number", "how"), [(signal.SIGKILL, "signal 9"), (signal.SIGSTOP, "stopped")])
def test_a_process_that_ends_or_stands_still_is_told_once_and_begun_again(
    announcer: Announcer, number: signal.Signals, how: str
) -> None:
    assert announcer.look() == ""
    old = struck(announcer, number)
    assert announcer.look() == f"{how}; started again"
    assert announcer.pid not in (None, old)
    assert announcer.look() == ""


def test_one_that_ends_again_and_again_is_left_so(announcer: Announcer) -> None:
    told = []
    for _ in range(announcing.MOST_STARTS):
        struck(announcer, signal.SIGKILL)
        told.append(announcer.look())
    assert told == ["signal 9; started again"] * 3 + ["signal 9; devices are announced no more"]
    assert announcer.pid is None
    assert announcer.look() == ""


def test_one_that_cannot_be_started_again_is_told(announcer: Announcer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Announcer, "command", ("/no/such/program",))
    struck(announcer, signal.SIGKILL)
    assert announcer.look() == "signal 9; devices are announced no more: No such file or directory"


def test_one_that_has_never_started_ends_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Announcer, "command", ("/no/such/program",))
    with pytest.raises(LinkError, match="mdns: true: its process does not start: No such file"):
        Announcer([("127.0.0.2", ONE)])


def test_one_that_has_ended_with_its_input_unread_ends_no_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its pipe is broken."""
    monkeypatch.setattr(Announcer, "command", ("true",))
    many = Announcement(ONE.kind, ONE.name, ONE.host, 80, {"sn": "7" * 200_000})
    made = Announcer([("127.0.0.2", many)])
    assert made.pid is not None
    os.waitid(os.P_PID, made.pid, os.WEXITED | os.WNOWAIT)
    assert made.look() == "exit code 0; started again"
    made.close()


def test_one_that_does_not_end_is_killed_and_told(
    announcer: Announcer, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(announcing, "ENDS_S", 0.0)
    struck(announcer, signal.SIGSTOP)
    announcer.close()
    assert "browsers show the devices until they expire" in capsys.readouterr().err
