"""What the page shows of structures that move: all of it where they truly are."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import vf
from app.devices.report import LinkReport
from app.motion.declared import Motion, Tracker
from app.scene.moment import Moment, Placed, places_at
from app.session import Session
from app.settings import Options
from app.view import Page
from app.view.drawing import fixture, section
from app.view.inspector.inspection import Inspector, Request
from app.view.inspector.subject import at_tool, hit
from app.view.tabs import readouts, signals
from app.view.tabs.depth import whereabouts
from app.view.tabs.measuring import Measuring
from tests.support.headless import wait_until
from tests.support.stand_ins import client

SWAY = Motion("breathing", move=(0.002, 0.0, 0.006), turn=(0.0, 0.0, 0.4), period=1.0)
LATE = Tracker(rate=20.0, latency=0.1, bound=0.1)
OPTIONS = Options(mesh="cube", robot="point", motions=(SWAY,), tracker=LATE)


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with Session(OPTIONS) as running:
        wait_until(lambda: running.latest().phase > 0.4)
        running.pause()
        wait_until(lambda: running.latest().paused)
        yield running


@pytest.fixture(scope="module")
def page(session: Session) -> Iterator[Page]:
    page = Page(session, "127.0.0.1", 0)
    page._frame()
    page._read_out()
    yield page
    page.close()


@pytest.fixture
def shown(page: Page) -> Moment:
    return page._source.now()


def moved(moment: Moment) -> trimesh.Trimesh:
    """The cube where it truly is, by the formula of a breath [m]."""
    surface = moment.scene.surface
    share = np.sin(np.pi * moment.telemetry.phase / 1.0) ** 6
    middle = 0.5 * (surface.vertices.min(axis=0) + surface.vertices.max(axis=0))
    c, s = np.cos(0.4 * share), np.sin(0.4 * share)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    vertices = (surface.vertices - middle) @ turn.T + middle + share * np.array(SWAY.move)
    return trimesh.Trimesh(vertices, surface.faces, process=False)


def placed_nodes(node: Any, surface: vf.Surface) -> np.ndarray:
    """Vertices of a surface as its node is placed [m]."""
    R = pin.Quaternion(*np.asarray(node.wxyz, dtype=float)).matrix()
    return surface.vertices @ R.T + np.asarray(node.position) / 100.0


def test_it_is_drawn_where_it_truly_is_and_the_ghost_where_it_is_believed(
    page: Page, shown: Moment
) -> None:
    drawn = page._anatomy._drawn[0]
    surface, truth = shown.scene.surface, moved(shown)
    assert placed_nodes(drawn.mesh, surface) == pytest.approx(truth.vertices, abs=1e-6)
    # The guard's belief is from 0.1 to 0.15 s ago, at a number of the tracker.
    phase = shown.telemetry.phase
    seen = np.floor((phase - 0.1) * 20.0 + 1e-9) / 20.0
    before = replace(shown, telemetry=replace(shown.telemetry, phase=seen))
    ghost = placed_nodes(drawn.ghost, surface)
    assert ghost == pytest.approx(moved(before).vertices, abs=1e-6)
    assert np.abs(ghost - truth.vertices).max() > 1e-4


def test_the_ghost_is_larger_by_the_margin_for_what_is_not_known(shown: Moment, page: Page) -> None:
    drawn, surface = page._anatomy._drawn[0], shown.scene.surface
    margin = shown.places.margin
    assert margin > 5e-3
    assert drawn.ghost is not None
    page._anatomy._drawn[0].grown_at = -np.inf
    page._frame()
    shell = np.asarray(drawn.ghost.vertices) / 100.0
    outwards = shell - surface.vertices
    assert np.linalg.norm(outwards, axis=1) == pytest.approx(margin, abs=2e-4)
    middle = surface.vertices.mean(axis=0)
    assert (np.einsum("ij,ij->i", outwards, surface.vertices - middle) > 0.0).all()
    # Of a face of the cube the middle is as far away as a corner's normal says.
    assert np.ptp(shell, axis=0).max() > np.ptp(surface.vertices, axis=0).max() + margin


def test_the_layer_switch_hides_the_ghost_alone(page: Page) -> None:
    drawn: Any = page._anatomy._drawn[0]
    page._anatomy.show_ghosts(False)
    assert drawn.mesh.visible
    assert not drawn.ghost.visible
    page._anatomy.show_ghosts(True)
    assert drawn.ghost.visible


def test_distances_and_depth_are_of_the_true_anatomy(shown: Moment) -> None:
    truth = moved(shown)
    for height in (5e-3, -5e-3):
        top = truth.vertices[:, 2].max()
        p = np.array([*truth.vertices.mean(axis=0)[:2] + 2e-3, top + height])
        where = whereabouts(
            shown.scene, shown.telemetry.q, p, 0.0, None, around=[("cube", shown.scene.surface)],
            poses=[shown.pose(0)],
        )  # fmt: skip
        signed = -float(trimesh.proximity.signed_distance(truth, [p])[0])
        assert where.distance == pytest.approx(abs(signed), abs=1e-9)
        assert where.inside == (height < 0.0)


def test_what_is_measured_and_plotted_is_of_the_true_anatomy(shown: Moment) -> None:
    truth, step = moved(shown), shown.telemetry.step
    assert step is not None
    p = np.array(step.tip.translation)
    distance = abs(float(trimesh.proximity.signed_distance(truth, [p])[0]))
    extras = Measuring().measure(shown, 0, "")
    assert extras.where is not None
    assert extras.where.distance == pytest.approx(distance, abs=1e-9)
    assert extras.where.part_gap == pytest.approx(distance, abs=1e-9)
    values = signals.sample(shown.telemetry, shown.guarded)
    assert values is not None
    assert values[0] == pytest.approx(1e3 * distance, abs=1e-6)
    at = [curve.name for plot in signals.PLOTS for curve in plot.curves].index("true")
    resting = shown.pose(0).actInv(p)  # type: ignore[union-attr]
    assert values[at] == pytest.approx(1e3 * np.linalg.norm(p - resting))
    assert values[at] > 1.0
    assert values[at + 1] != pytest.approx(values[at], abs=0.1)


def text(html: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<style>.*?</style>|<[^>]*>", " ", html))


def test_the_read_outs_have_contacts_margin_and_age(shown: Moment) -> None:
    extras = Measuring().measure(shown, 0, "")
    said = text(readouts.readouts(shown.telemetry, shown.options, extras))
    assert "tip met the true anatomy 0" in said
    age = shown.places.beliefs[0].age  # type: ignore[union-attr]
    assert 0.1 - 1e-9 <= age <= 0.15
    assert f"margin for what is not known {1e3 * 0.1 * age:.2f} mm" in said
    assert f"age of the last sighting {age:.2f} s" in said
    still = Measuring().measure(replace(shown, scene=replace(shown.scene, courses=())), 0, "")
    assert "sighting" not in text(readouts.readouts(shown.telemetry, shown.options, still))


def test_the_banner_says_overtaken_with_its_depth_and_a_stale_tracker(shown: Moment) -> None:
    extras = Measuring().measure(shown, 0, "")
    step = shown.telemetry.step
    assert step is not None
    overtaken = replace(step, status=vf.Status.OVERTAKEN, violation=1.25e-4)
    telemetry = replace(shown.telemetry, paused=False, step=overtaken)
    assert "Overtaken" in (said := text(readouts.banner(telemetry, shown.options, extras, False)))
    assert "seen late" in said
    assert "0.125 mm" in said
    known = replace(shown.options, tracker=None)
    said = text(readouts.banner(telemetry, known, extras, False))
    assert "came faster than the arm yields, by up to 0.125 mm" in said
    assert "0.125 mm" in text(readouts.readouts(telemetry, shown.options, extras))
    lost = replace(telemetry, lost=True)
    assert "Stale tracker" in text(readouts.banner(lost, shown.options, extras, False))


def test_triangles_of_planes_are_drawn_where_the_guard_believes_them(shown: Moment) -> None:
    surface = shown.scene.surface
    rows = np.array([3, 7])
    planes = replace(
        vf.Planes.none(1e-3),
        normals=np.zeros((8, 3)), offsets=np.zeros(8), points=np.zeros((8, 3)),
        triangles=np.arange(8), rules=np.zeros(8, dtype=np.int64),
    )  # fmt: skip
    believed = shown.believed(0)
    assert believed is not None
    _, corners = fixture._triangles(planes, [surface], rows, [believed])
    for k, row in enumerate(rows):
        for corner, v in zip(corners[k], surface.faces[row], strict=True):
            assert corner == pytest.approx(believed.act(surface.vertices[v]))


def test_the_section_cuts_the_anatomy_where_it_is(shown: Moment) -> None:
    pose = shown.pose(0)
    assert pose is not None
    truth = moved(shown)
    middle, normal = truth.vertices.mean(axis=0), np.array([0.0, 1.0, 0.0])
    cut = section.Cut(shown.scene, pose.actInv(middle), normal @ pose.rotation)
    left = section.make(cut)
    there = left.vertices @ pose.rotation.T + pose.translation
    assert (there @ normal).max() == pytest.approx(middle @ normal, abs=1e-9)
    assert (there @ normal).min() == pytest.approx((truth.vertices @ normal).min(), abs=1e-6)


def test_the_inspector_looks_at_the_anatomy_where_the_guard_believed_it(shown: Moment) -> None:
    believed, rest = shown.believed(0), shown.scene.surface
    assert believed is not None
    vertices = rest.vertices @ believed.rotation.T + believed.translation
    assert np.abs(vertices - moved(shown).vertices).max() > 1e-3  # and not where it truly is
    subject = at_tool(shown, None)
    assert subject is not None
    assert subject.margin == pytest.approx(shown.places.margin)
    assert subject.margin > 1e-3
    near = vertices[rest.faces[11]].mean(axis=0)
    found = Inspector().inspect(Request(replace(subject, x=near, radius=2e-3), True, True))
    there = found.explanation
    exact = trimesh.Trimesh(vertices, rest.faces, process=False)
    _, distance, _ = exact.nearest.on_surface([near])
    assert distance[0] < 1e-9
    assert 11 in there.triangles
    for k, triangle in enumerate(there.triangles):
        corners = vertices[rest.faces[triangle]][None]
        point = trimesh.triangles.closest_point(corners, near[None])[0]
        np.testing.assert_allclose(there.points[k], point, rtol=0, atol=1e-9)
    assert found.forecasts is not None
    assert all(np.isnan(one.step) for one in found.forecasts.of)
    # Of the next tick it is another surface, of the same one the same.
    again = Inspector()
    first = again.inspect(Request(subject, False, False)).subject.surface
    assert again.inspect(Request(subject, True, False)).subject.surface is first
    assert first is not rest


def test_a_click_picks_the_triangle_where_the_guard_believes_it(shown: Moment) -> None:
    believed, rest = shown.believed(0), shown.scene.surface
    assert believed is not None
    for triangle in (0, 5, 11):
        corners = rest.vertices[rest.faces[triangle]]
        middle = believed.act(corners.mean(axis=0))
        normal = believed.rotation @ rest.normals[triangle]
        assert hit(shown, middle + 0.2 * normal, -normal) == (0, triangle)
    assert hit(shown, middle + 0.2 * normal, normal) is None


def test_in_a_scene_that_moves_it_can_be_inspected_and_explored(page: Page) -> None:
    tab: Any = next(part for part in page._parts if type(part).__name__ == "InspectorTab")
    page._read_out()
    assert not tab._inspect.disabled
    assert not tab._freeze.disabled
    assert "the guard believed it" in tab._intro.content
    me = client()
    tab._explore(me, True)
    try:
        assert tab._exploring
        believed = page._source.now().believed(0)
        rest = tab._scene.surface.vertices
        wanted = rest @ believed.rotation.T + believed.translation
        np.testing.assert_allclose(tab._surface.vertices, wanted, rtol=0, atol=1e-12)
    finally:
        tab._stop_exploring()
        tab._switch(me, False)
        page._input.moved.clear()


def test_the_controls_of_motion_are_there_where_something_moves(
    page: Page, session: Session
) -> None:
    control: Any = next(part for part in page._parts if type(part).__name__ == "MotionControl")
    plots: Any = next(part for part in page._parts if isinstance(part, signals.Signals))
    assert control._folder.visible
    assert plots._plots[signals.MOTION].visible
    session.move_structures(on=False, pace=0.5)
    page._read_out()
    assert not control._on.value
    assert control._pace.value == 0.5
    still = replace(session.scene, courses=(None,))
    control.set_scene(still)
    assert not control._folder.visible
    control.set_scene(session.scene)


def test_a_structure_at_rest_stays_where_it_is() -> None:
    scene_options = Options(mesh="cube", robot="point")
    from app.scene import scene as scenes

    still = scenes.build(scene_options, 1, warm=False)
    moment_places = places_at(scenes.plant(still, scene_options).movement(), 0.3)
    assert moment_places.poses == ()
    own = Placed(scene_options.anatomy[0], still.surface)
    assert own.seen([0.1, 0.2, 0.3]) == pytest.approx([0.1, 0.2, 0.3])


def test_vertices_that_come_are_told_by_name(page: Page, session: Session, shown: Moment) -> None:
    """Where from, how often, and what is wrong: in the folder, and in the banner of a hold."""
    control: Any = next(part for part in page._parts if type(part).__name__ == "MotionControl")
    good = LinkReport("socket://127.0.0.1:48060", "127.0.0.1:5", 29.7, 0.02)
    bad = replace(good, peer="", trouble="no sender, not finite", refused={"not finite": 3})
    for link, words in ((good, ("30 Hz", "20 ms old")), (bad, ("no sender, not finite",))):
        control.read_out(replace(shown, stream=link))
        assert control._link.visible
        assert control._on.disabled
        assert control._pace.disabled
        assert all(word in text(control._link.content) for word in (link.url, *words))
        lost = replace(shown.telemetry, lost=True, paused=False)
        extras = Measuring().measure(replace(shown, stream=link, telemetry=lost), 0, "")
        told = text(readouts.banner(lost, shown.options, extras, False))
        assert f"no new vertices from {link.url}" in told
        assert link.trouble in told
    control.read_out(shown)
    assert not control._link.visible
    assert not control._on.disabled
