"""What the page shows of a structure that changes its shape: the true one, and a ghost."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

import meshes
from app.motion.declared import Motion, Tracker
from app.motion.movement import streamed
from app.scene.moment import Moment
from app.session import Session
from app.settings import Options
from app.structure import Registration
from app.view import Page
from app.view.drawing import anatomy, section
from app.view.drawing.heat.bands import pieces, scale
from app.view.inspector.subject import at_tool
from app.view.tabs.depth import nearest_of
from tests.support import naive
from tests.support.headless import wait_until

BEAT = Motion("deforming", period=0.5, amplitude=3.0)
LATE = Tracker(rate=10.0, latency=0.05, bound=0.2)
OPTIONS = Options(mesh="vessel", robot="point", motions=(BEAT,), tracker=LATE)


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with Session(OPTIONS) as running:
        wait_until(lambda: 0.27 < running.latest().phase % 0.5 < 0.3)
        running.pause()
        wait_until(lambda: running.latest().paused)
        yield running


@pytest.fixture(scope="module")
def page(session: Session) -> Iterator[Page]:
    page = Page(session, "127.0.0.1", 0)
    time.sleep(2.0 * anatomy.RESHAPED)
    page._frame()
    page._read_out()
    yield page
    page.close()


@pytest.fixture
def shown(page: Page) -> Moment:
    return page._source.now()


def test_it_is_drawn_in_its_true_shape_and_the_ghost_in_the_one_believed(
    page: Page, shown: Moment
) -> None:
    drawn = page._anatomy._drawn[0]
    truth, believed = shown.shape(0), shown.shape(0, believed=True)
    assert truth is not None
    assert believed is not None
    rest = shown.scene.surface.vertices
    assert np.abs(truth - rest).max() > 5e-4
    assert np.abs(truth - believed).max() > 1e-4
    assert drawn.mesh is not None
    assert drawn.ghost is not None
    assert np.asarray(drawn.mesh.vertices) / 100.0 == pytest.approx(truth, abs=1e-6)
    shell = np.asarray(drawn.ghost.vertices) / 100.0
    apart = np.linalg.norm(shell - believed, axis=1)
    assert apart == pytest.approx(shown.places.margin, abs=2e-4)
    outside = trimesh.Trimesh(believed, shown.scene.surface.faces, process=False)
    normals = outside.vertex_normals
    assert (np.einsum("ij,ij->i", shell - believed, normals) > 0.0).mean() > 0.99


def test_distances_are_those_of_the_true_shape(shown: Moment) -> None:
    tip = np.array(shown.tip.translation)
    one = nearest_of(shown.structures, tip)
    truth = shown.shape(0)
    assert truth is not None
    wanted = float(naive.closest(truth[shown.scene.surface.faces], tip)[1].min())
    assert one.surface.nearest(one.seen(tip))[0] == pytest.approx(wanted, abs=1e-9)
    believed = shown.shape(0, believed=True)
    assert one.guards.vertices == pytest.approx(believed, abs=1e-12)


def test_a_shape_is_sent_now_and_then_and_not_every_frame(page: Page) -> None:
    drawn = page._anatomy._drawn[0]
    assert drawn.follows is not None
    assert drawn.mesh is not None
    truth = np.array(drawn.mesh.vertices)
    for due, phase, sends in ((np.inf, -1.0, False), (-np.inf, -1.0, True), (-np.inf, None, False)):
        drawn.mesh.vertices = 0.5 * truth
        drawn.follows.due = due
        if phase is not None:
            drawn.follows.phase = phase
        before = time.monotonic()
        page._frame()
        assert np.allclose(drawn.mesh.vertices, truth) == sends
        assert (drawn.follows.due >= before + anatomy.RESHAPED) == (sends or due > 0.0)
    drawn.mesh.vertices = truth


def test_what_is_drawn_with_fewer_vertices_goes_with_the_nearest() -> None:
    rng = np.random.default_rng(0)
    vertices = rng.normal(size=(500, 3))
    shown = vertices[::9] + 1e-6
    follows = anatomy.Follows(vertices, shown)
    moved = vertices * [1.1, 0.9, 1.0] + [0.0, 0.1, 0.0]
    assert follows.shape(moved) == pytest.approx(moved[::9] + 1e-6, abs=1e-12)


def test_the_section_is_of_the_shape_that_it_has(page: Page, shown: Moment) -> None:
    looks = page._anatomy.looks(shown, 0)
    truth = shown.shape(0)
    assert truth is not None
    assert np.abs(looks - truth).max() < 1e-9  # it is drawn with all its vertices
    middle, normal = looks.mean(axis=0), np.array([1.0, 0.0, 0.0])
    cut = section.Cut(shown.scene, middle, normal, vertices=looks)
    left = section.make(cut).vertices
    assert (left @ normal).max() == pytest.approx(middle @ normal, abs=1e-9)
    assert (left @ normal).min() == pytest.approx((truth @ normal).min(), abs=1e-9)
    later = section.Cut(shown.scene, middle, normal, vertices=looks, phase=0.1)
    assert not later.near(cut)


def test_the_inspector_looks_at_the_shape_that_the_guard_believed(shown: Moment) -> None:
    subject = at_tool(shown, None)
    assert subject is not None
    assert subject.placed is not None
    believed = shown.shape(0, believed=True)
    np.testing.assert_allclose(subject.placed.frozen().vertices, believed, rtol=0, atol=1e-12)


def test_the_heat_map_of_margins_goes_with_the_shape() -> None:
    """Every band is cut in the triangles that it is cut in at rest."""
    vertices, faces = meshes.arrays("vessel")
    values = 1e-3 + 0.02 * np.linalg.norm(vertices - vertices[0], axis=1)
    among = scale(float(values.min()), float(values.max()))
    turned = 1.5 * vertices[:, [1, 2, 0]] + np.array([0.1, 0.0, -0.2])
    for piece in pieces(faces, values, among):
        rest, now = piece.vertices(vertices), piece.vertices(turned)
        np.testing.assert_allclose(
            now, 1.5 * rest[:, [1, 2, 0]] + np.array([0.1, 0.0, -0.2]), rtol=0, atol=1e-12
        )
    moved = meshes.deforming("vessel").shape(0.4)
    area = sum(
        trimesh.triangles.area(piece.vertices(moved)[piece.faces]).sum()
        for piece in pieces(faces, values, among)
    )
    assert area == pytest.approx(trimesh.triangles.area(moved[faces]).sum(), rel=1e-9)


def test_the_nodes_of_the_heat_map_are_sent_its_shape() -> None:
    options = Options(
        mesh="vessel", robot="point", motions=(BEAT,),
        registration=Registration(((0.0, 0.0, 0.0), (0.02, 0.0, 0.0), (0.0, 0.02, 0.0))),
    )  # fmt: skip
    with Session(options) as session:
        wait_until(lambda: session.latest().phase > 0.1)
        page = Page(session, "127.0.0.1", 0)
        try:
            page._frame()
            heat = page._anatomy._heat._shapes[0]
            assert len(heat.nodes) > 1
            before = [np.array(node.vertices) for node in heat.nodes]
            time.sleep(1.5 * anatomy.RESHAPED)
            page._frame()
            assert any(
                np.abs(np.asarray(node.vertices) - old).max() > 1e-3
                for node, old in zip(heat.nodes, before, strict=True)
            )
            mesh = page._anatomy._drawn[0].mesh
            assert mesh is not None
            drawn = np.concatenate([np.asarray(node.vertices) for node in heat.nodes])
            # Each vertex of the mesh is one of a band.
            assert cKDTree(drawn).query(np.asarray(mesh.vertices))[0].max() < 1e-4
        finally:
            page.close()


def test_a_shape_that_came_is_drawn_and_its_ghost_is_larger_by_the_margin() -> None:
    one = Motion("vertices", stream="socket://127.0.0.1:0")
    with Session(Options(mesh="vessel", robot="point", motions=(one,))) as session:
        form = streamed(session.scene.courses)
        assert form is not None
        page = Page(session, "127.0.0.1", 0)
        try:
            shape = meshes.deforming("vessel").shape(0.4)
            form.stream.hear(shape.astype(np.float32))
            came = session.latest().phase
            wait_until(lambda: session.latest().phase > came + 0.1)
            session.pause()
            wait_until(lambda: session.latest().paused)
            time.sleep(1.5 * anatomy.RESHAPED)
            page._frame()
            page._read_out()
            T, drawn = session.scene.T_base_mesh, page._anatomy._drawn[0]
            assert drawn.mesh is not None
            assert drawn.ghost is not None
            wanted = shape @ T[:3, :3].T + T[:3, 3]
            seen = np.asarray(drawn.mesh.vertices) / 100.0
            assert seen == pytest.approx(wanted, abs=1e-6)
            margin = page._source.now().places.margin
            assert margin > 5e-3
            apart = np.linalg.norm(np.asarray(drawn.ghost.vertices) / 100.0 - wanted, axis=1)
            assert apart == pytest.approx(margin, abs=2e-4)
        finally:
            page.close()
