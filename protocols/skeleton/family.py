"""`FAMILY` of a module, made of a session, its keys and its commands.

Belongs here: a family whose devices differ by keys alone, and one with a table of models. Not: families with several
sessions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from protocols.errors import DeviceSettingError
from protocols.framing import Framing
from protocols.session import CommandRow, DeviceKey, LinkKind, Session
from protocols.skeleton.keys import DeviceKeys
from protocols.wire import ANY, Wire


@dataclass(frozen=True)
class SimpleFamily:
    """A family whose `device:` table is read by one function."""

    name: str
    tcp_is_line: bool
    "Whether TCP reaches the device through a serial device server."
    build: Callable[[DeviceKeys], Session]
    "Reads the keys, with their defaults, and makes the session."
    rows: tuple[CommandRow, ...] = ()
    wire: Wire = ANY

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> Session:
        """A device that is switched off. Raises `DeviceSettingError`."""
        keys = DeviceKeys(device, facts)
        session = self.build(keys)
        keys.finish(device)  # a model may extend one of another family, whose facts it inherits
        return session

    def commands(self) -> tuple[CommandRow, ...]:
        """The coverage table."""
        return self.rows

    def framing(self, session: Session, kind: LinkKind) -> Framing | None:
        """How its telegrams are changed on their way."""
        return self.wire.framing(kind) if self.wire.framing is not None else None

    def device_keys(self) -> tuple[DeviceKey, ...]:
        """Every key, from the code that checks them."""
        return self.keys_of_model({})

    def keys_of_model(self, facts: Mapping[str, Any]) -> tuple[DeviceKey, ...]:
        """Those of a model, with its defaults and choices, for `lidaremu list device`."""
        keys = DeviceKeys({}, facts)
        self.build(keys)
        return tuple(keys.known)


Model = TypeVar("Model")
Device = TypeVar("Device", bound=Session)


@dataclass(frozen=True)
class ModelFamily(Generic[Model, Device]):
    """A family with a table of models; a spec's `device` table names one of them: `{model: ...}`."""

    name: str
    models: Mapping[str, Model]
    usual: str
    "Of a spec that names none."
    build: Callable[[DeviceKeys, Model], Device]
    "Reads the keys, with the defaults of the model, and makes the session. Raises `DeviceSettingError`."
    rows: tuple[CommandRow, ...]
    wire: Wire
    tcp_is_line: bool = False
    "Whether TCP reaches the device through a serial device server."
    further: Mapping[str, Callable[[Model, Any], Model]] = field(default_factory=dict)
    "Other keys of a spec's `device` table, and the model that they make of one of the maker's."

    def model_of(self, facts: Mapping[str, Any]) -> Model:
        """The model that a spec's `device` table states; `DeviceSettingError` when there is none."""
        name = facts.get("model", self.usual)
        if not isinstance(name, str) or name not in self.models:
            raise DeviceSettingError("model", name, " | ".join(self.models))
        model = self.models[name]
        for key, value in facts.items():
            if key != "model" and key not in self.further:
                raise DeviceSettingError(str(key), value, " or ".join(("model", *self.further)))
            if key != "model" and value is not None:
                model = self.further[key](model, value)
        return model

    def check_facts(self, facts: Mapping[str, Any]) -> None:
        """Raise `DeviceSettingError` for a spec's `device` table that is none."""
        self.model_of(facts)

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> Device:
        """A device that is switched off. Raises `DeviceSettingError`."""
        model, keys = self.model_of(facts), DeviceKeys(device, {})
        session = self.build(keys, model)
        keys.finish()
        return session

    def commands(self) -> tuple[CommandRow, ...]:
        """The coverage table."""
        return self.rows

    def framing(self, session: Session, kind: LinkKind) -> Framing | None:
        """How its telegrams are changed on their way."""
        return self.wire.framing(kind) if self.wire.framing is not None else None

    def device_keys(self) -> tuple[DeviceKey, ...]:
        """Every key of a scenario's `device:` table."""
        return self.keys_of_model({})

    def keys_of_model(self, facts: Mapping[str, Any]) -> tuple[DeviceKey, ...]:
        """Those of a model, with its defaults and limits."""
        keys = DeviceKeys({}, {})
        self.build(keys, self.model_of(facts))
        return tuple(keys.known)
