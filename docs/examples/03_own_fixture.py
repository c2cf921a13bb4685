"""Your own fixture beside the mesh: a cone that the tool must stay in, such as a port.

A fixture has `planes`, `inside` and `depth` (`vf.Fixture`). A convex region is the simple case: at
any x the planes that support it there, and a step that obeys them cannot leave it.
"""

import numpy as np
import pinocchio as pin

import meshes
import robots
import vf


class Cone:
    """Keeps the tip in a cone that opens upwards: |p_xy| <= slope * p_z, p from the apex."""

    radius = None  # asks for no motion sphere of its own
    certified = True  # the region is convex: a checked step does not leave it

    def __init__(self, apex: np.ndarray, slope: float, sides: int = 16) -> None:
        self.apex = np.asarray(apex, dtype=float)  # [m]
        # A pyramid of many sides inside the cone: its faces are the planes, at every x the same.
        angle = 2 * np.pi * np.arange(sides) / sides
        slope = slope * np.cos(np.pi / sides)
        inwards = np.column_stack([-np.cos(angle), -np.sin(angle), np.full(sides, slope)])
        self.normals = inwards / np.linalg.norm(inwards, axis=1)[:, None]

    def planes(
        self, x: np.ndarray, radius: float, standoff: float, tip_radius: float, inside: bool
    ) -> vf.Planes:
        offsets = self.normals @ self.apex + tip_radius + standoff
        # Two rules of every fixture: a plane never cuts off x itself (standing still is always
        # allowed), and the answer depends on the arguments alone.
        offsets = np.minimum(offsets, self.normals @ x)
        count = len(offsets)
        return vf.Planes(
            normals=self.normals,
            offsets=offsets,
            points=np.tile(self.apex, (count, 1)),
            triangles=np.full(count, -1),  # of no mesh
            rules=np.full(count, int(vf.Rule.NAIVE)),
            radius=radius,
        )

    def inside(self, x: np.ndarray) -> bool:
        """Whether x is where the tool must never be; outside the cone a step may only go back."""
        return False

    def depth(self, x: np.ndarray) -> float:
        return 0.0


# A sphere of 30 mm radius with its centre in the origin, and a port above it.
surface = meshes.load("sphere")
port = Cone(apex=[0.0, 0.0, 0.02], slope=0.3)

arm = robots.load("point")  # three slides: joint values are the tip's position [m]
controller = vf.Controller(arm, [vf.MeshFixture(surface), port], vf.Settings(dt=1e-3))


def follow(q: np.ndarray, goal: list[float], ticks: int = 600) -> vf.Step:
    for _ in range(ticks):
        step = controller.step(q, pin.SE3(np.eye(3), np.array(goal)))
        q = step.q
    return step


def told(step: vf.Step) -> str:
    """What holds the tool: the planes with a multiplier, which push it back."""
    pushing = step.planes.triangles[step.multipliers > 1e-9]
    return f"held by planes of the mesh: {(pushing >= 0).sum()}, of the port: {(pushing < 0).sum()}"


down = follow(np.array([0.0, 0.0, 0.05]), [0.0, 0.0, 0.01])
x, y, z = down.tip.translation * 1e3
print(f"pushed down:  ({x:.2f}, {y:.2f}, {z:.2f}) mm, {told(down)}")

aside = follow(down.q, [0.02, 0.0, 0.04])
x, y, z = aside.tip.translation * 1e3
print(f"pulled aside: ({x:.2f}, {y:.2f}, {z:.2f}) mm, {told(aside)}")

assert surface.nearest(down.tip.translation)[0] > 19e-6
offset = aside.tip.translation - port.apex
assert np.hypot(offset[0], offset[1]) <= 0.3 * offset[2]
