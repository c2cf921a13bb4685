"""Distance, depth and side of the tool under every rule, against brute force."""

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
from app.judges import boxes
from app.judges.nearest import gaps
from app.session import Session
from app.settings import Options
from app.view.tabs import readouts
from app.view.tabs.depth import Whereabouts, whereabouts
from tests.support.headless import wait_until


def distance(session: Session, p: np.ndarray) -> float:
    """Distance from p (3,) to the mesh, over all triangles."""
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


class Shown:
    """What the page shows of a session at rest."""

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
        parts = tuple(capsule.name for capsule in session.scene.arm.capsules)
        extras = readouts.Extras(0, 0.0, joints, where=self.where, parts=parts)
        clutched, options = session.master.clutched, session.options
        self.banner = _text(readouts.banner(telemetry, options, extras, clutched))
        self.html = readouts.readouts(telemetry, options, extras)
        self.table = _text(self.html)

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
    """Move the tool without a fixture to a height above the mesh's top [m]."""
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
    """Wait until ticks with the new settings have been tested for crossings."""
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 100)


def rules(session: Session) -> Iterator[tuple[str, Shown]]:
    """Each rule, and what the page shows under it."""
    for rule in vf.RULES:
        session.set(rule=rule)
        settle(session)
        yield rule, Shown(session)


def test_free_space_is_reported_as_free(session: Session) -> None:
    go(session, 0.008)
    for rule, shown in rules(session):
        assert shown.where.free
        assert shown.number("distance to surface") == pytest.approx(8.0, abs=5e-3)
        assert ("Free." in shown.banner) == (rule != "off")
        assert "crossingnone" in shown.table
        assert "background:rgb(200,0,30)" not in shown.html


def test_behind_the_surface_is_never_reported_as_free(session: Session) -> None:
    """Inside the sphere, below the plate, on the far side of the sheet."""
    go(session, -0.012)
    solid = session.scene.surface
    for _, shown in rules(session):
        assert session.crossing is not None
        assert "Free." not in shown.banner
        assert f"Crossed at tick {session.crossing.tick:,}, triangle #" in shown.banner
        assert "(rule off)" in shown.banner
        assert re.search(
            rf"background:rgb\(200,0,30\)[^>]*>tick {session.crossing.tick:,}<", shown.html
        )
        assert "Reset" in shown.banner
        true = 1e3 * distance(session, shown.p_tip)
        assert shown.number("distance to surface") == pytest.approx(true, abs=6e-4)
        if session.scene.mesh_name == "sphere":
            assert trimesh.Trimesh(solid.vertices, solid.faces).contains([shown.p_tip]).all()
            assert "deep in the anatomy" in shown.banner
            assert shown.number("depth below surface") == pytest.approx(true, abs=6e-4)
        else:
            assert "On the far side" in shown.banner
            depth = 1e3 * (float(solid.vertices[:, 2].max()) - shown.p_tip[2])
            assert shown.number("depth below crossing") == pytest.approx(depth, abs=6e-4)
    session.pause()
    wait_until(lambda: session.latest().paused)
    assert "Paused." in Shown(session).banner
    assert re.search("deep in|On the far side", Shown(session).banner)
    session.resume()


def test_a_crossing_stays_reported_after_the_return(session: Session) -> None:
    go(session, -0.012)
    start = session.scene.T_base_start
    session.drive(start)
    wait_until(lambda: np.allclose(tip(session), start.translation, atol=1e-7))
    for _, shown in rules(session):
        assert "Crossed at tick" in shown.banner
        assert "Back on the near side" in shown.banner
        assert "Free." not in shown.banner


def test_distances_of_a_ball_are_from_its_centre_and_its_surface(session: Session) -> None:
    go(session, 0.004)
    session.set(tip_radius=0.001)
    for rule, shown in rules(session):
        true = 1e3 * distance(session, shown.p_tip)
        assert shown.number("tip’s centre to surface") == pytest.approx(true, abs=6e-4)
        assert shown.number("tip’s ball to surface") == pytest.approx(true - 1.0, abs=6e-4)
        # Of a thin plate, rule "all" also has the planes of the side turned away.
        assert "Free." in shown.banner or rule in ("all", "off")
    go(session, 0.004)
    session.pause()
    wait_until(lambda: session.latest().paused)
    session.set(tip_radius=0.005)  # now it overlaps, though nothing moved
    shown = Shown(session)
    true = 1e3 * distance(session, shown.p_tip)
    assert shown.where.overlaps
    assert not shown.where.free
    assert shown.number("tip’s ball to surface") == pytest.approx(true - 5.0, abs=6e-4)
    session.resume()
    settle(session)
    assert session.crossing is None


def test_a_path_round_the_edge_is_no_crossing(sheet: Path) -> None:
    options = Options(mesh=str(sheet), unit="mm", robot="point")
    with Session(options) as session:
        start = session.scene.T_base_start
        for shift in ((0.04, 0.0, 0.0), (0.04, 0.0, -0.03), (0.0, 0.0, -0.03)):
            goal = start.translation + np.array(shift)
            session.drive(pin.SE3(start.rotation, goal))
            wait_until(lambda goal=goal: np.allclose(tip(session), goal, atol=1e-6))
        settle(session)
        shown = Shown(session)
        assert session.crossing is None
        assert "Free." in shown.banner
        assert "depth below surface–" in shown.table


def test_a_shaft_in_the_mesh_is_reported() -> None:
    """The tip moves round the edge of a plate to below it, where the shaft penetrates it."""
    with Session(Options(mesh="thin-plate", guard="tip")) as session:
        settle(session)
        remark = "The wrist and shaft are in the mesh: only the tip is guarded."
        assert not Shown(session).where.in_mesh
        assert remark not in Shown(session).banner
        start = session.scene.T_base_start
        for shift in ((0.06, 0.0, 0.0), (0.06, 0.0, -0.03), (0.03, 0.0, -0.03)):
            goal = start.translation + np.array(shift)
            session.drive(pin.SE3(start.rotation, goal))
            wait_until(lambda goal=goal: np.allclose(tip(session), goal, atol=1e-4))
        settle(session)
        shown = Shown(session)
        assert session.crossing is None
        assert shown.where.in_mesh == ("wrist", "shaft")
        assert shown.number("nearest part: (?:wrist|shaft)") == pytest.approx(-4.2, abs=0.03)
        assert remark in shown.banner
        assert "Free." in shown.banner


@pytest.mark.parametrize(
    "name",
    # The drawings of the others take some seconds to read.
    [pytest.param(n, marks=[pytest.mark.slow] * (n in ("panda", "ur5"))) for n in robots.names()],
)
def test_a_wall_across_the_instrument_is_met_by_it(name: str) -> None:
    arm = robots.load(name)
    p_tip = np.array(arm.tip(arm.neutral).translation)
    # A wall across the instrument, 5 cm up from the tip, meets it; one as far below does not.
    up = -np.array(arm.tip(arm.neutral).rotation[:, 2])
    across = np.linalg.svd(up[None])[2][1:]
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]]) * 0.01 @ across
    for side in (1.0, -1.0):
        wall = p_tip + side * 0.05 * up + corners
        found = gaps(boxes.build(wall, np.array([[0, 1, 2]])), arm, arm.neutral)
        met = name != "point" and side > 0.0
        assert (found == -np.array([c.radius for c in arm.capsules])).any() == met
        assert (found.min() < 0.0) == met


def test_of_the_parts_only_the_nearest_counts_and_the_trocar_zone_is_left_out() -> None:
    arm = robots.load("psm")
    sheet = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 2.0, 0.0]])

    def at(height: float, **options: float) -> list[float]:
        wall = boxes.build(sheet + np.array([0.0, 0.0, height]), np.array([[0, 1, 2]]))
        return list(gaps(wall, arm, arm.neutral, **options))

    tip, radii = arm.tip(arm.neutral).translation[2], [c.radius for c in arm.capsules]
    assert at(tip - 0.01) == pytest.approx([0.01, np.inf, np.inf, np.inf])
    away = arm.axes(arm.neutral)[3, 1, 2] + 0.01
    assert at(away)[3] == pytest.approx(0.01 - radii[3])
    assert at(away)[:3] == pytest.approx(
        away - arm.axes(arm.neutral)[:3, :, 2].max(axis=1) - radii[:3]
    )
    assert at(-0.003)[2] == -radii[2]
    assert at(-0.003, trocar=0.02)[2] == pytest.approx(
        np.sqrt(0.02**2 - radii[2] ** 2) - 0.003 - radii[2]
    )
