"""Anatomy that deforms: a heart that beats, whose shapes come 50 times a second, and a held tool.

A tracker or a simulator gives new vertices for the same faces. `deforming` takes the surface from
its last shape to the new one, and the blend of a tick's motion says how far it is on that way. A
tool that is held beside the wall yields to it.
"""

import numpy as np
import pinocchio as pin

import meshes
import robots
import vf

heart = meshes.deforming("heart")
surface = vf.Surface.from_arrays(heart.vertices, heart.faces)
arm = robots.load("psm")
controller = vf.Controller(arm, [vf.MeshFixture(surface, name="heart")], vf.Settings(dt=1e-3))

q = arm.neutral
held = arm.tip(q)  # the hand does not move
# In diastole, when the heart is full, the wall would come 3 mm past the tip.
high = heart.vertices[heart.vertices[:, 2].argmax()]
squeezed = 0.33  # of a beat
low = heart.shape(squeezed)[heart.vertices[:, 2].argmax()]
T = pin.SE3(np.eye(3), held.translation - high - [0.0, 0.0, -3e-3])
now = surface.deforming(heart.shape(squeezed)).deforming(heart.shape(squeezed))
print(f"the wall rises by {(high - low)[2] * 1e3:.1f} mm")

TICKS = 20  # between two shapes
least = np.inf
for frame in range(42):
    now = now.deforming(heart.shape(squeezed + 0.02 * (frame + 1) / heart.period))
    controller.replace(0, now)
    for k in range(TICKS):
        motion = vf.Motion(T, T, blend=(k / TICKS, (k + 1) / TICKS))
        step = controller.step(q, held, motions=[motion])
        q = step.q
    seen = T.actInv(step.tip.translation)
    least = min(least, now.shape(1.0).nearest(seen)[0])
    if frame % 10 == 9:
        lift = (step.tip.translation - held.translation)[2]
        print(f"{20 * (frame + 1):4} ms  {step.status.name:10} lifted {lift * 1e3:.2f} mm")
print(f"never closer than {least * 1e6:.0f} µm where a shape was complete")
