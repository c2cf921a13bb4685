"""Section and Examine of the structure that is chosen on the page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from app.control.autopilot import Course
from app.session import Session
from app.view import Page
from app.view.drawing import section
from app.view.units import VIEW_SCALE
from tests.support import structured
from tests.support.headless import wait_until
from tests.support.stand_ins import client


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    options = structured.options(structured.balls(tmp_path_factory.mktemp("balls")))
    with Session(options) as session:
        wait_until(lambda: session.latest().step is not None)
        page = Page(session, "127.0.0.1", 0)
        page._frame()
        yield page
        page.close()


def test_the_chosen_structure_is_cut_and_the_one_before_is_whole_again(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(section, "PERIOD", 0.0)
    anatomy, cutting, me = page._anatomy, page._section, client()
    cutting.toggle(me)

    def cut(number: int) -> bool:
        with page.server.atomic():
            cutting.frame(page._source.now(), {me.client_id: me})
        return [k for k, drawn in enumerate(anatomy._drawn) if not drawn.whole] == [number]

    for number in (2, 0, 1):
        anatomy.chosen = number
        wait_until(lambda number=number: cut(number))  # type: ignore[misc]
        mesh = anatomy._drawn[number].mesh
        assert mesh is not None
        tip = np.array(page._source.now().tip.translation)
        away = me.camera.position - tip * VIEW_SCALE
        assert ((np.asarray(mesh.vertices) - tip * VIEW_SCALE) @ away).max() < 1e-3 * away @ away
    cutting.toggle(me)
    with page.server.atomic():
        cutting.frame(page._source.now(), {})
    assert all(drawn.whole for drawn in anatomy._drawn)


def test_the_chosen_structure_is_examined_and_the_report_names_it(page: Page) -> None:
    tab: Any = next(part for part in page._parts if type(part).__name__ == "MeshTab")
    scene = page._source.now().scene
    tab._run_examination(scene, 2)
    assert structured.NAMES[1] in tab._report.content
    assert f"{len(scene.surfaces[2].faces):,}" in tab._report.content
    tab._run_examination(scene)
    assert structured.NAMES[1] not in tab._report.content
    tab._run_examination(scene, 99)  # gone meanwhile: nothing happens


def test_a_script_that_begins_after_the_scene_was_drawn_does_not_silence_the_tabs(
    page: Page,
) -> None:
    """The session's scene is another object then, of the same version."""
    session = page._source._session
    before = page._source.now().scene
    here = before.T_base_start
    session.perform(
        Course(np.array(here.rotation), np.array([0.0, 9.0]), np.array(2 * [here.translation]))
    )
    wait_until(lambda: session.latest().tick > 2)
    page._frame()
    assert session.scene is not before
    parts: dict[str, Any] = {type(part).__name__: part for part in page._parts}
    inspector, mesh = parts["InspectorTab"], parts["MeshTab"]
    inspector._on = True

    def inspected() -> bool:
        with page.server.atomic():
            inspector.frame(page._source.now(), {})
        return inspector._newest() is not None

    wait_until(inspected)
    inspector._on = False
    mesh._report.content = ""
    mesh._run_examination(before)
    assert mesh._report.content
