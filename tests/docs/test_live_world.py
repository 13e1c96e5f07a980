"""docs/live_world.md and the limits of SECURITY.md: every example is run, every key and number is the code's."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from emulator.commands.ctl import ctl
from emulator.judging.rig import Rig
from emulator.live import esmini, json_lines, osi, receivers, samples
from emulator.live.client import Lockstep
from emulator.live.json_lines import ACTOR_KEYS, KEYS, UNUSED
from emulator.runtime import feeding, lockstep
from emulator.scenario.live_options import MOST_POOL, MOST_STATICS, WANT_FEED
from emulator.scenario.scenario import loads

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/live_world.md").read_text(encoding="utf-8")
BLOCKS = [
    "\n".join(line[4:] for line in found.splitlines()) for found in re.findall(r"(?:^(?: {4}.*)?\n)+", PAGE, re.M)
]
BLOCKS = [block.strip("\n") for block in BLOCKS if block.strip()]
SCENE = next(block for block in BLOCKS if block.startswith("schema: 1"))
LIVE = next(block for block in BLOCKS if block.startswith("live:"))
LINE = next(block for block in BLOCKS if block.startswith("{"))
FEEDER, STEPPER = (block for block in BLOCKS if block.startswith("from "))


def first_column(after: str) -> list[str]:
    """Names in the first column of the table that follows a line."""
    table = PAGE[PAGE.index(after) :].split("\n\n")[0] if after.startswith("|") else ""
    return [name for row in table.splitlines()[2:] for name in re.findall(r"`(\w+)`", row.split("|")[1])]


def test_scenarios_of_the_page_load() -> None:
    assert loads(SCENE, Path("page.yaml")).live is not None
    found = loads(SCENE.partition("live:")[0] + LIVE, Path("page.yaml")).live
    assert found is not None
    assert found.actors.classes["delivery_robot"].class_ == "bicycle"


def test_the_line_of_the_page_is_one_update_and_all_its_keys_are_known() -> None:
    update = json_lines.decoded(LINE)
    assert (update.t_ns, update.seq, update.unknown) == (1_050_000_000, 21, ())


def test_the_tables_have_every_key() -> None:
    assert sorted(first_column("| key | |")) == sorted(set(KEYS) - set(UNUSED))
    actors = first_column("| key of an actor | |")
    assert sorted(actors) == sorted(set(ACTOR_KEYS) - set(UNUSED))


def test_the_table_has_every_feed() -> None:
    wanted = set(re.findall(r"[a-z-]+(?=:)", WANT_FEED)) - {"unix"}
    rows = [row for row in PAGE[PAGE.index("| `feed` |") :].split("\n\n")[0].splitlines()[2:]]
    reported = {one for row in rows for one in re.findall(r"`([a-z-]+)(?=[:`])", row.split("|")[1])}
    assert wanted | {"control"} == reported


def test_the_feeder_of_the_page_feeds(tmp_path: Path) -> None:
    path = tmp_path / "page.yaml"
    path.write_text(SCENE.replace(":47100", ":0"))
    with Rig(str(path), tmp_path) as rig:
        while not rig.feed().get("received"):
            exec(FEEDER.replace("json-udp://127.0.0.1:47100", str(rig.feed_url)), {})
        assert rig.feed()["actors"] == 1


def test_lock_step_of_the_page_steps(tmp_path: Path) -> None:
    path = tmp_path / "page.yaml"
    path.write_text(SCENE.replace("json-udp://127.0.0.1:47100", "lockstep://127.0.0.1:0"))
    with Rig(str(path), tmp_path) as rig:
        found: dict[str, object] = {}
        exec(STEPPER.replace("lockstep://127.0.0.1:47101", str(rig.feed_url)), found)
        assert found["done"]["t_s"] == pytest.approx(0.01)  # type: ignore[index]


def test_requests_of_the_table_are_answered_as_it_says(tmp_path: Path) -> None:
    path = tmp_path / "page.yaml"
    path.write_text(SCENE.replace("json-udp://127.0.0.1:47100", "lockstep://127.0.0.1:0"))
    rows = re.findall(r"^\| `(\{.*?\})` \| `(\{.*?\})`", PAGE, re.M)
    assert len(rows) >= 4
    with Rig(str(path), tmp_path) as rig, Lockstep(str(rig.feed_url)) as world:
        for request, answer in rows:
            got = world.ask(json.loads(request.replace("[...]", "[]")))
            assert set(got) == set(json.loads(answer)), request
            assert got["op"] == json.loads(answer)["op"]


def test_ctl_tells_of_poses() -> None:
    assert "poses" in CliRunner().invoke(ctl, ["--help"]).output


def test_limits_of_a_feed_are_those_of_the_code() -> None:
    text = " ".join((ROOT / "SECURITY.md").read_text(encoding="utf-8").split())
    text = text[text.index("A feed of poses is untrusted input") :].partition("- **")[0]
    for reported, most in (
        (f"{receivers.MOST_RATE} updates a second", 5000),
        (f"{json_lines.MOST_BYTES / 1e6:.0f} MB a JSON line", 4),
        (f"{esmini.MOST_MESSAGE >> 20} MiB an OSI message", 64),
        (f"({receivers.MOST_OSI >> 20} MiB by TCP)", 16),
        ("10 000 actors an update", json_lines.MOST_ACTORS // 10_000),
        (f"{receivers.MOST_CONNECTIONS} connections", 8),
        (f"{esmini.MOST_SENDERS} senders of OSI datagrams", 8),
        (f"{feeding.MOST_PENDING} updates that wait", 2000),
        (f"`live.actors.pool` (at most {MOST_POOL})", 500),
        (f"`live.actors.statics` (at most {MOST_STATICS})", 2000),
        ("10 000 km", samples.MOST_M / 1e7),
    ):
        assert reported in text, most
    assert osi.MOST_OBJECTS == json_lines.MOST_ACTORS == 10_000
    assert samples.MOST_M == 1e7
    assert lockstep.MOST_OSI == esmini.MOST_MESSAGE


def test_what_waits_for_the_run_has_its_limit() -> None:
    live = "live: {feed: control, clock: {map: arrival}}\n"
    scenario = loads(SCENE.partition("live:")[0] + live, Path("page.yaml"))
    assert scenario.live is not None
    found = feeding.Feeding(scenario, scenario.live, [], lambda: 0)
    waiting: list[object] = []
    found.call = waiting.append  # type: ignore[assignment]
    update = json_lines.decoded(LINE)
    for _ in range(feeding.MOST_PENDING + 5):
        found._from_outside(update, 0)
    assert (len(waiting), found.book.counts["overrun"]) == (feeding.MOST_PENDING, 5)


def test_objects_and_datagrams_beyond_their_limits_are_refused() -> None:
    with pytest.raises(samples.BadSample, match="at most 10000"):
        json_lines.update_of({"actors": [{"id": k, "at_m": [0, 0]} for k in range(json_lines.MOST_ACTORS + 1)]})
    with pytest.raises(samples.BadSample, match="want at most"):
        json_lines.decoded(b" " * (json_lines.MOST_BYTES + 1))
    budget = receivers.Budget()
    assert sum(budget.has_room(10**9) for _ in range(10_000)) == receivers.MOST_RATE // 10
