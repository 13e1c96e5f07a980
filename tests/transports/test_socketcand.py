"""The socketcand server: what its clients read and write, in every chunking, and stock python-can clients."""

from __future__ import annotations

import logging
import re
import select
import socket
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.transports.can_link import CanLink, CanPorts
from emulator.transports.link import Received
from emulator.transports.schemes import open_link
from emulator.transports.socketcand import SETTLE_NS, frame_text, parse_send
from emulator.transports.socketcand_bcm import MOST_ENTRIES, bcm_text
from protocols.can_frame import EXTENDED

MS = 1_000_000
SECOND = 1_000_000_000
TIME_LIMIT_S = 5.0


class Rig:
    """A link, and raw clients; time is the test's own."""

    def __init__(self, ports: CanPorts | None = None) -> None:
        link = open_link("socketcand:127.0.0.1:0/can0", can_ports=ports)
        assert isinstance(link, CanLink)
        self.link = link
        self.now_ns = SECOND
        self.clients: list[socket.socket] = []
        match = re.fullmatch(r"socketcand:(.*):(\d+)/can0", link.url)
        assert match is not None
        self.host, self.port = match[1], int(match[2])

    def client(self) -> socket.socket:
        self.clients.append(socket.create_connection((self.host, self.port), timeout=TIME_LIMIT_S))
        self.step()
        return self.clients[-1]

    def raw_client(self) -> socket.socket:
        client = self.client()
        assert self.talk(client, "", "< hi >")
        assert self.talk(client, "< open can0 >", "< ok >")
        assert self.talk(client, "< rawmode >", "< ok >")
        self.now_ns += SETTLE_NS
        return client

    def bcm_client(self) -> socket.socket:
        client = self.client()
        assert self.talk(client, "", "< hi >")
        assert self.talk(client, "< open can0 >", "< ok >")
        return client

    def say(self, client: socket.socket, text: str) -> None:
        """Say something that is not answered, and let it be understood: an echo comes behind it."""
        assert self.talk(client, text + "< echo >", "< echo >")

    def carry(self, *frames: tuple[int, str]) -> None:
        """The sensor sends frames, a millisecond apart."""
        for peer, data in frames:
            self.link.send(bytes.fromhex(data), self.now_ns, peer)
            self.now_ns += MS
            self.step()

    def reported(self, client: socket.socket) -> list[list[str]]:
        """What a client has been told since the last time: identifier and data of each frame."""
        assert client.sendall(b"< echo >") is None
        text = ""
        while "< echo >" not in text:
            self.step()
            if select.select([client], [], [], 0.01)[0]:
                text += client.recv(65536).decode()
        frames = [one.split() for one in re.findall(r"<([^>]*)>", text)]
        return [[one[1], "".join(one[3:])] for one in frames if one[0] == "frame"]

    def talk(self, client: socket.socket, text: str, answer: str) -> bool:
        """Say something and read exactly the answer."""
        client.sendall(text.encode())
        got = b""
        while len(got) < len(answer):
            self.step()
            if select.select([client], [], [], 0.01)[0]:
                got += client.recv(len(answer) - len(got))
        return got.decode() == answer

    def step(self) -> list[Received]:
        if self.link.filenos():
            select.select(self.link.filenos(), [], [], 0.005)
        got = self.link.receive(self.now_ns)
        self.link.flush(self.now_ns)
        return got

    def hear(self, count: int) -> list[Received]:
        """What the sensor receives of its hosts, once so many frames are there."""
        got: list[Received] = []
        for _ in range(1000 if count else 5):
            got += self.step()
            if len(got) >= count > 0:
                break
            self.now_ns += MS
        return got

    def read(self, client: socket.socket, groups: int) -> list[str]:
        """So many groups as a client reads them."""
        text = ""
        while text.count(">") < groups:
            self.step()
            if select.select([client], [], [], 0.01)[0]:
                text += client.recv(65536).decode()
        return re.findall(r"<[^>]*>", text)

    def close(self) -> None:
        for client in self.clients:
            client.close()
        self.link.close()


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    yield made
    made.close()


def test_the_handshake_is_greeting_open_raw_mode_each_with_one_answer(rig: Rig) -> None:
    rig.raw_client()


def test_a_frame_reaches_a_client_with_the_time_of_its_last_bit(rig: Rig) -> None:
    client = rig.raw_client()
    rig.link.send(bytes.fromhex("03FBF710"), rig.now_ns, 0x60A)
    rig.link.send(b"", rig.now_ns, 0x12345 | EXTENDED)
    rig.now_ns += 10 * MS
    first, second = rig.read(client, 2)
    identifier, time_s, data = first[8:-2].split(" ")
    assert (identifier, data) == ("60A", "03FBF710")
    assert float(time_s) == pytest.approx((rig.now_ns - 10 * MS) / SECOND + 83 * 2e-6, abs=20e-6)
    assert second.startswith("< frame 00012345 ")
    assert second.endswith("  >")  # no data between the two spaces, as socketcand prints it


def test_the_worked_frame_is_written_as_the_protocol_has_it() -> None:
    assert frame_text(0x60A, bytes.fromhex("03FBF710"), 123_456_789_000) == b"< frame 60A 123.456789 03FBF710 >"


@pytest.mark.parametrize(
    ("text", "frame"),
    [
        ("200 8 b9 1f 40 0 8 8c 1 0", (0x200, bytes.fromhex("B91F4000088C0100"))),
        ("7FF 0", (0x7FF, b"")),
        ("00000200 1 ff", (0x200 | EXTENDED, b"\xff")),
        ("1FFFFFFF 0", (0x1FFFFFFF | EXTENDED, b"")),
        ("5 1 a", (5, b"\x0a")),
        ("800 0", None),
        ("20000000 0", None),
        ("0200 0", None),
        ("200", None),
        ("200 9 1 2 3 4 5 6 7 8 9", None),
        ("200 2 1", None),
        ("200 1 100", None),
        ("200 1 xx", None),
        ("200 1 -1", None),
        ("200 1 +1", None),
        ("", None),
    ],
)
def test_a_send_group_is_a_frame_or_refused(text: str, frame: tuple[int, bytes] | None) -> None:
    assert parse_send(text.encode().split()) == frame


@given(st.lists(st.binary(max_size=12), max_size=12))
def test_reading_a_send_group_never_raises(words: list[bytes]) -> None:
    found = parse_send(words)
    assert found is None or len(found[1]) <= 8


WORKED = "< send 200 8 b9 1f 40 0 8 8c 1 0 >"
HEARD = Received(0x200, bytes.fromhex("B91F4000088C0100"))


@pytest.mark.parametrize(
    ("chunks", "frames"),
    [
        ([WORKED], 1),
        (list(WORKED), 1),
        ([WORKED + WORKED], 2),
        (["rubbish\n >> ", WORKED], 1),
        ([WORKED, " and more \r\n"], 1),
        (["< send 200 8 b9 ", WORKED], 1),  # half a group is given up when the next one begins
    ],
)
def test_a_host_s_frame_arrives_however_it_is_cut(rig: Rig, chunks: list[str], frames: int) -> None:
    client = rig.raw_client()
    for chunk in chunks:
        client.sendall(chunk.encode())
        rig.step()
    assert rig.hear(frames) == [HEARD] * frames
    assert rig.link.hosts.host_frames == frames


def test_frames_of_one_client_are_shown_to_the_others_and_not_to_itself(rig: Rig) -> None:
    one, other = rig.raw_client(), rig.raw_client()
    one.sendall(WORKED.encode())
    assert rig.hear(1) == [HEARD]
    assert [group.split()[2] for group in rig.read(other, 1)] == ["200"]
    assert select.select([one], [], [], 0.02)[0] == []


@pytest.mark.parametrize(
    ("said", "answer"),
    [
        ("< statistics 100 >", "< error unknown command >"),
        ("< subscribe 0 0 123 >", "< error unknown command >"),  # of BCM mode
        ("< isotpmode >", "< error isotpmode is not supported >"),
        ("< muxfilter 0 0 123 2 FF >", "< error muxfilter is not supported >"),
        ("< sendrtr 123 0 >", "< error sendrtr is not supported >"),
        ("< fdsend 123 0 0 >", "< error fdsend is not supported >"),
        ("< open can0 >", "< error unknown command >"),  # a second time
        ("< >", "< error syntax error >"),
        ("< send 800 0 >", "< error syntax error in send command >"),
        ("< echo >", "< echo >"),
    ],
)
def test_other_groups_are_answered_with_an_error_group(rig: Rig, said: str, answer: str) -> None:
    client = rig.raw_client()
    assert rig.talk(client, said, answer)
    assert rig.link.hosts.malformed == (0 if answer == "< echo >" else 1)
    client.sendall(WORKED.encode())
    assert rig.hear(1) == [HEARD]


def test_before_open_there_is_nothing_but_open(rig: Rig) -> None:
    client = rig.client()
    assert rig.talk(client, "", "< hi >")
    assert rig.talk(client, "< rawmode >", "< error unknown command >")
    assert rig.talk(client, WORKED, "< error unknown command >")
    assert rig.talk(client, "< open can7 >", "< error could not open bus >")
    assert rig.talk(client, "< open can0 >", "< ok >")


def test_text_without_end_is_refused_and_forgotten(rig: Rig) -> None:
    client = rig.raw_client()
    assert rig.talk(client, "<" + "x" * 2000, "< error too long >")
    client.sendall(b">" + WORKED.encode())
    assert rig.hear(1) == [HEARD]


def test_frames_wait_until_a_client_has_read_that_raw_mode_began(rig: Rig) -> None:
    client = rig.client()
    assert rig.talk(client, "", "< hi >")
    assert rig.talk(client, "< open can0 >", "< ok >")
    assert rig.talk(client, "< rawmode >", "< ok >")
    for k in range(5):
        rig.link.send(bytes([k]), rig.now_ns, 0x100)
    rig.now_ns += SETTLE_NS - 1
    rig.step()
    assert select.select([client], [], [], 0.02)[0] == []
    wake = rig.link.flush(rig.now_ns)
    assert wake is not None
    assert wake <= rig.now_ns + 1
    rig.now_ns += 1
    assert [group.split()[-2] for group in rig.read(client, 5)] == ["00", "01", "02", "03", "04"]


def test_without_a_client_frames_are_lost_and_counted(rig: Rig) -> None:
    rig.link.send(b"abc", rig.now_ns, 0x100)
    rig.now_ns += 10 * MS
    rig.step()
    assert rig.link.stats.bytes_lost == 3
    client = rig.raw_client()
    rig.link.send(b"abc", rig.now_ns, 0x100)
    rig.now_ns += 10 * MS
    assert len(rig.read(client, 1)) == 1
    assert rig.link.stats.bytes_out == 3


def test_a_client_that_does_not_read_loses_whole_frames_and_the_others_none(rig: Rig) -> None:
    lazy, keen = rig.raw_client(), rig.raw_client()
    lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    seen, sent = "", 0
    while rig.link.stats.payloads_dropped == 0:
        for _ in range(200):
            rig.link.send(sent.to_bytes(8, "big"), rig.now_ns, 0x100)
            sent += 1
        rig.now_ns += 100 * MS
        rig.step()
        while select.select([keen], [], [], 0)[0]:
            seen += keen.recv(65536).decode()
        assert sent < 200_000
    while seen.count(">") < sent:
        rig.step()
        seen += keen.recv(65536).decode()
    assert [int(word, 16) for word in re.findall(r"([0-9A-F]{16}) >", seen)] == list(range(sent))
    lazy.settimeout(0.2)
    text, pauses = "", 0
    while pauses < 300 and not (pauses and text.endswith(" >")):  # the kernel hands over a full window's rest late
        rig.step()
        try:
            text += lazy.recv(65536).decode()
            pauses = 0
        except TimeoutError:
            pauses += 1
    numbers = [int(word, 16) for word in re.findall(r"([0-9A-F]{16}) >", text)]
    assert numbers == sorted(set(numbers))
    assert re.fullmatch(r"(< frame 100 [0-9.]+ [0-9A-F]{16} >)*", text)


def test_a_client_that_goes_in_the_middle_of_a_group_leaves_nothing_behind(rig: Rig) -> None:
    client = rig.raw_client()
    client.sendall(b"< send 200 8 b9 1f")
    rig.step()
    client.close()
    assert rig.hear(0) == []
    other = rig.raw_client()
    other.sendall(WORKED.encode())
    assert rig.hear(1) == [HEARD]


def test_a_flood_of_a_client_is_carried_at_the_bit_rate_and_loses_nothing(rig: Rig) -> None:
    client = rig.raw_client()
    client.sendall(b"".join(f"< send 300 2 {k >> 8:x} {k & 255:x} >".encode() for k in range(3000)))
    got = rig.hear(3000)
    assert [int.from_bytes(frame.data, "big") for frame in got] == list(range(3000))


def test_a_lower_identifier_of_a_host_goes_before_the_sensor_s_next_frame(rig: Rig) -> None:
    client = rig.raw_client()
    listener = rig.raw_client()
    start_ns = rig.now_ns + 5 * MS
    for k in range(4):
        rig.link.send(bytes([k] * 8), start_ns, 0x60B)
    rig.now_ns = start_ns + 100_000  # the first one is on the bus
    rig.step()
    client.sendall(b"< send 200 0 >< send 7FF 0 >")
    assert select.select(rig.link.filenos(), [], [], TIME_LIMIT_S)[0]
    rig.step()
    rig.now_ns += 50 * MS
    assert [group.split()[2] for group in rig.read(listener, 6)] == ["60B", "200", "60B", "60B", "60B", "7FF"]


def test_clients_are_told_of_bus_off_with_an_error_frame(rig: Rig) -> None:
    client = rig.raw_client()
    rig.link.disturb(32)
    rig.link.send(bytes(8), rig.now_ns, 0x100)
    rig.now_ns += 20 * MS
    assert [group.split()[1:3] for group in rig.read(client, 3)] == [
        ["error", "20000004"],
        ["error", "20000040"],
        ["error", "20000100"],
    ]


def test_channels_of_one_server_are_separate_buses() -> None:
    ports = CanPorts()
    links = [open_link(f"socketcand:127.0.0.1:0/{name}", can_ports=ports) for name in ("can0", "can1")]
    try:
        address = [link.url.rpartition("/")[0] for link in links]
        assert address[0] == address[1]
        assert [len(link.filenos()) for link in links] == [1, 0]
    finally:
        for link in links:
            link.close()


def test_after_open_a_client_hears_what_it_has_subscribed_to(rig: Rig) -> None:
    client = rig.bcm_client()
    rig.carry((0x60A, "01"))
    assert rig.reported(client) == []
    assert not rig.link.has_host()
    rig.say(client, "< subscribe 0 0 60A >< subscribe 0 0 00012345 >")
    assert rig.link.has_host()
    rig.carry((0x60A, "02"), (0x60B, "03"), (0x12345 | EXTENDED, "04"), (0x60A, "02"))
    assert rig.reported(client) == [["60A", "02"], ["00012345", "04"], ["60A", "02"]]
    rig.say(client, "< unsubscribe 60A >")
    rig.carry((0x60A, "05"), (0x12345 | EXTENDED, "06"))
    assert rig.reported(client) == [["00012345", "06"]]


def test_bcm_mode_writes_frames_as_the_real_server_does() -> None:
    assert bcm_text(0x123, bytes.fromhex("11223344"), 23_424_242_000) == b"< frame 123 23.424242 11 22 33 44  >"


def test_a_filter_tells_changes_of_the_bits_it_names(rig: Rig) -> None:
    client = rig.bcm_client()
    rig.say(client, "< filter 0 0 60A 2 FF 0F >")
    rig.carry(
        (0x60A, "0110"), (0x60A, "0120"), (0x60A, "0121"), (0x60A, "02210000"), (0x60A, "0221FFFF"), (0x60A, "02")
    )
    assert [data for _, data in rig.reported(client)] == ["0110", "0121", "02210000", "02"]


def test_a_throttle_tells_the_latest_when_its_time_is_over(rig: Rig) -> None:
    client = rig.bcm_client()
    rig.say(client, "< subscribe 0 50000 60A >")
    rig.carry((0x60A, "01"), (0x60A, "02"), (0x60A, "03"))
    assert [data for _, data in rig.reported(client)] == ["01"]
    wake_ns = rig.link.flush(rig.now_ns)
    assert wake_ns is not None
    assert 45 * MS < wake_ns - rig.now_ns < 50 * MS
    rig.now_ns = wake_ns
    rig.step()
    assert [data for _, data in rig.reported(client)] == ["03"]
    rig.carry((0x60A, "04"))
    assert rig.reported(client) == []
    rig.now_ns += 50 * MS
    rig.step()
    assert [data for _, data in rig.reported(client)] == ["04"]
    rig.now_ns += 200 * MS
    rig.step()
    rig.carry((0x60A, "05"))
    assert [data for _, data in rig.reported(client)] == ["05"]


def test_a_job_sends_at_once_and_again_until_it_is_deleted(rig: Rig) -> None:
    client, other = rig.bcm_client(), rig.raw_client()
    rig.say(client, "< add 0 20000 123 2 1 22 >")
    begun_ns = rig.now_ns
    heard = rig.hear(3)
    assert heard == [Received(0x123, b"\1\x22")] * 3
    assert 40 * MS <= rig.now_ns - begun_ns < 46 * MS
    assert [group.split()[2] for group in rig.read(other, 3)] == ["123"] * 3
    assert rig.reported(client) == []
    rig.say(client, "< update 123 1 ff >")
    assert rig.hear(2) == [Received(0x123, b"\xff")] * 2
    rig.say(client, "< delete 123 >")
    rig.now_ns += SECOND
    assert rig.hear(0) == []


def test_an_interval_of_zero_sends_once_and_an_update_alone_not_at_all(rig: Rig) -> None:
    client = rig.bcm_client()
    rig.say(client, "< add 0 0 123 0 >< update 124 0 >< send 125 0 >")
    rig.now_ns += SECOND
    assert sorted(frame.peer for frame in rig.hear(2)) == [0x123, 0x125]
    rig.now_ns += SECOND
    assert rig.hear(0) == []


def test_a_job_faster_than_the_bus_fills_it_and_no_more(rig: Rig) -> None:
    client = rig.bcm_client()
    rig.say(client, "< add 0 10 123 8 0 0 0 0 0 0 0 0 >")
    assert len(rig.hear(1000)) >= 1000
    wake_ns = rig.link.flush(rig.now_ns)
    assert wake_ns is not None


def test_jobs_end_with_their_client_and_with_bcm_mode(rig: Rig) -> None:
    client = rig.bcm_client()
    rig.say(client, "< add 0 1000 123 0 >")
    assert rig.hear(2)
    assert rig.talk(client, "< rawmode >", "< ok >")
    rig.now_ns += 10 * MS
    rig.hear(0)
    rig.now_ns += SECOND
    assert rig.hear(0) == []
    assert rig.talk(client, "< bcmmode >", "< ok >")
    rig.say(client, "< add 0 1000 123 0 >")
    assert rig.hear(2)
    client.close()
    rig.hear(0)
    rig.now_ns += SECOND
    assert rig.hear(0) == []


def test_raw_mode_ends_with_another_mode(rig: Rig) -> None:
    client = rig.raw_client()
    rig.carry((0x60A, "01"))
    assert rig.reported(client) == [["60A", "01"]]
    for mode in ("bcmmode", "controlmode"):
        assert rig.talk(client, f"< {mode} >", "< ok >")
        rig.carry((0x60A, "02"))
        assert rig.reported(client) == []
    assert not rig.link.has_host()


def test_control_mode_tells_statistics_of_the_bus(rig: Rig) -> None:
    client = rig.bcm_client()
    rig.carry((0x60A, "0102"), (0x60A, "030405"))
    client.sendall(b"< send 123 1 7 >")
    rig.hear(1)
    assert rig.talk(client, "< controlmode >", "< ok >")
    rig.say(client, "< statistics 100 >")
    wake_ns = rig.link.flush(rig.now_ns)
    assert wake_ns is not None
    assert 90 * MS < wake_ns - rig.now_ns <= 100 * MS
    rig.now_ns = wake_ns
    assert rig.read(client, 1) == ["< stat 5 2 1 1 >"]
    rig.carry((0x60A, "01"))
    rig.now_ns += 100 * MS
    assert rig.read(client, 1) == ["< stat 6 3 1 1 >"]
    rig.say(client, "< statistics 0 >")
    rig.now_ns += SECOND
    rig.say(client, "")
    assert rig.talk(client, "< statistics >", "< error syntax error in statistics command >")
    assert rig.talk(client, "< send 123 0 >", "< error unknown command >")


@pytest.mark.parametrize(
    ("said", "answer"),
    [
        ("< subscribe 0 123 >", "syntax error in subscribe command"),
        ("< subscribe 0 x 123 >", "syntax error in subscribe command"),
        ("< subscribe 0 0 800 >", "syntax error in subscribe command"),
        ("< subscribe 9999999999999 0 123 >", "syntax error in subscribe command"),
        ("< unsubscribe >", "syntax error in unsubscribe command"),
        ("< filter 0 0 123 2 FF >", "syntax error in filter command"),
        ("< add 0 123 1 1 >", "syntax error in add command"),
        ("< add 0 0 123 9 1 1 1 1 1 1 1 1 1 >", "syntax error in add command"),
        ("< update 123 >", "syntax error in update command"),
        ("< delete 20000000 >", "syntax error in delete command"),
        ("< statistics 100 >", "unknown command"),
    ],
)
def test_a_command_of_bcm_mode_that_cannot_be_read_is_named(rig: Rig, said: str, answer: str) -> None:
    client = rig.bcm_client()
    assert rig.talk(client, said, f"< error {answer} >")
    assert rig.link.hosts.malformed == 1


def test_subscriptions_and_jobs_of_a_client_are_bounded(rig: Rig) -> None:
    client = rig.bcm_client()
    for k in range(MOST_ENTRIES):
        rig.say(client, f"< subscribe 0 0 {k:03X} >< update {k:03X} 0 >")
        rig.now_ns += MS
    assert rig.talk(client, "< subscribe 0 0 7FF >", "< error too many subscriptions in subscribe command >")
    assert rig.talk(client, "< add 0 0 7FF 0 >", "< error too many jobs in add command >")
    rig.say(client, "< subscribe 0 0 001 >")


def test_time_stamps_are_those_that_the_run_gives(quiet: None) -> None:
    epoch_ns = 1_700_000_000 * SECOND
    rig = Rig(CanPorts(stamp_ns=lambda at_ns: epoch_ns + at_ns))
    try:
        raw, bcm = rig.raw_client(), rig.bcm_client()
        rig.say(bcm, "< subscribe 0 0 60A >")
        rig.carry((0x60A, "01"))
        for client in (raw, bcm):
            stamp = float(rig.read(client, 1)[0].split()[3])
            assert stamp == pytest.approx((epoch_ns + rig.now_ns) / SECOND, abs=0.01)
    finally:
        rig.close()


@pytest.fixture
def quiet(caplog: pytest.LogCaptureFixture) -> None:
    """The stock client warns of every group that TCP has cut."""
    logging.getLogger("can.interfaces.socketcand").setLevel(logging.ERROR)
    logging.getLogger("can.socketcand").setLevel(logging.ERROR)


def test_two_stock_clients_in_one_process_see_the_same_frames(rig: Rig, quiet: None) -> None:
    import threading

    import can

    buses: list[Any] = []
    stop = threading.Event()

    def serve() -> None:
        while not stop.is_set():
            rig.step()
            rig.now_ns += MS

    server = threading.Thread(target=serve)
    server.start()
    try:
        for _ in range(2):
            buses.append(can.Bus(interface="socketcand", host=rig.host, port=rig.port, channel="can0"))
        stop.set()
        server.join()
        rig.now_ns += SETTLE_NS
        for k in range(300):
            rig.link.send(bytes([k & 255, k >> 8]), rig.now_ns + k * 100_000, 0x60B)
        rig.now_ns += 200 * MS
        rig.step()
        for bus in buses:
            seen = [bus.recv(1.0) for _ in range(300)]
            assert [(m.arbitration_id, m.data[0] | m.data[1] << 8) for m in seen] == [(0x60B, k) for k in range(300)]
            assert not seen[0].is_extended_id
        buses[0].send(can.Message(arbitration_id=0x1ABCDE, data=b"x", is_extended_id=True))
        assert rig.hear(1) == [Received(0x1ABCDE | EXTENDED, b"x")]
        assert buses[1].recv(1.0).arbitration_id == 0x1ABCDE
    finally:
        stop.set()
        server.join()
        for bus in buses:
            bus.shutdown()
