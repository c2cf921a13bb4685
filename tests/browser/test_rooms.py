"""`bench rooms`: two participants' rooms, each with a browser and in a trial; no timings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from app.bench import rooms
from app.bench.tools import settings

pytestmark = pytest.mark.slow


def test_two_rooms_tick_in_a_trial_at_once(chromium: str, tmp_path: Path) -> None:
    assert chromium
    shares: list[float] = []
    result: dict[str, Any] = rooms.run(
        settings.Rooms(seconds=2.0, out=tmp_path), lambda _: None, shares.append
    )
    assert shares == [0.25, 0.5, 1.0]
    assert len(result["rooms"]) == 2
    for row in result["rooms"]:
        assert row["ticks"] > 200
        assert 0.0 <= row["prompt"] <= row["punctual"] <= 1.0
