"""SICK CoLa-A and CoLa-B: LMS1xx, LMS5xx, TiM5xx, TiM7xx and MRS1000 on TCP 2111 and 2112, CoLa-A on serial lines.

framing     telegrams changed by faults; frames and values of both dialects: skeleton.cola_frames, cola_values
layouts     of variables, scans and events
scandata    LMDscandata
models, settings   facts of the models, the scenario's `device` table
commands    variables, methods, events: the table
answers     what its rows do
filters     echo choice, fog, particle, median and mean filter
fields      field evaluation
shapes      beams and telegrams at the present settings
state       what the device remembers
asking      requests in either dialect, with their answers
session     what happens when, and to whom scans go
"""

from __future__ import annotations

from protocols.cola.commands import rows
from protocols.cola.framing import ColaFraming
from protocols.cola.session import ColaSession
from protocols.cola.settings import settings_of
from protocols.session import LinkKind
from protocols.skeleton.cola_frames import frame
from protocols.skeleton.cola_values import BINARY
from protocols.skeleton.family import SimpleFamily
from protocols.skeleton.keys import DeviceKeys
from protocols.wire import Wire


def new_session(keys: DeviceKeys) -> ColaSession:
    """Of a scenario's `device:` table."""
    return ColaSession(settings_of(keys))


WIRE = Wire(
    (LinkKind.STREAM, LinkKind.SERIAL, LinkKind.DATAGRAM),
    lambda kind: ColaFraming(),
    LinkKind.STREAM,
    (frame(BINARY, b"sEN LMDscandata \x01"),),
    impaired=("busy", "login"),
)
FAMILY = SimpleFamily("cola", tcp_is_line=False, build=new_session, rows=rows(), wire=WIRE)
