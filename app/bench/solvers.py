"""The QP of a tick for `bench peers`, for every solver that is installed."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import robots
import vf
from app.bench.queries import Peer
from app.bench.tools.reference import least_squares
from vf.qp.problem import rotation_log
from vf.qp.solver_osqp import osqp_was_interrupted

FloatArray = NDArray[np.float64]

MM = 1e3  # peers get the problem in mm and mrad, as their tolerances are absolute
TOLERANCE = 5e-6
"""Tolerance of steps [m]: a quarter of the default standoff."""


@dataclass(frozen=True)
class Problem:
    """min ½‖J Δq − d‖² + ½ λ‖Δq‖², G Δq ≥ b, lower ≤ Δq ≤ upper, also in standard form.

    Attributes:
        J, d: (6, n), (6,) rotation weighted by a length [m].
        G, b: (m, n), (m,) [m].
        lower, upper: (n,) with lower ≤ 0 ≤ upper.
        H, g: (n, n), (n,) Hessian and gradient of the QP in x = 10³ Δq.
    """

    J: FloatArray
    d: FloatArray
    damping: float
    G: FloatArray
    b: FloatArray
    lower: FloatArray
    upper: FloatArray
    H: FloatArray
    g: FloatArray


def problem(
    arm: robots.Arm, q: FloatArray, target: Any, step: vf.Step, settings: vf.Settings
) -> Problem:
    """The problem of a tick from joint positions q (n,) towards `target`."""
    T, J = arm.kinematics(q)
    x = T.translation
    d = np.empty(6)
    d[:3] = target.translation - x
    turn = rotation_log(*(target.rotation @ T.rotation.T).ravel())
    d[3:] = settings.rotation_length * np.array(turn)
    for part in (d[:3], d[3:]):
        length = float(np.linalg.norm(part))
        if length > step.planes.radius:
            part *= step.planes.radius / length
    task = np.vstack([J[:3], settings.rotation_length * J[3:]])
    reach = arm.velocity * settings.dt
    lower = np.minimum(np.maximum(arm.lower - q, -reach), 0.0)
    upper = np.maximum(np.minimum(arm.upper - q, reach), 0.0)
    normals = step.planes.normals
    b = np.minimum(step.planes.offsets - normals @ x, 0.0)
    H = task.T @ task + settings.damping * np.eye(len(q))
    # As in the controller: scale the task to the joints' speed limits.
    d /= max(1.0, float(np.max(np.abs(np.linalg.solve(H, task.T @ d)) / reach)))
    return Problem(
        task, d, settings.damping, np.ascontiguousarray(normals @ J[:3]), b, lower, upper,
        H, -MM * (task.T @ d),
    )  # fmt: skip


def peers(problems: Sequence[Problem], missing: dict[str, str]) -> list[Peer]:
    """All solvers; answers are Δq (n,)."""
    n = problems[0].J.shape[1]
    ours = vf.ConstrainedLeastSquares(n)

    def ask_ours(k: int) -> Any:
        p = problems[k]
        return ours.solve(p.J, p.d, p.damping, p.G, p.b, p.lower, p.upper)

    found = [
        Peer(
            "vf: ConstrainedLeastSquares.solve",
            ask_ours,
            lambda r: r.dq,
            "OSQP on persistent workspaces behind exact shortcuts",
            ours=True,
        )
    ]
    for name, make in (("osqp", _osqp), ("daqp", _daqp), ("proxsuite", _proxqp)):
        try:
            found.append(make(importlib.import_module(name), problems))
        except ImportError as error:
            missing[name] = str(error)
    try:
        qpsolvers = importlib.import_module("qpsolvers")
    except ImportError as error:
        missing["qpsolvers"] = str(error)
    else:
        found += [_qpsolvers(qpsolvers, name, problems) for name in qpsolvers.available_solvers]
    return found


def _osqp(osqp: Any, problems: Sequence[Problem]) -> Peer:
    from scipy import sparse

    n = problems[0].J.shape[1]

    def ask(k: int) -> Any:
        p = problems[k]
        solver = osqp.OSQP()
        A = sparse.csc_matrix(np.vstack([p.G, np.eye(n)]))
        solver.setup(
            sparse.csc_matrix(np.triu(p.H)), p.g, A,
            np.concatenate([p.b, p.lower]) * MM,
            np.concatenate([np.full(len(p.b), np.inf), p.upper * MM]),
            verbose=False, eps_abs=1e-5, eps_rel=0.0, max_iter=20_000,
        )  # fmt: skip
        answer = solver.solve(raise_error=False)
        _pass_on_interrupt()
        return answer

    return Peer("OSQP: set up anew each tick", ask, lambda r: r.x / MM, "tolerance 1e-5 mm")


def _pass_on_interrupt() -> None:
    if osqp_was_interrupted():
        raise KeyboardInterrupt


def _daqp(daqp: Any, problems: Sequence[Problem]) -> Peer:
    unbounded = 1e30

    def ask(k: int) -> Any:
        p = problems[k]
        high = np.concatenate([p.upper * MM, np.full(len(p.b), unbounded)])
        low = np.concatenate([p.lower, p.b]) * MM
        return daqp.solve(p.H, p.g, p.G, high, low, np.zeros(len(low), dtype=np.int32))

    return Peer("DAQP: solve", ask, lambda r: np.asarray(r[0]) / MM, "dual active set, C")


def _proxqp(proxsuite: Any, problems: Sequence[Problem]) -> Peer:
    n = problems[0].J.shape[1]
    identity = np.eye(n)

    def ask(k: int) -> Any:
        p = problems[k]
        m = len(p.b)
        solver = proxsuite.proxqp.dense.QP(n, 0, m + n)
        # The default tolerances give errors up to 0.1 mm.
        solver.settings.eps_abs = 1e-9
        solver.settings.eps_rel = 0.0
        solver.init(
            p.H, p.g, None, None, np.vstack([p.G, identity]),
            np.concatenate([p.b, p.lower]) * MM,
            np.concatenate([np.full(m, 1e20), p.upper * MM]),
        )  # fmt: skip
        solver.solve()
        return solver

    return Peer(
        "ProxQP: dense", ask, lambda r: np.asarray(r.results.x) / MM, "set up anew each tick"
    )


def _qpsolvers(qpsolvers: Any, name: str, problems: Sequence[Problem]) -> Peer:
    from scipy import sparse

    # The default tolerances of OSQP and ProxQP are too coarse for steps of micrometres.
    options: dict[str, Any] = {
        "osqp": {"eps_abs": 1e-5, "eps_rel": 0.0, "max_iter": 20_000},
        "proxqp": {"eps_abs": 1e-9, "eps_rel": 0.0},
    }.get(name, {})
    convert = sparse.csc_matrix if name in qpsolvers.sparse_solvers else np.ascontiguousarray

    def ask(k: int) -> Any:
        p = problems[k]
        answer = qpsolvers.solve_qp(
            convert(p.H), p.g, convert(-p.G), -p.b * MM, lb=p.lower * MM, ub=p.upper * MM,
            solver=name, **options,
        )  # fmt: skip
        if name == "osqp":
            _pass_on_interrupt()
        return answer

    return Peer(
        f"qpsolvers: {name}",
        ask,
        lambda r: np.full(len(problems[0].lower), np.nan) if r is None else r / MM,
    )


def check(
    problems: Sequence[Problem], answers: Sequence[FloatArray], chosen: Sequence[int]
) -> tuple[bool, str]:
    """Compare steps with the reference: (agrees, description)."""
    off = broken = 0.0
    for dq, k in zip(answers, chosen, strict=True):
        p = problems[k]
        best = least_squares(p.J, p.d, p.damping, p.G, p.b, p.lower, p.upper)
        if not np.isfinite(dq).all():
            return False, f"no answer to problem {k}"
        off = max(off, float(np.linalg.norm(p.J @ (dq - best))))
        # Violations of joint limits are measured by the motion of the tip.
        speed = np.linalg.norm(p.J, axis=0)
        out = np.maximum(np.maximum(p.lower - dq, dq - p.upper), 0.0) * speed
        broken = max(broken, float(out.max()), float(np.max(p.b - p.G @ dq, initial=0.0)))
    words = f"off by {off * 1e6:.2g} µm, rows broken by {broken * 1e6:.2g} µm at most"
    return max(off, broken) <= TOLERANCE, words
