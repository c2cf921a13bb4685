"""Validation of messages from browsers. Pure functions."""

from __future__ import annotations

import functools
import inspect
import math
import typing
from typing import Any, Union, get_args, get_origin

import msgspec
from viser import _messages as wire

MAX_MESSAGE = 8 * 2**20  # a rendered picture can be that large [byte]
MAX_PLAIN = 64 * 2**10  # a message that carries no file or picture [byte]
MAX_TEXT = 4096  # characters in one string
MAX_ITEMS = 1000  # entries in one list
MAX_DEPTH = 4  # of nested lists

INBOUND = (
    "GuiUpdateMessage", "GuiButtonHoldMessage", "GuiFormSubmitMessage", "GuiFormDirtyMessage",
    "FileTransferStartUpload", "FileTransferPart", "CommandTriggerMessage",
    "LocalStorageGetItemResponseMessage", "ViewerCameraMessage", "GetRenderResponseMessage",
    "ScenePointerMessage", "SceneNodeClickMessage", "SceneNodeDragMessage",
    "TransformControlsUpdateMessage", "TransformControlsDragStartMessage",
    "TransformControlsDragEndMessage",
)  # fmt: skip
LARGE = ("FileTransferPart", "GetRenderResponseMessage")


def problem_with(raw: bytes | str) -> str | None:
    """Why a message is invalid; None: viser can decode it."""
    if not isinstance(raw, bytes):
        return "a message in text"
    try:
        fields = msgspec.msgpack.decode(raw)
    except (msgspec.MsgspecError, RecursionError, ValueError):
        return "a message that is no msgpack"
    kind = fields.pop("type", None) if isinstance(fields, dict) else None
    if not isinstance(kind, str) or kind not in INBOUND:
        return "a message of an unknown kind"
    if len(raw) > MAX_PLAIN and kind not in LARGE:
        return f"a {kind} that is too large"
    hints, required = _shape(kind)
    if not required <= fields.keys() <= hints.keys():
        return f"a {kind} with other fields"
    for name, value in fields.items():
        if not _matches(value, hints[name]):
            return f"a {kind} with an impossible {name}"
    # viser would set any attribute of a control that the message names.
    if kind == "GuiUpdateMessage" and fields["updates"].keys() != {"value"}:
        return "an update of something else than a value"
    return None


@functools.cache
def _shape(kind: str) -> tuple[dict[str, Any], set[str]]:
    """Fields of a message with their types, and the required ones."""
    message = getattr(wire, kind)
    parameters = inspect.signature(message).parameters.values()
    hints = typing.get_type_hints(message)
    return (
        {p.name: hints[p.name] for p in parameters},
        {p.name for p in parameters if p.default is inspect.Parameter.empty},
    )


def _matches(value: Any, hint: Any) -> bool:
    """Whether a decoded value has a field's type, finite numbers and a bounded size."""
    origin, choices = get_origin(hint), get_args(hint)
    if origin is Union:
        return any(_matches(value, choice) for choice in choices)
    if origin is typing.Literal:
        return any(type(value) is type(choice) and value == choice for choice in choices)
    if origin is tuple:
        if not isinstance(value, list) or len(value) > MAX_ITEMS:
            return False
        if choices[-1] is Ellipsis:
            choices = choices[:1] * len(value)
        return len(value) == len(choices) and all(map(_matches, value, choices))
    if origin is dict:
        return isinstance(value, dict) and _is_plain(value, MAX_DEPTH)
    if hint in (int, float):
        # JavaScript does not distinguish integers from floats.
        return type(value) in (int, float) and math.isfinite(value)
    if hint is str:
        return isinstance(value, str) and len(value) <= MAX_TEXT
    return hint in (bytes, type(None)) and isinstance(value, hint)


def _is_plain(value: Any, depth: int) -> bool:
    """Whether a value is one that a control can have: plain, finite, of bounded size."""
    if isinstance(value, list | dict):
        if depth == 0 or len(value) > MAX_ITEMS:
            return False
        parts = [*value, *value.values()] if isinstance(value, dict) else value
        return all(_is_plain(part, depth - 1) for part in parts)
    if isinstance(value, str):
        return len(value) <= MAX_TEXT
    return value is None or (type(value) in (bool, int, float) and math.isfinite(value))
