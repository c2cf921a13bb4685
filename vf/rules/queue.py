"""The priority queue of the walk of the certified rule: a binary heap of (key, item, mask) rows."""

from __future__ import annotations

from vf.kernels import njit


@njit(cache=True, nogil=True)
def push(queue, size, key, item, mask):  # type: ignore[no-untyped-def]
    """Add an entry to a heap of `size` entries, smallest key at the root."""
    i = size
    while i > 0:
        parent = (i - 1) >> 1
        if queue[parent, 0] <= key:
            break
        queue[i, 0], queue[i, 1] = queue[parent, 0], queue[parent, 1]
        queue[i, 2] = queue[parent, 2]
        i = parent
    queue[i, 0], queue[i, 1], queue[i, 2] = key, item, mask


@njit(cache=True, nogil=True)
def pop(queue, size):  # type: ignore[no-untyped-def]
    """Remove the root of a heap of `size` entries (read it before)."""
    size -= 1
    # The vacancy moves down to a leaf without branches, then the last entry, which belongs near the
    # leaves, is inserted there: this costs fewer mispredicted branches than sifting it down.
    i = 0
    child = 1
    while child < size:
        child += queue[child + 1, 0] < queue[child, 0]  # at most the last entry itself
        queue[i, 0], queue[i, 1], queue[i, 2] = queue[child, 0], queue[child, 1], queue[child, 2]
        i = child
        child = 2 * i + 1
    push(queue, i, queue[size, 0], queue[size, 1], queue[size, 2])
