"""3D Slicer's side of a session, by a stand-in in a process of its own; and the wire."""

from __future__ import annotations

import json
import socket
import struct
from typing import Any

import numpy as np
import pytest

from app.devices.igtl import wire
from app.session import Session
from app.settings import Options, Structure
from app.words import OptionError
from tests.support.counterparts import Counterpart, counterpart
from tests.support.headless import wait_until


def test_the_crc_is_that_of_ecma_182() -> None:
    assert wire.crc64(b"") == 0
    assert wire.crc64(b"123456789") == 0x6C40DF5F0B497347


def test_a_stream_is_split_into_its_messages_however_it_arrives() -> None:
    T = np.eye(4)
    T[:3, 3] = 0.1, -0.2, 0.3
    stream = wire.transform("Tool", T) + wire.string("state", "ENABLED") + wire.transform("x", T)
    for step in (1, 7, 58, 1000):
        found, buffer = [], b""
        for k in range(0, len(stream), step):
            buffer += stream[k : k + step]
            while True:
                message, buffer = wire.split(buffer)
                if message is None:
                    break
                found.append(message)
        assert [(m.kind, m.name) for m in found] == [
            ("TRANSFORM", "Tool"), ("STRING", "state"), ("TRANSFORM", "x"),
        ]  # fmt: skip
        np.testing.assert_allclose(found[0].transform, T, atol=1e-7)
        assert found[1].text == "ENABLED"


def header(version: int = 1, size: int = 0, crc: int = 0) -> bytes:
    return struct.pack(">H12s20sQQQ", version, b"TRANSFORM", b"x", 0, size, crc)


@pytest.mark.parametrize(
    ("data", "reason"),
    [(header(version=9), "version 9"), (header(size=1 << 40), "at most"),
     (header(size=4, crc=1) + b"1234", "CRC"), (b"GET / HTTP/1.1\r\n" + b"x" * 60, "version"),
     (header(2, 4, wire.crc64(b"1234")) + b"1234", "extended header"),
     (header(2, 12, wire.crc64(b"\xff" * 12)) + b"\xff" * 12, "longer than the body")],
)  # fmt: skip
def test_what_is_none_is_unreadable(data: bytes, reason: str) -> None:
    with pytest.raises(wire.Unreadable, match=reason):
        wire.split(data)


def free_tcp_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def asked(slicer: Counterpart) -> Any:
    slicer.tell("tool")
    assert slicer.process.stdout is not None
    return json.loads(slicer.process.stdout.readline())


def started(session: Session) -> Any:
    """The first step of a session: what joins a session may be faster than its first tick."""
    wait_until(lambda: session.latest().step is not None)
    return session.latest().step


def options(port: int, **more: Any) -> Options:
    return Options(mesh="cube", robot="psm", master=f"igtl://127.0.0.1:{port}", **more)


def test_slicer_sees_structures_and_tool_moves_it_and_places_the_mesh() -> None:
    port = free_tcp_port()
    with Session(options(port, structures=(Structure("sphere", name="vessel"),))) as session:
        with counterpart("slicer", port) as first:
            first.tell("wait", "POLYDATA", "2")
            newest, state, models, _ = asked(first)
            assert state == "ENABLED"
            tip = started(session).tip
            np.testing.assert_allclose(newest["Tool"][9:], 1e3 * tip.translation, atol=1e-3)
            np.testing.assert_allclose(newest["Tool"][:9], tip.rotation.T.ravel(), atol=1e-6)
            assert [name for name, *_ in models] == ["cube", "vessel"]
            for (_, _, cells, low, high), surface in zip(
                models, session.scene.surfaces, strict=True
            ):
                assert cells == len(surface.faces)
                np.testing.assert_allclose(low, 1e3 * surface.vertices.min(axis=0), atol=1e-3)
                np.testing.assert_allclose(high, 1e3 * surface.vertices.max(axis=0), atol=1e-3)
            # One that comes later gets them too.
            with counterpart("slicer", port) as late:
                late.tell("wait", "POLYDATA", "2")
                assert len(asked(late)[2]) == 2
                late.quit()
            first.tell("proxy", "4", "-2", "1")
            goal = tip.translation + np.array([4e-3, -2e-3, 1e-3])
            wait_until(lambda: np.allclose(session.latest().step.tip.translation, goal, atol=1e-5))
            first.tell("register", "5", "-4", "-170", "30")
            wait_until(lambda: session.scene.version == 2)
            T = session.scene.T_base_mesh
            np.testing.assert_allclose(T[:3, 3], [0.005, -0.004, -0.17], atol=1e-6)
            np.testing.assert_allclose(T[:2, 0], [np.sqrt(0.75), 0.5], atol=1e-6)
            first.tell("wait", "POLYDATA", "4")
            moved = asked(first)[2][2]
            low = 1e3 * session.scene.surface.vertices.min(axis=0)
            np.testing.assert_allclose(moved[3], low, atol=1e-3)
            first.quit()
        assert session.crossing is None


def test_slicer_pushes_the_tool_into_the_anatomy_in_vain() -> None:
    port = free_tcp_port()
    with Session(options(port)) as session, counterpart("slicer", port) as slicer:
        start = started(session).tip.translation
        slicer.tell("proxy", "0", "0", "-60")
        wait_until(lambda: np.linalg.norm(session.latest().step.force) > 1.0)
        assert session.latest().step.tip.translation[2] < start[2] - 1e-3
        assert session.crossing is None
        slicer.quit()


def test_what_is_no_pose_moves_nothing_and_what_is_no_message_ends_the_connection() -> None:
    port = free_tcp_port()
    with Session(options(port)) as session, counterpart("slicer", port) as slicer:
        slicer.tell("wait", "POLYDATA", "1")
        server = session._server
        tip = started(session).tip
        far = np.eye(4)
        far[:3, 3] = 0.3
        scaled, nan = 2.0 * np.eye(4), np.full((4, 4), np.nan)
        for T, words in ((far, "must be at the tool"), (scaled, "not a rotation"),
                         (nan, "not finite")):  # fmt: skip
            slicer.tell("raw", wire.transform("Proxy", T).hex())
            wait_until(lambda words=words: words in server.refused)
        slicer.tell("raw", wire.string("state_command", "enable").hex())
        wait_until(lambda: "always enabled" in server.refused)
        assert session.latest().step.tip.isApprox(tip, 1e-12)
        slicer.tell("raw", (b"GET / HTTP/1.1\r\n" + b"x" * 60).hex())
        wait_until(lambda: not server._clients)
        with counterpart("slicer", port) as another:
            another.tell("wait", "POLYDATA", "1")
            another.quit()


def test_a_port_that_is_taken_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(OptionError, match=f"{port}: cannot listen"), Session(options(port)):
            pass
