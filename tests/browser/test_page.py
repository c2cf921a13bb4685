"""A user's paths through the page, in a real browser, checked on the server by other means."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
import trimesh

from app.session import Session
from app.view import Page
from app.view.drawing.proxy import GIZMO_SIZE
from app.view.units import VIEW_SCALE
from tests.support.watching import Track, Visitor, drawn_share, settle, wait_until

MESH = "skull-coarse"  # as the default skull, but a software renderer draws it ten times faster


@pytest.fixture(autouse=True)
def _fresh(session: Session) -> None:
    """Every test starts at rest at the scene's start, with the default settings."""
    if session.scene.mesh_name != MESH:
        session.change(mesh=MESH)
    session.resume()
    session.set(rule="certified")
    session.set(radius=5e-3)
    session.reset()
    wait_until(lambda: np.allclose(tip(session), start(session), atol=1e-6), "the reset")


def tip(session: Session) -> np.ndarray:
    step = session.latest().step
    return np.full(3, np.nan) if step is None else np.array(step.tip.translation)


def start(session: Session) -> np.ndarray:
    return np.array(session.scene.T_base_start.translation)


def solid(session: Session) -> trimesh.Trimesh:
    return trimesh.Trimesh(
        session.scene.surface.vertices, session.scene.surface.faces, process=False
    )


def distance(mesh: trimesh.Trimesh, p: np.ndarray) -> float:
    """From p (3,) to the mesh, by trimesh, over all triangles [m]."""
    points = trimesh.triangles.closest_point(mesh.triangles, np.tile(p, (len(mesh.faces), 1)))
    return float(np.linalg.norm(points - p, axis=1).min())


def crossed(mesh: trimesh.Trimesh, path: np.ndarray) -> bool:
    """Whether the polyline path (k, 3) meets the mesh (signed volumes, every triangle)."""
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)

    def volume(p: np.ndarray, q: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.einsum("ij,ij->i", np.cross(u - q, v - q), p - q)

    for p, q in pairwise(path):
        if (p == q).all():
            continue
        sides = np.einsum("ij,ij->i", normal, p - a) * np.einsum("ij,ij->i", normal, q - a)
        near = sides <= 0
        P, Q = (np.tile(x, (int(near.sum()), 1)) for x in (p, q))
        A, B, C = a[near], b[near], c[near]
        turns = np.sign([volume(P, Q, A, B), volume(P, Q, B, C), volume(P, Q, C, A)])
        if (np.abs(turns.sum(axis=0)) == 3).any():
            return True
    return False


def drag_gizmo(visitor: Visitor, page: Page, axis: int, distance: float) -> None:
    """Grab one of the gizmo's arrows with the mouse, pull it along its axis [m], let go."""
    wxyz, origin = page.gizmo_pose
    w, x, y, z = wxyz
    direction = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
            [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
            [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
        ]
    )[axis]
    # The arrow's length is fixed in pixels; its head is at the end.
    head = origin + 0.88 * GIZMO_SIZE * visitor.pixel(origin) * direction
    mouse = visitor.tab.mouse
    mouse.move(*visitor.to_screen(head))
    visitor.tab.wait_for_timeout(200)  # the page looks for what is under the mouse once a frame
    mouse.down()
    for share in np.linspace(0.0, 1.0, 6)[1:]:  # each one waits for a frame of a slow renderer
        mouse.move(*visitor.to_screen(head + share * VIEW_SCALE * distance * direction))
    mouse.up()
    wait_until(lambda: not page.dragging, "the page to let go")


def rest(session: Session) -> None:
    """Wait until the tool does not move any more."""
    seen: list[np.ndarray] = []

    def still() -> bool:
        seen.append(tip(session))
        return len(seen) > 5 and bool(np.ptp(seen[-5:], axis=0).max() < 1e-6)

    wait_until(still, "the tool to rest")


def test_page_opens_with_scene_and_panel_and_a_quiet_console(visitor: Visitor) -> None:
    picture = visitor.picture("first-sight")
    assert drawn_share(picture) > 0.1
    assert picture.reshape(-1, 3).std(axis=0).min() > 10.0  # shaded shapes, not one flat colour
    for text in ("Fixture", "Scene", "Teleoperation", "View", "Read-outs", "Legend"):
        visitor.tab.get_by_text(text, exact=True).first.wait_for()
    wait_until(lambda: visitor.readout("rule") == "certified", "the rule")
    wait_until(lambda: float(visitor.readout("rate").replace(",", "")) > 0.0, "the rate")
    assert visitor.complaints == []


def test_dragging_the_gizmo_into_the_skull_stops_the_tool_at_the_bone(
    visitor: Visitor, session: Session, page: Page
) -> None:
    mesh = solid(session)
    before = tip(session)
    with Track(session) as track:
        drag_gizmo(visitor, page, axis=2, distance=0.022)  # the gizmo's z points out of the tool
        wait_until(
            lambda: np.linalg.norm(session.handle.translation - before) > 0.018, "the proxy to move"
        )
        rest(session)
    proxy, end = np.array(session.handle.translation), tip(session)
    visitor.picture("pressed-against-the-skull")
    assert crossed(mesh, np.array([before, proxy])), "the drag must lead into the bone"
    assert np.linalg.norm(end - before) > 0.01, "the tool must have followed"
    assert 5e-6 < distance(mesh, end) < 2e-4
    assert np.linalg.norm(proxy - end) > 1e-3
    assert not crossed(mesh, np.array(track.tips[:: max(1, len(track.tips) // 200)]))
    wait_until(lambda: float(visitor.readout("simulated force")) > 0.1, "the force")
    wait_until(lambda: int(visitor.readout("active planes")) > 0, "the planes")
    visitor.tab.get_by_text("The fixture holds the blade back").wait_for()


def test_recall_puts_the_proxy_back_onto_the_tool(
    visitor: Visitor, session: Session, page: Page
) -> None:
    drag_gizmo(visitor, page, axis=2, distance=0.022)
    wait_until(lambda: np.linalg.norm(session.handle.translation - tip(session)) > 2e-3, "a pull")
    visitor.press("Recall to tool")
    wait_until(
        lambda: np.linalg.norm(session.handle.translation - tip(session)) < 1e-4, "the recall"
    )
    wait_until(
        lambda: np.allclose(page.gizmo_pose[1], VIEW_SCALE * session.handle.translation, atol=1e-3),
        "the gizmo to go there",
    )


def test_choosing_a_rule_changes_the_planes(visitor: Visitor, session: Session, page: Page) -> None:
    session.set(radius=2e-3)  # rule "all" in a larger sphere overwhelms a software renderer
    drag_gizmo(visitor, page, axis=2, distance=0.02)
    rest(session)
    wait_until(lambda: len(session.latest().step.planes) > 0, "contact")
    counts = {}
    for rule in ("certified", "all", "paper"):
        visitor.choose("Rule", rule)
        wait_until(lambda rule=rule: session.options.rule == rule, f"rule {rule}")
        wait_until(lambda rule=rule: visitor.readout("rule") == rule, f"read-out {rule}")
        counts[rule] = len(session.latest().step.planes)
        visitor.picture(f"rule-{rule}")
    # Every face in the sphere makes a plane in "all"; both other rules choose.
    assert counts["all"] > counts["certified"] > 0
    assert counts["all"] >= counts["paper"] > 0


def test_choosing_a_mesh_swaps_the_scene_while_the_loop_runs(
    visitor: Visitor, session: Session
) -> None:
    ticks = session.latest().tick
    visitor.choose("Mesh", "gear")
    wait_until(lambda: session.scene.mesh_name == "gear", "the gear", 60.0)
    wait_until(lambda: session.latest().tick > ticks + 100, "ticks")
    wait_until(lambda: drawn_share(visitor.picture("gear")) > 0.05, "the gear's picture")
    mesh = solid(session)
    assert len(mesh.faces) == len(session.scene.surface.faces)
    assert mesh.is_watertight


def test_pause_stops_the_ticks_and_step_does_one(visitor: Visitor, session: Session) -> None:
    visitor.press("Pause")
    wait_until(lambda: session.latest().paused, "the pause")
    tick = session.latest().tick
    visitor.press("1")
    wait_until(lambda: session.latest().tick == tick + 1, "one tick")
    visitor.tab.get_by_text("Paused.").wait_for()
    visitor.press("Run")
    wait_until(lambda: session.latest().tick > tick + 10, "ticks")


@pytest.mark.slow
def test_autopilot_runs_until_somebody_takes_the_gizmo(
    visitor: Visitor, session: Session, page: Page
) -> None:
    visitor.tab.get_by_label("Autopilot").click()
    wait_until(lambda: session.latest().autopilot, "the autopilot")
    wait_until(lambda: np.linalg.norm(tip(session) - start(session)) > 5e-3, "motion")
    visitor.picture("autopilot")
    session.pause()  # the gizmo must hold still to be grabbed
    visitor.tab.get_by_text("Paused.").wait_for()
    drag_gizmo(visitor, page, axis=0, distance=0.005)
    session.resume()
    wait_until(lambda: not session.latest().autopilot, "the hand to take over")
    wait_until(lambda: not visitor.tab.get_by_label("Autopilot").is_checked(), "the box")


def test_typed_values_out_of_range_are_put_right(visitor: Visitor, session: Session) -> None:
    box = visitor.tab.get_by_label("Radius [mm]", exact=True)
    box.fill("900")
    box.press("Enter")
    wait_until(lambda: abs(session.options.radius - 0.02) < 1e-9, "the clamped radius")
    wait_until(lambda: box.input_value() == "20", "the box to show it")
    visitor.tab.get_by_text("20, as 900 is outside 0.05 to 20").wait_for(timeout=30_000)


@pytest.mark.slow
def test_a_second_client_sees_the_same(
    visit: Callable[[], Visitor], visitor: Visitor, session: Session, page: Page
) -> None:
    session.set(rule="paper")
    session.set(radius=2e-3)
    drag_gizmo(visitor, page, axis=2, distance=0.02)
    rest(session)
    second = visit()
    try:
        wait_until(lambda: second.readout("rule") == "paper", "the second page's read-outs")
        a, b = visitor.picture("first-client"), second.picture("second-client")
        for name in ("active planes", "distance to surface"):
            wait_until(lambda name=name: visitor.readout(name) == second.readout(name), name)
        height = min(a.shape[0], b.shape[0])
        assert np.abs(a[:height].astype(int) - b[:height].astype(int)).mean() < 8.0
        before = session.handle.translation.copy()
        drag_gizmo(second, page, axis=0, distance=0.006)
        wait_until(
            lambda: np.linalg.norm(session.handle.translation - before) > 4e-3, "the second hand"
        )
        assert second.complaints == []
    finally:
        second.tab.close()
    wait_until(lambda: len(page.server.get_clients()) == 1, "the second client to leave")


@pytest.mark.slow
def test_the_page_survives_a_reload(visitor: Visitor, session: Session, page: Page) -> None:
    session.set(rule="paper")
    drag_gizmo(visitor, page, axis=0, distance=0.01)
    wait_until(lambda: session.latest().target is not None, "a proxy")
    pose = page.gizmo_pose[1]
    known = set(page.server.get_clients())
    visitor.tab.reload()
    settle(visitor, known)
    wait_until(lambda: visitor.readout("rule") == "paper", "the read-outs")
    assert np.allclose(page.gizmo_pose[1], pose)
    assert drawn_share(visitor.picture("reloaded")) > 0.1
    drag_gizmo(visitor, page, axis=0, distance=-0.01)  # the gizmo is where the page shows it
    wait_until(lambda: np.abs(page.gizmo_pose[1] - pose).max() > 0.5, "the gizmo to move")
    assert visitor.complaints == []


@pytest.mark.slow
def test_old_numbers_say_that_they_are_old(
    visitor: Visitor, page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    opacity = "document.querySelector('.vf-old') ? getComputedStyle("
    opacity += "document.querySelector('.vf-old')).opacity : '-'"
    wait_until(lambda: visitor.tab.evaluate(opacity) == "0", "numbers of now")
    monkeypatch.setattr(page, "_read_out", lambda: None)  # a view thread that hangs
    wait_until(lambda: visitor.tab.evaluate(opacity) == "1", "the note")
    visitor.picture("old-numbers")
    monkeypatch.undo()
    wait_until(lambda: visitor.tab.evaluate(opacity) == "0", "the note to go")
