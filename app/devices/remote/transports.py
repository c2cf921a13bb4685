"""Opens what carries messages to a device, by the kind of its address."""

from __future__ import annotations

from app.devices.remote.messages import Transport
from app.devices.sockets.endpoint import Endpoint
from app.kinds.links import Address


def open(address: Address) -> Transport:
    """The transport of an address on the network.

    Raises:
        OptionError: it cannot be opened, with the reason.
    """
    return Endpoint(address)
