"""Built-in hosts on a daemon that the page has started itself: devices send on request."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from emulator.errors import EmulatorError
from emulator.hosts.families import free_link, is_on_can
from emulator.scenario import scenario as scenario_file
from emulator.sensors.spec import load_spec

BAUD = 500_000


def free_links(name: str, folder: Path) -> list[str]:
    """SENSOR=URL for each sensor that has a protocol: links that no other run can be using."""
    found = []
    for one in scenario_file.load(name).sensors:
        family = load_spec(one.model).family
        if family is not None and (url := free_link(family, one.id, folder)) is not None:
            found.append(f"{one.id}={url}")
    return found


class Guests:
    """One host a sensor; each reads until the daemon goes."""

    def __init__(self, sensors: Sequence[Mapping[str, Any]], failed: Callable[[str], None]) -> None:
        """`sensors` as reported in `ready`."""
        self._failed = failed
        self._over = threading.Event()
        self._reported: set[str] = set()
        for row in sensors:
            family = load_spec(row["model"]).family
            if family is not None and row["links"]:
                threading.Thread(target=self._host, args=(row, family), daemon=True).start()

    def _host(self, row: Mapping[str, Any], family: str) -> None:
        from emulator.looking.look import connect

        while not self._over.is_set():
            try:
                host = connect(row["links"][0], family, BAUD, row["model"] if is_on_can(family) else None)
                for _ in host.scans(0.5):
                    if self._over.is_set():
                        return
            except EmulatorError as error:
                self._tell(f"host of {row['id']}: {error}")
            except Exception as error:  # a host under faults may fail in any way; it tries again
                self._tell(f"host of {row['id']}: {type(error).__name__}: {error}")
            self._over.wait(1.0)

    def _tell(self, text: str) -> None:
        if not self._over.is_set() and text not in self._reported:
            self._reported.add(text)
            self._failed(text)

    def close(self) -> None:
        """No more reading; the threads end with the process."""
        self._over.set()
