"""What sets the models of the LMS2xx family apart on the wire. One row a model; optics stand in the sensor specs.

A spec's `device` table is `{model: sick-lms291-s05}`; any field of `Model` may be overridden there.
"""

from __future__ import annotations

import re
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
    "The 21 characters of the replies 90 and BA."
    config_bytes: int = 34
    "Length of the configuration block: 34, or 32 without the word A4 (firmware before V2.10 and X1.10)."
    fast: bool = False
    "S14: 90 deg at 0.5 deg in one turn, no variant switch, range + reflectivity telegrams (C4)."
    status: int = 0x10
    "Source bits of every status byte."
    has_sensitivity: bool = True
    "Configuration byte B high is the receiver's sensitivity; else the peak threshold."
    indoor: bool = False
    "LMS200, LMS220: mm at delivery, no operating data counter, no contour on a plane."
    special: bool = False
    "LMS211/221-S19 and -S20: another software, with two subtractive areas."
    reflectivity_k_m2: float = 9000.0
    "R^2 / reflectance of a Lambert target that just reaches the detection threshold at standard sensitivity."

    @property
    def firmware(self) -> str:
        """The seven characters of the software version."""
        return self.type_text[-7:]


def _outdoor(name: str, suffix: str, **facts: Any) -> Model:
    """LMS211, 221, 291: type text as Telegram Listing 7.15 and sicktoolbox search it; the padding is ours [A].

    The 3 behind a number is part of it in the listing; one log of an LMS200 has 1 there, whatever its unit.
    """
    middle = f"{suffix}3" if suffix.isdigit() else f"{suffix:<6}"
    firmware = "S01.31 " if suffix in ("S19", "S20") else "X01.27 "  # listing 8007954/Q501, p. 2
    if suffix in ("S19", "S20"):
        facts |= {"special": True}
    if suffix == "S14":
        facts |= {"fast": True, "status": 0x18}  # sicktoolbox, Stanford driver of an S14
    return Model(f"sick-{name.lower()}-{suffix.lower()}", f"{name};{middle};{firmware}", **facts)


def _indoor(name: str) -> Model:
    """LMS200, 220: text of a real LMS200-30106 (manorajesh/sick-lidar), from which 34 bytes of block were read.

    The range constant follows from 10 m at 10 % reflectivity (data sheet, unverified).
    """
    return Model(
        f"sick-{name.lower()}-30106",
        f"{name};301063;V02.10 ",
        has_sensitivity=False,
        indoor=True,
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


NEWER_BLOCK = {"V": (2, 10), "X": (1, 10)}
"Firmware from which the configuration block has 34 bytes (listing, p. 31)."


def with_firmware(model: Model, text: object) -> Model:
    """The model with another software, `V02.10` or the like. Raises `DeviceSettingError`."""
    match = re.fullmatch(r"([VXS])(\d\d)\.(\d\d)", text) if isinstance(text, str) else None
    if match is None:
        raise DeviceSettingError("firmware", text, "V, X or S and a version: V02.10")
    line, version = match[1], (int(match[2]), int(match[3]))
    older = line in NEWER_BLOCK and version < NEWER_BLOCK[line]
    return replace(model, type_text=f"{model.type_text[:-7]}{text} ", config_bytes=32 if older else 34)


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
