"""The JSON pose feed: what is read, what is refused, the way to a recording and back."""

from __future__ import annotations

import json

import numpy as np
import pytest

from emulator.live.client import encoded
from emulator.live.json_lines import as_json, decoded, of_json
from emulator.live.rotations import from_angles
from emulator.live.samples import BadSample

WORKED = (
    b'{"t_s":1.05,"seq":21,"actors":[{"id":"1","host":true,"at_m":[0.0,0.0,0.75],"velocity_m_s":[5.0,0.0,0.0],'
    b'"size_m":[4.5,1.8,1.5],"class":"car"},{"id":"2","at_m":[20.0,-3.5,0.75],"yaw_deg":28.64789,'
    b'"size_m":[4.5,1.8,1.5],"class":"car"}]}'
)
"Specification, section 11."


def test_the_worked_line() -> None:
    found = decoded(WORKED)
    assert (found.t_ns, found.seq, found.snapshot) == (1_050_000_000, 21, False)
    one, two = found.actors
    assert (one.id, one.host, one.reference) == ("1", True, "box_centre")
    assert two.quaternion == pytest.approx(from_angles(0.5), abs=1e-6)


def test_a_quaternion_is_x_y_z_w() -> None:
    found = decoded('{"actors": [{"id": 7, "at_m": [1, 2], "quaternion_xyzw": [0, 0, 2, 2]}]}').actors[0]
    assert (found.id, found.at_m) == ("7", (1.0, 2.0, 0.0))
    assert found.quaternion == pytest.approx(from_angles(np.pi / 2))


@pytest.mark.parametrize("yaw_deg", [0.0, 28.64789, -90.0, 180.0, 200.0, -359.0])
def test_a_plain_actor_is_what_one_with_all_keys_is(yaw_deg: float) -> None:
    plain = {"id": "7", "at_m": [1.0, -2.5, 0.75], "yaw_deg": yaw_deg, "velocity_m_s": [5.0, 0.0, -1.0]}
    more = plain | {"reference": "ground"}
    level = {"pitch_deg": 0.0, "roll_deg": 0.0, "static": False}
    one, two = decoded(json.dumps({"actors": [plain, more | {"id": "8"}]})).actors
    other, another = decoded(json.dumps({"actors": [plain | level, more | level | {"id": "8"}]})).actors
    assert (one, two) == (other, another)
    assert one.quaternion == pytest.approx(from_angles(np.radians(yaw_deg)), abs=0.0)
    assert (one.reference, two.reference) == ("box_centre", "ground")


@pytest.mark.parametrize(
    "wrong",
    [
        {"at_m": [1.0, 2.0, float("nan")]}, {"at_m": [1e8, 0.0, 0.0]}, {"velocity_m_s": [float("inf"), 0.0, 0.0]},
        {"velocity_m_s": [2e5, 0.0, 0.0]}, {"yaw_deg": 2e6}, {"yaw_deg": float("nan")}, {"reference": "roof"},
        {"velocity_m_s": ["a", 0.0, 0.0]}, {"id": ""}, {"id": "x" * 200},
    ],
)  # fmt: skip
def test_a_plain_actor_with_one_wrong_value_is_refused(wrong: dict[str, object]) -> None:
    plain = {"id": "7", "at_m": [1.0, 2.0, 0.0], "yaw_deg": 5.0, "velocity_m_s": [5.0, 0.0, 0.0]}
    decoded(json.dumps({"actors": [plain]}))
    with pytest.raises(BadSample, match="want"):
        decoded(json.dumps({"actors": [plain | wrong]}))


@pytest.mark.parametrize(
    "line",
    [
        "[]", "7", "{", "", '{"actors": 1}', '{"actors": [7]}', '{"actors": [{}]}', '{"actors": [{"id": 1}]}',
        '{"actors": [{"id": 1.5, "at_m": [0, 0, 0]}]}', '{"actors": [{"id": 1, "at_m": [0]}]}',
        '{"actors": [{"id": 1, "at_m": ["a", 0, 0]}]}', '{"actors": [{"id": 1, "at_m": [NaN, 0, 0]}]}',
        '{"actors": [{"id": 1, "at_m": [1e400, 0, 0]}]}', '{"actors": [{"id": 1, "at_m": [true, 0, 0]}]}',
        '{"actors": [{"id": 1, "at_m": [0, 0, 0], "yaw_deg": "north"}]}', '{"t_s": "now", "actors": []}',
        '{"actors": [{"id": 1, "at_m": [0, 0, 0], "quaternion_xyzw": [0, 0, 0, 0]}]}', '{"t_ns": 1.5}',
        '{"actors": [{"id": 1, "at_m": [0, 0, 0], "quaternion_xyzw": [0, 0, 0, 1], "yaw_deg": 5}]}',
        '{"actors": [{"id": 1, "at_m": [0, 0, 0]}, {"id": "1", "at_m": [0, 0, 0]}]}', '{"seq": 1e3}',
        '{"actors": [{"id": 1, "at_m": [0, 0, 0], "reference": "roof"}]}', '{"snapshot": 1}', '{"removed": [[]]}',
        "[" * 100_000, '{"t_s": 1e300}', '{"actors": [{"id": 1, "at_m": [0, 0, 0], "size_m": [-1, 1, 1]}]}',
    ],
)  # fmt: skip
def test_a_wrong_line_is_refused_with_what_is_wanted(line: str) -> None:
    with pytest.raises(BadSample, match="want"):
        decoded(line)


def test_unknown_keys_are_named_once_each() -> None:
    actors = [{"id": k, "at_m": [0, 0, 0], "wings": 2} for k in (1, 2)]
    found = decoded(json.dumps({"colour": 1, "actors": actors}))
    assert found.unknown == ("colour", "actors.wings")


def test_what_is_recorded_is_read_back_to_the_last_bit() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        actors = [
            {"id": str(k), "at_m": rng.normal(size=3).tolist(), "yaw_deg": float(rng.normal() * 100), "host": k == 0,
             "velocity_m_s": rng.normal(size=3).tolist(), "turn_rate_deg_s": float(rng.normal()), "jump": k == 1}
            for k in range(3)
        ]  # fmt: skip
        update = decoded(encoded(actors, float(rng.random()), 5, ["a"], True))
        assert of_json(json.loads(json.dumps(as_json(update)))) == update
