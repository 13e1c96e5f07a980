"""The tables of docs/faults.md, from the catalogue: `python -m emulator.faults.page` writes them again.

Belongs here: rows as Markdown, and where they go. Not: the text of the page (docs/faults.md itself).
"""

from __future__ import annotations

from pathlib import Path

from emulator.faults.catalogue import LAYERS, fits, keys_of, kinds
from emulator.faults.kinds import Kind

BEGIN, END = "<!-- made by python -m emulator.faults.page -->", "<!-- end of what is made -->"
WHAT = {
    "photon": "optics, laser and detector",
    "mechanics": "mirror, motor and mount",
    "measurement": "evaluation of echoes",
    "clock": "the clock of the device",
    "telegram": "telegrams, their fields and replies",
    "byte": "bytes and bits on the wire",
    "link": "plugs, power and connections",
    "can": "frames, end-to-end protection and the bus",
}


def tables() -> str:
    """All kinds by layer."""
    parts = [f"{len(kinds())} faults in {len(LAYERS)} layers.", ""]
    for layer in LAYERS:
        parts += [f"### {layer}: {WHAT[layer]}", "", "| fault | keys | for | what the host sees | after the fault |"]
        parts += ["|---|---|---|---|---|", *(_row(kind) for kind in kinds().values() if kind.layer == layer), ""]
    return "\n".join(parts)


def _row(kind: Kind) -> str:
    keys = ", ".join(_key(row) for row in keys_of(kind)) or "-"
    lasting = {"telegrams": "", "state": " Lasts until the fault ends.", "own": ""}[kind.lasts]
    return f"| `{kind.name}` | {keys} | {fits(kind)} | {kind.summary}{lasting} | {kind.ends} |".replace("||", "|")


def _key(row: dict[str, str]) -> str:
    default = "" if row["default"] in ("required", "none") else f" {row['default']}"
    return f"**`{row['key']}`**" if row["default"] == "required" else f"`{row['key']}`{default}"


def written(text: str) -> str:
    """The page with its tables made again."""
    head, begin, rest = text.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"the page lacks {BEGIN} or {END}")
    return f"{head}{BEGIN}\n{tables()}\n{END}{tail}"


if __name__ == "__main__":
    page = Path("docs/faults.md")
    page.write_text(written(page.read_text(encoding="utf-8")), encoding="utf-8")
