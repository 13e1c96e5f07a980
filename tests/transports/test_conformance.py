"""Every byte link keeps the contract."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.transports.conformance import LinkConformance
from tests.transports.rigs import RIGS, Rig, rig_of


class TestLinks(LinkConformance):
    @pytest.fixture(params=sorted(RIGS))
    def rig(self, request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Rig]:
        with rig_of(request.param, tmp_path) as rig:
            yield rig
