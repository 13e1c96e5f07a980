"""What files, `--set` and expressions are made of: tables, YAML with the line of every key, changes, names.

Belongs here: how values are written and refused. Not: which values there are (scenario, sensors, faults).

May import: `emulator.errors`, `protocols`.
"""
