"""The dialect of the dVRK's socket streamer (sawSocketStreamer): messages as JSON, and back.

A datagram is an object of CRTK names, each with the value of a cisst type. Feedback (`measured_js`,
`setpoint_cp`, …) has ``Position`` and so on, commands (`servo_jp`, …) have ``Goal``. Numbers that
are not valid may be null, denormal, ``NaN`` or ``1e+9999``; such a message says ``Valid: false``.
Enumerations come as words or, from older versions, as numbers.
"""

from __future__ import annotations

import json
from typing import Any

import msgspec

from app.devices.remote.messages import Message

LARGEST = 8192  # of a datagram that is read [byte]
LARGEST_SENT = 1000  # the streamer reads no more than 1024 of a datagram [byte]
MOST_NAMES = 32  # of a datagram
_STATES = ("UNDEFINED", "DISABLED", "ENABLED", "PAUSED", "FAULT")
_read = msgspec.json.Decoder().decode
_write = msgspec.json.Encoder().encode
_write_finite = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode
_COMMANDS = ("servo_", "move_", "interpolate_")


class Unreadable(ValueError):
    """A datagram that is not of the dialect; the message says why."""


def decode(data: bytes, at: float) -> list[Message]:
    """The messages of a datagram that arrived at this time.

    Raises:
        Unreadable: it is not of the dialect.
    """
    try:
        content = _read(data)
    except (msgspec.MsgspecError, RecursionError):
        # It is several times as fast, and knows neither NaN nor numbers beyond the doubles.
        try:
            content = json.loads(data)
        except (ValueError, RecursionError):
            raise Unreadable("not JSON") from None
    if not isinstance(content, dict):
        raise Unreadable("not a JSON object")
    if len(content) > MOST_NAMES:
        raise Unreadable(f"more than {MOST_NAMES} names")
    return [_message(name, value, at) for name, value in content.items()]


def _message(name: str, value: Any, at: float) -> Message:
    message = Message(name, at=at)
    if isinstance(value, str):
        message.text = value
        return message
    if not isinstance(value, dict):
        return message
    stamp, valid, frame = value.get("Timestamp"), value.get("Valid", True), ""
    if isinstance(stamp, (int, float)) and not isinstance(stamp, bool):
        message.stamp = _number(stamp)
    message.valid = valid is True
    frame = value.get("ReferenceFrame", "")
    message.frame = frame if isinstance(frame, str) else "?"
    main = value.get("Goal", value.get("Position", value.get("Force")))
    if isinstance(main, dict):
        message.rotation, message.translation = main.get("Rotation"), main.get("Translation")
    else:
        message.numbers = main
        message.velocity = value.get("Velocity")
    if "State" in value:
        state = value["State"]
        if isinstance(state, int) and 0 <= state < len(_STATES):
            state = _STATES[state]
        message.text = state if isinstance(state, str) else ""
        message.homed, message.busy = value.get("IsHomed") is True, value.get("IsBusy") is True
    elif "Type" in value and "Message" not in value:
        message.pressed = value["Type"] in ("PRESSED", 0)
        message.text = "released" if value["Type"] in ("RELEASED", 1) else ""
    else:
        text = value.get("Data", value.get("Message", ""))
        message.text = text if isinstance(text, str) else ""
    return message


def _number(value: int | float) -> float:
    try:
        return float(value)
    except OverflowError:  # a whole number of more than 308 digits
        return float("inf")


def encode(message: Message) -> bytes:
    """The datagram of one message, as the streamer writes and reads it.

    Raises:
        ValueError: a number that is not finite, or a datagram that the streamer could not read.
    """
    name = message.name
    base = name.rpartition("/")[2]
    value: Any
    numbers: Any
    stamp = {"Timestamp": message.stamp or 0.0, "Valid": message.valid, "AutomaticTimestamp": False}
    pose = {"Rotation": message.rotation, "Translation": message.translation}
    if base.startswith(_COMMANDS):
        if base.endswith("f"):
            value = {"Force": message.numbers}
        else:
            value = {"Goal": message.numbers if message.rotation is None else pose}
    elif base.endswith("_js"):
        value = {
            "Name": [], "Position": message.numbers, "Velocity": message.velocity or [],
            "Effort": [], **stamp,
        }  # fmt: skip
    elif base.endswith("_cp"):
        frames = {"ReferenceFrame": message.frame, "MovingFrame": message.text}
        value = {"Position": pose, **frames, **stamp}
    elif base.endswith("_cv"):
        numbers = message.numbers
        value = {"VelocityLinear": numbers[:3], "VelocityAngular": numbers[3:], **stamp}
    elif base == "operating_state":
        value = {
            "State": message.text, "SubState": "", "IsHomed": message.homed,
            "IsBusy": message.busy, **stamp,
        }  # fmt: skip
    elif base in ("error", "warning", "status"):
        value = {"Type": base.upper(), "Message": message.text, **stamp}
    elif base == "period_statistics":
        numbers = message.numbers
        value = dict(zip(("Average", "StdDev", "Min", "Max"), numbers, strict=True)) | stamp
    else:  # hold, free, state_command
        value = message.text
    data = _write({name: value})
    if b"null" in data:  # a number that is not finite, or a word
        data = _write_finite({name: value}).encode()
    if len(data) > LARGEST_SENT:
        raise ValueError(f"{name} takes {len(data)} byte, the streamer reads {LARGEST_SENT}")
    return data
