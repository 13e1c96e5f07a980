"""Packets of every model against the bytes of the specification's worked example."""

from __future__ import annotations

import hashlib
import zlib
from datetime import UTC, datetime

import numpy as np
import pytest

from protocols.hesai import calibration, codec
from protocols.hesai.models import LAST, MODELS, Model

WORKED = {
    "hesai-xt32": (18, "accc29d066dfb8e75eb7fa025eb009578c6dbaeab7ec7ce90d67bfd332c5a6a6"),
    "hesai-xt32m2x": (18, "2b03083ac821ef0fd5566770dc76a453a09f5ece5bef50e32eca818bca294045"),
    "hesai-pandar128e3x": (20, "2776fa42b16ca4097831b7b29ed6f5516363a3673ed7de5f90921c64b43cb99b"),
    "hesai-ot128": (20, "ca841ce6020b11345584fa0aec09a52f0f90d91b2cae8b0b5aa364247f476d6d"),
    "hesai-at128": (5, "87d084b888963003620288fb7c9e33828ea24f96b1f1f83f134be123b9573c72"),
    "hesai-pandar40p": (20, "10133d6aab9c64dbf5f49f1de5d5ae4d8989cae6e2ac3b0b834fa9d7c837cdbb"),
    "hesai-qt64": (60, "51dd29ce7b1861aff36126dcfadebd6e621783eda721f8f575e259e6169157d8"),
}
UTC_NS = int(datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC).timestamp()) * 10**9 + 123_456_000


def worked(model: Model, step: int, signed: bool = False) -> bytes:
    block, channel = np.arange(model.layout.blocks)[:, None], np.arange(model.lasers)
    fine = 0x80 if model.layout.fine else 0
    said = codec.Packets(
        (9000 + step * np.arange(model.layout.blocks))[None] * codec.FINE + fine,
        (1000 + 10 * block + channel)[None],
        ((2 * channel + block) % 256)[None],
        np.array([UTC_NS]),
        np.array([7]),
        LAST,
        200 if model.layout.fine else 600,
        np.zeros((1, model.layout.blocks), np.int64),
        1 if model.model == "hesai-ot128" else 2,
        codec.safety(np.array([3 * codec.REFRESH_NS]), 1),
        signed=signed,
        felt=(np.array((0.0, 0.0, 8196 * 122e-6 * codec.G)), np.zeros(3)),
        felt_ns=4_938_240 * codec.IMU_TICK_NS,
    )
    (packet,) = codec.encode(model, said)
    return packet


@pytest.mark.parametrize("name", sorted(MODELS))
def test_the_worked_packet_of_each_model_is_reproduced_byte_by_byte(name: str) -> None:
    step, digest = WORKED[name]
    packet = worked(MODELS[name], step)
    assert len(packet) == MODELS[name].layout.size
    assert hashlib.sha256(packet).hexdigest() == digest


def test_the_crc_has_the_check_value_of_its_definition_and_that_of_a_recorded_packet() -> None:
    assert codec.crc32_mpeg2(b"123456789") == 0x0376E6E7
    assert codec.crc32_mpeg2(b"\x05" + bytes(11)) == 0x11B13B3F
    assert codec.crc32_mpeg2(b"") == 0xFFFFFFFF
    assert zlib.crc32(b"123456789") == 0xCBF43926


def test_a_signed_packet_has_its_flag_and_thirty_two_bytes_more() -> None:
    packet = worked(MODELS["hesai-ot128"], 20, signed=True)
    assert len(packet) == 893
    assert hashlib.sha256(packet).hexdigest() == "2d7ad166906b434f9f20077920e91dbc8b6fce15f279465091cb8c6c2ac15c06"


def test_the_calibration_of_an_at128_is_the_worked_file_and_that_of_an_xt32_its_303_bytes() -> None:
    flat = np.zeros((128, 180), np.int8)
    made = calibration.at128(MODELS["hesai-at128"], flat, flat)
    assert len(made) == 47_176
    assert made[-32:].hex() == "8c0dddc0a1a91a441d6ce5aa4238cdd527cdbad0e17836019f695db78e2a4b0b"
    assert hashlib.sha256(made).hexdigest() == "53e856270993fa85d74c92fa71acfe4dc5f2ecd2ba098f18079dbf19349aba60"
    made = calibration.served(MODELS["hesai-xt32"])
    assert len(made) == 303
    assert made.startswith(b"Channel,Elevation,Azimuth\r\n1,15,0\r\n")
