"""The scenarios of a soak, cheap to measure.

The usual one: LMS291 at 37.5 scans per second, LD-LRS, TiM551, an object list on CAN. The others: four desk scanners;
three lidars of many layers on a street, whose world is a sphere: every slice of a turn may be repeated for any other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from emulator.scenario import scenario
from emulator.scenario.scenario import Scenario

LMS_RATE_HZ, LD_RATE_HZ, COLA_RATE_HZ, LIST_RATE_HZ = 37.5, 5.0, 15.0, 1e3 / 75.0
LMS_BEAMS, LD_BEAMS, COLA_BEAMS = 361, 360, 271
DESK: dict[str, tuple[str, str]] = {
    "urg": ("hokuyo-uhg-08lx", "{}"),
    "slam": ("rplidar-a1m8", "{wobble: 0}"),
    "ld": ("ldrobot-ld19", "{speed_wobble: 0}"),
    "eai": ("ydlidar-x4", "{speed_wobble: 0}"),
}
"Scanner -> model and its device: the four families that people have on their desks, on a line each."
STREET: dict[str, tuple[str, str]] = {
    "velo": ("velodyne-vlp-16", "{boot_s: 1, spin_up_s: 1}"),
    "oust": ("ouster-os0-32", "{config: {lidar_mode: 512x10, udp_profile_lidar: RNG15_RFL8_NIR8}}"),
    "hesa": ("hesai-xt32", "{boot_s: 1, spin_up_s: 1}"),
}
"Lidar -> model and its device: the families that measure turns in slices, on TCP."
DESK_WALL_M = 4.0
WALL_M = 8.0
"What the middle beam of the scanners sees."

_TEXT = """\
schema: 1
seed: {seed}
world:
  - {{plane: {{size_m: [6, 60]}}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}}
actors:
  - id: car
    class: car
    shape: {{box: {{size_m: [4, 1.8, 1.5]}}}}
    material: car_paint_grey
    motion: {{at_m: [7, 4, 0]}}
sensors:
  - id: front
    model: sick-lms291-s05
    mount: {{at_m: [0, 0, 1]}}
    device: {{resolution_deg: 0.5, field_deg: 180}}
    physics: {physics}
    links: ["{front}"]
  - id: top
    model: sick-ld-lrs1000
    mount: {{at_m: [0, 0, 1]}}
    device: {{delays: fast, step_deg: 1.0, motor_hz: 5}}
    physics: {physics}
    links: ["{top}"]
  - id: gate
    model: sick-tim551
    mount: {{at_m: [0, 0, 1]}}
    physics: {physics}
    links: ["{gate}"]
  - id: objects
    model: can-ars408
    from: [front]
    mount: {{at_m: [0, 0, 1]}}
    links: ["{objects}"]
"""
_DESK_WORLD = """\
schema: 1
seed: {seed}
world:
  - {{plane: {{size_m: [6, 60]}}, at_m: [{wall_m}, 0, 1], pitch_deg: -90, material: white_plaster}}
sensors:
"""
_STREET_WORLD = """\
schema: 1
seed: {seed}
world:
  - {{sphere: {{radius_m: {wall_m}}}, at_m: [0, 0, -{wall_m}], material: white_plaster}}
sensors:
"""
_DESK = """\
  - id: {name}
    model: {model}
    mount: {{at_m: [0, 0, 1]}}
    device: {device}
    physics: {physics}
    links: ["{link}"]
"""
_STREET = """\
  - {{id: {name}, model: {model}, device: {device}, physics: {physics}, links: ["{link}"]}}
"""
_PHYSICS = "{rule: axis, sub_beams: 1, background: false, weather_echoes: false}"


def soak_text(
    seed: int,
    front: str = "loop:front",
    top: str = "loop:top",
    objects: str = "can:virtual:soak",
    gate: str = "loop:gate",
) -> str:
    """The scenario with these links."""
    return _TEXT.format(seed=seed, physics=_PHYSICS, front=front, top=top, objects=objects, gate=gate)


def desk_text(seed: int, link: str = "loop:") -> str:
    """That of the desk scanners; their links are `link` and their names."""
    sensors = (
        _DESK.format(name=name, model=model, device=device, physics=_PHYSICS, link=link + name)
        for name, (model, device) in DESK.items()
    )
    return _DESK_WORLD.format(seed=seed, wall_m=DESK_WALL_M) + "".join(sensors)


def street_text(seed: int, link: str = "loop:") -> str:
    """That of the lidars of a street; their links are `link` and their names."""
    sensors = (
        _STREET.format(name=name, model=model, device=device, physics=_PHYSICS, link=link + name)
        for name, (model, device) in STREET.items()
    )
    return _STREET_WORLD.format(seed=seed, wall_m=WALL_M) + "".join(sensors)


TEXTS: Mapping[str, Callable[[int], str]] = {"": soak_text, "desk": desk_text, "street": street_text}
"By the sensors that a soak is of."


def soak_scenario(seed: int, sensors: str = "") -> Scenario:
    """The scenario, judged. `sensors`: one of `TEXTS`."""
    return scenario.loads(TEXTS[sensors](seed), Path("soak.yaml"))
