"""Hokuyo's scanners with SCIP 1.1, 2.0 and 2.2: URG-04LX, UBG-04LX-F01, UHG-08LX, UTM-30LX(-EW), UST-10LX, UST-20LX.

Reading order: `codec` (bytes), `models` (facts of each), `device` (states, sweeps, blocks), `commands`, `session`.
`settings.read` has the keys of a scenario's `device:` table.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from protocols.scip.commands import COMMANDS
from protocols.scip.framing import ScipFraming
from protocols.scip.models import model_of
from protocols.scip.session import ScipSession
from protocols.scip.settings import read
from protocols.session import CommandRow, DeviceKey, LinkKind, Session
from protocols.skeleton.keys import DeviceKeys
from protocols.skeleton.requests import coverage
from protocols.wire import Wire


class ScipFamily:
    """The family as `protocols.family("scip")` gives it."""

    name = "scip"
    tcp_is_line = False
    wire = Wire(
        (LinkKind.SERIAL, LinkKind.STREAM), lambda kind: ScipFraming(), LinkKind.SERIAL, (b"MD0044072501000\n",)
    )
    "Asked for all steps, continuously."

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> ScipSession:
        """A device that is switched off. Raises `DeviceSettingError`."""
        model = model_of(facts)
        keys = DeviceKeys(device, {})
        settings = read(keys, model)
        keys.finish()
        return ScipSession(model, settings)

    def commands(self) -> tuple[CommandRow, ...]:
        """The coverage table."""
        return coverage(COMMANDS)

    def framing(self, session: Session, kind: LinkKind) -> ScipFraming:
        """How its replies are changed on their way."""
        return ScipFraming()

    def device_keys(self) -> tuple[DeviceKey, ...]:
        """Every key of a scenario's `device:` table."""
        keys = DeviceKeys({}, {})
        read(keys, model_of({}))
        return tuple(keys.known)


FAMILY = ScipFamily()
