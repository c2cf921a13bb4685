"""The constrained least squares: optimality from residuals, and against an active-set method.

The other solver is Lawson and Hanson's: least distance programming by non-negative least squares
(scipy.optimize.nnls), which is exact up to rounding and shares nothing with the solvers.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import nnls

import robots
import vf
from vf import ConstrainedLeastSquares, Solver
from vf.qp.solver import backend

ROOT = Path(__file__).parents[3]
UM = 1e-6
DAMPING = 1e-8


@pytest.fixture(params=vf.SOLVERS)
def kind(request):
    """The name of each solver: all have the same to do."""
    return request.param


OPTIMAL = {Solver.FREE, Solver.PROJECTED, Solver.SOLVED}
ARMS = {3: robots.load("point"), 6: robots.load("psm"), 7: robots.load("panda")}


class Problem:
    """A random problem of n joints and m rows in the units of a tick: metres and radians."""

    def __init__(self, rng: np.random.Generator, n: int, m: int, scale: float = 1e-3) -> None:
        arm = ARMS[n]
        q = rng.uniform(arm.lower, arm.upper)
        self.J = arm.jacobian(q)
        self.J[3:] *= 0.05  # [m/rad]
        self.d = scale * rng.normal(size=6)
        self.damping = DAMPING
        normals = rng.normal(size=(m, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        self.G = normals @ self.J[:3]
        self.b = -scale * rng.exponential(0.5, m)
        # As in a tick of 1 ms to 20 ms; some joints stand at their upper limit.
        speed = arm.velocity * rng.choice([1e-3, 5e-3, 20e-3])
        self.lower, self.upper = -speed, speed * rng.choice([0.0, 0.2, 1.0], n, p=[0.1, 0.2, 0.7])
        # As the controller paces it: the unconstrained step goes as fast as its fastest joint can.
        H = self.J.T @ self.J + self.damping * np.eye(n)
        self.d /= max(1.0, (np.abs(np.linalg.solve(H, self.J.T @ self.d)) / speed).max())

    @property
    def arguments(self) -> tuple:
        return self.J, self.d, self.damping, self.G, self.b, self.lower, self.upper

    def cost(self, dq: np.ndarray) -> float:
        r = self.J @ dq - self.d
        return float(0.5 * r @ r + 0.5 * self.damping * dq @ dq)

    def reference(self) -> np.ndarray | None:
        """The optimum by least distance programming; None if no Δq obeys the rows."""
        n = len(self.lower)
        H = self.J.T @ self.J + self.damping * np.eye(n)
        L = np.linalg.cholesky(H)
        best = np.linalg.solve(L, self.J.T @ self.d)  # in u = Lᵀ Δq
        rows = np.concatenate([self.G, np.eye(n), -np.eye(n)]) @ np.linalg.inv(L.T)
        low = np.concatenate([self.b, self.lower, -self.upper])
        norms = np.linalg.norm(rows, axis=1)
        rows, low = rows / norms[:, None], low / norms
        gap = low - rows @ best
        unit = np.abs(gap).max() or 1.0
        # min ‖v‖ s.t. rows v ≥ gap: the residual of an NNLS problem gives v.
        E = np.vstack([rows.T, gap[None] / unit])
        f = np.zeros(n + 1)
        f[-1] = 1.0
        y, norm = nnls(E, f, maxiter=100 * E.shape[1])
        if norm < 1e-9:
            return None
        r = E @ y - f
        return np.linalg.solve(L.T, best - unit * r[:n] / r[n])

    def check(self, solution: vf.Solution) -> None:
        """Primal and dual feasibility and complementarity in the caller's coordinates."""
        dq, mu = solution.dq, solution.multipliers
        H = self.J.T @ self.J + self.damping * np.eye(len(dq))
        root = np.sqrt(np.diag(H))  # how far a unit of each joint moves the task [m]
        assert (dq >= self.lower).all()
        assert (dq <= self.upper).all()
        assert (mu >= 0).all()
        slack = self.G @ dq - self.b
        # A row is met to OSQP's tolerance in the tip's space, or less where the arm is stiff to it.
        assert slack.min(initial=0) > -1.5 * UM, slack.min()
        assert (mu * np.maximum(slack, 0)).max(initial=0) < UM * max(np.abs(mu).max(initial=0), UM)
        gradient = self.J.T @ (self.J @ dq - self.d) + self.damping * dq - self.G.T @ mu
        scaled = gradient / root  # [m]
        hair = UM * np.sqrt(np.diag(np.linalg.inv(H)))  # of the joints, for one of the task
        low, high = dq <= self.lower + hair, dq >= self.upper - hair
        # At its lower bound a joint may be pushed down, at its upper bound up, else not at all.
        assert scaled[~low].max(initial=0) < 2 * UM
        assert scaled[~high].min(initial=0) > -2 * UM


@pytest.fixture
def solvers(kind: str) -> dict[int, ConstrainedLeastSquares]:
    return {n: ConstrainedLeastSquares(n, solver=kind) for n in (3, 6, 7)}


SIZES = [(n, m) for n in (3, 6, 7) for m in (0, 1, 3, 10, 40, 100)]


@pytest.mark.parametrize(("n", "m"), SIZES)
def test_random_problems_are_solved_to_optimality(n, m, solvers):
    rng = np.random.default_rng(100 * n + m)
    constrained = spent = 0
    for trial in range(25):
        problem = Problem(rng, n, m)
        solution = solvers[n].solve(*problem.arguments)
        if solution.solver is Solver.NOT_CONVERGED and m >= 40:
            # A crowd of random rows may outlast the iterations: said so, rarely, and bounds hold.
            spent += 1
            assert spent <= 1
            assert (solution.dq >= problem.lower).all()
            assert (solution.dq <= problem.upper).all()
            continue
        assert solution.solver in (Solver.FREE, Solver.PROJECTED, Solver.SOLVED), (trial, solution)
        problem.check(solution)
        reference = problem.reference()
        assert reference is not None
        # Equal in the task's space; in the arm's nearly singular directions nothing is asked.
        near = 2 * UM if m < 40 else 20 * UM  # corners between nearly parallel rows
        assert np.abs(problem.J @ (solution.dq - reference)).max() < near, trial
        best = problem.cost(reference)
        assert problem.cost(solution.dq) <= best + 2 * UM * np.sqrt(2 * best) + UM**2, trial
        constrained += solution.solver is not Solver.FREE
    if m >= 10:
        assert constrained >= 20 - spent


def test_the_reference_is_right_where_the_answer_is_known(kind):
    """A point pushed at a wall slides along it: drop the component into the wall."""
    problem = Problem(np.random.default_rng(0), 3, 0)
    problem.J, problem.d = np.eye(3), np.array([1e-3, 2e-3, -3e-3])
    problem.G, problem.b = np.array([[0.0, 0.0, 1.0]]), np.array([-1e-3])
    problem.lower, problem.upper = np.full(3, -1.0), np.full(3, 1.0)
    expected = [1e-3, 2e-3, -1e-3]
    assert np.allclose(problem.reference(), expected, atol=1e-9)
    solution = ConstrainedLeastSquares(3, solver=kind).solve(*problem.arguments)
    assert np.allclose(solution.dq, expected, atol=UM / 10)
    # It wanted 2 mm more than the wall lets it have.
    assert solution.multipliers == pytest.approx([2e-3], abs=UM)


def test_an_unconstrained_optimum_needs_no_solver(kind):
    problem = Problem(np.random.default_rng(1), 6, 5)
    problem.lower, problem.upper, problem.b = np.full(6, -9.0), np.full(6, 9.0), np.full(5, -9.0)
    solution = ConstrainedLeastSquares(6, solver=kind).solve(*problem.arguments)
    assert solution.solver is Solver.FREE
    augmented = np.vstack([problem.J, np.sqrt(problem.damping) * np.eye(6)])
    expected = np.linalg.lstsq(augmented, np.r_[problem.d, np.zeros(6)], rcond=None)[0]
    assert np.allclose(solution.dq, expected, rtol=1e-9)
    assert not solution.multipliers.any()


def test_answers_do_not_depend_on_what_was_solved_before(kind):
    rng = np.random.default_rng(2)
    problems = [Problem(rng, 6, m) for m in (4, 90, 12, 33, 5, 250)]
    hard = Problem(rng, 6, 60)
    hard.b = 1e-3 * rng.normal(size=60)  # infeasible or nearly so: many iterations, ρ adapted
    fresh = [ConstrainedLeastSquares(6, solver=kind).solve(*p.arguments) for p in problems]
    used = ConstrainedLeastSquares(6, solver=kind)
    for turn in range(3):
        for problem, expected in zip(problems[::-1], fresh[::-1], strict=True):
            used.solve(*hard.arguments)
            again = used.solve(*problem.arguments)
            assert again.dq.tobytes() == expected.dq.tobytes(), turn
            assert again.multipliers.tobytes() == expected.multipliers.tobytes(), turn
            assert again.iterations == expected.iterations, turn
            assert again.solver is expected.solver, turn


def test_answers_are_the_callers_to_keep(kind):
    rng = np.random.default_rng(3)
    solver = ConstrainedLeastSquares(6, solver=kind)
    first = solver.solve(*Problem(rng, 6, 20).arguments)
    kept = first.dq.copy(), first.multipliers.copy()
    for _ in range(5):
        solver.solve(*Problem(rng, 6, 20).arguments)
    assert (first.dq == kept[0]).all()
    assert (first.multipliers == kept[1]).all()


@pytest.mark.parametrize("n", [3, 6, 7])
def test_an_infeasible_problem_is_no_motion(n, kind):
    rng = np.random.default_rng(4)
    solver = ConstrainedLeastSquares(n, solver=kind)
    for _ in range(20):
        problem = Problem(rng, n, 5)
        g = problem.G[0]
        problem.G = np.vstack([problem.G, g, -g])
        problem.b = np.r_[problem.b, 1e-3, 1e-3]  # this far up and this far down at once
        problem.lower, problem.upper = np.full(n, -10.0), np.full(n, 10.0)
        solution = solver.solve(*problem.arguments)
        assert solution.solver in (Solver.INFEASIBLE, Solver.NOT_CONVERGED)
        if solution.solver is Solver.INFEASIBLE:
            assert not solution.dq.any()


def test_more_motion_than_the_joints_have_is_infeasible(kind):
    problem = Problem(np.random.default_rng(5), 3, 0)
    problem.J, problem.d = np.eye(3), np.zeros(3)
    problem.G, problem.b = np.array([[0.0, 0.0, 1.0]]), np.array([1e-3])
    problem.lower, problem.upper = np.full(3, -1e-4), np.full(3, 1e-4)
    solution = ConstrainedLeastSquares(3, solver=kind).solve(*problem.arguments)
    assert solution.solver in (Solver.INFEASIBLE, Solver.NOT_CONVERGED)
    assert (np.abs(solution.dq) <= 1e-4).all()


def test_a_row_that_no_joint_moves_is_infeasible_only_if_it_asks_for_motion(kind):
    problem = Problem(np.random.default_rng(6), 3, 1)
    problem.G = np.zeros((1, 3))
    problem.lower, problem.upper = np.full(3, -1.0), np.full(3, 1.0)
    solver = ConstrainedLeastSquares(3, solver=kind)
    problem.b = np.array([-1e-3])
    assert solver.solve(*problem.arguments).solver is Solver.FREE
    problem.b = np.array([1e-3])
    solution = solver.solve(*problem.arguments)
    assert solution.solver is Solver.INFEASIBLE
    assert not solution.dq.any()


@pytest.mark.parametrize("scale", [1e-9, 1e-6, 1.0, 1e3, 1e6])
@pytest.mark.parametrize("part", ["d", "G", "J", "b", "bounds"])
def test_badly_scaled_input_ends_in_a_status_not_in_motion(part, scale, kind):
    """Whatever the scales: finite, within the bounds, and what is called solved obeys its rows."""
    rng = np.random.default_rng(7)
    solver = ConstrainedLeastSquares(6, solver=kind)
    for _ in range(15):
        problem = Problem(rng, 6, 12)
        if part == "d":
            problem.d *= scale
        elif part == "G":
            grow = np.where(rng.random(12) < 0.5, scale, 1.0)
            problem.G *= grow[:, None]
            problem.b *= grow
        elif part == "J":
            column = rng.integers(6)
            problem.J[:, column] *= scale
            problem.G[:, column] *= scale
        elif part == "b":
            problem.b *= scale
        else:
            problem.lower, problem.upper = problem.lower * scale, problem.upper * scale
        solution = solver.solve(*problem.arguments)
        assert np.isfinite(solution.dq).all()
        assert (solution.dq >= problem.lower).all()
        assert (solution.dq <= problem.upper).all()
        if solution.solver in (Solver.FREE, Solver.PROJECTED, Solver.SOLVED):
            # Rows in metres: each scaled back to its unit normal.
            size = grow if part == "G" else 1.0
            assert ((problem.G @ solution.dq - problem.b) / size).min() > -2 * UM


def test_bounds_hold_to_the_last_bit_even_without_convergence(kind):
    rng = np.random.default_rng(8)
    solver = ConstrainedLeastSquares(7, solver=kind)
    seen = set()
    for _ in range(200):
        problem = Problem(rng, 7, 60)
        problem.b = 1e-3 * rng.normal(-0.3, 0.5, 60)  # often infeasible
        problem.damping = 1e-10
        problem.J[:, 0] = problem.J[:, 1] * (1 + 1e-7)  # nearly singular
        solution = solver.solve(*problem.arguments)
        seen.add(solution.solver)
        assert np.isfinite(solution.dq).all()
        assert (solution.dq >= problem.lower).all()
        assert (solution.dq <= problem.upper).all()
        assert (solution.multipliers >= 0).all()
    assert seen & {Solver.INFEASIBLE, Solver.NOT_CONVERGED}


def test_pacing_keeps_the_direction(kind):
    """A far goal is approached in a straight line: no joint gets ahead of the slowest."""
    problem = Problem(np.random.default_rng(9), 3, 0)
    problem.J, problem.d = np.eye(3), np.array([3e-3, -1e-3, 0.5e-3])
    problem.lower, problem.upper = np.full(3, -2e-4), np.full(3, 2e-4)
    solution = ConstrainedLeastSquares(3, solver=kind).solve(
        *problem.arguments, pace=np.full(3, 2e-4)
    )
    assert np.abs(solution.dq).max() == pytest.approx(2e-4, rel=1e-6)
    assert np.allclose(solution.dq / np.linalg.norm(solution.dq),
                       problem.d / np.linalg.norm(problem.d), atol=1e-6)  # fmt: skip


def test_the_number_of_joints_is_checked():
    with pytest.raises(ValueError, match="0"):
        ConstrainedLeastSquares(0)


SOLVES = """
import os, signal, sys
import numpy as np
from vf import ConstrainedLeastSquares
from vf.qp import solver_osqp

told = int(sys.argv[1])
found = heard = 0
ask = solver_osqp._interrupted

def asked():
    global found
    came = ask()
    found += came != 0
    return came

def hear(number, frame):
    global heard
    heard += 1
    os.write(told, b"!")

solver_osqp._interrupted = asked
random = np.random.default_rng(0)
problem = (
    random.normal(size=(6, 6)), 1e-2 * random.normal(size=6), 1e-6,
    random.normal(size=(60, 6)), -1e-4 * random.random(60), np.full(6, -1.0), np.full(6, 1.0),
)
solver = ConstrainedLeastSquares(6)
first = solver.solve(*problem)
assert first.iterations > 0, "OSQP is not asked"
signal.signal(signal.SIGINT, hear)
os.write(told, b"!")
while heard < 200:
    again = solver.solve(*problem)
    assert np.array_equal(again.dq, first.dq)
    assert np.array_equal(again.multipliers, first.multipliers)
    assert (again.solver, again.iterations) == (first.solver, first.iterations)
assert found > 0, "none came while OSQP solved"
"""


def test_an_interrupt_while_osqp_solves_is_heard_and_changes_no_answer() -> None:
    read, write = os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-c", SOLVES, str(write)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, pass_fds=[write], cwd=ROOT,
    )  # fmt: skip
    try:
        os.close(write)
        # One at a time: signals that wait together are one.
        for k in range(201):
            assert select.select([read], [], [], 60.0)[0], f"interrupt {k} was lost"
            if not os.read(read, 1) or k == 200:
                break
            time.sleep(1e-4 * (k % 20))
            process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
        assert process.returncode == 0, err
    finally:
        process.kill()
        process.wait()
        os.close(read)


def test_unknown_solvers_are_refused_with_the_known_ones() -> None:
    for attempt in (
        lambda: ConstrainedLeastSquares(3, solver="simplex"),
        lambda: vf.Settings(solver="simplex"),
    ):
        with pytest.raises(ValueError, match=r"'simplex'.*osqp, daqp"):
            attempt()


def test_a_solver_that_is_not_installed_says_what_to_install(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "daqp", None)
    monkeypatch.delitem(sys.modules, "vf.qp.solver_daqp", raising=False)
    with pytest.raises(RuntimeError, match=r"daqp.*pip install 'vf-sandbox\[daqp\]'"):
        ConstrainedLeastSquares(3, solver="daqp")


def nearest(best: np.ndarray, rows: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """The point of a polyhedron nearest to u*, by least distance programming."""
    E = np.vstack([rows.T, (bounds - rows @ best)[None]])
    f = np.zeros(len(best) + 1)
    f[-1] = 1.0
    y, _norm = nnls(E, f, maxiter=100 * E.shape[1])
    r = E @ y - f
    return best - r[:-1] / r[-1]


@pytest.mark.parametrize("n", [3, 6, 7])
@pytest.mark.parametrize("k", [1, 5, 12, 60])
def test_every_solver_projects_on_polyhedra(kind, n, k):
    """By itself, without the shortcuts that settle most ticks: within its tolerance."""
    rng = np.random.default_rng(10 * n + k)
    solver = backend(kind, n, 64)
    solved = 0
    for _ in range(20):
        rows = rng.normal(size=(k, n))
        rows /= np.linalg.norm(rows, axis=1, keepdims=True)
        bounds, best = -rng.exponential(0.3, k), rng.normal(size=n)
        if (rows @ best >= bounds).all():
            continue
        code, u, duals, iterations = solver.solve(best.copy(), rows.copy(), bounds.copy())
        assert iterations > 0
        assert code in (Solver.SOLVED, Solver.NOT_CONVERGED)
        if code is Solver.SOLVED:
            solved += 1
            assert np.abs(u - nearest(best, rows, bounds)).max() < 2e-3  # [mm]
            assert (duals < 1e-3).all()
            assert np.abs(best - duals @ rows - u).max() < 2e-3  # stationary
    assert solved >= 5


def test_every_solver_says_that_nothing_obeys_opposing_rows(kind):
    solver = backend(kind, 3, 64)
    rows, bounds = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]), np.array([1.0, 1.0])
    code = solver.solve(np.zeros(3), rows, bounds)[0]
    assert code in (Solver.INFEASIBLE, Solver.NOT_CONVERGED)
    code, u, _duals, _iterations = solver.solve(np.zeros(3), rows[:1].copy(), bounds[:1].copy())
    assert code is Solver.SOLVED
    assert np.abs(u - [1.0, 0.0, 0.0]).max() < 1e-3
