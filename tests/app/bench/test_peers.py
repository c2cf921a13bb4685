"""Queries and solvers of `bench peers`: answers agree, and wrong ones are caught."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

import robots
import vf
from app.bench import peers, queries, solvers
from app.bench.queries import Peer
from app.bench.tools import reference
from app.bench.tools import route as routes


@pytest.fixture(scope="module")
def bodies(small: vf.Surface) -> queries.Bodies:
    rng = np.random.default_rng(4)
    faces = rng.integers(len(small.faces), size=30)
    middle = small.vertices[small.faces[faces]].mean(axis=1)
    height = rng.uniform(2e-5, 4e-3, (30, 1))
    return queries.Bodies.of(small, middle + height * small.normals[faces])


def test_distances_of_the_reference_are_the_least_of_all_points_of_a_triangle() -> None:
    rng = np.random.default_rng(5)
    corners = rng.normal(size=(40, 3, 3))
    corners[0, 2] = corners[0, 1]  # an edge
    corners[1] = corners[1, :1]  # a point
    weights = rng.dirichlet((0.5, 0.5, 0.5), size=4000)
    for x in rng.normal(size=(10, 3)):
        exact = reference.distances(corners, x)
        sampled = np.linalg.norm(np.einsum("sk,tkj->tsj", weights, corners) - x, axis=2)
        assert (exact <= sampled.min(axis=1) + 1e-12).all()
        assert (exact >= sampled.min(axis=1) - 0.1).all()


def test_every_installed_library_agrees_about_nearest_and_ball(bodies: queries.Bodies) -> None:
    held = queries.Holders(bodies, lambda _: None)
    every = range(len(bodies.points))
    asked = queries.nearest(bodies, held)
    assert {"vf: Surface.nearest"} == {peer.name for peer in asked if peer.ours}
    for peer in asked:
        answers = [peer.read(peer.ask(k)) for k in every]
        agrees, words = queries.check_near(bodies, answers, every)
        assert agrees, (peer.name, words)
    for radius in (1e-3, 5e-3):
        for peer in queries.ball(bodies, held, radius):
            answers = [peer.read(peer.ask(k)) for k in every]
            agrees, words = queries.check_ball(bodies, answers, every, radius)
            assert agrees, (peer.name, radius, words)


def test_wrong_answers_are_caught_and_not_timed(bodies: queries.Bodies) -> None:
    surface, points = bodies.surface, bodies.points
    right = Peer(
        "right", lambda k: surface.nearest(points[k]), lambda r: (r[0] * 1e3, r[1]), ours=True
    )
    far = replace(right, name="far", read=lambda r: (r[0] * 1e3 + 2e-3, r[1]), ours=False)
    other = replace(right, name="other", read=lambda r: (r[0] * 1e3, (r[1] + 5000) % 10_000))
    none = replace(right, name="none", read=lambda r: (r[0] * 1e3, -1))

    def check(answers: list, chosen: list[int]) -> tuple[bool, str]:
        return queries.check_near(bodies, answers, chosen)

    entries = {e["name"]: e for e in peers.compare([right, far, other, none], check, 30, 2)}
    assert entries["right"]["agrees"]
    assert entries["right"]["calls"] == 60
    for name in ("far", "other", "none"):
        assert not entries[name]["agrees"], name
        assert entries[name]["calls"] == 0

    every = list(range(30))
    sets = [np.sort(surface.within(x, 4e-3).triangles) for x in points]
    assert max(map(len, sets)) > 3
    assert queries.check_ball(bodies, sets, every, 4e-3)[0]
    assert not queries.check_ball(bodies, [s[1:] for s in sets], every, 4e-3)[0]
    strangers = [np.append(s, (s.max(initial=0) + 5000) % 10_000) for s in sets]
    assert not queries.check_ball(bodies, strangers, every, 4e-3)[0]


def test_planes_with_a_hole_are_caught(bodies: queries.Bodies) -> None:
    planes = [vf.certified_planes(bodies.surface, x, 5e-3) for x in bodies.points]
    every = list(range(len(planes)))
    assert peers._check_planes(bodies, planes, every, 5e-3)[0]
    holed = [
        replace(p, normals=p.normals[1:], offsets=p.offsets[1:]) if len(p) else p for p in planes
    ]
    assert not peers._check_planes(bodies, holed, every, 5e-3)[0]


def test_the_reference_qp_is_the_optimum_of_a_general_solver() -> None:
    rng = np.random.default_rng(6)
    for case in range(20):
        J, d = rng.normal(size=(6, 6)), rng.normal(size=6)
        G, b = rng.normal(size=(4, 6)), -rng.uniform(0.0, 0.5, 4)
        lower, upper = -rng.uniform(0.1, 1.0, 6), rng.uniform(0.1, 1.0, 6)
        dq = reference.least_squares(J, d, 1e-3, G, b, lower, upper)
        H, g = J.T @ J + 1e-3 * np.eye(6), J.T @ d
        peer = minimize(
            lambda x, H=H, g=g: 0.5 * x @ H @ x - g @ x,
            np.zeros(6),
            jac=lambda x, H=H, g=g: H @ x - g,
            bounds=list(zip(lower, upper, strict=True)),
            constraints={"type": "ineq", "fun": lambda x, G=G, b=b: G @ x - b},
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert (G @ dq >= b - 1e-9).all(), case
        assert (dq >= lower - 1e-9).all(), case
        assert (dq <= upper + 1e-9).all(), case
        assert 0.5 * dq @ H @ dq - g @ dq <= peer.fun + 1e-7, case


def test_every_installed_solver_agrees_and_a_wrong_one_is_caught(small: vf.Surface) -> None:
    arm = robots.load("psm")
    _, problems = peers._route_samples(small, arm, routes.plan(small, arm, spots=2), 12)
    assert problems
    every = list(range(len(problems)))
    for peer in solvers.peers(problems, {}):
        answers = [peer.read(peer.ask(k)) for k in every]
        agrees, words = solvers.check(problems, answers, every)
        assert agrees, (peer.name, words)
    still = [np.zeros(6) for _ in problems]
    assert not solvers.check(problems, still, every)[0]
    free = [np.linalg.solve(p.H, p.J.T @ p.d) for p in problems]
    assert not solvers.check(problems, free, every)[0]
    assert not solvers.check(problems, [np.full(6, np.nan)] * len(every), every)[0]
