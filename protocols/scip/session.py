"""One SCIP device: lines in, replies with echo, status and sums out.

Belongs here: the form of requests and replies, and which commands a state accepts. Not: what they do (commands).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from protocols.scip import commands
from protocols.scip.codec import summed
from protocols.scip.device import ScipDevice
from protocols.session import DropReason, LinkKind
from protocols.skeleton.receiving import LineSplitter
from protocols.skeleton.requests import Command, Refused, Request

LONGEST = 64
"Of a request; the longest has 15 characters, `;` and 16 of the host."


class ScipSession(ScipDevice):
    """With its commands."""

    COMMANDS: ClassVar[Mapping[bytes, Command]] = commands.COMMANDS

    def _splitter(self, kind: LinkKind | None) -> LineSplitter:
        return LineSplitter(LONGEST, b"\n", b"\r")

    def _parse(self, request: bytes) -> tuple[bytes, bytes]:
        line = request.rstrip(b"\r\n")
        if line.partition(b";")[0] == commands.SWITCH:
            return commands.SWITCH, line[len(commands.SWITCH) :]
        if self.scip1 and line:
            return commands.OLD + line[:1], line[1:]
        size = 3 if line[:1] in (b"%", b"$") else 2
        return line[:size], line[size:]

    def _not_now(self, request: Request) -> Refused | None:
        errors, code, tag = self.model.errors, request.code, request.data.partition(b";")[2]
        if len(tag) > commands.MOST_TAG:
            return commands.refused(errors["tag"], f"{len(tag)} characters; want {commands.MOST_TAG}")
        if code not in self.COMMANDS or self.scip1 or code == commands.SWITCH:
            return None
        if self.in_time_mode and code not in commands.ANY_TIME:
            return commands.refused(errors["unknown"], "in time mode", DropReason.WRONG_MODE)
        accepted = code in commands.EVEN_FAULTY or (self.model.protocol == "SCIP 2.0" and code in (b"RS", b"RT"))
        if self.faulty and not accepted:
            return commands.refused(errors["abnormal"], "abnormal condition", DropReason.WRONG_MODE)
        return None

    def _echo(self, request: Request) -> bytes:
        return request.code.removeprefix(commands.OLD) + request.data + b"\n"

    def _reply(self, request: Request, payload: bytes) -> bytes:
        return self._echo(request) + payload + b"\n"

    def _refusal(self, request: Request, refused: Refused) -> bytes:
        code = refused.detail.partition(" ")[0].encode()
        if refused.reason is DropReason.UNKNOWN_COMMAND and not (len(code) == 2 and code.isalnum()):
            code = self.model.errors["unknown"].encode()
        if refused.reason is DropReason.REFUSED and not code[:1].isdigit():
            code = self.model.errors["absent"].encode()
        if self.scip1:
            return self._echo(request) + (code if len(code) == 1 else b"E") + b"\n\n"
        return self._echo(request) + summed(code) + b"\n"
