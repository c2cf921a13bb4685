"""Depth, distance, sides and the word "Free.": at every rule, against brute force."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import meshes
import robots
import vf
from app.session import Session
from app.settings import Options
from app.view import readouts
from app.view.depth import Whereabouts, free_line, shaft, whereabouts
from tests.support.headless import wait_until


def distance(session: Session, p: np.ndarray) -> float:
    """From p (3,) to the mesh, over all triangles."""
    corners = session.scene.surface.vertices[session.scene.surface.faces]
    points = trimesh.triangles.closest_point(corners, np.tile(p, (len(corners), 1)))
    return float(np.linalg.norm(points - p, axis=1).min())


@pytest.fixture(scope="module")
def sheet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An open mesh: a flat square of 40 mm."""
    side = np.linspace(-0.02, 0.02, 9)
    x, y = np.meshgrid(side, side)
    k = np.arange(64) + np.arange(64) // 8
    faces = np.vstack([np.stack([k, k + 1, k + 10], 1), np.stack([k, k + 10, k + 9], 1)])
    path = tmp_path_factory.mktemp("mesh") / "sheet.ply"
    meshes.save(path, np.column_stack([x.ravel(), y.ravel(), 0.0 * x.ravel()]), faces)
    return path


class Told:
    """What the page says of a session at rest, and what it says it from."""

    def __init__(self, session: Session) -> None:
        telemetry = session.latest()
        assert telemetry.step is not None
        self.session = session
        self.p_tip = np.array(telemetry.step.tip.translation)
        self.where: Whereabouts = whereabouts(
            session.scene,
            telemetry.q,
            self.p_tip,
            session.options.tip_radius,
            session.crossing,
        )
        joints = tuple(session.scene.arm.joints)
        extras = readouts.Extras(0, 0.0, joints, where=self.where)
        clutched, options = session.master.clutched, session.options
        self.banner = _text(readouts.banner(telemetry, options, extras, clutched))
        self.table = _text(readouts.readouts(telemetry, options, extras))

    def number(self, row: str) -> float:
        found = re.search(row + r"\s*(-?[\d.]+)mm", self.table)
        assert found is not None, (row, self.table)
        return float(found[1])


def _text(html: str) -> str:
    return re.sub(r"<[^>]*>", "", html)


@pytest.fixture(scope="module", params=["sphere", "thin-plate", "sheet"])
def session(request: pytest.FixtureRequest, sheet: Path) -> Iterator[Session]:
    mesh: dict[str, Any] = {"mesh": request.param}
    if request.param == "sheet":
        mesh = {"mesh": str(sheet), "unit": "mm"}
    with Session(Options(robot="point", **mesh)) as session:
        yield session


def go(session: Session, height: float) -> None:
    """Lead the tool without a fixture to a height over the mesh's top [m]."""
    session.set(rule="off")
    session.set(tip_radius=0.0)
    session.reset()
    wait_until(lambda: session.crossing is None and session.latest().target is None)
    start = session.scene.T_base_start
    top = float(session.scene.surface.vertices[:, 2].max())
    goal = np.array([*start.translation[:2], top + height])
    session.drive(pin.SE3(start.rotation, goal))
    wait_until(lambda: np.allclose(tip(session), goal, atol=1e-7))


def tip(session: Session) -> np.ndarray:
    step = session.latest().step
    return np.full(3, np.nan) if step is None else np.array(step.tip.translation)


def settle(session: Session) -> None:
    """Wait for ticks with what was set last, and for the watch to have seen them."""
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 100)


def rules(session: Session) -> Iterator[tuple[str, Told]]:
    """Every rule, and what the page says under it where the tool is."""
    for rule in vf.RULES:
        session.set(rule=rule)
        settle(session)
        yield rule, Told(session)


def test_in_free_space_it_is_free(session: Session) -> None:
    go(session, 0.008)
    for rule, told in rules(session):
        assert told.where.free
        assert told.number("distance to surface") == pytest.approx(8.0, abs=5e-3)
        assert ("Free." in told.banner) == (rule != "off")
        assert "crossingnone" in told.table


def test_behind_the_surface_it_is_never_free(session: Session) -> None:
    """Inside the sphere, below the plate, on the far side of the sheet."""
    go(session, -0.012)
    solid = session.scene.surface
    for _, told in rules(session):
        assert session.crossing is not None
        assert "Free." not in told.banner
        assert f"Crossed at tick {session.crossing.tick:,}, triangle #" in told.banner
        assert "(rule off)" in told.banner
        assert "Reset" in told.banner
        true = 1e3 * distance(session, told.p_tip)
        assert told.number("distance to surface") == pytest.approx(true, abs=6e-4)
        if session.scene.mesh_name == "sphere":
            assert trimesh.Trimesh(solid.vertices, solid.faces).contains([told.p_tip]).all()
            assert "deep in the anatomy" in told.banner
            assert told.number("depth below surface") == pytest.approx(true, abs=6e-4)
        else:
            assert "On the far side" in told.banner
            depth = 1e3 * (float(solid.vertices[:, 2].max()) - told.p_tip[2])
            assert told.number("depth below crossing") == pytest.approx(depth, abs=6e-4)
    session.pause()
    wait_until(lambda: session.latest().paused)
    assert "Paused." in Told(session).banner
    assert re.search("deep in|On the far side", Told(session).banner)
    session.resume()


def test_back_out_it_is_said_to_be_back_but_the_crossing_stays(session: Session) -> None:
    go(session, -0.012)
    start = session.scene.T_base_start
    session.drive(start)
    wait_until(lambda: np.allclose(tip(session), start.translation, atol=1e-7))
    for _, told in rules(session):
        assert "Crossed at tick" in told.banner
        assert "Back on the near side" in told.banner
        assert "Free." not in told.banner


def test_a_ball_is_measured_from_its_centre_and_from_its_surface(session: Session) -> None:
    go(session, 0.004)
    session.set(tip_radius=0.001)
    for rule, told in rules(session):
        true = 1e3 * distance(session, told.p_tip)
        assert told.number("tip’s centre to surface") == pytest.approx(true, abs=6e-4)
        assert told.number("tip’s ball to surface") == pytest.approx(true - 1.0, abs=6e-4)
        # Of a thin plate, rule "all" also has the planes of the side turned away.
        assert "Free." in told.banner or rule in ("all", "off")
    go(session, 0.004)
    session.pause()
    wait_until(lambda: session.latest().paused)
    session.set(tip_radius=0.005)  # now it overlaps, though nothing moved
    told = Told(session)
    true = 1e3 * distance(session, told.p_tip)
    assert told.where.overlaps
    assert not told.where.free
    assert told.number("tip’s ball to surface") == pytest.approx(true - 5.0, abs=6e-4)
    session.resume()
    settle(session)
    assert session.crossing is None


def test_round_the_edge_is_no_far_side_and_no_crossing(sheet: Path) -> None:
    options = Options(mesh=str(sheet), unit="mm", robot="point")
    with Session(options) as session:
        start = session.scene.T_base_start
        for shift in ((0.04, 0.0, 0.0), (0.04, 0.0, -0.03), (0.0, 0.0, -0.03)):
            goal = start.translation + np.array(shift)
            session.drive(pin.SE3(start.rotation, goal))
            wait_until(lambda goal=goal: np.allclose(tip(session), goal, atol=1e-6))
        settle(session)
        told = Told(session)
        assert session.crossing is None
        assert "Free." in told.banner
        assert "depth below surface–" in told.table


def test_the_shaft_in_the_mesh_is_remarked() -> None:
    """The tip goes round the edge of a plate, and below it, where the shaft sticks through it."""
    with Session(Options(mesh="thin-plate")) as session:
        settle(session)
        remark = "The shaft is in the mesh: only the tip is guarded."
        assert not Told(session).where.shaft_crosses
        assert remark not in Told(session).banner
        start = session.scene.T_base_start
        for shift in ((0.06, 0.0, 0.0), (0.06, 0.0, -0.03), (0.03, 0.0, -0.03)):
            goal = start.translation + np.array(shift)
            session.drive(pin.SE3(start.rotation, goal))
            wait_until(lambda goal=goal: np.allclose(tip(session), goal, atol=1e-4))
        settle(session)
        told = Told(session)
        assert session.crossing is None
        assert told.where.shaft_crosses
        assert remark in told.banner
        assert "Free." in told.banner


@pytest.mark.parametrize(
    "name",
    # The drawings of the others take some seconds to read.
    [pytest.param(n, marks=[pytest.mark.slow] * (n in ("panda", "ur5"))) for n in robots.names()],
)
def test_the_shaft_is_a_line_from_the_tip_up_the_arm(name: str) -> None:
    arm = robots.load(name)
    p_tip = np.array(arm.tip(arm.neutral).translation)
    line = shaft(arm, arm.neutral, p_tip)
    np.testing.assert_array_equal(line[0], p_tip)
    if name == "point":
        assert len(line) == 1
        return
    # A wall across the instrument, 5 cm up from the tip, meets it; one as far below does not.
    up = -np.array(arm.tip(arm.neutral).rotation[:, 2])
    across = np.linalg.svd(up[None])[2][1:]
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]]) * 0.01 @ across
    for side, free in ((1.0, False), (-1.0, True)):
        wall = vf.Surface.from_arrays(p_tip + side * 0.05 * up + corners, [[0, 1, 2]])
        assert free_line(wall, line) == free
