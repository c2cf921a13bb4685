"""A rate limit."""

from __future__ import annotations

import time


class TokenBucket:
    """A token bucket: `rate` [1/s] on average, `burst` at once."""

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._left = burst
        self._since = time.monotonic()

    def take(self) -> bool:
        """Take one token; whether there was one."""
        self._refill()
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True

    def charge(self, amount: float) -> float:
        """Take tokens, below zero if need be; the time until the bucket is back at zero [s]."""
        self._refill()
        self._left -= amount
        return max(0.0, -self._left / self._rate)

    def _refill(self) -> None:
        now = time.monotonic()
        self._left = min(self._burst, self._left + self._rate * (now - self._since))
        self._since = now
