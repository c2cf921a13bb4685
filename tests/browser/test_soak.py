"""Five minutes of what `vf-sandbox bench soak` does in an hour."""

from __future__ import annotations

import pytest

from app.bench import soak
from app.bench.tools import settings


@pytest.mark.slow
def test_clients_that_come_and_go_for_five_minutes_leave_nothing(chromium: str) -> None:
    options = settings.Soak(minutes=5.0, reconnect=20.0, mesh="skull-coarse", rate=500.0)
    result = soak.run(options, lambda text: None, lambda share: None)
    assert result["complaints"] == []
    assert result["visits"] >= 5
    assert result["loop"]["longest stall [ms]"] < 30_000  # it never stopped for good
