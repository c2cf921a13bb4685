"""The judge beside meshes that move: exact cubics on tiny cases, contacts shorter than sampling."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import robots
from app.judges import motion, passing, screws, sweep
from robots import point

ONE = np.array([[0, 1, 2]])
STILL = passing.Frame(np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))


def frame(rng: np.random.Generator, turn: float, way: float, screw: bool) -> passing.Frame:
    R = pin.Quaternion(*_unit(rng, 4)).toRotationMatrix()
    return passing.Frame(
        R, rng.normal(size=3) * 0.1, turn * _unit(rng), way * _unit(rng), screw=screw
    )


def _unit(rng: np.random.Generator, n: int = 3) -> np.ndarray:
    x = rng.normal(size=n)
    return x / np.linalg.norm(x)


def pose(known: passing.Frame, share: float) -> pin.SE3:
    """By Pinocchio, or by the words of `Frame`."""
    start = pin.SE3(known.rotation, known.translation)
    if known.screw:
        return start * pin.exp6(share * np.concatenate([known.way, known.turn]))
    return pin.SE3(
        known.rotation @ pin.exp3(share * known.turn), known.translation + share * known.way
    )


@pytest.mark.parametrize("screw", [True, False])
@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.9e-7, 1.1e-7, 1e-3, 0.5])
def test_the_joints_of_a_frame_show_what_pinocchio_says(turn: float, screw: bool) -> None:
    rng = np.random.default_rng(0)
    for _ in range(40):
        known = frame(rng, turn, rng.choice([0.0, 1e-5, 0.01]), screw)
        lines, far = known.joints
        start = pin.SE3(known.rotation, known.translation)
        p = rng.normal(size=3) * 0.2
        ends = np.array([start.actInv(p)])
        for share in (0.0, 0.3, 1.0):
            found = np.empty(3)
            screws.place_end(lines, np.zeros(2), ends, np.array([2]), 0, share * far, found)
            # A screw that hardly turns goes straight here.
            np.testing.assert_allclose(found, pose(known, share).actInv(p), rtol=0, atol=3e-10)
        np.testing.assert_allclose(found, pose(known, 1.0).actInv(p), rtol=0, atol=2e-11)


def test_without_any_motion_it_is_the_judge_of_still_meshes() -> None:
    arm, rng = robots.load("psm"), np.random.default_rng(1)
    judge = passing.Judge(arm)
    met = 0
    for _ in range(60):
        q = rng.uniform(arm.lower, arm.upper)
        q_new = q + rng.normal(size=len(q)) * 0.05
        axis = arm.axes(q)[rng.integers(len(arm.capsules))]
        corners = axis[0] + rng.random() * (axis[1] - axis[0]) + 0.02 * rng.normal(size=(3, 3))
        known = {t.capsule: t.share for t in sweep.Judge(arm, corners, ONE).touches(q, q_new)}
        found = judge.contacts(passing.shapes(corners, ONE), STILL, q, q_new)
        assert {one.capsule for one in found} == set(known)
        for one in found:
            assert one.share == pytest.approx(known[one.capsule], abs=1e-6)
        met += len(found)
    assert met > 30


def cubic_contact(p: np.ndarray, way: np.ndarray, a: np.ndarray, b: np.ndarray) -> float | None:
    """When a point first meets a triangle whose corners go straight from a to b (3, 3)."""
    # Volume of corners and point, a polynomial of the third degree of the share.
    shares = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
    volumes = []
    for s in shares:
        u, v, w = a + s * (b - a) - (p + s * way)
        volumes.append(np.cross(u, v) @ w)
    roots = np.roots(np.polyfit(shares, volumes, 3))
    times = sorted(r.real for r in roots if abs(r.imag) < 1e-9 and 0.0 <= r.real <= 1.0)
    for s in times:
        corners, x = a + s * (b - a), p + s * way
        n = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        shares_of = [
            np.cross(corners[(k + 1) % 3] - corners[k], x - corners[k]) @ n / (n @ n)
            for k in range(3)
        ]
        if min(shares_of) > 1e-6:
            return float(s)
        if min(shares_of) > -1e-6:
            return np.nan  # at an edge, within rounding
    return None


def test_a_point_meets_a_triangle_that_deforms_when_the_cubic_says_so() -> None:
    arm, rng = robots.load("point"), np.random.default_rng(2)
    judge = passing.Judge(arm, tip_alone=True)
    met = spared = 0
    for _ in range(900):
        a = 0.02 * rng.normal(size=(3, 3))
        b = a + 0.02 * rng.normal(size=(3, 3))
        p = 0.015 * rng.normal(size=3)
        way = 0.01 * rng.normal(size=3) * rng.choice([0.0, 1.0])
        when = cubic_contact(p, way, a, b)
        if when is not None and np.isnan(when):
            continue
        # From a part of a longer way between two shapes: the same.
        low, high = sorted(rng.random(2)) if rng.random() < 0.5 else (0.0, 1.0)
        whole = (b - a) / (high - low)
        mesh = passing.shapes(a - low * whole, ONE, a - low * whole + whole)
        found = judge.contacts(mesh, STILL, p, p + way, (low, high))
        assert bool(found) == (when is not None)
        if found:
            assert found[0].share == pytest.approx(when, abs=1e-6)
        met += bool(found)
        spared += not found
    assert met > 40
    assert spared > 200


def test_of_the_same_faces_adapted_boxes_find_the_same() -> None:
    arm, rng = robots.load("point"), np.random.default_rng(3)
    judge = passing.Judge(arm, tip_alone=True)
    a = rng.normal(size=(300, 3)) * 0.03
    faces = rng.integers(0, 300, (200, 3))
    other = a + rng.normal(size=a.shape) * 0.02
    adapted = passing.shapes(a, faces, other, passing.shapes(other, faces, a))
    like = passing.shapes(other, faces, a)
    room = (
        np.ones_like(like.ways),
        np.ones_like(like.boxes.vertices),
        np.ones_like(like.boxes.boxes),
    )
    again = passing.shapes(a, faces, other, like, room)
    assert again.ways is room[0]
    np.testing.assert_array_equal(again.ways, adapted.ways)
    np.testing.assert_array_equal(again.boxes.vertices, adapted.boxes.vertices)
    np.testing.assert_array_equal(again.boxes.boxes, adapted.boxes.boxes)
    fresh = passing.shapes(a, faces, other)
    for _ in range(100):
        p, q = rng.normal(size=(2, 3)) * 0.03
        assert judge.contacts(adapted, STILL, p, q, (0.0, 1.0)) == judge.contacts(
            fresh, STILL, p, q, (0.0, 1.0)
        )


@pytest.mark.parametrize(("name", "deforms"), [("psm", False), ("psm", True), ("ur5", False)])
def test_a_contact_of_a_few_nanometres_between_any_two_samples_is_seen(
    name: str, deforms: bool
) -> None:
    """A speck that a capsule grazes while arm and structure move."""
    arm, rng = robots.load(name), np.random.default_rng(4)
    judge = passing.Judge(arm)
    seen = spared = 0
    while seen < 25 or spared < 25:
        q = rng.uniform(arm.lower, arm.upper)
        dq = rng.normal(size=len(q)) * rng.choice([1e-3, 0.05])
        known = frame(rng, rng.choice([0.0, 2e-3, 0.04]), rng.choice([2e-4, 4e-3]), True)
        drift = rng.normal(size=3) * 1e-3 * deforms
        k, share = rng.integers(len(arm.capsules)), rng.uniform(0.02, 0.98)

        def ends(s: float, k=k, q=q, dq=dq, known=known, drift=drift) -> np.ndarray:
            """Of the axis in the structure's frame, less how far the speck has gone."""
            T = pose(known, s)
            return np.array([T.actInv(p) for p in arm.axes(q + s * dq)[k]]) - s * drift

        before, there, after = ends(share - 1e-4), ends(share), ends(share + 1e-4)
        u = rng.uniform(0.2, 0.8)
        spot, velocity, bent = (
            (1.0 - u) * e[0] + u * e[1]
            for e in (there, (after - before) / 2e-4, (after - 2.0 * there + before) / 1e-8)
        )
        out = np.cross(there[1] - there[0], velocity)
        if not np.linalg.norm(out) > 1e-9:
            continue
        out /= np.linalg.norm(out)
        if out @ bent > 0.0:  # it comes nearest to the speck just there
            out = -out
        radius = arm.capsules[k].radius
        if not radius > 0.0:
            continue
        speck = 1e-12 * rng.normal(size=(3, 3))
        for depth in (5e-9, -5e-9):
            corners = spot + (radius - depth) * out + speck
            mesh = passing.shapes(corners, ONE, corners + drift)
            found = judge.contacts(mesh, known, q, q + dq, (0.0, 1.0))
            touched = int(k) in [one.capsule for one in found]
            shares = np.concatenate(
                [np.linspace(0.0, 1.0, 200), share + np.linspace(-1, 1, 9) / 3e5]
            )
            least = min(_gap(ends(s), corners[0]) for s in shares) - radius
            if least < -motion.TOLERANCE:
                assert touched
                seen += 1
            elif least > 0.0 and not touched:
                spared += 1


def _gap(axis: np.ndarray, p: np.ndarray) -> float:
    way = axis[1] - axis[0]
    share = np.clip((p - axis[0]) @ way / max(way @ way, 1e-300), 0.0, 1.0)
    return float(np.linalg.norm(p - axis[0] - share * way))


def test_the_tip_alone_is_a_point_or_a_ball() -> None:
    arm = point.load((0.01, 0.0, 0.04))
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]]) * 0.1
    mesh = passing.shapes(corners, ONE)
    up = passing.Frame(np.eye(3), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 1e-3]))
    q = np.array([0.0, 0.0, 0.9e-3])
    found = passing.Judge(arm, tip_alone=True).contacts(mesh, up, q, q)
    assert [one.share for one in found] == [pytest.approx(0.9, abs=1e-5)]
    found = passing.Judge(arm, 0.5e-3, tip_alone=True).contacts(mesh, up, q, q)
    assert [one.share for one in found] == [pytest.approx(0.4, abs=1e-5)]
    q = np.array([0.0, 0.0, 1.1e-3])
    assert not passing.Judge(arm, tip_alone=True).contacts(mesh, up, q, q)
    # The tool that goes along is not met.
    q = np.array([0.0, 0.0, 0.9e-3])
    judge = passing.Judge(arm, tip_alone=True)
    assert not judge.contacts(mesh, up, q, q + np.array([0.0, 0.0, 1e-3]))
