"""The list of structures on the page: its buttons, the live distances, the settings below it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pinocchio as pin
import pytest

from app.session import Session
from app.view import Page
from tests.support import structured
from tests.support.watching import Visitor, wait_until

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def session(chromium: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    folder = structured.balls(tmp_path_factory.mktemp("balls"))
    options = structured.options(folder, rate=500.0)
    with Session(options) as session:
        yield session


@pytest.fixture(scope="module")
def visitor(page: Page, open_tab: Callable[[Page], Visitor]) -> Visitor:
    visitor = open_tab(page)
    visitor.tab.get_by_role("tab", name="Mesh", exact=True).click()
    return visitor


def button(visitor: Visitor, order: str, number: int):  # a playwright Locator
    return visitor.tab.locator(f"[data-vf-order='{order} {number}']")


def distance(visitor: Visitor, number: int) -> str:
    """What is written into a row [mm]."""
    return visitor.tab.locator(f".vf-s{number} .vf-distance").evaluate(
        "cell => getComputedStyle(cell, '::after').content.replaceAll('\"', '')"
    )


def bar(visitor: Visitor, number: int) -> bool:
    """Whether a row is marked: the structure holds the tool."""
    return (
        visitor.tab.locator(f".vf-s{number} .vf-name").evaluate(
            "cell => getComputedStyle(cell).boxShadow"
        )
        != "none"
    )


def test_the_list_names_all_and_its_field_is_hidden(visitor: Visitor) -> None:
    rows = visitor.tab.locator(".vf-structures .vf-name button")
    assert [text.strip() for text in rows.all_inner_texts()] == ["cube", *structured.NAMES]
    assert not visitor.tab.get_by_text("Order of the list").is_visible()
    assert visitor.complaints == []


def test_eye_and_box_of_a_row(visitor: Visitor, session: Session, page: Page) -> None:
    button(visitor, "eye", 2).click()
    wait_until(lambda: not page._anatomy.shows(2), "the nerve to be hidden")
    wait_until(
        lambda: button(visitor, "eye", 2).get_attribute("aria-pressed") == "false", "the row"
    )
    button(visitor, "eye", 2).click()
    wait_until(lambda: page._anatomy.shows(2), "the nerve to be drawn")
    button(visitor, "guard", 1).click()
    wait_until(lambda: not session.options.structures[0].guarded, "the dura to be off")
    wait_until(
        lambda: button(visitor, "guard", 1).get_attribute("aria-pressed") == "false", "the row"
    )
    session.set_structure(1, guarded=True)


def test_from_the_keyboard_the_focus_stays_where_it_was(visitor: Visitor, session: Session) -> None:
    """A row is drawn anew when its structure is switched, also by another client."""
    focused = "() => document.activeElement.dataset.vfOrder"
    button(visitor, "guard", 1).focus()
    for on in (False, True, False):
        visitor.tab.keyboard.press("Enter")
        wait_until(lambda on=on: session.options.structures[0].guarded is on, "the dura's switch")
        said = str(on).lower()
        wait_until(
            lambda said=said: button(visitor, "guard", 1).get_attribute("aria-pressed") == said,
            "the row",
        )
        assert visitor.tab.evaluate(focused) == "guard 1"
    session.set_structure(1, guarded=True)
    wait_until(
        lambda: button(visitor, "guard", 1).get_attribute("aria-pressed") == "true", "the row"
    )
    assert visitor.tab.evaluate(focused) == "guard 1"
    # Whoever has left the list is not called back.
    visitor.tab.get_by_label("Margin [mm]", exact=True).focus()
    session.set_structure(1, guarded=False)
    wait_until(
        lambda: button(visitor, "guard", 1).get_attribute("aria-pressed") == "false", "the row"
    )
    assert visitor.tab.evaluate("() => document.activeElement.tagName") == "INPUT"
    session.set_structure(1, guarded=True)


def test_the_chosen_one_is_set_below_the_list(visitor: Visitor, session: Session) -> None:
    button(visitor, "choose", 2).click()
    visitor.reads("Chosen", "2: nerve")
    field = visitor.tab.get_by_label("Margin [mm]", exact=True)
    wait_until(lambda: field.input_value() == "1", "the margin of the nerve")
    field.fill("2.5")
    field.press("Enter")
    wait_until(lambda: session.options.structures[1].margin == 2.5e-3, "the margin")
    wait_until(
        lambda: "2.5" in visitor.tab.locator(".vf-s2").inner_text(), "the margin in the list"
    )
    session.set_structure(2, margin=1e-3)
    wait_until(lambda: field.input_value() == "1", "the margin that was set elsewhere")


def test_distances_and_the_bar_follow_the_tool(visitor: Visitor, session: Session) -> None:
    before = visitor.tab.locator(".vf-s2").element_handle()
    middle = session.scene.surfaces[2].vertices.mean(axis=0)
    session.drive(pin.SE3(session.scene.T_base_start.rotation, middle))
    wait_until(lambda: distance(visitor, 2) == "1.02", "the distance: margin and standoff")
    wait_until(lambda: bar(visitor, 2), "the bar")
    assert not bar(visitor, 1)
    assert not bar(visitor, 0)
    banner = visitor.tab.locator(".vf-banner")
    wait_until(lambda: "nerve holds the tool back" in banner.inner_text(), "the banner")
    # The row itself has not been replaced meanwhile: a click is not lost.
    assert before.evaluate("row => row.isConnected")
    session.reset()
    wait_until(lambda: not bar(visitor, 2), "the bar to go")


def test_on_a_phone_rows_are_high_enough_for_a_finger(
    browser: object, page: Page, session: Session
) -> None:
    context = browser.new_context(  # type: ignore[attr-defined]
        viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True,
        device_scale_factor=0.5,
    )  # fmt: skip
    tab = context.new_page()
    try:
        tab.goto(page.url)
        tab.locator(".vf-banner").wait_for(timeout=120_000)
        tab.get_by_role("button", name="Expand panel Read-outs").tap()
        tab.get_by_role("tab", name="Mesh", exact=True).tap()
        row = tab.locator(".vf-s3")
        row.scroll_into_view_if_needed()
        box = row.bounding_box()
        assert box["height"] >= 28.0
        assert box["x"] >= 0.0
        assert box["x"] + box["width"] <= 390.0
        tab.locator("[data-vf-order='guard 3']").tap()
        wait_until(lambda: not session.options.structures[2].guarded, "the vessel to be off")
        session.set_structure(3, guarded=True)
    finally:
        context.close()
