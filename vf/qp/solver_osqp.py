"""OSQP on persistent workspaces of fixed size: an operator splitting method (ADMM)."""

from __future__ import annotations

import ctypes
import signal

import numpy as np
import osqp
from scipy import sparse

from vf.kernels import njit
from vf.planes import FloatArray
from vf.qp.solver import Answer, Solver

TOLERANCE = 1e-4  # primal and dual [mm]
RHO = 2.0
ITERATIONS = 500
ADAPT = 50  # iterations between looks at ρ: counted, never timed, or runs would not repeat


class Osqp:
    """Workspaces for 8, 16, 32, … rows; those up to `capacity` are made by the constructor.

    More rows (the paper's rule and the naive baseline know no bound) get theirs when they first
    come. Every solve starts from zero with the same settings. Not thread-safe.
    """

    def __init__(self, n: int, capacity: int) -> None:
        self._n = n
        self._workspaces: dict[int, _Workspace] = {}
        rows = 8
        while rows <= capacity:
            self._workspaces[rows] = _Workspace(n, rows)
            rows *= 2

    def solve(self, best: FloatArray, rows: FloatArray, bounds: FloatArray) -> Answer:
        size = 8
        while size < len(bounds):
            size *= 2
        workspace = self._workspaces.get(size)
        if workspace is None:
            workspace = self._workspaces[size] = _Workspace(self._n, size)
        return workspace.solve(best, rows, bounds)


class _Workspace:
    """One problem: min ½‖u‖² − u*·u subject to A u ≥ l, with a dense A of fixed size."""

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
        # Compiled now, and not in the tick that asks first.
        _pack(self._x0, np.zeros((0, n)), np.zeros(0), self._values, self._low, self._linear)

    def solve(self, best: FloatArray, rows: FloatArray, bounds: FloatArray) -> Answer:
        _pack(best, rows, bounds, self._values, self._low, self._linear)
        self._osqp.update_data_vec(q=self._linear, l=self._low, u=None)
        self._osqp.update_data_mat(P_x=None, P_i=None, A_x=self._values, A_i=None)
        self._run()
        interrupted = False
        while osqp_was_interrupted():
            # Solved anew: what a tick gives may not depend on when somebody presses a key.
            interrupted = True
            self._osqp.update_rho(RHO)
            self._run()
        if interrupted:
            signal.raise_signal(signal.SIGINT)
        info = self._osqp.info
        status, iterations = info.status_val, info.iter
        x, y = self._osqp.solution.x, self._osqp.solution.y[: len(bounds)]
        if iterations >= ADAPT:
            self._osqp.update_rho(RHO)  # as new for the next tick
        if status == osqp.SolverStatus.OSQP_SOLVED:
            return Solver.SOLVED, x, y, iterations
        # An infeasible problem ends in a finite, huge x.
        if status in _INFEASIBLE or not np.isfinite(x).all():
            return Solver.INFEASIBLE, x, y, iterations
        return Solver.NOT_CONVERGED, x, y, iterations

    def _run(self) -> None:
        self._osqp.warm_start(self._x0, self._y0)
        self._osqp.solve()


def osqp_was_interrupted() -> bool:
    """Whether SIGINT came while OSQP solved, the last time that it did.

    While it solves, OSQP handles SIGINT itself and Python's handler does not hear of it: whoever
    finds that one came raises it again. OSQP keeps the process's handler in one place, so two
    threads may not solve at once.
    """
    return bool(_interrupted())


# Its status says so only where it came before the last iteration. A build without handler has none.
_interrupted = getattr(ctypes.PyDLL(osqp.OSQP().ext.__file__), "osqp_is_interrupted", int)
_INFEASIBLE = (
    osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE,
    osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE_INACCURATE,
    osqp.SolverStatus.OSQP_DUAL_INFEASIBLE,
    osqp.SolverStatus.OSQP_DUAL_INFEASIBLE_INACCURATE,
)


@njit(cache=True)
def _pack(best, rows, bounds, values, low, linear):  # type: ignore[no-untyped-def]
    """The problem as OSQP wants it: A by columns, l, linear term; open rows at the end."""
    size, count = low.shape[0], bounds.shape[0]
    for i in range(size):
        low[i] = bounds[i] if i < count else -np.inf
        for j in range(linear.shape[0]):
            values[j * size + i] = rows[i, j] if i < count else 0.0
    for j in range(linear.shape[0]):
        linear[j] = -best[j]
