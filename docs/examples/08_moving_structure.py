"""Anatomy that moves: a structure with a margin that breathes, and a tool that is held beside it.

A motion is the pose of the structure's frame at the start and at the end of a tick. A tool that is
to stay where it is (its own pose is the target) yields to what comes, no more than it has to. What
comes faster than the arm can yield overtakes it, and the tick says by how much at most.
"""

import numpy as np
import pinocchio as pin

import meshes
import robots
import vf

arm = robots.load("psm")
controller = vf.Controller(
    arm,
    [vf.MeshFixture(meshes.load("sphere"), margin=0.5e-3, name="liver")],
    vf.Settings(dt=1e-3, standoff=20e-6),
)
surface = controller.fixtures[0].surface
low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
q = arm.neutral
tip = arm.tip(q).translation


def liver(t: float) -> pin.SE3:
    """T_base_liver at a time [s]: its top 1 mm below the tip, 4 mm up and down every 3 s."""
    rise = 2e-3 * (1.0 - np.cos(2.0 * np.pi * t / 3.0))
    middle = np.array([0.5 * (low + high)[0], 0.5 * (low + high)[1], high[2]])
    return pin.SE3(np.eye(3), tip - middle + [0.0, 0.0, rise - 1e-3])


held = arm.tip(q)  # the hand does not move
least = np.inf
for k in range(3000):
    motion = vf.Motion(liver(1e-3 * k), liver(1e-3 * (k + 1)))
    step = controller.step(q, held, motions=[motion])
    q = step.q
    least = min(least, surface.nearest(motion.end.actInv(step.tip.translation))[0])
    if k % 500 == 499:
        lift = step.tip.translation[2] - tip[2]
        print(f"{k + 1:5} ms  {step.status.name:10} lifted {lift * 1e3:.2f} mm")
print(f"never closer than {least * 1e3:.2f} mm")

# A knock on the table: 30 mm in one tick.
knocked = liver(3.0) * pin.SE3(np.eye(3), np.array([0.0, 0.0, 30e-3]))
step = controller.step(q, held, motions=[vf.Motion(liver(3.0), knocked)])
print(f"knocked: {step.status.name}, up to {step.violation * 1e3:.0f} mm deep")
