"""A namespace of topics as the transport of one device."""

from __future__ import annotations

import contextlib
import importlib
import logging
import threading
import time
from collections import Counter, deque
from typing import Any

from app.devices.remote.line import Line
from app.devices.remote.messages import Message
from app.devices.ros.conversion import COMMANDS, FEEDBACK, HAND, kind_of, read, write
from app.kinds.links import Address
from app.words import OptionError

log = logging.getLogger(__name__)

FORCE = "body/servo_cf"
MOST = 4096  # messages that wait for the control thread
REPLACED = {
    "crtk_msgs/StringStamped": "std_msgs/String",
    "crtk_msgs/OperatingState": "std_msgs/String",
}
"""Where crtk_msgs is not installed: what carries its text instead."""


class Topics:
    """Messages over the topics of a namespace, with rclpy, which spins in a thread of its own.

    Attributes:
        refused: how many messages were not taken, by reason.
    """

    def __init__(self, address: Address, role: str) -> None:
        """Join the network.

        Args:
            role: "arm": the namespace is that of an arm, which is commanded. "master": of the
                guard as an arm, or with `address.listen` of a hand.

        Raises:
            OptionError: rclpy cannot be imported, with the reason.
        """
        self.refused: dict[str, int] = Counter()
        self._inbox: deque[Message] = deque(maxlen=MOST)
        self._types: dict[str, Any] = {}
        self._link = address.link
        self._inwards: Line[Message] = Line(address.link, 1)
        self._outwards: Line[Message] = Line(address.link, 2)
        rclpy = _imported("rclpy")
        self._context = rclpy.Context()
        self._context.init()
        self._node = rclpy.create_node(f"vf_guard_{role}", context=self._context)
        self._space = "/" + address.path.strip("/")
        hand = role == "master" and address.listen
        heard: tuple[str, ...] = FEEDBACK
        said: tuple[str, ...] = COMMANDS
        if hand:
            heard, said = HAND, (FORCE,)
        elif role == "master":
            heard, said = tuple(one for one in COMMANDS if one != FORCE), (*FEEDBACK, FORCE)
        for name in heard:
            self._node.create_subscription(
                self._type(name), f"{self._space}/{name}", self._hearing(name), 10
            )
        self._said = {
            name: self._node.create_publisher(self._type(name), f"{self._space}/{name}", 10)
            for name in said
        }
        self._executor = importlib.import_module("rclpy.executors").SingleThreadedExecutor(
            context=self._context
        )
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name="ros", daemon=True)
        self._thread.start()

    @property
    def peer(self) -> str:
        """The namespace."""
        return self._space

    def receive(self, now: float) -> list[Message]:
        """What has arrived since the last call."""
        found = []
        with contextlib.suppress(IndexError):
            while True:
                found.append(self._inbox.popleft())
        if self._link.clear:
            return found
        for message in found:
            self._inwards.put(message, message.at)
        for message, _ in self._outwards.take(now):
            self._publish(message)
        arrived = []
        for message, at in self._inwards.take(now):
            message.at = at
            arrived.append(message)
        return arrived

    def send(self, message: Message, now: float) -> None:
        """Publish a message, if its topic is one of ours."""
        if message.name not in self._said:
            return
        if self._link.clear:
            self._publish(message)
        else:
            self._outwards.put(message, now)

    def close(self) -> None:
        if self._context.ok():
            self._context.shutdown()
            self._thread.join(2.0)

    def _publish(self, message: Message) -> None:
        try:
            stamp = self._node.get_clock().now().to_msg()
            self._said[message.name].publish(write(message, self._new, stamp))
        except Exception as error:
            self.refused[f"not sent: {type(error).__name__}"] += 1

    def _spin(self) -> None:
        with contextlib.suppress(Exception):  # it was shut down
            self._executor.spin()

    def _hearing(self, name: str) -> Any:
        def heard(ros: Any) -> None:
            try:
                self._inbox.append(read(name, ros, time.monotonic()))
            except Exception as error:
                self.refused[f"unreadable: {type(error).__name__}"] += 1

        return heard

    def _type(self, name: str) -> Any:
        self._new(kind_of(name))
        return self._types[kind_of(name)]

    def _new(self, kind: str) -> Any:
        """A new message of this type, or of the one that replaces it."""
        if kind not in self._types:
            package, _, what = kind.partition("/")
            try:
                self._types[kind] = getattr(importlib.import_module(f"{package}.msg"), what)
            except ImportError:
                if kind not in REPLACED:
                    raise OptionError(f"ros: the package {package} is not installed") from None
                other = REPLACED[kind]
                log.warning("%s is not installed: %s carries its text", package, other)
                self._new(other)
                self._types[kind] = self._types[other]
        return self._types[kind]()


def _imported(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        first = str(error).splitlines()[0]
        raise OptionError(
            f"ros: {name} cannot be imported ({first}): source a ROS 2, or install the extra ros"
        ) from None
