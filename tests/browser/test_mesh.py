"""Bringing one's own mesh: what a user does on the page's tab about the mesh."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

import meshes
from app.session import Session
from app.settings import Options
from app.view import Page
from app.view.tabs import health
from tests.support.watching import Visitor, wait_until

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def session(chromium: str) -> Iterator[Session]:
    # One of its own: the limit on uploads is part of what is tested.
    options = Options(mesh="skull-coarse", robot="point", rate=500.0, upload_limit=1.0)
    with Session(options) as session:
        yield session


@pytest.fixture(scope="module")
def visitor(page: Page, open_tab: Callable[[Page], Visitor]) -> Visitor:
    visitor = open_tab(page)
    visitor.tab.get_by_role("tab", name="Mesh", exact=True).click()
    return visitor


@pytest.fixture(autouse=True)
def _nothing_under_way(visitor: Visitor) -> Iterator[None]:
    yield
    wait_until(lambda: says(visitor, "Examine").is_enabled(), "the page to be done")


def says(visitor: Visitor, button: str):  # a playwright Locator
    return visitor.tab.get_by_role("button", name=button, exact=True)


def in_millimetres(visitor: Visitor) -> None:
    """Answer the question for the unit; the size is beside it."""
    visitor.tab.get_by_role("button", name=re.compile("^mm: ")).click()


def send(visitor: Visitor, path: Path) -> None:
    """Choose a file in the dialog that the upload button opens."""
    with visitor.tab.expect_file_chooser() as chooser:
        visitor.press("Bring your own mesh")
    chooser.value.set_files(path)


def damaged_torus(path: Path) -> tuple[int, int]:
    """A torus in mm, some faces turned and some missing; how many of each."""
    vertices, faces = meshes.arrays("torus")
    faces = faces.copy()
    rng = np.random.default_rng(5)
    rows = rng.choice(len(faces), 60, replace=False)
    turned, missing = rows[:40], rows[40:]
    faces[turned] = faces[turned][:, ::-1]
    keep = np.setdiff1d(np.arange(len(faces)), missing)
    trimesh.Trimesh(vertices * 1e3, faces[keep], process=False).export(path)
    return len(turned), len(missing)


def share_of(picture: np.ndarray, rgb: tuple[int, int, int]) -> float:
    """Share of pixels (h, w, 3) of a hue, whatever the light does to its brightness."""
    # Below the place where notifications, which have coloured rims, come up.
    pixels = picture[170:].reshape(-1, 3).astype(float)
    own = np.array(rgb, dtype=float)
    bright = np.linalg.norm(pixels, axis=1)
    cosine = pixels @ own / np.maximum(bright * np.linalg.norm(own), 1.0)
    return float(((cosine > 0.98) & (bright > 60.0)).mean())


def test_a_scan_with_flipped_faces_and_holes_is_taken_examined_and_shown_where_it_is_bad(
    visitor: Visitor, session: Session, tmp_path: Path
) -> None:
    path = tmp_path / "my scan.ply"
    turned, _ = damaged_torus(path)
    send(visitor, path)
    # It asks for the unit, and shows the size in each that is possible: 91 m is not.
    visitor.tab.get_by_text("This PLY file does not say its unit").wait_for()
    visitor.picture("mesh-unit-asked")
    across = float(np.linalg.norm(np.ptp(trimesh.load(path, process=False).vertices, axis=0)))
    in_mm = f"mm: {across:.4g} mm from corner to corner"
    says(visitor, in_mm).wait_for()
    assert visitor.tab.get_by_role("button", name=re.compile("^m: ")).count() == 0
    visitor.press(in_mm)
    wait_until(lambda: session.scene.mesh_name == "my scan.ply", "the mesh to be taken")
    assert session.options.unit == "mm"
    np.testing.assert_allclose(np.ptp(session.scene.surface.vertices, axis=0)[0], 0.08, atol=1e-3)
    # It says what is wrong and what that means for which rule.
    visitor.tab.get_by_text(f"{turned} faces are wound against their surroundings").wait_for()
    visitor.tab.get_by_text("lets the tool through").wait_for()
    visitor.tab.get_by_text("boundary loops").first.wait_for()

    # It shows where, in colours of their own, and stops showing when told to.
    def marked(rgb: tuple[int, int, int]) -> float:
        return share_of(visitor.picture("mesh-problems"), rgb)

    wait_until(lambda: marked(health.DEFECT) > 1.5e-3, "flipped faces to be marked")
    assert marked(health.EDGES["boundary loops"]) > 2e-4
    visitor.tab.get_by_label("Show problems").click()
    wait_until(lambda: marked(health.DEFECT) < 5e-4, "the marks to go")
    visitor.tab.get_by_label("Show problems").click()


def test_repairing_turns_the_faces_back_and_says_what_is_left(
    visitor: Visitor, session: Session, tmp_path: Path
) -> None:
    turned = int((session.scene.surface.normals[:, 2] < 2.0).sum())
    assert turned == len(session.scene.surface.faces)
    assert meshes.health(session.scene.surface).count("flipped faces") == 40
    visitor.press("Repair")
    wait_until(lambda: session.options.repair, "the repair")
    assert meshes.health(session.scene.surface).count("flipped faces") == 0
    wait_until(
        lambda: visitor.tab.get_by_text("faces are wound against").count() == 0,
        "the report to be another",
    )
    visitor.tab.get_by_text("boundary loops").first.wait_for()
    wait_until(says(visitor, "Repaired").is_disabled, "nothing to be left to repair")
    before = session.scene.surface.normals.copy()
    visitor.press("Flip")
    wait_until(lambda: session.options.flip, "the flip")
    np.testing.assert_allclose(session.scene.surface.normals, -before, atol=1e-12)
    wait_until(lambda: says(visitor, "Flip back").is_enabled(), "the page to offer the way back")
    visitor.picture("mesh-repaired")


def test_a_file_that_is_no_mesh_leaves_the_old_one_in_place(
    visitor: Visitor, session: Session, tmp_path: Path
) -> None:
    scene = session.scene
    path = tmp_path / "holiday.stl"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(300))
    send(visitor, path)
    visitor.tab.get_by_text("holiday.stl: not taken").first.wait_for()
    visitor.picture("mesh-refused")
    assert session.scene is scene
    visitor.tab.get_by_text("Nothing is changed").first.wait_for()
    # The loop goes on as if nothing had been.
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 50, "the loop to tick")


def test_a_file_beyond_the_limit_is_refused_before_it_is_kept(
    visitor: Visitor, session: Session, tmp_path: Path
) -> None:
    scene = session.scene
    path = tmp_path / "huge.stl"
    path.write_bytes(bytes(1_300_000))
    send(visitor, path)
    visitor.tab.get_by_text("1.3 MB are more than the 1 MB allowed").first.wait_for()
    assert visitor.tab.get_by_text("In which unit").count() == 0
    assert session.scene is scene
    # The button serves again.
    small = tmp_path / "small.obj"
    trimesh.creation.box((2.0, 2.0, 1.0)).export(small)
    send(visitor, small)
    visitor.tab.get_by_text("This OBJ file does not say its unit").wait_for()
    says(visitor, "mm: 3 mm from corner to corner").wait_for()
    says(visitor, "m: 3 m from corner to corner").wait_for()
    visitor.press("cm: 30 mm from corner to corner")
    wait_until(lambda: session.scene.mesh_name == "small.obj", "the box to be taken")
    visitor.tab.get_by_text("Sound: no defects.").wait_for()
    assert visitor.complaints == []


def test_a_file_becomes_a_further_structure_and_is_removed_again(
    visitor: Visitor, session: Session, tmp_path: Path
) -> None:
    before = session.options
    path = tmp_path / "nerve.off"
    ball = trimesh.creation.icosphere(subdivisions=2, radius=3.0)
    ball.apply_translation((0.0, 12.0, 40.0))
    ball.export(path)
    send(visitor, path)
    visitor.choose("Use it as", "a further structure")
    in_millimetres(visitor)
    wait_until(lambda: len(session.options.structures) == 1, "the structure to be taken")
    (own,) = session.options.structures
    assert (own.name, own.unit, Path(own.file).name) == ("nerve", "mm", "nerve.off")
    assert (session.options.mesh, session.options.unit) == (before.mesh, before.unit)
    T = session.scene.T_base_mesh
    middle = session.scene.surfaces[1].vertices.mean(axis=0)
    np.testing.assert_allclose((middle - T[:3, 3]) @ T[:3, :3], [0.0, 0.012, 0.04], atol=1e-6)
    row = visitor.tab.locator("[data-vf-order='choose 1']")
    row.wait_for()
    assert row.inner_text().strip() == "nerve"
    assert says(visitor, "Remove structure").count() == 0  # the mesh is the chosen one, and stays
    row.click()
    visitor.reads("Chosen", "1: nerve")
    visitor.press("Remove structure")
    wait_until(lambda: session.options.structures == (), "the structure to be gone")
    wait_until(lambda: row.count() == 0, "its row to be gone")
    assert session.options.mesh == before.mesh


def test_what_was_brought_keeps_its_name_outlives_the_page_and_is_deleted_when_confirmed(
    visitor: Visitor, session: Session, page: Page, tmp_path: Path
) -> None:
    name = "Schädel (links) 頭.stl"
    trimesh.creation.icosphere(subdivisions=2, radius=20.0).export(tmp_path / name)
    send(visitor, tmp_path / name)
    in_millimetres(visitor)
    wait_until(lambda: session.scene.mesh_name == name, "the ball to be taken")
    visitor.tab.get_by_text("Sound: no defects.").wait_for()
    kept = Path(session.options.mesh)
    for k in range(4):  # others come and go
        path = tmp_path / f"other {k}.off"
        trimesh.creation.box((20.0 + k, 20.0, 10.0)).export(path)
        send(visitor, path)
        in_millimetres(visitor)
        wait_until(lambda path=path: session.scene.mesh_name == path.name, "the other")
        wait_until(lambda: says(visitor, "Examine").is_enabled(), "the page to be done")
    visitor.choose("Mesh", name)
    wait_until(lambda: session.scene.mesh_name == name, "the ball again")
    assert (session.options.mesh, session.options.unit) == (str(kept), "mm")
    # Another page, as after a restart, has them all.
    other = Page(session, "127.0.0.1", 0)
    try:
        there = next(
            handle
            for handle in other.server.gui._gui_input_handle_from_uuid.values()
            if getattr(handle, "label", "") == "Mesh"
        )
        assert {name, *(f"other {k}.off" for k in range(4))} <= set(there.options)
    finally:
        other.close()
    size = f"{kept.stat().st_size / 1e3:.3g} kB"
    visitor.choose("Kept files", f"{name} ({size})")
    visitor.press("Delete mesh file")
    dialog = visitor.tab.get_by_role("dialog")
    dialog.get_by_role("button", name="Delete", exact=True).click()
    visitor.tab.get_by_text("is on the page: choose another mesh first").first.wait_for()
    visitor.choose("Mesh", "cube")
    wait_until(lambda: session.scene.mesh_name == "cube", "the cube")
    visitor.press("Delete mesh file")
    dialog.get_by_role("button", name="Cancel", exact=True).click()
    assert kept.exists()
    visitor.press("Delete mesh file")
    visitor.picture("mesh-delete")
    dialog.get_by_role("button", name="Delete", exact=True).click()
    wait_until(lambda: not kept.exists(), "the file to be gone")
    visitor.tab.get_by_role("combobox", name="Mesh", exact=True).click()
    wait_until(lambda: visitor.tab.get_by_role("option", name=name).count() == 0, "the list")
    visitor.tab.keyboard.press("Escape")
    assert visitor.complaints == []
