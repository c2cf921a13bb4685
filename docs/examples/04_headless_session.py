"""A session without a page: the control thread at 1 kHz, driven from Python.

`app.session.Session` is what the page talks to. Here a script takes the operator's place: it drags
the proxy into the bone, changes the rule's motion sphere meanwhile and keeps a recording.
"""

import tempfile
import time
from pathlib import Path

import numpy as np
import pinocchio as pin

from app.recording.read import read
from app.session import Session
from app.settings import Options

folder = Path(tempfile.mkdtemp())
options = Options(mesh="sphere", robot="psm", rate=1000.0)

with Session(options) as session:  # starts the control thread, and ends it
    tape = session.record(folder / "push.vfrec")
    start = session.scene.T_base_start

    # Where the surface is nearest, and a proxy 10 mm behind it.
    foot = session.scene.surface.nearest(start.translation)[2]
    inwards = (foot - start.translation) / np.linalg.norm(foot - start.translation)
    goal = foot + 0.01 * inwards

    for share in np.linspace(0.0, 1.0, 50):
        position = (1 - share) * start.translation + share * goal
        session.drive(pin.SE3(start.rotation, position))  # what the gizmo does
        time.sleep(0.02)
    session.set(radius=2e-3)  # takes effect at the next tick
    time.sleep(0.5)

    seen = session.latest()  # the newest tick, never waits
    tip = seen.step.tip.translation
    gap = session.scene.surface.nearest(tip)[0]
    print(f"{seen.tick} ticks, {seen.stats.rate:.0f} a second")
    print(f"status {seen.step.status.name}, {gap * 1e6:.0f} µm off the surface")
    print(f"force {np.linalg.norm(seen.step.force):.2f} N")
    print(f"crossed the mesh: {'yes' if session.crossing else 'no'}")
    session.stop_recording()

recording = read(tape.path)
print(f"{len(recording.rows)} ticks recorded: vf-sandbox replay {tape.path.name} --check")
assert gap > 19e-6
