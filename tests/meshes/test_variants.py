"""Files that are fine, though not as the textbook has them; others are refused by their name."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest

import meshes
from tests.support.mesh_files import (
    POINTS,
    QUADS,
    TRIANGLES,
    freesurfer,
    gltf,
    model,
    obj,
    off,
    ply_binary,
    ply_header,
    ply_text,
    stl_binary,
    stl_text,
    threemf,
    vtk_binary,
    vtk_text,
    vtp,
)

MARK = b"\xef\xbb\xbf"


def upper(data: bytes) -> bytes:
    return data.upper()


STL = stl_text().encode()
OBJ = obj().encode()
OFF = off().encode()
PLY = ply_text().encode()

FINE: dict[str, tuple[str, bytes]] = {
    "stl: capitals": ("m.stl", STL.upper()),
    "stl: byte-order mark": ("m.stl", MARK + STL),
    "stl: UTF-16": ("m.stl", STL.decode().encode("utf-16")),
    "stl: old line ends": ("m.stl", STL.replace(b"\n", b"\r")),
    "stl: tabs, two line ends": ("m.stl", STL.replace(b" ", b"\t").replace(b"\n", b"\r\n")),
    "stl: all on one line": ("m.stl", STL.replace(b"\n", b" ")),
    "stl: a long name": ("m.stl", stl_text("n" * 5000).encode()),
    "stl: a name of keywords": ("m.stl", stl_text("vertex facet my endsolid part").encode()),
    "stl: a name on one line": ("m.stl", stl_text("a b").replace("\n", " ").encode()),
    "stl: no name": ("m.stl", stl_text("").encode()),
    "stl: two solids": (
        "m.stl", (stl_text("a", TRIANGLES[:5]) + stl_text("my solid", TRIANGLES[5:])).encode(),
    ),
    "stl: normals that are no numbers": (
        "m.stl", STL.replace(b"0 0 0\n outer", b"-nan nan nan\n outer"),
    ),
    "stl: old end-of-file mark": ("m.stl", STL + b"\x1a"),
    "stl: binary, solid": ("m.stl", stl_binary(b"solid binary facet normal")),
    "stl: a count of zero": ("m.stl", stl_binary(count=0)),
    "stl: too small a count": ("m.stl", stl_binary(count=11)),
    "stl: a line end behind": ("m.stl", stl_binary(tail=b"\r\n")),
    "stl: a footer": ("m.stl", stl_binary(tail=b"\1\2\3made by hand")),
    "stl: attributes with data": ("m.stl", stl_binary(payload=b"1234567")),
    "obj: byte-order mark": ("m.obj", MARK + OBJ),
    "obj: UTF-16": ("m.obj", OBJ.decode().encode("utf-16")),
    "obj: capitals": ("m.obj", OBJ.upper()),
    "obj: tabs": ("m.obj", OBJ.replace(b" ", b"\t")),
    "obj: some tabs": ("m.obj", OBJ.replace(b"v ", b"v\t", 3).replace(b"f ", b"f \t", 2)),
    "obj: indented, old line ends": ("m.obj", b"  " + OBJ.replace(b"\n", b"\r  ")),
    "obj: edges and points as faces": ("m.obj", OBJ + b"f 1 2\nf 3\n"),
    "obj: lines that go on": (
        "m.obj", OBJ.replace(b" 3 ", b" 3 \\\n ").replace(b"v ", b"v \\\r\n"),
    ),
    "obj: negative, with normals": (
        "m.obj",
        (OBJ[: OBJ.index(b"f ")] + b"vn 0 0 1\nvt 0 0\n")
        + b"".join(b"f " + b" ".join(b"%d/1/1" % (i - 8) for i in q) + b" # x\n" for q in QUADS),
    ),
    "off: counts on the first line": ("m.off", off(counts="OFF 8 6 12\n").encode()),
    "off: no space": ("m.off", off(counts="OFF8 6 12\n").encode()),
    "off: no edges": ("m.off", off(counts="OFF\n8 6\n").encode()),
    "off: no word": ("m.off", off(counts="8 6 12\n").encode()),
    "off: counts line by line": ("m.off", off(counts="OFF\n8\n6\n12\n").encode()),
    "off: numbers in any lines": ("m.off", b"OFF " + OFF[4:].replace(b"\n", b" ")),
    "off: comments": ("m.off", OFF.replace(b"\n", b" # why\n# yes\n\n")),
    "off: colours of faces": (
        "m.off",
        OFF.replace(b"\n4 0 1 3 2\n", b"\n4 0 1 3 2 255 0 0\n")
        .replace(b"\n4 4 6 7 5\n", b"\n4 4 6 7 5 0.5 0.5 0.5 1\n"),
    ),
    "off: colours of vertices": (
        "m.off",
        b"COFF\n8 6 0\n" + b"".join(b"%g %g %g 255 0 0 255\n" % tuple(p) for p in POINTS)
        + OFF.split(b"\n", 10)[10],
    ),
    "off: byte-order mark, capitals": ("m.off", MARK + OFF.replace(b"OFF", b"off")),
    "ply: comment first": ("m.ply", PLY.replace(b"ply\n", b"ply\ncomment by me\nobj_info x\n")),
    "ply: two line ends": ("m.ply", PLY.replace(b"\n", b"\r\n")),
    "ply: old line ends": ("m.ply", PLY.replace(b"\n", b"\r")),
    "ply: byte-order mark": ("m.ply", MARK + PLY),
    "ply: mixed polygons": ("m.ply", ply_binary([*TRIANGLES[:2], *QUADS[1:]])),
    "ply: mixed polygons, text": ("m.ply", ply_text([*TRIANGLES[:2], *QUADS[1:]]).encode()),
    "ply: another name of the corners": (
        "m.ply", ply_binary().replace(b"vertex_indices", b"vertex_index"),
    ),
    "ply: more elements and properties": (
        "m.ply",
        PLY.replace(b"end_header", b"element edge 1\nproperty int a\nproperty int b\nend_header")
        + b"0 1\n",
    ),
    "ply: a comment in two lines": (
        "m.ply", PLY.replace(b"ply\nformat ascii 1.0", b"ply\nformat ascii 1.0\ncomment a\nb: c"),
    ),
    "ply: another line end at last": (
        "m.ply", ply_binary().replace(b"end_header\n", b"end_header\r\n"),
    ),
    "ply: more in its rows than it says": (
        "m.ply", PLY.replace(b"\n4 0 1 3 2\n", b"\n4 0 1 3 2 9 1 1 1 1 1 1 1 1 1\n"),
    ),
    "ply: bytes behind": ("m.ply", ply_binary() + b"more"),
    "vtk: title with a frame": ("m.vtk", vtk_text(title="3D Slicer output. SPACE=LPS").encode()),
    "vtk: point data": ("m.vtk", vtk_text().encode() + b"POINT_DATA 8\nSCALARS x float\n1 2 3\n"),
    "vtk: capitals, lines": (
        "m.vtk", vtk_text().replace("POLYGONS", "LINES 1 3\n2 0 1\npolygons").encode(),
    ),
    "vtk: fields": (
        "m.vtk",
        vtk_text()
        .replace("POINTS 8", "FIELD FieldData 2\na 1 2 float\n1 2\nSPACE 1 1 string\nLPS\nPOINTS 8")
        .encode(),
    ),
    "vtk: mixed, 5.1": ("m.vtk", vtk_binary([*TRIANGLES[:2], *QUADS[1:]], "5.1")),
    "vtp: a frame": ("m.vtp", vtp(space="LPS")),
    "gltf: without indices": (
        "m.gltf",
        gltf(
            points=(POINTS[np.array(TRIANGLES).ravel()] * 1e-3).astype("<f4"),
            accessor={"count": 36},
            meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}],
            bufferViews=[{"buffer": 0, "byteLength": 432}],
        ),
    ),
    "gltf: no scene": ("m.gltf", gltf(scenes=[], nodes=[])),
    "gltf: whole numbers, normalized": (
        "m.gltf",
        gltf(
            points=np.c_[np.round(POINTS / 15 * 32767), np.zeros(8)].astype("<i2"),
            accessor={"componentType": 5122, "normalized": True},
            nodes=[{"mesh": 0, "scale": [0.015] * 3}],
            bufferViews=[
                {"buffer": 0, "byteLength": 64, "byteStride": 8},
                {"buffer": 0, "byteOffset": 64, "byteLength": 72},
            ],
            extensionsUsed=["KHR_mesh_quantization"],
            extensionsRequired=["KHR_mesh_quantization"],
        ),
    ),
    "gltf: sparse, from nothing": (
        "m.gltf",
        gltf(
            accessors=[
                {"componentType": 5126, "count": 8, "type": "VEC3",
                 "sparse": {"count": 8, "indices": {"bufferView": 2, "componentType": 5121},
                            "values": {"bufferView": 0}}},
                {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
            ],
            points=np.frombuffer((POINTS * 1e-3).astype("<f4").tobytes() + bytes(range(8)), "u1"),
            bufferViews=[
                {"buffer": 0, "byteLength": 96},
                {"buffer": 0, "byteOffset": 104, "byteLength": 72},
                {"buffer": 0, "byteOffset": 96, "byteLength": 8},
            ],
        ),
    ),
    "3mf: other extensions": (
        "m.3mf",
        threemf(model(attributes='requiredextensions="m" xmlns:m="http://schemas.microsoft.com/'
                                 '3dmanufacturing/material/2015/02"')),
    ),
    "freesurfer: its volume behind": (
        "rh.white", freesurfer(b"\0\0\0\2valid = 1\ncras   = 1.5 -2 3\n"),
    ),
    "freesurfer: another name": ("lh.pial.T1", freesurfer()),
    "gzip: two members": ("m.stl.gz", gzip.compress(STL[:300]) + gzip.compress(STL[300:])),
    "gzip: capitals": ("M.PLY.GZ", gzip.compress(PLY)),
}  # fmt: skip


@pytest.mark.parametrize("name", FINE)
def test_every_day_files_are_read(tmp_path: Path, name: str) -> None:
    file, data = FINE[name]
    (tmp_path / file).write_bytes(data)
    found = meshes.read(tmp_path / file, unit="m" if "gltf" in file else "mm")
    vertices, faces = found.arrays
    assert len(faces) == 12
    assert {tuple(p) for p in np.round(vertices * 1e3).tolist()} == set(map(tuple, POINTS))
    a = vertices[faces]
    volume = np.einsum("ij,ij->", a[:, 0], np.cross(a[:, 1], a[:, 2])) / 6
    assert volume == pytest.approx(6e-6, rel=1e-3)
    assert (found.frame == "LPS") == ("frame" in name or "fields" in name)


NOTED = {
    "stl: a count of zero": "The header counts 0 triangles: all 12",
    "stl: too small a count": "counts 11 triangles, the file has 12",
    "stl: a footer": "15 bytes after the last triangle",
    "obj: edges and points as faces": "2 of the faces have fewer than three corners",
    "ply: bytes behind": "after the last element",
    "gltf: no scene": "no scene: every mesh",
    "freesurfer: its volume behind": "plus the volume's c_ras, 1.5, -2, 3 mm",
}


@pytest.mark.parametrize("name", NOTED)
def test_what_is_unusual_is_told(tmp_path: Path, name: str) -> None:
    file, data = FINE[name]
    (tmp_path / file).write_bytes(data)
    notes = meshes.read(tmp_path / file, unit="mm" if "gltf" not in file else "m").notes
    assert any(NOTED[name] in note for note in notes), notes


BOX = (
    '<object id="2"><components>' + '<component objectid="1"/>' * 90_000 + "</components></object>"
)
HEAD = b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET "
REFUSED: dict[str, tuple[str, bytes, str]] = {
    "ply: text cut": ("m.ply", PLY[: PLY.rindex(b"4 ")], "promises 6 of its element 'face'"),
    "stl: the last solid is cut": (
        "m.stl", (stl_text("a") + stl_text("b")).encode()[:-60], "until 'endsolid'",
    ),
    "stl: a word inside": ("m.stl", STL.replace(b"endfacet\n", b"endfacet\nx\n", 1), "line 9: 'x'"),
    "stl: decimal commas": ("m.stl", STL.replace(b"15", b"1,5"), "a decimal comma is not read"),
    "obj: of MNI": ("m.obj", b"P 0.3 0.3 0.4 10 1 4\n 0 0 0\n", "an MNI object file"),
    "obj: free form": ("m.obj", OBJ + b"cstype bspline\nsurf 0 1 0 1 1 2 3 4\n", "(surf) are not"),
    "obj: fewer than its comment": ("m.obj", b"# Faces: 9\n" + OBJ, "9 faces, but has 6"),
    "obj: a letter": ("m.obj", b"Dear surgeon,\nhere is it\n", "line 1 is 'Dear surgeon,'"),
    "off: binary": ("m.off", b"OFF BINARY\n\0\0\0\x08", "binary OFF is not read"),
    "off: in four": ("m.off", b"4OFF\n1 1 1\n", "four or more dimensions"),
    "gltf: version 1": ("m.gltf", b'{"asset": {"version": "1.0"}, "meshes": {}}', "glTF 1.0: only"),
    "gltf: nothing in it": ("m.gltf", b'{"asset": {"version": "2.0"}, "meshes": []}', "no meshes"),
    "gltf: a needed extension": (
        "m.gltf", gltf(extensionsRequired=["VENDOR_magic"]), "not read: VENDOR_magic",
    ),
    "gltf: instances": (
        "m.gltf", gltf(extensionsUsed=["EXT_mesh_gpu_instancing"]), "EXT_mesh_gpu_instancing",
    ),
    "gltf: compressed, not required": (
        "m.gltf",
        gltf(prim={"extensions": {"KHR_draco_mesh_compression": {}}},
             accessors=[{"componentType": 5126, "count": 8, "type": "VEC3"}] * 2),
        "without compression",
    ),
    "gltf: bones": ("m.gltf", gltf(nodes=[{"mesh": 0, "skin": 0}]), "moved by bones"),
    "gltf: morphed": ("m.gltf", gltf(nodes=[{"mesh": 0, "weights": [0.5]}]), "is morphed"),
    "gltf: no data": (
        "m.gltf",
        gltf(accessors=[{"componentType": 5126, "count": 3, "type": "VEC3"},
                        {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"}]),
        "without data",
    ),
    "gltf: a list for a name": (
        "m.gltf", gltf(nodes=["x"]), "a value of another kind",
    ),
    "3mf: beams": (
        "m.3mf",
        threemf(model(attributes='requiredextensions="b" xmlns:b="http://schemas.microsoft.com/'
                                 '3dmanufacturing/beamlattice/2017/02"')),
        "beamlattice",
    ),
    "3mf: a million triangles of nothing": (
        "m.3mf", threemf(model(BOX, '<item objectid="2"/>')), "places 1,080,000 triangles",
    ),
    "vtk: an image": ("m.vtk", HEAD + b"STRUCTURED_POINTS\n", "STRUCTURED_POINTS, not POLYDATA"),
    "vtp: a grid": ("m.vtp", b'<VTKFile type="UnstructuredGrid"/>', "UnstructuredGrid, not Poly"),
    "vtp: another packer": (
        "m.vtp", vtp().replace(b'version="0.1"', b'compressor="vtkSnappyDataCompressor"'), "Snappy",
    ),
    "gii: points only": (
        "m.gii", b'<GIFTI><DataArray Intent="NIFTI_INTENT_POINTSET"/></GIFTI>', "1 sets of points",
    ),
    "freesurfer: quadrangles": ("lh.orig", b"\xff\xff\xff" + bytes(20), "old quadrangle format"),
    "gzip: a bomb": ("m.stl.gz", gzip.compress(bytes(20_000_000)), "unpack to 10 MB or more"),
    "gzip: none": ("m.stl.gz", b"\x1f\x8b\x08", "a whole gzip file"),
    "vtp: a bomb": (
        "m.vtp",
        vtp("binary", packed=True).replace(b"AgAAA", b"////A", 1),
        "packed blocks",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_read_is_refused_by_its_name(tmp_path: Path, name: str) -> None:
    file, data, reason = REFUSED[name]
    (tmp_path / file).write_bytes(data)
    with pytest.raises(meshes.MeshError) as caught:
        meshes.read(tmp_path / file, unit="mm")
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_fan_and_a_strip_of_gltf_are_triangles(tmp_path: Path) -> None:
    """Seven triangles around a point, beside the box."""
    around = [(10 * np.cos(t), 10 * np.sin(t), 20) for t in np.linspace(0, 2 * np.pi, 8)]
    points = np.vstack([POINTS, [(0, 0, 20)], around])
    corners = np.arange(8, 17, dtype="<u2")
    boxes = np.array(TRIANGLES, "<u2").tobytes()
    blob = np.frombuffer((points * 1e-3).astype("<f4").tobytes() + corners.tobytes(), "u1")
    data = gltf(
        points=blob,
        accessors=[
            {"bufferView": 0, "componentType": 5126, "count": 17, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
            {"bufferView": 2, "componentType": 5123, "count": 9, "type": "SCALAR"},
        ],
        bufferViews=[
            {"buffer": 0, "byteLength": 204},
            {"buffer": 0, "byteOffset": 222, "byteLength": len(boxes)},
            {"buffer": 0, "byteOffset": 204, "byteLength": 18},
        ],
        meshes=[
            {
                "primitives": [
                    {"attributes": {"POSITION": 0}, "indices": 1},
                    {"attributes": {"POSITION": 0}, "indices": 2, "mode": 6},
                ]
            }
        ],
    )
    (tmp_path / "m.gltf").write_bytes(data)
    vertices, faces = meshes.arrays(tmp_path / "m.gltf")
    assert len(faces) == 19
    fan = vertices[faces[12:]]
    np.testing.assert_allclose(fan[:, 0], [(0, 0, 0.02)] * 7, atol=1e-9)
    areas = np.cross(fan[:, 1] - fan[:, 0], fan[:, 2] - fan[:, 0])
    np.testing.assert_allclose(areas, [(0, 0, 1e-4 * np.sin(2 * np.pi / 7))] * 7, atol=1e-9)
    strip = data.replace(b'"mode": 6', b'"mode": 5')
    (tmp_path / "m.gltf").write_bytes(strip)
    assert len(meshes.arrays(tmp_path / "m.gltf")[1]) == 19


def test_the_readers_of_the_field_agree(tmp_path: Path) -> None:
    """GIfTI and FreeSurfer as nibabel writes them."""
    nib = pytest.importorskip("nibabel")
    rng = np.random.default_rng(3)
    points = rng.normal(scale=40, size=(60, 3)).astype("f4")
    faces = rng.integers(0, 60, size=(90, 3)).astype("i4")
    wanted = points[faces].astype(float) * 1e-3
    nib.freesurfer.write_geometry(tmp_path / "lh.white", points, faces)
    for encoding in (1, 2, 3):  # ASCII, base64, packed
        image = nib.gifti.GiftiImage()
        for values, intent in ((points, "POINTSET"), (faces, "TRIANGLE")):
            image.add_gifti_data_array(
                nib.gifti.GiftiDataArray(values, f"NIFTI_INTENT_{intent}", encoding=encoding)
            )
        nib.save(image, tmp_path / f"{encoding}.surf.gii")
    for name in ("lh.white", "1.surf.gii", "2.surf.gii", "3.surf.gii"):
        found = meshes.read(tmp_path / name)
        np.testing.assert_allclose(found.arrays[0][found.arrays[1]], wanted, atol=1e-6)
        assert (found.unit, found.frame) == ("mm", "RAS")


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("a.STL", "stl"), ("a.b.surf.gii.gz", "gii"), ("lh.pial", "pial"), ("pial", "pial"),
        ("rh.white.deformed", "white"), ("bone.stl.txt", None), ("gz", None), (".gz", None),
        ("lh.thickness", None),
    ],
)  # fmt: skip
def test_formats_by_name(name: str, kind: str | None) -> None:
    assert meshes.kind(name) == kind


def test_lists_of_ply_with_more_than_corners() -> None:
    """Faces with texture points behind their corners, of varying length."""
    head = ply_header("binary_little_endian", 6).replace(
        "end_header", "property list uchar float texcoord\nproperty uchar flag\nend_header"
    )
    rows = b"".join(struct.pack(f"<B4iB{k}fB", 4, *q, k, *range(k), 9) for k, q in enumerate(QUADS))
    from meshes.formats import ply

    content = ply.read(head.encode() + POINTS.astype("<f4").tobytes() + rows)
    assert len(content.bodies[0][1]) == 12
