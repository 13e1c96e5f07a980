"""What holds for all tests: property tests draw the same cases every time, and none has a limit by the clock."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("lidaremu", deadline=None, derandomize=True)
settings.load_profile("lidaremu")
