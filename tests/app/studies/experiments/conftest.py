"""What the experiments' tests share."""

import threading
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def no_thread_left_behind() -> Iterator[None]:
    """As everywhere, but Dask keeps threads for the process, once it was used."""
    before = set(threading.enumerate())
    yield
    left = [
        t
        for t in threading.enumerate()
        if t not in before and not t.name.startswith(("IO loop", "Dask-"))
    ]
    for thread in left:
        thread.join(2.0)
    assert [t.name for t in left if t.is_alive()] == []
