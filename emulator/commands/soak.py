"""`lidaremu study soak`: a day in virtual time, or minutes in real time, with hosts that misbehave."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from emulator.commands.common import FAILED, OK, bar
from emulator.errors import EmulatorError
from emulator.output.lines import say

if TYPE_CHECKING:
    from emulator.endurance.soak import Soaked

MOST_HOURS, MOST_REAL_S = 24.0 * 14, 86_400.0 * 7


@click.command()
@click.option(
    "--hours",
    type=click.FloatRange(0.005, MOST_HOURS),
    metavar="H",
    help="Hours of virtual time (default 24, about 45 minutes of CPU time).",
)
@click.option(
    "--real",
    "real_s",
    type=click.FloatRange(5.0, MOST_REAL_S),
    metavar="S",
    help="Seconds of real time with real links, instead of virtual time.",
)
@click.option(
    "--desk", is_flag=True, help="The desk scanners instead, in virtual time: Hokuyo, RPLIDAR, LDROBOT, YDLIDAR."
)
@click.option("--street", is_flag=True, help="Velodyne, Ouster and Hesai instead, on TCP, in virtual time.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of the hosts' script.")
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), metavar="DIR", help="Write soak.json into DIR."
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object on standard output.")
def soak(
    hours: float | None, real_s: float | None, desk: bool, street: bool, seed: int, out: Path | None, as_json: bool
) -> int:
    """LMS291, LD-LRS, TiM551 and an object list while hosts come, go and misbehave: no leak, no scan lost unaccounted,
    clean data for every host that behaves. In virtual time, or with --real as a daemon with real links.
    """
    if hours is not None and real_s is not None:
        raise click.UsageError("--hours is virtual time, --real is real time; want one of them")
    if desk and street:
        raise click.UsageError("--desk and --street are different sensors; want one of them")
    if (desk or street) and real_s is not None:
        raise click.UsageError(f"--{'desk' if desk else 'street'} is in virtual time; want --hours")
    if out is not None:
        prepare(out)
    with bar("soak") as progress:
        if real_s is not None:
            from emulator.endurance.real_soak import run_real

            soaked = run_real(real_s, seed, progress)
        else:
            from emulator.endurance.soak import run_virtual

            soaked = run_virtual(
                24.0 if hours is None else hours, seed, progress, "desk" if desk else "street" if street else ""
            )
    reported = soaked.as_json()
    if out is not None:
        (out / "soak.json").write_text(json.dumps(reported, indent=1) + "\n", encoding="utf-8")
    if as_json:
        say(json.dumps(reported))
    else:
        for line in table(soaked):
            say(line)
    return OK if soaked.held else FAILED


def prepare(out: Path) -> None:
    """The folder of a report; `EmulatorError` where it cannot be."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EmulatorError(f"{out}: cannot write there: {error.strerror}") from None


def table(soaked: Soaked) -> Iterator[str]:
    """What a soak has shown, line by line."""
    took = f"{soaked.simulated_s:.0f} s of {soaked.kind} time in {soaked.wall_s:.0f} s"
    yield f"{took}, {soaked.simulated_s / max(soaked.wall_s, 1e-9):.1f} times real; seed {soaked.seed}"
    heads = f"{'asked':>9}{'sent':>9}{'again':>7}{'withdrawn':>10}{'under way':>10}{'lost':>6}"
    yield f"{'sensor':<9}{heads}  dropped, by reason"
    for name, one in soaked.sensors.items():
        dropped = ", ".join(f"{count} {reason}" for reason, count in one["dropped"].items()) or "none"
        counts = (
            f"{one['asked']:>9}{one['sent']:>9}{one['measured_again']:>7}{one['withdrawn']:>10}"
            f"{one['under_way']:>10}{one['unaccounted']:>6}"
        )
        yield f"{name:<9}{counts}  {dropped}"
    for name, book in soaked.hosts.items():
        visits = ", ".join(f"{count} {kind}" for kind, count in book["visits"].items())
        yield f"{name}: {book['clean_scans']} clean scans; visits: {visits}"
    for name, one in soaked.sensors.items():
        if "lateness_us" in one and one["lateness_us"]["p99"] is not None:
            late = one["lateness_us"]
            parts = ", ".join(f"{key} {late[key]:.0f} us" for key in ("median", "p99", "worst"))
            yield f"{name}: lateness: {parts}"
    memory = soaked.memory
    yield (
        f"memory: {memory['rss_mb_start']} MB at start, {memory['rss_mb_end']} MB at end,"
        f" peak {memory['rss_mb_peak']} MB; second half {memory['rss_mb_rise_second_half']:+} MB"
    )
    rest = [
        f"{key} {memory[key]}" for key in ("blocks_rise_second_half", "traced_kb_rise", "cpu_share") if key in memory
    ]
    yield f"descriptors: peak {memory['descriptors_peak']}" + "".join(f"; {text}" for text in rest)
    for text in soaked.faults:
        yield f"fault: {text}"
    yield "held" if soaked.held else "not held"
