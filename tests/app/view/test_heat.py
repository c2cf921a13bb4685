"""The heat map of margins: bands, their colours, the layer, the legend and the list."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import viser

import meshes
from app.control.messages import LoopStats, Telemetry
from app.scene import scene as scenes
from app.scene.moment import Moment, Places
from app.scene.picking import margin_near
from app.structure import Registration
from app.view.controls.margins import MarginLegend
from app.view.drawing.anatomy import Anatomy
from app.view.drawing.heat.bands import MOST, bands, legend, ramp, scale
from app.view.tabs import structure_list
from app.view.units import VIEW_SCALE
from tests.support import structured

OWN = Registration(
    ((-0.02, -0.02, -0.02), (0.025, -0.01, -0.02), (0.0, 0.03, -0.015), (0.0, 0.0, -0.05)), 0.4e-3
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return structured.balls(tmp_path_factory.mktemp("balls"))


@pytest.fixture(scope="module")
def scene(folder: Path) -> scenes.Scene:
    return scenes.build(structured.options(folder, registration=OWN), 1, warm=False)


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    running = viser.ViserServer("127.0.0.1", 0, verbose=False)
    yield running
    running.stop()


def moment(scene: scenes.Scene, **more: object) -> Moment:
    telemetry = Telemetry(
        0, 0.0, scene.start, None, None, LoopStats(), scene.version, 0, False, False, False
    )
    return Moment(**{"scene": scene, "options": scene.options, "telemetry": telemetry,
                     "clutched": False, **more})  # fmt: skip


def areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Vectors (m, 3) of twice the area, along the normals."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


# Bands


@pytest.mark.parametrize("name", ["sphere", "cube", "gear"])
def test_bands_are_the_surface_cut_at_the_levels(name: str) -> None:
    vertices, faces = meshes.arrays(name)
    slope = np.array([0.02, 0.5, 0.3])  # values are linear in space, so the cut is exact
    values = vertices @ slope
    among = scale(float(values.min()), float(values.max()))
    parts = bands(vertices, faces, values, among)
    assert len(parts) == among.bands == len(among.levels) - 1 == len(among.colors)
    assert sum(len(f) > 0 for _, f in parts) > 2
    total = 0.0
    for (v, f), low, high in zip(parts, among.levels[:-1], among.levels[1:], strict=True):
        if len(f) == 0:
            continue
        assert f.max() < len(v)
        found = v @ slope
        assert found[f].min() >= low - 1e-12
        assert found[f].max() <= high + 1e-12
        total += np.linalg.norm(areas(v, f), axis=1).sum()
    whole = np.linalg.norm(areas(vertices, faces), axis=1).sum()
    assert total == pytest.approx(whole, rel=1e-9)


def test_bands_keep_the_winding() -> None:
    """The volume below them, which is negative for what is turned over."""
    vertices, faces = meshes.arrays("sphere")
    values = vertices[:, 2]
    parts = bands(vertices, faces, values, scale(float(values.min()), float(values.max())))

    def volume(v: np.ndarray, f: np.ndarray) -> float:
        return float(np.einsum("ij,ij->", areas(v, f), v[f[:, 0]])) / 6.0

    assert sum(volume(v, f) for v, f in parts) == pytest.approx(volume(vertices, faces))
    assert all(volume(v, f) > 0.0 for v, f in parts if len(f))


def test_values_outside_the_scale_count_to_its_ends() -> None:
    vertices, faces = meshes.arrays("sphere")
    values = vertices[:, 2]
    inner = scale(-0.2 * float(np.ptp(values)), 0.2 * float(np.ptp(values)))
    parts = bands(vertices, faces, values, inner)
    area = sum(np.linalg.norm(areas(v, f), axis=1).sum() for v, f in parts)
    assert area == pytest.approx(np.linalg.norm(areas(vertices, faces), axis=1).sum())


@pytest.mark.parametrize(
    ("low", "high", "first", "last", "step"),
    [
        (0.49e-3, 0.78e-3, 0.45e-3, 0.8e-3, 0.05e-3),
        (1.02e-3, 3.99e-3, 1e-3, 4e-3, 0.5e-3),
        (0.0, 10e-3, 0.0, 10e-3, 1e-3),
        (2e-3, 2e-3, 2e-3, 2e-3 + 1e-7, 1e-7),
    ],
)
def test_a_scale_has_round_levels_around_the_range(
    low: float, high: float, first: float, last: float, step: float
) -> None:
    found = scale(low, high)
    assert found.levels[0] == pytest.approx(first, abs=1e-12)
    assert found.levels[-1] == pytest.approx(last, abs=1e-12)
    assert found.step == pytest.approx(step)


def test_any_range_has_a_scale_that_holds_it() -> None:
    rng = np.random.default_rng(3)
    for _ in range(500):
        low, high = np.sort(10.0 ** rng.uniform(-7.0, -1.3, size=2))
        found = scale(low, high)
        assert 1 <= found.bands <= MOST
        assert found.levels[0] <= low + 1e-12
        assert found.levels[-1] >= high - 1e-12
        assert found.levels[1] > low - 1e-12
        assert found.bands == 1 or found.levels[-2] < high + 1e-12


def test_equal_steps_of_the_colours_are_equal_steps_of_lightness() -> None:
    """CIE lightness, from sRGB by its definition."""
    rgb = np.array([ramp(share) for share in np.linspace(0.0, 1.0, MOST)]) / 255.0
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    luminance = linear @ [0.2126, 0.7152, 0.0722]
    lightness = 116.0 * np.cbrt(luminance) - 16.0
    steps = np.diff(lightness)
    assert steps.min() > 0.6 * steps.mean()
    assert steps.max() < 1.4 * steps.mean()
    assert lightness[0] < 20.0
    assert lightness[-1] > 85.0


# The layer


def test_guarded_structures_are_drawn_in_bands_of_their_margins(
    scene: scenes.Scene, server: viser.ViserServer
) -> None:
    layer = Anatomy(server.scene)
    layer.set_scene(scene)
    shown = moment(scene)
    layer.frame(shown, {})
    found = layer.margins
    assert found is not None
    own = [0.0, *structured.MARGINS.values()]
    every = [
        (margin + least, margin + most)
        for margin, (least, most) in zip(own, scene.added_range, strict=True)
    ]
    assert (found.low, found.high) == (min(a for a, _ in every), max(b for _, b in every))
    for k, drawn in enumerate(layer._drawn):
        nodes = layer._heat._shapes[k].nodes
        assert nodes
        assert not drawn.mesh.visible
        assert all(node.visible for node in nodes)
        colors = [tuple(node.color) for node in nodes]
        low, high = every[k]
        wanted = [
            color
            for color, a, b in zip(found.colors, found.levels[:-1], found.levels[1:], strict=True)
            if b > low and a < high
        ]
        assert colors == wanted
    # One that is not guarded keeps its own colour; the others' scale is without it.
    off = replace(scene.options, guarded=False)
    layer.frame(replace(shown, options=off), {})
    assert layer._drawn[0].mesh.visible
    assert not layer._heat._shapes[0].nodes
    assert layer.margins.low == min(a for a, _ in every[1:])
    # The layer switch, that of the anatomy, and that of one structure.
    layer.show_margins(False)
    assert layer.margins is None
    assert all(drawn.mesh.visible for drawn in layer._drawn)
    assert not any(node.visible for shape in layer._heat._shapes for node in shape.nodes)
    layer.show_margins(True)
    layer.show_structure(2, False)
    assert not any(node.visible for node in layer._heat._shapes[2].nodes)
    assert not layer._drawn[2].mesh.visible
    layer.show(False)
    assert layer.margins is None
    assert not any(node.visible for shape in layer._heat._shapes for node in shape.nodes)


def test_bands_follow_a_margin_that_is_set_and_a_structure_that_moves(
    scene: scenes.Scene, server: viser.ViserServer
) -> None:
    layer = Anatomy(server.scene)
    layer.set_scene(scene)
    shown = moment(scene)
    layer.frame(shown, {})
    before = layer.margins
    structures = list(scene.options.structures)
    structures[1] = replace(structures[1], margin=7e-3)
    more = replace(scene.options, structures=tuple(structures))
    layer.frame(replace(shown, options=more), {})
    assert layer.margins.high == pytest.approx(7e-3 + scene.added_range[2][1])
    assert layer.margins != before
    pose = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.01]))
    layer.frame(replace(shown, options=more, places=Places((pose, None, pose, None))), {})
    for node in layer._heat._shapes[2].nodes:
        assert node.position[2] == pytest.approx(layer._drawn[2].mesh.position[2])
        assert node.position[2] > 0.0
    layer.set_translucent(True)
    assert {node.opacity for node in layer._heat._shapes[2].nodes} == {layer._drawn[2].mesh.opacity}
    # The section of the mesh is in bands, too, and where the mesh is.
    vertices, faces = scene.vertices_shown, scene.faces_shown
    layer.cut((vertices, faces[:4]))
    layer._draw()
    cut = layer._heat._shapes[0].nodes
    area = sum(np.linalg.norm(areas(n.vertices, n.faces), axis=1).sum() for n in cut)
    whole = np.linalg.norm(areas(vertices, faces[:4]), axis=1).sum()
    assert area == pytest.approx(whole * VIEW_SCALE**2, rel=1e-4)
    assert all(node.position[2] > 0.0 for node in cut)


def test_a_scene_without_a_registration_has_no_bands(
    folder: Path, server: viser.ViserServer
) -> None:
    plain = scenes.build(structured.options(folder), 2, warm=False)
    layer = Anatomy(server.scene)
    layer.set_scene(plain)
    layer.frame(moment(plain), {})
    assert layer.margins is None
    assert all(drawn.mesh.visible for drawn in layer._drawn)


def test_the_legend_and_the_list_say_the_range(
    scene: scenes.Scene, folder: Path, server: viser.ViserServer
) -> None:
    layer = Anatomy(server.scene)
    layer.set_scene(scene)
    shown = moment(scene)
    beside = MarginLegend(server, layer, 0.0)
    beside.read_out(shown)
    assert not beside._html.visible
    layer.frame(shown, {})
    beside.read_out(shown)
    assert beside._html.visible
    text = re.sub(r"<[^>]*>", " ", beside._html.content)
    low, high = layer.margins.low, layer.margins.high
    assert f"{1e3 * low:.2f} – {1e3 * high:.2f}" in text
    layer.show_margins(False)
    beside.read_out(shown)
    assert not beside._html.visible
    rows = structure_list._rows(scene.options.anatomy, [True] * 4, 0, scene.added_range)
    least, most = scene.added_range[2]
    assert f"{1e3 * (1e-3 + least):.2f}–{1e3 * (1e-3 + most):.2f}" in rows
    plain = structure_list._rows(scene.options.anatomy, [True] * 4, 0, ())
    assert "<td>1</td>" in plain
    assert "–<" not in plain


def test_every_level_stands_where_its_bands_meet() -> None:
    found = scale(1.02e-3, 3.99e-3)
    text = legend(found)
    marks = re.findall(r"left:([\d.]+)%[^>]*>([\d.]+)<", text)
    assert [float(mark) for _, mark in marks] == pytest.approx(1e3 * found.levels)
    assert [float(at) for at, _ in marks] == pytest.approx(100.0 * np.arange(7) / 6, abs=1e-3)


def test_the_inspector_takes_the_margin_of_the_nearest_triangle(scene: scenes.Scene) -> None:
    own, surface = scene.options.structures[0], scene.surfaces[1]
    for corner in (0, 100):
        face = surface.faces[corner]
        x = surface.vertices[face].mean(axis=0) + 1e-4 * surface.normals[corner]
        wanted = float(own.margin) + scene.added.at(surface.vertices[face]).max()
        assert margin_near(own, surface, x, scene.added) == pytest.approx(wanted)
        assert margin_near(own, surface, x, None) == own.margin
