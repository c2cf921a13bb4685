"""Label maps: volumes whose whole numbers name structures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from meshes.errors import MeshError
from meshes.volume.grid import Volume

MIDDLE = 0.5  # the level at which `one_label` has its surface
_MOST_LABELS = 500  # a volume of more different values is taken for an image
_MOST_TOLD = 20


def one_label(volume: Volume, label: int) -> Volume:
    """1 in the voxels of one label and 0 elsewhere: its surface lies at `MIDDLE`.

    Raises:
        MeshError: no voxel has the label; the message lists the labels there are.
    """
    inside = volume.values == label
    if not inside.any():
        raise MeshError(f"{volume.name}: no voxel has label {label}: {told(volume)}")
    return replace(volume, values=inside.view(np.uint8))


def told(volume: Volume) -> str:
    """The range of a volume's values, and the labels that they may be, with numbers of voxels."""
    values = volume.values
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return "no voxel has a finite value"
    text = f"its values run from {known.min():g} to {known.max():g}"
    # Whole numbers may stand in floating point: some programs write nothing else.
    if values.dtype.kind == "f" and not (len(known) == values.size and (known % 1 == 0).all()):
        return text
    labels, counts = np.unique(known, return_counts=True)
    if len(labels) > _MOST_LABELS:
        return text
    names = dict(volume.names)
    parts = []
    for label, count in zip(labels.tolist(), counts.tolist(), strict=True):
        if label != 0:
            name = names.get(int(label))
            parts.append(f"{int(label)}{f' {name}' if name else ''} ({count:,} voxels)")
    more = f" and {len(parts) - _MOST_TOLD} more" if len(parts) > _MOST_TOLD else ""
    return f"{text}; as labels: {', '.join(parts[:_MOST_TOLD]) or 'none'}{more}"
