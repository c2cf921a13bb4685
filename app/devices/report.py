"""What a station says of its devices to people: small, immutable, and made off the fast path."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class LinkReport:
    """One device as it was seen last.

    Attributes:
        url: where it is.
        peer: who answers there; empty: nobody yet.
        rate: values a second that were taken [Hz].
        age: of the newest [s]; inf: there never was one.
        trouble: why it is not to be relied on now; empty: it is.
        refused: how much of what came was refused, by reason.
    """

    url: str
    peer: str = ""
    rate: float = 0.0
    age: float = float("inf")
    trouble: str = ""
    refused: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Report:
    """All devices as they were seen last.

    Attributes:
        state: operating state, one of those of `app.devices.crtk.state`.
        why: of a FAULT; empty else.
        homed, busy: as in CRTK.
        holds: why the tool holds; empty: it does not.
        arm, master: the two sides.
        error: how far the arm is off the certified path [m].
        largest: the largest error since the arm was enabled [m].
        limit: up to which error the certificate holds [m].
        latency: median and 99.9th percentile of the time from a master's goal to the arm's
            set-point [s]; nan: none yet.
        sent: set-points that went to the arm.
        errors: of the devices' code, in each of which the tool held.
    """

    state: str
    why: str
    homed: bool
    busy: bool
    holds: str
    arm: LinkReport
    master: LinkReport
    error: float = 0.0
    largest: float = 0.0
    limit: float = 0.0
    latency: tuple[float, float] = (float("nan"), float("nan"))
    sent: int = 0
    errors: int = 0


class Rate:
    """How often something happens, from a count that grows."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, int]] = deque(maxlen=11)

    def of(self, count: int, now: float) -> float:
        """A second, over the last ten calls [Hz]."""
        self._seen.append((now, count))
        (since, before) = self._seen[0]
        return (count - before) / (now - since) if now > since else 0.0


class Latencies:
    """The newest latencies [s]."""

    def __init__(self, most: int = 8192) -> None:
        self._ring = np.zeros(most)
        self._count = 0

    def add(self, latency: float) -> None:
        """Note one."""
        self._ring[self._count % len(self._ring)] = latency
        self._count += 1

    def summary(self) -> tuple[float, float]:
        """Median and 99.9th percentile; nan where there are none."""
        seen = self._ring[: self._count]
        if not len(seen):
            return float("nan"), float("nan")
        middle, late = len(seen) // 2, int(0.999 * len(seen))
        sorted_there = np.partition(seen, (middle, late))  # once: this is done in a tick
        return float(sorted_there[middle]), float(sorted_there[late])
