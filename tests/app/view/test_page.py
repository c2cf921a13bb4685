"""The page and its parts without a browser: nudges, help, names, colours, replay."""

from __future__ import annotations

import itertools
import re
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pinocchio as pin
import pytest

import vf
from app.scene import worker
from app.scene.moment import Moment
from app.scene.scene import Scene
from app.session import Session
from app.settings import Options
from app.view import Page, camera, palette
from app.view.clients import client_names
from app.view.clients.client_input import ClientInput
from app.view.controls import help
from app.view.part import Clients, Part
from app.view.tabs import recorder
from app.words import Refused
from tests.support.headless import wait_until


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
        axes = camera.viewer_axes(looking(eye, [0.0, 0.0, 0.0]))
        np.testing.assert_allclose(axes, np.column_stack([right, away, [0, 0, 1]]), atol=1e-12)


def test_the_viewers_axes_are_orthonormal_for_any_camera() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        q = rng.normal(size=4)
        axes = camera.viewer_axes(q / np.linalg.norm(q))
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


def test_every_rule_status_and_outcome_of_the_solver_has_its_words() -> None:
    assert set(palette.RULE_HELP) == set(vf.RULES)
    assert set(palette.LOOKS) == set(vf.Rule)
    assert set(palette.STATUS_HELP) == set(vf.Status)
    assert set(palette.SOLVER_HELP) == set(vf.Solver)


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
