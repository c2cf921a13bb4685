"""A judge that took its triangles from what it judges would be blind to the same ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import meshes
import robots
import vf
from app.commands import call
from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats
from app.control.watch import Watch
from app.judges import oracles
from app.judges.meeting import first_meeting, sees
from app.scene import scene as scenes
from app.settings import Options
from app.studies.experiments import judge
from app.studies.verification import campaign
from app.view.inspector.compare import Comparison, Pose
from vf.tree import build as trees
from vf.tree.pdtree import Tree

LINK = 15  # column of a node's record that says where its children or triangles are


def forget(tree: Tree) -> None:
    """Every leaf loses its triangles."""
    leaves = tree.nodes[:, LINK] < 0.0
    tree.nodes[leaves, LINK] += -tree.nodes[leaves, LINK] % 64.0


def shrink(tree: Tree) -> None:
    """Every leaf's box shrinks to its centre."""
    tree.nodes[tree.nodes[:, LINK] < 0.0, 3:6] = 0.0


BREAKS = pytest.mark.parametrize("broken", [forget, shrink], ids=lambda broken: broken.__name__)


def broken_surface(arrays: tuple, broken: Callable[[Tree], None]) -> vf.Surface:
    surface = vf.Surface.from_arrays(*arrays)
    surface.tree.nodes.flags.writeable = True
    broken(surface.tree)
    return surface


def partly(broken: Callable[[Tree], None], faces: int) -> Callable[..., Tree]:
    """What builds trees, and breaks every fourth leaf of those over so many triangles."""
    honest = trees.build

    def build(vertices: np.ndarray, triangles: np.ndarray, leaf: int = trees.LEAF) -> Tree:
        tree = honest(vertices, triangles, leaf)
        if len(triangles) == faces:
            worse = tree._replace(nodes=tree.nodes.copy())
            broken(worse)
            rows = np.flatnonzero(tree.nodes[:, LINK] < 0.0)[::4]
            tree.nodes[rows] = worse.nodes[rows]
        return tree

    return build


# The campaign


@BREAKS
def test_the_campaign_notices_a_box_that_lost_its_triangles(
    broken: Callable[[Tree], None],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["--mesh", "cube", "--damage", "none", "--steps", "3000", "--queries", "120"]
    honest = call("verify", words)
    assert honest == 0
    capsys.readouterr()
    monkeypatch.setattr("vf.surface.build", partly(broken, len(meshes.arrays("cube")[1])))
    assert call("verify", words) == 1
    out = capsys.readouterr().out
    assert "cube, none: query " in out
    assert "cube, none: one mesh, tick " in out


def test_a_tick_is_judged_whatever_the_controller_calls_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """INSIDE is the controller's own word: it excuses nothing before anything was crossed."""
    honest = vf.Controller.step
    monkeypatch.setattr(
        vf.Controller, "step", lambda *of: replace(honest(*of), status=vf.Status.INSIDE)
    )
    result = campaign.drive(
        robots.load("point"), meshes.arrays("cube"), rule="off", radius=5e-3, steps=1200, seed=1
    )
    assert result.inside == result.ticks
    # Three starts, and what follows a crossing is the way out again.
    assert 1 <= result.crossings <= 3


# The oracles, and the judge of the experiments


@BREAKS
def test_the_oracles_do_not_look_at_the_tree(broken: Callable[[Tree], None]) -> None:
    arrays = meshes.arrays("gear")
    whole, surface = vf.Surface.from_arrays(*arrays), broken_surface(arrays, broken)
    rng = np.random.default_rng(1)
    counts = np.zeros(6, dtype=int)
    for k in range(80):
        a = whole.vertices[rng.integers(len(whole.vertices))] + rng.normal(size=3) * 1e-3
        b = a + rng.normal(size=3) * 2e-3
        planes = vf.every_plane(whole, a, 2e-3)
        few = replace(planes, normals=planes.normals[:2], offsets=planes.offsets[:2])
        answers = []
        for one in (whole, surface):
            met = first_meeting(one, a[None], b[None], 3e-4)
            answers.append(
                (
                    oracles.crossings(one, a, b),
                    oracles.overlaps(one, a, b, 5e-4),
                    oracles.leaks(one, few, a, 2e-3),
                    *oracles.blocked(one, few, a, 2e-3, np.random.default_rng(k), 8),
                    not sees(one, a, b),
                    -1 if met is None else met.triangle,
                )
            )
        assert answers[0] == answers[1]
        counts += np.array(answers[0][:6]) > 0
        counts[5] += answers[0][6] >= 0
    assert (counts > 5).all()
    # What it is broken for: the library itself finds nothing any more.
    assert len(surface.within(surface.vertices[0], 1e-3)) < len(
        whole.within(whole.vertices[0], 1e-3)
    )


def test_the_judge_of_the_experiments_has_no_tree_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trees, "_build", None)
    vertices, faces = meshes.arrays("cube")
    top = vertices[:, 2].max()
    way = np.array([[1e-3, 2e-3, top + 1e-3], [1e-3, 2e-3, top - 1e-3]])
    assert judge.crossings(vertices, faces, way) > 0


# The watch, and the comparison of rules


def test_the_watch_sees_the_tool_go_through_triangles_that_the_tree_lost() -> None:
    options = Options(mesh="thin-plate", robot="point", rule="certified")
    scene = scenes.build(options, 1)
    through = []
    lost = broken_surface((scene.surface.vertices, scene.surface.faces), forget)
    for surface in (scene.surface, lost):
        plant = scenes.plant(replace(scene, surface=surface), options)
        orders = Orders(plant, Command(None, 0))
        engine, watch = Engine(orders), Watch()
        start = scene.T_base_start
        below = pin.SE3(start.rotation, start.translation - np.array([0.0, 0.0, 0.03]))
        for k in range(400):
            orders = replace(orders, command=Command(below, 1))
            watch.take(orders, *engine.advance(orders, LoopStats()))
            if k % 100 == 0:
                watch.look()
        watch.look()
        through.append(watch.crossing)
    assert through[0] is None
    assert through[1] is not None
    assert through[1].rule == "certified"


def test_the_comparison_of_rules_sees_what_the_tree_lost() -> None:
    options = Options(mesh="thin-plate", robot="point", rule="certified")
    scene = scenes.build(options, 1)
    surface = broken_surface((scene.surface.vertices, scene.surface.faces), forget)
    scene = replace(scene, surface=surface)
    tip = scene.T_base_start
    x = np.array(tip.translation)
    x[2] = surface.vertices[:, 2].max() + 5e-6
    q = scene.arm.inverse(pin.SE3(tip.rotation, x), start=scene.start)
    goal = pin.SE3(tip.rotation, x - np.array([0.0, 0.0, 0.01]))
    found = Comparison(scene).forecasts(surface, x, 5e-4, options, Pose(q, goal))
    certified = next(one for one in found if one.rule == "certified")
    assert certified.leaking > 0.0
    assert certified.crosses
