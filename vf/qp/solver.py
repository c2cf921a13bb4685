"""The interface and the registry of the solvers: they get what `vf.qp.active_set` leaves open.

A new one is a module with a class like `vf.qp.solver_osqp.Osqp`, and a line in `_FACTORIES`.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from importlib import import_module
from typing import Any, Protocol, cast

from vf.planes import FloatArray


class Solver(IntEnum):
    """How a tick's optimum was found."""

    FREE = 0  # the unconstrained optimum obeys every row
    SOLVED = 1  # several rows bind
    NOT_CONVERGED = 2  # iterations spent; the best iterate is returned
    INFEASIBLE = 3  # no Δq obeys the rows; zero is returned
    IDLE = 4  # nothing was asked
    PROJECTED = 5  # one row binds: its projection obeys every other

    def __str__(self) -> str:
        return self.name.lower().replace("_", " ")


class Backend(Protocol):
    """A solver of projections on polyhedra: min ½‖u − u*‖² subject to A u ≥ l.

    Rows of A have unit length; u, u* and l are in millimetres and of order one. The answer depends
    on the arguments alone. What is not exact is settled by the active set of the multipliers.
    """

    def solve(self, best: FloatArray, rows: FloatArray, bounds: FloatArray) -> Answer:
        """Solve for u* (n,), A (k, n) and l (k,), all contiguous and only lent."""
        ...


# Status (SOLVED, NOT_CONVERGED or INFEASIBLE), u (n,), multipliers (k,) < 0 where a row binds, and
# iterations. The arrays last until the next problem.
Answer = tuple[Solver, FloatArray, FloatArray, int]

# Module and class of each, imported when first asked for, and what has to be installed for it.
_FACTORIES = {
    "osqp": ("vf.qp.solver_osqp", "Osqp", "osqp"),
    "daqp": ("vf.qp.solver_daqp", "Daqp", "vf-sandbox[daqp]"),
}
SOLVERS = tuple(_FACTORIES)


def backend(name: str, n: int, capacity: int) -> Backend:
    """A new solver for problems of n unknowns, prepared for up to `capacity` rows.

    Raises:
        ValueError: unknown name.
        RuntimeError: its package is not installed.
    """
    check_solver(name)
    module, kind, package = _FACTORIES[name]
    try:
        factory = cast(Callable[[int, int], Backend], getattr(import_module(module), kind))
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise RuntimeError(
            f"the solver {name!r} is not installed: python -m pip install '{package}'"
        ) from error
    return factory(n, capacity)


def check_solver(name: Any) -> None:
    """ValueError unless it is one of `SOLVERS`."""
    if name not in SOLVERS:
        raise ValueError(f"unknown solver {name!r}: choose one of {', '.join(SOLVERS)}")
