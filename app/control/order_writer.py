"""Serialises changes of the orders to a control loop."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from app.control.engine import Orders
from app.control.mailbox import Mailbox
from app.words import Refused


class OrderWriter:
    """Holds the newest orders and controls their changes. Thread-safe.

    Attributes:
        lock: of the writers; the loop reads `inbox` without it.
        inbox: mailbox from which the loop reads the orders.
        orders: the newest orders.
        closed: why changes are refused; empty: they are accepted.
    """

    def __init__(self, orders: Orders, inbox: Mailbox[Orders] | None = None) -> None:
        """`inbox`: has these orders; None: one is made."""
        self.lock = threading.RLock()
        self.orders = orders
        self.inbox: Mailbox[Orders] = Mailbox(orders) if inbox is None else inbox
        self.closed = ""
        self._paused = False  # before it was closed

    @contextlib.contextmanager
    def exclusive(self) -> Iterator[None]:
        """Hold the lock for one or more changes.

        Raises:
            Refused: changes are refused, see `closed`.
        """
        with self.lock:
            if self.closed:
                raise Refused(self.closed)
            yield

    def write(self, **changes: Any) -> None:
        """Change the orders; all changes take effect at the same tick.

        Raises:
            Refused: the control process cannot use them; nothing is changed.
        """
        with self.lock:
            orders = replace(self.orders, **changes)
            self.inbox.put(orders)
            self.orders = orders

    def close(self, reason: str) -> None:
        """Pause the loop, and refuse changes for this reason."""
        with self.exclusive():
            self.closed, self._paused = reason, self.orders.paused
            self.write(paused=True)

    def open(self) -> None:
        """Accept changes again, and resume the loop if it ran before. Safe to call twice."""
        with self.lock:
            if self.closed:
                self.closed = ""
                self.write(paused=self._paused)
