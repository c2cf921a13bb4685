"""Takes the README's picture from the running page: python tests/browser/take_picture.py FILE."""

from __future__ import annotations

import sys
import time

import numpy as np
import pinocchio as pin
from playwright.sync_api import sync_playwright
from watching import Visitor, settle

from app.bench.watcher import ARGUMENTS, chromium
from app.session import Session
from app.settings import Options
from app.view import Page, camera

PUSH = np.array([0.012, 0.022, -0.0265])  # from the start into the bone [m]


def main(path: str) -> None:
    """The tool pressed against the skull, the proxy seen through the bone."""
    with Session(Options()) as session, sync_playwright() as playwright:
        page = Page(session, "127.0.0.1", 0)
        try:
            browser = playwright.chromium.launch(executable_path=chromium(), args=list(ARGUMENTS))
            tab = browser.new_page(viewport={"width": 1280, "height": 720})
            visitor = Visitor(tab, -1, page)
            tab.goto(page.url)
            settle(visitor, set())
            tab.wait_for_timeout(3000)
            # The notice that there is no graphics card.
            tab.locator(".mantine-Notification-closeButton").first.click(timeout=30_000)
            tab.get_by_text("Layers", exact=True).click()
            tab.get_by_label("See-through").click()
            start = session.scene.T_base_start
            for share in np.linspace(0.0, 1.0, 20):
                session.drive(pin.SE3(start.rotation, start.translation + share * PUSH))
                time.sleep(0.05)
            time.sleep(1.0)
            step = session.latest().step
            assert step is not None
            view = camera.tool_view(step)
            middle = 0.5 * (step.tip.translation + session.handle.translation)
            middle += np.array([0.0, 0.0, 0.003])
            away = (view.eye - view.look_at) / np.linalg.norm(view.eye - view.look_at)
            camera.move(visitor.client, camera.View(middle + 0.052 * away, middle))
            tab.wait_for_timeout(8000)
            tab.screenshot(path=path, timeout=90_000)
            browser.close()
        finally:
            page.close()


if __name__ == "__main__":
    main(sys.argv[1])
