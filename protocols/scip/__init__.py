"""Hokuyo's scanners with SCIP 1.1, 2.0 and 2.2: URG-04LX, UBG-04LX-F01, UHG-08LX, UTM-30LX(-EW), UST-10LX, UST-20LX.

Reading order: `codec` (bytes), `models` (facts of each), `device` (states, sweeps, blocks), `commands`, `session`.
`settings.read` has the keys of a scenario's `device:` table.
"""

from __future__ import annotations

from protocols.scip.commands import COMMANDS
from protocols.scip.framing import ScipFraming
from protocols.scip.models import MODELS
from protocols.scip.session import ScipSession
from protocols.scip.settings import read
from protocols.session import LinkKind
from protocols.skeleton.family import ModelFamily
from protocols.skeleton.requests import coverage
from protocols.wire import Wire

LINKS = (LinkKind.SERIAL, LinkKind.STREAM)
ASKED = (b"MD0044072501000\n",)
"For all steps, continuously."
FAMILY = ModelFamily(
    name="scip",
    models=MODELS,
    usual="hokuyo-utm-30lx",
    build=lambda keys, model: ScipSession(model, read(keys, model)),
    rows=coverage(COMMANDS),
    wire=Wire(LINKS, lambda kind: ScipFraming(), LinkKind.SERIAL, ASKED),
)
