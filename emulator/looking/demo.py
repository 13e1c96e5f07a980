"""`lidaremu demo`: the daemon on a built-in scenario, and a built-in host on the other end of its line."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from emulator.errors import EmulatorError, LinkError
from emulator.hosts.families import BUILT_IN, free_link, names
from emulator.looking.look import FIRST_S, Wanted, connect, watch
from emulator.looking.screen import drawable
from emulator.runtime.own_daemon import DaemonError, OwnDaemon, own_daemon
from emulator.scenario import scenario as scenario_file
from emulator.sensors.spec import load_spec

DEFAULT_S = 20.0
"How long the demo lasts on a terminal when neither the user nor the scenario says."
UNWATCHED_S = 5.0
"The same where nobody watches."


def run_demo(
    name: str | None,
    sensor: str | None,
    family: str | None,
    duration_s: float | None,
    baud: int,
    say: Callable[[str], None],
) -> int:
    """Start the daemon as a process of its own, look through one sensor, stop it; the exit code."""
    if family is not None and family not in BUILT_IN:
        raise EmulatorError(f"demo does not support {family!r}; want {names()}")
    name = name or BUILT_IN[family or "lms2xx"].shown_by
    loaded = scenario_file.load(name)
    families = {item.id: load_spec(item.model).family or "none" for item in loaded.sensors}
    chosen = sensor or next((one for one, its in families.items() if family in (None, its)), None)
    if chosen not in families:
        reported = ", ".join(f"{one} ({its})" for one, its in families.items())
        raise EmulatorError(f"{f'sensor {sensor!r}' if sensor else f'family {family}'}; {name} has {reported}")
    live = drawable()
    lasts_s = duration_s or ((loaded.duration_s or DEFAULT_S) if live else UNWATCHED_S)
    options = [f"--duration={lasts_s + 60.0}"]
    with tempfile.TemporaryFile() as log:  # kept out of the picture
        try:
            with own_daemon(
                name,
                options,
                lambda folder: [f"{item}={_link(item, its, folder)}" for item, its in families.items()],
                errors=log,
            ) as daemon:
                _show(daemon, name, chosen, families[chosen], baud, lasts_s, live, say)
        except DaemonError as error:
            log.seek(0)
            raise DaemonError(f"{error}: {log.read().decode('utf-8', 'replace').strip()}") from None
    if daemon.last:
        _tell(next(item for item in daemon.last["sensors"] if item["id"] == chosen), say)
    if not live:
        say(f"this was {name}, sensor {chosen}; on a terminal it is drawn live")
    return 0


def _show(
    daemon: OwnDaemon,
    name: str,
    chosen: str,
    family: str,
    baud: int,
    lasts_s: float,
    live: bool,
    say: Callable[[str], None],
) -> None:
    """A host on one sensor's link."""
    links = {item["id"]: item["links"][0] for item in daemon.ready["sensors"]}
    say(f"daemon: {name}: " + ", ".join(links.values()))
    host = connect(links[chosen], family, baud, more=True)
    try:
        seen = watch(host, Wanted(duration_s=lasts_s, live=live), say)
    finally:
        host.close()
    if seen is None:
        raise LinkError(f"{links[chosen]}: no scan came within {FIRST_S:g} s")


def _link(sensor: str, family: str, folder: Path) -> str:
    """Where a host of the demo finds a sensor; one without a protocol has no host."""
    return free_link(family, sensor, folder) or f"pty:{folder / sensor}"


def _tell(total: dict[str, Any], say: Callable[[str], None]) -> None:
    late = total["lateness_us"]
    say(
        f"{total['id']}: {total['scans_sent']} scans sent, {total['scans_per_s'] or 0.0:.1f}/s;"
        f" lateness median {late['median']:.0f} us, p99 {late['p99']:.0f} us"
    )
