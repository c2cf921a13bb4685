"""Quadric decimation in a process of its own.

fast-simplification holds Python's interpreter for as long as it works, seconds for a million
triangles. In the process of the control loop that would be as long a pause of the tool.

Run as a script, by path, this file reads one `.npz` on standard input and writes one on standard
output; it imports neither our packages nor their dependencies, so it starts in a fraction of a
second.
"""

from __future__ import annotations

import io
import subprocess
import sys

import numpy as np
from numpy.typing import NDArray


def thin(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], limit: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """About `limit` triangles in place of `faces` (m, 3), or None if that process failed."""
    sent = io.BytesIO()
    np.savez(sent, vertices=vertices, faces=faces.astype(np.int32), limit=limit)
    answer = subprocess.run(
        [sys.executable, __file__], input=sent.getvalue(), capture_output=True, check=False
    )
    if answer.returncode != 0:
        return None
    with np.load(io.BytesIO(answer.stdout)) as got:
        return got["vertices"].astype(np.float64), got["faces"].astype(np.int64)


def _main() -> None:
    import fast_simplification

    with np.load(io.BytesIO(sys.stdin.buffer.read())) as asked:
        vertices, faces = fast_simplification.simplify(
            asked["vertices"], asked["faces"], target_count=int(asked["limit"])
        )
    got = io.BytesIO()
    np.savez(got, vertices=vertices, faces=faces)
    sys.stdout.buffer.write(got.getvalue())


if __name__ == "__main__":
    _main()
