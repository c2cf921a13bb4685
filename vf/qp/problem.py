"""The least squares problem of a tick from arm, target and planes, and the checks of its answer.

All kernels, called by `vf.tick.tick`. Planes are records (PLANE,), see `vf.layout`. A plane holds
one guarded point, a row of `places` (p, 3), whose linear Jacobian is that row of `jacobians`
(p, 3, n).
"""

from __future__ import annotations

import numpy as np

from vf.kernels import njit
from vf.layout import (
    CARRY,
    FLOOR,
    FOOT,
    KEEP,
    NORMAL,
    OFFSET,
    PATH_LIMIT,
    POINT,
    RULE,
    STEP_LIMIT,
    THICKNESS,
)
from vf.planes import Rule

# Reject targets farther than this from the base [m].
FARTHEST_TARGET = 10.0
# Reject joint positions beyond this [rad or m]: hundreds of turns, and rounding grows with them.
JOINT_RANGE = 1e4
# Rows are tightened by this against the planes that are verified, ten times OSQP's tolerance, so
# that a tick in contact does not miss by rounding [m].
TIGHTENING = 1e-6
# Share of the deficit to the standoff that a tick recovers.
RECOVERY = 0.5
# Out of a margin a tick leads by no more than this [m]: 10 mm/s at 1 kHz.
LED_OUT = 1e-5
SWEEPS = 16
EXIT = int(Rule.EXIT)


@njit(cache=True)
def usable(R):  # type: ignore[no-untyped-def]
    """Whether a pose (3, 4) is usable: not too far, its rotation orthonormal and right-handed."""
    for k in range(3):
        if not abs(R[k, 3]) < FARTHEST_TARGET:
            return False
    for i in range(3):
        for j in range(3):
            dot = R[i, 0] * R[j, 0] + R[i, 1] * R[j, 1] + R[i, 2] * R[j, 2]
            if not abs(dot - (1.0 if i == j else 0.0)) < 1e-4:
                return False
    det = (
        R[0, 0] * (R[1, 1] * R[2, 2] - R[1, 2] * R[2, 1])
        - R[0, 1] * (R[1, 0] * R[2, 2] - R[1, 2] * R[2, 0])
        + R[0, 2] * (R[1, 0] * R[2, 1] - R[1, 1] * R[2, 0])
    )
    return det > 0.0


@njit(cache=True)
def rotation_log(r00, r01, r02, r10, r11, r12, r20, r21, r22):  # type: ignore[no-untyped-def]
    """Rotation vector (three numbers) [rad] of a rotation matrix, up to half a turn."""
    x, y, z = 0.5 * (r21 - r12), 0.5 * (r02 - r20), 0.5 * (r10 - r01)
    sine = np.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (r00 + r11 + r22 - 1.0)
    angle = np.arctan2(sine, cosine)
    if cosine > -0.99:
        scale = angle / sine if sine > 1e-12 else 1.0
        return x * scale, y * scale, z * scale
    # Near half a turn the skew part vanishes; (R + Rᵀ)/2 − cos·I = (1 − cos) a aᵀ does not. Of its
    # columns the longest is taken.
    xy, xz, yz = 0.5 * (r01 + r10), 0.5 * (r02 + r20), 0.5 * (r12 + r21)
    if r00 >= r11 and r00 >= r22:
        ax, ay, az, sign = r00 - cosine, xy, xz, x
    elif r11 >= r22:
        ax, ay, az, sign = xy, r11 - cosine, yz, y
    else:
        ax, ay, az, sign = xz, yz, r22 - cosine, z
    scale = angle / np.sqrt(ax * ax + ay * ay + az * az)
    if sign < 0.0:
        scale = -scale
    return ax * scale, ay * scale, az * scale


@njit(cache=True)
def _dot(a, i, b, j):  # type: ignore[no-untyped-def]
    """Of row i of one pose and row j of another: an entry of R_a R_bᵀ."""
    return a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2]


@njit(cache=True)
def desired_step(start, goal, radius, length, desired):  # type: ignore[no-untyped-def]
    """The step (6,) [m] from one pose (3, 4) to another, each half shortened to `radius` [m].

    Rotation is weighed by `length` [m/rad].
    """
    desired[3], desired[4], desired[5] = rotation_log(
        _dot(goal, 0, start, 0), _dot(goal, 0, start, 1), _dot(goal, 0, start, 2),
        _dot(goal, 1, start, 0), _dot(goal, 1, start, 1), _dot(goal, 1, start, 2),
        _dot(goal, 2, start, 0), _dot(goal, 2, start, 1), _dot(goal, 2, start, 2),
    )  # fmt: skip
    move = 0.0
    spin = 0.0
    for k in range(3):
        desired[k] = goal[k, 3] - start[k, 3]
        desired[3 + k] *= length
        move += desired[k] * desired[k]
        spin += desired[3 + k] * desired[3 + k]
    move = np.sqrt(move)
    spin = np.sqrt(spin)
    for k in range(3):
        if move > radius:
            desired[k] *= radius / move
        if spin > radius:
            desired[3 + k] *= radius / spin


@njit(cache=True)
def height(plane, x):  # type: ignore[no-untyped-def]
    """n·x of a plane's record and a point (3,) [m]."""
    return plane[NORMAL] * x[0] + plane[NORMAL + 1] * x[1] + plane[NORMAL + 2] * x[2]


@njit(cache=True)
def fill_rows(  # type: ignore[no-untyped-def]
    planes, m, places, jacobians, standoff, guards, moves, approach, rows, bounds
):  # fmt: skip
    """Rows n·J Δq ≥ b of the first m planes, written to rows (≥ m, n) and bounds (≥ m,).

    Below standoff and margin, b > 0 asks for a motion that recovers a share of the deficit, slowly
    of what is missing to a margin. Between two
    walls less than two standoffs apart both requests cannot be met, so they are first reconciled
    for the tip: projections give a motion v, and no row asks for more than v provides. Towards the
    farther of two such walls v may go as far as that wall's plane allows. The same for every other
    guarded point by itself; one that no joint moves is asked for nothing.

    Args:
        planes: records, those of a point next to each other.
        guards: (p, GUARD) see `vf.layout`.
        moves: whether planes have their CARRY, by how much they ask for motion beside all that;
            else it is set to 0.
        approach: share of the room above its plane that a point may use up, 1: all of it.

    Returns:
        Distance of the nearest foot of a plane of the tip, and the worst deficit of any point to
        the standoff [m].
    """
    n = rows.shape[1]
    nearest = np.inf
    deficit = 0.0
    for i in range(m):
        plane = planes[i]
        point = int(plane[POINT])
        x, J = places[point], jacobians[point]
        if point == 0:
            d2 = 0.0
            for k in range(3):
                d2 += (x[k] - plane[FOOT + k]) ** 2
            nearest = min(nearest, d2)
        for j in range(n):
            rows[i, j] = (
                plane[NORMAL] * J[0, j] + plane[NORMAL + 1] * J[1, j] + plane[NORMAL + 2] * J[2, j]
            )
        # Relative to the structure, that is where the plane would take x.
        if not moves:
            plane[CARRY] = 0.0
        above = height(plane, x) + plane[CARRY]
        if plane[RULE] == EXIT:
            bounds[i] = min(plane[OFFSET] - above, 0.0)  # nothing to recover
            continue
        if point > 0 and not rows[i].any():
            bounds[i] = min(plane[OFFSET] - above, 0.0)
            continue
        missing = (
            height(plane, plane[FOOT : FOOT + 3]) + plane[KEEP] + guards[point, THICKNESS] - above
        )
        deficit = max(deficit, missing)
        # A plane moved beyond the standoff is obeyed, but a tip on it has no deficit.
        missing = max(missing, min(plane[OFFSET] - above, 0.0)) + TIGHTENING
        bounds[i] = RECOVERY * missing if missing > 0.0 else missing
        if plane[KEEP] > standoff:
            to_standoff = RECOVERY * max(missing - (plane[KEEP] - standoff), 0.0)
            bounds[i] = min(bounds[i], to_standoff + LED_OUT)
    nearest = np.sqrt(nearest)
    if deficit + TIGHTENING > 0.0:
        first = 0
        for i in range(1, m + 1):
            if i == m or planes[i, POINT] != planes[first, POINT]:
                _reconcile(planes[first:i], i - first, places, bounds[first:i])
                first = i
    if approach < 1.0:
        for i in range(m):
            if bounds[i] < 0.0:
                bounds[i] *= approach
    if moves:
        for i in range(m):
            if planes[i, POINT] == 0.0 or rows[i].any():
                bounds[i] += planes[i, CARRY]
    return nearest, deficit


@njit(cache=True)
def _along(plane, v):  # type: ignore[no-untyped-def]
    """n·v."""
    return plane[NORMAL] * v[0] + plane[NORMAL + 1] * v[1] + plane[NORMAL + 2] * v[2]


@njit(cache=True)
def _reconcile(planes, m, places, bounds):  # type: ignore[no-untyped-def]
    """Lower the bounds to what one motion of the tip can provide, see `fill_rows`."""
    v = np.zeros(3)
    moved = False
    for _ in range(SWEEPS):
        moved = False
        for i in range(m):
            gap = bounds[i] - _along(planes[i], v)
            if gap > 1e-10:
                for k in range(3):
                    v[k] += gap * planes[i, NORMAL + k]
                moved = True
        if not moved:
            break
    if moved:
        # No motion was found that meets all requests. Averaged projections converge to the middle
        # between walls with opposite requests, independent of how many planes a wall has.
        alike = np.ones(m)
        for i in range(m):
            for j in range(m):
                if i != j and bounds[j] > 0.0:
                    alike[i] += max(_along(planes[i], planes[j, NORMAL : NORMAL + 3]), 0.0)
        g = np.empty(3)
        v[:] = 0.0
        for _ in range(SWEEPS):
            g[:] = 0.0
            total = 0.0
            for i in range(m):
                gap = bounds[i] - _along(planes[i], v)
                if gap > 1e-10:
                    weight = 1.0 / alike[i]
                    for k in range(3):
                        g[k] += weight * gap * planes[i, NORMAL + k]
                    total += weight
            if total == 0.0:
                break
            for k in range(3):
                v[k] += g[k] / total
    share = 1.0
    for i in range(m):
        gain = _along(planes[i], v)
        if gain < min(bounds[i], 0.0):
            # Half of the space there is, as the tip's path is not straight.
            left = bounds[i]
            if left > 0.0:
                x = places[int(planes[i, POINT])]
                left = 0.5 * (planes[i, OFFSET] - (height(planes[i], x) + planes[i, CARRY]))
            if gain < left:
                share = min(share, max(left / gain, 0.0))
    for i in range(m):
        if bounds[i] > 0.0:
            bounds[i] = min(bounds[i], share * _along(planes[i], v))


@njit(cache=True)
def pace(dq, reach, J, tip_reach):  # type: ignore[no-untyped-def]
    """Largest share ≤ 1 of the joint step dq (n,) that fits into a tick.

    Every joint stays within its reach (n,), and the tip (Jacobian J (6, n), linear rows first)
    within tip_reach [m], which may be inf.
    """
    share = 1.0
    for j in range(dq.shape[0]):
        if abs(dq[j]) * share > reach[j]:
            share = reach[j] / abs(dq[j])
    if tip_reach < np.inf:
        square = 0.0
        for i in range(3):
            v = 0.0
            for j in range(dq.shape[0]):
                v += J[i, j] * dq[j]
            square += v * v
        length = np.sqrt(square)  # [m]
        if share * length > tip_reach:
            share = tip_reach / length
    return share


@njit(cache=True)
def sagitta(J, dq, share, revolute):  # type: ignore[no-untyped-def]
    """Bound on how far the tip leaves its chord [m] while the joints move from q to q + share·dq.

    With all joints moving in proportion the tip's path is p(τ), τ from 0 to 1, and leaves its chord
    by at most ⅛ max|p″|. For joints i ≤ j the second derivative ∂²p/∂q_i∂q_j is the axis of i times
    the column J_j for a revolute i, and zero for a prismatic one. The length of a column depends
    only on the joints after its own, and changes on the way by at most what they move the tip.

    Args:
        J: (6, n), linear rows first, at q.
        dq: (n,) [rad or m].
        revolute: (n,) 1 for a revolute joint, 0 for a prismatic one.
    """
    bend = 0.0
    later = 0.0  # Σ |J_j||dq_j| over the joints after i, the longest on the way
    for i in range(dq.shape[0] - 1, -1, -1):
        turn = share * abs(dq[i])
        column = np.sqrt(J[0, i] ** 2 + J[1, i] ** 2 + J[2, i] ** 2)
        moved = turn * (column + revolute[i] * later)
        bend += revolute[i] * turn * (moved + 2.0 * later)
        later += moved
    return 0.125 * bend


@njit(cache=True)
def farthest(J, reach):  # type: ignore[no-untyped-def]
    """How far the tip can go [m] when every joint goes as far as its reach (n,)."""
    far = 0.0
    for j in range(reach.shape[0]):
        far += reach[j] * np.sqrt(J[0, j] ** 2 + J[1, j] ** 2 + J[2, j] ** 2)
    return far


@njit(cache=True)
def widest(J, reach):  # type: ignore[no-untyped-def]
    """Bound on J dq [m] while every joint goes no farther than its reach (n,).

    |Σ ±w_j|² is at most Σ |w_i·w_j|, with w_j the columns times the reach. For columns at right
    angles to each other, as of the first three joints of a PSM, that is their diagonal and not,
    as `farthest` has it, the sum of their lengths.
    """
    square = 0.0
    for i in range(reach.shape[0]):
        for j in range(i + 1):
            dot = abs(J[0, i] * J[0, j] + J[1, i] * J[1, j] + J[2, i] * J[2, j])
            square += (1.0 if i == j else 2.0) * reach[i] * reach[j] * dot
    return np.sqrt(square)


@njit(cache=True)
def obeys(planes, m, places, trials, bulges, guards):  # type: ignore[no-untyped-def]
    """Whether steps from `places` to `trials` (p, 3), and their paths, keep to ball and planes.

    Args:
        planes: records, of which the first m count.
        bulges: (p,) how far a path may leave its chord [m].
        guards: (p, GUARD) see `vf.layout`.
    """
    for p in range(places.shape[0]):
        x, y = places[p], trials[p]
        d2 = (y[0] - x[0]) ** 2 + (y[1] - x[1]) ** 2 + (y[2] - x[2]) ** 2
        longest = guards[p, STEP_LIMIT]
        if not (np.sqrt(d2) + bulges[p] <= guards[p, PATH_LIMIT] and d2 <= longest * longest):
            return False
    for i in range(m):
        plane = planes[i]
        p = int(plane[POINT])
        end = height(plane, trials[p])
        if not end >= plane[OFFSET]:
            return False
        if not min(end, height(plane, places[p])) - bulges[p] >= plane[FLOOR]:
            return False
    return True
