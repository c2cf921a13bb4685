"""Hostile messages and connections are dropped or closed; the control loop runs on."""

from __future__ import annotations

import math
import socket
import struct
import time
from collections.abc import Callable
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import viser
from viser import _viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection

from app.session import Session
from app.view import Page, guard
from app.view.guard import connection, token_bucket
from app.view.guard.messages import MAX_MESSAGE, problem_with
from app.view.guard.patches import SHARE
from tests.support.clients import joined
from tests.support.headless import wait_until

CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": (1, 0, 0, 0), "position": (1, 1, 1), "fov": 1.0,
    "near": 0.1, "far": 10.0, "look_at": (0, 0, 0), "up_direction": (0, 0, 1),
    "image_height": 100, "image_width": 100,
}  # fmt: skip


def packed(**fields: object) -> bytes:
    return msgspec.msgpack.encode(fields)


def cut_off(socket: ClientConnection, *messages: bytes | str) -> int:
    """Close code with which the server ends the connection during or after these messages."""
    try:
        for raw in messages:
            socket.send(raw)
        deadline = time.monotonic() + 10.0
        while time.monotonic() < deadline:
            socket.recv(timeout=10.0)
    except ConnectionClosed as closed:
        return 0 if closed.rcvd is None else closed.rcvd.code
    raise AssertionError("the connection was not closed")


def send_for_ever(send: Callable[[bytes], object], raw: bytes) -> None:
    for _ in range(100_000):
        send(raw)


def test_messages_open_no_tunnel(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[object] = []
    monkeypatch.setattr(_viser, "ViserTunnel", lambda *a: opened.append(a))
    with joined(page) as socket:
        for kind in SHARE:
            socket.send(packed(type=kind))
        socket.send(packed(**CAMERA))
        wait_until(lambda: page.server.get_clients())
    assert not opened
    assert page.server._share_tunnel is None
    with pytest.raises(guard.GuardError):
        page.server.request_share_url()
    assert not opened


def nested(depth: int) -> object:
    return [nested(depth - 1)] if depth else 1


GIZMO = {
    "type": "TransformControlsUpdateMessage", "name": "/proxy/gizmo", "owner": "",
    "wxyz": (1, 0, 0, 0), "position": (0, 0, 0),
}  # fmt: skip
UPDATE = {"type": "GuiUpdateMessage", "uuid": "x", "updates": {"value": 1}}
BAD = {
    "text": "hello",
    "empty": b"",
    "garbage": bytes(range(256)),
    "truncated": packed(**GIZMO)[:-3],
    "huge array announced": b"\xdd\xff\xff\xff\xff",
    "deep": b"\x91" * 10_000,
    "no mapping": msgspec.msgpack.encode([1, 2]),
    "no type": packed(name="x"),
    "type of another type": packed(type=["GuiUpdateMessage"]),
    "unknown type": packed(type="Message"),
    "for clients only": packed(type="RunJavascriptMessage", source="1"),
    "share": packed(type="ShareUrlRequest"),
    "missing field": packed(type="GuiUpdateMessage", uuid="x"),
    "additional field": packed(**UPDATE, excluded_self_client=1),
    "NaN": packed(**{**GIZMO, "position": (math.nan, 0, 0)}),
    "infinite": packed(**{**GIZMO, "wxyz": (math.inf, 0, 0, 0)}),
    "three of four": packed(**{**GIZMO, "wxyz": (1, 0, 0)}),
    "number as text": packed(**{**GIZMO, "position": ("1", 0, 0)}),
    "name without end": packed(**{**GIZMO, "name": "x" * 5000}),
    "name that is none": packed(**{**GIZMO, "name": 1}),
    "another attribute": packed(**{**UPDATE, "updates": {"update_cb": []}}),
    "NaN in a value": packed(**{**UPDATE, "updates": {"value": [math.nan]}}),
    "deep value": packed(**{**UPDATE, "updates": {"value": nested(20)}}),
    "long value": packed(**{**UPDATE, "updates": {"value": "x" * 5000}}),
    "unknown phase": packed(
        type="SceneNodeDragMessage", phase="?", name="x", instance_index=None,
        start_position=(0, 0, 0), start_screen_pos=(0, 0), end_position=(0, 0, 0),
        end_screen_pos=(0, 0), button="left", modifier=None,
    ),
    "bulky": packed(**{**UPDATE, "updates": {"value": ["x" * 1000] * 100}}),
}  # fmt: skip


@pytest.mark.parametrize("raw", BAD.values(), ids=BAD.keys())
def test_invalid_messages_are_recognized(raw: bytes | str) -> None:
    assert problem_with(raw)


@pytest.mark.parametrize(
    "fields",
    [
        CAMERA,
        GIZMO,
        UPDATE,
        {**UPDATE, "updates": {"value": [0.5, "a", None, True]}},
        {"type": "TransformControlsDragStartMessage", "name": "/proxy/gizmo", "owner": ""},
        {"type": "CommandTriggerMessage", "uuid": "x"},
        {"type": "ScenePointerMessage", "event_type": "click", "ray_origin": (0, 0, 0),
         "ray_direction": None, "screen_pos": ((0.5, 0.5),), "modifier": None},
        {"type": "FileTransferStartUpload", "source_component_uuid": "x", "transfer_uuid": "y",
         "filename": "a.stl", "mime_type": "", "part_count": 400, "size_bytes": 200_000_000},
        {"type": "FileTransferPart", "source_component_uuid": "x", "transfer_uuid": "y",
         "part_index": 399, "content": bytes(512 * 1024)},
        {"type": "GetRenderResponseMessage", "payload": bytes(3_000_000), "render_uuid": "x"},
    ],
    ids=lambda fields: str(fields["type"]),
)  # fmt: skip
def test_messages_of_browsers_are_valid(fields: dict[str, object]) -> None:
    assert problem_with(packed(**fields)) is None
    assert _viser._messages.Message.deserialize(packed(**fields))


def test_every_mutated_message_is_refused_or_decodable() -> None:
    rng = np.random.default_rng(0)
    good = [packed(**GIZMO), packed(**CAMERA), packed(**UPDATE)]
    passed = 0
    for k in range(3000):
        raw = bytearray(good[k % 3])
        for place in rng.integers(len(raw), size=rng.integers(1, 4)):
            raw[place] = rng.integers(256)
        if problem_with(bytes(raw)) is None:
            passed += 1
            _viser._messages.Message.deserialize(bytes(raw))
    assert 0 < passed < 3000


def test_a_few_bad_messages_are_dropped_and_many_end_the_connection(page: Page) -> None:
    with joined(page) as socket:
        for raw in list(BAD.values())[:15]:
            socket.send(raw)
        socket.send(packed(**CAMERA))
        wait_until(lambda: page.server.get_clients())
        assert cut_off(socket, *BAD.values()) == 1008
    wait_until(lambda: not page.server.get_clients())


def test_an_oversized_message_closes_the_connection(page: Page) -> None:
    with joined(page) as socket:
        assert cut_off(socket, bytes(MAX_MESSAGE + 1)) == 1009


def test_a_flood_is_dropped_then_cut_off(page: Page, session: Session) -> None:
    with joined(page) as socket:
        socket.send(packed(**CAMERA))
        wait_until(lambda: page.server.get_clients())
        tick = session.latest().tick
        with pytest.raises(ConnectionClosed):
            send_for_ever(socket.send, packed(**CAMERA))
        assert session.latest().tick > tick
    wait_until(lambda: not page.server.get_clients())
    with joined(page) as socket:
        assert socket.recv(timeout=10.0), "other clients are served"


def test_a_flood_of_pings_is_cut_off(page: Page) -> None:
    ping = b"\x89\x80\x00\x00\x00\x00"
    with joined(page) as client, pytest.raises((BrokenPipeError, ConnectionResetError)):
        send_for_ever(client.socket.sendall, ping * 1000)


def test_no_message_of_a_browser_s_drag_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten seconds of drag, camera and slider together, then a second of them in one burst."""
    clock = [0.0]
    monkeypatch.setattr(token_bucket, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    messages = token_bucket.TokenBucket(*connection.MESSAGES)
    for _ in range(1000):
        clock[0] += 0.01
        assert messages.take()
    assert all(messages.take() for _ in range(100))


def test_an_upload_is_slowed_and_not_cut_off(page: Page) -> None:
    part = {"type": "FileTransferPart", "source_component_uuid": "x", "transfer_uuid": "y"}
    with joined(page) as socket:
        for k in range(60):
            socket.send(packed(**part, part_index=k, content=bytes(512 * 1024)))
        socket.send(packed(**CAMERA))
        wait_until(lambda: page.server.get_clients())


def test_a_client_that_does_not_read_is_dropped(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "STALL_TIMEOUT", 0.5)
    raw = socket.create_connection(("127.0.0.1", page.port))
    with raw:
        raw.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
        )
        camera = packed(**CAMERA)
        raw.sendall(b"\x82\xfe" + struct.pack("!H", len(camera)) + bytes(4) + camera)
        wait_until(lambda: page.server.get_clients())
        ((client_id, _),) = page.server.get_clients().items()
        transport = page.server._websock_server._live_connections[client_id].transport
        points = np.random.default_rng(0).random((250_000, 3), dtype=np.float32)
        most = 0
        for _ in range(100):
            page.server.scene.add_point_cloud("/flood", points, (0, 0, 0), precision="float32")
            most = max(most, transport.get_write_buffer_size())
            time.sleep(0.02)
            if not page.server.get_clients():
                break
        wait_until(lambda: not page.server.get_clients())
        assert 0 < most < 10 * points.nbytes, "100 clouds were to be sent"
    page.server.scene.add_point_cloud("/flood", points[:1], (0, 0, 0)).remove()


def test_values_of_the_wrong_type_do_not_fill_the_log(
    page: Page, caplog: pytest.LogCaptureFixture
) -> None:
    controls = page.server.gui._gui_input_handle_from_uuid.values()
    control = next(c for c in controls if getattr(c, "label", None) == "Scale")
    with joined(page) as socket:
        for _ in range(100):
            socket.send(packed(**{**UPDATE, "uuid": control._impl.uuid, "updates": {"value": "x"}}))
        socket.send(packed(**CAMERA))
        wait_until(lambda: page.server.get_clients())
    wait_until(lambda: not page.server.get_clients())
    assert 1 <= sum("never retrieved" in record.message for record in caplog.records) <= 12


def test_clients_that_disconnect_leave_no_state(page: Page) -> None:
    for _ in range(5):
        client = joined(page)
        client.send(packed(**CAMERA))
        wait_until(lambda: page.server.get_clients())
        client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        client.socket.close()  # a TCP reset
        wait_until(lambda: not page.server.get_clients())
    server = page.server._websock_server
    wait_until(lambda: not server._live_connections and not server._client_state_from_id)
