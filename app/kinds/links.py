"""Times, shares, and the addresses of devices."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, ClassVar
from urllib.parse import parse_qsl, urlsplit

from app.kinds.base import Kind, exact, shown
from app.kinds.number import Number
from app.words import OptionError

_TIME = re.compile(r"\s*([-+0-9.eE]+)\s*(ms|s|µs|us)\s*")
_FACTOR = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
SCHEMES = {
    "arm": ("sim", "socket", "ros", "python"),
    "master": ("page", "sim", "socket", "ros", "igtl", "python"),
    "stream": ("socket",),
}
"""By role: the kinds of devices there are."""
NETWORKED = ("socket", "ros", "python")
PLAIN = ("sim", "page")
_SHAPES = {
    "socket": "socket://HOST:PORT",
    "ros": "ros:/NAMESPACE",
    "igtl": "igtl://HOST:PORT",
    "python": "python:FILE:CLASS",
}


def parse_time(text: str) -> float:
    """A time [s] from a text such as ``80ms``.

    Raises:
        OptionError: not a time with its unit.
    """
    found = _TIME.fullmatch(text)
    try:
        if found is None:
            raise ValueError
        return float(found[1]) * _FACTOR[found[2]]
    except ValueError:
        raise OptionError(f"{shown(text)} is not a time with its unit, such as 80ms") from None


def parse_share(text: str) -> float:
    """A share from 0 to 1 from a text such as ``2%`` or ``0.02``.

    Raises:
        OptionError: not a number.
    """
    number, percent = text.strip().removesuffix("%"), text.strip().endswith("%")
    try:
        return float(number) * (0.01 if percent else 1.0)
    except ValueError:
        raise OptionError(f"{shown(text)} is not a share, such as 2%") from None


@dataclass(frozen=True)
class Time(Number):
    """A time [s]."""

    unit: str = "s"

    metavar, wanted = "TIME", 'a text such as "80ms"'
    json: ClassVar[tuple[type, ...]] = (str,)

    def parse(self, text: str) -> float:
        return parse_time(text)

    def format(self, value: float) -> str:
        """In ms if that is exact, else in s with all digits."""
        return exact(value, lambda x: f"{x * 1e3:g}ms", parse_time, lambda x: f"{float(x)!r}s")


@dataclass(frozen=True)
class Share(Number):
    """A share from 0 to 1."""

    metavar, wanted = "SHARE", 'a text such as "2%"'
    json: ClassVar[tuple[type, ...]] = (str, int, float)

    def parse(self, text: str) -> float:
        return parse_share(text)

    def format(self, value: float) -> str:
        """In per cent if that is exact, else with all digits."""
        return exact(value, lambda x: f"{x * 100:g}%", parse_share, lambda x: repr(float(x)))


@dataclass(frozen=True)
class Link:
    """What a network does to the datagrams of one device, in each direction.

    Attributes:
        delay: of every datagram [s].
        jitter: standard deviation of what comes on top, half of a normal distribution [s].
        loss: share of the datagrams that never arrive.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0

    @property
    def clear(self) -> bool:
        """Whether it does nothing."""
        return not (self.delay or self.jitter or self.loss)

    @property
    def latest(self) -> float:
        """How late a datagram may be [s]; one in 10,000 is later."""
        return self.delay + 4.0 * self.jitter


@dataclass(frozen=True)
class Address:
    """Where a device is: what follows ``--arm`` and ``--master``, in parts.

    Attributes:
        scheme: kind of the device.
        host, port: for one on the network; port 0 takes a free one to listen on.
        path: what follows them.
        listen: whether the device sends to this port of ours; else we send to it.
        frame: name of the base frame its poses must be in; empty: any, but always the same.
        age: how old its newest value may be, from its arrival [s].
        link: disturbances on purpose.
    """

    scheme: str
    host: str = ""
    port: int = 0
    path: str = ""
    listen: bool = True
    frame: str = ""
    age: float = 0.05
    link: Link = Link()

    @property
    def networked(self) -> bool:
        """Whether it is on the network, and so may be a real device."""
        return self.scheme in NETWORKED


def parse_address(role: str, text: str, link: Link | None = None) -> Address:
    """The address of a device.

    Args:
        role: one of `SCHEMES`.
        link: used where the text has none of delay, jitter and loss.

    Raises:
        OptionError: an unknown kind of device, or a part that is not valid.
    """
    known = SCHEMES[role]
    if text in known and text in PLAIN:
        return Address(text, link=link or Link())
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError as error:
        raise OptionError(f"{role} {shown(text)}: {error}") from None
    if parts.scheme not in known or parts.scheme in PLAIN:
        raise OptionError(
            f"{role} {shown(text)} is no device: choose one of "
            + ", ".join(_SHAPES.get(one, one) for one in known)
        )
    complete = {
        "socket": bool(parts.hostname) and port is not None,
        "igtl": bool(parts.hostname) and port is not None,
        "ros": re.fullmatch(r"(/[A-Za-z_]\w*)+", parts.path) is not None and not parts.netloc,
        "python": re.fullmatch(r".+:[A-Za-z_]\w*", parts.path) is not None,
    }
    if not complete[parts.scheme]:
        raise OptionError(f"{role} {shown(text)}: write {_SHAPES[parts.scheme]}")
    values: dict[str, Any] = {}
    for key, value in parse_qsl(parts.query, keep_blank_values=True):
        values[key] = _read(role, key, value)
    given = {key: values.pop(key) for key in ("delay", "jitter", "loss") if key in values}
    fallback = link or Link()
    return Address(
        parts.scheme,
        parts.hostname or "",
        port or 0,
        parts.path if parts.scheme == "python" else parts.path.strip("/"),
        listen=values.pop("listen", role == "arm"),
        link=Link(**{"delay": fallback.delay, "jitter": fallback.jitter, "loss": fallback.loss}
                  | given),
        **values,
    )  # fmt: skip


def _read(role: str, key: str, value: str) -> Any:
    """A part after the question mark."""
    if key in ("delay", "jitter", "age"):
        number = parse_time(value)
        if not 0.0 <= number <= 10.0:
            raise OptionError(f"{role}: {key} {shown(value)} is outside 0 to 10 s")
        return number
    if key == "loss":
        share = parse_share(value)
        if not 0.0 <= share <= 1.0:
            raise OptionError(f"{role}: loss {shown(value)} is outside 0 to 100%")
        return share
    if key == "listen":
        if value not in ("", "0", "1"):
            raise OptionError(f"{role}: listen is 0 or 1, not {shown(value)}")
        return value != "0"
    if key == "frame":
        return value
    raise OptionError(
        f"{role}: unknown part {shown(key)}: choose from listen, frame, age, delay, jitter, loss"
    )


@dataclass(frozen=True)
class Device(Kind):
    """The address of a device; `role` is one of `SCHEMES`."""

    role: str

    metavar, wanted = "URL", 'a text such as "socket://127.0.0.1:48051"'

    def check(self, name: str, value: Any) -> None:
        if not isinstance(value, str) or not 0 < len(value) <= 1000:
            raise OptionError(f"{name} must be the address of a device, not {shown(value)}")
        address = parse_address(self.role, value)
        if self.role == "stream" and (address.path or "?" in value):
            raise OptionError(f"{name} {shown(value)}: write {_SHAPES['socket']}")
