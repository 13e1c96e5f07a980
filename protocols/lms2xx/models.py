"""What sets the models of the LMS2xx family apart on the wire. One row a model; optics stand in the sensor specs.

A spec's `device` table is `{model: sick-lms291-s05}`; any field of `Model` may be overridden there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from protocols.errors import DeviceSettingError


@dataclass(frozen=True)
class Model:
    """Facts of one model."""

    model: str
    "Identifier, as the sensor spec is called."
    type_text: str
    "The 21 characters of the replies 90 and BA; `#` is the digit that tells the unit (3: cm, 1: mm)."
    config_bytes: int = 34
    "Length of the configuration block: 34, or 32 without the word A4."
    fast: bool = False
    "S14: 90 deg at 0.5 deg in one turn, no variant switch, range + reflectivity telegrams (C4)."
    status: int = 0x10
    "Source bits of every status byte."
    has_sensitivity: bool = True
    "Configuration byte B high is the receiver's sensitivity; else the peak threshold."
    reflectivity_k_m2: float = 9000.0
    "R^2 / reflectance of a Lambert target that just reaches the detection threshold at standard sensitivity."

    @property
    def firmware(self) -> str:
        """The seven characters of the software version."""
        return self.type_text[-7:]


def _outdoor(name: str, suffix: str, **facts: Any) -> Model:
    """LMS211, 221, 291: type text as Telegram Listing 7.15 and sicktoolbox search it; the padding is ours [A]."""
    digits = suffix.isdigit()
    middle = f"{suffix}#" if digits else f"{suffix:<6}"
    firmware = "S01.31 " if suffix in ("S19", "S20") else "X01.27 "  # listing 8007954/Q501, p. 2
    if suffix == "S14":
        facts |= {"fast": True, "status": 0x18}  # sicktoolbox, Stanford driver of an S14
    return Model(f"sick-{name.lower()}-{suffix.lower()}", f"{name};{middle};{firmware}", **facts)


def _indoor(name: str) -> Model:
    """LMS200, 220: text of a real LMS200-30106 (manorajesh/sick-lidar), old firmware with the 32-byte block.

    The range constant follows from 10 m at 10 % reflectivity (data sheet, unverified).
    """
    return Model(
        f"sick-{name.lower()}-30106",
        f"{name};30106#;V02.10 ",
        config_bytes=32,
        has_sensitivity=False,
        reflectivity_k_m2=1000.0,
    )


MODELS: Mapping[str, Model] = {
    model.model: model
    for model in (
        _indoor("LMS200"),
        *(_outdoor("LMS211", suffix) for suffix in ("30106", "30206", "S07", "S14", "S15", "S19", "S20")),
        _indoor("LMS220"),
        *(_outdoor("LMS221", suffix) for suffix in ("30106", "30206", "S07", "S14", "S15", "S16", "S19", "S20")),
        *(_outdoor("LMS291", suffix) for suffix in ("S05", "S14", "S15")),
    )
}
"Every model that sicktoolbox knows by name."


def model_of(facts: Mapping[str, Any]) -> Model:
    """The model of a spec's `device` table, with what the table overrides. Raises `DeviceSettingError`."""
    name = str(facts.get("model"))
    if name not in MODELS:
        raise DeviceSettingError("model", name, f"one of {', '.join(MODELS)}")
    known = {field.name: field for field in fields(Model)}
    for key, value in facts.items():
        if key not in known:
            raise DeviceSettingError(key, value, f"one of {', '.join(known)}")
    model = replace(MODELS[name], **{str(key): value for key, value in facts.items()})
    if len(model.type_text) != 21 or not model.type_text.isascii():
        raise DeviceSettingError("type_text", model.type_text, "21 ASCII characters")
    if model.config_bytes not in (32, 34):
        raise DeviceSettingError("config_bytes", model.config_bytes, "32 or 34")
    return model
