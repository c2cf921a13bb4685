"""A user's hand, eye and help, in a real browser: nudges, lock, camera, plots, a phone."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from app.session import Session
from app.view import Page
from app.view.units import VIEW_SCALE
from tests.support.watching import Visitor, drawn_share, wait_until

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _fresh(session: Session) -> Iterator[None]:
    """At rest at the start with the default settings, before and after."""

    def reset() -> None:
        if session.scene.mesh_name != "skull-coarse":
            session.change(mesh="skull-coarse")
        session.resume()
        session.set(rule="certified")
        session.set(radius=5e-3)
        session.set(lock_orientation=False)
        session.reset()
        wait_until(lambda: session.latest().target is None, "the reset")

    reset()
    yield
    reset()


def test_nudges_the_proxy_with_keys_that_leave_the_camera_alone(
    visitor: Visitor, session: Session
) -> None:
    eye = np.array(visitor.client.camera.position)
    keyboard = visitor.tab.keyboard
    for keys, length, upward in (("l", 1e-4, 0.0), ("Shift+L", 1e-3, 0.0), ("Shift+O", 1e-3, 1e-3)):
        before = session.handle.translation.copy()
        keyboard.press(keys)
        wait_until(
            lambda before=before: np.abs(session.handle.translation - before).max() > 1e-6, keys
        )
        shift = session.handle.translation - before
        assert np.linalg.norm(shift) == pytest.approx(length, abs=1e-9)
        assert shift[2] == pytest.approx(upward, abs=1e-9)
    tip = lambda: np.array(session.latest().step.tip.translation)  # noqa: E731
    wait_until(lambda: np.linalg.norm(tip() - session.handle.translation) < 1e-5, "the tool")
    np.testing.assert_allclose(visitor.client.camera.position, eye)


def test_locks_the_orientation(visitor: Visitor, session: Session, page: Page) -> None:
    visitor.tab.get_by_text("Teleoperation", exact=True).click()
    box = visitor.tab.get_by_label("Lock orientation")
    box.click()
    wait_until(lambda: session.options.lock_orientation, "the lock")
    start = session.scene.T_base_start
    turned = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.3) @ start.rotation, start.translation)
    session.drive(turned)
    wait_until(lambda: session.latest().target is not None, "the proxy")
    np.testing.assert_allclose(session.latest().target.rotation, start.rotation, atol=1e-9)
    wait_until(
        lambda: page.server.scene._handle_from_node_name["/proxy/gizmo"].disable_rotations,
        "no rings",
    )
    visitor.picture("locked-orientation")
    box.click()
    wait_until(lambda: not session.options.lock_orientation, "the release")
    visitor.tab.get_by_text("Teleoperation", exact=True).click()


def test_follows_the_tool_with_the_camera(visitor: Visitor, session: Session) -> None:
    visitor.press("Follow")
    start = session.scene.T_base_start
    aim = lambda p: np.linalg.norm(visitor.client.camera.look_at - VIEW_SCALE * p) < 0.05  # noqa: E731
    wait_until(lambda: aim(start.translation), "the close-up")
    goal = pin.SE3(start.rotation, start.translation + np.array([0.01, 0.004, 0.006]))
    session.drive(goal)
    wait_until(lambda: aim(goal.translation), "the camera to follow")
    visitor.picture("following")
    visitor.tab.keyboard.press("f")
    visitor.tab.wait_for_timeout(500)
    session.drive(start)
    wait_until(
        lambda: np.linalg.norm(session.latest().step.tip.translation - start.translation) < 1e-5,
        "the way back",
    )
    assert aim(goal.translation), "the camera stands"
    visitor.press("Surgeon")
    wait_until(lambda: aim(start.translation), "the surgeon's view")
    visitor.picture("surgeon")
    visitor.press("Site")


def test_reads_the_plots_and_sees_how_deep_the_tool_goes_without_a_fixture(
    visitor: Visitor, session: Session
) -> None:
    charts = "Object.values((window.__viserTestpoints || {}).uplots || {})"
    newest = f"{charts}.map(u => u.chart.data.slice(1).map(s => s[s.length - 1]))"
    visitor.tab.get_by_text("Signals", exact=True).click()
    wait_until(lambda: visitor.tab.evaluate(f"{charts}.length") == 5, "five plots")
    before_opening = f"{charts}[0].chart.data[0].length"
    assert visitor.tab.evaluate(before_opening) > 5, "they show what was before"
    for curve in ("Condition 1", "Condition 2", "Condition 3", "median", "worst"):
        visitor.tab.locator(".u-legend").get_by_text(curve, exact=True).wait_for()
    start = session.scene.T_base_start
    session.set(rule="off")
    session.drive(pin.SE3(start.rotation, start.translation - np.array([0.0, 0.0, 0.016])))
    wait_until(lambda: visitor.tab.evaluate(newest)[0][0] < -0.1, "the depth in the plot")
    visitor.picture("signals")
    visitor.tab.get_by_label("Plot", exact=True).click()
    visitor.tab.wait_for_timeout(1000)
    before = visitor.tab.evaluate(newest)
    session.reset()
    visitor.tab.wait_for_timeout(1500)
    assert visitor.tab.evaluate(newest) == before, "what is switched off stands still"
    visitor.tab.get_by_label("Plot", exact=True).click()
    session.drive(pin.SE3(start.rotation, start.translation - np.array([0.0, 0.0, 0.016])))
    visitor.tab.get_by_text("Read-outs", exact=True).click()
    wait_until(lambda: float(visitor.readout("depth below surface").strip("–") or 0) > 0.1, "depth")
    visitor.tab.get_by_text("deep in the anatomy").wait_for()


def test_opens_the_help_and_closes_it(visitor: Visitor) -> None:
    title = visitor.tab.get_by_text("in ten lines")
    visitor.press("What am I looking at?")
    title.wait_for()
    visitor.picture("help")
    visitor.press("Close")
    title.wait_for(state="hidden")
    visitor.tab.keyboard.press("h")
    title.wait_for()
    wait_until(lambda: visitor.tab.locator(".vf-help li").count() == 10, "ten lines")
    visitor.tab.keyboard.press("h")
    title.wait_for(state="hidden")
    visitor.tab.keyboard.press("h")
    title.wait_for()
    visitor.tab.keyboard.press("Escape")
    title.wait_for(state="hidden")


def test_uses_a_phone_and_still_sees_most_of_the_scene(browser: Any, page: Page) -> None:
    known = set(page.server.get_clients())
    tab = browser.new_page(viewport={"width": 390, "height": 844}, device_scale_factor=0.3)
    tab.set_default_timeout(120_000)  # with another tab drawing in software beside it
    try:
        tab.goto(page.url)
        tab.get_by_text("Read-outs · Legend").wait_for()  # the sheet has a row for them
        wait_until(lambda: set(page.server.get_clients()) - known, "the phone", 120.0)
        pause = tab.get_by_role("button", name="Pause", exact=True)
        wait_until(lambda: pause.bounding_box()["y"] < 820, "buttons that need no scrolling")
        banner = tab.get_by_text("Ready: drag the tool").bounding_box()
        assert banner["y"] > 0.55 * 844, "the scene has the upper half"
        assert banner["width"] > 0.8 * 390, "the sheet is as wide as the screen"
        picture = Visitor(tab, -1, page).picture("phone")
        assert drawn_share(picture[:480]) > 0.1
    finally:
        tab.close()
    wait_until(lambda: set(page.server.get_clients()) == known, "the phone to leave")
