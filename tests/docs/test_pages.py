"""What the pages show is true: scenarios are accepted, Python runs, functions and files exist, made pages are new."""

from __future__ import annotations

import ast
import copy
import importlib
import json
import re
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from emulator.commands import pages
from emulator.judging.expectations import understand
from emulator.runtime.assembly import new_sessions
from emulator.scenario import scenario
from tests.docs import reading
from tests.docs.reading import ROOT, Block

TABLES = ("schema", "duration_s", "world", "actors", "weather", "sensors", "faults", "expect", "materials", "device")
EVERY = [block for page in reading.pages() for block in reading.blocks(page)]
YAML_BLOCKS = [
    block for block in EVERY if block.language in ("", "yaml") and re.match(rf"(?:{'|'.join(TABLES)}):", block.text)
]
BASE: dict[str, Any] = {
    "schema": 1,
    "actors": [
        {"id": "ego", "motion": {"at_m": [0, 0, 0]}},
        *({"id": name, "shape": {"box": {"size_m": [4, 2, 1]}}, "material": "asphalt"} for name in ("car", "child")),
    ],
    "sensors": [
        {"id": "front", "model": "sick-lms291-s05", "links": ["loop:front"]},
        {"id": "radar", "model": "can-ars408", "from": ["front"], "links": ["can:virtual:1"]},
    ],
}
"What the pieces of scenarios speak of."
DEVICES = {
    "can_objects.md": "can-ldmrs",
    "sick_ld.md": "sick-ld-lrs1000",
    "lms2xx.md": "sick-lms291-s05",
    "scip.md": "hokuyo-utm-30lx",
    "velodyne.md": "velodyne-vlp-16",
    "hesai.md": "hesai-xt32",
    "ouster.md": "ouster-os1-128",
    "rplidar.md": "rplidar-a2m8",
    "desk_scanners.md": "ydlidar-g4",
}
"Whose `device:` table a page shows alone."


def plain(text: str) -> Any:
    return YAML(typ="safe", pure=True).load(text)


def laid_over(base: dict[str, Any], piece: dict[str, Any]) -> dict[str, Any]:
    """Tables key by key, lists of things with an id by that, a nameless first thing over the first."""
    out = copy.deepcopy(base)
    for key, value in piece.items():
        if isinstance(value, dict) and isinstance(out.get(key), dict) and key not in ("shape", "motion"):
            out[key] = laid_over(out[key], value)
        elif isinstance(value, list) and key in ("actors", "sensors"):
            known = {one["id"]: one for one in out.setdefault(key, [])}
            for item in value:
                name = item.get("id", next(iter(known), None))
                if name in known:
                    merged = laid_over(known[name], item)
                    known[name].clear()
                    known[name].update(merged)
                else:
                    out[key].append(item)
        else:
            out[key] = value
    return out


@pytest.mark.parametrize("block", YAML_BLOCKS, ids=str)
def test_pieces_of_scenarios_are_accepted(block: Block, tmp_path: Path) -> None:
    piece = plain(block.text.partition("\nlidaremu ")[0])
    if "device" in piece:
        model = DEVICES[block.page.name]
        extra = {"from": ["front"]} if model.startswith("can") else {}
        usual = dict.fromkeys(("velodyne", "ouster", "hesai"), "udp:127.0.0.1:2368")
        usual |= dict.fromkeys(("hokuyo", "rplidar", "ydlidar"), "pty:./other")
        link = usual.get(model.partition("-")[0], "can:virtual:2")
        piece = {"sensors": [{"id": "other", "model": model, "links": [link], **extra, **piece}]}
    whole = piece if "schema" in piece else laid_over(BASE, piece)
    for name in ("acme-x1.yaml", "acme-mems.yaml"):
        (tmp_path / name).write_text((ROOT / "docs/examples" / name).read_text(encoding="utf-8"))
    (tmp_path / "meshes").symlink_to(ROOT / "scenarios/meshes")
    loaded = scenario.loads(json.dumps(whole), tmp_path / "page.yaml")
    understand(loaded)
    new_sessions(loaded)


def test_there_are_pieces_of_scenarios() -> None:
    assert len(YAML_BLOCKS) > 12


def test_the_steps_of_the_tutorial_make_its_file() -> None:
    made: dict[str, Any] = {}
    for block in reading.blocks(ROOT / "docs/write_a_scenario.md"):
        made = laid_over(made, plain(block.text)) if block.language == "yaml" else made
    whole = plain((ROOT / "docs/examples/step_out.yaml").read_text(encoding="utf-8"))
    for one in (made, whole):
        one["actors"] = {actor["id"]: actor for actor in one["actors"]}
    assert made == whole


@pytest.mark.parametrize("name", ["acme-x1.yaml", "one_file.yaml", "acme-mems.yaml"])
def test_files_that_a_page_shows_whole_are_those_files(name: str) -> None:
    text = (ROOT / "docs/examples" / name).read_text(encoding="utf-8")
    shown = [block.text for block in EVERY if block.page.name == "sensor_model.md" and block.language == "yaml"]
    assert text[text.index("\n") + 1 :] in shown


@pytest.mark.parametrize("block", [one for one in EVERY if one.language == "python"], ids=str)
def test_python_of_the_pages_compiles(block: Block) -> None:
    ast.parse(block.text)


def test_the_formulas_of_the_physics_page_can_be_checked_as_it_says() -> None:
    (block,) = [one for one in EVERY if one.page.name == "physics.md" and one.language == "python"]
    exec(compile(block.text, str(block), "exec"), {})


def test_every_function_of_the_physics_page_is_there() -> None:
    text = (ROOT / "docs/physics.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([a-z_]+)\.([a-z_0-9]+)`", text)) - {("module", "function")}
    assert len(named) > 50
    for module, function in named:
        assert callable(getattr(importlib.import_module(f"emulator.physics.{module}"), function)), (module, function)


@pytest.mark.parametrize("name", pages.PAGES)
def test_pages_made_of_code_are_new(name: str) -> None:
    assert (ROOT / "docs" / name).read_text(encoding="utf-8") == pages.PAGES[name](), (
        "run python -m emulator.commands.pages"
    )


@pytest.mark.parametrize("page", reading.pages(), ids=lambda page: page.name)
def test_links_of_the_pages_lead_somewhere(page: Path) -> None:
    text = re.sub(r"`[^`]*`", "", page.read_text(encoding="utf-8"))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if link.startswith(("http://", "https://")):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.is_file(), link
        assert not anchor or anchor in anchors(target), link


def anchors(page: Path) -> set[str]:
    heads = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


def test_files_and_modules_that_the_pages_name_are_there() -> None:
    for page in reading.pages():
        text = page.read_text(encoding="utf-8")
        named = re.findall(r"`((?:emulator|protocols|scenarios|tests|docs)/[\w./-]*)`", text)
        for name in named:
            assert (ROOT / name).exists(), f"{page.name}: {name}"
        for module in re.findall(r"python -m ((?:emulator|protocols|tests)[\w.]+)", text):
            path = ROOT / module.replace(".", "/")
            assert path.is_dir() or path.with_suffix(".py").is_file(), f"{page.name}: {module}"


def test_the_index_names_every_page() -> None:
    index = (ROOT / "docs/index.md").read_text(encoding="utf-8")
    linked = set(re.findall(r"\]\(([\w./]+\.md)\)", index))
    assert {path.name for path in (ROOT / "docs").glob("*.md")} - {"index.md"} <= linked


def test_the_architecture_has_a_place_for_every_module() -> None:
    text = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    table = text[text.index("| place") : text.index("## The contracts")]
    known = [name.rstrip("/").rpartition("/")[2] for name in re.findall(r"`([\w./*-]+)`", table)]
    for path in (*(ROOT / "emulator").iterdir(), *(ROOT / "protocols").iterdir()):
        package = path.is_dir() and (path / "__init__.py").is_file()
        if package or (path.suffix == ".py" and not path.name.startswith("__")):
            assert any(fnmatch(path.name, pattern) for pattern in known), path


def test_pages_are_plain_markdown() -> None:
    for page in reading.pages():
        assert not re.search(r"^(?:```|:::)\{", page.read_text(encoding="utf-8"), re.M), page


def test_formulas_become_mathml_and_pages_load_nothing_from_elsewhere() -> None:
    from latex2mathml.converter import convert

    text = (ROOT / "docs" / "physics.md").read_text(encoding="utf-8")
    text = re.sub(r"`[^`]*`", "", text)
    found = re.findall(r"\$\$(.+?)\$\$|\$([^$\n]+)\$", text, re.DOTALL)
    assert len(found) > 50
    for block, inline in found:
        made = convert(block or inline)
        assert made.startswith("<math")
        assert "merror" not in made
    for name in ("conf.py", "static/custom.css"):
        assert not re.search(r"https?:|mathjax", (ROOT / "docs" / name).read_text(encoding="utf-8"))
