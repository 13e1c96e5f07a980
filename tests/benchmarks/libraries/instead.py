"""A pytest plug-in that puts a library in the place of a part of ours: `LIDAREMU_INSTEAD=job:library`."""

from __future__ import annotations

import importlib
import os

_job, _, _library = os.environ.get("LIDAREMU_INSTEAD", "").partition(":")
if _job:
    importlib.import_module(f"tests.benchmarks.libraries.{_job}").put_in(_library)
