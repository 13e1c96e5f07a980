"""A sweep under faults of what is measured: where the beams really go, what light comes back, what is made of it.

Belongs here: the order of these steps around those of a healthy sweep. Not: what each fault does (emulator.faults), and
nothing of it is imported in a run without them.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from emulator.measuring.conditions import ActiveFault
from emulator.physics.arrays import Floats
from emulator.physics.random_streams import RandomStreams
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import SubEchoes
from emulator.sensing.daylight import Daylight, of_power
from emulator.sensing.model import SensorModel
from emulator.sensing.photon_receiver import PhotonReceiver
from emulator.sensing.receiver import Receiver
from emulator.sensing.soft import SoftTargets
from protocols.scan import Scan, ScanPlan

if TYPE_CHECKING:
    from emulator.sensing.faulty.held import Held
    from emulator.sensing.faulty.light import Light
    from emulator.sensing.view import View

MOST_RECEIVERS = 16
"Worn receivers that are kept: one that drifts is a new one in every sweep."
FACTOR_STEP = 0.01
"Relative step in which a drifting light's share of the air's return is taken: its tables are made once for each."

Look = Callable[[ScanPlan, "Floats | None"], "tuple[View, Daylight]"]
"Of a sweep, and how far the sensor is beside its place."


class FaultySweeps:
    """Measures one sensor's sweeps under faults."""

    def __init__(
        self, model: SensorModel, draws: RandomStreams, soft: SoftTargets, healthy: Receiver | PhotonReceiver
    ) -> None:
        self._model, self._draws, self._soft, self._healthy = model, draws, soft, healthy
        self._worn: OrderedDict[SensorModel, Receiver | PhotonReceiver] = OrderedDict()

    def measured(self, plan: ScanPlan, faults: tuple[ActiveFault, ...], look: Look) -> Scan:
        """The scan that the device takes for that of `plan`."""
        from emulator.sensing.faulty import aims, readings
        from emulator.sensing.faulty.held import held

        active = held(faults, plan)
        asked = plan
        reported = readings.frozen(plan, active)
        if reported is not None:
            # what else is wrong is as it was at that instant
            plan = reported
            active = tuple(one for one in held(faults, plan) if one.from_ns <= plan.start_ns)
        view, light = look(aims.aimed(plan, active, self._draws), aims.shift_m(active))
        scan = self._received(plan, active, view, light)
        for name, effect in readings.READINGS.items():
            for one in active:
                if one.name == name:
                    # the device knows its beams by the directions that it believes in
                    scan = effect(one, scan, self._draws)
        return replace(scan, plan=asked)

    def _received(self, plan: ScanPlan, active: tuple[Held, ...], view: View, light: Daylight) -> Scan:
        from emulator.sensing.faulty.light import LIGHT, Light

        altered = Light(plan, self._model, self._draws)
        hit = False
        for name, effect in LIGHT.items():
            for one in active:
                if one.name == name:
                    hit = True
                    effect(one, altered)
        if not hit:
            return self._healthy.receive(plan, view.echoes, self._soft.everywhere(view.air, plan.gain), light)
        worn = altered.receiver()
        scale = altered.scale(worn)
        found, soft = self._air_and_all(plan, altered, view, scale)
        echoes = altered.echoes(found)
        echoes = replace(echoes, amplitude=echoes.amplitude * scale)
        power_w = np.zeros(len(plan)) if light.power_w is None else light.power_w
        outside = of_power((power_w + altered.glare_w) * altered.dimmed, worn)
        return self._receiver(worn, altered).receive(plan, echoes, soft, outside)

    def _air_and_all(
        self, plan: ScanPlan, altered: Light, view: View, scale: float
    ) -> tuple[SubEchoes, SoftProfile | None]:
        """What the air sends back: one table where all beams are alike, else points along each beam."""
        passed = altered.passed
        first = float(passed[0])
        if bool(np.all(passed == first)):
            factor = first * scale
            if factor <= 0.0:
                return view.echoes, None
            factor = math.exp(round(math.log(factor) / FACTOR_STEP) * FACTOR_STEP)
            return view.echoes, self._soft.everywhere(view.air, plan.gain * factor)
        if self._soft.everywhere(view.air, plan.gain) is None:
            return view.echoes, None
        t_s = 1e-9 * plan.start_ns + plan.fire_offset_s
        points = self._soft.points(view.air, view.rays, view.echoes, t_s, plan.gain)
        return (view.echoes if points is None else SubEchoes.joined(view.echoes, points)), None

    def _receiver(self, worn: SensorModel, altered: Light) -> Receiver | PhotonReceiver:
        if worn is self._model:
            return self._healthy
        known = self._worn.get(worn)
        if known is None:
            if worn.photons is not None:
                # it counts: noise are dark counts, whose spread goes with their root
                options = worn.photons.model_copy(
                    update={"dark_count_hz": worn.photons.dark_count_hz * altered.noise**2}
                )
                known = PhotonReceiver(self._model, options, self._draws)
            else:
                known = Receiver(worn, self._draws)
            self._worn[worn] = known
            if len(self._worn) > MOST_RECEIVERS:
                self._worn.popitem(last=False)
        return known
