"""The models of the family, and their default identification."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from protocols.errors import DeviceSettingError

IDENTITIES = {
    0x0000: "sensor_part_number",
    0x0001: "sensor_name",
    0x0002: "sensor_version",
    0x0003: "sensor_serial_number",
    0x0004: "edm_serial_number",
    0x0010: "firmware_part_number",
    0x0011: "firmware_name",
    0x0012: "firmware_version",
    0x0020: "application_part_number",
    0x0021: "application_name",
    0x0022: "application_version",
}
"Items of GET_IDENTIFICATION (sicktoolbox)."


@dataclass(frozen=True)
class Model:
    """Facts of one model that its conversation depends on."""

    name: str
    sensor_name: str
    "As GET_IDENTIFICATION 0001 gives it."
    max_range_m: float
    "A farther echo is reported as none. 250 m: sicktoolbox_wrapper's range_max, Miro's no-echo limit."
    near_field_m: float = 2.5
    """Echoes nearer than this are ignored while near-field suppression is on: the supplement (p. 5, 22) gives 2.5 m
    as shortest range, and 250 m as largest one without it."""
    fastest_hz: int = 20
    "Of the head; 10 in LD-LRS1000, 2100 and 3100 (supplement p. 5, 22)."
    useful_deg: int = 360
    "Arc that a device measures as delivered; 300 through the window of LD-LRS2100 and 3100."
    speaks_cola: bool = False
    "CoLa binary beside the user protocol (supplement, p. 18-21)."
    has_interlace: bool = False
    "Knows configuration item 0011 (LD-LRS36x1 only, by the C port of sicktoolbox)."

    def identities(self) -> dict[str, str]:
        """Texts by name; part numbers, serial numbers and versions are placeholders."""
        texts = dict.fromkeys(IDENTITIES.values(), "0000000")
        texts |= {name: "V1.00" for name in texts if name.endswith("version")}
        return texts | {"sensor_name": self.sensor_name, "firmware_name": "LD-FW", "application_name": "LD-APP"}


MODELS = {
    model.name: model
    for model in (
        Model("sick-ld-lrs1000", "LD-LRS1000", 250.0, fastest_hz=10, speaks_cola=True),
        Model("sick-ld-lrs2100", "LD-LRS2100", 250.0, fastest_hz=10, useful_deg=300, speaks_cola=True),
        Model("sick-ld-lrs3100", "LD-LRS3100", 250.0, fastest_hz=10, useful_deg=300, speaks_cola=True),
        Model("sick-ld-oem1000", "LD-OEM1000", 250.0),
        Model("sick-ld-lrs3611", "LD-LRS3611", 250.0, has_interlace=True),
        Model("lase-eld-l-a", "ELD-L-A", 250.0),
    )
}


def model_of(facts: Mapping[str, Any]) -> Model:
    """The model that a spec's `device` table names; `DeviceSettingError` if it names none, or has other keys."""
    for key in facts:
        if key != "model":
            raise DeviceSettingError(key, facts[key], "only `model` in the device table of an ld spec")
    name = facts.get("model")
    if not isinstance(name, str) or name not in MODELS:
        raise DeviceSettingError("model", name, " | ".join(MODELS))
    return MODELS[name]
