"""The dialect of the socket streamer, links that lose and delay, addresses, operating states."""

from __future__ import annotations

import json
import math
import socket
import time

import numpy as np
import pytest

from app.devices.crtk.state import COMMANDS, Machine, State
from app.devices.remote.line import Line
from app.devices.remote.messages import Message
from app.devices.sockets.dialect import LARGEST_SENT, Unreadable, decode, encode
from app.devices.sockets.endpoint import Endpoint
from app.kinds.links import Address, Link, parse_address
from app.words import OptionError
from tests.support.headless import wait_until


def test_feedback_of_the_streamer_is_read() -> None:
    told = decode(
        b'{"measured_js":{"AutomaticTimestamp":false,"Effort":null,"Name":["a","b"],'
        b'"Position":[0.25,-1],"Timestamp":19.5,"Valid":true,"Velocity":[0,0]},'
        b'"jaw/measured_js":{"Position":[4.67e-310],"Timestamp":19.5,"Valid":false},'
        b'"setpoint_cp":{"MovingFrame":"PSM1","Position":{"Rotation":[[1,0,0],[0,1,0],[0,0,1]],'
        b'"Translation":[0.1,0.2,-0.3]},"ReferenceFrame":"PSM1_base","Timestamp":19.4,"Valid":true},'
        b'"operating_state":{"State":2,"SubState":"","IsHomed":true,"IsBusy":false}}\n',
        at=7.0,
    )
    js, jaw, cp, state = told
    assert (js.name, js.numbers, js.stamp, js.valid, js.at) == (
        "measured_js", [0.25, -1], 19.5, True, 7.0,
    )  # fmt: skip
    assert not jaw.valid
    assert (cp.frame, cp.translation, cp.stamp) == ("PSM1_base", [0.1, 0.2, -0.3], 19.4)
    assert (state.text, state.homed, state.busy) == ("ENABLED", True, False)


def test_commands_to_the_streamer_are_read() -> None:
    (jp,) = decode(b'{"servo_jp": {"Goal": [0.1, 0.0, 0.12, 0.0, 0.0, 0.0] } }', 0.0)
    assert (jp.name, jp.numbers, jp.stamp) == ("servo_jp", [0.1, 0.0, 0.12, 0.0, 0.0, 0.0], None)
    (hold,) = decode(b'{"hold": ""}', 0.0)
    assert (hold.name, hold.text) == ("hold", "")
    for data in (b'{"state_command": "enable"}', b'{"state_command": {"Data": "enable"}}'):
        assert decode(data, 0.0)[0].text == "enable"
    (press,) = decode(b'{"clutch": {"Type": 0}}', 0.0)
    (lift,) = decode(b'{"clutch": {"Type": "RELEASED"}}', 0.0)
    assert (press.pressed, lift.pressed, lift.text) == (True, False, "released")


@pytest.mark.parametrize(
    "data",
    [b"", b"\xff\xfe", b"{", b"[1, 2]", b"3", b'"servo_jp"', b"[" * 4000, b"null",
     json.dumps({f"n{k}": 1 for k in range(33)}).encode()],
)  # fmt: skip
def test_other_datagrams_are_unreadable(data: bytes) -> None:
    with pytest.raises(Unreadable):
        decode(data, 0.0)


@pytest.mark.parametrize(
    "data",
    [b'{"measured_js": null}', b'{"measured_js": [1, 2]}', b'{"measured_js": {"Timestamp": "x"}}',
     b'{"measured_js": {"Position": {"Rotation": 3}}}', b'{"operating_state": {"State": 77}}',
     b'{"operating_state": {"State": -1}}', b'{"measured_js": {"Timestamp": 1e999}}',
     b'{"measured_js": {"Timestamp": ' + b"9" * 400 + b"}}", b'{"warning": {"Message": 3}}'],
)  # fmt: skip
def test_strange_values_are_messages_without_them(data: bytes) -> None:
    (message,) = decode(data, 0.0)
    assert message.numbers is None or message.name == "measured_js"


def test_what_is_written_is_what_the_streamer_reads_and_writes() -> None:
    goal = json.loads(encode(Message("servo_jp", numbers=[0.1, 0.2])))
    assert goal == {"servo_jp": {"Goal": [0.1, 0.2]}}
    assert json.loads(encode(Message("state_command", text="enable"))) == {
        "state_command": "enable"
    }
    R = np.eye(3).tolist()
    cp = json.loads(encode(Message("servo_cp", rotation=R, translation=[0.0, 0.0, 1.0])))
    assert cp == {"servo_cp": {"Goal": {"Rotation": R, "Translation": [0.0, 0.0, 1.0]}}}
    told = json.loads(encode(Message("measured_js", numbers=[1.0], stamp=2.0)))["measured_js"]
    assert (told["Position"], told["Timestamp"], told["Valid"]) == ([1.0], 2.0, True)
    force = json.loads(encode(Message("body/servo_cf", numbers=[1.0] * 6)))
    assert force == {"body/servo_cf": {"Force": [1.0] * 6}}


def test_what_the_streamer_could_not_read_is_not_written() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        encode(Message("servo_jp", numbers=[math.nan]))
    with pytest.raises(ValueError, match="the streamer reads"):
        encode(Message("status", text="x" * LARGEST_SENT))


def test_a_line_delays_loses_and_reorders() -> None:
    line: Line[int] = Line(Link(delay=0.08, jitter=0.01, loss=0.1), seed=1)
    for k in range(2000):
        line.put(k, 1e-3 * k)
    assert line.take(0.079) == []
    arrived = line.take(10.0)
    numbers = [k for k, _ in arrived]
    late = np.array([at - 1e-3 * k for k, at in arrived])
    assert len(arrived) == 2000 - line.lost
    assert 140 < line.lost < 260
    assert late.min() >= 0.08
    # The mean of half a normal distribution is √(2/π) of its deviation.
    assert late.mean() == pytest.approx(0.08 + 0.01 * math.sqrt(2 / math.pi), abs=1e-3)
    assert numbers != sorted(numbers)
    assert [at for _, at in arrived] == sorted(at for _, at in arrived)


def test_addresses_are_read_or_refused_with_the_reason() -> None:
    found = parse_address("arm", "socket://10.0.0.2:48051?frame=PSM1_base&age=20ms&loss=2%")
    assert found == Address(
        "socket", "10.0.0.2", 48051, listen=True, frame="PSM1_base", age=0.02, link=Link(loss=0.02)
    )
    console = parse_address("master", "socket://localhost:9", Link(delay=0.08))
    assert (console.listen, console.link.delay) == (False, 0.08)
    assert parse_address("master", "socket://localhost:9?listen").listen
    assert parse_address("arm", "sim").networked is False
    assert parse_address("arm", "ros:/cart/PSM1").path == "cart/PSM1"
    assert parse_address("arm", "python:/a/robot.py:Mine?age=1s").path == "/a/robot.py:Mine"
    for role, text, words in (
        ("arm", "serial://x:1", "choose one of sim, socket://HOST:PORT, ros:/NAMESPACE"),
        ("arm", "page", "choose one of"),
        ("arm", "ros:/", "write ros:/NAMESPACE"),
        ("arm", "ros://host/PSM1", "write ros:/NAMESPACE"),
        ("arm", "python:robot.py", "write python:FILE:CLASS"),
        ("arm", "socket://host", "write socket://HOST:PORT"),
        ("arm", "socket://host:70000", "Port out of range"),
        ("arm", "socket://h:1?speed=3", "unknown part 'speed'"),
        ("arm", "socket://h:1?age=3", "not a time with its unit"),
        ("master", "socket://h:1?loss=120%", "outside 0 to 100%"),
    ):
        with pytest.raises(OptionError, match=words):
            parse_address(role, text)


def test_the_operating_state_follows_its_commands_and_refuses_the_rest() -> None:
    allowed = {
        (State.DISABLED, "enable"): State.ENABLED,
        (State.ENABLED, "enable"): State.ENABLED,
        (State.ENABLED, "pause"): State.PAUSED,
        (State.PAUSED, "pause"): State.PAUSED,
        (State.PAUSED, "resume"): State.ENABLED,
        (State.ENABLED, "home"): State.ENABLED,
        (State.ENABLED, "unhome"): State.ENABLED,
    } | {(state, "disable"): State.DISABLED for state in State}
    for state in State:
        for word in COMMANDS:
            one = Machine()
            one.state = state
            refusal = one.command(word)
            assert (refusal == "") == ((state, word) in allowed), (state, word)
            assert one.state is allowed.get((state, word), state)
            assert (one.refuses() == "") == (one.state is State.ENABLED and one.homed)
    fresh = Machine()
    assert fresh.state is State.DISABLED
    assert "choose one of enable, disable" in fresh.command("fly")
    fresh.fail("it broke")
    assert "it broke" in fresh.command("enable")


@pytest.fixture
def listening() -> Endpoint:
    return Endpoint(Address("socket", "127.0.0.1", 0))


def test_a_port_hears_its_first_sender_and_answers_it(listening: Endpoint) -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        listening.send(Message("hold"), time.monotonic())  # nobody is there yet
        here = ("127.0.0.1", listening.port)
        one.settimeout(5.0)
        before = time.monotonic()
        one.sendto(b'{"hold": ""}', here)
        heard: list[Message] = []
        wait_until(lambda: heard.extend(listening.receive(time.monotonic())) or heard)
        assert [m.name for m in heard] == ["hold"]
        assert before - 1e-3 <= heard[0].at <= time.monotonic()
        other.sendto(b'{"free": ""}', here)
        wait_until(lambda: listening.receive(time.monotonic()) or listening.refused)
        assert listening.refused == {"from a stranger": 1}
        listening.send(Message("servo_jp", numbers=[1.0]), time.monotonic())
        assert json.loads(one.recv(2000)) == {"servo_jp": {"Goal": [1.0]}}
        # After a silence another one is heard.
        later = time.monotonic() + 1.5
        other.sendto(b'{"free": ""}', here)
        heard.clear()
        wait_until(lambda: heard.extend(listening.receive(later)) or heard)
        assert heard[0].name == "free"
    listening.close()


def test_what_cannot_be_read_is_counted_and_raises_nothing(listening: Endpoint) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        for data in (b"\xff", b"[]", b"{" + b" " * 9000 + b"}", b'{"a": 1}'):
            one.sendto(data, ("127.0.0.1", listening.port))
        heard: list[Message] = []
        wait_until(lambda: heard.extend(listening.receive(time.monotonic())) or heard)
    assert listening.refused == {
        "not JSON": 1, "not a JSON object": 1, "longer than 8192 byte": 1,
    }  # fmt: skip
    listening.send(Message("servo_jp", numbers=[math.nan]), time.monotonic())
    assert sum(listening.refused.values()) == 4
    listening.close()


def test_a_flood_is_read_in_portions(listening: Endpoint) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        for _ in range(200):
            one.sendto(b'{"a": 1}', ("127.0.0.1", listening.port))
    wait_until(lambda: True)
    counts = [len(listening.receive(time.monotonic())) for _ in range(5)]
    assert counts[0] == 64
    assert max(counts) == 64
    listening.close()


def test_a_taken_port_and_an_unknown_host_are_named(listening: Endpoint) -> None:
    with pytest.raises(OptionError, match=f"127.0.0.1:{listening.port}: cannot listen there"):
        Endpoint(Address("socket", "127.0.0.1", listening.port))
    with pytest.raises(OptionError, match="unknown host"):
        Endpoint(Address("socket", "no.such.host.invalid", 1))
    listening.close()


def test_nobody_at_the_other_end_is_no_error() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    end = Endpoint(Address("socket", "127.0.0.1", port, listen=False))
    for _ in range(20):
        end.send(Message("hold"), time.monotonic())
        assert end.receive(time.monotonic()) == []
    end.close()
