"""Reading Wavefront OBJ: positions and faces, nothing else.

An own reader, because trimesh splits positions that carry several normals or texture points,
drops what no face uses, and takes index 0 for the first vertex: a fixture needs the positions and
the neighbours as the file has them. Material files are never opened.
"""

from __future__ import annotations

import numpy as np

from meshes.shapes import Arrays


def read(data: bytes) -> Arrays:
    """Vertices ``(n, 3)`` in the file's unit and faces ``(m, 3)``, polygons cut into fans.

    Raises ``ValueError`` naming the line's content on anything that is not OBJ.
    """
    positions: list[bytes] = []
    corners: list[list[int]] = []
    for line in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        kind, _, rest = line.lstrip().partition(b" ")
        if kind == b"v":
            positions.append(rest)
        elif kind == b"f":
            corners.append(_polygon(rest, len(positions)))
    vertices = np.empty((len(positions), 3))
    for row, text in enumerate(positions):
        numbers = text.split()
        if len(numbers) < 3:
            raise ValueError(f"vertex with {len(numbers)} coordinates: 'v {_shown(text)}'")
        vertices[row] = (float(numbers[0]), float(numbers[1]), float(numbers[2]))
    triangles = [(p[0], p[k], p[k + 1]) for p in corners for k in range(1, len(p) - 1)]
    return vertices, np.array(triangles, dtype=np.int64).reshape(-1, 3)


def _polygon(text: bytes, vertices_so_far: int) -> list[int]:
    """Zero-based corners of one face; negative indices count back from the latest vertex."""
    polygon = []
    for token in text.split():
        if token.startswith(b"#"):
            break
        index = int(token.partition(b"/")[0])
        if index == 0:
            raise ValueError(f"index 0 in 'f {_shown(text)}': OBJ counts from 1")
        polygon.append(index - 1 if index > 0 else vertices_so_far + index)
    if len(polygon) < 3:
        raise ValueError(f"face with {len(polygon)} corners: 'f {_shown(text)}'")
    return polygon


def _shown(text: bytes) -> str:
    return text[:40].decode("utf-8", "replace").strip()
