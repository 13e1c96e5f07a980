"""A sensor that triangulates, through the whole path: rated accuracy, near limit, dark targets, sunlight."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from emulator.measuring.conditions import NORMAL
from emulator.scenario.scenario import load
from emulator.sensing.measure import measure_of
from protocols.scan import DAZZLED, Scan, ScanPlan
