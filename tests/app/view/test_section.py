"""The section of the anatomy through the tip."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from app.scene import scene as scenes
from app.settings import Options
from app.view.drawing import section
from app.view.units import VIEW_SCALE
from tests.support.headless import wait_until
from tests.support.stand_ins import client


@pytest.fixture(scope="module")
def anatomy() -> scenes.Scene:
    return scenes.build(Options(mesh="skull-coarse", robot="point"), 1, warm=False)


def test_a_section_keeps_exactly_the_part_behind_the_plane(anatomy: scenes.Scene) -> None:
    rng = np.random.default_rng(3)
    shown = anatomy.vertices_shown[anatomy.faces_shown]
    for _ in range(6):
        point = rng.choice(anatomy.vertices_shown) + rng.normal(scale=1e-3, size=3)
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        parts = [section.make(section.Cut(anatomy, point, side * normal)) for side in (1.0, -1.0)]
        areas = []
        for part, side in zip(parts, (1.0, -1.0), strict=True):
            corners = part.vertices[part.faces]
            assert (side * (corners - point) @ normal).max() < 1e-12
            areas.append(trimesh.triangles.area(corners).sum())
        # Both sides together are the whole.
        assert sum(areas) == pytest.approx(trimesh.triangles.area(shown).sum(), rel=1e-9)


def test_the_section_follows_the_tip_and_ends_with_its_client(
    anatomy: scenes.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(section, "PERIOD", 0.0)
    drawn: list[Any] = []
    stage: Any = SimpleNamespace(cut=lambda part, _number: drawn.append(part))
    cutting, me = section.Section(stage), client()
    tip = np.array(anatomy.T_base_start.translation)

    def update(at: np.ndarray, *clients: Any) -> None:
        cutting.update(anatomy, {c.client_id: c for c in clients}, at)

    def drawn_behind(at: np.ndarray) -> bool:
        update(at, me)
        if not drawn or drawn[-1] is None:
            return False
        away = me.camera.position / VIEW_SCALE - at
        farthest = ((drawn[-1][0] - at) @ away).max() / np.linalg.norm(away)
        return bool(farthest < 1e-9)

    update(tip, me)
    assert drawn == [], "there is no section before it is switched on"
    cutting.toggle(me)
    low = tip - np.array([0.0, 0.0, 0.03])
    wait_until(lambda: drawn_behind(low))
    wait_until(lambda: drawn_behind(low - np.array([0.0, 0.0, 0.01])))
    update(low)  # the client is gone
    assert drawn[-1] is None
    assert not cutting.on
    cutting.toggle(me)
    wait_until(lambda: drawn_behind(low))
    cutting.toggle(me)
    update(low, me)
    assert drawn[-1] is None
