"""DAQP, a dual active set method, exact to rounding.

D. Arnström, A. Bemporad, D. Axehill, "A Dual Active-Set Solver for Embedded Quadratic Programming
Using Recursive LDLᵀ Updates", IEEE Transactions on Automatic Control, 2022.
"""

from __future__ import annotations

import daqp
import numpy as np

from vf.planes import FloatArray
from vf.qp.solver import Answer, Solver

UNBOUNDED = 1e30
TOLERANCE = 1e-9  # primal [mm]
ITERATIONS = 1000
OPTIMAL, ROUGHLY, INFEASIBLE = 1, 2, -1  # of its exit flags


class Daqp:
    """Every solve starts from no active row. Keeps nothing, so any number of rows will do."""

    def __init__(self, n: int, capacity: int) -> None:
        self._eye = np.eye(n)

    def solve(self, best: FloatArray, rows: FloatArray, bounds: FloatArray) -> Answer:
        k = len(bounds)
        u, _value, flag, info = daqp.solve(
            self._eye, -best, rows, np.full(k, UNBOUNDED), bounds, np.zeros(k, dtype=np.int32),
            primal_tol=TOLERANCE, iter_limit=ITERATIONS,
        )  # fmt: skip
        x, y = np.asarray(u), np.asarray(info["lam"])
        iterations = int(info["iterations"])
        if flag in (OPTIMAL, ROUGHLY):
            return Solver.SOLVED, x, y, iterations
        if flag == INFEASIBLE or not np.isfinite(x).all():
            return Solver.INFEASIBLE, x, y, iterations
        return Solver.NOT_CONVERGED, x, y, iterations
