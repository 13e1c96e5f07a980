"""The sweep that each sensor of a scenario makes once a host has asked for scans, found without measuring one.

Belongs here: running the devices and built-in hosts of a scenario on empty scans. Not: what a device plans (protocols).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

from emulator.judging.trial import Trial
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.scenario.scenario import Scenario
from protocols.scan import Scan, ScanPlan

LONGEST_S = 60.0
"Virtual time in which every device has booted and been asked."
SETTLED = 3
"Sweeps after which a device does what the host has asked for."


class _Empty:
    """Measures nothing, and remembers what was asked for."""

    def __init__(self) -> None:
        self.plans: dict[str, list[ScanPlan]] = defaultdict(list)
        self._owed: dict[str, list[Scan]] = defaultdict(list)

    def request(self, sensor: str, plan: ScanPlan, conditions: Conditions = NORMAL) -> None:
        """Note the plan; its scan sees nothing."""
        self.plans[sensor].append(plan)
        self._owed[sensor].append(Scan.empty(plan))

    def collect(self, sensor: str) -> list[Scan]:
        """Empty scans of what was asked for."""
        return self._owed.pop(sensor, [])


def plans_of(scenario: Scenario) -> Mapping[str, ScanPlan]:
    """Sensor -> a sweep of its running; without those that no built-in host can ask for scans."""
    taken = _Empty()
    trial = Trial(scenario.model_copy(update={"expect": ()}), measuring=taken)
    second = 0
    names = [sensor.id for sensor in scenario.sensors]
    while second < LONGEST_S and any(len(taken.plans[name]) < SETTLED for name in names):
        second += 1
        trial.run.advance(1_000_000_000 * second)
    return {name: taken.plans[name][-1] for name in names if taken.plans[name] and len(taken.plans[name][-1])}
