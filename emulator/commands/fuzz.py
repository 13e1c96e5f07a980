"""`lidaremu study fuzz`: every parser of untrusted input, with seeded mutations of valid examples."""

from __future__ import annotations

import json
from pathlib import Path

import click

from emulator.commands.common import FAILED, OK, bar
from emulator.commands.soak import prepare
from emulator.output.lines import say

MOST_SECONDS = 86_400.0


@click.command()
@click.option(
    "--seconds",
    type=click.FloatRange(0.01, MOST_SECONDS),
    default=60.0,
    show_default=True,
    help="CPU time for all parsers together.",
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.option("--parser", "names", multiple=True, metavar="NAME", help="Fuzz only this parser. Several times.")
@click.option(
    "--engine",
    type=click.Choice(["mutate", "atheris"]),
    default="mutate",
    help="Input generator; atheris: guided by coverage, needs the extra `fuzz`.",
)
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), metavar="DIR", help="Write fuzz.json and failing inputs."
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object per parser on standard output.")
def fuzz(seconds: float, seed: int, names: tuple[str, ...], engine: str, out: Path | None, as_json: bool) -> int:
    """Feed every parser with mutated examples: hosts' telegrams on every link, control orders, scenarios, meshes,
    recordings, expressions. Each in a process of its own, bounded in memory and time.
    """
    from emulator.endurance import fuzz as whole

    known = {parser.name: parser for parser in whole.PARSERS}
    for name in names:
        if name not in known:
            raise click.BadParameter(f"{name!r}; want one of {', '.join(known)}", param_hint="--parser")
    if out is not None:
        prepare(out)
    chosen = [known[name] for name in names] or list(whole.PARSERS)
    rows, found = [], 0
    with bar("fuzz") as progress:
        for number, parser in enumerate(chosen):
            if engine == "atheris":
                from emulator.endurance.fuzz_guided import guided

                outcome = guided(parser, seconds / len(chosen), seed)
            else:
                outcome = whole.fuzz(parser, seconds / len(chosen), seed)
            row = whole.reported(outcome)
            rows.append(row)
            say(json.dumps(row) if as_json else _line(row))
            for fault in outcome.faults:
                found += 1
                where = "" if out is None else f": {whole.save(fault, out / 'faults')}"
                if not as_json:
                    say(f"  fault: {fault.kind}{where}: {fault.data[:60]!r}")
            progress((number + 1) / len(chosen))
    total = {"study": "fuzz", "engine": engine, "seed": seed, "held": not found, "parsers": rows}
    if out is not None:
        (out / "fuzz.json").write_text(json.dumps(total, indent=1) + "\n", encoding="utf-8")
    if not as_json:
        cases, cpu_s = sum(row["cases"] for row in rows), sum(row["cpu_s"] for row in rows)
        say(f"{cases} cases in {cpu_s:.0f} s of CPU, {found} faults; engine {engine}, seed {seed}")
    return FAILED if found else OK


def _line(row: dict[str, object]) -> str:
    return (
        f"{row['parser']:<18}{row['cases']:>9} cases {row['cpu_s']:>8} s {row['cases_per_s']:>8}/s"
        f"   slowest {row['slowest_ms']:>8} ms   peak {row['peak_mb']:>7} MB   {len(list(row['faults']))} faults"  # type: ignore[call-overload]
    )
