"""Keys, the Escape key, number fields, lenses, the section and the script of the page."""

from __future__ import annotations

import asyncio
import gzip
import http.client
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

import vf
from app.refused import Refused
from app.scene import scene as scenes
from app.scene.outside import shows_fronts_only
from app.session import Session
from app.settings import Options
from app.view import Page, camera
from app.view.clients.escape import EscapeKey
from app.view.controls import fields
from app.view.controls.help import Help
from app.view.controls.keys import STEPS, Keys, viewer_axes
from app.view.controls.views import Views
from app.view.drawing import section
from app.view.script import adding, script
from app.view.units import VIEW_SCALE
from tests.support.headless import wait_until


class Handle:
    """A stand-in for any control: stores its callbacks, and calls them as for a client."""

    def __init__(self, **properties: Any) -> None:
        self.__dict__.update(properties)
        self.heard: list[Any] = []

    def _listen(self, function: Any) -> Any:
        self.heard.append(function)
        return function

    on_trigger = on_update = on_click = _listen

    def __enter__(self) -> Handle:
        return self

    def __exit__(self, *_: object) -> None: ...

    def act(self, client: Any, **properties: Any) -> None:
        self.__dict__.update(properties)
        for function in self.heard:
            asyncio.run(function(SimpleNamespace(client=client, target=self)))


class Gui:
    """A stand-in for viser's panel."""

    def __init__(self) -> None:
        self.made: list[Handle] = []
        self.themes: list[dict[str, Any]] = []

    def configure_theme(self, **theme: Any) -> None:
        self.themes.append(theme)

    def __getattr__(self, name: str) -> Callable[..., Handle]:
        def add(label: str = "", value: Any = None, **more: Any) -> Handle:
            self.made.append(Handle(kind=name, label=label, value=value, **more))
            return self.made[-1]

        return add

    def commands(self) -> dict[tuple[str, str | None], Handle]:
        keyed = [m for m in self.made if m.kind == "add_command"]
        found = {(m.hotkey, getattr(m, "modifier", None)): m for m in keyed}
        assert len(found) == len(keyed), "two commands have one key"
        return found


class ClientInput:
    """Runs orders at once."""

    owner = None

    def __init__(self) -> None:
        self.moved = SimpleNamespace(set=lambda: None)

    def submit(self, order: Callable[..., object], *arguments: object) -> None:
        order(*arguments)


def client(number: int = 0) -> Any:
    """A client whose camera looks along +y, slightly downwards."""
    eye = SimpleNamespace(
        wxyz=np.array([0.5, -0.8, 0.0, 0.0]) / np.hypot(0.5, 0.8),
        position=np.array([0.0, -10.0, 5.0]),
        look_at=np.zeros(3),
        up_direction=np.array([0.0, 0.0, 1.0]),
        fov=camera.FIELD_OF_VIEW,
        near=camera.NEAR_PLANE,
        far=camera.FAR_PLANE,
    )
    return SimpleNamespace(client_id=number, camera=eye, atomic=lambda: Handle(), gui=Gui())


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with Session(Options(mesh="cube", robot="point", rate=500.0)) as session:
        yield session


@pytest.fixture
def panel(session: Session) -> SimpleNamespace:
    """All commands without a browser; the camera orders and the notifications."""
    gui, client_input = Gui(), ClientInput()
    looked: list[str] = []
    told: list[str] = []
    notify = lambda _client, text: told.append(text)  # noqa: E731
    server: Any = SimpleNamespace(gui=gui, on_client_disconnect=lambda function: function)
    escape = EscapeKey(server, client_input)  # type: ignore[arg-type]
    Help(server, client_input, escape, 0.0)  # type: ignore[arg-type]
    views = Views(
        server,
        client_input,  # type: ignore[arg-type]
        lambda _client, name: looked.append(name),
        lambda _client: looked.append("section"),
        {},
    )
    Keys(server, session, client_input, notify, views.commands())  # type: ignore[arg-type]
    return SimpleNamespace(gui=gui, looked=looked, told=told, escape=escape)


def test_every_key_has_one_command_and_none_of_visers(panel: Any) -> None:
    commands = panel.gui.commands()
    keys = {key for key, _ in commands}
    flying = {*"WASDQE", "arrowup", "arrowdown", "arrowleft", "arrowright"}
    assert not keys & flying
    # Nudges, pause, steps, reset, rules, views, lens, section.
    assert keys >= {*"JLIKUOPNRTVFXZBH1234567890", "escape"}
    assert {held for key, held in commands if key == "N"} == {None, "shift", "alt"}
    assert all(command.label for command in commands.values()), "each has a label"
    assert len({command.label for command in commands.values()}) == len(commands)


def test_keys_pause_step_choose_rules_and_reset(panel: Any, session: Session) -> None:
    commands = panel.gui.commands()
    me = client()
    press = lambda key, held=None: commands[key, held].act(me)  # noqa: E731
    press("P")
    wait_until(lambda: session.latest().paused)
    for held, ticks in STEPS.items():
        before = session.latest().tick
        press("N", held)
        wait_until(lambda n=before + ticks: session.latest().tick >= n)
        assert session.latest().tick == before + ticks
        assert session.latest().paused
    press("P")
    wait_until(lambda: not session.latest().paused)
    for number, rule in enumerate(vf.RULES, 1):
        press(str(number))
        assert session.options.rule == rule
    press("1")
    before_nudge = session.handle.translation.copy()
    press("J", "shift")
    moved = session.handle.translation - before_nudge
    np.testing.assert_allclose(moved, -1e-3 * viewer_axes(me.camera.wxyz)[:, 0], atol=1e-12)
    press("R")
    np.testing.assert_allclose(
        session.handle.translation, session.scene.T_base_start.translation, atol=1e-12
    )
    press("G")
    wait_until(lambda: session.latest().autopilot)
    press("C")
    wait_until(lambda: not session.latest().autopilot)
    for key, name in (("5", "Side"), ("6", "Front"), ("7", "Top"), ("0", "Arm"), ("X", "section")):
        press(key)
        assert panel.looked[-1] == name
    assert panel.told == []


def test_the_dark_theme_is_per_client(panel: Any) -> None:
    one, other = client(0), client(1)
    toggle = panel.gui.commands()["B", None]
    for _ in range(2):
        toggle.act(one)
    toggle.act(other)
    assert [theme["dark_mode"] for theme in one.gui.themes] == [True, False]
    assert [theme["dark_mode"] for theme in other.gui.themes] == [True]


def test_escape_closes_the_clients_newest_dialog_then_calls_the_fallbacks(panel: Any) -> None:
    escape, closed = panel.escape, []
    replay = [True]
    escape.add_fallback(lambda: bool(replay) and replay.pop())
    first, second = lambda: closed.append("first"), lambda: closed.append("second")
    escape.opened(0, first)
    escape.opened(0, second)
    escape.opened(1, lambda: closed.append("another's"))
    escape.press(0)
    assert closed == ["second"]
    escape.closed(0, first)  # by its own button
    escape.closed(0, first)
    escape.press(0)
    assert closed == ["second"]
    assert replay == []
    escape.press(0)  # nothing is open any more
    assert closed == ["second"]


def test_escape_closes_the_help(panel: Any) -> None:
    me = client()
    shut: list[bool] = []
    me.gui.add_modal = lambda _title: Handle(close=lambda: shut.append(True))
    commands = panel.gui.commands()
    commands["H", None].act(me)
    commands["escape", None].act(me)
    assert shut == [True]
    commands["escape", None].act(me)
    assert shut == [True]


class Typing:
    """A number field with a stand-in for its timer."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, take: Callable[[float], object]) -> None:
        self.timers: list[Any] = []
        self.told: list[str] = []
        self.value = 5.0

        def timer(_seconds: float, function: Any, arguments: Any) -> Any:
            made = SimpleNamespace(on=False)
            made.start = lambda: setattr(made, "on", True)
            made.cancel = lambda: setattr(made, "on", False)
            made.end = lambda: function(*arguments) if made.on else None
            self.timers.append(made)
            return made

        monkeypatch.setattr(fields.threading, "Timer", timer)

        def takes(value: float) -> None:
            take(value)
            self.value = value

        self.control = Handle(label="Radius [mm]", value=5.0)
        self.field = fields.NumberField(
            self.control,  # type: ignore[arg-type]
            (0.05, 20.0),
            ClientInput(),  # type: ignore[arg-type]
            lambda _client, text: self.told.append(text),
            takes,
            lambda: self.value,
        )

    def type(self, *texts: float) -> None:
        for number in texts:
            self.control.act(client(), value=number)
            self.field.sync()  # the page does four times a second

    def wait(self) -> None:
        for timer in self.timers:
            timer.end()


def test_a_number_in_range_is_set_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    typing = Typing(monkeypatch, lambda value: None)
    typing.type(7.5)
    assert typing.value == 7.5
    assert typing.told == []


def test_a_number_is_not_clamped_while_it_is_typed(monkeypatch: pytest.MonkeyPatch) -> None:
    typing = Typing(monkeypatch, lambda value: None)
    typing.type(0.0)
    assert typing.control.value == 0.0, "the field is left alone while somebody types"
    typing.type(0.0, 0.5)
    typing.wait()
    assert typing.value == 0.5
    assert typing.control.value == 0.5
    assert typing.told == []


@pytest.mark.parametrize(("typed", "becomes"), [(900.0, 20.0), (0.0, 0.05), (-3.0, 0.05)])
def test_a_clamped_number_is_shown_and_notified(
    monkeypatch: pytest.MonkeyPatch, typed: float, becomes: float
) -> None:
    for browser_clamps in (False, True):
        typing = Typing(monkeypatch, lambda value: None)
        typing.type(typed)
        if browser_clamps:  # it does so when the field is left
            typing.type(becomes)
        typing.wait()
        assert typing.value == becomes
        assert typing.control.value == becomes
        assert len(typing.told) == 1
        for word in ("Radius", f"{typed:g}", f"{becomes:g}", "0.05 to 20"):
            assert word in typing.told[0]


def test_a_refused_number_is_reset_and_notified(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(value: float) -> None:
        raise Refused(f"a corridor of {value:g} mm is wider than the path's bends allow")

    typing = Typing(monkeypatch, refuse)
    typing.type(12.0)
    assert typing.control.value == 5.0
    assert "12 mm is wider" in typing.told[0]


def test_another_lens_keeps_the_size_of_objects_at_the_centre() -> None:
    me = client()
    eye = me.camera

    def height() -> float:
        return float(np.linalg.norm(eye.position - eye.look_at) * np.tan(0.5 * eye.fov))

    before, direction = height(), eye.position / np.linalg.norm(eye.position)
    camera.set_lens(me, camera.PARALLEL)
    assert camera.is_parallel(me)
    assert height() == pytest.approx(before)
    np.testing.assert_allclose(eye.position / np.linalg.norm(eye.position), direction, atol=1e-12)
    # A thing half a picture's height nearer looks 1.8 % larger, as the hint says, no more.
    distance = np.linalg.norm(eye.position)
    assert distance / (distance - height()) == pytest.approx(1.018, abs=5e-4)
    assert eye.near < distance - 10.0 * height()
    assert distance < eye.far
    camera.set_lens(me, camera.FIELD_OF_VIEW)
    np.testing.assert_allclose(eye.position, [0.0, -10.0, 5.0], atol=1e-9)
    assert (eye.near, eye.far) == (camera.NEAR_PLANE, camera.FAR_PLANE)


def test_the_clipping_planes_follow_a_parallel_camera() -> None:
    me = client()
    camera.set_lens(me, camera.PARALLEL)
    for zoom in (0.1, 0.01, 3.0):
        me.camera.position = me.camera.look_at + zoom * (me.camera.position - me.camera.look_at)
        camera.update_clipping(me)
        distance = np.linalg.norm(me.camera.position - me.camera.look_at)
        assert 0.3 * distance < me.camera.near < 0.7 * distance
        assert me.camera.far > distance


def test_axis_views_are_along_the_axes_with_any_lens(session: Session) -> None:
    tip = np.array(session.scene.T_base_start.translation)
    for lens in (camera.FIELD_OF_VIEW, camera.PARALLEL):
        for k, name in enumerate(("Side", "Front", "Top")):
            me = client()
            camera.set_lens(me, lens)
            camera.move(me, camera.named_view(name, session.scene, None))
            away = me.camera.position - me.camera.look_at
            np.testing.assert_allclose(away / np.linalg.norm(away), np.eye(3)[k], atol=1e-12)
            assert abs(me.camera.up_direction @ away) < 1e-9, "up is not the way it looks"
            assert np.linalg.norm(me.camera.look_at / VIEW_SCALE - tip) < 0.02
            half = np.linalg.norm(away) * np.tan(0.5 * lens) / VIEW_SCALE
            assert half == pytest.approx(camera.site_half_height(session.scene), rel=0.07)


@pytest.fixture(scope="module")
def anatomy() -> scenes.Scene:
    return scenes.build(Options(mesh="skull-coarse", robot="point"), 1, warm=False)


def test_a_section_keeps_exactly_the_part_behind_the_plane(anatomy: scenes.Scene) -> None:
    rng = np.random.default_rng(3)
    shown = anatomy.vertices_shown[anatomy.faces_shown]
    for _ in range(6):
        point = rng.choice(anatomy.vertices_shown) + rng.normal(scale=1e-3, size=3)
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        parts = [section.make(section.Cut(anatomy, point, side * normal)) for side in (1.0, -1.0)]
        areas = []
        for part, side in zip(parts, (1.0, -1.0), strict=True):
            corners = part.vertices[part.faces]
            assert (side * (corners - point) @ normal).max() < 1e-12
            areas.append(trimesh.triangles.area(corners).sum())
        # Both sides together are the whole.
        assert sum(areas) == pytest.approx(trimesh.triangles.area(shown).sum(), rel=1e-9)


def test_the_section_follows_the_tip_and_ends_with_its_client(
    anatomy: scenes.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(section, "PERIOD", 0.0)
    drawn: list[Any] = []
    stage: Any = SimpleNamespace(cut=drawn.append)
    cutting, me = section.Section(stage), client()
    tip = np.array(anatomy.T_base_start.translation)

    def update(at: np.ndarray, *clients: Any) -> None:
        cutting.update(anatomy, {c.client_id: c for c in clients}, at)

    def drawn_behind(at: np.ndarray) -> bool:
        update(at, me)
        if not drawn or drawn[-1] is None:
            return False
        away = me.camera.position / VIEW_SCALE - at
        farthest = ((drawn[-1][0] - at) @ away).max() / np.linalg.norm(away)
        return bool(farthest < 1e-9)

    update(tip, me)
    assert drawn == [], "there is no section before it is switched on"
    cutting.toggle(me)
    low = tip - np.array([0.0, 0.0, 0.03])
    wait_until(lambda: drawn_behind(low))
    wait_until(lambda: drawn_behind(low - np.array([0.0, 0.0, 0.01])))
    update(low)  # the client is gone
    assert drawn[-1] is None
    assert not cutting.on
    cutting.toggle(me)
    wait_until(lambda: drawn_behind(low))
    cutting.toggle(me)
    update(low, me)
    assert drawn[-1] is None


def ball(radius: float = 1.0, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    made = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    made.apply_translation(at)
    return made


def inverted(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)


def joined(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(parts)


def test_back_faces_are_culled_only_where_none_is_visible_from_outside() -> None:
    flipped, opened = ball(), ball()
    faces = flipped.faces.copy()
    faces[7] = faces[7, ::-1]
    flipped = trimesh.Trimesh(flipped.vertices, faces, process=False)
    opened = trimesh.Trimesh(opened.vertices, opened.faces[1:], process=False)
    soup = trimesh.Trimesh(*trimesh.triangles.to_kwargs(ball().triangles).values(), process=False)
    cases = {
        "a ball": (ball(), True),
        "two": (joined(ball(), ball(0.5, (3.0, 0.0, 0.0))), True),
        "far from the origin": (ball(1.0, (50.0, -20.0, 7.0)), True),
        "inside out": (inverted(ball()), False),
        "one of two inside out": (joined(ball(), inverted(ball(0.5, (3.0, 0.0, 0.0)))), False),
        "a face turned over": (flipped, False),
        "a hole": (opened, False),
        "corners not shared": (soup, False),
        "faces twice": (joined(ball(), ball()), True),  # two bodies in one place
    }
    for name, (mesh, expected) in cases.items():
        shown = shows_fronts_only(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64))
        assert shown == expected, name
        if shown:
            # Oracle: the first face that a ray from outside meets is a front face.
            rng = np.random.default_rng(0)
            eyes = rng.normal(size=(200, 3))
            eyes = mesh.bounds.mean(axis=0) + 9.0 * eyes / np.linalg.norm(eyes, axis=1)[:, None]
            aims = rng.choice(mesh.vertices, 200) + rng.normal(scale=0.1, size=(200, 3))
            first = mesh.ray.intersects_first(eyes, aims - eyes)
            met = first >= 0
            turned = np.einsum("ij,ij->i", mesh.face_normals[first[met]], (aims - eyes)[met])
            assert met.sum() > 50
            assert (turned < 0.0).all(), name
    assert not shows_fronts_only(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))


def test_the_page_is_served_with_its_script_first(session: Session) -> None:
    page = Page(session, "127.0.0.1", 0)
    try:
        for coding in ("gzip", "identity"):
            connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=30)
            connection.request("GET", "/", headers={"Accept-Encoding": coding})
            answer = connection.getresponse()
            body = answer.read()
            assert answer.status == 200
            assert int(answer.headers["Content-Length"]) == len(body)
            text = (gzip.decompress(body) if coding == "gzip" else body).decode()
            assert text.count(script()) == 1
            assert text.index(script()) < text.index("<script", text.index(script()))
            assert text.index("<script") == text.index(f"<script>{script()}")
            connection.close()
    finally:
        page.close()


def test_only_pages_get_the_script() -> None:
    response = SimpleNamespace(headers={"Content-Type": "image/png"}, body=b"<head>")
    assert adding(lambda *_: response)(None, None).body == b"<head>"  # type: ignore
    assert adding(lambda *_: None)(None, None) is None  # type: ignore[arg-type]
