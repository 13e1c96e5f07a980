"""The fixture `lidaremu` for tests of a driver: installed with the package, found by pytest.

    def test_driver_sees_the_car(lidaremu):
        with lidaremu("crossing_car", weather__fog__visibility_m=50) as rig:
            host = MyDriver(rig["front"].path, baud=38400)
            rig.advance(seconds=2)
            assert len(host.scan()) == 361

Imports nothing of the emulator until a test asks for it.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from emulator.judging.rig import Rig

Make = Callable[..., "Rig"]
RIGS = pytest.StashKey["list[Rig]"]()
FAILED = pytest.StashKey[bool]()


@pytest.fixture
def lidaremu(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Make]:
    """Starts scenarios on free ports in virtual time: `lidaremu(SCENARIO, seed=, links=, speed=, a__b__c=value)`.

    Two underscores stand for the dot of a scenario key; lists are reached by number or `id`.
    """
    from emulator.judging.rig import Rig

    made: list[Rig] = []

    def make(
        scenario: str,
        *,
        seed: int | None = None,
        links: Mapping[str, str | Sequence[str]] | None = None,
        speed: float | None = None,
        **overrides: Any,
    ) -> Rig:
        texts = [f"{key.replace('__', '.')}={json.dumps(value)}" for key, value in overrides.items()]
        made.append(Rig(str(scenario), tmp_path_factory.mktemp("lidaremu"), texts, seed, links, speed))
        made[-1].on_verdict = lambda text: request.node.add_report_section("call", "lidaremu verdict", text)
        return made[-1]

    request.node.stash[RIGS] = made
    yield make
    for rig in made:
        rig.close()
    if not request.node.stash.get(FAILED, False):
        for rig in made:
            shutil.rmtree(rig.recording, ignore_errors=True)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A failed test's report says where its recordings are; those of good tests are removed."""
    report = yield
    rigs = item.stash.get(RIGS, [])
    if report.failed and rigs:
        item.stash[FAILED] = True
        report.sections.append(("lidaremu recordings", "\n".join(str(rig.recording) for rig in rigs)))
    return report
