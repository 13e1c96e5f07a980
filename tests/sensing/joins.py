"""Reference values for terms that meet, made apart from the product: how they are looked up."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

FILE = Path(__file__).parent / "data" / "joins_light.json"


def cases(kind: str) -> list[dict[str, Any]]:
    """All of a kind."""
    found = json.loads(FILE.read_text(encoding="utf-8"))["cases"]
    return [one for one in found if one["kind"] == kind]
