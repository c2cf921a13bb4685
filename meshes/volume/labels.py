"""Label maps: volumes of integers that stand for structures."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.errors import MeshError
from meshes.volume.grid import Volume, extent, planes_at_once

MIDDLE = 0.5  # the level at which `one_label` has its surface
_MOST_LABELS = 500  # a volume of more different values is an image
_MOST_LISTED = 20


def one_label(volume: Volume, label: int) -> Volume:
    """1 in the voxels of one label and 0 elsewhere: its surface lies at `MIDDLE`.

    Raises:
        MeshError: no voxel has the label; the message lists the labels there are.
    """
    inside = volume.values == label
    if not inside.any():
        raise MeshError(f"{volume.name}: no voxel has label {label}: {describe_values(volume)}")
    return replace(volume, values=inside.view(np.uint8))


def describe_values(volume: Volume) -> str:
    """The range of a volume's values, and its labels with names and numbers of voxels, as text."""
    values, known = volume.values, extent(volume.values)
    if known.count == 0:
        return "no voxel has a finite value"
    text = f"its values run from {known.low:g} to {known.high:g}"
    counts = label_counts(values) if known.count == values.size else None
    if counts is None:
        return text
    names = dict(volume.names)
    parts = []
    for label in sorted(counts):
        name = f" {names[label]}" if label in names else ""
        parts.append(f"{label}{name} ({counts[label]:,} voxels)")
    more = f" and {len(parts) - _MOST_LISTED} more" if len(parts) > _MOST_LISTED else ""
    return f"{text}; as labels: {', '.join(parts[:_MOST_LISTED]) or 'none'}{more}"


def label_counts(values: NDArray[Any]) -> Counter[int] | None:
    """How many voxels have each label but 0; None for an image."""
    counts: Counter[int] = Counter()
    step = planes_at_once(values)
    for first in range(0, values.shape[0], step):
        part = values[first : first + step].ravel()
        # Some programs write labels as floating-point numbers.
        if part.dtype.kind == "f" and (part != np.floor(part)).any():
            return None
        if part.dtype.itemsize <= 2 and part.dtype.kind in "iu":  # much quicker than sorting
            low = int(part.min())
            found = np.bincount(part.astype(np.int64) - low)
            labels = np.flatnonzero(found)
            found, labels = found[labels], labels + low
        else:
            labels, found = np.unique(part, return_counts=True)
        counts.update(dict(zip(map(int, labels), map(int, found), strict=True)))
        if len(counts) > _MOST_LABELS:
            return None
    del counts[0]
    return counts
