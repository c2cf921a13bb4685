"""Reading FreeSurfer's surfaces: `lh.pial`, `rh.white` and so on, the triangle format."""

from __future__ import annotations

import re

import numpy as np

from meshes.content import Content, checked, cut_off
from meshes.errors import MeshError

MAGIC = b"\xff\xff\xfe"
_QUADRANGLES = (b"\xff\xff\xff", b"\xff\xff\xfd")
_CENTRE = re.compile(rb"cras\s*=\s*(\S+)\s+(\S+)\s+(\S+)")


def read(data: bytes) -> Content:
    """The one body of a surface file, in millimetres.

    Raises:
        MeshError: cut off, damaged or another format.
    """
    if data.startswith(_QUADRANGLES):
        raise MeshError("FreeSurfer's old quadrangle format: convert it with mris_convert")
    if not data.startswith(MAGIC):
        raise MeshError("not a FreeSurfer surface: it does not begin with its mark")
    # A line with author and date, and an empty line.
    head = data[3:2000].find(b"\n\n") + 5
    if head < 5 or len(data) < head + 8:
        raise cut_off("two lines and two counts at the start")
    vertices, faces = np.frombuffer(data, ">i4", count=2, offset=head).tolist()
    if min(vertices, faces) < 0:
        raise MeshError(f"counts {vertices} vertices and {faces} faces: damaged")
    if len(data) < head + 8 + 12 * (vertices + faces):
        raise cut_off(f"{vertices:,} vertices and {faces:,} faces", f"{len(data):,} bytes")
    points = np.frombuffer(data, ">f4", count=3 * vertices, offset=head + 8)
    corners = np.frombuffer(data, ">i4", count=3 * faces, offset=head + 8 + 12 * vertices)
    centre = _CENTRE.search(data, head + 8 + 12 * (vertices + faces))
    offset = f", {b', '.join(centre.groups()).decode('latin-1')} mm" if centre else ""
    return Content(
        [
            checked(
                points.reshape(-1, 3).astype(np.float64), corners.reshape(-1, 3).astype(np.int64)
            )
        ],
        "mm",
        "RAS",
        (
            "In FreeSurfer's surface RAS (tkreg), whose origin is the middle of its volume: the"
            f" scanner's coordinates are these plus the volume's c_ras{offset}.",
        ),
    )
