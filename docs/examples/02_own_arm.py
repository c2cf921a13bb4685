"""The controller with your own arm: a Pinocchio model built here, held off a sphere.

`vf.Controller` asks of an arm for limits, the pose of the tip and its Jacobian
(`vf.controller.Kinematics`). Any Pinocchio model has all of that.
"""

import numpy as np
import pinocchio as pin

import meshes
import vf


class Scara:
    """Two revolute joints about z, a prismatic one along z, and a revolute one for the tool."""

    def __init__(self) -> None:
        model = pin.Model()
        parent = 0
        for kind, name, place, low, high, speed in (
            # placed in the joint before it [m]; limits and speed in rad or m
            (pin.JointModelRZ, "shoulder", (0.0, 0.0, 0.3), -2.0, 2.0, 1.5),
            (pin.JointModelRZ, "elbow", (0.25, 0.0, 0.0), -2.5, 2.5, 1.5),
            (pin.JointModelPZ, "quill", (0.2, 0.0, 0.0), -0.25, 0.0, 0.2),
            (pin.JointModelRZ, "tool", (0.0, 0.0, 0.0), -3.0, 3.0, 3.0),
        ):
            parent = model.addJoint(
                parent, kind(), pin.SE3(np.eye(3), np.array(place)), name,
                np.array([1.0]), np.array([speed]), np.array([low]), np.array([high]),
            )  # fmt: skip
        tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.05]))
        self.frame = model.addFrame(pin.Frame("tip", parent, tip, pin.FrameType.OP_FRAME))
        self.model, self.data = model, model.createData()
        self.lower = model.lowerPositionLimit
        self.upper = model.upperPositionLimit
        self.velocity = model.velocityLimit
        self.revolute = np.array([1.0, 1.0, 0.0, 1.0])

    def tip(self, q: np.ndarray) -> pin.SE3:
        return self.kinematics(q)[0]

    def kinematics(self, q: np.ndarray) -> tuple[pin.SE3, np.ndarray]:
        """Pose of the tip and its Jacobian (6, 4), both along the axes of the arm's base."""
        J = pin.computeFrameJacobian(
            self.model, self.data, np.asarray(q), self.frame, pin.LOCAL_WORLD_ALIGNED
        )
        return pin.SE3(pin.updateFramePlacement(self.model, self.data, self.frame)), J


arm = Scara()
q = np.array([0.4, 0.6, -0.02, 0.0])
start = arm.tip(q)

# The anatomy in the arm's base frame: a sphere with its top 20 mm below the tip.
vertices, faces = meshes.arrays("sphere")
top = vertices[vertices[:, 2].argmax()]
surface = vf.Surface.from_arrays(vertices - top + start.translation - [0, 0, 0.02], faces)

controller = vf.Controller(arm, [vf.MeshFixture(surface)], vf.Settings(dt=1e-3))

# The proxy, where the hand wants the tool, is 30 mm below: inside the sphere.
proxy = pin.SE3(start.rotation, start.translation - [0.0, 0.0, 0.03])
for tick in range(400):
    step = controller.step(q, proxy)
    q = step.q  # what the servos get; next time start from where the robot is
    if tick % 80 == 0:
        gap = surface.nearest(step.tip.translation)[0]
        print(f"{tick:4d} ms  {step.status.name:8} {gap * 1e3:7.3f} mm, planes: {len(step.planes)}")

gap = surface.nearest(step.tip.translation)[0]
print(f"rests {gap * 1e6:.0f} µm off the surface, force {np.linalg.norm(step.force):.2f} N")
assert not surface.inside(step.tip.translation)
assert gap > 19e-6
