"""A link that delays and loses on purpose, to try teleoperation over a distance."""

from __future__ import annotations

import heapq
import random
from typing import Generic, TypeVar

from app.kinds.links import Link

T = TypeVar("T")

MOST = 20_000  # on their way; more are lost


class Line(Generic[T]):
    """One direction of a `Link`: what is put in comes out later, in another order, or never.

    Attributes:
        lost: how many did not come out.
    """

    def __init__(self, link: Link, seed: int = 0) -> None:
        """`seed`: of delays and losses."""
        self.link = link
        self.lost = 0
        self._random = random.Random(seed)
        self._on_the_way: list[tuple[float, int, T]] = []
        self._count = 0

    def put(self, item: T, now: float) -> None:
        """Send an item at this time [s]."""
        link = self.link
        if len(self._on_the_way) >= MOST or (link.loss and self._random.random() < link.loss):
            self.lost += 1
            return
        late = abs(self._random.gauss(0.0, link.jitter)) if link.jitter else 0.0
        self._count += 1
        heapq.heappush(self._on_the_way, (now + link.delay + late, self._count, item))

    def take(self, now: float) -> list[tuple[T, float]]:
        """What has arrived by this time [s], each with its time of arrival."""
        arrived = []
        waiting = self._on_the_way
        while waiting and waiting[0][0] <= now:
            due, _, item = heapq.heappop(waiting)
            arrived.append((item, due))
        return arrived
