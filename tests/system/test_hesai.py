"""A Hesai as a process: PTC by a plain socket, packets on UDP by the independent decoder, a redirected stream."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from tests.protocols.hesai import reader
from tests.system.conftest import TIME_LIMIT_S, daemons

SCENE = """\
schema: 1
seed: 1
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - id: one
    model: hesai-xt32
    mount: {at_m: [0, 0, 1]}
    physics: {false_alarms: false, noise: false, rule: axis, sub_beams: 1}
    device: {boot_s: 0, spin_up_s: 0, range_deg: [358, 2], clock_source: ptp}
    links: ["udp:127.0.0.1:PORT?listen=127.0.0.21:0", "tcp:127.0.0.21:0"]
"""


def heard() -> socket.socket:
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.bind(("127.0.0.1", 0))
    one.settimeout(TIME_LIMIT_S)
    return one


def ask(to: socket.socket, command: int, payload: bytes = b"") -> tuple[int, bytes]:
    to.sendall(b"\x47\x74" + bytes((command, 0)) + len(payload).to_bytes(4, "big") + payload)
    head = to.recv(8, socket.MSG_WAITALL)
    assert head[:3] == bytes((0x47, 0x74, command))
    length = int.from_bytes(head[4:8], "big")
    return head[3], to.recv(length, socket.MSG_WAITALL) if length else b""


def test_a_plain_host_gets_calibration_and_packets_and_sends_the_stream_elsewhere(tmp_path: Path) -> None:
    first, second = heard(), heard()
    text = SCENE.replace("PORT", str(first.getsockname()[1]))
    (tmp_path / "one.yaml").write_text(text, encoding="utf-8")
    with first, second, daemons(tmp_path) as start:
        running = start("one.yaml")
        host, _, port = running.link("one", 1).removeprefix("tcp:").rpartition(":")
        with (
            socket.create_connection((host, int(port)), TIME_LIMIT_S) as ptc,
            socket.create_connection((host, int(port))) as two,
        ):
            code, file = ask(ptc, 0x05)
            table = reader.csv_angles(file)
            assert (code, len(table)) == (0, 32)
            data, sender = first.recvfrom(2000)
            assert sender[0] == "127.0.0.21"
            packet = reader.decode(data)
            assert (packet.model, packet.rpm) == ("xt32", 600)
            level = [one.range_m for one in packet.points if abs(table[one.channel][0]) < 1e-9]
            assert level == pytest.approx([8.0] * len(level), abs=0.02)
            assert level
            assert ask(ptc, 0x20, bytes((127, 0, 0, 1)) + second.getsockname()[1].to_bytes(2, "big") + b"\x27\x7e") == (
                0,
                b"",
            )
            assert reader.decode(second.recvfrom(2000)[0]).model == "xt32"
            assert ask(two, 0x08)[1][16:18] == second.getsockname()[1].to_bytes(2, "big"), "all clients see one state"
            assert ask(two, 0xEE) == (5, b"")
            assert ask(ptc, 0x1C, b"\1") == (0, b"")
            assert ask(two, 0x08)[1][33] == 1
        running.stop()
