"""Processes: our only clock, waiting to the microsecond, how late we were, what befell us, children of ours.

Belongs here: what a process needs whatever it does. Not: what a run does (runtime), a device's own time (instrument).

May import: `emulator.errors`, nothing else of the project.
"""
