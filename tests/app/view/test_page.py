"""Parts of the page without a browser: keys, names, cameras, signals, trail, colours."""

from __future__ import annotations

import asyncio
import itertools
import re
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import vf
from app.control.messages import LoopStats, Telemetry
from app.recording.playback import Moment
from app.refused import Refused
from app.scene import worker
from app.scene.scene import Scene
from app.session import Session
from app.settings import Options
from app.view import Page, camera, palette
from app.view.clients import client_names
from app.view.clients.client_input import ClientInput
from app.view.controls import help, keys
from app.view.drawing import trail
from app.view.part import Clients, Part
from app.view.tabs import recorder, signals
from app.view.tabs.depth import signed_distance
from app.view.units import VIEW_SCALE
from tests.support.headless import wait_until
from tests.support.runs import run_headless


def looking(eye: list[float], at: list[float]) -> np.ndarray:
    """Quaternion wxyz of a level camera, +z forward, −y up."""
    forward = np.array(at, dtype=float) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    R = np.column_stack([right, np.cross(forward, right), forward])
    x, y, z, w = pin.Quaternion(R).coeffs()
    return np.array([w, x, y, z])


def test_nudges_are_in_the_viewers_directions() -> None:
    # From the front (−y) looking along +y, and from the right (+x) looking along −x, both downward.
    for eye, right, away in (
        ([0.0, -1.0, 0.7], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
        ([1.0, 0.0, 0.7], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]),
    ):
        axes = keys.viewer_axes(looking(eye, [0.0, 0.0, 0.0]))
        np.testing.assert_allclose(axes, np.column_stack([right, away, [0, 0, 1]]), atol=1e-12)


def test_the_viewers_axes_are_orthonormal_for_any_camera() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        q = rng.normal(size=4)
        axes = keys.viewer_axes(q / np.linalg.norm(q))
        np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        assert (axes[:, 2] == [0.0, 0.0, 1.0]).all()


def test_the_help_has_ten_lines() -> None:
    assert len(help.LINES) == 10


def text(html: str) -> str:
    return re.sub(r"<[^>]*>", "", html)


def test_the_line_of_a_client_names_who_drags() -> None:
    assert client_names.line(0, 0, 1) == ""
    assert "You are ■ client 3, one of 2" in text(client_names.line(2, None, 2))
    assert "You (■ client 1) have the proxy" in text(client_names.line(0, 0, 2))
    other = client_names.line(0, 4, 3)
    assert "Another client is dragging: ■ client 5 has the proxy" in text(other)
    assert palette.css(client_names.color(4)) in other
    assert len({client_names.color(i) for i in range(6)}) == 6


def test_signed_distance_is_negative_inside_only() -> None:
    solid = trimesh.creation.icosphere(subdivisions=3, radius=0.01)
    surface = vf.Surface.from_arrays(solid.vertices, solid.faces)
    assert signed_distance(surface, [0.0, 0.0, 0.012]) == pytest.approx(0.002, abs=1e-4)
    assert signed_distance(surface, [0.0, 0.0, 0.007]) == pytest.approx(-0.003, abs=2e-4)
    sheet = vf.Surface.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    assert signed_distance(sheet, [0.1, 0.1, -0.2]) == pytest.approx(0.2)


@pytest.fixture(scope="module")
def telemetry() -> list[Telemetry]:
    """The point pushed without a fixture from above a sphere into it."""
    options = Options(mesh="sphere", robot="point", rule="off")
    start = run_headless(options, [], 1)[0].step.tip
    from app.control.messages import Command

    goal = pin.SE3(start.rotation, start.translation - np.array([0.0, 0.0, 0.02]))
    return run_headless(options, [Command(goal, 1)], 150)


@pytest.fixture(scope="module")
def surface() -> vf.Surface:
    from app.scene import scene

    return scene.build(Options(mesh="sphere", robot="point"), 1).surface


def test_a_sample_has_the_ticks_values_in_the_plots_units(
    telemetry: list[Telemetry], surface: vf.Surface
) -> None:
    assert signals.sample(replace(telemetry[0], step=None), surface) is None
    last = replace(telemetry[-1], stats=LoopStats(tick_median=40e-6, tick_worst=90e-6))
    values = signals.sample(last, surface)
    assert values is not None
    p = last.step.tip.translation
    true = trimesh.proximity.signed_distance(
        trimesh.Trimesh(surface.vertices * 1e3, surface.faces, process=False), [p * 1e3]
    )[0]
    assert true > 1.0, "trimesh counts the inside as positive; the tool must have gone in"
    assert values[0] == pytest.approx(-true, abs=1e-6)
    assert values[1] == pytest.approx(1e3 * np.linalg.norm(last.target.translation - p))
    assert values[2] == pytest.approx(np.linalg.norm(last.step.force))
    assert (values[3:6] == 0.0).all()
    assert values[6:] == pytest.approx([40.0, 90.0])
    assert len(values) == signals.CURVES


def test_an_earlier_time_clears_the_history() -> None:
    history = signals.History()
    for time in (1.0, 1.1, 1.2, 0.5):
        history.add(time, np.full(signals.CURVES, time))
    times, values = history.shown()
    assert times.tolist() == [0.0]
    assert (values == 0.5).all()


def test_plots_are_sampled_while_off_and_drawn_when_switched_on(
    telemetry: list[Telemetry],
) -> None:
    from app.scene import scene

    options = Options(mesh="sphere", robot="point")
    sphere = scene.build(options, 1, warm=False)
    context: Any = MagicMock()
    context.source.live = True
    tab = signals.Signals(context)
    tab.set_scene(sphere)
    tab._on.value = False

    def frame(shot: Telemetry) -> None:
        tab.frame(Moment(sphere, options, shot, clutched=False), {})

    for shot in telemetry:
        frame(shot)
    times, _ = tab._history.shown()
    assert len(times) == 2, "150 ms at a sample each 100 ms"
    plots = [SimpleNamespace(data=None) for _ in signals.PLOTS]
    tab._plots = plots
    frame(telemetry[-1])
    assert plots[0].data is None, "switched off, nothing is sent"
    tab._on.value = True
    switched = tab._on.on_update.call_args.args[0]
    asyncio.run(switched(None))
    frame(telemetry[-1])  # of a paused loop: no new tick
    assert all(len(plot.data[0]) == 2 for plot in plots), "drawn at once, with the earlier samples"
    context.source.live = False  # a replay begins
    frame(telemetry[0])
    assert len(tab._history.shown()[0]) == 1


def test_plots_of_several_curves_have_a_legend() -> None:
    stage: Any = MagicMock()
    signals.Signals(stage)
    added = stage.server.gui.add_uplot.call_args_list
    assert len(added) == len(signals.PLOTS)
    for call, plot in zip(added, signals.PLOTS, strict=True):
        assert call.kwargs["legend"]["show"] == (len(plot.curves) > 1)
        assert [s["label"] for s in call.kwargs["series"][1:]] == [c.name for c in plot.curves]


def test_the_plots_scroll_over_the_last_twenty_seconds() -> None:
    history = signals.History()
    times, values = history.shown()
    assert len(times) == 1
    assert (values == 0.0).all()
    for k in range(3 * signals.LENGTH):
        history.add(k * signals.PERIOD, np.full(signals.CURVES, float(k)))
    times, values = history.shown()
    assert times[-1] == 0.0
    assert -signals.SPAN <= times[0] < -0.95 * signals.SPAN
    assert (np.diff(times) > 0.0).all()
    assert values[-1, 0] == 3 * signals.LENGTH - 1
    history.add(3 * signals.LENGTH * signals.PERIOD + 15.0, np.zeros(signals.CURVES))
    times, _ = history.shown()
    assert times[0] >= -signals.SPAN, "a gap in time counts for the span"
    history.clear()
    assert len(history.shown()[0]) == 1


def test_the_trail_is_bounded_skips_jumps_and_keeps_the_newest() -> None:
    path = trail.Path()
    for k in range(2 * trail.LENGTH):
        path.add(np.array([k * 1e-3, 0.0, 0.0]), -k * 1e-6)
    assert path.count == trail.LENGTH
    assert path.segments[-1, 1, 0] == pytest.approx((2 * trail.LENGTH - 1) * 1e-3)
    np.testing.assert_allclose(path.segments[1:, 0], path.segments[:-1, 1])
    last = path.segments[-1, 1].copy()
    ahead = np.array([1.0, 0.0, 0.0])
    assert not path.add(last + 0.1 * trail.MIN_STEP * ahead, 0.0), "less than the shortest segment"
    assert not path.add(last + 2.0 * trail.MAX_STEP * ahead, 0.0), "a reset"
    assert path.add(last + (2.0 * trail.MAX_STEP + 1e-3) * ahead, 0.0)
    assert np.linalg.norm(np.diff(path.segments[-1], axis=0)) == pytest.approx(1e-3)
    path.break_line()
    assert not path.add(last, 0.0)
    path.clear()
    assert path.count == 0


def test_the_trail_is_darker_with_depth_and_has_another_colour_outside() -> None:
    depths = np.linspace(0.0, 2.0 * trail.MAX_DEPTH, 9)
    shades = trail.colors(-depths[1:]).astype(float)
    lightness = shades @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(lightness[:4]) < -10.0).all()
    assert (np.diff(lightness[4:]) == 0.0).all(), "no darker than the darkest"
    outside = trail.colors(np.array([0.0, 1e-3]))
    assert (outside == palette.SKY).all()


class Camera(SimpleNamespace):
    """The attributes of viser's camera that `Following` and `move` use."""


def client_at(eye: list[float], at: list[float]) -> Any:
    from contextlib import nullcontext

    return SimpleNamespace(
        camera=Camera(position=np.array(eye), look_at=np.array(at)), atomic=nullcontext
    )


def test_a_following_camera_keeps_the_tool_centred_at_its_distance() -> None:
    following = camera.Following()
    client = client_at([0.0, -10.0, 5.0], [0.0, 0.0, 0.0])
    following.start(7, np.zeros(3))
    following.update({7: client}, np.array([1e-6, 0.0, 0.0]))
    assert (client.camera.look_at == 0.0).all(), "less than a pixel"
    tip = np.array([0.01, 0.02, -0.005])
    following.update({7: client}, tip)
    np.testing.assert_allclose(client.camera.look_at, VIEW_SCALE * tip)
    away = client.camera.position - client.camera.look_at
    np.testing.assert_allclose(away, [0.0, -10.0, 5.0])
    # A stale position reported by the client causes no drift.
    client.camera.position, client.camera.look_at = np.array([0.0, -10.0, 5.0]), np.zeros(3)
    following.update({7: client}, 2.0 * tip)
    np.testing.assert_allclose(client.camera.look_at, 2.0 * VIEW_SCALE * tip)
    following.stop(7)
    following.update({7: client}, np.zeros(3))
    np.testing.assert_allclose(client.camera.look_at, 2.0 * VIEW_SCALE * tip)
    following.start(8, np.zeros(3))
    following.update({}, np.ones(3))
    assert following.clients == (), "a disconnected client is forgotten"


def test_the_surgeon_looks_down_along_the_instrument(telemetry: list[Telemetry]) -> None:
    step = telemetry[-1].step
    for R in (pin.rpy.rpyToMatrix(np.pi, 0.0, 0.0), pin.rpy.rpyToMatrix(0.6 + np.pi, 0.3, 0.0)):
        view = camera.surgeon_view(replace(step, tip=pin.SE3(R, np.array([0.1, 0.0, 0.2]))))
        forward = (view.look_at - view.eye) / np.linalg.norm(view.look_at - view.eye)
        angle = np.rad2deg(np.arccos(forward @ R[:, 2]))
        assert 25.0 < angle < 45.0
        assert view.eye[2] > view.look_at[2]
        np.testing.assert_allclose(view.look_at, [0.1, 0.0, 0.2])


# Linear RGB with a colour blindness: Machado, Oliveira, Fernandes 2009, severity 1.
BLINDNESS = {
    "none": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}


def seen(color: palette.Rgb, kind: str) -> np.ndarray:
    """CIE L*a*b* (3,) of an sRGB colour with a colour blindness."""
    c = np.array(color) / 255.0
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.array(BLINDNESS[kind]) @ linear, 0.0, 1.0)
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    xyz = np.array(to_xyz) @ linear / [0.9505, 1.0, 1.089]
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.mark.parametrize("kind", list(BLINDNESS))
def test_the_colours_of_the_rules_are_distinct(kind: str) -> None:
    for a, b in itertools.combinations(palette.LOOKS, 2):
        apart = np.linalg.norm(
            seen(palette.LOOKS[a].color, kind) - seen(palette.LOOKS[b].color, kind)
        )
        assert apart > 10.0, f"{a.name} and {b.name}: {apart:.1f}"  # 2.3 is just noticeable


def test_the_page_calls_every_part() -> None:
    with Session(Options(mesh="cube", robot="point")) as session:
        page = Page(session, "127.0.0.1", 0)
        try:
            kinds = [type(part) for part in page._parts]
            assert len(kinds) == len(set(kinds))
            assert set(kinds) == set(Part.__subclasses__())
            heard: list[str] = []

            class Listening(Part):
                def set_scene(self, scene: Scene) -> None:
                    heard.append(f"scene {scene.mesh_name}")

                def frame(self, shown: Moment, clients: Clients) -> None:
                    heard.append(f"frame {shown.scene.mesh_name}")

                def read_out(self, shown: Moment) -> None:
                    heard.append("read-out")

            # Without clients the view thread does not call the parts.
            page._parts = (*page._parts, Listening())
            session.change(mesh="stairs")
            page._frame()
            page._frame()
            page._read_out()
            assert heard == ["scene stairs", "frame stairs", "frame stairs", "read-out"]
        finally:
            page.close()


def test_opening_a_replay_can_be_stopped_and_the_session_ticks_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "folder", lambda: tmp_path)
    client: Any = SimpleNamespace(client_id=-1)
    with Session(Options(mesh="cube", robot="point")) as session:
        tape = session.record(tmp_path / "run.vfrec")
        wait_until(lambda: tape.rows > 20)
        session.stop_recording()
        session.change(mesh="stairs")
        # Built in another process, as for a large mesh.
        monkeypatch.setattr(worker, "light", lambda _mesh: False)
        page = Page(session, "127.0.0.1", 0)
        try:
            (tab,) = (part for part in page._parts if isinstance(part, recorder.RecordTab))

            def open_it() -> threading.Thread:
                thread = threading.Thread(
                    target=tab._run, args=(client, lambda: tab._start(client))
                )
                thread.start()
                wait_until(lambda: tab._opening or not thread.is_alive())
                return thread

            opening = open_it()
            page._read_out()
            assert tab._open.label == "Stop opening"
            tick = session.latest().tick
            wait_until(lambda: session.latest().tick > tick + 100)
            with pytest.raises(Refused, match="another change is under way"):
                session.change(mesh="gear")
            assert session.work.going
            session.work.stop()
            opening.join(20.0)
            page._read_out()
            assert tab._open.label == "Replay"
            assert not session.suspended
            assert page.shown.scene.mesh_name == "stairs"

            open_it().join(60.0)
            page._frame()
            assert session.suspended
            assert page.shown.scene.mesh_name == "cube"
            assert page.shown.handle is None
            tab._replaying.leave()
            assert not session.suspended
        finally:
            page.close()


def test_a_gizmo_that_is_dragged_while_it_is_placed_is_placed_again() -> None:
    proxy, handle = MagicMock(), pin.SE3.Identity()
    entry = ClientInput(
        SimpleNamespace(handle=handle),  # type: ignore[arg-type]
        SimpleNamespace(get_clients=dict),  # type: ignore[arg-type]
        proxy,
        lambda _client, _text: None,
    )
    try:
        entry.release()
        wait_until(lambda: entry._shown is None)

        def moved_meanwhile(_handle: pin.SE3) -> None:
            entry.release()
            wait_until(lambda: entry._worker._work_queue.empty() and entry._shown is None)

        proxy.place.side_effect = moved_meanwhile
        entry.update(None, False)
        proxy.place.side_effect = None
        entry.update(None, False)
        assert proxy.place.call_count == 2
        entry.update(None, False)
        assert proxy.place.call_count == 2, "nothing is sent for an unchanged pose"
    finally:
        entry.close()
