"""The arms by name."""

from __future__ import annotations

from collections.abc import Callable

from robots import point, psm, urdf
from robots.arm import Arm

_ARMS: dict[str, Callable[[], Arm]] = {
    "psm": psm.load,
    "point": point.load,
    "panda": urdf.load_panda,
    "ur5": urdf.load_ur5,
}


def names() -> tuple[str, ...]:
    """The names `load` knows."""
    return tuple(_ARMS)


def load(name: str) -> Arm:
    """A new arm: "psm", "point", "panda" or "ur5". Other names raise `ValueError`."""
    if name not in _ARMS:
        raise ValueError(f"unknown robot {name!r}; choose one of {', '.join(_ARMS)}")
    return _ARMS[name]()
