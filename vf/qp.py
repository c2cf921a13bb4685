"""The constrained least squares of a tick, solved by OSQP on persistent workspaces.

    minimise over Δq   ½ ‖J Δq − d‖² + ½ λ ‖Δq‖²
    subject to         G Δq ≥ b,   lower ≤ Δq ≤ upper

What OSQP is given is the same problem in coordinates where it is easy: with L Lᵀ = JᵀJ + λI and
u = Lᵀ Δq the objective becomes the distance to a point, ½ ‖u − u*‖². Rows are scaled to unit
length and u is in millimetres, so that OSQP's tolerances and its step size ρ mean the same on any
arm in any pose. Three things follow from this shape:

- If u* obeys every row it is the answer, and no solver is asked. If it does not, but its projection
  on the row it breaks most obeys every row, that is the answer: nine contacts in ten are of one
  plane. The same projection, on the rows that OSQP found active, turns OSQP's answer into the
  exact one.
- If u = 0 is feasible, the answer lies in the ball with the diameter [0, u*]. Rows that hold
  throughout that ball are left out: of dozens of planes a handful reach the solver.

Every solve starts from zero with the same settings, so the answer depends on the problem alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import osqp
from numba import njit
from scipy import sparse

from vf.planes import FloatArray

MM = 1e3  # [mm/m]
TOLERANCE = 1e-4  # OSQP's primal and dual tolerance [mm]
RHO = 2.0
ITERATIONS = 500
ADAPT = 50  # iterations between looks at ρ: counted, never timed, or runs would not repeat


class Solver(IntEnum):
    """How a tick's optimum was found."""

    FREE = 0  # the unconstrained optimum obeys every row
    SOLVED = 1
    NOT_CONVERGED = 2  # iterations spent; the best iterate is returned
    INFEASIBLE = 3  # no Δq obeys the rows; zero is returned
    IDLE = 4  # nothing was asked
    PROJECTED = 5  # one row binds: its projection obeys every other

    def __str__(self) -> str:
        return self.name.lower().replace("_", " ")


@dataclass(frozen=True)
class Solution:
    """Optimum of one problem.

    Attributes:
        dq: (n,) joint step, within its bounds [rad or m].
        multipliers: (m,) of the rows of G, ≥ 0 and zero where a row does not bind; for rows in
            metres the distance by which a row pushes the tip back [m].
        solver: how it was found.
        iterations: of OSQP.
    """

    dq: FloatArray
    multipliers: FloatArray
    solver: Solver
    iterations: int


class ConstrainedLeastSquares:
    """Solver for problems of n joints, with OSQP workspaces for 8, 16, 32, … rows.

    The workspaces up to `capacity` rows are built by the constructor. More rows (the paper's rule
    and the naive baseline know no bound) get theirs when they first come. Not thread-safe.
    """

    def __init__(self, n: int, capacity: int = 128) -> None:
        if n < 1:
            raise ValueError(f"the number of joints must be positive, got {n}")
        self.n = n
        self._workspaces: dict[int, _Workspace] = {}
        self._factor = np.empty((n, n))
        self._best = np.empty(n)
        self._x = np.empty(n)
        self._endless = np.full(n, np.inf)
        self._grow(capacity)
        rows = 8
        while rows <= capacity:
            self._workspaces[rows] = _Workspace(n, rows)
            rows *= 2

    def _grow(self, rows: int) -> None:
        self._rows = np.empty((rows, self.n))
        self._bounds = np.empty(rows)
        self._y = np.empty(rows)
        self._scales = np.empty(rows)
        self._origin = np.empty(rows, dtype=np.int64)

    def solve(
        self,
        J: FloatArray,
        d: FloatArray,
        damping: float,
        G: FloatArray,
        b: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        pace: FloatArray | None = None,
    ) -> Solution:
        """Solve one problem; finite inputs are the caller's duty.

        Args:
            J: (k, n) task Jacobian [m per unit of the joint].
            d: (k,) desired task step [m].
            damping: λ > 0 [m²].
            G, b: (m, n), (m,) rows G Δq ≥ b.
            lower, upper: (n,) bounds with lower ≤ 0 ≤ upper.
            pace: (n,) shorten d so that its unconstrained step moves no joint farther than this:
                the tip still heads straight for its goal. None: as far as d asks.
        """
        m = len(b)
        if m + 2 * self.n > len(self._bounds):
            self._grow(2 * (m + 2 * self.n))
        dq = np.zeros(self.n)
        multipliers = np.zeros(m)
        solver, count = _attempt(
            J, d, damping, G, b, lower, upper, self._endless if pace is None else pace,
            self._factor, self._best, self._rows, self._bounds, self._scales, self._origin,
            self._x, self._y, dq, multipliers,
        )  # fmt: skip
        if count == 0:
            return Solution(dq, multipliers, _SOLVERS[solver], 0)
        size = 8
        while size < count:
            size *= 2
        workspace = self._workspaces.get(size)
        if workspace is None:
            workspace = self._workspaces[size] = _Workspace(self.n, size)
        solver, iterations = workspace.solve(self._rows, self._bounds, count, self._best)
        if solver is Solver.INFEASIBLE:
            return Solution(dq, multipliers, solver, iterations)
        # OSQP's answer is good to its tolerance; the active set it found gives the exact one.
        x, y = workspace.x.copy(), workspace.y.copy()
        if _settle(self._best, self._rows, self._bounds, count, 4 * self.n, x, y):
            solver = Solver.SOLVED
        _recover(
            x, y, count, self._factor, self._scales, self._origin,
            lower, upper, dq, multipliers,
        )  # fmt: skip
        return Solution(dq, multipliers, solver, iterations)


class _Workspace:
    """One OSQP problem: min ½‖u‖² − u*·u subject to A u ≥ l, with a dense A of fixed size."""

    def __init__(self, n: int, rows: int) -> None:
        problem = osqp.OSQP()
        problem.setup(
            sparse.eye(n, format="csc"),
            np.zeros(n),
            sparse.csc_matrix(np.ones((rows, n))),
            np.full(rows, -np.inf),
            np.full(rows, np.inf),
            verbose=False,
            eps_abs=TOLERANCE,
            eps_rel=0.0,
            eps_prim_inf=1e-6,
            rho=RHO,
            adaptive_rho=True,
            adaptive_rho_interval=ADAPT,
            scaling=0,  # rows and objective already have unit length
            check_termination=5,
            check_dualgap=False,
            max_iter=ITERATIONS,
            polishing=False,
        )
        # The wrapper's update() and solve() copy and build namespaces for longer than a solve
        # takes here; the extension object beneath is the same solver without them.
        self._osqp = problem._solver
        self._x0 = np.zeros(n)
        self._y0 = np.zeros(rows)
        self._linear = np.empty(n)
        self._values = np.zeros(rows * n)  # column-major
        self._low = np.full(rows, -np.inf)
        self.x = np.zeros(n)
        self.y = np.zeros(rows)

    def solve(
        self, rows: FloatArray, bounds: FloatArray, count: int, best: FloatArray
    ) -> tuple[Solver, int]:
        _pack(rows, bounds, count, best, self._values, self._low, self._linear)
        self._osqp.update_data_vec(q=self._linear, l=self._low, u=None)
        self._osqp.update_data_mat(P_x=None, P_i=None, A_x=self._values, A_i=None)
        self._osqp.warm_start(self._x0, self._y0)
        self._osqp.solve()
        info = self._osqp.info
        status, iterations = info.status_val, info.iter
        self.x = self._osqp.solution.x
        self.y = self._osqp.solution.y
        if iterations >= ADAPT:
            self._osqp.update_rho(RHO)  # as new for the next tick
        if status == osqp.SolverStatus.OSQP_SOLVED:
            return Solver.SOLVED, iterations
        if status in _INFEASIBLE or not np.isfinite(self.x).all():
            return Solver.INFEASIBLE, iterations
        return Solver.NOT_CONVERGED, iterations


_SOLVERS = tuple(Solver)  # by value: looking one up this way costs a tenth of calling the class
_INFEASIBLE = (
    osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE,
    osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE_INACCURATE,
    osqp.SolverStatus.OSQP_DUAL_INFEASIBLE,
    osqp.SolverStatus.OSQP_DUAL_INFEASIBLE_INACCURATE,
)


@njit(cache=True, nogil=True)
def _reduce(  # type: ignore[no-untyped-def]
    J, d, damping, G, b, lower, upper, pace,
    factor, best, rows, bounds, scales, origin, dq,
):  # fmt: skip
    """Factor, unconstrained optimum and the rows that matter; 0 rows: `dq` is the answer, −1: none.

    `origin` is the row of G, or −1 − j for the lower and −1 − n − j for the upper bound of joint j.
    """
    k, n = J.shape
    for i in range(n):
        for j in range(i + 1):
            h = damping if i == j else 0.0
            for r in range(k):
                h += J[r, i] * J[r, j]
            for r in range(j):
                h -= factor[i, r] * factor[j, r]
            factor[i, j] = np.sqrt(h) if i == j else h / factor[j, j]
    for i in range(n):
        h = 0.0
        for r in range(k):
            h += J[r, i] * d[r]
        for r in range(i):
            h -= factor[i, r] * best[r]
        best[i] = h / factor[i, i]
    for i in range(n - 1, -1, -1):
        h = best[i]
        for r in range(i + 1, n):
            h -= factor[r, i] * dq[r]
        dq[i] = h / factor[i, i]
    excess = 1.0
    for j in range(n):
        if abs(dq[j]) > excess * pace[j]:
            excess = abs(dq[j]) / pace[j]
    for j in range(n):
        best[j] /= excess
        dq[j] /= excess

    free = True
    highest = 0.0
    for i in range(b.shape[0]):
        value = 0.0
        for j in range(n):
            value += G[i, j] * dq[j]
        free &= value >= b[i]
        highest = max(highest, b[i])
    for j in range(n):
        free &= lower[j] <= dq[j] <= upper[j]
    if free:
        return 0

    length = 0.0
    for j in range(n):
        best[j] *= 1e3
        length += best[j] * best[j]
    # Where a row asks for motion (b > 0) zero is infeasible; the ball is widened by a generous
    # multiple of that motion instead of being placed exactly. What slips out, `verify` catches.
    half = 0.5 * np.sqrt(length) + 8.0 * 1e3 * highest
    count = 0
    for i in range(b.shape[0] + 2 * n):
        if i < b.shape[0]:
            for j in range(n):
                h = G[i, j]
                for r in range(j):
                    h -= factor[j, r] * rows[count, r]
                rows[count, j] = h / factor[j, j]
            bound = b[i]
            origin[count] = i
        else:
            c = (i - b.shape[0]) % n
            sign = 1.0 if i < b.shape[0] + n else -1.0
            for j in range(n):
                h = sign if j == c else 0.0
                for r in range(j):
                    h -= factor[j, r] * rows[count, r]
                rows[count, j] = h / factor[j, j]
            bound = lower[c] if sign > 0.0 else -upper[c]
            origin[count] = -1 - (i - b.shape[0])
        norm = 0.0
        middle = 0.0
        for j in range(n):
            norm += rows[count, j] * rows[count, j]
            middle += rows[count, j] * best[j]
        norm = np.sqrt(norm)
        if norm < 1e-12:  # no joint moves the tip along this normal
            if bound > 0.0:
                return -1
            continue
        bound *= 1e3 / norm
        if 0.5 * middle / norm - half > bound + 1e-9:
            continue
        for j in range(n):
            rows[count, j] /= norm
        bounds[count] = bound
        scales[count] = norm
        count += 1
    if count == 0:
        # Only rounding stood between the unconstrained optimum and its bounds.
        for j in range(n):
            dq[j] = min(max(dq[j], lower[j]), upper[j])
    return count


@njit(cache=True, nogil=True)
def _recover(x, y, count, factor, scales, origin, lower, upper, dq, multipliers):  # type: ignore[no-untyped-def]
    """Joint step and multipliers in the caller's coordinates."""
    n = x.shape[0]
    for i in range(n - 1, -1, -1):
        h = x[i] * 1e-3
        for r in range(i + 1, n):
            h -= factor[r, i] * dq[r]
        dq[i] = h / factor[i, i]
    for j in range(n):
        dq[j] = min(max(dq[j], lower[j]), upper[j])
    for i in range(count):
        if origin[i] >= 0 and y[i] < 0.0:
            multipliers[origin[i]] = -y[i] * 1e-3 / scales[i]


@njit(cache=True, nogil=True)
def _worst(best, rows, bounds, count, y):  # type: ignore[no-untyped-def]
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


@njit(cache=True, nogil=True)
def _settle(best, rows, bounds, count, changes, x, y):  # type: ignore[no-untyped-def]
    """Project u* on the active rows (y < 0), all at once, and take that if it is the optimum.

    It is when it obeys every row and every multiplier has the right sign; then x and y are exact
    and the answer is True. Otherwise up to `changes` times a row with a multiplier of the wrong
    sign leaves the active ones, or else the most broken row joins them.
    """
    n = best.shape[0]
    active = np.empty(n, dtype=np.int64)
    gram = np.empty((n, n))
    c = np.empty(n)
    u = np.empty(n)
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
            h = bounds[active[a]]
            for j in range(n):
                h -= rows[active[a], j] * best[j]
            c[a] = h
            for b in range(a + 1):
                h = 0.0
                for j in range(n):
                    h += rows[active[a], j] * rows[active[b], j]
                for r in range(b):
                    h -= gram[a, r] * gram[b, r]
                gram[a, b] = h if a == b else h / gram[b, b]
            if gram[a, a] < 1e-10:  # depends on those before it: they speak for it
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
                u[j] += c[a] * rows[active[a], j]
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
            y[:] = 0.0
            for a in range(k):
                y[active[a]] = -c[a]
            return True
        if k == n:
            return False
        active[k] = row
        k += 1
    return False


@njit(cache=True, nogil=True)
def _attempt(  # type: ignore[no-untyped-def]
    J, d, damping, G, b, lower, upper, pace,
    factor, best, rows, bounds, scales, origin, x, y, dq, multipliers,
):  # fmt: skip
    """All that can be had without OSQP, in one call from Python: solver and 0, or rows for OSQP."""
    count = _reduce(
        J, d, damping, G, b, lower, upper, pace, factor, best, rows, bounds, scales, origin, dq
    )
    if count == 0:
        return 0, 0
    if count < 0:
        dq[:] = 0.0
        return 3, 0
    _worst(best, rows, bounds, count, y)
    if _settle(best, rows, bounds, count, 0, x, y):
        _recover(x, y, count, factor, scales, origin, lower, upper, dq, multipliers)
        return 5, 0
    dq[:] = 0.0
    return 1, count


@njit(cache=True, nogil=True)
def _pack(rows, bounds, count, best, values, low, linear):  # type: ignore[no-untyped-def]
    n = best.shape[0]
    size = low.shape[0]
    for i in range(size):
        low[i] = bounds[i] if i < count else -np.inf
        for j in range(n):
            values[j * size + i] = rows[i, j] if i < count else 0.0
    for j in range(n):
        linear[j] = -best[j]
