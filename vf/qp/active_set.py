"""The kernels of `vf.qp.least_squares`: which rows can matter, and the active set of the optimum.

They share one scratch array, divided by `carve`: every array argument of a call from Python costs
time.
"""

from __future__ import annotations

import numba
import numpy as np

from vf.kernels import floats_at, njit
from vf.planes import FloatArray
from vf.qp.solver import Solver

EXTRA = 4  # numbers a row takes in the scratch besides its n coefficients
# What `reduce` returns where no rows are left to consider.
FREE_ROWS, NO_WAY = 0, -1
CHANGES = 4  # of the active rows that `settle` may make, for each joint
FREE, SOLVED, INFEASIBLE = int(Solver.FREE), int(Solver.SOLVED), int(Solver.INFEASIBLE)
PROJECTED = int(Solver.PROJECTED)


def scratch_size(n: int, rows: int) -> int:
    """Length of the scratch for n joints and that many rows, the joints' bounds among them."""
    return 2 * (n * n + 3 * n) + rows * (n + EXTRA)


@njit(cache=True)
def row_count(scratch, n):  # type: ignore[no-untyped-def]
    """How many rows the scratch has room for."""
    return (scratch.shape[0] - 2 * (n * n + 3 * n)) // (n + EXTRA)


@njit(cache=True, inline="always")
def carve(scratch, n):  # type: ignore[no-untyped-def]
    """Parts: factor (n, n), best, x, dq (n,), rows (r, n), bounds, scales, y, origin (r,)."""
    rows = row_count(scratch, n)
    a = n * n
    b = a + 3 * n
    c = b + rows * n
    start = scratch.ctypes.data  # by address: to reshape is a call of a function
    return (
        numba.carray(floats_at(start), (n, n)),
        scratch[a : a + n],
        scratch[a + n : a + 2 * n],
        scratch[a + 2 * n : b],
        numba.carray(floats_at(start + 8 * b), (rows, n)),
        scratch[c : c + rows],
        scratch[c + rows : c + 2 * rows],
        scratch[c + 2 * rows : c + 3 * rows],
        scratch[c + 3 * rows : c + 4 * rows],
    )


@njit(cache=True, inline="always")
def carve_rest(scratch, n):  # type: ignore[no-untyped-def]
    """What `settle` works in: gram (n, n), c, u and active (n,)."""
    a = scratch.shape[0] - n * n - 3 * n
    b = a + n * n
    return (
        numba.carray(floats_at(scratch.ctypes.data + 8 * a), (n, n)),
        scratch[b : b + n],
        scratch[b + n : b + 2 * n],
        scratch[b + 2 * n : b + 3 * n],
    )


@njit(cache=True)
def answer(scratch, n):  # type: ignore[no-untyped-def]
    """The joint step dq (n,) that was found."""
    return scratch[n * n + 2 * n : n * n + 3 * n]


def left_over(scratch: FloatArray, n: int, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The problem that `attempt` left for a solver: u* (n,), rows (count, n), bounds (count,)."""
    b = n * n + 3 * n
    c = b + row_count.py_func(scratch, n) * n
    return (
        scratch[n * n : n * n + n],
        scratch[b : b + count * n].reshape(count, n),
        scratch[c : c + count],
    )


@njit(cache=True)
def reduce(  # type: ignore[no-untyped-def]
    J, d, damping, G, b, lower, upper, pace, m,
    factor, best, rows, bounds, scales, origin, dq, inverse, norms, middles,
):  # fmt: skip
    """Factor, unconstrained optimum and how many rows matter.

    FREE_ROWS: `dq` is the answer; NO_WAY: no step obeys the rows. The factor's diagonal holds
    reciprocals: a division takes as long as several products.

    `inverse` (n, n), `norms` and `middles` (n,) are working memory.
    `origin` is the row of G, or −1 − j for the lower and −1 − n − j for the upper bound of joint j.
    """
    k, n = J.shape
    for i in range(n):
        for j in range(i + 1):
            factor[i, j] = damping if i == j else 0.0
        best[i] = 0.0
    for r in range(k):
        for i in range(n):
            for j in range(i + 1):
                factor[i, j] += J[r, i] * J[r, j]
            best[i] += J[r, i] * d[r]
    for i in range(n):
        for j in range(i):
            h = factor[i, j]
            for r in range(j):
                h -= factor[i, r] * factor[j, r]
            factor[i, j] = h * factor[j, j]
        h = factor[i, i]
        for r in range(i):
            h -= factor[i, r] * factor[i, r]
        # The damping bounds a pivot from below; rounding may not take it to zero or below.
        factor[i, i] = 1.0 / np.sqrt(max(h, damping))
        h = best[i]
        for r in range(i):
            h -= factor[i, r] * best[r]
        best[i] = h * factor[i, i]
    for i in range(n - 1, -1, -1):
        h = best[i]
        for r in range(i + 1, n):
            h -= factor[r, i] * dq[r]
        dq[i] = h * factor[i, i]
    excess = 1.0
    for j in range(n):
        if abs(dq[j]) > excess * pace[j]:
            excess = abs(dq[j]) / pace[j]
    for j in range(n):
        best[j] /= excess
        dq[j] /= excess

    free = True
    highest = 0.0
    for i in range(m):
        value = 0.0
        for j in range(n):
            value += G[i, j] * dq[j]
        free &= value >= b[i]
        highest = max(highest, b[i])
    for j in range(n):
        free &= lower[j] <= dq[j] <= upper[j]
    if free:
        return FREE_ROWS

    length = 0.0
    for j in range(n):
        best[j] *= 1e3
        length += best[j] * best[j]
    # Where a row asks for motion (b > 0) zero is infeasible; the ball is widened by a generous
    # multiple of that motion instead of being placed exactly. A row wrongly left out is caught by
    # the check of the step.
    half = 0.5 * np.sqrt(length) + 8.0 * 1e3 * highest
    count = 0
    for i in range(m):
        for j in range(n):
            h = G[i, j]
            for r in range(j):
                h -= factor[j, r] * rows[count, r]
            rows[count, j] = h * factor[j, j]
        norm = 0.0
        middle = 0.0
        for j in range(n):
            norm += rows[count, j] * rows[count, j]
            middle += rows[count, j] * best[j]
        norm = np.sqrt(norm)
        if norm < 1e-12:  # no joint moves the tip along this normal
            if b[i] > 0.0:
                return NO_WAY
            continue
        bound = b[i] * (1e3 / norm)
        if 0.5 * middle / norm - half > bound + 1e-9:
            continue
        for j in range(n):
            rows[count, j] /= norm
        bounds[count] = bound
        scales[count] = norm
        origin[count] = i
        count += 1
    # Bounds of the joints: the rows of lower and upper bounds differ in sign only.
    for c in range(n):
        for j in range(c):
            inverse[c, j] = 0.0
        inverse[c, c] = factor[c, c]
        for j in range(c + 1, n):
            h = 0.0
            for r in range(c, j):
                h -= factor[j, r] * inverse[c, r]
            inverse[c, j] = h * factor[j, j]
        norm = 0.0
        middle = 0.0
        for j in range(n):
            norm += inverse[c, j] * inverse[c, j]
            middle += inverse[c, j] * best[j]
        norms[c] = np.sqrt(norm)
        middles[c] = middle
    for side in range(2):
        sign = 1.0 - 2.0 * side
        for c in range(n):
            bound = lower[c] if side == 0 else -upper[c]
            norm = norms[c]
            if norm < 1e-12:
                if bound > 0.0:
                    return NO_WAY
                continue
            bound *= 1e3 / norm
            if 0.5 * sign * middles[c] / norm - half > bound + 1e-9:
                continue
            for j in range(n):
                rows[count, j] = sign * inverse[c, j] / norm
            bounds[count] = bound
            scales[count] = norm
            origin[count] = -1 - c - n * side
            count += 1
    if count == 0:
        # The unconstrained optimum misses its bounds by rounding only.
        for j in range(n):
            dq[j] = min(max(dq[j], lower[j]), upper[j])
    return count


@njit(cache=True)
def recover(x, y, count, factor, scales, origin, lower, upper, dq, multipliers):  # type: ignore[no-untyped-def]
    """Joint step and multipliers in the caller's coordinates."""
    n = x.shape[0]
    for i in range(n - 1, -1, -1):
        h = x[i] * 1e-3
        for r in range(i + 1, n):
            h -= factor[r, i] * dq[r]
        dq[i] = h * factor[i, i]
    for j in range(n):
        dq[j] = min(max(dq[j], lower[j]), upper[j])
    for i in range(count):
        if origin[i] >= 0.0 and y[i] < 0.0:
            multipliers[int(origin[i])] = -y[i] * 1e-3 / scales[i]


@njit(cache=True)
def mark_worst(best, rows, bounds, count, y):  # type: ignore[no-untyped-def]
    """Mark the row that u* breaks most as the only active one (y < 0)."""
    row = 0
    worst = -np.inf
    for i in range(count):
        y[i] = 0.0
        broken = bounds[i]
        for j in range(best.shape[0]):
            broken -= rows[i, j] * best[j]
        if broken > worst:
            worst = broken
            row = i
    y[row] = -1.0


@njit(cache=True)
def settle(best, rows, bounds, count, changes, x, y, scratch):  # type: ignore[no-untyped-def]
    """Project u* on the active rows (y < 0) together; True: that is the optimum, written to x, y.

    It is if it obeys every row and every multiplier has the right sign. Otherwise, up to `changes`
    times, a row with a multiplier of the wrong sign is removed from the active ones, or else the
    most violated row is added.
    """
    n = best.shape[0]
    gram, c, u, active = carve_rest(scratch, n)
    k = 0
    for _ in range(n):  # the n largest multipliers, largest first
        row = -1
        for i in range(count):
            if y[i] < -1e-9 and (row < 0 or y[i] < y[row]):
                taken = False
                for a in range(k):
                    taken |= active[a] == i
                if not taken:
                    row = i
        if row < 0:
            break
        active[k] = row
        k += 1
    for _ in range(changes + 1):
        a = 0
        while a < k:
            h = bounds[int(active[a])]
            for j in range(n):
                h -= rows[int(active[a]), j] * best[j]
            c[a] = h
            for b in range(a + 1):
                h = 0.0
                for j in range(n):
                    h += rows[int(active[a]), j] * rows[int(active[b]), j]
                for r in range(b):
                    h -= gram[a, r] * gram[b, r]
                gram[a, b] = h if a == b else h / gram[b, b]
            if gram[a, a] < 1e-10:  # linearly dependent on those before it
                k -= 1
                for b in range(a, k):
                    active[b] = active[b + 1]
                continue
            gram[a, a] = np.sqrt(gram[a, a])
            for r in range(a):
                c[a] -= gram[a, r] * c[r]
            c[a] /= gram[a, a]
            a += 1
        wrong = -1
        for a in range(k - 1, -1, -1):
            for r in range(a + 1, k):
                c[a] -= gram[r, a] * c[r]
            c[a] /= gram[a, a]
            if c[a] < 0.0 and (wrong < 0 or c[a] < c[wrong]):
                wrong = a
        if wrong >= 0:
            k -= 1
            for a in range(wrong, k):
                active[a] = active[a + 1]
            continue
        for j in range(n):
            u[j] = best[j]
            for a in range(k):
                u[j] += c[a] * rows[int(active[a]), j]
        row = -1
        worst = 1e-9
        for i in range(count):
            broken = bounds[i]
            for j in range(n):
                broken -= rows[i, j] * u[j]
            if broken > worst:
                worst = broken
                row = i
        if row < 0:
            x[:] = u
            y[:count] = 0.0
            for a in range(k):
                y[int(active[a])] = -c[a]
            return True
        if k == n:
            return False
        active[k] = row
        k += 1
    return False


@njit(cache=True)
def attempt(J, d, damping, G, b, lower, upper, pace, m, scratch, multipliers):  # type: ignore[no-untyped-def]
    """Solve for the first m rows of G without a solver if possible: how, and rows left for one.

    The answer is `dq` of the scratch and `multipliers`, written from the start.
    """
    n = J.shape[1]
    factor, best, x, dq, rows, bounds, scales, y, origin = carve(scratch, n)
    inverse, norms, middles, _ = carve_rest(scratch, n)
    for i in range(m):
        multipliers[i] = 0.0
    for j in range(n):
        dq[j] = 0.0
    count = reduce(
        J, d, damping, G, b, lower, upper, pace, m, factor, best, rows, bounds, scales, origin, dq,
        inverse, norms, middles,
    )  # fmt: skip
    if count == FREE_ROWS:
        return FREE, 0
    if count == NO_WAY:
        dq[:] = 0.0
        return INFEASIBLE, 0
    mark_worst(best, rows, bounds, count, y)
    if settle(best, rows, bounds, count, CHANGES * n, x, y, scratch):
        recover(x, y, count, factor, scales, origin, lower, upper, dq, multipliers)
        binding = 0
        for i in range(count):
            binding += y[i] < 0.0
        return PROJECTED if binding == 1 else SOLVED, 0
    dq[:] = 0.0
    return SOLVED, count


@njit(cache=True)
def finish(u, duals, count, lower, upper, scratch, multipliers):  # type: ignore[no-untyped-def]
    """Make a solver's answer exact by its active set and convert it to joints; whether it is exact.

    Args:
        u, duals: (n,), (≥ count,), see `vf.qp.solver.Backend`.
    """
    n = u.shape[0]
    factor, best, x, dq, rows, bounds, scales, y, origin = carve(scratch, n)
    x[:] = u
    y[:count] = duals[:count]
    exact = settle(best, rows, bounds, count, CHANGES * n, x, y, scratch)
    recover(x, y, count, factor, scales, origin, lower, upper, dq, multipliers)
    return exact
