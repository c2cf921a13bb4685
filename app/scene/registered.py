"""The margins that a scene's registration adds to those of its structures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import meshes
import vf
from app.kinds import Points, bare
from app.options import declared
from app.settings import Options
from app.structure import Registration, Structure

FIDUCIALS = bare(declared(Registration)["fiducials"].kind)
MOST = bare(declared(Structure)["margin"].kind).high  # type: ignore[attr-defined]


def with_fiducials(options: Options) -> Options:
    """The options with the fiducials themselves instead of the file that has them.

    So a recording or scenario does not depend on the file.

    Raises:
        meshes.MeshError: the file cannot be read, or has something else.
        OptionError: a fiducial too far from the mesh's origin.
    """
    own = options.registration
    if own is None or not isinstance(own.fiducials, str):
        return options
    assert isinstance(FIDUCIALS, Points)
    points = meshes.read_fiducials(own.fiducials, FIDUCIALS.most)
    found = replace(own, fiducials=tuple(map(tuple, points.tolist())))
    return replace(options, registration=found)


def registered(options: Options, T_base_mesh: NDArray[np.float64]) -> meshes.MarginMap | None:
    """The margins that the registration adds, arm base frame; None: there is no registration.

    Raises:
        meshes.MeshError: the fiducials determine no registration.
    """
    own = options.registration
    if own is None:
        return None
    made = meshes.margin_map(np.array(own.fiducials), own.fle, own.factor)
    return made.moved(T_base_mesh)


def ranges(
    added: meshes.MarginMap | None, names: Sequence[str], surfaces: Sequence[vf.Surface]
) -> tuple[tuple[float, float], ...]:
    """The least and the largest margin that is added to each structure [m]; empty: nothing is.

    Raises:
        meshes.MeshError: one is larger than a margin may be.
    """
    if added is None:
        return ()
    found = []
    for name, surface in zip(names, surfaces, strict=True):
        margins = added.at(surface.vertices)
        least, most = float(margins.min()), float(margins.max())
        if most > MOST:
            raise meshes.MeshError(
                f"the registration may be off by {most * 1e3:.3g} mm at {name} (factor included): "
                f"margins are at most {MOST * 1e3:g} mm; fiducials that are farther apart, or a "
                "smaller localisation error, are needed"
            )
        found.append((least, most))
    return tuple(found)
