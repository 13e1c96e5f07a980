"""OSI: the worked message of the specification, esmini's datagrams, traces, and bytes that are none of it."""

from __future__ import annotations

import contextlib
import gzip
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from emulator.errors import ScenarioError
from emulator.live.book import Book
from emulator.live.esmini import Assembly, datagrams
from emulator.live.files import read
from emulator.live.json_lines import as_json, of_json
from emulator.live.osi import ground_truth, sensor_view
from emulator.live.rotations import from_angles
from emulator.live.samples import BadSample

WORKED = bytes.fromhex(
    # specification, section 11: GroundTruth 3.8.0, 327 bytes, canonical serialisation
    "0a06080310081800120708011080e1eb171a0208012a96010a02080112740a1b09000000000000124011cdccccccccccfc3f19"
    "000000000000f83f121b09000000000000000011000000000000000019000000000000e83f1a1b0900000000000000001100000"
    "00000000000190000000000000000221b09000000000000144011000000000000000019000000000000000018022a14221209666"
    "666666666f6bf19666666666666d6bf320208042a96010a02080212740a1b09000000000000124011cdccccccccccfc3f190000"
    "00000000f83f121b090000000000003440110000000000000cc019000000000000e83f1a1b09000000000000000011000000000"
    "000000019000000000000e03f221b09000000000000000011000000000000000019000000000000000018022a14221209666666"
    "666666f6bf19666666666666d6bf32020804"
)
MS = 1_000_000


def test_the_worked_message() -> None:
    assert len(WORKED) == 327
    found = ground_truth(WORKED)
    assert (found.t_ns, found.host, found.snapshot) == (1_050_000_000, "1", True)
    one, two = found.actors
    assert (one.id, one.at_m, one.velocity_m_s, one.size_m) == ("1", (0, 0, 0.75), (5, 0, 0), (4.5, 1.8, 1.5))
    assert (one.class_, one.rear_m) == ("car", (-1.4, 0.0, -0.35))
    assert (two.id, two.at_m) == ("2", (20.0, -3.5, 0.75))
    assert two.quaternion == pytest.approx(from_angles(0.5))


def test_a_message_in_26_datagrams_is_put_together() -> None:
    message = (bytes(range(256)) * 826)[:211_299]
    parts = datagrams(message)
    assert (len(parts), len(parts[-1])) == (26, 6499 + 8)
    assert datagrams(WORKED)[0][:12] == bytes.fromhex("ffffffff470100000a060803")
    assembly = Assembly(Counter())
    found = [assembly.take(part, "peer", 0) for part in parts]
    assert found[:-1] == [None] * 25
    assert found[-1] == message


def test_loss_and_disorder_cost_one_message_each_and_are_counted() -> None:
    parts = datagrams(bytes(30_000))
    for lost in range(len(parts)):
        counts: Counter[str] = Counter()
        assembly = Assembly(counts)
        for number, part in enumerate(parts):
            if number != lost:
                assert assembly.take(part, 1, 0) is None
        assert assembly.take(datagrams(WORKED)[0], 1, MS) == WORKED
        assert counts["osi incomplete"] >= 1
    counts = Counter()
    assembly = Assembly(counts)
    for part in (parts[0], parts[2], parts[1], parts[3]):
        assert assembly.take(part, 1, 0) is None
    assert counts["osi incomplete"] >= 1


def test_two_senders_do_not_mix() -> None:
    assembly = Assembly(Counter())
    one, two = datagrams(bytes(20_000)), datagrams(b"\1" * 20_000)
    found = [assembly.take(part, peer, 0) for pair in zip(one, two, strict=True) for peer, part in enumerate(pair)]
    assert [part for part in found if part is not None] == [bytes(20_000), b"\1" * 20_000]


def test_strange_bytes_are_refused_and_never_raise_anything_else() -> None:
    rng = np.random.default_rng(7)
    for count in range(2000):
        data = bytearray(WORKED)
        for _ in range(1 + count % 5):
            data[rng.integers(len(data))] = rng.integers(256)
        for decode in (ground_truth, sensor_view):
            with contextlib.suppress(BadSample):
                decode(bytes(data[: rng.integers(len(data) + 1)]))
    for data in (b"\x0a\xff\xff\xff\xff\xff\xff\xff\xff\x7f", b"\xff" * 40, b"\x0b\x0c", b""):
        with pytest.raises(BadSample, match="want"):
            ground_truth(data)
    with pytest.raises(BadSample, match="want"):
        Assembly(Counter()).take(b"\1\0\0\0\xff\xff\xff\xff", 1, 0)


def test_unknown_fields_are_skipped() -> None:
    strange = b"\xfa\x3f\x03abc" + b"\xf8\x3f\x05" + b"\xfd\x3f1234"
    assert ground_truth(strange + WORKED + strange) == ground_truth(WORKED)


def test_traces_with_a_torn_end_and_packed(tmp_path: Path) -> None:
    one = len(WORKED).to_bytes(4, "little") + WORKED
    late = one.replace(bytes.fromhex("120708011080e1eb17"), bytes.fromhex("120708021080e1eb17"))
    trace = tmp_path / "a.osi"
    trace.write_bytes(one + late + one[:50])
    found = list(read("osi-trace", trace))
    assert [reported.run_ns for reported in found] == [0, 1_000_000_000]
    assert [reported.known_ns for reported in found] == [-1, 0]
    packed = tmp_path / "b.osi"
    packed.write_bytes(gzip.compress(one))
    assert len(list(read("osi-trace", packed))) == 1
    view = tmp_path / "20240101T000000Z_sv_380_1_1_x.osi"
    inner = b"\x3a" + bytes([len(WORKED) & 0x7F | 0x80, len(WORKED) >> 7]) + WORKED
    view.write_bytes(len(inner).to_bytes(4, "little") + inner)
    assert next(iter(read("osi-trace", view))).update.actors[0].id == "1"


@pytest.mark.parametrize("data", [b"PK\3\4 no trace", b"\5\0\0\0ab", b"\x10\0\0\0" + b"\xff" * 16])
def test_what_is_no_trace_is_told(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.osi"
    path.write_bytes(data)
    with pytest.raises(ScenarioError, match="want"):
        list(read("osi-trace", path))


def test_mcap_with_osi(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("osi3.GroundTruth", "protobuf", b"")
        channel = writer.register_channel("gt", "protobuf", schema)
        writer.add_message(channel, 0, WORKED, 0)
        writer.finish()
    (reported,) = read("osi-mcap", path)
    assert reported.update == ground_truth(WORKED)
    path.write_bytes(b"nothing")
    with pytest.raises(ScenarioError, match="want"):
        list(read("osi-mcap", path))


def _thing(number: int, x: float, size: bytes = b"", kind: int = 3) -> bytes:
    """A StationaryObject, as field 4 of a GroundTruth."""
    from struct import pack

    from emulator.recording.protowire import piece, whole

    position = piece(2, b"".join(bytes((8 * one + 1,)) + pack("<d", value) for one, value in ((1, x), (2, 0.0))))
    base = size + position
    return piece(4, piece(1, whole(1, number)) + piece(2, base) + piece(3, whole(1, kind)))


def test_stationary_objects_are_read_and_stay_when_later_messages_have_none() -> None:
    first = ground_truth(WORKED + _thing(100, 30.0) + _thing(101, 40.0, kind=4))
    posts = [one for one in first.actors if one.static]
    assert [(one.id, one.class_, one.size_m) for one in posts] == [
        ("100", "building", (0.1, 0.1, 0.1)),
        ("101", "pole", (0.1, 0.1, 0.1)),
    ]
    book = Book(slots=("live_000", "live_001"), static_slots=("static_0000", "static_0001"))
    book.take(first, 0)
    assert book.actors() == ["live_000", "live_001", "static_0000", "static_0001"]
    book.take(ground_truth(WORKED), 10 * MS)
    assert "static_0000" in book.actors()
    book.take(ground_truth(WORKED + _thing(101, 40.0, kind=4)), 20 * MS)
    assert book.actors() == ["live_000", "live_001", "static_0001"], "another list replaces them"
    again = of_json(as_json(first))
    assert again == first, "a recording has them"


def test_more_stationary_objects_than_there_is_room_for_take_no_place_of_those_that_move() -> None:
    book = Book(slots=("live_000", "live_001"))
    book.take(ground_truth(_thing(100, 30.0) + _thing(101, 40.0) + WORKED), 0)
    assert book.actors() == ["live_000", "live_001"]
    assert book.counts["static ones left out"] == 2
