"""The scripted hand, on every catalogue mesh: pace, repeatability, and that it does push in."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import meshes
import robots
import vf
from app.control.autopilot import DEPTH, Autopilot, Course, plan
from tests.support.brute import Oracle
from tests.support.everyday import everyday

NAMES = [name for name in meshes.names() if "fine" not in name]


def tour(name: str) -> tuple[vf.Surface, pin.SE3, Autopilot]:
    arm = robots.load("psm")
    T = arm.tip(arm.neutral)
    vertices, faces = meshes.arrays(name)
    surface = vf.Surface.from_arrays(meshes.place(vertices, T), faces)
    return surface, T, plan(surface, T)


@pytest.mark.parametrize("name", everyday(NAMES, "skull-coarse", "thin-plate"))
def test_a_tour_is_slow_and_closed_and_goes_in_and_out(name: str) -> None:
    surface, T, autopilot = tour(name)
    times = np.arange(0.0, autopilot.duration + 0.5, 1e-3)
    poses = [autopilot.pose(t) for t in times]
    path = np.array([pose.translation for pose in poses])
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1) / 1e-3
    assert speed.max() <= 0.1
    np.testing.assert_allclose(path[0], T.translation, atol=1e-12)
    end = np.searchsorted(times, autopilot.duration)
    np.testing.assert_allclose(path[end - 1], T.translation, atol=1e-4)
    # It starts over: what follows the end is what followed the start.
    np.testing.assert_allclose(
        autopilot.pose(autopilot.duration + 0.3).translation,
        autopilot.pose(0.3).translation,
        atol=1e-9,
    )
    for pose in poses[::500]:
        np.testing.assert_array_equal(pose.rotation, T.rotation)
    # In and out again, several times: a poke that does not enter would show nothing.
    truth = Oracle(surface.vertices, surface.faces)
    assert truth.crossings(path[::4]) >= 4
    assert abs(truth.winding(path[0])) < 0.5


def test_a_poke_reaches_its_depth_below_a_flat_top() -> None:
    surface, _, autopilot = tour("cube")
    top = surface.vertices[:, 2].max()
    lowest = min(autopilot.pose(t).translation[2] for t in np.arange(0, autopilot.duration, 5e-3))
    assert lowest == pytest.approx(top - DEPTH, abs=1e-6)


def test_the_same_surface_gives_the_same_tour_to_the_bit() -> None:
    _, _, first = tour("torus")
    _, _, second = tour("torus")
    for t in (0.0, 0.1, 1.234, first.duration - 1e-3, 7.5):
        assert (first.pose(t).homogeneous == second.pose(t).homogeneous).all()


def test_a_mesh_with_nothing_below_the_tool_is_still_visited() -> None:
    # Two walls to the left and right: no vertical line near the tool meets them.
    wall = np.array([[0.2, -1, -1], [0.2, 1, -1], [0.2, 0, 1.0]]) * 0.1
    vertices = np.vstack([wall, wall * [-1, 1, 1]])
    surface = vf.Surface.from_arrays(vertices, [[0, 1, 2], [3, 4, 5]])
    autopilot = plan(surface, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.02])))
    path = np.array([autopilot.pose(t).translation for t in np.arange(0, autopilot.duration, 0.01)])
    assert np.isfinite(path).all()
    assert np.abs(path[:, 0]).max() > 0.019


def test_a_course_passes_its_waypoints_at_rest() -> None:
    way = Course(
        np.eye(3), np.array([0.0, 1.0, 3.0]), np.array([[0.0, 0, 0], [1, 0, 0], [1, 2, 0]])
    )
    at = lambda t: np.array(way.pose(t).translation)  # noqa: E731
    np.testing.assert_allclose(at(0.0), way.points[0])
    np.testing.assert_allclose(at(0.5), [0.5, 0, 0])
    np.testing.assert_allclose(at(1.0), way.points[1])
    np.testing.assert_allclose(at(2.0), [1, 1, 0])
    np.testing.assert_array_equal(at(99.0), way.points[2])
    for t in (0.0, 1.0, 3.0):
        assert np.linalg.norm(at(t + 1e-3) - at(max(t - 1e-3, 0.0))) < 1e-7
