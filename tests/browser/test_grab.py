"""Dragging the tool itself, in a real browser with a real mouse."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from app.session import Session
from app.view import Page
from app.view.units import to_view
from tests.support.watching import Visitor, drawn_share, wait_until

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _fresh(session: Session, visitor: Visitor) -> Iterator[None]:
    def reset() -> None:
        session.reset()
        wait_until(lambda: session.latest().target is None, "the reset")

    reset()
    visitor.press("Site")
    visitor.tab.wait_for_timeout(1000)
    yield
    reset()


def tip(session: Session) -> np.ndarray:
    return np.array(session.latest().step.tip.translation)


def grip(visitor: Visitor, session: Session) -> np.ndarray:
    """Where the wrist of the tool is in the window (2,) [px], beside the gizmo."""
    arm = session.scene.arm
    wrist = [capsule.name for capsule in arm.capsules].index("wrist")
    return visitor.to_screen(to_view(arm.axes(session.latest().q)[wrist].mean(axis=0)))


@contextmanager
def dragged(
    visitor: Visitor, at: np.ndarray, by: tuple[float, float], *keys: str
) -> Iterator[None]:
    """Press on a place, move the pointer, and let go when the test has seen enough."""
    mouse, keyboard = visitor.tab.mouse, visitor.tab.keyboard
    mouse.move(*at)
    for key in keys:
        keyboard.down(key)
    mouse.down()
    for share in np.linspace(0.1, 1.0, 10):
        mouse.move(*(at + share * np.array(by)))
        visitor.tab.wait_for_timeout(40)
    yield
    mouse.up()
    for key in keys:
        keyboard.up(key)


def camera_axes(visitor: Visitor) -> np.ndarray:
    """Right, down and away, as columns (3, 3), without the code that is tested."""
    from scipy.spatial.transform import Rotation

    w, x, y, z = visitor.client.camera.wxyz
    return Rotation.from_quat([x, y, z, w]).as_matrix()


def test_follows_the_pointer_in_the_plane_towards_the_bone(
    visitor: Visitor, session: Session
) -> None:
    eye = np.array(visitor.client.camera.position)
    before, seen = tip(session), visitor.to_screen(to_view(tip(session)))
    where = lambda: visitor.to_screen(to_view(tip(session))) - seen  # noqa: E731
    with dragged(visitor, grip(visitor, session), (90.0, -40.0)):
        # The browser takes some pixels to tell a drag from a click. The tool is as large as the
        # place where it is held, which is nearer.
        wait_until(lambda: np.abs(where() - [90.0, -40.0]).max() < 12.0, "the tool at the pointer")
        down = session.scene.surface.vertices - before
        down = down[np.linalg.norm(down, axis=1).argmin()]
        down = down / np.linalg.norm(down)
        view = before - eye / 100.0
        across = np.cross(view, down)  # lies in the plane, as `down` does
        out_of_it = np.cross(across, down) / np.linalg.norm(across)
        assert abs(out_of_it @ (tip(session) - before)) < 5e-4
        visitor.tab.get_by_text("You hold the tool:").wait_for()
        visitor.picture("grab")
    np.testing.assert_allclose(visitor.client.camera.position, eye)
    wait_until(lambda: not visitor.page.dragging, "the release")


def test_the_mouse_alone_touches_the_bone_slides_along_it_and_lifts_off(
    visitor: Visitor, session: Session
) -> None:
    surface, mouse = session.scene.surface, visitor.tab.mouse
    gap = lambda: surface.nearest(tip(session))[0]  # noqa: E731
    at, eye = grip(visitor, session), np.array(visitor.client.camera.position)
    with dragged(visitor, at, (0.0, 260.0)):
        wait_until(lambda: gap() < 1e-4, "the touch", 20.0)
        touched = tip(session)
        for share in np.linspace(0.1, 1.0, 10):
            mouse.move(at[0] + 100.0 * share, at[1] + 260.0)
            visitor.tab.wait_for_timeout(40)
        wait_until(lambda: np.linalg.norm(tip(session) - touched) > 3e-3, "the slide", 20.0)
        assert gap() < 2e-4
        # The wheel moves it away from the viewer, and the camera stays.
        axes, slid = camera_axes(visitor), session.handle.translation.copy()
        mouse.wheel(0.0, -400.0)
        wait_until(
            lambda: axes[:, 2] @ (session.handle.translation - slid) > 1.5e-3, "the depth", 20.0
        )
        np.testing.assert_allclose(visitor.client.camera.position, eye)
        for share in np.linspace(0.1, 1.0, 10):
            mouse.move(at[0] + 100.0, at[1] + 260.0 - 300.0 * share)
            visitor.tab.wait_for_timeout(40)
        wait_until(lambda: gap() > 5e-3, "the lift", 20.0)
    wait_until(lambda: not visitor.page.dragging, "the release")
    assert session.crossing is None


def test_moves_it_in_depth_and_turns_it(visitor: Visitor, session: Session) -> None:
    before = tip(session)
    axes = camera_axes(visitor)
    with dragged(visitor, grip(visitor, session), (0.0, 60.0), "Shift"):
        wait_until(lambda: axes[:, 2] @ (tip(session) - before) < -2e-3, "the tool to come nearer")
        assert abs(axes[:, 0] @ (tip(session) - before)) < 2e-4
    session.reset()
    wait_until(lambda: np.linalg.norm(tip(session) - before) < 1e-4, "the reset")
    turn = session.handle.rotation.copy()
    with dragged(visitor, grip(visitor, session), (0.0, 40.0), "Control"):
        wait_until(lambda: np.abs(session.handle.rotation - turn).max() > 0.1, "the turn")
        np.testing.assert_allclose(session.handle.translation, before, atol=2e-4)
        # The near side goes down: a positive turn about what is to the right.
        change = session.handle.rotation @ turn.T
        assert axes[:, 2] @ change @ -axes[:, 2] > -1.0
        assert axes[:, 1] @ change @ -axes[:, 2] > 0.05


def test_slides_it_along_the_surface_below_the_pointer(visitor: Visitor, session: Session) -> None:
    # From high on the tool down to the bone.
    at = grip(visitor, session)
    bone = visitor.to_screen(to_view(tip(session))) + np.array([40.0, 150.0])
    with dragged(visitor, at, tuple(bone - at), "Control", "Shift"):
        surface = session.scene.surface
        wait_until(lambda: surface.nearest(session.handle.translation)[0] < 6e-4, "the surface")
        wait_until(lambda: surface.nearest(tip(session))[0] < 1e-4, "the tool on it", 20.0)
        there = visitor.to_screen(to_view(session.handle.translation))
        assert np.abs(there - bone).max() < 3.0
        assert not surface.inside(tip(session))
        visitor.picture("grab-surface")


def test_begins_at_the_tool_that_was_left_pressed(visitor: Visitor, session: Session) -> None:
    start = session.scene.T_base_start
    pressed = start.copy()
    pressed.translation = start.translation - np.array([0.0, 0.0, 0.022])
    session.drive(pressed)
    wait_until(lambda: session.latest().step.force[2] > 0.5, "the contact")
    wait_until(lambda: session.scene.surface.nearest(tip(session))[0] < 1e-4, "rest")
    before = tip(session)
    with dragged(visitor, grip(visitor, session), (0.0, -80.0)):
        wait_until(lambda: tip(session)[2] > before[2] + 2e-3, "the tool to lift off", 20.0)


def test_the_gizmo_moves_with_it_and_still_works(visitor: Visitor, session: Session) -> None:
    with dragged(visitor, grip(visitor, session), (60.0, -30.0)):
        wait_until(lambda: visitor.page.dragging, "the drag")
        shown = lambda: visitor.page.gizmo_pose[1]  # noqa: E731
        wait_until(
            lambda: np.abs(shown() - to_view(session.handle.translation)).max() < 1e-3, "the gizmo"
        )
    wait_until(lambda: not visitor.page.dragging, "the release")


def test_a_finger_moves_the_tool_on_a_phone(browser: Any, page: Page, session: Session) -> None:
    known = set(page.server.get_clients())
    context = browser.new_context(
        viewport={"width": 390, "height": 844}, device_scale_factor=0.3, has_touch=True,
        is_mobile=True,
    )  # fmt: skip
    tab = context.new_page()
    tab.set_default_timeout(120_000)  # with another tab drawing in software beside it
    try:
        tab.goto(page.url)
        wait_until(lambda: set(page.server.get_clients()) - known, "the phone", 120.0)
        phone = Visitor(tab, max(set(page.server.get_clients()) - known), page)
        wait_until(lambda: drawn_share(phone.picture("phone-grab")[:480]) > 0.1, "the picture")
        # viser's word about drawing in software hides the tool.
        tab.locator(".mantine-Notification-closeButton").first.click()
        tab.locator(".mantine-Notification-closeButton").first.wait_for(state="hidden")
        before, at = tip(session), grip(phone, session)
        touch = tab.context.new_cdp_session(tab)

        def finger(kind: str, *where: np.ndarray) -> None:
            points = [{"x": float(p[0]), "y": float(p[1])} for p in where]
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        finger("touchStart", at)
        for k in range(1, 11):
            finger("touchMove", at + np.array([6.0 * k, -2.0 * k]))
            tab.wait_for_timeout(60)
        moved = lambda: camera_axes(phone)[:, 0] @ (tip(session) - before)  # noqa: E731
        wait_until(lambda: moved() > 1e-3, "the tool to follow the finger", 30.0)
        # A second finger that comes nearer to the first moves it away, one that circles turns it.
        held = at + np.array([60.0, -20.0])
        start, axes = session.handle.copy(), camera_axes(phone)
        finger("touchStart", held, held - np.array([140.0, 0.0]))
        for k in range(1, 11):
            finger("touchMove", held, held - np.array([140.0 - 6.0 * k, 0.0]))
            tab.wait_for_timeout(60)
        depth = lambda: axes[:, 2] @ (session.handle.translation - start.translation)  # noqa: E731
        wait_until(lambda: depth() > 0.8e-3, "the tool to go away", 30.0)
        for k in range(1, 11):
            angle = 0.06 * k
            finger("touchMove", held, held - 80.0 * np.array([np.cos(angle), np.sin(angle)]))
            tab.wait_for_timeout(60)
        turn = lambda: pin.log3(session.handle.rotation @ start.rotation.T)  # noqa: E731
        wait_until(lambda: turn() @ axes[:, 2] > 0.4, "the turn", 30.0)
        finger("touchEnd")
        wait_until(lambda: not page.dragging, "the release")
    finally:
        context.close()
    wait_until(lambda: set(page.server.get_clients()) == known, "the phone to leave")
