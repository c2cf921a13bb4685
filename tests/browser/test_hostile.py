"""A client that is no browser and sends what no browser would: nothing of it may reach the tool."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest
import viser
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from app.session import Session
from app.settings import Options
from app.view import Page
from app.view.clients import client_names
from app.view.tabs import recorder
from app.view.units import VIEW_SCALE
from tests.support.watching import wait_until


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with Session(Options(mesh="sphere", port=0)) as session:
        yield session


@pytest.fixture
def attacker(page: Page) -> Iterator[ClientConnection]:
    with connect(
        page.url.replace("http", "ws"),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        max_size=None,
        # Two threads that wait for a third to end can fail in Python before 3.13.
        ping_interval=None,
        close_timeout=1.0,  # it reads nothing, not even the answer to its closing
    ) as connection:
        introduce(connection)
        wait_until(lambda: len(page.server.get_clients()) == 1, "the attacker to be known")
        yield connection
    wait_until(lambda: not page.server.get_clients(), "the attacker to be gone")


def introduce(connection: ClientConnection) -> None:
    """Say where the camera is, which makes the server count a client."""
    send(
        connection,
        "ViewerCameraMessage",
        wxyz=(1, 0, 0, 0),
        position=(1, 1, 1),
        fov=1.0,
        near=0.1,
        far=10.0,
        look_at=(0, 0, 0),
        up_direction=(0, 0, 1),
        image_height=100,
        image_width=100,
    )


def send(socket: ClientConnection, kind: str, **fields: object) -> None:
    socket.send(msgspec.msgpack.encode({"type": kind, **fields}))


def gizmo(
    socket: ClientConnection, phase: str, wxyz: object = None, position: object = None
) -> None:
    name = "/proxy/gizmo"
    if phase == "Update":
        send(
            socket,
            "TransformControlsUpdateMessage",
            name=name,
            owner="",
            wxyz=wxyz,
            position=position,
        )
    else:
        send(socket, f"TransformControlsDrag{phase}Message", name=name, owner="")


@pytest.mark.parametrize(
    ("wxyz", "position"),
    [
        ((math.nan, 0, 0, 0), (0, 0, 0)),
        ((1, 0, 0, 0), (math.inf, 0, 0)),
        ((0, 0, 0, 0), (0, 0, 0)),
        ((1, 0, 0, 0), (1e9, 0, 0)),
    ],
)
def test_absurd_proxies_are_refused_and_the_gizmo_returns(
    session: Session, page: Page, attacker: ClientConnection, wxyz: object, position: object
) -> None:
    session.reset()
    q, p = page.gizmo_pose
    good = p + np.array([0.1, 0.0, 0.0])
    gizmo(attacker, "Start")
    gizmo(attacker, "Update", q.tolist(), good.tolist())
    wait_until(lambda: np.allclose(VIEW_SCALE * session.handle.translation, good), "the good proxy")
    handle = session.handle.copy()
    gizmo(attacker, "Update", wxyz, position)
    gizmo(attacker, "End")
    wait_until(lambda: not session.latest().stale and not page.dragging, "the end of the drag")
    wait_until(
        lambda: np.allclose(page.gizmo_pose[0], q) and np.allclose(page.gizmo_pose[1], good),
        "the gizmo to be put back",
    )
    assert session.handle.isApprox(handle)
    assert np.isfinite(session.latest().q).all()


def test_a_client_that_vanishes_in_mid_drag_leaves_the_tool_holding(
    session: Session, page: Page, attacker: ClientConnection
) -> None:
    session.reset()
    wxyz, position = page.gizmo_pose
    gizmo(attacker, "Start")
    gizmo(attacker, "Update", wxyz.tolist(), (position + np.array([0.2, 0.0, 0.0])).tolist())
    wait_until(lambda: session.latest().target is not None, "the drag")
    time.sleep(1.0)
    assert not session.latest().stale, "a hand at rest is no lost hand"
    attacker.socket.shutdown(socket.SHUT_RDWR)  # no farewell
    wait_until(lambda: session.latest().stale, "the tool to hold")
    session.recall()
    wait_until(lambda: not session.latest().stale, "somebody to take over")


@pytest.mark.parametrize(
    ("label", "sent", "expected"),
    [
        ("Radius [mm]", 1e6, 20.0),
        ("Radius [mm]", -1.0, 0.05),
        ("Tip radius [mm]", math.inf, 0.0),
        ("Standoff [µm]", math.nan, 20.0),
        ("Scale", 1e300, 2.0),
        ("Rule", "none whatever", "certified"),
        ("Mesh", "/etc/passwd", "sphere"),
    ],
)
def test_panel_values_are_checked_by_the_server(
    session: Session,
    page: Page,
    attacker: ClientConnection,
    label: str,
    sent: object,
    expected: object,
) -> None:
    controls = page.server.gui._gui_input_handle_from_uuid.values()
    control = next(c for c in controls if getattr(c, "label", None) == label)
    send(attacker, "GuiUpdateMessage", uuid=control._impl.uuid, updates={"value": sent})
    wait_until(lambda: control.value == pytest.approx(expected), f"{label} = {expected}")
    options = session.options
    assert options.rule == "certified"
    assert session.scene.mesh_name == "sphere"
    assert 5e-5 <= options.radius <= 0.02
    assert options.standoff == 20e-6
    assert options.tip_radius == 0.0
    assert options.scale <= 2.0


def test_a_drag_ends_when_a_replay_begins_and_nothing_that_is_sent_reaches_the_session(
    session: Session, page: Page, attacker: ClientConnection
) -> None:
    session.reset()
    recorder.folder().mkdir(parents=True, exist_ok=True)
    tape = session.record(recorder.folder() / "run.vfrec")
    wait_until(lambda: tape.rows > 20, "ticks")
    session.stop_recording()
    controls = page.server.gui._gui_input_handle_from_uuid

    def use(label: str, value: object) -> None:
        control = next(c for c in controls.values() if getattr(c, "label", None) == label)
        send(attacker, "GuiUpdateMessage", uuid=control._impl.uuid, updates={"value": value})

    # The recording is in the list while it is still being made; the button says when it is over.
    wait_until(
        lambda: any(getattr(c, "label", None) == "Record" for c in controls.values()), "Record"
    )
    listed = next(c for c in controls.values() if getattr(c, "label", None) == "Recording")
    wait_until(lambda: listed.value == tape.path.name, "it to be in the list")
    wxyz, position = page.gizmo_pose
    aside = position + np.array([0.2, 0.0, 0.0])
    gizmo(attacker, "Start")
    gizmo(attacker, "Update", wxyz.tolist(), aside.tolist())
    wait_until(lambda: np.allclose(VIEW_SCALE * session.handle.translation, aside), "the drag")
    options, scene, handle = session.options, session.scene, session.handle
    wait_until(lambda: not session.work.going, "what was begun before to end")
    use("Replay", True)
    wait_until(lambda: session.suspended, "the replay")
    wait_until(lambda: not page.dragging, "the hand to be empty")
    gizmo(attacker, "Update", wxyz.tolist(), position.tolist())
    gizmo(attacker, "End")
    gizmo(attacker, "Start")
    gizmo(attacker, "Update", wxyz.tolist(), position.tolist())
    gizmo(attacker, "End")
    for label, value in (
        ("Rule", "off"), ("Mesh", "cube"), ("Robot", "point"), ("Motion sphere", "1 mm"),
        ("Radius [mm]", 1.0), ("Tip radius [mm]", 1.0), ("Standoff [µm]", 500.0),
        ("Autopilot", True), ("Clutch", True), ("Lock orientation", True), ("Scale", 0.5),
        ("Speed [mm/s]", 5.0), ("Stiffness [N/m]", 5.0), ("Stay by the path", True),
        ("Freeze and explore", True), ("Examine", True), ("Repair", True), ("Flip", True),
        ("Record", True), ("Loop", "Run"), ("Loop", "Step"), ("Proxy", "Reset"),
        ("Proxy", "Recall to tool"), ("Set-up", "Load"),
    ):  # fmt: skip
        use(label, value)
    speed = next(c for c in controls.values() if getattr(c, "label", None) == "Speed")

    def arrived() -> bool:
        # Again and again: when a replay's controls appear, their speed is set to 1.
        use("Speed", "1/4")
        return bool(speed.value == "1/4")

    # Messages are taken in their order: once this one is, the hand has all of those before it.
    wait_until(arrived, "all of it to arrive")
    done = threading.Event()
    page._input.submit(done.set)
    assert done.wait(20.0)
    assert (session.options, session.scene) == (options, scene)
    assert session.handle is handle
    assert session.suspended
    assert session.latest().paused
    use("Back to the session", True)
    wait_until(lambda: not session.suspended, "the session")
    assert (session.options, session.scene) == (options, scene)
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 700, "the session to go on")
    assert not session.latest().stale, "the drag that was cut short is no lost hand"
    rule = next(c for c in controls.values() if getattr(c, "label", None) == "Rule")
    wait_until(lambda: rule.value == options.rule and not rule.disabled, "the controls")


def test_one_client_has_the_proxy_and_the_others_are_told_who(
    session: Session, page: Page, attacker: ClientConnection
) -> None:
    session.reset()
    wxyz, position = page.gizmo_pose
    first = next(iter(page.server.get_clients()))
    with connect(
        page.url.replace("http", "ws"),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        max_size=None,
        close_timeout=1.0,
    ) as other:
        introduce(other)
        wait_until(lambda: len(page.server.get_clients()) == 2, "the other")
        second = max(page.server.get_clients())
        gizmo(attacker, "Start")
        mine = position + np.array([0.2, 0.0, 0.0])
        gizmo(attacker, "Update", wxyz.tolist(), mine.tolist())
        wait_until(lambda: np.allclose(VIEW_SCALE * session.handle.translation, mine), "the drag")
        told = page.client_line
        wait_until(lambda: client_names.name(first) in told(second), "the other to be told")
        assert "Another client is dragging" in told(second)
        assert "You" in told(first)
        gizmo(other, "Start")
        gizmo(other, "Update", wxyz.tolist(), (position - np.array([0.2, 0.0, 0.0])).tolist())
        gizmo(other, "End")
        time.sleep(0.3)
        assert np.allclose(VIEW_SCALE * session.handle.translation, mine), "the first one's"
        gizmo(attacker, "End")
        wait_until(lambda: not page.dragging, "the end of the drag")
        gizmo(other, "Start")
        gizmo(other, "Update", wxyz.tolist(), position.tolist())
        wait_until(
            lambda: np.allclose(VIEW_SCALE * session.handle.translation, position), "the next hand"
        )
        wait_until(lambda: "You" in told(second), "who has it now")
        gizmo(other, "End")
    wait_until(lambda: len(page.server.get_clients()) == 1, "the other to leave")
    wait_until(lambda: told(first) == "", "nobody else to tell of")
