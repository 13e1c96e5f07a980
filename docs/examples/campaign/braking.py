"""One drive of the campaign braking.yaml: a car brakes on the ranges that it reads from the emulated LMS291.

Started by `lidaremu campaign --driver` for every case: LIDAREMU_FRONT is its port, LIDAREMU_FEED moves the car and
time, LIDAREMU_FACTORS has the case's values, LIDAREMU_RESULT takes what it has found. Exit code 0: it has stopped.
"""

from __future__ import annotations

import json
import math
import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "brake"))
from car import FRICTION, Brake, Car
from lms_host import LmsHost
from stepping import AHEAD, STEP, Virtual, begin

STOPPED_X = 122.0 - 0.1 - 3.6
"Face of the board, less the front of the car before its rear axle. [m]"
WET_FROM = 10.0
"Rain from which the road is all wet. [mm/h]"


def main() -> int:
    """The command."""
    factors = json.loads(os.environ["LIDAREMU_FACTORS"])
    speed = factors["actors.ego.motion.velocity_m_s[0]"]
    wet = min(1.0, factors["weather.rain.rate_mm_h"] / WET_FROM)
    friction = FRICTION["dry"] + (FRICTION["wet"] - FRICTION["dry"]) * wet
    world = Virtual(LmsHost(os.environ["LIDAREMU_FRONT"], 100, 0.5), os.environ["LIDAREMU_FEED"])
    begin(world)
    car, brake = Car(speed, friction, STOPPED_X - 5.0 - AHEAD * speed), Brake()
    for _ in range(5):  # scans from before are over
        world.step(car, jump=True)
    began = world.t
    while car.speed > 0 and car.x < STOPPED_X:
        t = world.t - began
        for points in world.step(car):
            if brake.see(points, car.speed):
                car.demand(t, math.inf)
        car.move(t, STEP)
    hit = car.x >= STOPPED_X
    result = {"impact_km_h": car.speed * 3.6 if hit else 0.0} | ({} if brake.at is None else {"braked_at_m": brake.at})
    Path(os.environ["LIDAREMU_RESULT"]).write_text(json.dumps(result), encoding="utf-8")
    return int(hit)


if __name__ == "__main__":
    sys.exit(main())
