"""What the browser tests watch with: a tab on the page, the tool's track, patience."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from app.session import Session
from app.view import Page

ARTIFACTS = Path(__file__).parents[2] / "artifacts"

# The page draws as often as the browser lets it, and a software renderer fills a core with that.
# Ten pictures a second are enough to see what happens, and leave the core to the sandbox.
FEWER_FRAMES = """
window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 100);
window.cancelAnimationFrame = (timer) => clearTimeout(timer);
"""


def wait_until(condition: Callable[[], object], what: str, timeout: float = 60.0) -> None:
    """Poll until the condition holds; fails with `what` when it does not in time [s]."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, f"waited {timeout:g} s for: {what}"
        time.sleep(0.05)


class Track:
    """Records every position of the tool that telemetry shows, from a thread of its own."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.tips: list[np.ndarray] = []

    def __enter__(self) -> Track:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        last = None
        while not self._stop.wait(5e-4):
            step = self._session.latest().step
            if step is not None and step is not last:
                last = step
                self.tips.append(np.array(step.tip.translation))


@dataclass
class Visitor:
    """One browser tab on the page, and what its console said."""

    tab: Any  # playwright.sync_api.Page
    client_id: int
    page: Page
    complaints: list[str] = field(default_factory=list)

    @property
    def client(self) -> Any:
        """viser's handle of this tab."""
        return self.page.server.get_clients()[self.client_id]

    def canvas_box(self) -> dict[str, float]:
        """Where the 3D view is in the window [px]."""
        return self.tab.locator("canvas").first.bounding_box()

    def to_screen(self, p_view: np.ndarray) -> np.ndarray:
        """Where a point (3,) in scene units is in the window (2,) [px], by this tab's camera."""
        camera, box = self.client.camera, self.canvas_box()
        w, x, y, z = camera.wxyz
        R = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        right, down, forward = R.T @ (np.asarray(p_view) - camera.position)
        focal = 0.5 * box["height"] / np.tan(0.5 * camera.fov)
        return np.array(
            [
                box["x"] + box["width"] / 2 + focal * right / forward,
                box["y"] + box["height"] / 2 + focal * down / forward,
            ]
        )

    def pixel(self, p_view: np.ndarray) -> float:
        """Size of one pixel at a point (3,), in scene units."""
        camera = self.client.camera
        depth = np.linalg.norm(np.asarray(p_view) - camera.position)
        return float(2.0 * depth * np.tan(0.5 * camera.fov) / self.canvas_box()["height"])

    def picture(self, name: str) -> np.ndarray:
        """A screenshot of the 3D view alone (h, w, 3), kept as an artefact with the whole page."""
        from PIL import Image

        ARTIFACTS.mkdir(exist_ok=True)
        path = ARTIFACTS / f"{name}.png"
        self.tab.screenshot(path=path, scale="css", timeout=90_000)
        box = self.canvas_box()
        corners = (box["x"], box["y"], box["x"] + box["width"], box["y"] + box["height"])
        return np.asarray(Image.open(path).convert("RGB").crop(tuple(map(int, corners))))

    def readout(self, name: str) -> str:
        """The value beside a name in the table of read-outs."""
        row = self.tab.locator("tr", has=self.tab.get_by_role("cell", name=name, exact=True))
        return row.first.locator("td").nth(1).inner_text()

    def choose(self, control: str, option: str) -> None:
        """Pick an option of a dropdown in the panel, and wait until it has lost the focus.

        It loses it shortly after the click; a key that is pressed before is for its search.
        """
        box = self.tab.get_by_role("combobox", name=control, exact=True)
        box.click()
        self.tab.get_by_role("option", name=option, exact=True).click()
        self.reads(control, option)
        focused = "box => box === document.activeElement"
        wait_until(lambda: not box.evaluate(focused), f"{control} to lose the focus", 10.0)

    def reads(self, control: str, value: str) -> None:
        """Wait until a dropdown of the panel shows this value.

        What the session has already may still be on its way to the page: seconds, where a slow
        machine draws in software.
        """
        box = self.tab.get_by_role("combobox", name=control, exact=True)
        wait_until(lambda: box.input_value() == value, f"{control} to read {value}")

    def press(self, button: str) -> None:
        """Click a button of the panel."""
        self.tab.get_by_role("button", name=button, exact=True).click()


def settle(visitor: Visitor, known: set[int]) -> None:
    """Wait for the panel, for the client's camera, and for a picture that is not blank."""
    visitor.tab.get_by_text("Drag the tool, or the gizmo").wait_for(timeout=90_000)
    clients = visitor.page.server.get_clients
    deadline = time.monotonic() + 90.0
    while not set(clients()) - known:
        assert time.monotonic() < deadline, "the page never said where its camera is"
        visitor.tab.wait_for_timeout(100)
    visitor.client_id = max(set(clients()) - known)
    while time.monotonic() < deadline and drawn_share(visitor.picture("opening")) < 0.03:
        visitor.tab.wait_for_timeout(250)


def drawn_share(picture: np.ndarray) -> float:
    """Share of pixels (h, w, 3) that are not the white background."""
    return float((picture.min(axis=2) < 245).mean())
