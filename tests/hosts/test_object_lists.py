"""Our own reader of object lists: the worked ARS408 list of the maker's tables, and lists of every format in a round.

Source of the worked list: see tests/protocols/can_objects/test_ars408.py.
"""

from __future__ import annotations

import math
from typing import Any

import can
import pytest

from emulator.errors import EmulatorError, LinkError
from emulator.hosts import can_objects
from emulator.hosts.can_lines import Frame, open_can
from emulator.hosts.can_objects import CanObjectHost
from emulator.hosts.object_lists import READERS, Ars408Reader, ListReader, M16Reader, Vu8Reader, reader_of, recognised
from emulator.hosts.scans import HostObjects
from tests.protocols.can_objects.rig import crowd, start, thing
from tests.protocols.can_objects.test_ars408 import WORKED_LIST

DEVICES: dict[str, dict[str, Any]] = {
    "can-ars408": {"format": "ars408", "quality": True, "extended": True},
    "can-ldmrs": {"format": "ldmrs", "class_in_reserved": True},
    "can-esr": {"format": "esr", "radiate": "always"},
    "can-leddar-vu8": {"format": "leddar_vu8", "streaming": "start"},
    "can-leddar-m16": {"format": "leddar_m16", "streaming": "start"},
}


def frames_of(model: str, objects: Any, seconds: float = 0.4, **device: Any) -> list[Frame]:
    sent = start(DEVICES[model] | device, objects).run(seconds)
    return [Frame(one.address.peer, one.payload) for one in sent if one.address is not None]


def read(reader: ListReader, frames: list[Frame]) -> list[HostObjects]:
    return [found for frame in frames if (found := reader.feed(frame)) is not None]


def test_the_worked_list_of_the_makers_tables_is_read() -> None:
    frames = [Frame(int(line[:3], 16), bytes.fromhex(line[4:])) for line in WORKED_LIST]
    (found,) = read(Ars408Reader(), [*frames, frames[0]])
    one, two, three = found.objects
    assert (one.number, one.x_m, one.y_m, one.vx_m_s, one.vy_m_s) == pytest.approx((7, 12.4, -1.8, -2.5, 0.0))
    assert (two.number, two.x_m, two.y_m, two.vx_m_s, two.vy_m_s) == pytest.approx((19, 35.6, 3.4, 0.25, -0.5))
    assert (three.x_m, three.y_m, three.vx_m_s) == pytest.approx((58.0, -6.2, -13.75))
    assert [item.category for item in found.objects] == ["car", "truck", "point"]
    assert [(item.length_m, item.width_m) for item in found.objects] == [
        pytest.approx(size) for size in ((4.4, 1.8), (9.0, 2.6), (0.6, 0.6))
    ]
    assert math.degrees(two.yaw_rad or 0.0) == pytest.approx(-4.0)
    assert one.existence == 1.0  # code 7


@pytest.mark.parametrize("model", [name for name in READERS if not name.startswith("can-leddar")])
def test_every_format_is_recognised_and_read_back(model: str) -> None:
    objects = [
        thing(1, 20.0, 3.0, velocity_m_s=(-5.0, 0.5, 0.0), age_s=1.0),
        thing(2, 41.0, -6.0, velocity_m_s=(2.0, -1.0, 0.0), age_s=1.0),
    ]
    frames = frames_of(model, objects)
    reader = recognised(frame.identifier for frame in frames)
    assert reader is not None
    assert reader.model == model
    found = read(reader, frames)
    assert len(found) >= 3
    assert [one.number for one in found] == list(range(len(found)))
    assert reader.errors == 0
    near, far = sorted(found[-1].objects, key=lambda one: one.x_m)
    assert (near.x_m, near.y_m) == pytest.approx((20.0, 3.0), abs=0.2)
    assert (far.x_m, far.y_m) == pytest.approx((41.0, -6.0), abs=0.2)
    if model == "can-ldmrs":  # knows no speeds without its vehicle's
        assert (near.vx_m_s, near.vy_m_s) == (None, None)
    else:
        assert (near.vx_m_s, near.vy_m_s) == pytest.approx((-5.0, 0.5), abs=0.26)
    if model != "can-esr":
        assert near.category == "car"
        assert (near.length_m, near.width_m) == pytest.approx((4.4, 1.8), abs=0.11)


def test_detections_of_a_vu8_are_placed_in_the_middle_of_their_segments() -> None:
    (found, *_) = read(Vu8Reader(), frames_of("can-leddar-vu8", [thing(1, 30.0, 0.0, size_m=(4.0, 60.0, 2.0))]))
    azimuths = [math.degrees(math.atan2(one.y_m, one.x_m)) for one in found.objects]
    assert sorted(azimuths) == pytest.approx([-21.0, -15.0, -9.0, -3.0, 3.0, 9.0, 15.0, 21.0])
    assert min(math.hypot(one.x_m, one.y_m) for one in found.objects) == pytest.approx(28.0, abs=0.1)


@pytest.mark.parametrize("mode", ["00", "01"])
def test_detections_of_an_m16_are_read_in_pairs_and_its_answers_are_none(mode: str) -> None:
    objects = [thing(1, 30.0, 0.0, size_m=(4.0, 60.0, 2.0)), thing(2, 10.0, -3.9, size_m=(0.4, 0.4, 2.0))]
    rig = start({"format": "leddar_m16"}, objects)
    rig.run(0.1)
    for frame in (f"740 05 {mode}", "740 06 01", "740 08 08 FE FF 00 00 00 00"):  # one segment is not told: 15 are odd
        rig.hear(frame)
    frames = [Frame(one.address.peer, one.payload) for one in rig.run(0.5) if one.address is not None]
    reader = recognised(frame.identifier for frame in frames)
    assert reader is not None
    assert reader.model == ("can-leddar-m16" if mode == "00" else "can-leddar-vu8")
    reader = M16Reader()
    found = read(reader, frames)
    assert (len(found) >= 4, reader.errors) == (True, 0)
    azimuths = [math.degrees(math.atan2(one.y_m, one.x_m)) for one in found[-1].objects]
    assert azimuths == pytest.approx([45.0 * (0.5 - (k + 0.5) / 16) for k in range(15, 0, -1)])
    assert min(math.hypot(one.x_m, one.y_m) for one in found[-1].objects) == pytest.approx(10.5, abs=0.3)
    assert [(frame.identifier, frame.data[0]) for frame in reader.hello(True) + reader.goodbye()] == [
        (0x740, 5),
        (0x740, 3),
    ]


def test_an_ars408_is_recognised_with_its_sensor_id_and_an_ldmrs_wherever_its_base_is() -> None:
    for device, model in (({"sensor_id": 5}, "can-ars408"), ({"base_id": 0x300}, "can-ldmrs")):
        frames = frames_of(model, crowd(3), **device)
        reader = recognised(frame.identifier for frame in frames)
        assert reader is not None
        assert reader.model == model
        assert len(read(reader, frames)[-1].objects) == 3
    assert recognised([0x123, 0x124]) is None


@pytest.mark.parametrize("model", ["can-ars408", "can-ldmrs"])
def test_a_list_with_a_frame_lost_is_counted_and_the_next_one_is_whole(model: str) -> None:
    frames = frames_of(model, crowd(4))
    reader = reader_of(model)
    header = {"can-ars408": 0x60B, "can-ldmrs": 0x502}[model]
    lost = next(index for index, frame in enumerate(frames) if frame.identifier == header)
    found = read(reader, frames[:lost] + frames[lost + 1 :])
    assert reader.errors == 1
    assert (len(found[0].objects), len(found[1].objects)) == (3, 4)


def test_clusters_are_shown_as_objects() -> None:
    frames = frames_of("can-ars408", crowd(4), output="clusters")
    found = read(Ars408Reader(), frames)
    assert {one.category for one in found[0].objects} == {"cluster"}


class PlayedBus:
    """A bus that plays frames, and keeps what is sent."""

    def __init__(self, frames: list[Frame]) -> None:
        self.frames = list(frames)
        self.sent: list[Frame] = []
        self.closed = False

    def read(self, timeout_s: float) -> Frame | None:
        return self.frames.pop(0) if self.frames else None

    def write(self, frame: Frame) -> None:
        self.sent.append(frame)

    def close(self) -> None:
        self.closed = True


def test_a_named_format_is_spoken_to_and_left_as_it_was() -> None:
    bus = PlayedBus(frames_of("can-leddar-vu8", crowd(2)))
    host = CanObjectHost(bus, "leddar-vu8")  # type: ignore[arg-type]
    assert host.title == "can-leddar-vu8"
    assert isinstance(next(host.scans(0.01)), HostObjects)
    host.close()
    assert [(frame.identifier, frame.data[0]) for frame in bus.sent] == [(0x740, 3), (0x740, 1)]
    assert bus.closed
    with pytest.raises(EmulatorError, match="can-ars408"):
        CanObjectHost(bus, "ars409")  # type: ignore[arg-type]


def test_an_esr_is_told_to_radiate_unless_its_vehicle_does() -> None:
    assert {frame.identifier for frame in (recognised({0x4E0, 0x500}) or Vu8Reader()).keep_alive()} == {0x4F0, 0x4F1}
    assert (recognised({0x4E0, 0x500, 0x4F1}) or Vu8Reader()).keep_alive() == []


def test_a_bus_without_a_known_list_is_reported_with_its_identifiers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can_objects, "LISTEN_S", 0.01)
    with pytest.raises(LinkError, match=r"received: 123"):
        CanObjectHost(PlayedBus([Frame(0x123, b"")]))  # type: ignore[arg-type]
    with pytest.raises(LinkError, match=r"silent.*--model"):
        CanObjectHost(PlayedBus([]))  # type: ignore[arg-type]


def test_any_interface_of_python_can_is_listened_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can_objects, "ENOUGH_NS", 0)
    frames = frames_of("can-ldmrs", crowd(3))
    with can.Bus(interface="virtual", channel="look") as device:
        line = open_can("can:virtual:look?receive_own_messages=false")
        for frame in frames:
            device.send(can.Message(arbitration_id=frame.identifier, data=frame.data, is_extended_id=False))
        host = CanObjectHost(line)
        found = next(host.scans(0.1))
        host.close()
    assert found is not None
    assert (host.title, len(found.objects), host.errors) == ("can-ldmrs", 3, 0)


@pytest.mark.parametrize("url", ["socketcand:127.0.0.1:29536", "can:nothing:0", "can:virtual", "pty:./x", "x"])
def test_a_text_that_names_no_bus_is_refused(url: str) -> None:
    with pytest.raises(EmulatorError, match="want"):
        open_can(url)
