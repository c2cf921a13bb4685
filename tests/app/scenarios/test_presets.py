"""Presets: each shows what its sentence says; one is chosen by its name."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import vf
from app import __main__ as main
from app import cli
from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats, Telemetry
from app.judges import boxes
from app.judges.nearest import gaps
from app.judges.sweep import Judge
from app.scenarios.presets import PRESETS
from app.scenarios.staging import course
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.settings import Options
from tests.support.brute import Oracle

DOCUMENT = Path(__file__).parents[3] / "docs" / "scenarios.md"


Played = Callable[..., tuple[Scene, list[Telemetry]]]


@pytest.fixture(params=[250.0, pytest.param(1000.0, marks=pytest.mark.slow)])
def played(request: pytest.FixtureRequest) -> Played:
    """A preset from its start to half a second after its script, tick by tick; options changed."""

    def play(name: str, **changes: str) -> tuple[Scene, list[Telemetry]]:
        scenario = PRESETS[name]
        options = replace(scenario.applied(Options(rate=request.param)), **changes)
        scene = built(replace(options, rate=1000.0, rule="certified", guard="tool"))
        way = course(scenario, scene)
        assert way is not None
        plant = scenes.plant(replace(scene, autopilot=way), options)
        orders = Orders(plant, Command(None, 0), autopilot=True)
        engine, stats = Engine(orders), LoopStats()
        ticks = round((way.duration + 0.5) / options.dt)
        return scene, [engine.advance(orders, stats)[0] for _ in range(ticks)]

    return play


@cache
def built(options: Options) -> Scene:
    """A scene of a preset depends neither on the rate nor on the rule or the guard."""
    return scenes.build(options, 1)


def tips(seen: list[Telemetry]) -> np.ndarray:
    return np.array([telemetry.step.tip.translation for telemetry in seen])  # type: ignore[union-attr]


def in_mesh(scene: Scene, p_base: np.ndarray) -> np.ndarray:
    return (p_base - scene.T_base_mesh[:3, 3]) @ scene.T_base_mesh[:3, :3]


def pushing_rules(telemetry: Telemetry) -> set[int]:
    """Rules of the planes that push the tool back."""
    step = telemetry.step
    assert step is not None
    return set(step.planes.rules[step.multipliers > 1e-9].tolist())


def test_every_preset_has_a_sentence_of_its_own() -> None:
    assert len({scenario.about for scenario in PRESETS.values()}) == len(PRESETS) == 17
    for name, scenario in PRESETS.items():
        assert name == scenario.name
        assert scenario.about.endswith(".")
        assert f"| `{name}` | {scenario.about} |" in DOCUMENT.read_text()


def test_the_push_on_the_skull_ends_at_the_standoff(played: Played) -> None:
    scene, seen = played("push-on-the-skull")
    truth, path = Oracle(scene.surface.vertices, scene.surface.faces), tips(seen)
    target, step = seen[-1].target, seen[-1].step
    assert target is not None
    assert step is not None
    assert truth.crossings(path) == 0
    goals = np.array([t.target.translation for t in seen])  # type: ignore[union-attr]
    assert truth.crossings(goals[::5]) > 0  # the hand itself did go into the bone
    blade = gaps(boxes.of(scene.surface), scene.arm, seen[-1].q)[0]
    assert blade == pytest.approx(20e-6, abs=2e-6)
    _, alone = played("push-on-the-skull", guard="tip")
    assert scene.surface.nearest(tips(alone)[-1])[0] == pytest.approx(20e-6, abs=2e-6)
    assert np.linalg.norm(step.force) == pytest.approx(1.4, abs=0.05)


def test_the_slide_into_the_orbit_ends_in_its_hollow(played: Played) -> None:
    scene, seen = played("slide-into-the-orbit")
    path, surface = tips(seen), scene.surface
    truth = Oracle(surface.vertices, surface.faces)
    assert truth.crossings(path) == 0
    assert abs(truth.winding(path[-1])) < 0.5
    # How deep below a cloth that is spanned over the skull, without using any of its triangles.
    hull = ConvexHull(surface.vertices)
    touched = next(k for k, t in enumerate(seen) if pushing_rules(t))
    first, last = path[[touched, -1]] @ hull.equations[:, :3].T + hull.equations[:, 3]
    assert -first.max() < 1e-3
    assert -last.max() > 5e-3
    orbit = np.array([0.40, 0.86, -0.32])
    direction = in_mesh(scene, path[-1])
    assert direction @ orbit / np.linalg.norm(direction) / np.linalg.norm(orbit) > 0.99


def test_the_thin_plate_is_guarded_from_both_sides(played: Played) -> None:
    scene, seen = played("thin-plate-both-sides")
    path = tips(seen)
    assert Oracle(scene.surface.vertices, scene.surface.faces).crossings(path) == 0
    goals = in_mesh(scene, np.array([t.target.translation for t in seen]))  # type: ignore[union-attr]
    height = in_mesh(scene, path)[:, 2]
    pressed = np.flatnonzero((goals[:, 2] < -7e-3) & (goals[:, 0] > -0.0421))[0]
    assert height[pressed] == pytest.approx(0.25e-3 + 20e-6, abs=2e-6)
    assert goals[-1, 2] > 7e-3
    assert height[-1] == pytest.approx(-0.25e-3 - 20e-6, abs=2e-6)


def test_in_the_gap_of_the_gear_the_tool_leans_on_a_valley(played: Played) -> None:
    scene, seen = played("valley-of-the-gear")
    assert vf.Rule.VALLEY in pushing_rules(seen[-1])
    p = in_mesh(scene, tips(seen)[-1])
    # Between the teeth: below their tips, above the root circle.
    assert 0.0305 < math.hypot(p[0], p[1]) < 0.036
    assert abs(p[2]) < 7.5e-3


def test_on_the_saddle_there_are_ridges_and_valleys(played: Played) -> None:
    scene, seen = played("saddle")
    step = seen[-1].step
    assert step is not None
    assert {vf.Rule.RIDGE, vf.Rule.VALLEY} <= set(step.planes.rules.tolist())
    assert pushing_rules(seen[-1])
    assert np.linalg.norm(in_mesh(scene, tips(seen)[-1])[:2]) < 1.5e-3


def test_on_the_unclean_mesh_the_papers_rule_fails_and_the_certified_one_holds(
    played: Played,
) -> None:
    (scene, failed), (other, held) = (
        played("unclean-mesh-paper"), played("unclean-mesh-certified"),
    )  # fmt: skip
    np.testing.assert_array_equal(scene.surface.vertices, other.surface.vertices)
    for a, b in zip(failed[::25], held[::25], strict=True):
        assert a.target == b.target
    truth = Oracle(scene.surface.vertices, scene.surface.faces)
    assert truth.crossings(tips(failed)) >= 2  # in through the outer and out of the inner side
    assert truth.crossings(tips(held)) == 0
    # The clean skull tells where it all ended: within the head, and outside the bone.
    clean = scenes.build(Options(mesh="skull-coarse"), 1).surface
    goal = held[-1].target
    assert goal is not None
    assert np.linalg.norm(tips(failed)[-1] - goal.translation) < 1e-5
    outside = Oracle(clean.vertices, clean.faces)
    assert outside.crossings(np.array([tips(held)[-1], goal.translation])) == 1
    assert abs(outside.winding(tips(held)[-1])) < 0.5


@pytest.mark.slow
def test_the_million_triangles_are_all_in_force(played: Played) -> None:
    scene, seen = played("million-triangles")
    assert f"{len(scene.surface.faces) // 1000} thousand" in PRESETS["million-triangles"].about
    path = tips(seen)
    assert Oracle(scene.surface.vertices, scene.surface.faces).crossings(path) == 0
    sliding = [k for k, t in enumerate(seen) if pushing_rules(t)]
    assert np.linalg.norm(np.diff(path[sliding], axis=0), axis=1).sum() > 0.02


def crossings(scene: Scene, seen: list[Telemetry]) -> dict[str, int]:
    """Ticks on whose way, as the joints go, a part of the instrument is in the mesh, by part."""
    arm = scene.arm.copy()
    judge = Judge(arm, scene.surface.vertices, scene.surface.faces)
    found: dict[str, int] = {}
    for before, after in itertools.pairwise([scene.start, *(t.q for t in seen)]):
        for touch in judge.touches(before, after):
            name = arm.capsules[touch.capsule].name
            found[name] = found.get(name, 0) + 1
    return found


def held(scene: Scene, telemetry: Telemetry) -> set[str]:
    """The parts that planes hold back in a tick."""
    step = telemetry.step
    assert step is not None
    assert step.planes.capsules is not None
    capsules = step.planes.capsules[step.multipliers > 1e-7]
    return {scene.arm.capsules[k].name for k in capsules}


INSTRUMENT = ("through-the-fontanelle", "keyhole", "around-the-corner")


@pytest.mark.parametrize("name", INSTRUMENT)
def test_no_part_of_the_instrument_crosses_and_with_the_tip_guarded_alone_the_shaft_does(
    played: Played, name: str
) -> None:
    scene, guarded = played(name)
    assert crossings(scene, guarded) == {}
    assert any(held(scene, telemetry) == {"shaft"} for telemetry in guarded)
    # The tip itself is free: what holds it back is the shaft.
    assert all("blade" not in held(scene, telemetry) for telemetry in guarded)
    _, alone = played(name, guard="tip")
    assert crossings(scene, alone)["shaft"] > 0.2 * len(alone)
    assert Oracle(scene.surface.vertices, scene.surface.faces).crossings(tips(alone)) == 0
    goal = alone[-1].target
    assert goal is not None
    assert np.linalg.norm(tips(alone)[-1] - goal.translation) < 1e-4


def test_in_the_fontanelle_the_shaft_leans_on_the_rim_from_all_sides(played: Played) -> None:
    scene, seen = played("through-the-fontanelle")
    normals = []
    for telemetry in seen:
        step = telemetry.step
        assert step is not None
        if held(scene, telemetry) == {"shaft"}:
            normals.append(step.planes.normals[step.multipliers.argmax()])
    angles = np.degrees(np.arctan2(*np.array(normals)[:, 1::-1].T)) % 360.0
    # The rim is a rhombus: four sides, and the shaft leans on each.
    sides = np.unique(np.round((angles - 45.0) / 90.0) % 4)
    assert len(sides) == 4
    inside = in_mesh(scene, tips(seen))[-1]
    assert inside[2] < 0.02  # 4 cm below the crown


def test_in_the_keyhole_the_tip_moves_by_what_the_shaft_has(played: Played) -> None:
    scene, seen = played("keyhole")
    goals = in_mesh(scene, np.array([t.target.translation for t in seen]))  # type: ignore[union-attr]
    path = in_mesh(scene, tips(seen))
    below = path[:, 2] < -0.0345
    assert np.abs(goals[below, :2]).max() > 0.0149
    assert 0.3e-3 < np.abs(path[below, 0]).max() < 1e-3


def test_around_the_corner_the_two_guards_side_by_side(played: Played) -> None:
    (scene, tool), (_, tip) = played("around-the-corner"), played("around-the-corner-tip-only")
    for a, b in zip(tool[::25], tip[::25], strict=True):
        assert a.target == b.target
    away = np.linalg.norm(tips(tool) - tips(tip), axis=1)
    round_the_edge = next(k for k, t in enumerate(tool) if held(scene, t))
    assert away[:round_the_edge].max() < 1e-9
    assert away[-1] > 0.01
    assert crossings(scene, tip).keys() == {"wrist", "shaft"}


def test_in_the_temporal_bone_each_structure_holds_the_burr_at_its_margin(played: Played) -> None:
    scene, seen = played("temporal-bone")
    scenario = PRESETS["temporal-bone"]
    options = scenes.settled(scenario.applied(Options()), scene)
    assert not options.anatomy[0].guarded
    bone, path = scene.surface, tips(seen)
    assert any(bone.inside(p) for p in path[::25])  # the burr cuts
    margins = {own.name: own.margin for own in options.structures}
    assert sorted({margin for margin in margins.values() if margin}) == [0.5e-3, 1e-3, 2e-3, 3e-3]
    held: set[str] = set()
    for telemetry in seen:
        step = telemetry.step
        assert step is not None
        assert step.planes.fixtures is not None
        pushing = step.planes.fixtures[step.multipliers > 1e-9]
        held |= {str(options.structures[k].name) for k in set(pushing.tolist())}
    assert held >= {"facial nerve", "chorda tympani", "incus", "sigmoid sinus", "dura"}
    for own, built in zip(options.structures, scene.structures, strict=True):
        surface = built.surface
        assert Oracle(surface.vertices, surface.faces).crossings(path) == 0, own.name
        assert own.margin is not None
        # By the judges' search: the ball of the burr, and every other part, keep the margin.
        around = boxes.of(surface)
        near = min(float(gaps(around, scene.arm, t.q).min()) for t in seen[::20])
        assert near > own.margin, own.name
        assert min(surface.nearest(p)[0] for p in path[::10]) > own.margin + 1e-3, own.name


def test_a_scenario_by_its_name_and_options_that_win_over_it() -> None:
    options, scenario = cli._parsed(["--scenario", "saddle", "--radius", "2mm", "--port", "0"])
    assert scenario == PRESETS["saddle"]
    assert (options.mesh, options.rule, options.radius) == ("saddle-slab", "paper", 2e-3)
    assert options.port == 0
    # Also back to what is the default without a scenario.
    options, _ = cli._parsed(["--scenario", "saddle", "--rule", "certified", "--radius", "5mm"])
    assert (options.rule, options.radius) == ("certified", 5e-3)
    assert cli._parsed(["--scenario", "saddle", "--mesh", "saddle-slab"])[1] is not None


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--scenario", "sadle"], "unknown scenario 'sadle': choose one of push-on-the-skull, "),
        (["--scenario", "no.json"], "no.json: cannot be read (No such file or directory)"),
        (
            ["--scenario", "saddle", "--mesh", "cube"],
            "--mesh cube with --scenario saddle: the scenario is made for the mesh saddle-slab; "
            "leave one of the two out",
        ),
        (["--scenario", "saddle", "--rule", "soft"], "unknown rule 'soft'"),
    ],
)
def test_a_scenario_that_cannot_be_is_one_line(
    words: list[str], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main([*words, "--port", "0"]) == 2
    told = capsys.readouterr().err.strip()
    assert line in told
    assert "\n" not in told
