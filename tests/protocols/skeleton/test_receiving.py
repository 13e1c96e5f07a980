"""Bytes of hosts: any chunking gives the same, every byte is on account, pauses end exactly when they should."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.session import Address, DropReason, LinkKind
from protocols.skeleton.receiving import (
    MAX_CONNECTIONS,
    Connections,
    Fault,
    FrameSplitter,
    LineSplitter,
    Receiver,
    Refusal,
    Splitter,
)


class Frames(FrameSplitter):
    """`AB`, size of the whole, data, sum of all before."""

    START = b"AB"
    HEAD_BYTES = 3

    def _size(self, head: bytes) -> int | Refusal:
        return head[2] if 4 <= head[2] <= 16 else (DropReason.BAD_LENGTH, f"{head[2]} bytes")

    def _open(self, frame: bytes) -> bytes | Refusal:
        return frame if sum(frame[:-1]) & 0xFF == frame[-1] else (DropReason.BAD_CHECKSUM, "")


def framed(data: bytes) -> bytes:
    body = b"AB" + bytes((4 + len(data),)) + data
    return body + bytes((sum(body) & 0xFF,))


NOISE = st.binary(max_size=40) | st.text("AB\x04\x05\n", max_size=40).map(str.encode)
STREAM = st.lists(NOISE | st.binary(max_size=12).map(framed), max_size=6).map(b"".join)
CUTS = st.lists(st.integers(0, 200), max_size=8)


def fed(splitter: Splitter[bytes], data: bytes, cuts: list[int]) -> list[bytes | Fault]:
    found: list[bytes | Fault] = []
    places = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    for begin, end in pairwise(places):
        found += splitter.feed(data[begin:end])
    return found


def size(one: bytes | Fault) -> int:
    return one.count if isinstance(one, Fault) else len(one)


def joined(found: list[bytes | Fault]) -> list[Any]:
    """Noise in pieces is the same noise."""
    out: list[Any] = []
    for one in found:
        noise = isinstance(one, Fault) and one.reason is DropReason.NO_START_BYTE
        if noise and out and isinstance(out[-1], int):
            out[-1] += size(one)
        else:
            out.append(size(one) if noise else one)
    return out


@given(STREAM, CUTS)
def test_frames_are_the_same_in_any_pieces(data: bytes, cuts: list[int]) -> None:
    assert joined(fed(Frames(16), data, cuts)) == joined(fed(Frames(16), data, []))


@given(st.binary(max_size=120) | st.text("x\n", max_size=120).map(str.encode), CUTS)
def test_lines_end_at_their_end_in_any_pieces(data: bytes, cuts: list[int]) -> None:
    found = fed(LineSplitter(500), data, cuts)
    assert found == [line + b"\n" for line in data.split(b"\n")[:-1]]


@pytest.mark.parametrize("new", [lambda: Frames(16), lambda: LineSplitter(16)])
@given(data=STREAM, cuts=CUTS)
def test_every_byte_is_in_an_item_or_a_fault_or_held(new: Any, data: bytes, cuts: list[int]) -> None:
    receiver = Receiver(new(), 10)
    splitter = receiver._splitter
    found = fed(splitter, data, cuts)
    held = len(splitter._buffer)
    assert held <= 16
    assert sum(map(size, found)) + held == len(data)
    assert sum(map(size, receiver.end())) == held
    assert not splitter


@given(st.lists(st.binary(max_size=12), max_size=4), NOISE)
def test_whole_frames_are_found_behind_any_noise(payloads: list[bytes], noise: bytes) -> None:
    splitter = Frames(16)
    splitter.feed(noise)
    while splitter:
        splitter.expire()
    whole = [framed(payload) for payload in payloads]
    assert fed(splitter, b"".join(whole), []) == whole


def test_a_false_start_gives_back_the_frame_that_it_swallowed() -> None:
    splitter = Frames(16)
    assert splitter.feed(b"AB\x10" + framed(b"xy")) == []
    assert splitter.expire() == [
        Fault(DropReason.TIMEOUT, 2),
        Fault(DropReason.NO_START_BYTE, 1),
        framed(b"xy"),
    ]


def test_a_line_without_end_is_given_up_by_the_buffer() -> None:
    splitter = LineSplitter(8)
    assert splitter.feed(b"x" * 20 + b"\n") == [
        Fault(DropReason.OVERLONG, 8),
        Fault(DropReason.OVERLONG, 8),
        b"xxxx\n",
    ]


@given(st.integers(1, 10**9), st.integers(0, 10**12))
def test_half_a_request_is_given_up_exactly_at_its_deadline(gap_ns: int, now_ns: int) -> None:
    receiver = Receiver(LineSplitter(8), gap_ns)
    assert receiver.deadline() is None
    assert receiver.feed(b"ha", now_ns) == []
    assert receiver.deadline() == now_ns + gap_ns
    assert receiver.expire(now_ns + gap_ns - 1) == []
    assert receiver.feed(b"lf", now_ns + gap_ns - 1) == []
    assert receiver.deadline() == now_ns + 2 * gap_ns - 1
    assert receiver.expire(now_ns + 2 * gap_ns - 1) == [Fault(DropReason.TIMEOUT, 4)]
    assert receiver.deadline() is None


def test_bytes_behind_the_pause_do_not_complete_what_was_before() -> None:
    receiver = Receiver(LineSplitter(8), 10)
    receiver.feed(b"ha", 0)
    assert receiver.feed(b"lf\n", 10) == [Fault(DropReason.TIMEOUT, 2), b"lf\n"]


def lines() -> Connections[Receiver[bytes]]:
    return Connections(lambda kind: Receiver(LineSplitter(8), 10))


def test_connections_of_a_stream_are_apart_and_a_line_is_one() -> None:
    connections = lines()
    one, other, line = Address(0, 1), Address(0, 2), Address(1, 0)
    connections.connected(one, LinkKind.STREAM)
    connections.connected(other, LinkKind.STREAM)
    connections.connected(line, LinkKind.SERIAL)
    assert connections.of(one) is connections.of(one)
    assert connections.of(one) is not connections.of(other)
    assert connections.of(line) is connections.of(Address(1, 99)) is not connections.of(one)
    assert connections.kind(other) is LinkKind.STREAM
    connections.of(one).feed(b"ha", 5)
    connections.of(line).feed(b"ha", 3)
    assert connections.deadline() == 13
    connections.disconnected(line)
    assert connections.deadline() == 15
    connections.connected(one, LinkKind.STREAM)
    assert connections.deadline() is None


def test_half_requests_of_endless_connections_are_bounded() -> None:
    connections = lines()
    connections.connected(Address(0, 0), LinkKind.STREAM)
    for peer in range(3 * MAX_CONNECTIONS):
        connections.of(Address(0, peer)).feed(b"ha", peer)
    assert len(connections) == MAX_CONNECTIONS
    connections.clear()
    assert connections.deadline() is None
