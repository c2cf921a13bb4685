"""Hands surfaces and plants to another process: arrays in shared memory, the rest as a pickle."""

from __future__ import annotations

import ctypes
import pickle
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np

import vf
from app.control.plant import Description
from app.control.process.shared import Memory

_ALIGNED = 64  # [byte]
_POPULATE_READ = 22  # of madvise, Linux 5.14


@dataclass(frozen=True)
class Shared:
    """A surface in shared memory.

    Attributes:
        memory: its arrays, one behind another.
        pickled: the surface without them.
        places: (first byte, length) of each array.
    """

    memory: Memory
    pickled: bytes
    places: tuple[tuple[int, int], ...]


def share(surface: vf.Surface) -> Shared:
    """Copy the arrays of a surface to shared memory; from then on the surface itself uses those.

    So the arrays are there once. Threads may use the surface meanwhile.

    Raises:
        OSError: there is no memory for it.
    """
    arrays: list[pickle.PickleBuffer] = []
    pickled = pickle.dumps(surface, protocol=5, buffer_callback=arrays.append)
    places, end = [], 0
    for array in arrays:
        places.append((end, array.raw().nbytes))
        end += -(-array.raw().nbytes // _ALIGNED) * _ALIGNED
    memory = Memory.create(max(end, _ALIGNED))
    whole = np.frombuffer(memory.data, np.uint8)
    for array, (first, length) in zip(arrays, places, strict=True):
        whole[first : first + length] = np.frombuffer(array.raw(), np.uint8)
    shared = Shared(memory, pickled, tuple(places))
    # Attribute by attribute: each is equal to what it replaces.
    vars(surface).update(vars(_unpickled(memory.data, pickled, shared.places)))
    return shared


def attach(fd: int, pickled: bytes, places: tuple[tuple[int, int], ...]) -> vf.Surface:
    """The surface of `share`, over the same memory; the descriptor is closed."""
    memory = Memory(fd, write=False)
    memory.forget()
    _populate(memory.data)
    return _unpickled(memory.data, pickled, places)


def _unpickled(data: memoryview, pickled: bytes, places: tuple[tuple[int, int], ...]) -> vf.Surface:
    parts = [data[first : first + length].toreadonly() for first, length in places]
    surface = pickle.loads(pickled, buffers=parts)
    assert isinstance(surface, vf.Surface)
    return surface


def _populate(data: memoryview) -> None:
    """Map all pages now, so that no tick has to; without the interpreter lock."""
    if sys.platform.startswith("linux"):
        start = np.frombuffer(data, np.uint8).ctypes.data
        libc = ctypes.CDLL(None)
        libc.madvise(ctypes.c_void_p(start), ctypes.c_size_t(len(data)), _POPULATE_READ)


class _Pickler(pickle.Pickler):
    """Leaves surfaces out, but for their place in a list: the other process has them."""

    def __init__(self, file: BytesIO, surfaces: Sequence[vf.Surface]) -> None:
        super().__init__(file, protocol=5)
        self._places = {id(surface): k for k, surface in enumerate(surfaces)}

    def persistent_id(self, obj: Any) -> int | None:
        return self._places[id(obj)] if isinstance(obj, vf.Surface) else None


class _Unpickler(pickle.Unpickler):
    def __init__(self, data: bytes, surfaces: Sequence[vf.Surface]) -> None:
        super().__init__(BytesIO(data))
        self._surfaces = surfaces

    def persistent_load(self, place: int) -> vf.Surface:
        return self._surfaces[place]


def pack(description: Description) -> bytes:
    """A description without its surfaces.

    Raises:
        Exception: a script that cannot be pickled.
    """
    data = BytesIO()
    _Pickler(data, description.surfaces).dump(description)
    return data.getvalue()


def unpack(data: bytes, surfaces: Sequence[vf.Surface]) -> Description:
    """The description of `pack`, with these surfaces, in the order of `Description.surfaces`."""
    description = _Unpickler(data, surfaces).load()
    assert isinstance(description, Description)
    return description
