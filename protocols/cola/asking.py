"""Requests in either dialect: read, write, call, subscribe, each with its answer or `sFA`.

Belongs here: from a telegram to a row of the table and back. Not: what a row does (answers), scans (session).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

from protocols.cola.answers import Sfa, refusal
from protocols.cola.commands import METHODS, VARIABLES, Method, Variable, codes
from protocols.cola.settings import RUN
from protocols.cola.state import ColaState
from protocols.session import DropReason, LinkKind
from protocols.skeleton.cola_frames import UNKNOWN, ColaSplitter, frame, refused, telegram
from protocols.skeleton.cola_values import ASCII, BINARY, Code, Rejected, decode, encode
from protocols.skeleton.requests import Answer, Command, Refused, Request

ANSWERS = {b"sRN": b"sRA", b"sRI": b"sRA", b"sWN": b"sWA", b"sMN": b"sAN", b"sEN": b"sEA"}


class ColaAsking(ColaState):
    """One device, without its scans."""

    REPLY_NS: ClassVar[int] = 2_000_000

    @abstractmethod
    def _poll(self, request: Request) -> Answer | Refused:
        """The last scan."""

    @abstractmethod
    def _listen(self, name: str, on: int, request: Request) -> bytes | Refused:
        """Subscribe to an event, or no more."""

    def delivered(self) -> dict[str, Any]:
        """Variables as the factory delivers them."""
        settings, rows = self.settings, VARIABLES.items()
        return {name: one.factory(settings) for name, one in rows if one.factory is not None and one.on(settings.model)}

    def _may(self, level: int, request: Request) -> bool:
        return not self.settings.strict or self.levels.get(request.address, RUN) >= level

    def _splitter(self, kind: LinkKind | None) -> ColaSplitter:
        return ColaSplitter()

    def _parse(self, request: bytes) -> tuple[bytes, bytes]:
        """The code is kind and name; the data are dialect, name, a NUL and the arguments."""
        dialect, payload = request[:1], request[1:].lstrip(b" ")
        kind, _, rest = payload.partition(b" ")
        if kind == b"sRI":
            return kind, dialect + b"0\0" + rest
        name, _, arguments = rest.partition(b" ")
        known = kind in UNKNOWN and len(name) <= 64 and name.isalnum()
        return (kind + b" " + name if known else b"?" if payload else b""), dialect + name + b"\0" + arguments

    def _reply(self, request: Request, payload: bytes) -> bytes:
        dialect, name = request.data[:1], request.data[1:].partition(b"\0")[0]
        if request.code == b"sRI" and dialect == BINARY:
            return frame(dialect, b"sRA \0\0" + payload)
        return telegram(dialect, ANSWERS[request.code[:3]], name, payload)

    def _refusal(self, request: Request, why: Refused) -> bytes | None:
        dialect = request.data[:1]
        if not self._speaks(dialect):
            return None
        self._dialects[request.address] = dialect
        code = why.code if isinstance(why, Sfa) else UNKNOWN.get(request.code[:3], Code.COMMAND_UNKNOWN)
        return frame(dialect, refused(dialect, code))

    def _speaks(self, dialect: bytes) -> bool:
        """Whether it speaks that dialect at present."""
        spoken = BINARY if self.values["EIHstCola"] == [1] else ASCII
        return self.settings.dialect == "both" or dialect == spoken

    def _asked_for(self, request: Request) -> bytes | Answer | Refused:
        """Every row of the table leads here."""
        dialect, (raw, _, data) = request.data[:1], request.data[1:].partition(b"\0")
        if not self._speaks(dialect):
            return Answer(None)
        self._dialects[request.address] = dialect
        if "busy" in self.faults:
            return refusal(Code.BUSY, DropReason.BUSY)
        kind, name = request.code[:3], raw.decode("ascii", "replace")
        try:
            if kind == b"sRI":
                (index,) = decode("u16", dialect, data)
                return refusal(Code.OUT_OF_BOUNDS) if index else self._read("DeviceIdent", dialect, request.now_ns)
            if kind == b"sRN" and name == "LMDscandata":
                return self._poll(request)
            if kind == b"sEN":
                return self._listen(name, decode("u8", dialect, data)[0], request)
            if kind == b"sMN":
                return self._call(METHODS[name], data, request)
            variable = VARIABLES[name]
            if not variable.on(self.settings.model):
                return refusal(Code.VARIABLE_UNKNOWN, DropReason.UNKNOWN_COMMAND, name)
            if kind == b"sRN":
                return self._read(name, dialect, request.now_ns)
            return self._write(name, variable, data, request)
        except Rejected as rejected:
            return refusal(rejected.code)

    def _read(self, name: str, dialect: bytes, now_ns: int) -> bytes:
        variable = VARIABLES[name]
        values = self.values[name] if variable.live is None else variable.live(self, now_ns)
        return encode(variable.layout_of(self.settings.model), dialect, values)

    def _write(self, name: str, variable: Variable, data: bytes, request: Request) -> bytes | Refused:
        if variable.level is None or not self._may(variable.level, request):
            return refusal(Code.WRITE_DENIED, DropReason.WRONG_MODE)
        values = decode(variable.layout_of(self.settings.model), request.data[:1], data)
        if variable.check is not None and (code := variable.check(self, values)) is not None:
            return refusal(code)
        if values != self.values[name]:
            self.values[name] = values
            if variable.rearranges:
                self.rearrange(request.now_ns)
        return b""

    def _call(self, method: Method, data: bytes, request: Request) -> bytes | Answer | Refused:
        if not method.on(self.settings.model):
            return refusal(Code.METHOD_UNKNOWN, DropReason.UNKNOWN_COMMAND)
        if not self._may(method.level, request):
            return refusal(Code.METHOD_DENIED, DropReason.WRONG_MODE)
        dialect = request.data[:1]
        found = method.act(self, decode(method.arguments, dialect, data), request)
        if isinstance(found, Sfa):
            return found
        return Answer(encode(method.result, dialect, found), restarts=method.restarts)

    COMMANDS: ClassVar[Mapping[bytes, Command]] = {
        code.encode(): Command(code, lambda session, request: session._asked_for(request), "") for code in codes()
    }
