"""The campaign with the whole instrument: no capsule touches, and with the tip alone they do."""

from __future__ import annotations

import numpy as np
import pytest

import meshes
import robots
import vf
from app.commands import call
from app.judges import sweep
from app.studies.verification import instrument
from meshes.builtin.damage import damage
from robots import point


@pytest.mark.parametrize(
    ("robot", "period", "noise"),
    [("psm", 1e-3, 5e-3), ("psm", 0.1, 0.0), ("ur5", 0.02, 0.0), ("point", 1e-3, 0.0)],
)
def test_no_capsule_touches_anything(robot: str, period: float, noise: float) -> None:
    arm = point.load((0.01, 0.0, 0.04)) if robot == "point" else robots.load(robot)
    mesh = damage("flipped", meshes.arrays("gear"), seed=1)
    result = instrument.drive(
        arm, mesh, guard="tool", radius=5e-3, period=period, steps=400, seed=3, noise=noise
    )
    assert result.ticks == 400
    assert result.crossings == 0, result.first
    assert result.statuses[vf.Status.INSIDE] == 0


def test_with_the_tip_alone_the_same_hands_take_other_parts_through() -> None:
    result = instrument.drive(
        robots.load("psm"), meshes.arrays("gear"), guard="tip", radius=5e-3, period=0.02,
        steps=500, seed=3,
    )  # fmt: skip
    assert result.crossings > 0
    assert "from [" in result.first


def test_crossings_are_counted_by_part_and_episodes_begin_anew() -> None:
    result = instrument.drive(
        point.load((0.01, 0.0, 0.04)), meshes.arrays("gear"), guard="tip", radius=5e-3,
        period=1e-3, steps=600, seed=3,
    )  # fmt: skip
    assert set(result.parts) == {"needle"}
    assert result.parts["needle"] == result.crossings > 0
    assert result.episodes in (result.crossings, result.crossings + 1)


def test_a_point_that_no_rule_holds_is_seen_to_cross(monkeypatch: pytest.MonkeyPatch) -> None:
    """The judge has no radius to go by."""
    fixture = vf.MeshFixture
    monkeypatch.setattr(vf, "MeshFixture", lambda surface, _rule, radius: fixture(surface, "off"))
    result = instrument.drive(
        robots.load("point"), meshes.arrays("gear"), guard="tip", radius=5e-3, period=1e-3,
        steps=300, seed=3,
    )  # fmt: skip
    assert set(result.parts) == {"tip"}


def test_queries_with_the_arms_own_capsules_leak_nothing_and_see_what_leaks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arm, mesh = robots.load("psm"), meshes.arrays("torus")
    result = instrument.query(mesh, edges=None, queries=60, seed=2, arm=arm, standoff=20e-6)
    assert (result.queries, result.leaking) == (60, 0)
    assert 0 < result.planes < 4 * 60
    monkeypatch.setattr(
        vf, "certified_planes", lambda _surface, _x, radius, _standoff, _rho: vf.Planes.none(radius)
    )
    result = instrument.query(mesh, edges=None, queries=60, seed=2, arm=arm, standoff=20e-6)
    assert result.leaking > 50


def test_every_start_is_clear_and_beside_a_part() -> None:
    arm, rng = robots.load("psm"), np.random.default_rng(0)
    mesh = meshes.arrays("torus")
    start = instrument._Starts(mesh)
    for _ in range(6):
        q, surface, judge = start.near(arm, rng)
        assert judge.clear(q, 0.99 * instrument.GAPS[0])
        gaps = sweep.Judge(arm, surface.vertices, surface.faces).clearance(q)
        assert 0.99 * instrument.GAPS[0] <= gaps.min() < instrument.GAPS[1] + 2e-3


def test_no_end_of_an_axis_is_off_by_more_than_the_bound() -> None:
    arm, rng = robots.load("psm"), np.random.default_rng(1)
    judge = sweep.Judge(arm, *meshes.arrays("cube"))
    off = []
    for _ in range(50):
        q = rng.uniform(arm.lower, arm.upper)
        moved = instrument._actuate(judge, q, 1e-5, rng)
        off.append(np.linalg.norm(arm.axes(moved) - arm.axes(q), axis=2).max())
    assert max(off) <= 1e-5
    assert max(off) > 3e-6


def test_the_command_says_what_is_guarded(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--robot", "psm", "--mesh", "torus", "--damage", "none", "--steps", "60"]
    assert call("verify", [*words, "--queries", "30", "--guard", "tool"]) == 0
    assert "whole instrument, guard tool" in " ".join(capsys.readouterr().out.split())
    assert call("verify", [*words, "--guard", "tool", "--rule", "paper"]) != 0
    words[1] = "all"
    capsys.readouterr()
    assert call("verify", [*words, "--guard", "tool"]) == 0
    out = capsys.readouterr().out
    for name in (*robots.names(), "point, needle", "200 Hz", "1,000 Hz"):
        assert name in out
    assert call("verify", words) == 2
