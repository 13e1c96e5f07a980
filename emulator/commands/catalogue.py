"""What there is to choose from, as rows for `lidaremu list`: read from the tables that do the work."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

Row = dict[str, object]


class DeviceKey(Protocol):
    """One key of a scenario's `device:` table."""

    name: str
    allowed: str
    default: str
    meaning: str


@runtime_checkable
class HasDeviceKeys(Protocol):
    """A family that lists the keys of its `device:` table."""

    def device_keys(self) -> Sequence[DeviceKey]: ...


@runtime_checkable
class HasKeysOfModel(Protocol):
    """A family whose models have keys of their own: they depend on the spec's `device` table."""

    def keys_of_model(self, facts: Mapping[str, Any]) -> Sequence[DeviceKey]: ...


def sensors() -> list[Row]:
    """Every sensor model and the family whose protocol it speaks."""
    from emulator.sensors.spec import list_models, load_spec

    specs = [load_spec(name) for name in list_models()]
    return [{"model": spec.model, "family": spec.family or "-", "title": spec.title} for spec in specs]


def scenarios() -> list[Row]:
    """Every built-in scenario, with its first comment."""
    from emulator.scenario.scenario import builtin_names, builtin_summary

    return [{"scenario": name, "summary": builtin_summary(name)} for name in builtin_names()]


def materials() -> list[Row]:
    """Every material with its reflectance at 905 nm and 1550 nm."""
    from emulator.physics.materials import builtin_materials

    return [
        {
            "material": name,
            "rho_905": found.reflectance(905),
            "rho_1550": found.reflectance(1550),
            "source": found.source,
        }
        for name, found in sorted(builtin_materials().items())
    ]


def links() -> list[Row]:
    """Every kind of link."""
    from emulator.transports.schemes import LINK_SCHEMES

    return [{"form": scheme.form, "help": scheme.help} for scheme in LINK_SCHEMES.values()]


def commands(family_name: str | None) -> list[Row]:
    """Every command of a protocol family; `KeyError` names the families."""
    from protocols import families, family

    if family_name is None:
        raise KeyError(f"commands of which family? known: {', '.join(sorted(families()))}")
    return [
        {"code": row.code, "name": row.name, "status": row.status, "source": row.source, "note": row.note}
        for row in family(family_name).commands()
    ]


def faults(name: str | None) -> list[Row]:
    """Every fault that can be injected, or the keys of one; `KeyError` names those there are."""
    from emulator.faults.catalogue import rows as fault_rows

    return fault_rows(name)


def device(model: str | None) -> list[Row]:
    """Every key that a sensor's `device:` table may have; `KeyError` names the models."""
    from emulator.sensors.spec import is_file, list_models, load_spec
    from protocols import family

    model = str(Path(model).absolute()) if model and is_file(model) else model
    if model not in list_models() and not (model and is_file(model)):
        found = f"unknown model {model!r}" if model else "device of which model?"
        raise KeyError(f"{found}; known: {', '.join(list_models())}")
    name = load_spec(str(model)).family
    spoken = family(name) if name else None
    keys: Sequence[DeviceKey]
    if isinstance(spoken, HasKeysOfModel):
        keys = spoken.keys_of_model(load_spec(str(model)).device)
    elif isinstance(spoken, HasDeviceKeys):
        keys = spoken.device_keys()
    else:
        raise KeyError(f"{model}: its family lists no keys of `device:`; see docs")
    return [{"key": key.name, "allowed": key.allowed, "default": key.default, "meaning": key.meaning} for key in keys]


TABLES: dict[str, Callable[[], list[Row]]] = {
    "sensors": sensors,
    "scenarios": scenarios,
    "materials": materials,
    "links": links,
}
"What `lidaremu list` knows by its name alone."
OF_ONE: dict[str, Callable[[str | None], list[Row]]] = {"commands": commands, "device": device, "faults": faults}
"What it knows of a family, of a model, or of a fault."


def rows(what: str, name: str | None = None) -> list[Row]:
    """Rows of one table; `KeyError` with what there is when the name is unknown."""
    return OF_ONE[what](name) if what in OF_ONE else TABLES[what]()
