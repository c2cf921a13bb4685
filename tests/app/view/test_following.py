"""Cameras that follow the tool, or look along the instrument."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin

from app.control.messages import Telemetry
from app.view import camera
from app.view.units import VIEW_SCALE


class Camera(SimpleNamespace):
    """The attributes of viser's camera that `Following` and `move` use."""


def client_at(eye: list[float], at: list[float]) -> Any:
    from contextlib import nullcontext

    return SimpleNamespace(
        camera=Camera(position=np.array(eye), look_at=np.array(at)), atomic=nullcontext
    )


def test_a_following_camera_keeps_the_tool_centred_at_its_distance() -> None:
    following = camera.Following()
    client = client_at([0.0, -10.0, 5.0], [0.0, 0.0, 0.0])
    following.start(7, np.zeros(3))
    following.update({7: client}, np.array([1e-6, 0.0, 0.0]))
    assert (client.camera.look_at == 0.0).all(), "less than a pixel"
    tip = np.array([0.01, 0.02, -0.005])
    following.update({7: client}, tip)
    np.testing.assert_allclose(client.camera.look_at, VIEW_SCALE * tip)
    away = client.camera.position - client.camera.look_at
    np.testing.assert_allclose(away, [0.0, -10.0, 5.0])
    # A stale position reported by the client causes no drift.
    client.camera.position, client.camera.look_at = np.array([0.0, -10.0, 5.0]), np.zeros(3)
    following.update({7: client}, 2.0 * tip)
    np.testing.assert_allclose(client.camera.look_at, 2.0 * VIEW_SCALE * tip)
    following.stop(7)
    following.update({7: client}, np.zeros(3))
    np.testing.assert_allclose(client.camera.look_at, 2.0 * VIEW_SCALE * tip)
    following.start(8, np.zeros(3))
    following.update({}, np.ones(3))
    assert following.clients == (), "a disconnected client is forgotten"


def test_the_surgeon_looks_down_along_the_instrument(telemetry: list[Telemetry]) -> None:
    step = telemetry[-1].step
    for R in (pin.rpy.rpyToMatrix(np.pi, 0.0, 0.0), pin.rpy.rpyToMatrix(0.6 + np.pi, 0.3, 0.0)):
        view = camera.surgeon_view(replace(step, tip=pin.SE3(R, np.array([0.1, 0.0, 0.2]))))
        forward = (view.look_at - view.eye) / np.linalg.norm(view.look_at - view.eye)
        angle = np.rad2deg(np.arccos(forward @ R[:, 2]))
        assert 25.0 < angle < 45.0
        assert view.eye[2] > view.look_at[2]
        np.testing.assert_allclose(view.look_at, [0.1, 0.0, 0.2])
