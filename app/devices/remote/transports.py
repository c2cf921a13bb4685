"""Opens what carries messages to a device, by the kind of its address."""

from __future__ import annotations

import runpy

from app.devices.remote.messages import Transport
from app.devices.sockets.endpoint import Endpoint
from app.kinds.links import Address
from app.words import OptionError


def open(address: Address, role: str) -> Transport:
    """The transport of an address; `role`: "arm" or "master".

    Raises:
        OptionError: it cannot be opened, with the reason.
    """
    if address.scheme == "ros":
        from app.devices.ros.node import Topics

        return Topics(address, role)
    if address.scheme == "python":
        return _of_file(address.path)
    return Endpoint(address)


def _of_file(place: str) -> Transport:
    """An object of the class in a Python file: ``my_robot.py:MyRobot``."""
    path, _, name = place.rpartition(":")
    try:
        found = runpy.run_path(path)
    except Exception as error:
        raise OptionError(f"{path} cannot be run: {type(error).__name__}: {error}") from None
    if name not in found:
        raise OptionError(f"{path} has no class {name}")
    made = found[name]()
    for needed in ("receive", "send", "close", "peer", "refused"):
        if not hasattr(made, needed):
            raise OptionError(f"{name} of {path} has no '{needed}', see docs/devices.md")
    return made
