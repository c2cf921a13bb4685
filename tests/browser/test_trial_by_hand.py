"""A trial of a study that is done with the mouse alone, in a real browser."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.recording.read import read
from app.session import Session
from app.studies.people.folder import Study
from app.studies.people.served.room import Room
from app.studies.people.sitting import Sitting
from app.view.units import to_view
from tests.support.watching import FEWER_FRAMES, Visitor, wait_until

pytestmark = pytest.mark.slow

PROTOCOL = """
format = 1
name = "Hand"
about = "For tests."
title = "By hand"
repetitions = 1
rest = 0
[consent]
text = "You will move a simulated instrument."
[[tasks]]
task = "targeting"
targets = 1
limit = 150
[[conditions]]
name = "with"
[[conditions]]
name = "without"
rule = "off"
"""
PACE = 0.4  # of the way that is left, the pointer goes so much at once
LONGEST = 60.0  # and no farther [px]
WHEEL = 4e4  # the wheel is turned so much for a metre that is left in depth [px/m]


@pytest.fixture
def room(tmp_path: Path) -> Iterator[Room]:
    """The room of a participant who is about to begin the first trial."""
    (tmp_path / "hand.toml").write_text(PROTOCOL)
    study = Study.make(tmp_path / "study", str(tmp_path / "hand.toml"))
    sitting = Sitting.enter(study, "P1")
    sitting.consent(True)
    room = Room(sitting, "127.0.0.1", "http://127.0.0.1:1")
    leading = threading.Thread(target=room.run, daemon=True)
    leading.start()
    yield room
    room.close()
    leading.join(30.0)


def test_a_target_is_touched_with_the_mouse_alone(room: Room, browser: Any) -> None:
    page: Any = room.page
    session = page._session
    tab = browser.new_context(
        viewport={"width": 1280, "height": 720}, device_scale_factor=0.4
    ).new_page()
    tab.set_default_timeout(120_000)
    tab.add_init_script(FEWER_FRAMES)
    try:
        tab.goto(f"http://127.0.0.1:{page.port}/")
        tab.get_by_role("button", name="Start").wait_for()
        page.server = page._server
        wait_until(lambda: page.server.get_clients(), "the tab's camera")
        visitor = Visitor(tab, max(page.server.get_clients()), page)
        tip = lambda: np.array(session.latest().step.tip.translation)  # noqa: E731
        tab.get_by_role("button", name="Start").click()
        wait_until(lambda: not page.hidden, "the trial")
        tab.wait_for_timeout(1000)

        aim, began = page._progress.aim, tip()
        pointer = grip(visitor, session)
        tab.mouse.move(*pointer)
        tab.mouse.down()
        due = time.monotonic() + 140.0
        while len(Sitting(room.sitting.study, "P1").done) < 1 and time.monotonic() < due:
            way = visitor.to_screen(to_view(aim)) - visitor.to_screen(to_view(tip()))
            way *= PACE * min(1.0, LONGEST / (np.linalg.norm(way) + 1e-9))
            pointer = pointer + way
            tab.mouse.move(*pointer)
            depth = forward(visitor) @ (aim - tip())
            if abs(depth) > 5e-4:
                tab.mouse.wheel(0.0, float(np.clip(-WHEEL * depth, -150.0, 150.0)))
            tab.wait_for_timeout(150)
        tab.mouse.up()
        done = Sitting(room.sitting.study, "P1").done
        assert len(done) == 1
        assert np.linalg.norm(aim - began) > 5e-3, "the target is not where the tool began"
        assert done[0]["completed"]
        recording = read(room.sitting.files.recording(0))
        assert not recording.cut
    finally:
        tab.context.close()


def grip(visitor: Visitor, session: Session) -> np.ndarray:
    """Where the tool is to be pressed on (2,) [px]: above its tip, beside the gizmo, in sight."""
    axes = session.scene.arm.axes(session.latest().q)
    shares = np.linspace(0.0, 1.0, 50)[:, None, None]
    points = ((1.0 - shares) * axes[:, 0] + shares * axes[:, 1]).reshape(-1, 3)
    tip = np.array(session.latest().step.tip.translation)
    points = points[np.linalg.norm(points - tip, axis=1) < 25e-3]
    seen = np.array([visitor.to_screen(to_view(point)) for point in points])
    seen = seen[seen[:, 1] > 30.0]
    apart = np.linalg.norm(seen - visitor.to_screen(to_view(tip)), axis=1)
    return np.asarray(seen[apart.argmax()])


def forward(visitor: Visitor) -> np.ndarray:
    """Where this tab looks (3,), without the code that is tested."""
    from scipy.spatial.transform import Rotation

    w, x, y, z = visitor.client.camera.wxyz
    return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix()[:, 2])
