"""Shared memory: the newest message is whole, a queue keeps order and counts what did not fit."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from app.control.process import shared
from app.control.process.shared import Memory, Queue, Slot


def queue(room: int) -> tuple[Queue, Queue, Memory]:
    """A writer and a reader of the same memory, by two maps of it."""
    memory = Memory.create(Queue.HEAD + room)
    other = Memory(os.dup(memory.fd), write=True)
    return Queue(memory.data), Queue(other.data), memory


def messages(rng: np.random.Generator, count: int, longest: int) -> list[bytes]:
    return [rng.bytes(int(n)) for n in rng.integers(1, longest, count)]


@pytest.mark.parametrize("room", [256, 1000, 4096])
def test_what_fits_comes_out_in_order_and_the_rest_is_counted(
    room: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shared, "LOW", room // 4)
    rng = np.random.default_rng(room)
    ours, theirs, _memory = queue(room)
    put: dict[int, bytes] = {}
    taken: list[tuple[int, bytes]] = []
    for number, message in enumerate(messages(rng, 3000, room // 3), 1):
        if ours.put(message):
            put[number] = message
            assert theirs.newest() == (number, message)
        if rng.random() < 0.3:
            taken += theirs.take()
    taken += theirs.take()
    assert taken == sorted(put.items())
    assert ours.count == theirs.count == 3000
    assert 0 < len(put) < 3000, "some must not have fitted"


def test_a_reader_that_keeps_up_keeps_the_memory_small() -> None:
    ours, theirs, memory = queue(1 << 24)
    for _ in range(20_000):
        ours.put(bytes(1500))
        assert len(list(theirs.take())) == 1
    used = os.fstat(memory.fd).st_blocks * 512  # before a look at the rest takes memory for it
    assert shared.LOW <= used < 2 * shared.LOW
    assert not np.frombuffer(memory.data, np.uint8)[shared.LOW + 8192 :].any()


def test_a_message_larger_than_the_memory_does_not_fit() -> None:
    ours, theirs, _memory = queue(256)
    assert not ours.put(bytes(300))
    assert ours.put(b"next")
    assert list(theirs.take()) == [(2, b"next")]


def test_what_is_not_whole_is_not_read() -> None:
    ours, theirs, memory = queue(4096)
    ours.put(b"first")
    ours.put(b"second message")
    memory.data[Queue.HEAD + 24 + 16 + 3] ^= 1  # a byte of the second
    assert theirs.newest() is None
    assert list(theirs.take()) == [(1, b"first")]
    assert list(theirs.take()) == []  # given up
    ours.put(b"third")
    assert list(theirs.take()) == [(3, b"third")]


@pytest.fixture
def quick_switches() -> Iterator[None]:
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def test_a_slot_has_the_newest_message_whole_whenever_it_is_read(quick_switches: None) -> None:
    memory = Memory.create(Slot.SIZE)
    ours, theirs = Slot(memory.data), Slot(Memory(os.dup(memory.fd), write=True).data)
    assert theirs.read() is None
    rng = np.random.default_rng(2)
    sent = [bytes([k % 251]) * int(rng.integers(8, 400)) for k in range(500)]
    done = threading.Event()

    def write() -> None:
        while not done.is_set():
            for message in sent:
                ours.write(message)

    thread = threading.Thread(target=write)
    thread.start()
    known, seen, last = set(sent), set(), 0
    deadline = time.monotonic() + 10.0
    while len(seen) < 100 and time.monotonic() < deadline:
        message = theirs.read()
        if message is not None:
            assert message in known
            seen.add(message)
        assert theirs.count >= last
        last = theirs.count
    done.set()
    thread.join()
    assert theirs.read() == sent[-1]
    assert len(seen) == 100


def test_memory_has_no_name_and_goes_with_its_last_owner() -> None:
    before = set(os.listdir("/dev/shm")) if os.path.isdir("/dev/shm") else set()
    memory = Memory.create(1 << 16)
    if before or os.path.isdir("/dev/shm"):
        assert set(os.listdir("/dev/shm")) == before
    memory.data[5] = 7
    other = Memory(os.dup(memory.fd), write=False)
    memory.forget()
    memory.forget()
    assert other.data[5] == 7
    with pytest.raises(TypeError):
        other.data[5] = 8
