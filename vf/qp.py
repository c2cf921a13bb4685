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

import ctypes
import signal
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import osqp
from scipy import sparse

from vf.planes import FloatArray
from vf.qp_kernels import attempt, finish, pack, scratch_size

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
        self._endless = np.full(n, np.inf)
        self.reserve(capacity - 2 * n)
        rows = 8
        while rows <= capacity:
            self._workspaces[rows] = _Workspace(n, rows)
            rows *= 2

    def reserve(self, rows: int) -> None:
        """Have room for problems with that many rows of G.

        Attributes that change: `scratch`, what the kernels work in; `dq` (n,), a view of it, and
        `multipliers` (≥ rows,): the answer of the last problem.
        """
        n = self.n
        self.rows = max(rows, 0)
        self.scratch = np.zeros(scratch_size(n, self.rows + 2 * n))
        self.dq = self.scratch[n * n + 2 * n : n * n + 3 * n]
        self.multipliers = np.zeros(max(self.rows, 1))

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
        if m > self.rows:
            self.reserve(2 * m)
        solver, count = attempt(
            J, d, damping, G, b, lower, upper, self._endless if pace is None else pace,
            m, self.scratch, self.multipliers,
        )  # fmt: skip
        code, iterations = self.complete(solver, count, lower, upper)
        return Solution(self.dq.copy(), self.multipliers[:m].copy(), code, iterations)

    def complete(
        self, solver: int, count: int, lower: FloatArray, upper: FloatArray
    ) -> tuple[Solver, int]:
        """What `qp_kernels.attempt` began, by OSQP if rows are left for it: solver and iterations.

        The answer is in `dq` and `multipliers`, and lasts until the next problem.
        """
        if count == 0:
            return _SOLVERS[solver], 0
        size = 8
        while size < count:
            size *= 2
        workspace = self._workspaces.get(size)
        if workspace is None:
            workspace = self._workspaces[size] = _Workspace(self.n, size)
        code, iterations = workspace.solve(self.scratch, count)
        if code is Solver.INFEASIBLE:
            return code, iterations
        # OSQP's answer is good to its tolerance; the active set it found gives the exact one.
        if finish(
            workspace.x, workspace.y, count, 4 * self.n, lower, upper,
            self.scratch, self.multipliers,
        ):  # fmt: skip
            code = Solver.SOLVED
        return code, iterations


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

    def solve(self, scratch: FloatArray, count: int) -> tuple[Solver, int]:
        """Solve for the first `count` rows of the scratch; the answer is in x and y."""
        pack(scratch, count, self._values, self._low, self._linear)
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
        self.x = self._osqp.solution.x
        self.y = self._osqp.solution.y
        if iterations >= ADAPT:
            self._osqp.update_rho(RHO)  # as new for the next tick
        if status == osqp.SolverStatus.OSQP_SOLVED:
            return Solver.SOLVED, iterations
        if status in _INFEASIBLE or not np.isfinite(self.x).all():
            return Solver.INFEASIBLE, iterations
        return Solver.NOT_CONVERGED, iterations

    def _run(self) -> None:
        self._osqp.warm_start(self._x0, self._y0)
        self._osqp.solve()


def osqp_was_interrupted() -> bool:
    """Whether SIGINT came while OSQP solved, the last time that it did.

    While it solves, OSQP handles SIGINT itself and Python's handler does not hear of it: whoever
    finds that one came raises it again. OSQP keeps the process's handler in one place, so two
    threads may not solve at once.
    """
    return bool(_heard())


# Its status says so only where it came before the last iteration. A build without handler has none.
_heard = getattr(ctypes.PyDLL(osqp.OSQP().ext.__file__), "osqp_is_interrupted", int)
_SOLVERS = tuple(Solver)  # by value: looking one up this way costs a tenth of calling the class
_INFEASIBLE = (
    osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE,
    osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE_INACCURATE,
    osqp.SolverStatus.OSQP_DUAL_INFEASIBLE,
    osqp.SolverStatus.OSQP_DUAL_INFEASIBLE_INACCURATE,
)
