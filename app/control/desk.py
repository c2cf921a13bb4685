"""Where the orders to a control loop are written: by one at a time, and not while it is closed."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from app.control.engine import Orders
from app.control.mailbox import Mailbox
from app.refused import Refused


class Desk:
    """The newest orders, and who may change them. Any thread may call.

    Attributes:
        lock: of the writers; the loop, which reads `inbox`, never takes it.
        inbox: where the loop finds the orders.
        orders: the newest.
        closed: why orders are refused; empty: they are not.
    """

    def __init__(self, orders: Orders) -> None:
        self.lock = threading.RLock()
        self.orders = orders
        self.inbox: Mailbox[Orders] = Mailbox(orders)
        self.closed = ""
        self._paused = False  # before it was closed

    @contextlib.contextmanager
    def turn(self) -> Iterator[None]:
        """The lock, for an order.

        Raises:
            Refused: it is closed.
        """
        with self.lock:
            if self.closed:
                raise Refused(self.closed)
            yield

    def write(self, **changes: Any) -> None:
        """Change the orders; all of it is seen at the same tick."""
        with self.lock:
            self.orders = replace(self.orders, **changes)
            self.inbox.put(self.orders)

    def close(self, reason: str) -> None:
        """Stop the ticks, and refuse orders for this reason."""
        with self.turn():
            self.closed, self._paused = reason, self.orders.paused
            self.write(paused=True)

    def open(self) -> None:
        """Take orders again, and tick if it did before. Safe to call twice."""
        with self.lock:
            if self.closed:
                self.closed = ""
                self.write(paused=self._paused)
