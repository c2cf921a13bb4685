"""The PSM's drawing: solids that move with its joints and the links of its parallelogram.

A double parallelogram keeps the shaft on the remote centre O without any part there. In the plane
of yaw, with u = (0, −1, 0) along the yaw axis towards the base, w = (−sin q1, 0, cos q1) across it,
and φ = 0.2904 − q2:

    A = 0.516 u                          the crank's pivot on the yoke
    B = A + 0.150 (sin φ u + cos φ w)    the crank's end
    C = B − 0.516 u                      the pin on the carrier, which turns about O by q2

Dimensions [m] follow public drawings of the dVRK; the shapes are simplified.
"""

from __future__ import annotations

from functools import cache
from math import cos, pi, sin

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import NDArray

from robots.drawing import Body, Drawing, ball, bar, body, box, hull, rod

ROD_LENGTH = 0.516  # [m] OA and BC
CRANK_LENGTH = 0.150  # [m] AB and OC
CRANK_ANGLE = 0.2904  # [rad] φ at q2 = 0
LOWER_PIN = 0.085  # [m] where the lower rod's pin sits on the crank, from A

_COVER = (216, 219, 224)
_GREY = (150, 156, 165)
_DARK = (62, 67, 76)
_STEEL = (178, 184, 192)
_BRIGHT = (226, 230, 235)
_SHAFT = (48, 51, 57)
_BLUE = (38, 110, 190)

# Axes of the pitch and insertion joints' frames at q = 0, as columns in the base frame.
_R_BASE_PITCH = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
_R_BASE_INSERTION = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@cache
def drawing() -> Drawing:
    """The bodies, with the passive links "yoke", "crank", "upper_rod" and "lower_rod"."""
    parts = (_base(), _yoke(), _crank(), _rods(), _carrier(), _tool(), _wrist())
    return Drawing(tuple(b for part in parts for b in part), passive)


def passive(q: NDArray[np.float64]) -> dict[str, pin.SE3]:
    """Poses of the passive links in the base frame for a joint vector `(6,)`.

    All have x along the pitch axis. Origins: "yoke" O, z along w; "crank" A, z towards B;
    "upper_rod" B and "lower_rod" its pin, both with y along −u.
    """
    c, s = cos(q[0]), sin(q[0])
    R_yoke = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    phi = CRANK_ANGLE - q[1]
    R_crank = R_yoke @ np.array(
        [[1.0, 0.0, 0.0], [0.0, cos(phi), -sin(phi)], [0.0, sin(phi), cos(phi)]]
    )
    A = np.array([0.0, -ROD_LENGTH, 0.0])
    return {
        "yoke": pin.SE3(R_yoke, np.zeros(3)),
        "crank": pin.SE3(R_crank, A),
        "upper_rod": pin.SE3(R_yoke, A + CRANK_LENGTH * R_crank[:, 2]),
        "lower_rod": pin.SE3(R_yoke, A + LOWER_PIN * R_crank[:, 2]),
    }


def _base() -> tuple[Body, ...]:
    """The fixed housing behind the yaw bearing, on the base frame's −y."""
    return (
        body(
            "base",
            "universe",
            _COVER,
            box((-0.086, -0.773, -0.155), (0.086, -0.708, 0.073), 0.018),
            box((-0.070, -0.730, -0.155), (0.070, -0.600, -0.092), 0.015),
        ),
        body(
            "base_bearing",
            "universe",
            _DARK,
            rod((0, -0.715, 0), (0, -0.696, 0), 0.066, chamfer=0.003),
        ),
        body(
            "base_mark",
            "universe",
            _BLUE,
            box((-0.060, -0.7085, -0.130), (0.060, -0.5985, -0.122), 0.001),
        ),
    )


def _yoke() -> tuple[Body, ...]:
    """Moves with yaw: two cheeks with the crank's pivot A, and the pitch drive."""
    cheeks = [
        hull(
            np.vstack(
                [
                    bar([(0, -ROD_LENGTH, 0)] * 2, (0.034, 0.034), across, 0.003).vertices,
                    box((across[0], -0.690, -0.056), (across[1], -0.680, 0.030), 0.003).vertices,
                ]
            )
        )
        for across in ((-0.050, -0.038), (0.038, 0.050))
    ]
    drives = [
        rod((x, -ROD_LENGTH, 0), (1.9 * x, -ROD_LENGTH, 0), 0.030, chamfer=0.004)
        for x in (-0.050, 0.050)
    ]
    caps = [
        rod((1.9 * x, -ROD_LENGTH, 0), (1.95 * x, -ROD_LENGTH, 0), 0.022, chamfer=0.001)
        for x in (-0.050, 0.050)
    ]
    flange = rod((0, -0.696, 0), (0, -0.678, 0), 0.070, chamfer=0.004)
    floor = box((-0.045, -0.690, -0.056), (0.045, -0.560, -0.040), 0.004)
    return (
        body("yoke", "yoke", _GREY, flange, floor, *cheeks),
        body("pitch_drive", "yoke", _DARK, *drives),
        body("pitch_drive_caps", "yoke", _BLUE, *caps),
    )


def _crank() -> tuple[Body, ...]:
    """Two plates from A to B, and three pins."""
    ends = ((0, 0, 0), (0, 0, CRANK_LENGTH))
    plates = [bar(ends, (0.026, 0.020), x, 0.002) for x in ((-0.034, -0.025), (0.025, 0.034))]
    pins = [
        rod((-0.037, 0, z), (0.037, 0, z), 0.008, chamfer=0.001)
        for z in (0.0, LOWER_PIN, CRANK_LENGTH)
    ]
    return (body("crank", "crank", _GREY, *plates), body("crank_pins", "crank", _STEEL, *pins))


def _rods() -> tuple[Body, ...]:
    """The upper rod BC, and the lower rod, which keeps the carrier parallel."""
    ends = ((0, 0, 0), (0, ROD_LENGTH, 0))
    sides = ((-0.0225, -0.0155), (0.0155, 0.0225))
    return (
        body("upper_rod", "upper_rod", _COVER, bar(ends, (0.019, 0.019), (-0.0135, 0.0135), 0.004)),
        body(
            "upper_rod_mark",
            "upper_rod",
            _BLUE,
            box((-0.0138, 0.200, -0.003), (0.0138, 0.316, 0.003), 0.0004),
        ),
        body(
            "lower_rod", "lower_rod", _GREY, *[bar(ends, (0.010, 0.010), x, 0.0015) for x in sides]
        ),
    )


def _carrier() -> tuple[Body, ...]:
    """Moves with pitch about the remote centre: fork, insertion rail, cannula.

    Solids are given for q = 0: z up along the shaft, −y towards the base.
    """
    upright = np.array([0.0, -sin(CRANK_ANGLE), cos(CRANK_ANGLE)])
    upper, lower = CRANK_LENGTH * upright, LOWER_PIN * upright
    sides = ((-0.034, -0.025), (0.025, 0.034))
    fork = [bar((upper, lower), (0.021, 0.014), x, 0.002) for x in sides]
    fork += [bar((upper, np.array([0, -0.063, 0.215])), (0.021, 0.021), x, 0.002) for x in sides]
    pins = [
        rod((-0.037, p[1], p[2]), (0.037, p[1], p[2]), 0.008, chamfer=0.001) for p in (upper, lower)
    ]
    arm = bar((lower, np.array([0, -0.010, 0.043])), (0.012, 0.011), (-0.0245, 0.0245), 0.003)
    rail = box((-0.036, -0.088, 0.195), (0.036, -0.044, 0.510), 0.008)
    head = box((-0.038, -0.092, 0.492), (0.038, -0.036, 0.522), 0.008)
    track = box((-0.018, -0.046, 0.205), (0.018, -0.040, 0.492), 0.001)
    marks = [
        box((x - 0.0008, -0.074, 0.230), (x + 0.0008, -0.058, 0.470), 0.0004)
        for x in (-0.036, 0.036)
    ]
    cannula = rod((0, 0, 0.020), (0, 0, -0.022), 0.0060, 0.0056, chamfer=0.0006)
    funnel = rod((0, 0, 0.020), (0, 0, 0.056), 0.0062, 0.0135, chamfer=0.001)
    return (
        _upright("carrier", "pitch", _COVER, rail, head),
        _upright("carrier_fork", "pitch", _GREY, *fork, arm),
        _upright("carrier_pins", "pitch", _STEEL, *pins, cannula, funnel),
        _upright("carrier_track", "pitch", _DARK, track),
        _upright("carrier_marks", "pitch", _BLUE, *marks),
    )


def _tool() -> tuple[Body, ...]:
    """The instrument's housing on its carriage; the shaft turns with roll."""
    # In the insertion frame with z up: housing z −90 … +7 mm, the carriage behind it.
    lid = box((-0.034, -0.0215, -0.070), (0.034, 0.0215, 0.007), 0.006)
    nose = hull(
        np.vstack(
            [
                box((-0.030, -0.019, -0.074), (0.030, 0.019, -0.069), 0.004).vertices,
                box((-0.014, -0.012, -0.090), (0.014, 0.012, -0.086), 0.003).vertices,
            ]
        )
    )
    carriage = box((-0.028, -0.041, -0.030), (0.028, -0.0215, 0.007), 0.003)
    latches = [
        box((x - 0.0025, -0.010, -0.045), (x + 0.0025, 0.010, -0.020), 0.0015)
        for x in (-0.034, 0.034)
    ]
    band = box((-0.0343, -0.0218, -0.0045), (0.0343, 0.0218, 0.0005), 0.006)
    shaft = rod((0, 0, 0.090 - 0.4162), (0, 0, -0.0062), 0.004175)
    collar = rod((0, 0, -0.0075), (0, 0, -0.0052), 0.0043, chamfer=0.0004)
    clevis = [
        hull(
            [
                (x, y, z)
                for x in (-0.0022, 0.0022)
                for y in (side * 0.0022, side * 0.0036)
                for z in (-0.0060, 0.0004)
            ]
        )
        for side in (-1.0, 1.0)
    ]
    return (
        _upright("housing", "insertion", _COVER, lid),
        _upright("housing_nose", "insertion", _GREY, nose),
        _upright("carriage", "insertion", _DARK, carriage),
        _upright("housing_marks", "insertion", _BLUE, band, *latches),
        body("shaft", "roll", _SHAFT, shaft),
        body("shaft_end", "roll", _STEEL, collar, *clevis),
    )


def _wrist() -> tuple[Body, ...]:
    """The wrist link between its two axes, and the cutter, whose point is the arm's tip."""
    link = hull(
        np.vstack(
            [
                rod((0, 0, -0.0021), (0, 0, 0.0021), 0.0030, chamfer=0.0003).vertices,
                rod((0.0091, -0.0021, 0), (0.0091, 0.0021, 0), 0.0026, chamfer=0.0003).vertices,
            ]
        )
    )
    pivot = rod((0, 0, -0.0039), (0, 0, 0.0039), 0.0013, chamfer=0.0002)
    hub = rod((0, 0, -0.0026), (0, 0, 0.0026), 0.0022, chamfer=0.0003)
    blade = trimesh.util.concatenate([_blade(), hull(_neck())])
    return (
        body("wrist", "wrist_pitch", _STEEL, link),
        body("wrist_pivot", "wrist_pitch", _DARK, pivot),
        body("cutter_hub", "wrist_yaw", _BLUE, hub),
        body("cutter_blade", "wrist_yaw", _BRIGHT, blade),
        body("cutter_point", "wrist_yaw", _BRIGHT, ball((0, 0.0102 - 0.00012, 0), 0.00012)),
    )


def _neck() -> list[tuple[float, float, float]]:
    xs, zs = (-0.0009, 0.0009), (-0.0009, 0.0009)
    return [(x, y, z) for x in xs for z in zs for y in (0.001, 0.0042)]


def _blade() -> trimesh.Trimesh:
    """A scalpel blade in the x-y plane, its edge on the convex side."""
    back = [(0.0011, 0.0034), (0.0011, 0.0070)]
    turn = np.linspace(0.0, pi / 2, 9)
    belly = [(0.0 - 0.0015 * cos(t), 0.0050 + 0.0052 * sin(t)) for t in turn]
    edge = [(x, y, 0.0) for x, y in belly] + [(-0.0013, 0.0034, 0.0)]
    thick = [(x, y, z) for x, y in back for z in (-0.00035, 0.00035)]
    cheek = [(-0.0004, y, z) for y in (0.0034, 0.0062) for z in (-0.0003, 0.0003)]
    return hull(edge + thick + cheek)


def _upright(name: str, frame: str, color: tuple[int, int, int], *parts: trimesh.Trimesh) -> Body:
    """A body whose solids are given along the base frame's axes at q = 0."""
    R = {"pitch": _R_BASE_PITCH, "insertion": _R_BASE_INSERTION}[frame]
    T = np.eye(4)
    T[:3, :3] = R.T
    for part in parts:
        part.apply_transform(T)
    return body(name, frame, color, *parts)
