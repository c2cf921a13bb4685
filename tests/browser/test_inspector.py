"""What a user does with the inspector, in a real browser."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import vf
from app.session import Session
from app.view import Page, camera
from app.view.units import VIEW_SCALE
from tests.support.watching import Visitor, wait_until

pytestmark = pytest.mark.slow

MESH = "skull-coarse"
PUSH = np.array([0.012, 0.022, -0.0265])  # from the start into the bone [m]


@pytest.fixture(scope="module")
def tab(visit: Callable[[], Visitor], session: Session, page: Page) -> Iterator[Visitor]:
    """A tab of its own with the inspector switched on, the tool pressed against the skull."""
    if session.scene.mesh_name != MESH:
        session.change(mesh=MESH)
    session.resume()
    session.set(rule="certified")
    session.set(radius=5e-3)
    session.reset()
    visitor = visit()
    start = session.scene.T_base_start
    session.drive(pin.SE3(start.rotation, start.translation + PUSH))
    visitor.tab.locator(".mantine-Notification-closeButton").first.click(timeout=60_000)
    wait_until(lambda: session.latest().step.multipliers.max(initial=0.0) > 1e-6, "contact")
    visitor.tab.get_by_text("Inspector", exact=True).click()
    visitor.tab.get_by_label("Inspect", exact=True).click()
    camera.move(visitor.client, camera.tool_view(session.latest().step))
    wait_until(lambda: chosen(visitor) >= 0, "a report")
    yield visitor
    visitor.tab.get_by_label("Inspect", exact=True).click()
    wait_until(lambda: not node(page, "/inspector/near/grid").visible, "the inspector to be off")
    clients = set(page.server.get_clients())
    visitor.tab.close()
    wait_until(lambda: set(page.server.get_clients()) < clients, "the tab to leave")
    session.resume()
    session.reset()


def node(page: Page, name: str) -> object:
    return page.server.scene._handle_from_node_name[name]


def chosen(visitor: Visitor) -> int:
    """The triangle whose report the page shows, −1: none."""
    badge = visitor.tab.locator(".vf-triangle")
    return int(badge.first.get_attribute("data-triangle")) if badge.count() else -1


def text(visitor: Visitor, of: str) -> str:
    found = visitor.tab.locator(of)
    return found.first.inner_text() if found.count() else ""


def tip(session: Session) -> np.ndarray:
    return np.array(session.latest().step.tip.translation)


def test_the_report_names_the_triangle_that_blocks(tab: Visitor, session: Session) -> None:
    step = session.latest().step
    blocking = step.planes.triangles[np.argmax(step.multipliers)]
    wait_until(lambda: chosen(tab) == blocking, "the blocking triangle")
    assert "It blocks the way" in text(tab, ".vf-push")
    tab.picture("inspector-blocking")


def test_clicks_a_triangle_and_reads_its_report(tab: Visitor, session: Session, page: Page) -> None:
    surface = session.scene.surface
    mesh = trimesh.Trimesh(1e3 * surface.vertices, surface.faces, process=False)
    centres = surface.vertices[surface.faces].mean(axis=1)
    box = tab.canvas_box()
    camera_at = np.asarray(tab.client.camera.position) / VIEW_SCALE
    # A large triangle in sight, clear of the tool, its gizmo and the panels.
    away = np.linalg.norm(centres - tip(session), axis=1)
    for face in np.argsort(-mesh.area_faces * ((away > 4e-3) & (away < 12e-3)))[:300]:
        u, v = tab.to_screen(VIEW_SCALE * centres[face])
        if not (300 < u < 900 and 200 < v < box["y"] + box["height"] - 60):
            continue
        ray = centres[face] - camera_at
        hit = mesh.ray.intersects_first([1e3 * camera_at], [ray])[0]
        gizmo = tab.to_screen(VIEW_SCALE * session.handle.translation)
        if hit == face and np.hypot(*(gizmo - (u, v))) > 110:
            break
    else:
        pytest.fail("no triangle to click in this view")
    tab.tab.mouse.click(u, v)
    wait_until(lambda: chosen(tab) == face, f"the report on triangle {face}")
    assert "closest point" in text(tab, ".vf-reason") or "Not examined" in text(tab, ".vf-reason")
    tab.picture("inspector-clicked")


def test_steps_through_the_list(tab: Visitor, session: Session) -> None:
    tab.press("Main")
    step = session.latest().step
    contacts = session.scene.surface.within(tip(session), step.radius)
    order = contacts.triangles[np.argsort(contacts.distances)]
    wait_until(lambda: chosen(tab) in step.planes.triangles, "the main triangle")
    at = order.tolist().index(chosen(tab))
    for button, expected in (("▶", order[at + 1]), ("▶", order[at + 2]), ("◀", order[at + 1])):
        tab.press(button)
        wait_until(lambda expected=expected: chosen(tab) == expected, f"triangle {expected}")
    tab.press("Main")


def test_shows_the_allowed_region(tab: Visitor, session: Session, page: Page) -> None:
    tab.tab.get_by_label("Allowed region", exact=True).click()
    wait_until(lambda: node(page, "/inspector/region").visible, "the solid")
    tab.tab.get_by_text("of the sphere (drawn as a polyhedron inside it)").wait_for()
    corners = np.asarray(node(page, "/inspector/region").vertices) / VIEW_SCALE
    planes = session.latest().step.planes.of_tip()
    assert len(planes)
    assert (corners @ planes.normals.T >= planes.offsets - 1e-6).all()
    tab.picture("inspector-region")
    tab.tab.get_by_label("Allowed region", exact=True).click()
    wait_until(lambda: not node(page, "/inspector/region").visible, "the solid to go")


def test_compares_rules(tab: Visitor, session: Session) -> None:
    tab.tab.get_by_label("Compare rules", exact=True).click()
    table = tab.tab.locator(".vf-rules table").first
    table.wait_for()
    heads, *lines = [
        [cell.strip() for cell in line.split("\t")]
        for line in table.inner_text().splitlines()
        if line.strip()
    ]
    assert heads[1:4] == ["planes", "leak", "blocked"]
    found = {line[0]: dict(zip(heads, line, strict=True)) for line in lines}
    assert list(found) == list(vf.RULES)
    in_sphere = len(session.scene.surface.within(tip(session), 5e-3))
    assert int(found["all"]["planes"].replace(",", "")) == in_sphere
    assert found["off"]["planes"] == "0"
    assert found["certified"]["leak"] == "0%"
    assert found["off"]["leak"] == "100%"
    tab.tab.get_by_label("Compare rules", exact=True).click()
    table.wait_for(state="detached")


def test_freezes_and_moves_the_probe(tab: Visitor, session: Session, page: Page) -> None:
    tab.tab.get_by_label("Freeze and explore", exact=True).click()
    wait_until(lambda: session.latest().paused, "the pause")
    wait_until(lambda: node(page, "/probe/ball").visible, "the probe")
    before, tick = tip(session), session.latest().tick
    probe = node(page, "/probe/gizmo")
    origin = np.array(probe.position)
    box = tab.canvas_box()
    middle = np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])
    wait_until(lambda: np.linalg.norm(tab.to_screen(origin) - middle) < 5, "the camera")
    tab.tab.wait_for_timeout(1000)
    # Its arrow upwards: length fixed in pixels, the head at the end.
    up = np.array([0.0, 0.0, 1.0])
    head = origin + 0.88 * 60.0 * tab.pixel(origin) * up
    mouse = tab.tab.mouse
    mouse.move(*tab.to_screen(head))
    tab.tab.wait_for_timeout(300)
    mouse.down()
    for share in np.linspace(0.0, 1.0, 5)[1:]:
        mouse.move(*tab.to_screen(head + share * 0.2 * up))
    mouse.up()
    wait_until(lambda: probe.position[2] > origin[2] + 0.1, "the probe to follow the mouse")
    surface = session.scene.surface
    mesh = trimesh.Trimesh(1e3 * surface.vertices, surface.faces, process=False)
    tab.press("Main")

    def reported() -> bool:
        here = 1e3 * np.array(probe.position) / VIEW_SCALE
        points = trimesh.triangles.closest_point(
            mesh.triangles, np.tile(here, (len(mesh.faces), 1))
        )
        nearest = np.linalg.norm(points - here, axis=1).min()
        return f"{nearest:.3f} mm" in tab.tab.locator("body").inner_text()

    wait_until(reported, "the report of the probe's new place")
    assert session.latest().tick == tick
    assert (tip(session) == before).all()
    tab.picture("inspector-probe")


def test_puts_the_probe_into_figure_5_b(tab: Visitor, session: Session, page: Page) -> None:
    tab.choose("Explore", "Fig. 5 (b)")
    tab.tab.locator(".vf-expect", has_text="Fig. 5 (b)").wait_for()
    rows = tab.tab.locator("tr")
    wait_until(lambda: rows.filter(has_text="T1").filter(has_text="Condition 3").count(), "T1")
    wait_until(lambda: rows.filter(has_text="T2").filter(has_text="Condition 1").count(), "T2")
    assert session.latest().paused
    tab.picture("inspector-figure-5b")
    tab.tab.get_by_label("Freeze and explore", exact=True).click()
    wait_until(lambda: not session.latest().paused, "the loop to go on")
    wait_until(lambda: not node(page, "/probe/ball").visible, "the probe to go")
    assert tab.complaints == []
