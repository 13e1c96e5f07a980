"""What is announced by mDNS, and what cannot be."""

from __future__ import annotations

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
