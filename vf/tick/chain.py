"""Kinematics of a serial arm, compiled: the pose of its tip and the Jacobian there.

A chain is one array (k + 1, 14): a row for each of the k joints between base and tip, from the
base outwards, and a last one for the tip. A row says where its frame stands in the frame of the row
before it, whose joint has moved (`ROTATION`, row by row, and `TRANSLATION` [m]), whether its joint
turns or slides (`REVOLUTE`: 1 or 0) and which entry of the joint vector moves it (`JOINT`). Every
joint moves about or along the z axis of its frame: other axes are turned there beforehand.

A point that moves with the arm is an anchor (4,): how many joints of the chain move it (0: it
stands still), and where it is [m] in the frame of the last of them.
"""

from __future__ import annotations

import numpy as np

from vf.kernels import njit

ROTATION, TRANSLATION, REVOLUTE, JOINT = 0, 9, 12, 13
LINK = 14  # numbers of a row

# A quarter turn in three parts of 33 bits, and the polynomials of sine and cosine on an eighth of a
# turn either way: those of fdlibm (Sun Microsystems, 1993).
QUARTER, QUARTER_REST, QUARTER_LAST = (
    1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21,
)  # fmt: skip
S1, S2, S3, S4, S5, S6 = (
    -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
    2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10,
)  # fmt: skip
C1, C2, C3, C4, C5, C6 = (
    4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
    -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11,
)  # fmt: skip


@njit(cache=True)
def _cosine_sine(angle):  # type: ignore[no-untyped-def]
    """Cosine and sine of an angle up to `problem.JOINT_RANGE` [rad], to a unit in the last place.

    Both at once, in a third of the time of the C library's two.
    """
    turns = np.floor(angle * (2.0 / np.pi) + 0.5)
    x = ((angle - turns * QUARTER) - turns * QUARTER_REST) - turns * QUARTER_LAST
    z = x * x
    sine = x + x * z * (S1 + z * (S2 + z * (S3 + z * (S4 + z * (S5 + z * S6)))))
    cosine = 1.0 - (
        0.5 * z - z * z * (C1 + z * (C2 + z * (C3 + z * (C4 + z * (C5 + z * C6)))))
    )  # fmt: skip
    quarter = int(turns) & 3
    if quarter == 0:
        return cosine, sine
    if quarter == 1:
        return -sine, cosine
    if quarter == 2:
        return -cosine, -sine
    return sine, -cosine


@njit(cache=True)
def tip_pose(chain, q, pose, axes):  # type: ignore[no-untyped-def]
    """Pose of the tip for the joint positions q (n,) [rad or m].

    Args:
        pose: (3, 4) written: rotation and position, base frame.
        axes: (k, 6) written: direction and a point [m] of every joint's axis, base frame.
    """
    r00 = r11 = r22 = 1.0
    r01 = r02 = r10 = r12 = r20 = r21 = 0.0
    x = y = z = 0.0
    last = chain.shape[0] - 1
    for i in range(last + 1):
        link = chain[i]
        x += r00 * link[9] + r01 * link[10] + r02 * link[11]
        y += r10 * link[9] + r11 * link[10] + r12 * link[11]
        z += r20 * link[9] + r21 * link[10] + r22 * link[11]
        a00 = r00 * link[0] + r01 * link[3] + r02 * link[6]
        a01 = r00 * link[1] + r01 * link[4] + r02 * link[7]
        r02 = r00 * link[2] + r01 * link[5] + r02 * link[8]
        a10 = r10 * link[0] + r11 * link[3] + r12 * link[6]
        a11 = r10 * link[1] + r11 * link[4] + r12 * link[7]
        r12 = r10 * link[2] + r11 * link[5] + r12 * link[8]
        a20 = r20 * link[0] + r21 * link[3] + r22 * link[6]
        a21 = r20 * link[1] + r21 * link[4] + r22 * link[7]
        r22 = r20 * link[2] + r21 * link[5] + r22 * link[8]
        r00, r01, r10, r11, r20, r21 = a00, a01, a10, a11, a20, a21
        if i == last:
            break
        axes[i, 0], axes[i, 1], axes[i, 2] = r02, r12, r22
        axes[i, 3], axes[i, 4], axes[i, 5] = x, y, z
        value = q[int(link[JOINT])]
        if link[REVOLUTE] > 0.0:
            c, s = _cosine_sine(value)
            r00, r01 = a00 * c + a01 * s, a01 * c - a00 * s
            r10, r11 = a10 * c + a11 * s, a11 * c - a10 * s
            r20, r21 = a20 * c + a21 * s, a21 * c - a20 * s
        else:
            x += r02 * value
            y += r12 * value
            z += r22 * value
    pose[0, 0], pose[0, 1], pose[0, 2], pose[0, 3] = r00, r01, r02, x
    pose[1, 0], pose[1, 1], pose[1, 2], pose[1, 3] = r10, r11, r12, y
    pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3] = r20, r21, r22, z


@njit(cache=True)
def place_points(chain, q, guards, places):  # type: ignore[no-untyped-def]
    """Positions (p, 3) of guarded points from the second on, base frame [m]; the first is the tip.

    Args:
        guards: (p, GUARD) whose first numbers are anchors.
    """
    r = np.eye(3)
    moved = np.empty((3, 3))
    o = np.zeros(3)
    for i in range(chain.shape[0]):
        for p in range(1, guards.shape[0]):
            if int(guards[p, 0]) == i:
                for k in range(3):
                    places[p, k] = (
                        o[k] + r[k, 0] * guards[p, 1] + r[k, 1] * guards[p, 2]
                        + r[k, 2] * guards[p, 3]
                    )  # fmt: skip
        if i == chain.shape[0] - 1:
            break
        link = chain[i]
        for k in range(3):
            o[k] += r[k, 0] * link[9] + r[k, 1] * link[10] + r[k, 2] * link[11]
        for k in range(3):
            for c in range(3):
                moved[k, c] = r[k, 0] * link[c] + r[k, 1] * link[3 + c] + r[k, 2] * link[6 + c]
        value = q[int(link[JOINT])]
        if link[REVOLUTE] > 0.0:
            c, s = _cosine_sine(value)
            for k in range(3):
                r[k, 0] = moved[k, 0] * c + moved[k, 1] * s
                r[k, 1] = moved[k, 1] * c - moved[k, 0] * s
                r[k, 2] = moved[k, 2]
        else:
            for k in range(3):
                o[k] += moved[k, 2] * value
                for c in range(3):
                    r[k, c] = moved[k, c]


@njit(cache=True)
def point_jacobian(chain, axes, joints, x, y, z, J):  # type: ignore[no-untyped-def]
    """Linear Jacobian (3, n), written, of the point (x, y, z) that the first `joints` move."""
    J[:] = 0.0
    for i in range(joints):
        j = int(chain[i, JOINT])
        ax, ay, az = axes[i, 0], axes[i, 1], axes[i, 2]
        if chain[i, REVOLUTE] > 0.0:
            dx, dy, dz = x - axes[i, 3], y - axes[i, 4], z - axes[i, 5]
            J[0, j] = ay * dz - az * dy
            J[1, j] = az * dx - ax * dz
            J[2, j] = ax * dy - ay * dx
        else:
            J[0, j], J[1, j], J[2, j] = ax, ay, az


@njit(cache=True)
def jacobian(chain, axes, x, y, z, J):  # type: ignore[no-untyped-def]
    """Jacobian (6, n), written, of the point (x, y, z) that moves with the last joint.

    Linear rows first, along the base frame's axes; a joint that does not move it has a column of
    zeros.

    Args:
        axes: as `tip_pose` leaves them.
    """
    J[:] = 0.0
    for i in range(chain.shape[0] - 1):
        j = int(chain[i, JOINT])
        ax, ay, az = axes[i, 0], axes[i, 1], axes[i, 2]
        if chain[i, REVOLUTE] > 0.0:
            dx, dy, dz = x - axes[i, 3], y - axes[i, 4], z - axes[i, 5]
            J[0, j] = ay * dz - az * dy
            J[1, j] = az * dx - ax * dz
            J[2, j] = ax * dy - ay * dx
            J[3, j], J[4, j], J[5, j] = ax, ay, az
        else:
            J[0, j], J[1, j], J[2, j] = ax, ay, az
