"""What the tests of devices share."""

from __future__ import annotations

from dataclasses import replace

import pytest

from app.scene import scene as scenes
from app.scene.scene import Scene
from tests.support.wired import AWAY, Bench, Make


@pytest.fixture(scope="session")
def away() -> Scene:
    """The scene of arms and masters that are elsewhere."""
    return scenes.build(AWAY, 1)


@pytest.fixture
def make(away: Scene, monkeypatch: pytest.MonkeyPatch) -> Make:
    """Makes benches with other options."""
    return lambda **changes: Bench(away, replace(AWAY, **changes), monkeypatch)
