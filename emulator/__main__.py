"""`python -m emulator` is `lidaremu`."""

from emulator.cli import entry

entry()
