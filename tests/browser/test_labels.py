"""No labels of the scene overlap or are cut off: in every view and state, from any side."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from app.scenarios.presets import PRESETS
from app.scenarios.staging import stage
from app.session import Session
from app.view import Page, camera
from app.view.controls.views import KEYS
from app.view.drawing import labels
from app.view.tabs import recorder
from app.view.units import VIEW_SCALE
from tests.support.drawn_labels import Drawn, drawn_labels, overlapping
from tests.support.watching import Visitor, wait_until

pytestmark = pytest.mark.slow

MESH = "skull-coarse"
PUSH = np.array([0.012, 0.022, -0.0265])  # from the start into the bone [m]
SIDES = 6  # from which a camera looks that somebody turned and zoomed, for each state


@pytest.fixture(scope="module")
def page(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    place = tmp_path_factory.mktemp("recordings")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorder, "folder", lambda: place)
        page = Page(session, "127.0.0.1", 0)
        yield page
        page.close()


@pytest.fixture(autouse=True)
def _fresh(session: Session, visitor: Visitor) -> None:
    """At rest at the start with the default settings."""
    if session.scene.mesh_name != MESH or session.options.damage != "none":
        session.change(mesh=MESH, damage="none")
    session.resume()
    session.set(rule="certified", radius=5e-3, scale=1.0, corridor=None)
    session.reset()
    wait_until(lambda: session.latest().target is None, "the reset")
    camera.set_lens(visitor.client, camera.FIELD_OF_VIEW)


def name(node: str) -> str:
    """What a label is called in the tab's scene."""
    return f"/labels/{node[1:].replace('/', ' ')}"


def press(session: Session, scale: float = 1.0) -> None:
    """Lead the handle into the bone: the tool stays at it."""
    session.set(scale=scale)
    start = session.scene.T_base_start
    for share in np.linspace(0.0, 1.0, 20):
        session.drive(pin.SE3(start.rotation, start.translation + share * PUSH / scale))
        tick = session.latest().tick
        wait_until(lambda tick=tick: session.latest().tick > tick + 20, "ticks")
    wait_until(lambda: session.latest().step.multipliers.max(initial=0.0) > 1e-6, "contact")


def check(visitor: Visitor) -> list[Drawn]:
    """Wait until the tab shows what its camera is told to see.

    Then no two labels may overlap and none may be cut off by the picture's edge.
    """
    eye = visitor.client.camera

    def there() -> bool:
        _, place = drawn_labels(visitor)
        return bool(
            np.linalg.norm(place - eye.position) < 1e-3 * np.linalg.norm(eye.position - eye.look_at)
        )

    wait_until(there, "the tab to look from there")

    def placed() -> bool:
        found, _ = drawn_labels(visitor)
        return not overlapping(found) and all(label.whole for label in found)

    wait_until(placed, "labels apart and in the picture", 20.0)
    visitor.tab.wait_for_timeout(250)
    found, _ = drawn_labels(visitor)
    assert overlapping(found) == []
    assert [label.name for label in found if not label.whole] == []
    return found


def look_around(visitor: Visitor, session: Session, seed: int) -> dict[str, int]:
    """Look at the scene in every way; from how many of these each label is seen.

    The views that the page offers, then cameras that somebody turned, moved and zoomed.
    """
    step, scene = session.latest().step, session.scene
    p_tip = np.array(step.tip.translation)
    views = [camera.named_view(view, scene, step) for view in KEYS]
    rng = np.random.default_rng(seed)
    for _ in range(SIDES):
        direction = rng.normal(size=3)
        direction[2] = abs(direction[2])
        distance = 10.0 ** rng.uniform(-2.0, 0.0)  # 1 cm to 1 m
        look_at = p_tip + rng.normal(size=3) * 0.1 * distance
        away = distance * direction / np.linalg.norm(direction)
        views.append(camera.View(look_at + away, look_at))
    seen: dict[str, int] = {}
    for view in views:
        camera.move(visitor.client, view)
        for label in check(visitor):
            seen[label.name] = seen.get(label.name, 0) + 1
    return seen


def test_labels_on_each_other_are_noticed(visitor: Visitor, page: Page) -> None:
    """By what the other tests look with."""
    point = VIEW_SCALE * page.shown.telemetry.step.tip.translation + 0.2
    made = [
        visitor.client.scene.add_label(f"/labels/{word}", word, position=point + shift)
        for word, shift in (("here", np.zeros(3)), ("there", np.full(3, 0.01)))
    ]
    pair = "/labels/here", "/labels/there"
    wait_until(lambda: pair in overlapping(drawn_labels(visitor)[0]), "them to be noticed")
    box = next(label for label in drawn_labels(visitor)[0] if label.name == "/labels/here")
    corner = visitor.to_screen(point) - (visitor.canvas_box()["x"], visitor.canvas_box()["y"])
    assert (box.left, box.top) == pytest.approx(tuple(corner), abs=0.5)
    for label in made:
        label.remove()
    wait_until(lambda: not overlapping(drawn_labels(visitor)[0]), "them to be gone")


def test_before_anything_is_done(visitor: Visitor, session: Session) -> None:
    seen = look_around(visitor, session, seed=1)
    assert min(seen[name(f"/ruler/{which}/label")] for which in ("site", "anatomy")) > 3
    assert seen[name("/proxy/gizmo_name")] >= len(KEYS), "before all that is seen there"
    assert seen[name("/corridor/name")] > 3


def test_with_the_tool_against_the_bone(visitor: Visitor, session: Session) -> None:
    press(session)
    seen = look_around(visitor, session, seed=2)
    for label in ("/fixture/blocks", "/proxy/gizmo_name", "/tool/force_label"):
        assert seen[name(label)] > 3, label
    visitor.picture("labels-pressed")


def test_with_a_handle_apart_from_the_proxy_through_the_other_lens_and_in_a_corridor(
    visitor: Visitor, session: Session
) -> None:
    camera.set_lens(visitor.client, camera.PARALLEL)
    session.set(corridor=5e-3)
    press(session, scale=0.5)
    visitor.tab.keyboard.press("x")  # a section
    seen = look_around(visitor, session, seed=3)
    for label in ("/fixture/blocks", "/proxy/gizmo_name", "/proxy/ball_name", "/tool/force_label"):
        assert seen[name(label)] > 3, label
    visitor.picture("labels-parallel")
    visitor.tab.keyboard.press("x")


def test_with_a_crossing_and_a_report_and_a_probe_and_a_case(
    visitor: Visitor, session: Session, page: Page
) -> None:
    stage(PRESETS["unclean-mesh-paper"], session, lambda _text: None)
    wait_until(lambda: session.crossing is not None, "the tool to cross")
    session.pause()
    visitor.tab.get_by_role("tab", name="Inspector", exact=True).click()
    visitor.tab.get_by_label("Inspect", exact=True).click()
    wait_until(lambda: page._labels["/inspector/chosen/name"].visible, "a report")
    seen = look_around(visitor, session, seed=4)
    assert seen[name("/crossing/label")] >= len(KEYS), "before all others"
    for label in ("/inspector/chosen/name", "/proxy/gizmo_name"):
        assert seen[name(label)] > 2, label
    visitor.picture("labels-crossed")

    eye = visitor.client.camera

    def moved_by(act: Callable[[], object]) -> None:
        """Wait for the page to move the camera, which it does last of all."""
        before = np.array(eye.look_at)
        act()
        wait_until(lambda: np.abs(eye.look_at - before).max() > 1e-3, "the page's view")

    moved_by(visitor.tab.get_by_label("Freeze and explore", exact=True).click)
    wait_until(lambda: page._labels["/probe/name"].visible, "the probe")
    seen = look_around(visitor, session, seed=5)
    assert seen[name("/probe/name")] > 3
    for case in ("Fig. 4 (c)", "Fig. 5 (b)"):
        camera.move(visitor.client, camera.anatomy_view(session.scene))
        moved_by(partial(visitor.choose, "Explore", case))
        wait_until(lambda: page._labels["/probe/T2"].visible, "the case")
        names = {label.name for label in check(visitor)}
        assert {name("/probe/T1"), name("/probe/T2"), name("/probe/name")} <= names
        visitor.picture("labels-case")
    visitor.tab.get_by_label("Freeze and explore", exact=True).click()
    visitor.tab.get_by_label("Inspect", exact=True).click()
    wait_until(lambda: not page._labels["/inspector/chosen/name"].visible, "it to be off")
    visitor.tab.get_by_role("tab", name="Read-outs", exact=True).click()


def test_in_a_replay(visitor: Visitor, session: Session, page: Page) -> None:
    session.record(recorder.folder() / "run.vfrec")
    press(session)
    session.stop_recording()
    session.reset()
    visitor.tab.get_by_role("tab", name="Record", exact=True).click()
    wait_until(visitor.tab.get_by_role("button", name="Replay", exact=True).is_enabled, "the list")
    visitor.press("Replay")
    visitor.tab.get_by_text("Replay: tick").first.wait_for(timeout=30_000)
    slider = visitor.tab.get_by_role("slider").first
    slider.focus()
    slider.press("End")
    wait_until(lambda: page._labels["/fixture/blocks"].visible, "the last tick")
    seen = look_around(visitor, session, seed=6)
    for label in ("/fixture/blocks", "/proxy/ball_name", "/tool/force_label"):
        assert seen[name(label)] > 3, label
    visitor.press("Back to the session")
    visitor.tab.get_by_role("tab", name="Read-outs", exact=True).click()


def test_while_the_mouse_turns_and_zooms(visitor: Visitor, session: Session) -> None:
    press(session)
    camera.move(visitor.client, camera.tool_view(session.latest().step))
    check(visitor)
    box, mouse = visitor.canvas_box(), visitor.tab.mouse
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.8 * box["height"]
    for turn, zoom in ((90, 0), (-160, 400), (50, 1500), (-30, -2500)):
        before = np.array(visitor.client.camera.position)
        mouse.move(x, y)
        mouse.down(button="left")
        mouse.move(x + turn, y - 0.3 * turn, steps=5)
        mouse.up(button="left")
        mouse.wheel(0, zoom)
        wait_until(
            lambda before=before: np.linalg.norm(visitor.client.camera.position - before) > 0.01,
            "the view to turn",
        )
        visitor.tab.wait_for_timeout(500)  # it glides to its end
        check(visitor)


def test_each_of_two_who_look_from_elsewhere_sees_its_own(
    visitor: Visitor, browser: Any, page: Page, session: Session
) -> None:
    """The second on a phone, from so far away that all labels are at one point."""
    press(session)
    camera.move(visitor.client, camera.tool_view(session.latest().step))
    known = set(page.server.get_clients())
    tab = browser.new_page(viewport={"width": 390, "height": 844}, device_scale_factor=0.3)
    tab.set_default_timeout(120_000)
    phone = Visitor(tab, -1, page)
    try:
        tab.goto(page.url)
        tab.get_by_text("Read-outs · Legend").wait_for()
        wait_until(lambda: set(page.server.get_clients()) - known, "the phone", 120.0)
        phone.client_id = max(set(page.server.get_clients()) - known)
        look_around(phone, session, seed=7)
        p_tip = np.array(session.latest().step.tip.translation)
        camera.move(phone.client, camera.View(p_tip + np.array([20.0, 20.0, 20.0]), p_tip))
        there = {label.name for label in check(phone)}
        here = {label.name for label in check(visitor)}
        assert name("/fixture/blocks") in there & here, "the most important of them"
        assert name("/proxy/gizmo_name") in here - there
        assert phone.complaints == []
    finally:
        tab.close()
    wait_until(lambda: set(page.server.get_clients()) == known, "the phone to leave")


def test_no_label_is_larger_than_it_is_taken_for(
    visitor: Visitor, page: Page, session: Session
) -> None:
    """By what places them. If it is, the browser writes in a font that is wider than expected."""
    press(session)
    camera.move(visitor.client, camera.named_view("Site", session.scene, session.latest().step))
    found = check(visitor)
    assert len(found) >= 4
    known = {name(node): page._labels[node] for node in labels.IMPORTANCE}
    for label in found:
        width, height = labels.size(known[label.name].text, known[label.name].scale)
        assert 0.6 * width < label.right - label.left < width, known[label.name].text
        assert 0.7 * height < label.bottom - label.top < height


def test_the_scene_as_a_file_opens_with_its_labels_apart(
    visitor: Visitor, page: Page, browser: Any, session: Session, tmp_path: Path
) -> None:
    press(session)
    wait_until(lambda: page._labels["/fixture/blocks"].visible, "the page to show it")
    with page._labels.in_scene():
        content = page.server.get_scene_serializer().as_html()
    nodes = page.server.scene._handle_from_node_name
    assert not any(node.startswith("/labels/") for node in nodes), "only in the file"
    (tmp_path / "scene.html").write_text(content, encoding="utf-8")
    context = browser.new_context(viewport={"width": 1280, "height": 720}, offline=True)
    try:
        tab = context.new_page()
        tab.set_default_timeout(120_000)
        tab.goto((tmp_path / "scene.html").as_uri())
        tab.wait_for_function("() => window.__viserMutable?.nodeRefFromName['/labels']")
        there = Visitor(tab, -1, page)
        wait_until(lambda: len(drawn_labels(there)[0]) >= 3, "the labels")
        tab.wait_for_timeout(1000)
        found, _ = drawn_labels(there)
        assert overlapping(found) == []
        names = {label.name for label in found}
        assert {name("/fixture/blocks"), name("/ruler/site/label")} <= names
    finally:
        context.close()
    assert check(visitor)
    assert visitor.complaints == []
