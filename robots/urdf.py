"""Franka Panda and UR5 from the URDF files of the package example-robot-data, each with a probe.

The files end at the hand or the flange, where a rigid probe is added along +z; its point is the
arm's tip.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from math import pi
from pathlib import Path

import fast_simplification
import numpy as np
import pinocchio as pin
import trimesh

from robots import collada, numeric
from robots.arm import Arm
from robots.drawing import Body, Color, Drawing, body, rod
from robots.instrument import Capsule, Point, rigid

_TRIANGLES = 60_000  # of a whole arm's drawing
_PANDA = "panda_description/urdf/panda.urdf"
_UR5 = "ur_description/urdf/ur5_robot.urdf"
_FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
_PANDA_HOLDER = "panda_hand_tcp"  # between the tips of the shut fingers
_UR5_HOLDER = "tool0"  # the flange

PROBE_LENGTH = 0.1
"""From the frame that holds the probe to the probe's point [m]."""
_PROBE_RADIUS = 0.0025  # [m]
_POINT_LENGTH = 0.02  # of the tapered end [m]
_BETWEEN_FINGERS = 0.015  # of the panda's probe [m]
_STEEL: Color = (176, 182, 188)
_TIP = "probe_tip"

# Capsules around the last links: name, radius [m], frame, start and end there [m].
_PANDA_LINKS = (
    ("fingers", 0.027, "panda_hand", (0.0, -0.007, 0.088), (0.0, 0.007, 0.088)),
    ("hand", 0.044, "panda_hand", (0.0, -0.075, 0.030), (0.0, 0.075, 0.030)),
    ("flange", 0.051, "panda_hand", (0.0, -0.064, -0.033), (0.0, 0.060, -0.033)),
    ("wrist", 0.077, "panda_joint6", (0.022, 0.009, 0.0), (0.089, 0.009, 0.0)),
    ("forearm", 0.069, "panda_joint5", (0.0, 0.010, -0.241), (0.0, 0.064, 0.002)),
)
_UR5_LINKS = (
    ("flange", 0.044, "wrist_3_joint", (0.0, 0.061, 0.0), (0.0, 0.075, 0.0)),
    ("wrist 2", 0.057, "wrist_2_joint", (0.0, 0.010, 0.092), (0.0, -0.011, 0.090)),
    ("wrist 1", 0.057, "wrist_1_joint", (0.0, 0.090, -0.011), (0.0, 0.090, 0.010)),
    ("forearm", 0.065, "elbow_joint", (0.0, 0.028, -0.002), (0.0, -0.001, 0.388)),
)


def load_panda() -> Arm:
    """Franka Panda with a probe of `PROBE_LENGTH` in its locked fingers; tip: the probe's point."""
    neutral = (0.0, -pi / 4, 0.0, -3 * pi / 4, 0.0, pi / 2, pi / 4)
    model = _with_probe(_locked(_model(_PANDA), _FINGERS), _PANDA_HOLDER)
    capsules = _capsules(model, _PANDA_HOLDER, -_BETWEEN_FINGERS, _PANDA_LINKS)
    return Arm("panda", model, _TIP, neutral, numeric.inverse, _panda_drawing, capsules)


def load_ur5() -> Arm:
    """Universal Robots UR5 with a probe of `PROBE_LENGTH` on its flange; tip: the probe's point.

    At rest the elbow is up and the probe points down, its tip 0.45 m in front of the base's axis
    and 0.25 m above its foot.
    """
    shoulder, elbow = -1.638, 1.846
    neutral = (0.0, shoulder, elbow, -pi / 2 - shoulder - elbow, -pi / 2, 0.0)
    model = _with_probe(_model(_UR5), _UR5_HOLDER)
    capsules = _capsules(model, _UR5_HOLDER, 0.0, _UR5_LINKS)
    return Arm("ur5", model, _TIP, neutral, numeric.inverse, _ur5_drawing, capsules)


def _with_probe(model: pin.Model, holder: str) -> pin.Model:
    """The model with the frame `_TIP` at the point of a probe held by the frame `holder`."""
    held = model.getFrameId(holder)
    frame = model.frames[held]
    T_joint_tip = frame.placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, PROBE_LENGTH]))
    model.addFrame(
        pin.Frame(_TIP, frame.parentJoint, held, T_joint_tip, pin.FrameType.OP_FRAME), False
    )
    return model


def _capsules(
    model: pin.Model,
    holder: str,
    root: float,
    links: tuple[tuple[str, float, str, Point, Point], ...],
) -> tuple[Capsule, ...]:
    """The probe, from `root` [m] along its holder's z to the tip, and the links."""
    along = ((0.0, 0.0, root), (0.0, 0.0, PROBE_LENGTH - _PROBE_RADIUS))
    found = []
    for name, radius, frame, start, end in (("probe", _PROBE_RADIUS, holder, *along), *links):
        placed = model.frames[model.getFrameId(frame)]
        joint = model.names[placed.parentJoint]
        ends = [placed.placement.act(np.array(point)).tolist() for point in (start, end)]
        found.append(rigid(name, radius, joint, tuple(ends[0]), tuple(ends[1])))
    return tuple(found)


def _probe_drawing(urdf: str, locked: tuple[str, ...], holder: str, socket: float) -> Body:
    """A tapered rod to the tip; `socket` [m] is the radius of the disc it stands on (0: none)."""
    model = _locked(_model(urdf), locked)
    frame = model.frames[model.getFrameId(holder)]
    waist = [0.0, 0.0, PROBE_LENGTH - _POINT_LENGTH]
    parts = [
        # It begins between the fingers.
        rod([0.0, 0.0, 0.0 if socket else -_BETWEEN_FINGERS], waist, _PROBE_RADIUS),
        rod(waist, [0.0, 0.0, PROBE_LENGTH], _PROBE_RADIUS, end_radius=1e-4),
    ]
    if socket:
        parts.append(rod([0.0, 0.0, 0.0], [0.0, 0.0, 0.008], socket, chamfer=1e-3))
        parts.append(rod([0.0, 0.0, 0.008], [0.0, 0.0, 0.03], 0.3 * socket, _PROBE_RADIUS))
    for part in parts:
        part.apply_transform(frame.placement.homogeneous)
    return body("probe", model.names[frame.parentJoint], _STEEL, *parts)


def _share() -> Path:
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError as error:
        raise RuntimeError("the package example-robot-data is not installed") from error
    return Path(str(package.locate_file("cmeel.prefix/share")))


def _path(urdf: str) -> str:
    return str(_share() / "example-robot-data" / "robots" / urdf)


def _model(urdf: str) -> pin.Model:
    return pin.buildModelFromUrdf(_path(urdf))


def _locked(model: pin.Model, joints: tuple[str, ...]) -> pin.Model:
    """The model with some joints fixed at zero."""
    ids = [int(model.getJointId(name)) for name in joints]
    return pin.buildReducedModel(model, ids, np.zeros(model.nq))


@cache
def _panda_drawing() -> Drawing:
    probe = _probe_drawing(_PANDA, _FINGERS, _PANDA_HOLDER, socket=0.0)
    return Drawing((*_bodies(_PANDA, _FINGERS, linear=False), probe))


@cache
def _ur5_drawing() -> Drawing:
    # These files hold linear colours, not sRGB.
    probe = _probe_drawing(_UR5, (), _UR5_HOLDER, socket=0.025)
    return Drawing((*_bodies(_UR5, (), linear=True), probe))


def _bodies(urdf: str, locked: tuple[str, ...], linear: bool) -> tuple[Body, ...]:
    """The visual meshes as bodies of one colour, decimated to `_TRIANGLES`."""
    model = _model(urdf)
    share = str(_share())
    visual = pin.buildGeomFromUrdf(
        model, _path(urdf), pin.GeometryType.VISUAL, package_dirs=[share]
    )
    ids = [int(model.getJointId(name)) for name in locked]
    model, visual = pin.buildReducedModel(model, visual, ids, np.zeros(model.nq))
    merged: dict[tuple[str, Color], list[trimesh.Trimesh]] = {}
    for shape in visual.geometryObjects:
        frame = model.names[shape.parentJoint]
        for color, vertices, faces in collada.read(Path(shape.meshPath)):
            mesh = trimesh.Trimesh(vertices * shape.meshScale, faces)
            mesh.apply_transform(shape.placement.homogeneous)
            merged.setdefault((frame, _rgb(color, linear)), []).append(mesh)
    total = sum(len(mesh.faces) for meshes in merged.values() for mesh in meshes)
    keep = min(1.0, _TRIANGLES / total)
    return tuple(
        body(f"{frame}_{i}", frame, color, *[_decimated(mesh, keep) for mesh in meshes])
        for i, ((frame, color), meshes) in enumerate(merged.items())
    )


def _decimated(mesh: trimesh.Trimesh, keep: float) -> trimesh.Trimesh:
    """The mesh decimated to a share `keep` of its triangles; small ones are unchanged."""
    if keep >= 1.0 or len(mesh.faces) < 200:
        return mesh
    vertices, faces = fast_simplification.simplify(
        np.asarray(mesh.vertices, dtype=np.float32), np.asarray(mesh.faces), 1.0 - keep
    )
    return trimesh.Trimesh(vertices, faces)


def _rgb(color: tuple[float, float, float], linear: bool) -> Color:
    value = np.clip(np.array(color), 0.0, 1.0)
    if linear:
        value = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    red, green, blue = np.rint(255 * value).astype(int)
    return int(red), int(green), int(blue)
