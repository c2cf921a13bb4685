"""A trial gets on along its path, or from target to target, and in no other way."""

from __future__ import annotations

import numpy as np

from app.studies.experiments.site import PlannedCut
from app.studies.people.progress import Progress
from app.studies.people.tasks import Goal

DEPTH = 2e-3


def path_goal(task: str) -> Goal:
    """Along x for 10 mm, the outside up."""
    stations = np.linspace(0.0, 10e-3, 11)
    ones = np.ones((11, 1))
    planned = PlannedCut(
        stations, stations[:, None] * [1.0, 0.0, 0.0], ones * [1.0, 0.0, 0.0],
        ones * [0.0, 1.0, 0.0], ones * [0.0, 0.0, 1.0],
    )  # fmt: skip
    return Goal(task, planned, np.empty((0, 3)), DEPTH, ())


def run(progress: Progress, points: np.ndarray, dt: float = 0.02) -> Progress:
    for k, point in enumerate(points):
        progress.see(k * dt, point)
    return progress


def along(height: float, aside: float = 0.0, step: float = 2e-4) -> np.ndarray:
    x = np.arange(0.0, 10.4e-3, step)
    return np.column_stack([x, np.full_like(x, aside), np.full_like(x, height)])


def test_a_path_that_is_followed_is_done() -> None:
    done = run(Progress(path_goal("cutting"), 60.0), along(-DEPTH))
    assert done.completed
    assert done.over
    assert done.share == 1.0
    assert run(Progress(path_goal("tracing"), 60.0), along(0.5e-3)).completed


def test_what_is_beside_above_or_skipped_does_not_count() -> None:
    assert run(Progress(path_goal("cutting"), 60.0), along(-DEPTH, aside=5e-3)).station == 0.0
    assert run(Progress(path_goal("cutting"), 60.0), along(-0.5e-3)).station == 0.0
    assert run(Progress(path_goal("tracing"), 60.0), along(2e-3)).station == 0.0
    jumped = run(Progress(path_goal("cutting"), 60.0), along(-DEPTH, step=3e-3))
    assert jumped.station == 0.0
    backwards = run(Progress(path_goal("cutting"), 60.0), along(-DEPTH)[::-1])
    assert not backwards.completed


def test_time_ends_it_and_what_comes_later_does_not_count() -> None:
    progress = Progress(path_goal("cutting"), 0.4)
    run(progress, along(-DEPTH))
    assert progress.over
    assert not progress.completed
    assert progress.time == 0.4
    assert 0.3 < progress.share < 0.6


def test_targets_must_be_held_one_after_the_other() -> None:
    targets = np.array([[0.0, 0.0, 0.0], [10e-3, 0.0, 0.0]])
    progress = Progress(Goal("targeting", None, targets, 0.0, ()), 60.0)
    passing = np.array([[k * 1e-3, 0.0, 0.0] for k in range(-3, 12)])
    run(progress, passing)
    assert progress.touched == 0, "passed by, not held"
    for k in range(20):
        progress.see(1.0 + 0.02 * k, targets[1])
    assert progress.touched == 0, "not the one that is next"
    for k in range(15):
        progress.see(2.0 + 0.02 * k, targets[0] + 1e-3)
    assert progress.touched == 0, "too far from its middle"
    for k in range(17):
        progress.see(3.0 + 0.02 * k, targets[0] + [0.0, 1e-3, 0.0])
    assert progress.touched == 1
    np.testing.assert_array_equal(progress.aim, targets[1])
    for k in range(17):
        progress.see(4.0 + 0.02 * k, targets[1])
    assert progress.completed
