"""What the guard believes: late, noisy, with gaps, and never farther off than it says."""

from __future__ import annotations

from math import inf

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.motion.course import Course
from app.motion.declared import Motion, Tracker
from app.motion.tracking import Tracking

CENTRE = np.array([0.0, 0.0, 0.1])
BREATH = Course([Motion("breathing", move=(0.0, 0.005, 0.012), period=4.0)], CENTRE)


def off(truth: Course, pose: pin.SE3, time: float, radius: float = 0.05) -> float:
    """Largest distance of points of the structure from where they are believed [m]."""
    rng = np.random.default_rng(1)
    away = rng.normal(size=(30, 3))
    points = CENTRE + radius * away / np.linalg.norm(away, axis=1)[:, None]
    now = truth.pose(time)
    return max(float(np.linalg.norm(now * x - pose * x)) for x in points)


@given(
    rate=st.floats(5.0, 500.0), latency=st.floats(0.0, 0.3), noise=st.floats(0.0, 1e-3),
    dropouts=st.floats(0.0, 0.7), seed=st.integers(0, 1000),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_with_a_true_bound_the_margin_covers_the_error(rate, latency, noise, dropouts, seed):
    truth = Course(
        [
            Motion("breathing", move=(0.0, 0.004, 0.01), turn=(0.05, 0.0, 0.0), period=3.0),
            Motion("heartbeat", move=(0.003, 0.0, 0.0)),
        ],
        CENTRE,
    )
    tracker = Tracker(rate, latency, noise, dropouts, bound=truth.speed(0.05), seed=seed)
    tracking = Tracking(truth.pose, tracker)
    for time in np.random.default_rng(seed).uniform(0.0, 6.0, 60):
        belief = tracking.belief(float(time))
        assert off(truth, belief.pose, time) <= belief.margin + 1e-12
        assert belief.age >= latency - 1e-9
        assert belief.stale == (min(belief.age, time) > tracker.stale)


def test_a_bound_that_is_too_low_does_not_cover_it():
    """That the test above can fail."""
    tracking = Tracking(BREATH.pose, Tracker(10.0, 0.1, bound=0.2 * BREATH.speed(0.05)))
    beliefs = [(t, tracking.belief(t)) for t in np.linspace(0.0, 4.0, 400)]
    assert any(off(BREATH, belief.pose, t) > belief.margin for t, belief in beliefs)


def test_it_is_seen_when_it_arrives_and_not_before():
    tracking = Tracking(BREATH.pose, Tracker(10.0, 0.05))
    assert tracking.newest(0.0499) is None
    assert tracking.belief(0.0499).age == inf
    assert tracking.newest(0.05).number == 0
    assert tracking.newest(0.1499).number == 0
    assert tracking.newest(0.15).number == 1
    belief = tracking.belief(0.17)
    assert belief.age == pytest.approx(0.07)
    assert belief.pose.translation == pytest.approx(BREATH.pose(0.1).translation)
    assert belief.margin == pytest.approx(0.05 * 0.07)


def test_what_is_lost_leaves_an_older_sighting_and_a_larger_margin():
    tracker = Tracker(100.0, 0.0, dropouts=0.8, stale=0.05, seed=4)
    tracking = Tracking(BREATH.pose, tracker)
    ages = np.array([tracking.belief(k / 100.0).age for k in range(1, 2000)])
    fresh = np.mean(ages < 1e-6)
    assert fresh == pytest.approx(0.2, abs=0.03)
    assert any(tracking.belief(k / 100.0).stale for k in range(50, 2000))


def test_noise_has_its_size_and_never_more_than_three_times_that():
    still = Course([], CENTRE)
    tracking = Tracking(still.pose, Tracker(1000.0, noise=2e-4))
    errors = [np.linalg.norm(tracking.sighting(k).pose.translation) for k in range(4000)]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(2e-4, rel=0.03)
    assert max(errors) <= 6e-4 * (1.0 + 1e-9)


def test_the_same_seed_repeats_and_another_does_not():
    def seen(seed: int) -> list[float]:
        tracking = Tracking(BREATH.pose, Tracker(50.0, noise=1e-4, dropouts=0.3, seed=seed))
        return [tracking.belief(t).pose.translation[0] for t in np.linspace(0.0, 2.0, 77)]

    assert seen(3) == seen(3)
    assert seen(3) != seen(4)


def test_the_order_of_questions_does_not_matter():
    tracker = Tracker(50.0, noise=1e-4, dropouts=0.3, predictor="periodic", period=1.0)
    times = np.linspace(0.0, 5.0, 211)
    forwards, backwards = Tracking(BREATH.pose, tracker), Tracking(BREATH.pose, tracker)
    there = [forwards.belief(float(t)).margin for t in times]
    back = [backwards.belief(float(t)).margin for t in times[::-1]][::-1]
    assert there == back


def test_a_predictor_of_the_true_period_needs_a_smaller_margin_and_still_covers_the_error():
    late = {"rate": 60.0, "latency": 0.25, "bound": BREATH.speed(0.05)}
    plain = Tracking(BREATH.pose, Tracker(**late))
    predicted = Tracking(BREATH.pose, Tracker(**late, predictor="periodic", period=4.0))
    times = np.linspace(8.5, 16.0, 300)
    shares = []
    for t in times:
        without, belief = plain.belief(t), predicted.belief(t)
        assert belief.unpredicted == without.margin
        assert belief.margin <= without.margin
        assert off(BREATH, belief.pose, t) <= belief.margin
        shares.append(belief.margin / without.margin)
    assert np.median(shares) < 0.2


def test_a_predictor_of_a_wrong_period_is_found_out_by_its_errors():
    late = {"rate": 60.0, "latency": 0.25, "bound": BREATH.speed(0.05)}
    wrong = Tracking(BREATH.pose, Tracker(**late, predictor="periodic", period=3.1))
    for t in np.linspace(8.5, 16.0, 300):
        belief = wrong.belief(t)
        assert belief.margin <= belief.unpredicted
        assert off(BREATH, belief.pose, t) <= belief.margin
