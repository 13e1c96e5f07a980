"""From truth to a scan: what one sensor sees of a scene.

`build` makes the measuring function of a sensor. Its steps, a module each: model (facts and choices in SI), rays (where
the sub-beams go), paths (what they bring back), air (what is between), echoes and receiver (what becomes of it).
"""

from emulator.sensing.measure import Measure, build
from emulator.sensing.table import table_plan
from emulator.sensing.view import View

__all__ = ["Measure", "View", "build", "table_plan"]
