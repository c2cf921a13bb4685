"""Mesh formats: each has a module with `read`, and `write` where it is written, and a row below."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from meshes.content import Content
from meshes.formats import freesurfer, gifti, glb, gltf, obj, off, ply, stl, threemf, vtk, vtp
from meshes.packed import MAGIC


@dataclass(frozen=True)
class Format:
    """A format of mesh files.

    Attributes:
        title: its name in the documentation.
        ends: how the names of its files end, in lower case, after a dot.
        read: `(data)`, or `(data, folder)` if ``opens_others``, to the bodies of a file. Any
            exception means a damaged file; `MeshError` says why.
        write: `(vertices, faces, comment)` to the bytes of a file; vertices ``(n, 3)`` in the
            file's unit, faces ``(m, 3)``, one line of text. None: it is not written.
        opens_others: a file refers to others in its folder.
        shares_vertices: triangles share vertices. Otherwise corners at exactly the same place are
            joined when it is read.
        in_metres: coordinates are in metres by its standard.
    """

    title: str
    ends: tuple[str, ...]
    read: Callable[..., Content]
    write: Callable[[Any, Any, str], bytes] | None = None
    opens_others: bool = False
    shares_vertices: bool = True
    in_metres: bool = False


FREESURFER = ("pial", "white", "orig", "smoothwm", "inflated")
_SCENE: Any = {"opens_others": True, "shares_vertices": False, "in_metres": True}
TABLE = (
    Format("STL", ("stl",), stl.read, stl.write, shares_vertices=False),
    Format("OBJ", ("obj",), obj.read, obj.write),
    Format("PLY", ("ply",), ply.read, ply.write),
    Format("OFF", ("off",), off.read, off.write),
    Format("GLB", ("glb",), glb.read, glb.write, **_SCENE),
    Format("glTF", ("gltf",), gltf.read, **_SCENE),
    Format("3MF", ("3mf",), threemf.read),
    Format("VTP", ("vtp",), vtp.read),
    Format("legacy VTK", ("vtk",), vtk.read),
    Format("GIfTI", ("gii",), gifti.read),
    Format("FreeSurfer", FREESURFER, freesurfer.read),
)
BY_END = {end: entry for entry in TABLE for end in entry.ends}
FORMATS = tuple(BY_END)
"""Ends of the names of mesh files; `.gz` may follow any of them."""
WRITABLE = tuple(end for end, entry in BY_END.items() if entry.write)
"""Ends of the names of the files that `meshes.save` writes."""

_SIGNATURES = (  # first bytes in lower case, description, ends of the formats that may begin so
    (MAGIC, "packed with gzip: its name should end in .gz", ()),
    (b"\xff\xff\xfe", "a FreeSurfer surface", FREESURFER),
    (b"pk\x03\x04", "a zip archive (as 3MF is)", ("3mf",)),
    (b"gltf", "binary glTF", ("glb",)),
    (b"ply", "PLY", ("ply",)),
    (b"# vtk datafile", "legacy VTK", ("vtk",)),
    (b"<!doctype html", "a web page", ()),
    (b"<html", "a web page", ()),
    (b"<vtkfile", "VTK's XML", ("vtp",)),
    (b"<gifti", "GIfTI", ("gii",)),
    (b"<?xml", "XML", ("vtp", "gii")),
    (b"nrrd000", "an NRRD volume (see mesh from-volume)", ()),
    (b"iso-10303", "a STEP file, which has no triangles", ()),
    (b"version https://git-lfs", "a pointer of Git LFS in place of the file", ()),
)


def kind(name: str) -> str | None:
    """The format of a file by its name, of `FORMATS`; None of other files.

    FreeSurfer's surfaces may also go by names such as `lh.pial.T1`.
    """
    words = name.lower().removesuffix(".gz").split(".")
    if words[-1] in FORMATS:
        return words[-1]
    hemisphere = len(words) > 1 and words[0] in ("lh", "rh")
    return words[1] if hemisphere and words[1] in FREESURFER else None


def identified(data: bytes) -> tuple[str, tuple[str, ...]]:
    """What a file is by its first bytes, and the formats that begin so; "" if not known."""
    if data[128:132] == b"DICM":
        return "a DICOM file", ()
    begin = data[:256].lower()
    text = begin.removeprefix(b"\xef\xbb\xbf").lstrip()
    for magic, what, forms in _SIGNATURES:
        if (begin if magic[0] > 127 or magic[0] < 32 else text).startswith(magic):
            return what, forms
    return "", ()
