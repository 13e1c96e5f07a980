"""`python -m emulator` is `lidaremu`."""

from emulator.commands.cli import entry

entry()
