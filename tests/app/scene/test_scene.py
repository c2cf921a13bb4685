"""Scenes: what stands where, and a free start for the tool whatever the mesh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import meshes
import robots
import vf
from app.control.engine import is_free
from app.scene import scene as scenes
from app.scene.scene import free_start
from app.settings import Options
from tests.support.brute import Oracle


def around_the_tip(arm: robots.Arm, solid: trimesh.Trimesh) -> vf.Surface:
    """The solid (trimesh, own frame [m]) with its origin at the arm's neutral tip."""
    tip = arm.tip(arm.neutral).translation
    return vf.Surface.from_arrays(solid.vertices + tip, solid.faces)


@pytest.mark.parametrize("robot", robots.names())
def test_the_neutral_pose_is_kept_where_it_is_free(robot: str) -> None:
    arm = robots.load(robot)
    box = trimesh.creation.box((0.02, 0.02, 0.02))
    box.apply_translation([0.0, 0.0, -0.03])
    np.testing.assert_array_equal(free_start(arm, around_the_tip(arm, box), 2e-5), arm.neutral)


@pytest.mark.parametrize("clearance", [2e-5, 3e-3])
@pytest.mark.parametrize("robot", robots.names())
def test_a_tool_inside_the_anatomy_is_given_a_spot_outside(robot: str, clearance: float) -> None:
    arm = robots.load(robot)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.02)
    surface = around_the_tip(arm, ball)
    q = free_start(arm, surface, clearance)
    tip = arm.tip(q).translation
    assert (q >= arm.lower).all()
    assert (q <= arm.upper).all()
    assert abs(Oracle(surface.vertices, surface.faces).winding(tip)) < 0.5
    away = np.linalg.norm(tip - arm.tip(arm.neutral).translation) - 0.02
    assert clearance < away + 1e-12
    assert away < 0.03  # no farther than it needs to be


def test_a_tool_at_an_open_sheet_is_moved_off_it() -> None:
    arm = robots.load("point")
    sheet = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    sheet.apply_scale(0.05)
    surface = around_the_tip(arm, sheet)
    tip = arm.tip(free_start(arm, surface, 1e-3)).translation
    assert abs(tip[2] - arm.tip(arm.neutral).translation[2]) > 1e-3


def test_a_guarded_tool_starts_with_all_of_it_clear() -> None:
    arm = robots.load("psm")
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.01)
    ball.apply_translation([0.0, 0.0, 0.06])
    surface = around_the_tip(arm, ball)  # in its shaft
    np.testing.assert_array_equal(free_start(arm, surface, 2e-5), arm.neutral)
    options = Options(standoff=1e-4)
    for alone in (Options(guard="tip"), Options(rule="paper")):
        np.testing.assert_array_equal(free_start(arm, surface, 2e-5, alone), arm.neutral)
    q = free_start(arm, surface, 2e-5, options)
    for capsule, (a, b) in zip(arm.capsules, arm.axes(q), strict=True):
        along = np.clip((surface.vertices - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        away = np.linalg.norm(surface.vertices - a - along[:, None] * (b - a), axis=1)
        assert away.min() - capsule.radius > 1e-4


def test_a_tool_that_no_start_makes_clear_starts_with_a_note_unless_it_has_a_port() -> None:
    across = Options(mesh="sphere", at=(0.0, 0.0, 0.0))  # around the remote centre
    for options, noted in ((across, True), (replace(across, trocar=0.05), False)):
        scene = scenes.build(options, 1)
        np.testing.assert_array_equal(scene.start, scene.arm.neutral)
        assert any("No start was found" in note for note in scene.notes) == noted
        q = scene.start
        step = scenes.plant(scene, options).controller.step(
            q, scene.arm.tip(q) * pin.SE3(np.eye(3), np.array([0.0, 0.0, 1e-4]))
        )
        assert (step.status is vf.Status.HELD) == noted


def test_a_mesh_that_fills_the_workspace_is_refused() -> None:
    arm = robots.load("point")  # reaches 0.3 m
    surface = around_the_tip(arm, trimesh.creation.box((2.0, 2.0, 2.0)))
    with pytest.raises(ValueError, match=r"no free spot for the tool of point.*unit"):
        free_start(arm, surface, 2e-5)


def test_free_means_outside_and_clear() -> None:
    box = trimesh.creation.box((0.02, 0.02, 0.02))
    surface = vf.Surface.from_arrays(box.vertices, box.faces)
    assert not is_free(surface, np.zeros(3), 1e-5)
    assert not is_free(surface, np.array([0.0, 0.0, 0.0105]), 1e-3)
    assert is_free(surface, np.array([0.0, 0.0, 0.0115]), 1e-3)


def test_the_mesh_stands_below_the_tool_and_is_shown_in_full() -> None:
    scene = scenes.build(Options(mesh="sphere", robot="ur5"), 7)
    assert (scene.version, scene.mesh_name, scene.robot) == (7, "sphere", "ur5")
    tip = scene.arm.tip(scene.arm.neutral).translation
    high = scene.surface.vertices.max(axis=0)
    assert high[2] == pytest.approx(tip[2] - 0.015)
    np.testing.assert_array_equal(scene.vertices_shown, scene.surface.vertices)
    np.testing.assert_array_equal(scene.faces_shown, scene.surface.faces)
    assert not scene.decimated
    assert scene.notes == ()
    assert scene.arm.tip(scene.start).isApprox(scene.T_base_start, 1e-12)
    for array in (scene.vertices_shown, scene.faces_shown, scene.start):
        assert not array.flags.writeable


def test_a_mesh_stands_where_it_is_put_and_its_path_with_it() -> None:
    options = Options(
        mesh="skull-coarse", robot="point", at=(0.01, -0.02, -0.1), rotate=(0.0, 0.0, np.pi / 2)
    )
    scene = scenes.build(options, 1)
    own, _ = meshes.arrays("skull-coarse")
    turned = np.column_stack([-own[:, 1], own[:, 0], own[:, 2]]) + options.at
    np.testing.assert_allclose(scene.surface.vertices, turned, atol=1e-15)
    assert scene.planned_path is not None
    heights = [scene.surface.nearest(p)[0] for p in scene.planned_path]
    assert max(heights) < 1e-3  # on the smooth surface, the coarse mesh's chords run below it
    assert scenes.build(Options(mesh="cube", robot="point"), 1).planned_path is None


def test_a_mesh_is_damaged_and_repaired_as_told() -> None:
    clean = scenes.build(Options(mesh="torus", robot="point"), 1)
    bad = scenes.build(Options(mesh="torus", robot="point", damage="flipped", seed=3), 1)
    assert clean.surface.closed
    assert not bad.surface.closed
    turned = np.einsum("ij,ij->i", clean.surface.normals, bad.surface.normals) < 0.0
    assert turned.sum() == round(0.05 * len(turned))
    assert any("flipped, seed 3" in note for note in bad.notes)
    options = Options(mesh="torus", robot="point", damage="flipped", seed=3, repair=True)
    mended = scenes.build(options, 1)
    np.testing.assert_allclose(mended.surface.normals, clean.surface.normals, atol=1e-9)
    assert any(f"turned {turned.sum()} faces" in note for note in mended.notes)
    sheet = Options(mesh="torus", robot="point", damage="sheet")
    flipped = scenes.build(replace(sheet, flip=True), 1).surface
    np.testing.assert_allclose(flipped.normals, -scenes.build(sheet, 1).surface.normals, atol=1e-9)


@pytest.mark.slow
def test_a_large_mesh_is_shown_lighter_and_controlled_in_full() -> None:
    count = len(meshes.arrays("skull-fine")[1])
    scene = scenes.build(Options(mesh="skull-fine"), 1)
    assert len(scene.surface.faces) == count
    assert scene.decimated
    assert len(scene.faces_shown) <= 60_000
    assert any(f"{count:,}" in note for note in scene.notes)


def test_every_step_of_building_is_announced() -> None:
    said: list[str] = []
    scenes.build(Options(mesh="cone", robot="point"), 1, said.append)
    for word in ("point", "cone", "kernels", "tree", "picture", "start"):
        assert any(word in text for text in said), word
