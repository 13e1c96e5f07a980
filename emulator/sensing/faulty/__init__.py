"""A sweep under faults of what is measured: where the beams go (aims), what light comes back (light), what the device
makes of it (readings), in their order (sweeps). Loaded by the first sweep under a fault.

Not: keys and kinds of faults (emulator.faults), when they begin (emulator.injection).
"""
