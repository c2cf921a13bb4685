"""What parts of the page are built on, without a server and a browser."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from app.view import camera


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
