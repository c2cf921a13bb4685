"""What the page shows of a structure that changes its shape: the true one, and a ghost."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest

from app.motion.declared import Motion, Tracker
from app.scene.moment import Moment
from app.session import Session
from app.settings import Options
from app.view import Page
from app.view.drawing import anatomy
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
    middle = 0.5 * (believed.min(axis=0) + believed.max(axis=0))
    ghost = middle + anatomy.GHOST_SIZE * (believed - middle)
    assert np.asarray(drawn.ghost.vertices) / 100.0 == pytest.approx(ghost, abs=1e-6)


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
        page._frame()
        assert np.allclose(drawn.mesh.vertices, truth) == sends
        assert (drawn.follows.due > time.monotonic()) == (sends or due > 0.0)
    drawn.mesh.vertices = truth


def test_what_is_drawn_with_fewer_vertices_goes_with_the_nearest() -> None:
    rng = np.random.default_rng(0)
    vertices = rng.normal(size=(500, 3))
    shown = vertices[::9] + 1e-6
    follows = anatomy.Follows(vertices, shown)
    moved = vertices * [1.1, 0.9, 1.0] + [0.0, 0.1, 0.0]
    assert follows.shape(moved) == pytest.approx(moved[::9] + 1e-6, abs=1e-12)
