"""Sound and gamepad in a real browser: what is played is read from the audio graph itself."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from app.session import Session
from app.view import Page
from tests.support.watching import FEWER_FRAMES, Visitor, settle, wait_until

pytestmark = pytest.mark.slow

# A machine without a gamepad: the browser's interface to one, and the audio nodes that are made.
WATCHED = """
window.pad = {connected: true, mapping: "standard", axes: [0, 0, 0, 0],
  buttons: Array.from({length: 16}, () => ({pressed: false})), shaken: 0,
  vibrationActuator: {playEffect: async () => { window.pad.shaken += 1; }}};
navigator.getGamepads = () => [null, window.pad];
window.made = {};
for (const name of ["createOscillator", "createGain"]) {
  const original = BaseAudioContext.prototype[name];
  BaseAudioContext.prototype[name] = function () {
    return (window.made[name] = original.call(this));
  };
}
"""


@pytest.fixture(scope="module")
def visitor(browser: Any, page: Page) -> Iterator[Visitor]:
    known = set(page.server.get_clients())
    tab = browser.new_page(viewport={"width": 1280, "height": 720}, device_scale_factor=0.4)
    tab.add_init_script(FEWER_FRAMES)
    tab.add_init_script(WATCHED)
    visitor = Visitor(tab, -1, page)
    tab.goto(page.url)
    settle(visitor, known)
    visitor.tab.get_by_text("Hand", exact=True).click()
    yield visitor
    tab.close()


@pytest.fixture(autouse=True)
def _fresh(session: Session) -> Iterator[None]:
    session.reset()
    yield
    session.reset()


def press(session: Session, depth: float) -> None:
    start = session.scene.T_base_start
    session.drive(pin.SE3(start.rotation, start.translation - np.array([0.0, 0.0, depth])))


def test_the_force_is_heard_once_sound_is_on(visitor: Visitor, session: Session) -> None:
    press(session, 0.02)
    wait_until(lambda: np.linalg.norm(session.latest().step.force) > 0.3, "the contact")
    assert visitor.tab.evaluate("Object.keys(made).length") == 0, "silent unless asked"
    visitor.tab.get_by_label("Sound", exact=True).click()
    volume = lambda: visitor.tab.evaluate("made.createGain?.gain.value ?? 0")  # noqa: E731
    tone = lambda: visitor.tab.evaluate("made.createOscillator?.frequency.value ?? 0")  # noqa: E731
    wait_until(lambda: volume() > 0.01, "the tone", 20.0)
    soft, low = volume(), tone()
    press(session, 0.03)
    wait_until(lambda: volume() > 1.5 * soft and tone() > 1.05 * low, "louder and higher", 20.0)
    session.reset()
    wait_until(lambda: volume() < 1e-3, "silence", 20.0)
    visitor.tab.get_by_label("Sound", exact=True).click()
    press(session, 0.03)
    wait_until(lambda: np.linalg.norm(session.latest().step.force) > 0.3, "the contact")
    visitor.tab.wait_for_timeout(500)
    assert volume() < 1e-3


def test_a_gamepad_moves_the_proxy_and_shakes_at_a_contact(
    visitor: Visitor, session: Session
) -> None:
    visitor.tab.get_by_label("Gamepad or 3D mouse").click()
    before = session.handle.translation.copy()
    visitor.tab.evaluate("pad.axes = [0, 0, 0, -1]")
    wait_until(lambda: session.handle.translation[2] - before[2] > 4e-3, "the way up", 20.0)
    assert visitor.page.dragging
    assert visitor.tab.evaluate("pad.shaken") == 0, "in free space nothing is felt"
    visitor.tab.evaluate("pad.axes = [0, 0, 0, 0]")
    wait_until(lambda: not visitor.page.dragging, "rest", 20.0)
    rest = session.handle.translation.copy()
    visitor.tab.wait_for_timeout(500)
    np.testing.assert_array_equal(session.handle.translation, rest)
    np.testing.assert_allclose(rest[:2], before[:2], atol=1e-9)
    visitor.tab.evaluate("pad.axes = [0, 0, 0, 1]")
    wait_until(lambda: visitor.tab.evaluate("pad.shaken") > 0, "the contact", 30.0)
    assert session.scene.surface.nearest(session.latest().step.tip.translation)[0] < 1e-4
    visitor.tab.evaluate("pad.axes = [0, 0, 0, 0]")
    visitor.picture("hand")
    visitor.tab.evaluate("pad.buttons[0].pressed = true")
    wait_until(lambda: session.master.clutched, "the clutch", 20.0)
    visitor.tab.evaluate("pad.buttons[0].pressed = false")
    wait_until(lambda: not session.master.clutched, "its release", 20.0)
    visitor.tab.get_by_label("Gamepad or 3D mouse").click()
    here = session.handle.translation.copy()
    visitor.tab.evaluate("pad.axes = [0, 0, 0, -1]")
    visitor.tab.wait_for_timeout(700)
    np.testing.assert_array_equal(session.handle.translation, here)
