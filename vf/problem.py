"""The least squares problem of a tick from arm, target and planes, and the checks of its answer.

All kernels: what `vf.Controller.step` does between its calls of arm, fixtures and solver.
"""

from __future__ import annotations

import numpy as np

from vf.haptics import master_force
from vf.kernels import njit
from vf.qp_kernels import attempt, carve

# Reject targets farther than this from the base [m].
FARTHEST_TARGET = 10.0
# Reject joint positions beyond this [rad or m]: hundreds of turns, and rounding grows with them.
JOINT_RANGE = 1e4
# Rows are tightened by this against the planes that are verified, ten times OSQP's tolerance, so
# that a tick in contact does not miss by rounding [m].
TIGHTENING = 1e-6
# Share of what is missing to the standoff that a tick wins back.
RECOVERY = 0.5
SWEEPS = 16


@njit(cache=True)
def usable(p, R):  # type: ignore[no-untyped-def]
    """Whether p (3,) is near enough and R (3, 3) a rotation: finite, orthonormal, right-handed."""
    for k in range(3):
        if not abs(p[k]) < FARTHEST_TARGET:
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
def rotation_log(R, w):  # type: ignore[no-untyped-def]
    """Rotation vector w (3,) [rad] of the rotation matrix R (3, 3), up to half a turn."""
    w[0] = 0.5 * (R[2, 1] - R[1, 2])
    w[1] = 0.5 * (R[0, 2] - R[2, 0])
    w[2] = 0.5 * (R[1, 0] - R[0, 1])
    sine = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    if cosine > -0.99:
        scale = angle / sine if sine > 1e-12 else 1.0
        for k in range(3):
            w[k] *= scale
        return
    # Near half a turn the skew part vanishes; (R + Rᵀ)/2 − cos·I = (1 − cos) a aᵀ does not.
    k = 0
    for j in range(1, 3):
        if R[j, j] > R[k, k]:
            k = j
    sign = 1.0 if w[k] >= 0.0 else -1.0
    norm = 0.0
    for j in range(3):
        w[j] = 0.5 * (R[j, k] + R[k, j]) - (cosine if j == k else 0.0)
        norm += w[j] * w[j]
    scale = sign * angle / np.sqrt(norm)
    for j in range(3):
        w[j] *= scale


@njit(cache=True)
def _prepare(  # type: ignore[no-untyped-def]
    J, x, R, goal, R_goal, radius, length, q, lowest, highest, task, desired, lower, upper
):
    """Weighted task Jacobian, clamped desired step, and the joint bounds of this tick."""
    n = J.shape[1]
    turn = np.empty((3, 3))
    w = np.empty(3)
    for i in range(3):
        for j in range(3):
            turn[i, j] = R_goal[i, 0] * R[j, 0] + R_goal[i, 1] * R[j, 1] + R_goal[i, 2] * R[j, 2]
    rotation_log(turn, w)
    move = 0.0
    spin = 0.0
    for k in range(3):
        desired[k] = goal[k] - x[k]
        desired[3 + k] = length * w[k]
        move += desired[k] * desired[k]
        spin += desired[3 + k] * desired[3 + k]
    move = np.sqrt(move)
    spin = np.sqrt(spin)
    for k in range(3):
        if move > radius:
            desired[k] *= radius / move
        if spin > radius:
            desired[3 + k] *= radius / spin
    for j in range(n):
        for k in range(3):
            task[k, j] = J[k, j]
            task[3 + k, j] = length * J[3 + k, j]
        # A joint pushed beyond its limit may stay or come back, so that zero is always allowed.
        lower[j] = min(lowest[j] - q[j], 0.0)
        upper[j] = max(highest[j] - q[j], 0.0)


@njit(cache=True)
def _height(normals, i, x):  # type: ignore[no-untyped-def]
    """n·x of plane i [m]."""
    return normals[i, 0] * x[0] + normals[i, 1] * x[1] + normals[i, 2] * x[2]


@njit(cache=True)
def space(normals, points, first, last, x):  # type: ignore[no-untyped-def]
    """How far x (3,) is in front of the nearest of the planes first … last − 1 [m], inf: none.

    Seen from what gave the planes, their points (m, 3), not from where they stand.
    """
    least = np.inf
    for i in range(first, last):
        height = _height(normals, i, x) - _height(normals, i, points[i])
        least = min(least, height)
    return least


@njit(cache=True)
def _rows(normals, offsets, points, rules, m, x, J, standoff, tip_radius, rows, bounds):  # type: ignore[no-untyped-def]
    """Rows n·J Δq ≥ b of the planes; returns the nearest point's distance and the worst deficit.

    A tool below the standoff is asked to come out by a share of what is missing. Walls closer than
    two standoffs cannot both be obeyed, so the requests are first reconciled in the tip's space:
    projections give a motion v, and no row asks for more than v does. Towards the farther of two
    such walls v may go as far as its plane lets it.
    """
    n = J.shape[1]
    nearest = np.inf
    deficit = 0.0
    for i in range(m):
        d2 = 0.0
        height = 0.0
        level = 0.0
        for k in range(3):
            d2 += (x[k] - points[i, k]) ** 2
            height += normals[i, k] * x[k]
            level += normals[i, k] * points[i, k]
        nearest = min(nearest, d2)
        for j in range(n):
            rows[i, j] = normals[i, 0] * J[0, j] + normals[i, 1] * J[1, j] + normals[i, 2] * J[2, j]
        if rules[i] == 4:
            bounds[i] = min(offsets[i] - height, 0.0)  # as it is: nothing to recover from
            continue
        missing = level + standoff + tip_radius - height
        deficit = max(deficit, missing)
        # A plane moved beyond the standoff is obeyed, but being on it is nothing to recover from.
        missing = max(missing, min(offsets[i] - height, 0.0)) + TIGHTENING
        bounds[i] = RECOVERY * missing if missing > 0.0 else missing
    nearest = np.sqrt(nearest)
    if deficit + TIGHTENING <= 0.0:
        return nearest, deficit
    v0 = v1 = v2 = 0.0
    for _ in range(SWEEPS):
        moved = False
        for i in range(m):
            gap = bounds[i] - (normals[i, 0] * v0 + normals[i, 1] * v1 + normals[i, 2] * v2)
            if gap > 1e-10:
                v0 += gap * normals[i, 0]
                v1 += gap * normals[i, 1]
                v2 += gap * normals[i, 2]
                moved = True
        if not moved:
            break
    if moved:
        # No motion, or none that is found so soon, meets all requests. Averaged projections go to
        # the middle between walls that ask for opposite things, however many planes a wall has.
        alike = np.ones(m)
        for i in range(m):
            for j in range(m):
                if i != j and bounds[j] > 0.0:
                    alike[i] += max(_height(normals, i, normals[j]), 0.0)
        v0 = v1 = v2 = 0.0
        for _ in range(SWEEPS):
            g0 = g1 = g2 = total = 0.0
            for i in range(m):
                gap = bounds[i] - (normals[i, 0] * v0 + normals[i, 1] * v1 + normals[i, 2] * v2)
                if gap > 1e-10:
                    weight = 1.0 / alike[i]
                    g0 += weight * gap * normals[i, 0]
                    g1 += weight * gap * normals[i, 1]
                    g2 += weight * gap * normals[i, 2]
                    total += weight
            if total == 0.0:
                break
            v0 += g0 / total
            v1 += g1 / total
            v2 += g2 / total
    share = 1.0
    for i in range(m):
        gain = normals[i, 0] * v0 + normals[i, 1] * v1 + normals[i, 2] * v2
        if gain < min(bounds[i], 0.0):
            # Half of the room there is, as the tip's path is not straight.
            room = bounds[i]
            if room > 0.0:
                room = 0.5 * (offsets[i] - _height(normals, i, x))
            if gain < room:
                share = min(share, max(room / gain, 0.0))
    for i in range(m):
        if bounds[i] > 0.0:
            gain = normals[i, 0] * v0 + normals[i, 1] * v1 + normals[i, 2] * v2
            bounds[i] = min(bounds[i], share * gain)
    return nearest, deficit


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
def obeys(normals, offsets, floors, m, radius, longest, x, y, bulge):  # type: ignore[no-untyped-def]
    """Whether a step from x to y, and its path, keep to the ball and the first m planes.

    Args:
        floors: (≥ m,) what the path must not sink below, see `Planes`.
        radius: that the planes are valid in [m].
        longest: the step may be [m].
        bulge: how far the path may leave the chord [m].
    """
    d2 = (y[0] - x[0]) ** 2 + (y[1] - x[1]) ** 2 + (y[2] - x[2]) ** 2
    if not (np.sqrt(d2) + bulge <= radius and d2 <= longest * longest):
        return False
    for i in range(m):
        height = normals[i, 0] * y[0] + normals[i, 1] * y[1] + normals[i, 2] * y[2]
        if not height >= offsets[i]:
            return False
        start = normals[i, 0] * x[0] + normals[i, 1] * x[1] + normals[i, 2] * x[2]
        if not min(height, start) - bulge >= floors[i]:
            return False
    return True


# Rows of the table that a controller hands to `plan` and `report`, each (n,) …
TASK, LOWER, UPPER, LOWEST, HIGHEST, REACH, HORIZON, REVOLUTE = 0, 6, 7, 8, 9, 10, 11, 12
TABLE = 13
# … and entries of its list of numbers.
DESIRED, STANDOFF, TIP_RADIUS, LENGTH, DAMPING, GAIN, CAP, TIP_REACH, GUARDED, BULGE = (
    0, 6, 7, 8, 9, 10, 11, 12, 13, 14
)  # fmt: skip
NUMBERS = 15


@njit(cache=True)
def plan(  # type: ignore[no-untyped-def]
    q, T, J, goal, normals, offsets, points, rules, m, radius,
    table, numbers, G, b, scratch, multipliers, q_new,
):  # fmt: skip
    """From planes to the joint positions to be checked, as far as no other library is needed.

    Args:
        q: (n,) joint positions.
        T, goal: (4, 4) poses of tip and target.
        J: (6, n).
        normals, offsets, points, rules: fields of `Planes`, of which the first m count.
        radius: they are valid in.
        table, numbers: see `TASK` and `DESIRED`; task, bounds and desired step are written.
        G, b: (≥ m, n), (≥ m,) the planes' rows, written.
        scratch, multipliers: of `ConstrainedLeastSquares`, written.
        q_new: (n,) written where no rows are left for OSQP.

    Returns:
        Code of the `Solver`, −1: the goal is not usable; rows left for OSQP; distance of the
        nearest plane's point [m]; worst deficit to the standoff [m]; whether q_new is another q.
    """
    if not usable(goal[:3, 3], goal[:3, :3]):
        return -1, 0, np.inf, 0.0, False
    x = T[:3, 3]
    desired = numbers[:6]
    lower, upper = table[LOWER], table[UPPER]
    _prepare(
        J, x, T[:3, :3], goal[:3, 3], goal[:3, :3], radius, numbers[LENGTH],
        q, table[LOWEST], table[HIGHEST], table[:6], desired, lower, upper,
    )  # fmt: skip
    nearest, deficit = _rows(
        normals, offsets, points, rules, m, x, J, numbers[STANDOFF], numbers[TIP_RADIUS], G, b
    )
    solver, count = attempt(
        table[:6], desired, numbers[DAMPING], G, b, lower, upper, table[HORIZON],
        m, scratch, multipliers,
    )  # fmt: skip
    moves = False
    if count == 0:
        moves = move(q, J, scratch, table, numbers, q_new)
    return solver, count, nearest, deficit, moves


@njit(cache=True)
def move(q, J, scratch, table, numbers, q_new):  # type: ignore[no-untyped-def]
    """q_new = q + the solver's step, shortened to what a tick allows; whether there is one.

    How far the tip may leave the chord on the way is left in the numbers.
    """
    n = q.shape[0]
    dq = carve(scratch, n)[3]
    share = pace(dq, table[REACH], J, numbers[TIP_REACH])
    moves = False
    for j in range(n):
        step = share * dq[j]
        moves |= step != 0.0
        # The sum may round to just beyond a limit.
        q_new[j] = min(max(q[j] + step, min(table[LOWEST, j], q[j])), max(table[HIGHEST, j], q[j]))
    numbers[BULGE] = sagitta(J, dq, share, table[REVOLUTE]) if numbers[GUARDED] > 0.0 else 0.0
    return moves


@njit(cache=True)
def report(  # type: ignore[no-untyped-def]
    q_new, T, T_new, goal, normals, offsets, points, triangles, rules, floors, m, radius, longest,
    table, numbers, multipliers, check, whole, out,
):  # fmt: skip
    """Check the tip at q_new, and write what there is to say about it: whether it may go there.

    Args:
        T, T_new, goal: (4, 4) poses of the tip before and after, and of the target.
        check: False: it stays where it is, or was checked before.
        whole: whether the planes are written too.
        out: written if it may: force (3), limits of the joints (n), multipliers (m), and where
            `whole` normals (3m), offsets (m), points (3m), triangles (m), rules (m).
    """
    x, y = T[:3, 3], T_new[:3, 3]
    if check and not obeys(normals, offsets, floors, m, radius, longest, x, y, numbers[BULGE]):
        return False
    n = q_new.shape[0]
    out[:3] = master_force(y, goal[:3, 3], numbers[GAIN], numbers[CAP])
    for j in range(n):
        if q_new[j] >= table[HIGHEST, j]:
            out[3 + j] = 1.0
        else:
            out[3 + j] = -1.0 if q_new[j] <= table[LOWEST, j] else 0.0
    at = 3 + n
    for i in range(m):
        out[at + i] = multipliers[i]
    if whole:
        at += m
        for i in range(m):
            for k in range(3):
                out[at + 3 * i + k] = normals[i, k]
                out[at + 4 * m + 3 * i + k] = points[i, k]
            out[at + 3 * m + i] = offsets[i]
            out[at + 7 * m + i] = triangles[i]
            out[at + 8 * m + i] = rules[i]
    return True
