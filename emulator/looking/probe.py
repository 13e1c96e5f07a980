"""Which sensor is behind a link: families and line speeds tried in turn, the device left as it was found.

Belongs here: the order of tries and what was learnt. Not: protocols (hosts), options (commands).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from emulator.errors import EmulatorError, LinkError
from emulator.hosts.lines import Line, open_line
from emulator.looking.look import CAN_FAMILY, HasHost, tidy

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
    "False: it sends but heeds no request, as a recording that is sent again."

    def told(self) -> str:
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
    """Families in the order in which they are tried; over TCP an LD is likelier."""
    from protocols import families, family

    found: list[Try] = [("lms2xx", _lms2xx), ("ld", _ld)]
    if tcp:
        found.reverse()
    found.append(("scip", _scip))
    for name in families():
        known = family(name) if name not in (*(one for one, _ in found), CAN_FAMILY) else None
        if isinstance(known, HasHost):
            found.append((name, lambda line, name=name, known=known: _stranger(name, known, line)))
    return found


def _lms2xx(line: Line) -> Found:
    from emulator.hosts.lms2xx import Lms2xxHost

    host = Lms2xxHost(line, None)
    return Found("lms2xx", tidy(host.title), host.found_baud, not host.listens)


def _ld(line: Line) -> Found:
    from emulator.hosts.ld import LdHost

    host = LdHost(line, None)
    return Found("ld", tidy(host.title), host.found_baud, not host.listens)


def _scip(line: Line) -> Found:
    from emulator.hosts.scip import ScipHost

    host = ScipHost(line, None)
    return Found("scip", tidy(host.title), host.found_baud, not host.listens)


def _stranger(name: str, family: HasHost, line: Line) -> Found:
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
        return Found(CAN_FAMILY, CanObjectHost(bus).title, None, True)
    except LinkError as error:
        raise LinkError(f"{url}: {error}") from None
    except EmulatorError:
        raise
    finally:
        bus.close()
