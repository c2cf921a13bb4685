"""After the warm-up no tick compiles anything, or leaves anything behind in memory."""

from __future__ import annotations

import gc
import subprocess
import sys
import tracemalloc

import numba.core.event
import numpy as np

import robots
import vf
from tests.support.ticks import fixed, plate, pose


def test_warm_up_is_no_more_than_a_warm_up():
    arm = robots.load("psm")
    surface = plate(-0.12)
    cold, warm = (vf.Controller(arm, fixed(surface), vf.Settings()) for _ in range(2))
    warm.warm_up()
    goal = arm.tip(arm.neutral)
    goal.translation = goal.translation + np.array([1e-3, 0.0, -5e-3])
    assert warm.step(arm.neutral, goal).q.tobytes() == cold.step(arm.neutral, goal).q.tobytes()


FIRST_TICKS = """
import sys
import numpy as np, pinocchio as pin, trimesh
from numba.core.dispatcher import Dispatcher
import robots, vf

class Floor:  # a fixture of somebody's own, that only has planes
    radius, certified = None, True
    def inside(self, x): return False
    def leads_out(self, x, y): return True
    def planes(self, x, radius, standoff, tip_radius, inside): return vf.Planes.none(radius)

def kernels():
    modules = [m for n, m in list(sys.modules.items()) if n.split(".")[0] == "vf"]
    found = {id(v): v for m in modules for v in vars(m).values() if isinstance(v, Dispatcher)}
    return {v.py_func.__qualname__: len(v.overloads) for v in found.values()}

arm = robots.load("point")
tip = arm.tip(arm.neutral).translation.copy()
ball = trimesh.creation.icosphere(subdivisions=4, radius=1e-3)
corners, faces = ball.vertices + tip - [0.0, 0.0, 2e-3], ball.faces
surface = vf.Surface.from_arrays(corners, faces)
middle = np.array(corners.mean(axis=0))
runs = [
    vf.Controller(arm, [vf.MeshFixture(surface, rule, radius)])
    for rule in vf.RULES for radius in (5e-3, None)
]
runs.append(vf.Controller(arm, [vf.MeshFixture(surface), Floor()]))
along = np.array([0.01, 0.0, 0.0])
for corridor in (
    vf.CorridorFixture([middle - along, middle + along], [0.0, 0.0, 1.0]),
    vf.CorridorFixture([tip - along + 3e-3, tip, tip + along], [0.0, 0.0, 1.0]),  # bent
):
    for fixtures in ([corridor], [vf.MeshFixture(surface), corridor]):
        runs.append(vf.Controller(arm, fixtures))
before = kernels()
for controller in runs:
    # Free, in contact, on a corner exactly, inside, and where everything is equally near.
    for start in (tip, corners[np.argmax(corners[:, 2])], middle + 1e-4, middle):
        q = arm.inverse(pin.SE3(np.eye(3), np.array(start)), start=arm.neutral)
        for _ in range(20):
            q = controller.step(q, pin.SE3(np.eye(3), middle)).q
surface.nearest(middle)
late = {name: n for name, n in kernels().items() if n != before.get(name, 0)}
print(sorted(late))
"""


def test_a_tick_finds_every_kernel_in_memory():
    """In a new process, for a kernel may also be loaded from disk or be there from another test."""
    done = subprocess.run(
        [sys.executable, "-c", FIRST_TICKS], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


def test_nothing_compiles_after_warm_up_and_a_tick_leaves_nothing_behind():
    """Under any rule and radius, free, in contact and with the proxy deep behind the surface."""
    arm = robots.load("point")
    tip = arm.tip(arm.neutral).translation
    surface = plate(tip[2] - 1e-3)
    runs = [
        vf.Controller(arm, [vf.MeshFixture(surface, rule, radius)])
        for rule in vf.RULES
        for radius in (5e-3, None)
    ]
    runs[0].warm_up()
    goal = pose(tip - [1e-3, 2e-3, 5e-3])

    def drive(ticks):
        for controller in runs:
            q = arm.neutral
            for _ in range(ticks):
                q = controller.step(q, goal).q

    with numba.core.event.install_recorder("numba:compile") as compiled:
        drive(30)
    assert not compiled.buffer
    gc.collect()
    tracemalloc.start()
    try:
        drive(30)
        before = tracemalloc.get_traced_memory()[0]
        drive(300)
        gc.collect()
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert grown < 20_000  # [byte], of 2,400 ticks
