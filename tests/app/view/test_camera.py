"""Lenses, clipping planes and named views."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from app.session import Session
from app.settings import Options
from app.view import camera
from app.view.units import VIEW_SCALE
from tests.support.stand_ins import client


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with Session(Options(mesh="cube", robot="point", rate=500.0)) as session:
        yield session


def test_another_lens_keeps_the_size_of_objects_at_the_centre() -> None:
    me = client()
    eye = me.camera

    def height() -> float:
        return float(np.linalg.norm(eye.position - eye.look_at) * np.tan(0.5 * eye.fov))

    before, direction = height(), eye.position / np.linalg.norm(eye.position)
    camera.set_lens(me, camera.PARALLEL)
    assert camera.is_parallel(me)
    assert height() == pytest.approx(before)
    np.testing.assert_allclose(eye.position / np.linalg.norm(eye.position), direction, atol=1e-12)
    # A thing half a picture's height nearer looks 1.8 % larger, as the hint says, no more.
    distance = np.linalg.norm(eye.position)
    assert distance / (distance - height()) == pytest.approx(1.018, abs=5e-4)
    assert eye.near < distance - 10.0 * height()
    assert distance < eye.far
    camera.set_lens(me, camera.FIELD_OF_VIEW)
    np.testing.assert_allclose(eye.position, [0.0, -10.0, 5.0], atol=1e-9)
    assert (eye.near, eye.far) == (camera.NEAR_PLANE, camera.FAR_PLANE)


def test_the_clipping_planes_follow_a_parallel_camera() -> None:
    me = client()
    camera.set_lens(me, camera.PARALLEL)
    for zoom in (0.1, 0.01, 3.0):
        me.camera.position = me.camera.look_at + zoom * (me.camera.position - me.camera.look_at)
        camera.update_clipping(me)
        distance = np.linalg.norm(me.camera.position - me.camera.look_at)
        assert 0.3 * distance < me.camera.near < 0.7 * distance
        assert me.camera.far > distance


def test_axis_views_are_along_the_axes_with_any_lens(session: Session) -> None:
    tip = np.array(session.scene.T_base_start.translation)
    for lens in (camera.FIELD_OF_VIEW, camera.PARALLEL):
        for k, name in enumerate(("Side", "Front", "Top")):
            me = client()
            camera.set_lens(me, lens)
            camera.move(me, camera.named_view(name, session.scene, None))
            away = me.camera.position - me.camera.look_at
            np.testing.assert_allclose(away / np.linalg.norm(away), np.eye(3)[k], atol=1e-12)
            assert abs(me.camera.up_direction @ away) < 1e-9, "up is not the way it looks"
            assert np.linalg.norm(me.camera.look_at / VIEW_SCALE - tip) < 0.02
            half = np.linalg.norm(away) * np.tan(0.5 * lens) / VIEW_SCALE
            assert half == pytest.approx(camera.site_half_height(session.scene), rel=0.07)
