"""Applies a scenario to a session, and describes a session as a scenario."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

import meshes
from app.control.autopilot import Course
from app.scenarios.file import SETTINGS, Scenario, Waypoint
from app.scene import worker
from app.scene.scene import Progress, Scene
from app.session import Session


def course(scenario: Scenario, scene: Scene) -> Course | None:
    """The scenario's proxy in the arm's base frame; None: it stays on the tool.

    If the first waypoint's time is later than 0, the course starts on the tool.
    """
    if not scenario.proxy:
        return None
    T_base_mesh = scene.T_base_mesh
    rotation = np.array(scene.T_base_start.rotation)
    if scenario.wxyz is not None:
        rotation = T_base_mesh[:3, :3] @ pin.Quaternion(*scenario.wxyz).normalized().matrix()
    points = meshes.transformed(T_base_mesh, [waypoint.at for waypoint in scenario.proxy])
    times = np.array([waypoint.time for waypoint in scenario.proxy])
    if times[0] > 0.0:
        times = np.concatenate([[0.0], times])
        points = np.vstack([scene.T_base_start.translation, points])
    return Course(rotation, times, points)


def begin(scenario: Scenario, session: Session) -> None:
    """Reset the tool and start the scenario's proxy, in a session with the scenario's scene.

    Raises:
        session.Refused: the proxy is too far from the arm's base.
    """
    way = course(scenario, session.scene)
    session.pause()
    if way is None:
        session.reset()
    elif len(way.points) == 1:
        session.reset()
        session.put(way.pose(0.0))
    else:
        session.perform(way)
    if not scenario.paused:
        session.resume()


def stage(
    scenario: Scenario,
    session: Session,
    progress: Progress | None = None,
    stop: worker.Stop | None = None,
) -> None:
    """Apply a scenario to a running session: scene and settings, then `begin`.

    Args:
        progress, stop: as in `Session.change`.

    Raises:
        ValueError: what `Session.change` refuses; nothing is changed then.
    """
    wanted = {name: getattr(scenario.options, name) for name in SETTINGS}
    session.change(**wanted, progress=progress, stop=stop)
    begin(scenario, session)


def present(session: Session, name: str, about: str) -> Scenario:
    """The present state of a session as a scenario, with its script or the proxy's pose."""
    scene, options, telemetry = session.scene, session.options, session.latest()
    R_mesh_base = scene.T_base_mesh[:3, :3].T
    way: Course | None = None
    if telemetry.autopilot and isinstance(scene.autopilot, Course):
        way = scene.autopilot
    elif telemetry.target is not None and not telemetry.autopilot:
        target = telemetry.target
        way = Course(np.array(target.rotation), np.zeros(1), np.array(target.translation)[None, :])
    scenario = Scenario(name, about, options, paused=telemetry.paused)
    if way is None:
        return scenario
    x, y, z, w = pin.Quaternion(R_mesh_base @ way.rotation).coeffs()
    points = (way.points - scene.T_base_mesh[:3, 3]) @ R_mesh_base.T
    proxy = tuple(
        Waypoint(float(time), (float(p[0]), float(p[1]), float(p[2])))
        for time, p in zip(way.times, points, strict=True)
    )
    return replace(scenario, proxy=proxy, wxyz=(float(w), float(x), float(y), float(z)))
