"""Which sensor is behind a link: families and line speeds tried in turn, the device left as it was found.

Belongs here: the order of tries and what was learnt. Not: protocols (hosts), options (commands).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from emulator.errors import EmulatorError, LinkError
from emulator.hosts.families import BUILT_IN, found_at, on_lines
from emulator.hosts.lines import Line, open_line
from emulator.looking.look import HasHost, tidy
from protocols.session import LinkKind
from protocols.wire import wire_of

CAN_SCHEMES = ("socketcand", "slcan", "can")
FIRST_BAUD = 9_600


@dataclass(frozen=True)
class Found:
    """What is behind a link."""

    family: str
    title: str
    "The device's own name for itself; of an object list the model of its format."
    baud: int | None
    "Line speed at which it was found; None where there is none."
    answers: bool
    "False: it sends but follows no request, as a recording that is sent again."

    def reported(self) -> str:
        """One line for a user."""
        speed = "" if self.baud is None else f" at {self.baud} baud"
        how = "" if self.answers else "; it sends and answers nothing, as a recording that is sent again"
        return f"{self.family}: {self.title}{speed}{how}"


Try = tuple[str, Callable[[Line], Found]]


def probe(url: str, tell: Callable[[str], None] = lambda text: None) -> Found:
    """What is behind that link; `tell` hears of each family that is tried. `LinkError` when nothing known is."""
    if url.partition(":")[0] in CAN_SCHEMES:
        tell(f"{url}: listening for object lists")
        return _objects(url)
    refused = []
    for name, attempt in tries(url.startswith("tcp:")):
        tell(f"{url}: trying {name}")
        line = open_line(url, FIRST_BAUD)
        try:
            return attempt(line)
        except LinkError as error:
            refused.append(f"{name}: {error}")
        finally:
            line.close()
    raise LinkError(f"{url}: no sensor recognised; {'; '.join(refused)}")


def tries(tcp: bool) -> list[Try]:
    """Families in the order in which they are tried: first those that usually have such a link."""
    from protocols import families, family

    usual = LinkKind.STREAM if tcp else LinkKind.SERIAL
    own = sorted(on_lines(), key=lambda name: (wire := wire_of(name)) is None or wire.usual is not usual)
    found: list[Try] = [(name, partial(_built_in, name)) for name in own]
    for name in families():
        known = family(name) if name not in BUILT_IN else None
        if isinstance(known, HasHost):
            found.append((name, lambda line, name=name, known=known: _foreign(name, known, line)))
    return found


def _built_in(name: str, line: Line) -> Found:
    host = found_at(BUILT_IN[name].host)(line, None)
    return Found(name, tidy(host.title), host.found_baud, not host.listens)


def _foreign(name: str, family: HasHost, line: Line) -> Found:
    host = family.host(line, FIRST_BAUD)
    try:
        return Found(name, tidy(host.title), None, True)
    finally:
        host.close()


def _objects(url: str) -> Found:
    from emulator.hosts.can_lines import open_can
    from emulator.hosts.can_objects import CanObjectHost

    bus = open_can(url)
    try:
        return Found("can_objects", CanObjectHost(bus).title, None, True)
    except LinkError as error:
        raise LinkError(f"{url}: {error}") from None
    except EmulatorError:
        raise
    finally:
        bus.close()
