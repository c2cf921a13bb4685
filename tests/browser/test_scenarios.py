"""Scenarios on the page: what a user does to see one, and to keep what is set."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import meshes
from app.scenarios.file import read
from app.scenarios.presets import PRESETS
from app.scenarios.staging import begin
from app.session import Session
from app.settings import Options
from app.view import Page
from app.view.units import VIEW_SCALE
from tests.support.watching import Visitor, drawn_share, wait_until

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def session(chromium: str) -> Iterator[Session]:
    # As the command line does it.
    options = PRESETS["thin-plate-both-sides"].applied(Options(rate=500.0))
    with Session(options) as session:
        yield session


@pytest.fixture(scope="module")
def page(session: Session) -> Iterator[Page]:
    scenario = PRESETS["thin-plate-both-sides"]
    page = Page(session, "127.0.0.1", 0, scenario)
    begin(scenario, session)
    yield page
    page.close()


@pytest.fixture(scope="module")
def visitor(page: Page, open_tab: Callable[[Page], Visitor]) -> Visitor:
    return open_tab(page)


def reads(visitor: Visitor, name: str) -> None:
    visitor.tab.get_by_text(PRESETS[name].about, exact=True).wait_for(timeout=30_000)


def rests(session: Session) -> np.ndarray:
    """Where the tool is once nothing moves any more, arm base frame."""

    def still() -> bool:
        telemetry = session.latest()
        script = session.scene.autopilot
        end = script.pose(1e6).translation
        return telemetry.autopilot and np.array_equal(telemetry.target.translation, end)

    wait_until(still, "the script to end")
    visitor_ticks = session.latest().tick + 100
    wait_until(lambda: session.latest().tick > visitor_ticks, "the tool to rest")
    return np.array(session.latest().step.tip.translation)


def test_sees_the_scenario_the_page_was_started_with(visitor: Visitor, session: Session) -> None:
    reads(visitor, "thin-plate-both-sides")
    p_tip = rests(session)
    assert session.scene.surface.nearest(p_tip)[0] == pytest.approx(20e-6, abs=2e-6)
    assert drawn_share(visitor.picture("scenario-started")) > 0.03


def test_picks_a_scenario_reads_its_sentence_and_sees_it(
    visitor: Visitor, session: Session
) -> None:
    visitor.choose("Show", "valley-of-the-gear")
    offered = f"Load shows: {PRESETS['valley-of-the-gear'].about}"
    visitor.tab.get_by_text(offered, exact=True).wait_for(timeout=30_000)
    assert session.scene.mesh_name == "thin-plate"  # only looked at so far
    visitor.press("Load")
    wait_until(lambda: session.scene.mesh_name == "gear", "the gear")
    wait_until(lambda: session.latest().autopilot, "the hand")
    reads(visitor, "valley-of-the-gear")
    p_tip = rests(session)
    visitor.reads("Rule", "paper")
    visitor.reads("Mesh", "gear")

    # Its camera goes along with the tool.
    def followed() -> bool:
        return bool(np.abs(visitor.client.camera.look_at / VIEW_SCALE - p_tip).max() < 1e-3)

    wait_until(followed, "the camera to look at the tool")
    assert drawn_share(visitor.picture("scenario-gear")) > 0.2
    assert visitor.complaints == []


def test_saves_what_is_set_and_starts_with_it_again(
    visitor: Visitor, session: Session, tmp_path: Path
) -> None:
    session.set(radius=1.5e-3)
    session.set_autopilot(False)
    session.nudge([0.0, 0.0, 5e-3])
    wait_until(lambda: session.latest().target is not None, "the proxy")
    with visitor.tab.expect_download(timeout=60_000) as download:
        visitor.press("Save")
    assert download.value.suggested_filename == "scenario.json"
    download.value.save_as(tmp_path / "scenario.json")
    saved = read(tmp_path / "scenario.json")
    assert (saved.options.mesh, saved.options.rule) == ("gear", "paper")
    assert saved.options.radius == pytest.approx(1.5e-3)
    assert len(saved.proxy) == 1
    p = meshes.transformed(session.scene.T_base_mesh, [saved.proxy[0].at])[0]
    np.testing.assert_allclose(p, session.handle.translation, atol=1e-9)
    assert visitor.complaints == []


def test_opens_what_was_saved_and_looks_at_it_from_the_same_place(
    visitor: Visitor, session: Session, tmp_path: Path
) -> None:
    session.change(mesh="stairs")
    session.set(radius=1.25e-3)
    session.nudge([2e-3, 0.0, 3e-3])
    wait_until(lambda: session.latest().target is not None, "the proxy")
    visitor.press("Anatomy")
    box = visitor.canvas_box()
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    before = np.array(visitor.client.camera.position)
    wait_until(lambda: (visitor.client.camera.position == before).all(), "the camera to rest")
    visitor.tab.mouse.move(x, y + 0.3 * box["height"])
    visitor.tab.mouse.down(button="left")
    visitor.tab.mouse.move(x + 90, y + 0.35 * box["height"], steps=5)
    visitor.tab.mouse.up(button="left")
    wait_until(
        lambda: np.linalg.norm(visitor.client.camera.position - before) > 0.05, "the view to turn"
    )
    rest: list[np.ndarray] = []

    def at_rest() -> bool:
        """The camera goes on for a while after the mouse has let go."""
        rest.append(np.array(visitor.client.camera.position))
        time.sleep(0.5)
        return len(rest) > 1 and (rest[-1] == rest[-2]).all()

    wait_until(at_rest, "the view to rest")
    with visitor.tab.expect_download(timeout=60_000) as download:
        visitor.press("Save")
    path = tmp_path / "mine.json"
    download.value.save_as(path)
    handle, options = np.array(session.handle.translation), session.options
    eye = np.array(visitor.client.camera.position)
    look_at = np.array(visitor.client.camera.look_at)

    visitor.choose("Show", "thin-plate-both-sides")
    visitor.press("Load")
    wait_until(lambda: session.scene.mesh_name == "thin-plate", "another scene")
    wait_until(lambda: session.latest().autopilot, "the hand")
    with visitor.tab.expect_file_chooser() as chooser:
        visitor.press("Open a scenario file")
    chooser.value.set_files(path)
    wait_until(lambda: session.scene.mesh_name == options.mesh, "the scene that was saved")
    wait_until(lambda: session.options == options, "its settings")
    wait_until(lambda: np.abs(session.handle.translation - handle).max() < 1e-9, "its proxy")
    camera = visitor.client.camera
    wait_until(lambda: np.abs(camera.position - eye).max() < 2e-3, "its camera")
    assert np.abs(camera.look_at - look_at).max() < 2e-3
    visitor.reads("Show", "my-set-up")
    visitor.picture("scenario-opened")
    # One that is none is refused with the reason, and what was there stays.
    path.write_text('{"format": 1, "name": "x", "about": "x", "mesh": "../../secret.stl"}')
    with visitor.tab.expect_file_chooser() as chooser:
        visitor.press("Open a scenario file")
    chooser.value.set_files(path)
    visitor.tab.get_by_text("is not known here: bring it first").first.wait_for()
    assert session.scene.mesh_name == options.mesh
    assert visitor.complaints == []


def test_the_leak_of_the_papers_rule_is_said_until_reset(
    visitor: Visitor, session: Session, page: Page
) -> None:
    visitor.choose("Show", "unclean-mesh-paper")
    visitor.press("Load")
    wait_until(lambda: session.scene.mesh_name == "skull-coarse", "the skull")
    wait_until(lambda: session.crossing is not None, "the tool to cross")
    crossing = session.crossing
    assert crossing is not None
    latch = visitor.tab.get_by_text(f"Crossed at tick {crossing.tick:,}, triangle #")
    latch.wait_for(timeout=60_000)
    mark = page._crossing._label  # drawn in the scene, where no browser finds a text
    assert mark.visible
    assert f"crossed at tick {crossing.tick:,}" in mark.text
    wait_until(lambda: visitor.readout("crossing") == f"tick {crossing.tick:,}", "the read-out")
    rests(session)
    assert latch.is_visible()
    assert visitor.tab.get_by_text("Free.", exact=True).count() == 0
    visitor.picture("scenario-leak")
    visitor.press("Reset")
    latch.wait_for(state="hidden", timeout=60_000)
    wait_until(lambda: not mark.visible, "the mark to go")
    assert visitor.complaints == []
