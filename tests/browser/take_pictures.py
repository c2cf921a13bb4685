"""Takes the pictures of README and guide from the running page.

    python -m tests.browser.take_pictures docs [NAME ...]

Each picture is what a user sees who does what the function of that name does. When all are taken,
what page they are of is noted beside them (tests/support/pictured.py), and tests/test_docs.py fails
when the page is another one.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from PIL import Image
from playwright.sync_api import sync_playwright

import meshes
from app.bench.tools.watcher import ARGUMENTS, chromium
from app.session import Session
from app.settings import Options
from app.view import Page, camera
from meshes.builtin.damage import damage
from tests.support.pictured import write_record
from tests.support.watching import Visitor, settle, wait_until

PUSH = np.array([0.012, 0.022, -0.0265])  # from the start into the bone [m]
DRAWN = 4000  # what a software renderer may take for the last picture [ms]


def first_sight(visitor: Visitor, session: Session) -> None:
    """The page as it opens."""


def sandbox(visitor: Visitor, session: Session) -> None:
    """The tool pressed against the skull, the proxy seen through the bone."""
    layer(visitor, "See-through")
    press(session)
    step = session.latest().step
    view = camera.tool_view(step)
    middle = 0.5 * (step.tip.translation + session.handle.translation) + np.array([0, 0, 0.003])
    away = (view.eye - view.look_at) / np.linalg.norm(view.eye - view.look_at)
    camera.move(visitor.client, camera.View(middle + 0.052 * away, middle))


def inspector(visitor: Visitor, session: Session) -> None:
    """Why the tool stops: the report on the triangle that blocks."""
    press(session)
    inspect(visitor)
    camera.move(visitor.client, camera.tool_view(session.latest().step))
    visitor.tab.locator(".vf-push").first.wait_for(timeout=30_000)


def region(visitor: Visitor, session: Session) -> None:
    """Where the tool may go, and what other rules would have left of it."""
    press(session)
    inspect(visitor)
    visitor.tab.get_by_label("Allowed region", exact=True).click()
    visitor.tab.get_by_label("Compare rules", exact=True).click()
    camera.move(visitor.client, camera.tool_view(session.latest().step))
    visitor.tab.locator(".vf-rules table").first.wait_for(timeout=60_000)
    # At once: the table is drawn anew again and again, and is never still for long.
    visitor.tab.locator(".vf-rules table").first.evaluate("table => table.scrollIntoView()")


def condition_2(visitor: Visitor, session: Session) -> None:
    """The probe in the case of the paper's Figure 4 (c)."""
    inspect(visitor)
    visitor.tab.get_by_label("Freeze and explore", exact=True).click()
    visitor.choose("Explore", "Fig. 4 (c)")
    visitor.tab.wait_for_timeout(DRAWN)


def signals(visitor: Visitor, session: Session) -> None:
    """Twenty seconds of the autopilot as plots."""
    visitor.tab.get_by_role("tab", name="Signals", exact=True).click()
    session.set_autopilot(True)
    visitor.tab.wait_for_timeout(22_000)
    session.pause()


def mesh(visitor: Visitor, session: Session) -> None:
    """A scan with flipped faces and holes, and where they are."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan.ply"
        meshes.save(
            path, *damage("holes", damage("flipped", meshes.arrays("skull-coarse")), seed=1)
        )
        session.change(mesh=str(path), unit="mm")
        visitor.tab.get_by_role("tab", name="Mesh", exact=True).click()
        visitor.press("Examine")
        visitor.tab.get_by_text("wound against").first.wait_for(timeout=60_000)
    camera.move(visitor.client, camera.anatomy_view(session.scene))


PICTURES: tuple[Callable[[Visitor, Session], None], ...] = (
    first_sight, sandbox, inspector, region, condition_2, signals, mesh,
)  # fmt: skip


def press(session: Session) -> None:
    """Lead the tool onto the bone, as a hand would."""
    start = session.scene.T_base_start
    for share in np.linspace(0.0, 1.0, 20):
        session.drive(pin.SE3(start.rotation, start.translation + share * PUSH))
        time.sleep(0.05)
    wait_until(lambda: session.latest().step.multipliers.max(initial=0.0) > 1e-6, "contact")
    time.sleep(1.0)


def inspect(visitor: Visitor) -> None:
    visitor.tab.get_by_role("tab", name="Inspector", exact=True).click()
    visitor.tab.get_by_label("Inspect", exact=True).click()


def layer(visitor: Visitor, name: str) -> None:
    """Click a layer's switch, unfolding the layers."""
    visitor.tab.get_by_text("Layers", exact=True).click()
    visitor.tab.get_by_label(name, exact=True).click()
    visitor.tab.get_by_text("Layers", exact=True).click()


def take(browser: Any, picture: Callable[[Visitor, Session], None], path: Path) -> None:
    """One picture, with a session and a page of its own."""
    with Session(Options()) as session:
        page = Page(session, "127.0.0.1", 0)
        try:
            tab = browser.new_page(viewport={"width": 1280, "height": 720})
            visitor = Visitor(tab, -1, page)
            tab.goto(page.url)
            settle(visitor, set())
            # The notice that there is no graphics card.
            tab.locator(".mantine-Notification-closeButton").first.click(timeout=60_000)
            picture(visitor, session)
            tab.mouse.move(600, 700)  # off the controls and their hints
            tab.wait_for_timeout(DRAWN)
            tab.screenshot(path=path, timeout=90_000)
            tab.close()
        finally:
            page.close()
    # In all of its colours: a palette takes one condition's small mark for another's.
    Image.open(path).convert("RGB").save(path, optimize=True)


def name_of(picture: Callable[[Visitor, Session], None]) -> str:
    return picture.__name__.replace("_", "-")


def main(folder: str, *names: str) -> None:
    """Take the named pictures, or all and note of what page they are."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=list(ARGUMENTS))
        for picture in PICTURES:
            name = name_of(picture)
            if not names or name in names:
                take(browser, picture, Path(folder) / f"{name}.png")
                print(name, flush=True)
        browser.close()
    if not names:
        write_record(Path(folder), [name_of(picture) for picture in PICTURES])


if __name__ == "__main__":
    main(*sys.argv[1:])
