"""The constrained least squares of a tick.

    minimise over Δq   ½ ‖J Δq − d‖² + ½ λ ‖Δq‖²
    subject to         G Δq ≥ b,   lower ≤ Δq ≤ upper

A solver is given the same problem in coordinates where it is simple: with L Lᵀ = JᵀJ + λI and
u = Lᵀ Δq the objective becomes the distance to a point, ½ ‖u − u*‖². Rows are scaled to unit
length and u is in millimetres, so that a solver's tolerances and step sizes mean the same on any
arm in any pose. Two things follow from this form:

- If u* obeys every row it is the answer, and no solver is asked. If it does not, it is projected on
  the row it violates most, which in nine contacts of ten is the answer: one plane is active. Else
  rows are added to those it is projected on, or removed: an answer that obeys all rows with
  multipliers of the right sign is exact. The same projection, on the rows that the solver
  found active, turns its answer into the exact one.
- If u = 0 is feasible, the answer lies in the ball with the diameter [0, u*]. Rows that hold
  throughout that ball are left out: of dozens of planes a few are left for the solver.

Every solve starts anew with the same settings, so the answer depends on the problem alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vf.planes import FloatArray
from vf.qp.active_set import answer, attempt, finish, left_over, scratch_size
from vf.qp.solver import Solver, backend

__all__ = ["ConstrainedLeastSquares", "Solution", "Solver"]


@dataclass(frozen=True)
class Solution:
    """Optimum of one problem.

    Attributes:
        dq: (n,) joint step, within its bounds [rad or m].
        multipliers: (m,) of the rows of G, ≥ 0 and zero where a row does not bind; for rows in
            metres the distance by which a row pushes the tip back [m].
        solver: how it was found.
        iterations: of the solver.
    """

    dq: FloatArray
    multipliers: FloatArray
    solver: Solver
    iterations: int


class ConstrainedLeastSquares:
    """Problems of n joints, solved by one of `vf.SOLVERS`.

    A solver is prepared for `capacity` rows; more are taken too. Not thread-safe.

    Raises:
        ValueError: n is not positive, or the solver is unknown.
        RuntimeError: the solver is not installed.
    """

    def __init__(self, n: int, capacity: int = 128, solver: str = "osqp") -> None:
        if n < 1:
            raise ValueError(f"the number of joints must be positive, got {n}")
        self.n = n
        self._backend = backend(solver, n, capacity)
        self._endless = np.full(n, np.inf)
        self._reserve(capacity - 2 * n)

    def _reserve(self, rows: int) -> None:
        """Have room for problems with that many rows of G."""
        self._rows = max(rows, 1)
        self._scratch = np.zeros(scratch_size(self.n, self._rows + 2 * self.n))
        self._multipliers = np.zeros(self._rows)

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
        if m > self._rows:
            self._reserve(2 * m)
        code, count = attempt(
            J, d, damping, G, b, lower, upper, self._endless if pace is None else pace,
            m, self._scratch, self._multipliers,
        )  # fmt: skip
        solver, iterations = Solver(code), 0
        if count:
            left = left_over(self._scratch, self.n, count)
            solver, x, y, iterations = self._backend.solve(*left)
            if solver is not Solver.INFEASIBLE and finish(
                x, y, count, lower, upper, self._scratch, self._multipliers
            ):
                solver = Solver.SOLVED
        dq = answer.py_func(self._scratch, self.n)
        return Solution(dq.copy(), self._multipliers[:m].copy(), solver, iterations)
