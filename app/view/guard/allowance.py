"""How often something may happen: on average, and at once."""

from __future__ import annotations

import time


class Allowance:
    """A token bucket: `rate` per second on average, `burst` at once."""

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._left = burst
        self._since = time.monotonic()

    def take(self) -> bool:
        """Whether there is one left to take."""
        self._refill()
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True

    def owe(self, amount: float) -> float:
        """Take in any case; for how long to wait until that is made up for [s]."""
        self._refill()
        self._left -= amount
        return max(0.0, -self._left / self._rate)

    def _refill(self) -> None:
        now = time.monotonic()
        self._left = min(self._burst, self._left + self._rate * (now - self._since))
        self._since = now
