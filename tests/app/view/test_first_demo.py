"""The first view: closed anatomy, visible tip, and one colour for each thing."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
import viser

import meshes
import vf
from app.scenarios import presets
from app.scenarios.staging import course
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.settings import Options
from app.view import camera, palette
from app.view.drawing import anatomy
from app.view.drawing.proxy import GIZMO_SIZE
from app.view.tabs import legend, readouts, signals
from tests.support.runs import run_headless

HEIGHT = 900  # of the picture on a usual screen [px]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scenes.build(Options(), 1)


def heights(scene: Scene, xy: np.ndarray) -> np.ndarray:
    """The highest point of the mesh on verticals through xy (n, 2); nan: none (trimesh's rays)."""
    mesh = trimesh.Trimesh(scene.surface.vertices, scene.surface.faces, process=False)
    top = scene.surface.vertices[:, 2].max() + 0.01
    origins = np.column_stack([xy, np.full(len(xy), top)])
    down = np.tile([0.0, 0.0, -1.0], (len(xy), 1))
    points, rays, _ = mesh.ray.intersects_location(origins, down, multiple_hits=False)
    found = np.full(len(xy), np.nan)
    found[rays] = points[:, 2]
    return found


def test_the_first_anatomy_has_no_opening_on_top(scene: Scene) -> None:
    side = np.arange(-0.03, 0.031, 0.0015)
    x, y = np.meshgrid(side, side)
    around = scene.T_base_start.translation[:2] + np.column_stack([x.ravel(), y.ravel()])
    top = heights(scene, around)
    assert np.isfinite(top).all()
    assert top.min() > scene.surface.vertices[:, 2].max() - 0.02, "the top of the cap, not a floor"


@pytest.mark.parametrize("mesh", ["skull-closed", "skull"])
def test_the_autopilot_passes_through_no_opening(mesh: str) -> None:
    options = Options(mesh=mesh, rate=200.0)
    scene = scenes.build(options, 1)
    ticks = round(scene.autopilot.duration * 200)
    seen = run_headless(options, [], ticks, autopilot=True)
    tips = np.array([t.step.tip.translation for t in seen[::4] if t.step is not None])
    assert np.ptp(tips[:, :2], axis=0).max() > 5e-3
    top = heights(scene, tips[:, :2])
    assert np.isfinite(top).all(), "there is bone below the tip"
    assert (tips[:, 2] > top).all(), "and none above it"


def pixels(scene: Scene, points: np.ndarray, view: camera.View | None = None) -> np.ndarray:
    """Points (n, 3) in a view (n, 2) [px], from its centre to the right and up; None: the first."""
    view = view or camera.site_view(scene, scene.T_base_start.translation)
    forward = view.look_at - view.eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    away = points - view.eye
    focal = 0.5 * HEIGHT / np.tan(0.5 * camera.FIELD_OF_VIEW)
    across = np.column_stack([away @ right, away @ np.cross(right, forward)])
    return focal * across / (away @ forward)[:, None]


def test_the_motion_sphere_is_larger_than_the_gizmo(scene: Scene) -> None:
    start = scene.T_base_start.translation
    up = np.array([0.0, 0.0, 1.0])
    p, q = pixels(scene, np.array([start, start + Options().radius * np.cross(up, [1, 0, 0])]))
    side = np.cross(camera.DIRECTION, up)
    q = pixels(scene, start[None] + Options().radius * side / np.linalg.norm(side))[0]
    assert np.linalg.norm(q - p) > GIZMO_SIZE


@pytest.mark.parametrize("name", list(presets.PRESETS))
def test_a_scenario_stays_in_the_picture_or_its_camera_follows(name: str) -> None:
    scenario = presets.find(name)
    if scenario.camera == "follow":
        return
    options = scenario.options
    if options.mesh == "skull-fine":
        options = replace(options, mesh="skull")  # the same shape, built sooner
    scene = scenes.build(options, 1)
    way = course(scenario, scene)
    assert way is not None
    view = None
    if isinstance(scenario.camera, str):
        view = camera.named_view(scenario.camera.capitalize(), scene, None)
    elif scenario.camera is not None:
        ends = [scenario.camera.eye, scenario.camera.look_at]
        view = camera.View(*meshes.transformed(scene.T_base_mesh, ends))
    seen = np.abs(pixels(scene, way.points, view))
    assert seen.max(axis=0) == pytest.approx([200, 225], abs=225)


def test_the_anatomy_is_translucent_while_it_hides_the_tip(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = 100.0
    monkeypatch.setattr(anatomy.time, "monotonic", lambda: clock)
    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    try:
        layer = anatomy.Anatomy(server.scene)
        layer.set_scene(scene)
        mesh: Any = layer._drawn[0].mesh
        assert mesh.opacity is None
        tip = scene.T_base_start.translation
        low = np.array([*tip[:2], scene.surface.vertices[:, 2].min()])
        above, below = (100.0 * (p + np.array([0.0, 0.0, h])) for p, h in ((tip, 0.1), (low, -0.1)))
        layer.keep_tip_visible([above], tip)
        assert mesh.opacity is None
        layer.keep_tip_visible([above, below], tip)
        assert mesh.opacity == anatomy.TRANSLUCENT
        layer.keep_tip_visible([above], tip)
        assert mesh.opacity == anatomy.TRANSLUCENT, "no flicker"
        clock += 2.0 * anatomy.HOLD
        layer.keep_tip_visible([above], tip)
        assert mesh.opacity is None
        layer.keep_tip_visible([np.full(3, np.nan)], tip)
        assert mesh.opacity is None
        layer.set_translucent(True)
        layer.keep_tip_visible([above], tip)
        assert mesh.opacity == anatomy.TRANSLUCENT
    finally:
        server.stop()


def test_the_force_has_one_name_and_one_colour() -> None:
    options = Options(mesh="cube", robot="point")
    scene = scenes.build(options, 1)
    start = scene.T_base_start
    from app.control.messages import Command

    goal = start.copy()
    goal.translation = start.translation - np.array([0.0, 0.0, 0.02])
    last = run_headless(options, [Command(goal, 1)], 300)[-1]
    force = np.linalg.norm(last.step.force)
    assert force > 0.1
    extras = readouts.Extras(0, 0.0, tuple(scene.arm.joints))
    name, color = palette.FORCE_NAME, palette.css(palette.FORCE)
    table = readouts.readouts(last, options, extras)
    row = re.search(rf"<tr>(?:(?!</tr>).)*{name}.*?</tr>", table)
    assert row is not None
    assert color in row[0]
    assert f"{force:.2f}" in row[0]
    assert f"{name} {force:.2f} N" in readouts.banner(last, options, extras, clutched=False)
    plot = next(p for p in signals.PLOTS if "force" in p.title.lower())
    assert plot.title.lower().startswith(name)
    assert plot.curves[0].color == palette.FORCE
    assert name in legend.legend()
    others = [look.color for look in palette.LOOKS.values()]
    others += [palette.BLOCKING, palette.PROXY, palette.ALARM, palette.CORRIDOR]
    assert palette.FORCE not in others


def test_linear_colours_are_displayed_as_those_of_the_legend() -> None:
    """A display applies the inverse of the gamma."""
    legend = np.array([look.color for look in palette.LOOKS.values()], dtype=np.uint8)
    shown = 255.0 * (palette.linear(legend) / 255.0) ** (1.0 / 2.2)
    assert np.abs(shown - legend).max() < 8.0


def test_every_triangle_has_edges_in_its_rules_colour(scene: Scene) -> None:
    from app.view.drawing.fixture import MAX_PLANES, FixtureDrawing
    from app.view.drawing.labels import Labels

    p_tip = np.array(scene.T_base_start.translation) - np.array([0.0, 0.0, 0.014])
    planes = vf.certified_planes(scene.surface, p_tip, radius=5e-3)
    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    try:
        drawing = FixtureDrawing(server.scene, Labels(server))
        drawing.draw(p_tip, 5e-3, planes, np.zeros(len(planes)), [scene.surface])
        edges: Any = drawing._edges
        assert edges.visible
        count = 3 * len(planes)
        looks = np.array([palette.LOOKS[vf.Rule(r)].color for r in planes.rules])
        expected = palette.linear(np.repeat(looks, 3, axis=0))
        np.testing.assert_array_equal(edges.colors[:count, 0], expected)
        np.testing.assert_array_equal(edges.colors[:count, 1], expected)
        assert len(edges.points) == 3 * MAX_PLANES
        lengths = np.linalg.norm(edges.points[:, 1] - edges.points[:, 0], axis=1)
        assert (lengths[:count] > 0).all()
        assert (lengths[count:] == 0).all()
    finally:
        server.stop()
