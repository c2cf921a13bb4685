"""The patient frame of a mesh file's coordinates: which way x and y point.

"RAS": x to the patient's right, y to the front (anterior), z up (superior): NIfTI, FreeSurfer, and
3D Slicer inside. "LPS": x to the left, y to the back (posterior), z up: DICOM, and what 3D Slicer
writes. They differ by half a turn about z. Most formats do not say which they hold; 3D Slicer
writes `SPACE=RAS` or `SPACE=LPS` in a header or comment, and takes a file without it as LPS.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from meshes.errors import MeshError

FRAMES = ("RAS", "LPS")

_SPACE = re.compile(r"\bSPACE\s*=\s*([RL][AP][SI])\b", re.IGNORECASE)


def in_text(text: bytes | str) -> str | None:
    """The frame that a header or comment names as 3D Slicer does, `SPACE=RAS` or `SPACE=LPS`.

    Raises:
        MeshError: it names both, or another one.
    """
    if isinstance(text, bytes):
        text = text.decode("latin-1")
    found = {match.upper() for match in _SPACE.findall(text)}
    if len(found) > 1:
        both = " and ".join(f"SPACE={frame}" for frame in sorted(found, reverse=True))
        raise MeshError(f"says {both}: only one frame is possible")
    frame = found.pop() if found else None
    if frame not in (None, *FRAMES):
        raise MeshError(f"says SPACE={frame}: only {' and '.join(FRAMES)} are read")
    return frame


def tag(frame: str) -> str:
    """The text from which `in_text` and 3D Slicer read a frame."""
    return f"SPACE={frame}"


def chosen(frame: str | None) -> str | None:
    """A frame given by the user, in capitals; None stays None.

    Raises:
        MeshError: neither RAS nor LPS.
    """
    if frame is None or frame.upper() in FRAMES:
        return frame and frame.upper()
    raise MeshError(f"unknown frame {frame!r}: choose one of {', '.join(FRAMES)}")


def combined(said: str | None, found: str | None) -> str | None:
    """The frame given by the user (``said``) or by the file (``found``); None if neither.

    Raises:
        MeshError: they contradict each other.
    """
    if said is not None and found is not None and said != found:
        raise MeshError(f"is in {found}, it says so itself, and not in {said}")
    return said or found


def turned(
    points: NDArray[np.float64], frame: str | None, wanted: str | None
) -> tuple[NDArray[np.float64], str | None]:
    """Points ``(n, 3)`` of a frame transformed to the wanted one, and the resulting frame.

    Raises:
        MeshError: a frame is wanted, but the points' own is not known.
    """
    if wanted is None or wanted == frame:
        return points, frame
    if frame is None:
        raise MeshError(
            f"to write it in {wanted}, its own patient frame has to be known:"
            f" say --frame {FRAMES[0]} or --frame {FRAMES[1]}"
        )
    return half_turn(points), wanted


def frame_description(frame: str | None) -> str:
    """A sentence part about a frame, for the user."""
    if frame == "RAS":
        return "RAS (x to the patient's right, y to the front, z up)"
    if frame == "LPS":
        return "LPS (x to the patient's left, y to the back, z up)"
    return "the file does not say whether it is LPS or RAS; 3D Slicer would take it as LPS"


def half_turn(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points ``(n, 3)`` of RAS in LPS or the reverse: half a turn about z, exact."""
    return points * (-1.0, -1.0, 1.0) + 0.0
