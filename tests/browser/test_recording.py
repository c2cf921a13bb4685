"""Keeping a session: what a user does on the page's tab about recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from PIL import Image

from app.recording import rerun
from app.recording.read import read
from app.session import Session
from app.settings import Options
from app.view import Page
from app.view.clients import pictures
from app.view.tabs import recorder
from tests.support.watching import ARTIFACTS, Visitor, drawn_share, wait_until


@pytest.fixture(scope="module")
def session(chromium: str) -> Iterator[Session]:
    with Session(Options(mesh="cube", robot="point", rate=500.0)) as session:
        yield session


@pytest.fixture(scope="module")
def page(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    place = tmp_path_factory.mktemp("recordings")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorder, "folder", lambda: place)
        patch.setattr(pictures, "FRAMES", 4)  # a software renderer takes its time
        page = Page(session, "127.0.0.1", 0)
        yield page
        page.close()


@pytest.fixture(scope="module")
def visitor(page: Page, open_tab: Callable[[Page], Visitor]) -> Visitor:
    visitor = open_tab(page)
    visitor.tab.get_by_role("tab", name="Record", exact=True).click()
    return visitor


def slide(session: Session, seconds: float = 2.0) -> None:
    """Push the tool into the cube's top and along it, as a hand would."""
    start = session.scene.T_base_start
    for u in np.linspace(0.0, 1.0, 40):
        shift = np.array([0.02 * u - 0.01, 0.0, -0.05 * min(2.0 * u, 1.0)])
        session.drive(pin.SE3(start.rotation, start.translation + shift), held=u < 1.0)
        until = session.latest().tick + round(seconds * 500 / 40)
        wait_until(lambda until=until: session.latest().tick >= until, "the loop to tick")


def downloaded(visitor: Visitor, button: str, folder: Path) -> Path:
    with visitor.tab.expect_download(timeout=90_000) as waiting:
        visitor.press(button)
    path = folder / waiting.value.suggested_filename
    waiting.value.save_as(path)
    return path


def banner(visitor: Visitor, text: str) -> Any:
    return visitor.tab.get_by_text(text).first


@pytest.mark.slow
def test_a_user_records_replays_scrubs_and_takes_pictures(
    session: Session, page: Page, visitor: Visitor, browser: Any, tmp_path: Path
) -> None:
    visitor.press("Record")
    wait_until(lambda: session.tape is not None and session.tape.running, "the recording")
    slide(session)
    visitor.press("Stop recording")
    wait_until(lambda: not session.tape.running, "the file")
    visitor.tab.get_by_text("Recorded ").first.wait_for(timeout=20_000)
    recording = read(session.tape.path)
    assert recording.rows["planes"].max() > 0
    assert rerun.first_difference(recording) is None
    visitor.picture("recorded")

    visitor.press("Replay")
    banner(visitor, "Replay: tick").wait_for(timeout=30_000)
    assert session.latest().paused
    stood = session.latest().tick
    slider = visitor.tab.get_by_role("slider").first
    slider.focus()
    slider.press("End")
    last = int(recording.rows["tick"][-1])
    banner(visitor, f"Replay: tick {last:,}").wait_for(timeout=30_000)
    wait_until(
        lambda: np.linalg.norm(tool_on_page(page) - recording.rows["tip"][-1]) < 1e-6,
        "the tool where it was at the end",
    )
    at_end = visitor.picture("replay-end")
    slider.press("Home")
    first = int(recording.rows["tick"][0])
    banner(visitor, f"Replay: tick {first:,}").wait_for(timeout=30_000)
    visitor.tab.wait_for_timeout(500)
    at_start = visitor.picture("replay-start")
    assert np.abs(at_end.astype(int) - at_start.astype(int)).max() > 40  # another picture

    visitor.choose("Speed", "1/4")
    visitor.press("Play")
    wait_until(lambda: tool_on_page(page)[2] < recording.rows["tip"][0, 2] - 1e-3, "a move")
    sequence = downloaded(visitor, "Image sequence", tmp_path)
    with Image.open(sequence) as gif:
        assert gif.is_animated  # pillow makes one picture of pictures that are alike
    if page.shown.telemetry.tick < last:
        visitor.press("Pause replay")
    assert session.latest().tick == stood  # the session itself rests

    shot = downloaded(visitor, "Screenshot", tmp_path)
    image = np.asarray(Image.open(shot).convert("RGB"))
    assert image.shape[2] == 3
    assert min(image.shape[:2]) > 100
    assert drawn_share(image) > 0.03

    scene = downloaded(visitor, "Scene as HTML", tmp_path)
    assert drawn_share(offline(browser, scene)) > 0.03

    visitor.press("Back to the session")
    wait_until(lambda: session.latest().tick > stood + 50, "the session to go on")
    assert not visitor.complaints


@pytest.mark.slow
def test_while_a_replay_is_shown_the_session_waits_and_all_is_back_afterwards(
    session: Session, page: Page, visitor: Visitor
) -> None:
    """The recording is of another mesh and rule than the session has by then, and of a corridor."""
    box = visitor.tab.get_by_role
    session.change(mesh="skull-coarse")
    session.set(rule="all")
    session.set(corridor=2e-3)
    session.set_autopilot(True)
    visitor.press("Record")
    wait_until(lambda: session.tape is not None and session.tape.rows > 300, "ticks")
    visitor.press("Stop recording")
    wait_until(lambda: not session.tape.running, "the file")
    session.set_autopilot(False)
    session.change(mesh="cube")
    session.set(rule="paper")
    session.set(corridor=None)
    wait_until(lambda: page.shown.scene.mesh_name == "cube", "the cube")
    visitor.press("Arm")
    wait_until(lambda: visitor.client.camera.position[2] > 3.0, "the view of the arm")
    seen_from = np.array(visitor.client.camera.position)
    options, scene, handle = session.options, session.scene, session.handle
    wait_until(lambda: box("button", name="Replay", exact=True).is_enabled(), "the list")
    visitor.press("Replay")
    banner(visitor, "Replay: tick").wait_for(timeout=30_000)

    # The page shows what is of the recording, and none of it can be changed.
    visitor.reads("Mesh", "skull-coarse")
    visitor.reads("Rule", "all")
    nodes = page.server.scene._handle_from_node_name
    drawn = lambda: (page._labels["/corridor/name"].visible, nodes["/corridor/left"].visible)  # noqa: E731
    wait_until(lambda: drawn() == (True, True), "the cut and its corridor")
    for name in ("Mesh", "Robot", "Rule", "Motion sphere", "Show"):
        wait_until(box("combobox", name=name, exact=True).is_disabled, f"{name} to be locked")
    visitor.tab.get_by_role("tab", name="Mesh", exact=True).click()
    for name in ("Examine", "Repair", "Flip"):
        wait_until(box("button", name=name, exact=True).is_disabled, f"{name} to be locked")
    visitor.tab.get_by_role("tab", name="Record", exact=True).click()
    wait_until(box("button", name="Record", exact=True).is_disabled, "Record to be locked")
    for name in ("Run", "Pause", "Step", "Recall to tool", "Reset", "Load", "Save"):
        box("button", name=name, exact=True).wait_for(state="detached")
    visitor.picture("replay-of-another-scene")
    # Nor is there a way around the controls.
    visitor.tab.keyboard.press("j")
    visitor.tab.get_by_text("Not nudged: a replay is shown").first.wait_for(timeout=20_000)
    assert not nodes["/proxy/gizmo"].visible
    assert (session.options, session.scene) == (options, scene)
    assert session.handle is handle
    assert session.latest().paused
    visitor.press("▶")
    first = page.shown.telemetry.tick
    wait_until(lambda: page.shown.telemetry.tick == first + 1 or first > 0, "a step of the replay")

    visitor.press("Back to the session")
    wait_until(lambda: page.shown.scene is scene, "the cube again")
    assert (session.options, session.scene) == (options, scene)
    visitor.reads("Mesh", "cube")
    wait_until(lambda: drawn() == (False, False), "the cut to go")
    for name in ("Mesh", "Robot", "Rule", "Motion sphere", "Show"):
        wait_until(box("combobox", name=name, exact=True).is_enabled, name)
    for name in ("Run", "Reset", "Load"):
        box("button", name=name, exact=True).wait_for(timeout=20_000)
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 50, "the session to go on")
    wait_until(
        lambda: np.abs(visitor.client.camera.position - seen_from).max() < 1e-3, "the view back"
    )
    assert not visitor.complaints


@pytest.mark.slow
def test_recordings_are_renamed_and_deleted_once_that_is_confirmed(
    session: Session, visitor: Visitor, sound_recording: Path
) -> None:
    place = sound_recording.parent
    chosen = visitor.tab.get_by_role("combobox", name="Recording", exact=True)
    wait_until(lambda: chosen.input_value() == sound_recording.name, "it to be in the list")
    visitor.tab.get_by_text("ticks, ").first.wait_for()
    visitor.press("Rename")
    dialog = visitor.tab.get_by_role("dialog")
    dialog.get_by_role("textbox").fill("../Übung 3/4 頭")
    dialog.get_by_role("button", name="Rename", exact=True).click()
    wait_until(lambda: chosen.input_value() == "_Übung 3_4 頭.vfrec", "its new name")
    assert (place / "_Übung 3_4 頭.vfrec").exists()
    assert not sound_recording.exists()
    # Nothing on the page says any more that the file is where it was.
    gone = visitor.tab.get_by_text(f"to {sound_recording}")
    wait_until(lambda: gone.count() == 0, "the old place to be forgotten")
    visitor.press("Delete recording")
    visitor.picture("recording-delete")
    dialog.get_by_role("button", name="Cancel", exact=True).click()
    assert (place / "_Übung 3_4 頭.vfrec").exists()
    visitor.press("Delete recording")
    visitor.tab.get_by_text("It cannot be brought back").wait_for()
    dialog.get_by_role("button", name="Delete", exact=True).click()
    wait_until(lambda: not (place / "_Übung 3_4 頭.vfrec").exists(), "it to be gone")
    wait_until(lambda: chosen.input_value() != "_Übung 3_4 頭.vfrec", "the list to say so")
    # One that is being written cannot be touched.
    visitor.press("Record")
    wait_until(lambda: session.tape.running and session.tape.rows > 0, "ticks")
    going = session.tape.path
    wait_until(lambda: chosen.input_value() == going.name, "it to be in the list")
    visitor.press("Delete recording")
    visitor.tab.get_by_text("is still being recorded").first.wait_for()
    visitor.press("Stop recording")
    wait_until(lambda: not session.tape.running, "the file")
    assert going.exists()


@pytest.fixture
def sound_recording(session: Session, page: Page) -> Path:
    """A recording that is in the list, the newest one."""
    tape = session.record(recorder.folder() / "run.vfrec")
    wait_until(lambda: tape.rows > 50, "ticks")
    session.stop_recording()
    return tape.path


def tool_on_page(page: Page) -> np.ndarray:
    """Where the page shows the tool's tip (3,) [m]."""
    return np.array(page.shown.telemetry.step.tip.translation)


def offline(browser: Any, path: Path) -> np.ndarray:
    """What a browser without any network shows of a file; fails if it asks the network."""
    asked: list[str] = []
    context = browser.new_context(
        viewport={"width": 1280, "height": 720}, device_scale_factor=0.4, offline=True
    )
    tab = context.new_page()
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(path.as_uri())
    picture = ARTIFACTS / "scene-offline.png"
    for _ in range(60):
        tab.wait_for_timeout(500)
        tab.screenshot(path=picture, scale="css", timeout=90_000)
        shown = np.asarray(Image.open(picture).convert("RGB"))
        if drawn_share(shown) > 0.03:
            break
    context.close()
    assert not [url for url in asked if not url.startswith(("file:", "data:", "blob:"))]
    return shown
