"""The judge of motions: exact arithmetic on tiny cases, contacts shorter than any sampling."""

from __future__ import annotations

from fractions import Fraction
from math import isqrt

import numpy as np
import pytest

import robots
from app.judges import exact, motion, screws, sweep
from robots import point

ONE = np.array([[0, 1, 2]])


def root(value: Fraction) -> float:
    scale = 10**40
    return isqrt(int(value * scale * scale)) / scale


@pytest.mark.parametrize("name", robots.names())
def test_places_of_the_screws_are_those_of_pinocchio(name: str) -> None:
    rng = np.random.default_rng(0)
    for arm in [robots.load(name)] + [point.load((0.01, 0.0, 0.03))] * (name == "point"):
        known = screws.of(arm, ball=True)
        for _ in range(50):
            q = rng.uniform(arm.lower, arm.upper)
            found = screws.place(known, q)
            np.testing.assert_allclose(found[:-1], arm.axes(q), rtol=0.0, atol=3e-15)
            np.testing.assert_allclose(found[-1], [arm.tip(q).translation] * 2, atol=3e-15)


@pytest.mark.parametrize("name", ["psm", "panda", "ur5"])
def test_no_end_goes_farther_or_bends_more_than_its_bounds(name: str) -> None:
    """And bounds that are far too large would be no good."""
    arm, rng = robots.load(name), np.random.default_rng(1)
    known = screws.of(arm)
    tightest = np.zeros(2)
    for _ in range(60):
        q = rng.uniform(arm.lower, arm.upper)
        dq = rng.normal(size=len(q)) * (rng.random(len(q)) < 0.5) * rng.choice([1e-2, 0.5])
        shares = np.linspace(0.0, 1.0, 41)
        path = np.array([arm.axes(q + s * dq).reshape(-1, 3) for s in shares])
        ways = np.linalg.norm(np.diff(path, axis=0), axis=2).max(axis=0) * 40
        chords = path[0] + shares[:, None, None] * (path[-1] - path[0])
        bends = 8.0 * np.linalg.norm(path - chords, axis=2).max(axis=0)
        for i in range(len(known.ends)):
            bounds = np.array(screws.fastest(*known, i, q, dq))
            measured = np.array([ways[i], bends[i]])
            assert (measured <= bounds * (1.0 + 1e-9) + 1e-13).all()
            tightest = np.maximum(tightest, measured / (bounds + 1e-12))
    assert (tightest > 0.9).all()


def test_a_point_touches_what_its_segment_meets_in_exact_arithmetic() -> None:
    """On a small grid, where most of what can coincide does."""
    arm, rng = robots.load("point"), np.random.default_rng(2)
    met = 0
    for _ in range(800):
        corners = rng.integers(-2, 3, (3, 3)) / 16.0
        q, q_new = rng.integers(-2, 3, (2, 3)) / 16.0
        touches = sweep.Judge(arm, corners, ONE).touches(q, q_new)
        meets = exact.meets(q, q_new, corners)
        assert bool(touches) == meets, (corners, q, q_new)
        met += meets
        if meets:
            assert exact.distance2(*[q + touches[0].share * (q_new - q)] * 2, corners) < 5e-9**2
    assert 50 < met < 600


def test_a_straight_motion_against_exact_distances() -> None:
    """Up to the contact every pose is clear, and there the distance is the radius."""
    arm, rng = point.load((0.0, 0.02, 0.03)), np.random.default_rng(3)
    radius = point.NEEDLE_RADIUS
    touched = 0
    for _ in range(120):
        corners = 0.02 * rng.normal(size=(3, 3)) * 10.0 ** rng.uniform(-2, 0)
        q = 0.04 * rng.normal(size=3)
        # Through a random place near the triangle, and beyond.
        q_new = q + rng.uniform(0.5, 2.0) * (corners.mean(axis=0) + 0.01 * rng.normal(size=3) - q)
        judge = sweep.Judge(arm, corners, ONE)
        found = {touch.capsule: touch for touch in judge.touches(q, q_new)}
        end = found[1].share if 1 in found else 1.0
        gaps = [
            root(exact.distance2(*judge.axes(q + s * (q_new - q))[1], corners)) - radius
            for s in np.linspace(0.0, end, 12)
        ]
        if 1 not in found:
            assert min(gaps) > -motion.TOLERANCE - 1e-14
        elif found[1].before:
            assert gaps[0] <= -motion.TOLERANCE
            assert found[1].gap == pytest.approx(max(gaps[0], -radius), abs=1e-14)
        else:
            assert min(gaps[:-1]) > -motion.TOLERANCE - 1e-14
            assert gaps[-1] == pytest.approx(-motion.TOLERANCE, abs=2e-11)
            touched += 1
    assert touched > 15


@pytest.mark.parametrize("name", ["psm", "panda", "ur5"])
def test_a_contact_of_a_few_nanometres_between_any_two_samples_is_seen(name: str) -> None:
    """A speck that a capsule grazes somewhere on its way, at once before the middle or after it."""
    arm, rng = robots.load(name), np.random.default_rng(4)
    seen = spared = 0
    while seen < 40 or spared < 40:
        q = rng.uniform(arm.lower, arm.upper)
        q_new = q + rng.normal(size=len(q)) * rng.choice([1e-3, 0.05])
        k, share = rng.integers(len(arm.capsules)), rng.uniform(0.02, 0.98)
        before, there, after = (
            arm.axes(q + (share + h) * (q_new - q))[k] for h in (-1e-4, 0, 1e-4)
        )
        u = rng.uniform(0.2, 0.8)
        spot, velocity, bent = (
            (1.0 - u) * ends[0] + u * ends[1]
            for ends in (there, (after - before) / 2e-4, (after - 2.0 * there + before) / 1e-8)
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
            judge = sweep.Judge(arm, spot + (radius - depth) * out + speck, ONE)
            touched = k in [touch.capsule for touch in judge.touches(q, q_new)]
            shares = np.concatenate(
                [np.linspace(0.0, 1.0, 200), share + np.linspace(-1, 1, 9) / 3e5]
            )
            least = min(judge.clearance(q + s * (q_new - q))[k] for s in shares)
            if least < -motion.TOLERANCE:
                assert touched
                seen += 1
            elif least > 0.0 and not touched:
                spared += 1
            else:
                # The way may be nearer between the samples, but not by much.
                assert least < 1e-6 * np.linalg.norm(velocity) + 1e-8
