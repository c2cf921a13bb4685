"""Small mesh files of every format, written here by hand: what the readers' tests read.

No writer of the package is used, so that reader and writer cannot share a mistake.
"""

from __future__ import annotations

import base64
import gzip
import io
import json
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np

# A box of 30 × 20 × 10, closed, wound outwards: 12 triangles, a volume of 6,000.
POINTS = np.array([(x, y, z) for x in (-15, 15) for y in (-10, 10) for z in (-5, 5)], dtype=float)
QUADS = [
    [0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3],
]  # fmt: skip
TRIANGLES = [t for q in QUADS for t in ([q[0], q[1], q[2]], [q[0], q[2], q[3]])]


def stl_text(name: str = "box", triangles: list[list[int]] = TRIANGLES) -> str:
    return (
        f"solid {name}\n"
        + "".join(
            "facet normal 0 0 0\n outer loop\n"
            + "".join("  vertex {:g} {:g} {:g}\n".format(*POINTS[i]) for i in t)
            + " endloop\nendfacet\n"
            for t in triangles
        )
        + f"endsolid {name}\n"
    )


def stl_binary(
    head: bytes = b"by hand", count: int = 12, payload: bytes = b"", tail: bytes = b""
) -> bytes:
    body = b"".join(
        struct.pack("<12fH", 0, 0, 0, *POINTS[t].ravel(), len(payload)) + payload for t in TRIANGLES
    )
    return head.ljust(80) + struct.pack("<I", count) + body + tail


def obj(faces: list[list[int]] = QUADS) -> str:
    return "".join("v {:g} {:g} {:g}\n".format(*p) for p in POINTS) + "".join(
        "f " + " ".join(str(i + 1) for i in face) + "\n" for face in faces
    )


def off(faces: list[list[int]] = QUADS, counts: str = "OFF\n8 6 12\n") -> str:
    return (
        counts
        + "".join("{:g} {:g} {:g}\n".format(*p) for p in POINTS)
        + "".join(f"{len(f)} " + " ".join(map(str, f)) + "\n" for f in faces)
    )


def ply_header(form: str, faces: int, element: str = "face", count: str = "uchar") -> str:
    return (
        f"ply\nformat {form} 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
        f"property float z\nelement {element} {faces}\nproperty list {count} int vertex_indices\n"
        "end_header\n"
    )


def ply_text(faces: list[list[int]] = QUADS) -> str:
    return (
        ply_header("ascii", len(faces))
        + "".join("{:g} {:g} {:g}\n".format(*p) for p in POINTS)
        + "".join(f"{len(f)} " + " ".join(map(str, f)) + "\n" for f in faces)
    )


def ply_binary(faces: list[list[int]] = QUADS, order: str = "<") -> bytes:
    form = "binary_little_endian" if order == "<" else "binary_big_endian"
    return (
        ply_header(form, len(faces)).encode()
        + POINTS.astype(order + "f4").tobytes()
        + b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)
    )


def ply_strips(strip: list[int]) -> bytes:
    return (
        ply_header("binary_little_endian", 1, "tristrips", "int").encode()
        + POINTS.astype("<f4").tobytes()
        + struct.pack(f"<{len(strip) + 1}i", len(strip), *strip)
    )


def gltf(
    binary: bool = False,
    prim: dict | None = None,
    points: np.ndarray | None = None,
    accessor: dict | None = None,
    **changes: object,
) -> bytes:
    """The box in metres; ``accessor`` changes the one of positions, ``changes`` the header."""
    body = ((POINTS * 1e-3).astype("<f4") if points is None else points).tobytes()
    corners = np.array(TRIANGLES, "<u2").tobytes()
    blob = body + corners
    header = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, **(prim or {})}]}],
        "buffers": [{"byteLength": len(blob)}],
        "bufferViews": [
            {"buffer": 0, "byteLength": len(body)},
            {"buffer": 0, "byteOffset": len(body), "byteLength": len(corners)},
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 8,
                "type": "VEC3",
                **(accessor or {}),
            },
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        **changes,
    }  # fmt: skip
    if not binary:
        uri = "data:application/octet-stream;base64," + base64.b64encode(blob).decode()
        header["buffers"] = [{"byteLength": len(blob), "uri": uri}]
        return json.dumps(header).encode()
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    blob += b"\0" * (-len(blob) % 4)
    chunks = struct.pack("<2I", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<2I", len(blob), 0x004E4942) + blob
    return b"glTF" + struct.pack("<2I", 2, 12 + len(chunks)) + chunks


def model(objects: str = "", items: str = '<item objectid="1"/>', attributes: str = "") -> str:
    box = (
        "<mesh><vertices>"
        + "".join('<vertex x="{:g}" y="{:g}" z="{:g}"/>'.format(*p) for p in POINTS)
        + "</vertices><triangles>"
        + "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*t) for t in TRIANGLES)
        + "</triangles></mesh>"
    )
    return (
        '<?xml version="1.0"?><model unit="millimeter"'
        f' xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" {attributes}>'
        f'<resources><object id="1">{box}</object>{objects}</resources>'
        f"<build>{items}</build></model>"
    )


def threemf(text: str = "", method: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        archive.writestr("3D/3dmodel.model", text or model())
    return stream.getvalue()


def vtk_text(faces: list[list[int]] = QUADS, title: str = "by hand") -> str:
    size = sum(len(f) + 1 for f in faces)
    return (
        f"# vtk DataFile Version 3.0\n{title}\nASCII\nDATASET POLYDATA\nPOINTS 8 float\n"
        + "".join("{:g} {:g} {:g}\n".format(*p) for p in POINTS)
        + f"POLYGONS {len(faces)} {size}\n"
        + "".join(f"{len(f)} " + " ".join(map(str, f)) + "\n" for f in faces)
    )


def vtk_binary(faces: list[list[int]] = QUADS, version: str = "3.0") -> bytes:
    flat = np.array([i for f in faces for i in f])
    ends = np.cumsum([0] + [len(f) for f in faces])
    head = f"# vtk DataFile Version {version}\nby hand\nBINARY\nDATASET POLYDATA\nPOINTS 8 double\n"
    if version.startswith("5"):
        cells = (
            f"POLYGONS {len(ends)} {len(flat)}\nOFFSETS vtktypeint64\n".encode()
            + ends.astype(">i8").tobytes()
            + b"\nCONNECTIVITY vtktypeint64\n"
            + flat.astype(">i8").tobytes()
        )
    else:
        lists = [n for f in faces for n in (len(f), *f)]
        cells = f"POLYGONS {len(faces)} {len(lists)}\n".encode() + np.array(lists, ">i4").tobytes()
    return head.encode() + POINTS.astype(">f8").tobytes() + b"\n" + cells + b"\n"


def vtp(mode: str = "ascii", packed: bool = False, space: str = "") -> bytes:
    """VTP with its arrays as "ascii", "binary", "raw" (appended) or "base64" (appended)."""
    arrays = {
        "points": POINTS.astype("<f4"),
        "connectivity": np.array([i for q in QUADS for i in q], "<i8"),
        "offsets": np.arange(4, 28, 4).astype("<i8"),
    }
    appended = b""
    written = {}
    for name, array in arrays.items():
        raw = array.tobytes()
        if packed:
            half = len(raw) // 2
            parts = [zlib.compress(raw[:half]), zlib.compress(raw[half:])]
            head = struct.pack("<5I", 2, half, len(raw) - half, *map(len, parts))
            content = b"".join(parts)
        else:
            head, content = struct.pack("<I", len(raw)), raw
        coded = (
            head + content
            if mode == "raw"
            else base64.b64encode(head) + (base64.b64encode(content))
        )
        if mode == "ascii":
            written[name] = 'format="ascii">' + " ".join(map(str, array.ravel().tolist()))
        elif mode == "binary":
            written[name] = f'format="binary">{coded.decode()}'
        else:
            written[name] = f'format="appended" offset="{len(appended)}">'
            appended += coded
    packer = 'compressor="vtkZLibDataCompressor"' if packed else ""
    codes = " ".join(str(ord(c)) for c in space + "\0")
    text = (
        f'<VTKFile type="PolyData" version="0.1" byte_order="LittleEndian" {packer}><PolyData>'
        f'<FieldData><Array type="String" Name="SPACE" NumberOfTuples="1" format="ascii">{codes}'
        '</Array></FieldData><Piece NumberOfPoints="8" NumberOfPolys="6"><Points>'
        f'<DataArray type="Float32" NumberOfComponents="3" {written["points"]}</DataArray>'
        f'</Points><Polys><DataArray type="Int64" Name="connectivity" {written["connectivity"]}'
        f'</DataArray><DataArray type="Int64" Name="offsets" {written["offsets"]}</DataArray>'
        "</Polys></Piece></PolyData>"
    ).encode()
    if appended:
        coding = b"raw" if mode == "raw" else b"base64"
        text += b'<AppendedData encoding="' + coding + b'">_' + appended + b"</AppendedData>"
    return text + b"</VTKFile>"


def gifti(encoding: str = "GZipBase64Binary") -> bytes:
    def array(intent: str, kind: str, values: np.ndarray) -> str:
        raw = values.tobytes()
        if encoding == "ASCII":
            data = " ".join(map(str, values.ravel().tolist()))
        else:
            data = base64.b64encode(zlib.compress(raw) if "GZip" in encoding else raw).decode()
        return (
            f'<DataArray Intent="NIFTI_INTENT_{intent}" DataType="NIFTI_TYPE_{kind}"'
            ' ArrayIndexingOrder="RowMajorOrder" Dimensionality="2"'
            f' Dim0="{len(values)}" Dim1="3" Encoding="{encoding}" Endian="LittleEndian">'
            "<CoordinateSystemTransformMatrix><DataSpace>NIFTI_XFORM_SCANNER_ANAT</DataSpace>"
            f"</CoordinateSystemTransformMatrix><Data>{data}</Data></DataArray>"
        )

    points = array("POINTSET", "FLOAT32", POINTS.astype("<f4"))
    corners = array("TRIANGLE", "INT32", np.array(TRIANGLES, "<i4"))
    return (
        '<?xml version="1.0"?><!DOCTYPE GIFTI SYSTEM "http://www.nitrc.org/frs/download.php/115/'
        f'gifti.dtd"><GIFTI Version="1.0" NumberOfDataArrays="2">{points}{corners}</GIFTI>'
    ).encode()


def freesurfer(tail: bytes = b"") -> bytes:
    return (
        b"\xff\xff\xfecreated by hand\n\n"
        + struct.pack(">2i", len(POINTS), len(TRIANGLES))
        + POINTS.astype(">f4").tobytes()
        + np.array(TRIANGLES, ">i4").tobytes()
        + tail
    )


# The same box in every way that one of our readers has to know; all of it has an end that is seen.
FILES: dict[str, tuple[str, bytes]] = {
    "stl text": ("m.stl", stl_text().encode()),
    "stl binary": ("m.stl", stl_binary()),
    "stl with attributes": ("m.stl", stl_binary(payload=b"abcd")),
    "obj with counts": ("m.obj", ("# Vertices: 8\n# Faces: 6\n" + obj()).encode()),
    "off": ("m.off", off().encode()),
    "ply text": ("m.ply", ply_text().encode()),
    "ply binary": ("m.ply", ply_binary()),
    "ply big-endian, mixed": (
        "m.ply", ply_binary([TRIANGLES[0], TRIANGLES[1], *QUADS[1:]], ">"),
    ),
    "ply strips": ("m.ply", ply_strips([i for t in TRIANGLES for i in (*t, -1)])),
    "glb": ("m.glb", gltf(binary=True)),
    "gltf": ("m.gltf", gltf()),
    "3mf": ("m.3mf", threemf()),
    "vtk text": ("m.vtk", vtk_text().encode()),
    "vtk binary": ("m.vtk", vtk_binary()),
    "vtk 5.1": ("m.vtk", vtk_binary(version="5.1")),
    "vtp text": ("m.vtp", vtp()),
    "vtp binary": ("m.vtp", vtp("binary")),
    "vtp raw": ("m.vtp", vtp("raw")),
    "vtp base64": ("m.vtp", vtp("base64")),
    "vtp raw, packed": ("m.vtp", vtp("raw", packed=True)),
    "vtp binary, packed": ("m.vtp", vtp("binary", packed=True)),
    "gii text": ("m.surf.gii", gifti("ASCII")),
    "gii base64": ("m.surf.gii", gifti("Base64Binary")),
    "gii packed": ("m.surf.gii", gifti()),
    "freesurfer": ("lh.pial", freesurfer()),
    "stl.gz": ("m.stl.gz", gzip.compress(stl_binary(), mtime=0)),
    "ply.gz": ("m.ply.gz", gzip.compress(ply_text().encode(), mtime=0)),
}  # fmt: skip


TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]], dtype=float) / np.sqrt(3)
"""Of diagonal 1."""
SIDES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def tetrahedron(path: Path, across: float) -> Path:
    """An OBJ file of a tetrahedron of this diagonal, which says no unit."""
    corners = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in (TETRAHEDRON * across).tolist())
    path.write_text(corners + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in SIDES.tolist()))
    return path
