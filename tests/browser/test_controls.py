"""Keys, fields, colours and buttons under a user's hand, in a real browser."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from app.session import Session
from app.view import Page, camera
from tests.support.watching import Visitor, wait_until

pytestmark = pytest.mark.slow

MESH = "skull-coarse"
# How far any button or field moves from now on [px], by what it is called.
WATCH = """() => {
  const shown = () => [...document.querySelectorAll('button, input')]
    .filter(e => e.offsetParent !== null && !e.closest('.mantine-Notification-root'));
  const place = e => { const at = e.getBoundingClientRect(); return [at.x, at.y]; };
  const first = new Map(shown().map(e => [e, place(e)]));
  window.shifted = {};
  window.watching = setInterval(() => {
    for (const e of shown()) {
      if (!first.has(e)) continue;
      const [was, is] = [first.get(e), place(e)], far = Math.hypot(is[0] - was[0], is[1] - was[1]);
      const name = e.innerText || e.labels?.[0]?.innerText || e.id || e.outerHTML.slice(0, 80);
      if (far > 0.5) window.shifted[name] = Math.max(far, window.shifted[name] || 0);
    }
  }, 20);
}"""
# The lowest contrast of our own words with what is behind them, and which words those are.
CONTRAST = """() => {
  const numbers = text => text.match(/[\\d.]+/g).map(Number);
  const light = c => c.slice(0, 3).map(v => v / 255)
    .map(v => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  const behind = e => { for (; e; e = e.parentElement) {
    const c = numbers(getComputedStyle(e).backgroundColor); if ((c[3] ?? 1) > 0.5) return c; }
    return [255, 255, 255]; };
  let worst = [99, ''];
  for (const block of document.querySelectorAll('div[style*="margin:0 .75em"], .vf-numbers'))
    for (const e of [block, ...block.querySelectorAll('*')]) {
      const words = [...e.childNodes].filter(n => n.nodeType === 3).map(n => n.textContent.trim());
      if (e.offsetParent === null || !words.some(w => /[A-Za-z0-9]/.test(w))) continue;
      const [a, b] = [light(numbers(getComputedStyle(e).color)), light(behind(e))];
      const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
      if (ratio < worst[0]) worst = [ratio, words.join(' ')];
    }
  return worst;
}"""


@pytest.fixture(autouse=True)
def _fresh(session: Session) -> Iterator[None]:
    """At rest at the start with the default settings, before and after."""

    def reset() -> None:
        if session.scene.mesh_name != MESH:
            session.change(mesh=MESH)
        session.resume()
        session.set(rule="certified")
        session.set(radius=5e-3)
        session.reset()
        wait_until(lambda: session.latest().target is None, "the reset")

    reset()
    yield
    reset()


def nudged(visitor: Visitor, session: Session) -> None:
    """Press a nudging key and wait until the handle has moved by it."""
    before = session.handle.translation.copy()
    visitor.tab.keyboard.press("Shift+O")
    wait_until(lambda: session.handle.translation[2] > before[2] + 9e-4, "the nudge")


def test_keys_work_whatever_has_the_focus_but_a_text_field(
    visitor: Visitor, session: Session
) -> None:
    focus = "document.activeElement.type || document.activeElement.tagName"
    box = visitor.tab.get_by_label("Autopilot", exact=True)
    box.click()
    wait_until(lambda: session.latest().autopilot, "the autopilot")
    box.click()
    wait_until(lambda: not session.latest().autopilot, "its end")
    assert visitor.tab.evaluate(focus) == "checkbox"
    nudged(visitor, session)
    visitor.choose("Rule", "paper")
    nudged(visitor, session)
    assert session.options.rule == "paper"
    visitor.press("Recall to tool")
    nudged(visitor, session)
    field = visitor.tab.get_by_label("Standoff [µm]", exact=True)
    field.fill("")
    before = session.handle.translation.copy()
    for key in ("4", "Shift+O", "p", "1"):
        visitor.tab.keyboard.press(key)
    wait_until(lambda: session.options.standoff == pytest.approx(41e-6), "what was typed")
    assert session.options.rule == "paper", "digits are for the field"
    assert not session.latest().paused
    assert (session.handle.translation == before).all()
    visitor.tab.keyboard.press("Escape")  # leaves the field
    nudged(visitor, session)
    session.set(standoff=20e-6)


def test_loading_a_scenario_moves_no_button(visitor: Visitor, session: Session) -> None:
    visitor.tab.evaluate(WATCH)
    try:
        for name in ("saddle", "push-on-the-skull"):
            visitor.choose("Show", name)
            version = session.scene.version
            visitor.press("Load")
            wait_until(lambda v=version: session.scene.version > v, "the scenario", 120.0)
            visitor.tab.wait_for_timeout(1500)
        assert visitor.tab.evaluate("window.shifted") == {}
    finally:
        visitor.tab.evaluate("clearInterval(window.watching)")


def test_the_dark_page_can_be_read(visitor: Visitor) -> None:
    scheme = "document.documentElement.getAttribute('data-mantine-color-scheme')"
    assert visitor.tab.evaluate(scheme) == "light"
    for tab in ("Read-outs", "Legend", "Signals", "Inspector", "Mesh"):
        visitor.tab.get_by_role("tab", name=tab, exact=True).click()
        for wanted in ("dark", "light"):
            visitor.tab.keyboard.press("b")
            wait_until(lambda w=wanted: visitor.tab.evaluate(scheme) == w, wanted)
            visitor.picture(f"{wanted}-{tab.lower()}")
            ratio, words = visitor.tab.evaluate(CONTRAST)
            assert ratio > 3.5, f"{tab}, {wanted}: “{words}” has a contrast of {ratio:.1f}"
    visitor.tab.get_by_role("tab", name="Read-outs", exact=True).click()


def test_an_emptied_number_shows_its_value_again(visitor: Visitor, session: Session) -> None:
    field = visitor.tab.get_by_label("Tip radius [mm]", exact=True)
    shown = field.input_value()
    field.fill("")
    field.press("Tab")
    wait_until(lambda: field.input_value() == shown, "the value")
    assert session.options.tip_radius * 1e3 == pytest.approx(float(shown))


def test_a_processor_that_draws_does_not_smooth_edges(visitor: Visitor) -> None:
    """The tests' browser draws with the processor; half of its time would go into that."""
    attributes = visitor.tab.evaluate(
        "document.querySelector('canvas[data-engine]').getContext('webgl2').getContextAttributes()"
    )
    assert attributes["antialias"] is False


def test_looks_through_a_parallel_lens_and_cuts_the_anatomy_open(
    visitor: Visitor, session: Session, page: Page
) -> None:
    visitor.tab.keyboard.press("Escape")  # out of whatever field the test before left it in
    visitor.tab.keyboard.press("8")
    eye = visitor.client.camera
    visitor.tab.keyboard.press("z")
    wait_until(lambda: eye.fov == pytest.approx(camera.PARALLEL, rel=1e-3), "the lens")
    visitor.tab.keyboard.press("x")

    def behind() -> bool:
        vertices = page.server.scene._handle_from_node_name["/anatomy/mesh"].vertices
        tip = 100.0 * session.latest().step.tip.translation
        away = (eye.position - tip) / np.linalg.norm(eye.position - tip)
        return bool(((vertices - tip) @ away).max() < 0.05)

    wait_until(behind, "the cut")
    visitor.picture("parallel-section")
    visitor.tab.keyboard.press("x")
    wait_until(lambda: not behind(), "the whole")
    visitor.tab.keyboard.press("z")
    wait_until(lambda: eye.fov == pytest.approx(camera.FIELD_OF_VIEW, rel=1e-3), "the lens")
