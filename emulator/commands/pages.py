"""Pages of docs/ that are made from tables and options: `python -m emulator.commands.pages` writes them again.

Belongs here: the command line as Markdown, and what `lidaremu list` knows. Not: pages that people write; the tables of
docs/faults.md (faults.page) and of protocols/COVERAGE.md (protocols.coverage).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from inspect import cleandoc
from pathlib import Path
from types import MappingProxyType

import click

MADE = "Made by `python -m emulator.commands.pages`; do not edit."
EXIT_CODES = """\
Exit codes: 0 held, or stopped as asked; 1 an expectation failed; 2 cannot run: bad scenario, spec or arguments; 3 a
link could not be opened or was lost; 4 the run went on but its recording ended early; 5 a sensor fell silent, or scans
are unaccounted for."""


def cli() -> str:
    """Every command with its arguments and options, as click knows them."""
    from emulator.commands.cli import commands

    parts = [f"# Command line\n\n{MADE}\n\n{EXIT_CODES}\n"]
    parts += [_section(name, command) for name, command in _all("lidaremu", commands)]
    return "\n".join(parts)


def _all(path: str, command: click.Command) -> Iterator[tuple[str, click.Command]]:
    if isinstance(command, click.Group):
        for name in sorted(command.commands):
            yield from _all(f"{path} {name}", command.commands[name])
    else:
        yield path, command


def _section(path: str, command: click.Command) -> str:
    context = click.Context(command, info_name=path)
    arguments = [one for one in command.params if isinstance(one, click.Argument)]
    options = [one for one in command.params if isinstance(one, click.Option) and not one.hidden]
    usage = " ".join([path, "[OPTIONS]", *(one.make_metavar(context) for one in arguments)])
    lines = [f"## {path}", "", f"    {usage}", "", _text(command.help or ""), ""]
    if options:
        lines += ["| option | | default |", "|---|---|---|", *(_option(one, context) for one in options), ""]
    return "\n".join(lines)


def _text(help_: str) -> str:
    """Paragraphs; what click shall not wrap becomes lines of code."""
    out = []
    for paragraph in cleandoc(help_).split("\n\n"):
        lines = [line.strip() for line in paragraph.removeprefix("\b").strip().splitlines()]
        if paragraph.startswith("\b"):
            out.append("\n".join(f"    {line}" for line in lines))
        else:
            out.append(" ".join(map(_safe, lines)))
    return "\n\n".join(out)


def _option(option: click.Option, context: click.Context) -> str:
    names = ", ".join([*option.opts, *option.secondary_opts])
    metavar = "" if option.is_flag else f" {option.make_metavar(context)}"
    several = " Several times." if option.multiple and "several" not in (option.help or "") else ""
    default = option.get_default(context, call=False)
    reported = isinstance(default, str | int | float) and not isinstance(default, bool)
    shown = f"`{_plain(default)}`" if reported else ""
    if option.required:
        shown = "required"
    return f"| `{_plain(names + metavar)}` | {_safe(option.help or '')}{several} | {shown} |"


def _plain(value: object) -> str:
    return str(value).replace("|", "\\|")


def _safe(text: str) -> str:
    """Text whose signs mean nothing to Markdown."""
    for sign in ("\\", "|", "*", "<", "[", "$"):
        text = text.replace(sign, f"\\{sign}")
    return text


def catalogue() -> str:
    """What there is to choose from."""
    from emulator.commands import catalogue as known

    parts = [
        f"# Sensors, scenarios, links, materials\n\n{MADE} On a terminal: `lidaremu list sensors` and so on.\n\n"
        "Commands of each protocol: [COVERAGE.md](../protocols/COVERAGE.md). Faults: [faults.md](faults.md).\n",
        f"## Sensors\n\n{_table(_sensor_rows())}",
        f"## Scenarios\n\n{_table(known.scenarios(), code=('scenario',))}",
        f"## Links\n\nMore in [links.md](links.md).\n\n{_table(known.links(), code=('form',))}",
        "## Materials\n\n`rho_905`, `rho_1550`: reflectance at 905 and 1550 nm, at normal incidence.\n\n"
        + _table(known.materials(), code=("material",)),
    ]
    return "\n".join(parts)


def _sensor_rows() -> Iterator[dict[str, object]]:
    """Facts of each model that most readers look for first."""
    from emulator.sensors.spec import list_models, load_spec

    for name in list_models():
        spec = load_spec(name)
        row: dict[str, object] = {"model": f"`{name}`", "family": spec.family or "-", "title": spec.title}
        geometry, optics, receiver = spec.geometry, spec.optics, spec.receiver
        row["field [deg]"] = "-" if geometry is None else f"{geometry.field_deg.value:g}"
        row["steps [deg]"] = "-" if geometry is None else ", ".join(f"{one:g}" for one in geometry.steps_deg.value)
        row["divergence [mrad]"] = "-" if optics is None else f"{optics.divergence_x_mrad.value:g}"
        row["gate [m]"] = "-" if receiver is None else f"{receiver.gate_m.value:g}"
        yield row


def _table(rows: Iterable[Mapping[str, object]], code: tuple[str, ...] = ()) -> str:
    listed = list(rows)
    heads = list(listed[0])
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in listed:
        cells = [f"`{_plain(row[key])}`" if key in code else _cell(row[key]) for key in heads]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _cell(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value).replace("|", "\\|").replace("\n", " ")


PAGES: Mapping[str, Callable[[], str]] = MappingProxyType({"cli.md": cli, "catalogue.md": catalogue})
"Name in docs/ -> its text."


def write(folder: Path) -> None:
    """All pages that are made."""
    for name, make in PAGES.items():
        (folder / name).write_text(make(), encoding="utf-8")


if __name__ == "__main__":
    write(Path("docs"))
