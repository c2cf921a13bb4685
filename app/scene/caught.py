"""Collecting the warnings of mesh readers."""

from __future__ import annotations

import threading
import warnings
from typing import Any


class caught_warnings:
    """Collects warnings, by one thread at a time: `warnings.catch_warnings` is not thread-safe."""

    _lock = threading.Lock()

    def __enter__(self) -> list[warnings.WarningMessage]:
        self._lock.acquire()
        self._catcher = warnings.catch_warnings(record=True)
        caught = self._catcher.__enter__()
        warnings.simplefilter("always", UserWarning)
        return caught

    def __exit__(self, *error: Any) -> None:
        try:
            self._catcher.__exit__(*error)
        finally:
            self._lock.release()
