"""A running daemon, asked again and again through its control socket."""

from __future__ import annotations

import base64
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from emulator.errors import EmulatorError, LinkError
from emulator.runtime.control import ask
from emulator.runtime.own_daemon import OwnDaemon
from emulator.runtime.snapshots import LONG, ORIGIN, SHORT
from emulator.scenario import scenario as scenario_file
from emulator.scenario.scenario import Scenario
from emulator.view.frames import Frame, ShownLink, ShownScan, ShownSensor, ShownTelegram, ViewError

KEPT = 64
"Telegrams of each sensor."
INSTANT_S = 1e-6
SOON_S = 1.0
"A daemon that hangs up will have ended by then."


class LiveSource:
    """Polls one daemon. `frame` and `order` may be called from different threads."""

    length_s: float | None = None
    can_restart = False
    "It is somebody else's."

    def __init__(self, path: Path, daemon: OwnDaemon | None = None) -> None:
        """Raises `LinkError` when no daemon answers, `ViewError` when it shows nothing. `daemon`: where it is ours."""
        self._path = path
        self._daemon = daemon
        parts, at = [], 0
        while at is not None:
            found = self._ask("scene", {"at": at})
            parts.append(found["yaml"])
            at = found["next"]
        self.source = Path(found["source"])
        self.scenario: Scenario = scenario_file.loads("".join(parts), self.source)
        self.title: str = self.source.stem
        self._scans: dict[str, ShownScan] = {}
        self._numbers: dict[str, int] = {}
        self._telegrams: dict[str, deque[ShownTelegram]] = {}
        self._telegram_numbers: dict[str, int] = {}
        self._keeper: int = 0
        self._missed: int = 0
        self._notes: tuple[str, ...] = ()
        self._last: Frame = Frame(0.0, False, False, None)
        self._end_s: float | None = None

    def _ask(self, method: str, params: Mapping[str, Any]) -> Any:
        return ask(self._path, method, params)

    def stand_at_end(self) -> None:
        """Have time stand where the scenario ends by its `duration_s`; whoever looks may let it go on."""
        self._end_s = None if self.scenario.loop else self.scenario.duration_s
        if self._end_s is not None:
            self._ask("pause", {"at_s": self._end_s})

    def _at_end(self, glance: Mapping[str, Any]) -> str:
        if self._end_s is None or not glance["paused"] or abs(glance["now_s"] - self._end_s) > INSTANT_S:
            return ""
        return f"The scenario ends at {self._end_s:g} s. Restart begins again, Resume continues beyond its end."

    def order(self, method: str, params: Mapping[str, Any]) -> Any:
        """An order to the daemon."""
        return self._ask(method, params)

    def frame(self) -> Frame:
        """What the daemon has now."""
        try:
            glance = self._ask("glance", {})
            self._take_scans(self._ask("scans", {"since": self._numbers}))
            self._take_telegrams(self._ask("telegrams", {"since": self._telegram_numbers, "count": 32}))
        except EmulatorError as error:  # gone, or just going
            return replace(self._last, ended=self._how_it_ended() or str(error))
        except (KeyError, TypeError, ValueError) as error:
            raise ViewError(f"{self._path}: an invalid answer: {error!r}") from None
        self._last = Frame(
            now_s=glance["now_s"],
            virtual=glance["clock"] == "virtual",
            paused=glance["paused"],
            speed=glance["speed"],
            scans=dict(self._scans),
            sensors={name: _sensor(row) for name, row in glance["sensors"].items()},
            telegrams=self._reported(),
            telegrams_missed=self._missed,
            notes=self._notes,
            stands=self._at_end(glance),
        )
        return self._last

    def _how_it_ended(self) -> str:
        """Of a daemon of ours that answers no more; empty while it runs."""
        return "" if self._daemon is None or self._daemon.code(SOON_S) is None else self._daemon.how

    @property
    def failed(self) -> bool:
        """Whether a daemon of ours has ended, and not as asked."""
        return self._daemon is not None and self._daemon.code() not in (None, 0)

    def _reported(self) -> dict[str, tuple[ShownTelegram, ...]]:
        return {name: tuple(rows) for name, rows in self._telegrams.items()}

    def _take_scans(self, answer: Mapping[str, Any]) -> None:
        if answer["keeper"] != self._keeper:
            self._keeper = answer["keeper"]
            self._numbers.clear()
            self._telegram_numbers.clear()
        for name, row in answer["scans"].items():
            self._scans[name] = scan_of(row)
            self._numbers[name] = row["number"]

    def _take_telegrams(self, answer: Mapping[str, Any]) -> None:
        for name, found in answer["telegrams"].items():
            kept = self._telegrams.setdefault(name, deque(maxlen=KEPT))
            before = self._telegram_numbers.get(name, 0)
            self._telegram_numbers[name] = found["number"]
            if before:
                self._missed += max(0, found["number"] - before - len(found["payloads"]))
            for row in found["payloads"]:
                kept.append(telegram_of(row))
        notes = [(row["at_s"], f"{name}: {row['event']}") for name, rows in answer["events"].items() for row in rows]
        self._notes = tuple(f"{at_s:.3f} s {text}" for at_s, text in sorted(notes)[-12:])

    def close(self) -> None:
        """Nothing is held: every question has a connection of its own."""


def scan_of(row: Mapping[str, Any]) -> ShownScan:
    """A scan of the control's `scans`."""
    n = -(-row["beams"] // row["every"])

    def array(name: str) -> Any:
        kind = (SHORT | LONG)[name]
        found = np.frombuffer(base64.b64decode(row[name]), kind)
        found = found.astype(np.int32) if kind == "<i2" else found.astype(np.float64)
        return found.reshape((n, row["echoes"]) if name in LONG else (n,))

    begins = None if row.get("origin_m") is None else np.frombuffer(base64.b64decode(row["origin_m"]), ORIGIN)
    return ShownScan(
        start_s=row["start_s"],
        sweep=row["sweep"],
        objects=tuple(row["objects"]),
        every=row["every"],
        missed=row["missed"],
        origin_m=None if begins is None else begins.reshape(n, 3).astype(np.float64),
        **{name: array(name) for name in SHORT | LONG},
    )


def telegram_of(row: Mapping[str, Any]) -> ShownTelegram:
    """A payload of the control's `telegrams`."""
    data = bytes.fromhex(row["data"])
    return ShownTelegram(
        number=row["number"],
        link=row["link"],
        peer=row["peer"],
        sent=row["sent"],
        at_s=row["first_bit_s"],
        data=data,
        label=row["label"],
        sweep=row["sweep"],
        cut=row["bytes"] - len(data),
    )


def _sensor(row: Mapping[str, Any]) -> ShownSensor:
    late = row["lateness_us"] or {}
    return ShownSensor(
        scans_sent=row["scans_sent"],
        rate_hz=row["scans_per_s"],
        late_median_us=late.get("median"),
        late_worst_us=late.get("worst"),
        dropped=row["dropped"],
        input_dropped=row["input_dropped"],
        restarts=row["restarts"],
        links=tuple(ShownLink(**one) for one in row["links"]),
    )


def find(path: Path | None) -> Path:
    """The socket meant: `path`, or that of the only daemon that runs. Raises `LinkError`."""
    from emulator.runtime.control import running

    if path is not None:
        return path
    found = running()
    if len(found) != 1:
        if not found:
            raise LinkError("no daemon of this user is running; want a control socket, a recording or a scenario")
        several = "; ".join(map(str, found))
        raise LinkError(f"which daemon? {several}; want its control socket, a recording or a scenario")
    return found[0]
