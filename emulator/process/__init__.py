"""Processes: the only clock, waiting to the microsecond, lateness, incidents, child processes.

Belongs here: what a process needs whatever it does. Not: what a run does (runtime), a device's own time (instrument).

May import: `emulator.errors`, nothing else of the project.
"""
