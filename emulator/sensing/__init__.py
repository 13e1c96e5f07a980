"""From truth to a scan: what one sensor sees of a scene.

`measure.build` makes the measuring function of a sensor. Its steps, a module each: model (facts and choices in SI),
rays (where the sub-beams go), paths (what they bring back), air (what is between), echoes and receiver (what becomes
of it); `faulty/`: the same under faults; error_budget and cost: what a scene does not need, and what leaving it out
saves.

May import: `casting`, `world`, `measuring`, `scenario`, `faults`, `physics`, `compiled` and below.
"""
