"""The whole instrument on the page: its parts in banner, read-outs, inspector and scene."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import viser

import vf
from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats
from app.scenarios.presets import PRESETS
from app.scenarios.staging import course
from app.scene import scene as scenes
from app.scene.moment import Moment
from app.settings import Options
from app.view import palette
from app.view.controls import panel
from app.view.drawing import fixture
from app.view.drawing.instrument import LIFT, Instrument, part_states, solid
from app.view.drawing.labels import Labels
from app.view.inspector import descriptions
from app.view.inspector.inspection import Inspector, Request, Subject
from app.view.tabs import readouts
from app.view.tabs.measuring import Measuring
from app.view.units import VIEW_SCALE

SHAFT = 2


@pytest.fixture(scope="module")
def leaning() -> Moment:
    """The shaft against the edge of a plate, the tip free below it."""
    scenario = PRESETS["around-the-corner"]
    options = scenario.applied(Options(rate=250.0))
    scene = scenes.build(options, 1)
    way = course(scenario, scene)
    assert way is not None
    orders = Orders(
        scenes.plant(replace(scene, autopilot=way), options), Command(None, 0), autopilot=True
    )
    engine = Engine(orders)
    for _ in range(round(4.0 / options.dt)):
        telemetry, _ = engine.advance(orders, LoopStats())
    assert telemetry.step is not None
    assert telemetry.step.planes.capsules is not None
    return Moment(scene, options, telemetry, False)


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    made = viser.ViserServer("127.0.0.1", 0, verbose=False)
    yield made
    made.stop()


def step_of(moment: Moment) -> vf.Step:
    assert moment.telemetry.step is not None
    return moment.telemetry.step


def text(html: str) -> str:
    return re.sub(r"<[^>]*>", "", html)


def test_banner_and_read_outs_say_which_part_is_held_and_which_is_nearest(leaning: Moment) -> None:
    extras = Measuring().measure(leaning, 0, "")
    n = int((step_of(leaning).multipliers > fixture.MIN_PUSH).sum())
    planes = f"{n} plane{'s' if n > 1 else ''}"
    said = text(readouts.banner(leaning.telemetry, leaning.options, extras, False))
    assert f"The fixture holds the shaft back ({planes}): " in said
    table = text(readouts.readouts(leaning.telemetry, leaning.options, extras))
    assert "guardedwhole tool" in table
    assert re.search(r"nearest part: shaft0\.02\dmm", table)
    capsules = step_of(leaning).planes.capsules
    for k, capsule in enumerate(leaning.scene.arm.capsules):
        assert f"of the {capsule.name}{(capsules == k).sum()}" in table


def test_a_banner_counts_the_planes_of_every_part_that_is_held(leaning: Moment) -> None:
    step = step_of(leaning)
    extras = Measuring().measure(leaning, 0, "")

    def said(capsules: list[int], options: Options) -> str:
        m = len(capsules)
        planes = replace(
            step.planes,
            normals=np.tile([0.0, 0.0, 1.0], (m, 1)), offsets=np.zeros(m), points=np.zeros((m, 3)),
            triangles=np.zeros(m, dtype=np.int64), rules=np.zeros(m, dtype=np.int64), floors=None,
            capsules=np.array(capsules), fixtures=None, of_axis=np.array(capsules) > 0,
        )  # fmt: skip
        told = replace(step, planes=planes, multipliers=np.full(m, 1e-5))
        telemetry = replace(leaning.telemetry, step=told)
        return text(readouts.banner(telemetry, options, extras, False))

    assert "holds the blade back (1 plane):" in said([0], leaning.options)
    assert "holds the blade and shaft back (3 planes: blade 1, shaft 2):" in said(
        [2, 0, 2], leaning.options
    )
    assert "holds the blade, wrist and shaft back (3 planes: " in said([0, 1, 2], leaning.options)
    tip = replace(leaning.options, guard="tip")
    assert "holds the tool back (2 planes):" in said([0, 0], tip)


def test_the_inspector_says_what_holds_the_shaft_and_leaves_the_tip_its_region(
    leaning: Moment,
) -> None:
    step, scene = step_of(leaning), leaning.scene
    subject = Subject(
        scene.surface, np.array(step.tip.translation), step.radius, leaning.options, "certified",
        scene, step, axes=scene.arm.axes(step.q),
    )  # fmt: skip
    inspection = Inspector().inspect(Request(subject, region=True, comparison=False))
    most = int(step.planes.triangles[step.multipliers.argmax()])
    push = float(step.multipliers.sum())
    parts = text(descriptions.parts(inspection))
    assert f"shaftheld back by {push * 1e3:.3f} mm, " in parts
    assert f"most by #{most:,}" in parts
    assert parts.count("no plane near") == 4 - len(np.unique(step.planes.capsules))
    assert inspection.main_triangle() == most
    report = text(descriptions.triangle(inspection, most))
    assert "Plane of the shaft (rule certified)" in report
    away = re.search(r"([\d.]+) mm to its axis", report)
    assert away is not None
    assert float(away[1]) < 2e-3  # pressed onto it
    assert inspection.region is not None
    assert inspection.region.share == pytest.approx(0.98, abs=0.005)  # the whole sphere
    tip_only = replace(inspection, subject=replace(subject, options=Options(guard="tip")))
    assert descriptions.parts(tip_only) == ""


def test_the_disc_of_a_plane_touches_the_capsule_that_it_holds(
    leaning: Moment, server: viser.ViserServer
) -> None:
    labels = Labels(server)
    drawing = fixture.FixtureDrawing(server.scene, labels)
    drawing.frame(leaning, {})
    step, arm = step_of(leaning), leaning.scene.arm
    discs = drawing._rims.batched_positions[: len(step.planes)] / VIEW_SCALE
    assert step.planes.capsules is not None
    assert SHAFT in step.planes.capsules
    for centre, k, push in zip(discs, step.planes.capsules, step.multipliers, strict=True):
        assert leaning.scene.surface.nearest(centre)[0] < 1e-4
        a, b = arm.axes(step.q)[k]
        share = np.clip((centre - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        away = np.linalg.norm(centre - a - share * (b - a)) - arm.capsules[k].radius
        assert away > -1e-6
        if push > fixture.MIN_PUSH:
            assert away < 5e-5
    names = [label.text for label in drawing._names if label.visible]
    assert names == [arm.capsules[k].name for k in np.unique(step.planes.capsules)]
    assert drawing._blocks.visible
    assert drawing._blocks.text.startswith("shaft blocks: ")
    drawing.suppressed = True
    drawing.frame(leaning, {})
    assert not any(label.visible for label in (drawing._blocks, *drawing._names))


def test_capsules_are_drawn_where_they_are_and_coloured_by_what_holds_them(
    leaning: Moment, server: viser.ViserServer
) -> None:
    drawing = Instrument(server.scene)
    drawing.set_scene(leaning.scene)
    drawing.frame(leaning, {})
    assert not any(node.visible for node in drawing._capsules)
    drawing.show = True
    drawing.frame(leaning, {})
    arm, q = leaning.scene.arm, leaning.telemetry.q
    for k, (node, capsule) in enumerate(zip(drawing._capsules, arm.capsules, strict=False)):
        assert node.visible
        w, x, y, z = node.wxyz
        v = np.asarray(node.vertices, dtype=float)
        t = 2.0 * np.cross([x, y, z], v)
        points = (v + w * t + np.cross([x, y, z], t) + node.position) / VIEW_SCALE
        a, b = arm.axes(q)[k]
        share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)[:, None]
        away = np.linalg.norm(points - a - share * (b - a), axis=1)
        np.testing.assert_allclose(away, capsule.radius + LIFT, atol=3e-5)
    near = step_of(leaning).planes.capsules
    assert near is not None
    expected = [palette.PART_NEAR if k in near else palette.PART for k in range(4)]
    expected[SHAFT] = palette.PART_HELD
    assert part_states(leaning) == expected
    assert tuple(drawing._capsules[SHAFT].color) == palette.PART_HELD
    assert not drawing._zone.visible
    drawing.frame(replace(leaning, options=replace(leaning.options, trocar=0.02)), {})
    assert drawing._zone.visible
    np.testing.assert_allclose(drawing._zone.position, 0.0, atol=1e-9)  # the remote centre
    assert float(drawing._zone.scale) == pytest.approx(0.02 * VIEW_SCALE)
    tip = replace(leaning.options, trocar=0.02, guard="tip")
    drawing.frame(replace(leaning, options=tip), {})
    assert not drawing._zone.visible


def test_a_drawn_capsule_is_a_closed_outward_solid() -> None:
    vertices, faces = solid(0.004, 0.1)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    volume = float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0
    true = np.pi * 0.004**2 * (0.1 + 4.0 / 3.0 * 0.004)
    assert volume == pytest.approx(true, rel=0.05)


def test_the_panel_says_which_rules_guard_the_tip_alone() -> None:
    assert panel.guard_help(Options()) == palette.GUARD_HELP["tool"]
    assert panel.guard_help(Options(guard="tip")) == palette.GUARD_HELP["tip"]
    for rule in ("paper", "all"):
        assert "tip alone" in panel.guard_help(Options(rule=rule))
    assert not Options(rule="paper").guards_tool
