"""The campaign against the certified rule: nothing gets through, and it would notice if it did."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import meshes
import robots
import vf
from app.commands import call
from app.judges import oracles
from app.studies.verification import campaign, scenes
from meshes.builtin.damage import damage, kinds
from tests.support.everyday import everyday
from vf import fixtures
from vf.rules.certified import cover

ROOT = Path(__file__).parents[4]
SMALL = ("cube", "gear", "thin-plate", "skull-coarse")


def certified(name: str, kind: str, number: int, robot: str, steps: int, **more: float) -> None:
    """Drive and query one damaged mesh; every other case with actuation noise."""
    mesh = damage(kind, meshes.arrays(name), seed=number)
    result = campaign.drive(
        robots.load(robot), mesh, rule="certified", radius=5e-4 if number % 3 else 5e-3,
        steps=steps, seed=number, noise=5e-3 if number % 2 else 0.0, **more,
    )  # fmt: skip
    assert result.ticks == steps
    assert result.crossings == 0, f"{name}, {kind}, {robot}: {result.first}"
    assert result.inside == 0, f"{name}, {kind}, {robot}"


@pytest.mark.parametrize("kind", everyday(kinds(), "flipped", "sheet"))
def test_nothing_gets_through_with_point(kind):
    for k, name in enumerate(SMALL):
        certified(name, kind, 10 * kinds().index(kind) + k, "point", 250)


@pytest.mark.parametrize("kind", ["none", "flipped", "holes", "slivers", "sheet"])
def test_nothing_gets_through_with_psm(kind):
    for k, name in enumerate(("torus", "skull-coarse")):
        certified(name, kind, 10 * kinds().index(kind) + k, "psm", 250)


@pytest.mark.parametrize("kind", ["none", "unwelded", "fin", "sheet"])
def test_no_part_of_a_ball_shaped_tip_gets_through(kind):
    for k, name in enumerate(("gear", "saddle-slab")):
        certified(name, kind, 10 * kinds().index(kind) + k, "point", 400, tip_radius=5e-4)


def test_a_fast_arm_with_an_automatic_radius_gets_nothing_through():
    mesh = damage("holes", meshes.arrays("star-prism"))
    result = campaign.drive(
        robots.load("point"), mesh, rule="certified", radius=None, steps=800, seed=4, noise=5e-3
    )
    assert result.crossings == 0, result.first


@pytest.mark.parametrize("kind", everyday(kinds(), "unwelded", "slivers"))
def test_nothing_leaks(kind):
    for k, name in enumerate(SMALL):
        mesh = damage(kind, meshes.arrays(name), seed=k)
        for edges in (0.3, 1.0, 3.0):
            found = campaign.query(
                mesh, rule="certified", edges=edges, queries=25, seed=k,
                standoff=20e-6 if k % 2 else 0.0,
            )  # fmt: skip
            assert found.queries == 25
            assert found.leaking == 0, f"{name}, {kind}, {edges} edges: {found.first}"
            assert 0 < found.free <= 2 * 64  # two of the queries are sampled for what is blocked


# What stands around the tip


@pytest.mark.parametrize("scene", scenes.SCENES[1:], ids=lambda scene: scene.name)
def test_nothing_gets_through_whatever_stands_around_the_tip(scene: scenes.Scene) -> None:
    for k, name in enumerate(("gear", "thin-plate")):
        result = campaign.drive(
            robots.load("point"), damage("holes", meshes.arrays(name)), rule="certified",
            radius=5e-3, steps=120, seed=k, noise=5e-3 * k, scene=scene,
        )  # fmt: skip
        assert result.ticks == 120
        assert result.crossings == 0, result.first
        assert result.inside == 0
        if scene.pins:
            assert result.shrunk > 0


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["psm", "ur5"])
@pytest.mark.parametrize("scene", scenes.SCENES, ids=lambda scene: scene.name)
def test_nothing_gets_through_with_an_arm_whatever_stands_around(scene, robot) -> None:
    for k, name in enumerate(("gear", "torus", "skull-coarse")):
        result = campaign.drive(
            robots.load(robot), damage("flipped", meshes.arrays(name)), rule="certified",
            radius=(None, 5e-3)[k % 2], steps=300, seed=k, scene=scene,
        )  # fmt: skip
        assert result.crossings == 0, result.first


def test_every_surface_of_a_scene_and_its_corridor_are_judged() -> None:
    x, down = np.zeros(3), np.array([0.0, 0.0, -1.0])
    depths = iter((1e-3, 2e-3, 3e-3))
    floor = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]])
    around = scenes.Surroundings(
        scenes.Scene("all", meshes=3, pins=True, corridor=True),
        lambda: vf.Surface.from_arrays(floor + next(depths) * down, [[0, 1, 2]]),
        x, "certified", 5e-3, 0.0, np.random.default_rng(1),
    )  # fmt: skip
    assert len(around.fixtures) == 5
    corridor = around.fixtures[-1]
    assert isinstance(corridor, vf.CorridorFixture)
    across = np.cross(corridor.direction, down)
    for k in range(4):
        y = (1e-3 * k + 5e-4) * down
        out = oracles.lateral_distance(corridor.path, corridor.direction, y) > corridor.width
        assert around.crossings(x, y) == k + out
    assert around.crossings(x, 0.5 * across / np.linalg.norm(across)) == 1  # the corridor alone
    assert around.crossings(x, 2.0 * around.surfaces[3].vertices[0]) >= 1  # a pin


def test_a_ball_that_is_between_the_walls_is_in_the_corridor() -> None:
    """Inside a bend its centre may be farther from a leg than the width less its radius."""
    far, tip, beside = vf.Surface.from_arrays(np.eye(3) + 5.0, [[0, 1, 2]]), 5e-4, 0
    rng = np.random.default_rng(4)
    for seed in range(10):
        around = scenes.Surroundings(
            scenes.Scene("ball", corridor=True), lambda: far, np.zeros(3), "certified", 5e-3, tip,
            np.random.default_rng(seed),
        )  # fmt: skip
        corridor = around.fixtures[-1]
        assert isinstance(corridor, vf.CorridorFixture)
        spots = corridor.path[rng.integers(1, 5, 600)]
        for x in spots + 0.4 * corridor.width * rng.normal(size=(600, 3)):
            off = oracles.lateral_distance(corridor.path, corridor.direction, x)
            between = corridor.room(x) >= tip
            if between and off > corridor.width - tip:
                beside += 1
                assert around.crossings(x, x) == 0, (seed, x)
            elif not between and off > corridor.width:
                assert around.crossings(x, x) == 1, (seed, x)
    assert beside > 0


def test_the_distance_from_a_path_seen_along_the_cut():
    path = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 5.0], [1.0, 1.0, -3.0], [1.0, 1.0, 2.0]])
    for p, distance in (
        ([0.5, 0.5, 9.0], 0.5), ([-2.0, 0.3, 1.0], 2.0), ([-1.0, -7.0, 0.0], 1.0),
        ([5.0, 1.5, 0.0], 0.5), ([-3.0, 5.0, 0.0], 5.0)):  # fmt: skip
        found = oracles.lateral_distance(path, np.array([0.0, 0.0, 1.0]), np.array(p))
        assert found == pytest.approx(distance), p


# The campaign has teeth


def test_without_planes_the_hands_get_through():
    for robot in ("point", "psm"):
        result = campaign.drive(
            robots.load(robot), meshes.arrays("cube"), rule="off", radius=5e-3, steps=800, seed=1
        )
        assert result.crossings > 5
        assert re.fullmatch(r"tick \d+: \[.*\] → \[.*\]", result.first)


def test_the_papers_conditions_let_hands_through_flipped_faces():
    """On the damaged gear, from outside; on the whole one they hold."""
    whole = meshes.arrays("gear")
    outside_of = vf.Surface.from_arrays(*whole)
    crossings = {}
    for kind in ("none", "inside-out"):
        result = campaign.drive(
            robots.load("point"), damage(kind, whole), rule="paper", radius=5e-4, steps=2000,
            seed=2, outside_of=outside_of,
        )  # fmt: skip
        crossings[kind] = result.crossings
    assert crossings["none"] == 0
    assert crossings["inside-out"] > 0


@pytest.mark.parametrize("kind", ["unwelded", "flipped", "inside-out", "holes", "jittered"])
def test_the_papers_conditions_leak_on_damaged_meshes(kind):
    whole = meshes.arrays("skull-coarse")
    outside_of = vf.Surface.from_arrays(*whole)
    leaking = {}
    for case in ("none", kind):
        found = campaign.query(
            damage(case, whole), rule="paper", edges=1.0, queries=150, seed=3,
            outside_of=outside_of,
        )  # fmt: skip
        leaking[case] = found.leaking
    assert leaking["none"] == 0
    assert leaking[kind] > 0


def test_a_weakened_cover_is_caught(monkeypatch):
    """The certified planes, but one standoff too far behind the surface: hands and queries see."""
    honest = cover

    def weakened(surface, x, radius, standoff, tip_radius, *margins):
        planes = honest(surface, x, radius, standoff, tip_radius, *margins)
        back = standoff + 5e-5
        return replace(
            planes,
            offsets=planes.offsets - back,
            floors=planes.floors - back,
            points=planes.points - back * planes.normals,
        )

    monkeypatch.setattr("vf.rules.certified.cover", weakened)
    monkeypatch.setattr(fixtures, "cover", weakened)
    monkeypatch.setattr(fixtures, "Search", lambda *_, **__: None)  # ticks ask the fixture
    mesh = meshes.arrays("cube")
    driven = campaign.drive(
        robots.load("point"), mesh, rule="certified", radius=5e-4, steps=2000, seed=5
    )
    assert driven.crossings > 0
    assert campaign.query(mesh, rule="certified", edges=1.0, queries=60, seed=5).leaking > 0


def test_a_ball_is_judged_whole():
    """The same hands as above: guarded for a point, a ball of half a millimetre cuts the mesh."""
    mesh = meshes.arrays("cube")
    drive = {}
    for guarded in (0.0, 5e-4):
        drive[guarded] = _drive_ball(mesh, guarded)
    assert drive[5e-4] == 0
    assert drive[0.0] > 0


def _drive_ball(mesh, guarded: float) -> int:
    settings = vf.Settings

    def forced(**values: float) -> vf.Settings:
        return settings(**{**values, "tip_radius": guarded})

    forced.standoff = settings.standoff  # type: ignore[attr-defined]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(vf, "Settings", forced)
        return campaign.drive(
            robots.load("point"), mesh, rule="certified", radius=5e-4, steps=1200, seed=6,
            tip_radius=5e-4,
        ).crossings  # fmt: skip


def test_actuation_error_is_bounded_and_really_there():
    arm = robots.load("psm")
    rng = np.random.default_rng(7)
    q = arm.lower + 0.4 * (arm.upper - arm.lower)
    p = arm.tip(q).translation
    errors = [
        np.linalg.norm(arm.tip(campaign._actuate(arm, q, 2.5e-6, rng)).translation - p)
        for _ in range(200)
    ]
    assert max(errors) <= 2.5e-6
    assert max(errors) > 2e-6


def test_starts_are_free_and_near_the_surface_all_over_the_range():
    arm = robots.load("psm")
    rng = np.random.default_rng(8)
    limits = 0
    for name in ("cube", "thin-plate"):
        for _ in range(20):
            q = campaign.random_joints(arm, rng)
            assert (q >= arm.lower).all()
            assert (q <= arm.upper).all()
            limits += int(((q == arm.lower) | (q == arm.upper)).any())
            p = arm.tip(q).translation
            surface = campaign._surface_near(meshes.arrays(name), p, 1e-3, None, rng)
            assert 1e-3 < surface.nearest(p)[0] < 4.1e-3
            assert not surface.inside(p)
    assert limits > 5


# The same numbers again


def _numbers(result: campaign.Drive) -> tuple:
    return (result.ticks, result.crossings, result.first, result.statuses, result.planes,
            result.forbidden, result.free)  # fmt: skip


def test_a_seed_gives_the_same_campaign_whoever_watches():
    arm, mesh = robots.load("point"), meshes.arrays("gear")
    seen: list[int] = []
    runs = [
        campaign.drive(arm, mesh, rule="off", radius=5e-3, steps=900, seed=seed, **watch)
        for seed, watch in ((9, {}), (9, {"progress": seen.append}), (10, {}))
    ]
    assert _numbers(runs[0]) == _numbers(runs[1])
    assert _numbers(runs[0]) != _numbers(runs[2])
    assert sum(seen) == 900
    seen.clear()
    covers = [
        campaign.query(mesh, rule="certified", edges=1.0, queries=250, seed=seed, **watch)
        for seed, watch in ((9, {}), (9, {"progress": seen.append}), (10, {}))
    ]
    assert covers[0] == covers[1]
    assert covers[0] != covers[2]
    assert sum(seen) == 250


# The command


def command(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "app", "verify", *words],
        capture_output=True, text=True, timeout=120, cwd=ROOT,
    )  # fmt: skip


def test_the_command_says_that_nothing_got_through():
    result = command("--mesh", "cube", "--damage", "holes", "--steps", "400", "--queries", "60")
    assert result.returncode == 0, result
    assert "0 crossings at radius 0.5mm, 5mm, 0 leaks" in result.stdout
    assert "cube" in result.stdout
    assert "Traceback" not in result.stderr


def test_the_command_says_what_got_through_and_where(capsys):
    code = call("verify", ["--mesh", "cube", "--rule", "off", "--damage", "none", "--steps",
                           "800", "--queries", "30", "--radius", "5mm"])  # fmt: skip
    out = capsys.readouterr().out
    assert code == 1
    assert re.search(r"[1-9]\d* crossings at radius 5mm, [1-9]\d* leaks", out)
    assert "cube, none: tick " in out
    assert "cube, none: query " in out


def test_the_command_reads_a_mesh_file(tmp_path, capsys):
    path = tmp_path / "box.stl"
    trimesh.creation.box((20.0, 20.0, 20.0)).export(path)
    words = ["--mesh", str(path), "--unit", "mm", "--steps", "220"]
    assert call("verify", words) == 0
    out = capsys.readouterr().out
    for kind in kinds():
        assert kind in out


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (
            ["--rule", "soft"],
            "unknown rule 'soft': choose one of certified, paper, all, off, nearest, sdf",
        ),
        (["--damage", "rust"], "unknown damage 'rust': choose one of all, none, unwelded"),
        (["--robot", "r2d2"], "unknown robot 'r2d2'"),
        (["--mesh", "teapot"], "teapot"),
        (["--steps", "-1"], "steps -1 is outside 0 to 1000000000000"),
        (["--steps", "0"], "nothing to do: steps and queries are both 0"),
        (["--noise", "nan"], "noise nan is outside 0 to 0.1"),
        (["--tip-radius", "wide"], "'wide' is not a length"),
        (["--tip-radius", "-1mm"], "tip_radius -1mm is outside 0mm to 5mm"),
        (["--radius", "0"], "radius 0mm is outside 0.05mm to 20mm"),
    ],
)
def test_what_the_command_refuses(words, reason, capsys):
    assert call("verify", words) == 2
    out, told = capsys.readouterr()
    assert out == ""
    assert reason in told
    assert told.count("\n") == 1


def test_a_refusal_is_one_line_and_exit_code_2():
    result = command("--rule", "soft")
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.splitlines() == [
        "vf-sandbox verify: error: unknown rule 'soft': choose one of certified, paper, all, off, "
        "nearest, sdf"
    ]


# The long versions


def _moderate() -> list[str]:
    return [name for name in meshes.names() if len(meshes.arrays(name)[1]) <= 20_000]


@pytest.mark.slow
def test_a_hundred_thousand_ticks_with_point():
    _long("point", 110_000, number=1)


@pytest.mark.slow
def test_twenty_thousand_ticks_with_psm():
    _long("psm", 22_000, number=2)


def _long(robot: str, ticks: int, number: int) -> None:
    cases = [(name, kind) for name in _moderate() for kind in kinds()]
    share = -(-ticks // len(cases))
    for k, (name, kind) in enumerate(cases):
        certified(name, kind, 1000 * number + k, robot, share)


@pytest.mark.slow
def test_twenty_thousand_queries_leak_nowhere_and_rarely_spend_the_budget():
    queries = shrunk = 0
    cases = [(name, kind) for name in _moderate() for kind in kinds()]
    share = -(-20_000 // (3 * len(cases)))
    for k, (name, kind) in enumerate(cases):
        mesh = damage(kind, meshes.arrays(name), seed=k)
        for edges in (0.3, 1.0, 3.0):
            found = campaign.query(
                mesh, rule="certified", edges=edges, queries=share, seed=k,
                standoff=20e-6 if k % 2 else 0.0,
            )  # fmt: skip
            assert found.leaking == 0, f"{name}, {kind}, {edges} edges: {found.first}"
            queries += found.queries
            shrunk += found.shrunk
    assert queries >= 20_000
    assert shrunk < queries / 200
