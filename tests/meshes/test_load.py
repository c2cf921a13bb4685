"""Files come back as the triangles they hold, in metres, or are refused with the reason."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

import meshes
from meshes.load import SIZE_LIMIT

MM = 1000.0  # [mm/m]


def triangle_set(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Triangles ``(m, 9)``, each turned to start at its smallest corner, sorted: order-free."""
    corners = vertices[faces]
    rows = []
    for triangle in corners:
        start = min(range(3), key=lambda k: tuple(triangle[k]))
        rows.append(tuple(np.roll(triangle, -start, axis=0).ravel()))
    return np.array(sorted(rows))


def exported(
    folder: Path, kind: str, vertices: np.ndarray, faces: np.ndarray, ascii: bool = False
) -> Path:
    """The mesh written by trimesh's exporters."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    path = folder / f"mesh.{kind}"
    if kind == "stl" and ascii:
        mesh.export(path, file_type="stl_ascii")
    elif kind == "ply":
        mesh.export(path, file_type="ply", encoding="ascii" if ascii else "binary")
    else:
        mesh.export(path, file_type=kind)
    return path


@pytest.mark.parametrize(
    ("kind", "unit", "scale", "ascii"),
    [
        ("stl", "mm", 1e3, False),
        ("stl", "mm", 1e3, True),
        ("ply", "mm", 1e3, False),
        ("ply", "m", 1.0, True),
        ("obj", "cm", 1e2, True),
        ("off", "in", 1 / 0.0254, True),
        ("glb", None, 1.0, False),
    ],
)
def test_round_trip(tmp_path: Path, kind: str, unit: str | None, scale: float, ascii: bool) -> None:
    vertices, faces = meshes.arrays("star-prism")
    # Numbers that single precision and eight decimals hold, so that equal means equal.
    grid = 256 * 1000 / scale  # per unit of the file
    grid = 2.0 ** round(np.log2(grid))
    in_file = np.round(vertices * scale * grid) / grid
    path = exported(tmp_path, kind, in_file, faces, ascii)
    back_vertices, back_faces = meshes.arrays(path, unit=unit)
    assert len(back_vertices) == len(np.unique(in_file, axis=0))
    assert back_vertices.dtype == np.float64
    assert back_faces.dtype == np.int64
    np.testing.assert_allclose(
        triangle_set(np.round(back_vertices * scale * grid), back_faces),
        triangle_set(np.round(in_file * grid), faces),
        rtol=0,
        atol=0,
    )
    np.testing.assert_allclose(
        np.ptp(back_vertices, axis=0), np.ptp(in_file, axis=0) / scale, rtol=1e-6
    )


def test_load_returns_a_surface_with_the_callers_faces() -> None:
    surface = meshes.load("cube")
    vertices, faces = meshes.arrays("cube")
    assert np.array_equal(surface.vertices, vertices)
    assert np.array_equal(surface.faces, faces)


def test_stl_merges_equal_corners_only(tmp_path: Path) -> None:
    a, b, c, d = (0, 0, 0), (10, 0, 0), (0, 10, 0), (10, 10, 0)
    near = tuple(np.nextafter(np.float32(b), np.float32(20)).tolist())
    path = tmp_path / "two.stl"
    write_stl(path, [(a, b, c), (b, d, c)])
    assert len(meshes.arrays(path, unit="mm")[0]) == 4
    write_stl(path, [(a, b, c), (near, d, c)])
    assert len(meshes.arrays(path, unit="mm")[0]) == 5
    write_stl(path, [(a, b, c), (b, d, (-0.0, 10, -0.0))])
    assert len(meshes.arrays(path, unit="mm")[0]) == 4


def write_stl(path: Path, triangles: list[tuple]) -> None:
    body = b"".join(
        struct.pack("<12fH", 0, 0, 0, *(x for corner in t for x in corner), 0) for t in triangles
    )
    path.write_bytes(b"made by hand".ljust(80) + struct.pack("<I", len(triangles)) + body)


def test_ply_and_off_stay_unwelded(tmp_path: Path) -> None:
    soup = np.array([(0, 0, 0), (10, 0, 0), (0, 10, 0), (10, 0, 0), (10, 10, 0), (0, 10, 0)], float)
    for kind in ("ply", "off"):
        path = exported(tmp_path, kind, soup, np.arange(6).reshape(2, 3))
        assert len(meshes.arrays(path, unit="mm")[0]) == 6


def test_scene_bodies_stand_where_the_scene_puts_them(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.02, 0.02, 0.02))
    T = trimesh.transformations.rotation_matrix(0.3, (1, 2, 3), (0.1, 0, 0))
    T[:3, 3] += (0.05, 0.01, -0.02)
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirror[0, 3] = -0.1
    scene = trimesh.Scene()
    scene.add_geometry(box, node_name="here")
    scene.add_geometry(box, node_name="there", transform=T)
    scene.add_geometry(box, node_name="mirrored", transform=mirror)
    path = tmp_path / "scene.glb"
    scene.export(path)
    vertices, faces = meshes.arrays(path)
    assert faces.shape == (36, 3)
    loaded = trimesh.Trimesh(vertices, faces, process=False)
    assert loaded.volume == pytest.approx(3 * 0.02**3, rel=1e-5)  # the mirror is not inside out
    assert loaded.is_watertight
    moved = box.vertices @ T[:3, :3].T + T[:3, 3]
    wanted = np.vstack([box.vertices, moved, box.vertices * (-1, 1, 1) + (-0.1, 0, 0)])
    for point in wanted:
        assert np.abs(vertices - point).max(axis=1).min() < 1e-7


def test_obj_as_programs_write_it(tmp_path: Path) -> None:
    path = tmp_path / "quads.obj"
    path.write_text(
        "mtllib ../../etc/passwd\no one\nusemtl x\n"
        "v 0 0 0\nv 20 0 0 0.5 0.5 0.5\nv 20 20 0\nv 0 20 0\n"
        "vt 0 0\nvt 1 1\nvn 0 0 1\nvn 0 1 0\n"
        "f 1/1/1 2/2/1 3/1/2 4/2/2\n"
        "v 0 0 10\nf -5//1 2//2 -1//1 # relative\n"
        "l 1 2\nf 1 2 \\\n5\n"
    )
    vertices, faces = meshes.arrays(path, unit="mm")
    np.testing.assert_allclose(
        vertices * MM, [(0, 0, 0), (20, 0, 0), (20, 20, 0), (0, 20, 0), (0, 0, 10)]
    )
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 4], [0, 1, 4]]


def test_vertices_without_faces_are_dropped(tmp_path: Path) -> None:
    path = tmp_path / "stray.off"
    path.write_text("OFF\n5 1 0\n0 0 0\n9999999 0 0\n20 0 0\n0 20 0\n1 1 1\n3 0 2 3\n")
    vertices, faces = meshes.arrays(path, unit="mm")
    np.testing.assert_allclose(vertices * MM, [(0, 0, 0), (20, 0, 0), (0, 20, 0)])
    assert faces.tolist() == [[0, 1, 2]]


def test_no_warning_when_nothing_is_guessed(tmp_path: Path) -> None:
    vertices, faces = meshes.arrays("cube")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        meshes.arrays("cube")
        meshes.arrays(exported(tmp_path, "stl", vertices * MM, faces), unit="mm")
        glb = exported(tmp_path, "glb", vertices, faces)
        np.testing.assert_allclose(np.ptp(meshes.arrays(glb)[0], axis=0), 0.04, rtol=1e-6)
        # A GLB in millimetres against its standard: the user has the last word.
        np.testing.assert_allclose(
            np.ptp(meshes.arrays(glb, unit="cm")[0], axis=0), 0.0004, rtol=1e-6
        )


PLY = "ply\nformat ascii 1.0\nelement vertex {v}\nproperty float x\nproperty float y\n" + (
    "property float z\nelement face {f}\nproperty list uchar int vertex_indices\nend_header\n{body}"
)
SOLID = "solid s\nfacet normal 0 0 1\nouter loop\n{}\nendloop\nendfacet\nendsolid s\n"
BROKEN: dict[str, tuple[str, bytes | str, str]] = {
    "empty": ("m.stl", b"", "empty"),
    "few bytes": ("m.stl", b"\0" * 20, "too few"),
    "cut-off binary stl": (
        "m.stl",
        b"x".ljust(80) + struct.pack("<I", 7) + b"\0" * 50 * 3,
        "promises 7 triangles",
    ),
    "stl of zero triangles": ("m.stl", b"x".ljust(80) + struct.pack("<I", 0), "no triangles"),
    "text as stl": ("m.stl", "Dear surgeon,\n" * 20, "not begin with 'solid' but with 'Dear s"),
    "ascii stl without end": ("m.stl", SOLID.format("vertex 0 0 0").split("endloop")[0], "cut off"),
    "ascii stl, two corners": (
        "m.stl",
        SOLID.format("vertex 0 0 0\nvertex 1 0 0"),
        "line 2: a facet",
    ),
    "ascii stl, words": (
        "m.stl",
        SOLID.format("vertex 0 0 zero\nvertex 1 0 0\nvertex 0 1 0"),
        "line 4: 'zero' is not a number",
    ),
    "nan stl": (
        "m.stl",
        b"x".ljust(80) + struct.pack("<I12fH", 1, 0, 0, 1, 0, 0, 0, 9, 0, 0, 0, float("nan"), 0, 0),
        "not finite",
    ),
    "infinite obj": ("m.obj", "v 0 0 0\nv inf 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
    "obj points": ("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles, only 3 points"),
    "obj index too large": ("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "vertex 8, of 3"),
    "obj index zero": ("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "counts from 1"),
    "obj index before start": (
        "m.obj",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -9 1 2\n",
        "vertex -9, 3 are above",
    ),
    "obj index beyond 64 bits": ("m.obj", f"v 0 0 0\nf 1 1 {10**30}\n", "is no corner of a face"),
    "obj flat vertex": ("m.obj", "v 0 0\nf 1 1 1\n", "2 coordinates"),
    "obj two corners": ("m.obj", "v 0 0 0\nv 1 0 0\nf 1 2\n", "no triangles, only 2 points"),
    "obj words": ("m.obj", "v a b c\nf 1 1 1\n", "line 1: 'a' is not a number"),
    "not even text": ("m.obj", bytes(range(256)) * 4, "binary data where text should be"),
    "ply points": ("m.ply", PLY.format(v=1, f=0, body="0 0 0\n"), "no triangles"),
    "ply index too large": (
        "m.ply",
        PLY.format(v=3, f=1, body="0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n"),
        "m.ply",
    ),
    "ply cut off": ("m.ply", PLY.format(v=3, f=2, body="0 0 0\n1 0 0\n"), "m.ply"),
    "ply that claims gigabytes": (
        "m.ply",
        PLY.format(v=4_000_000_000, f=4_000_000_000, body="0 0 0\n").replace(
            "ascii", "binary_little_endian"
        ),
        "m.ply",
    ),
    "ply without header": ("m.ply", "hello", "does not begin with a line 'ply'"),
    "off of other kind": ("m.off", "OOPS\n1 2 3\n", "does not begin with 'OFF' but with 'OOPS'"),
    "off without counts": ("m.off", "OFF\n", "numbers of vertices and faces are missing"),
    "off index too large": (
        "m.off",
        "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n",
        "vertex 7, of 3",
    ),
    "off of no faces": ("m.off", "OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n", "m.off"),
    "glb magic only": ("m.glb", b"glTF", "cut off"),
    "glb cut off": (
        "m.glb",
        b"glTF" + struct.pack("<4I", 2, 10**9, 10**9, 0x4E4F534A),
        "promises 1,000,000,000",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_files_are_refused_in_one_line(tmp_path: Path, case: str) -> None:
    name, content, reason = BROKEN[case]
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(meshes.MeshError) as caught:
        meshes.load(path, unit="cm")
    message = str(caught.value)
    assert reason in message
    assert name in message
    assert "\n" not in message
    assert isinstance(caught.value, ValueError)


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: rng.integers(len(data))]


def overwritten(data: bytes, rng: np.random.Generator) -> bytes:
    where = rng.integers(0, len(data), size=8)
    mutable = bytearray(data)
    for place in where:
        mutable[place] = rng.integers(256)
    return bytes(mutable)


@pytest.mark.parametrize("damage", [cut, overwritten])
@pytest.mark.parametrize("kind", meshes.WRITABLE)
def test_random_damage_never_ends_in_another_exception(
    tmp_path: Path, kind: str, damage: Callable[[bytes, np.random.Generator], bytes]
) -> None:
    ball = trimesh.creation.icosphere(subdivisions=1, radius=30)
    path = exported(tmp_path, kind, ball.vertices, ball.faces)
    sound = path.read_bytes()
    rng = np.random.default_rng(11)
    refusals = []
    for round_ in range(60):
        path.write_bytes(damage(sound, rng))
        try:
            vertices, faces = meshes.arrays(path, unit="mm")
        except meshes.MeshError as error:
            refusals.append(str(error))
        else:
            assert np.isfinite(vertices).all(), round_
            assert 0 <= faces.min() <= faces.max() < len(vertices), round_
    assert not any("\n" in message for message in refusals)
    if damage is cut and kind not in ("obj", "off"):  # text without counts may end anywhere
        assert len(refusals) == 60


@pytest.mark.parametrize(
    ("given", "parts"),
    [
        ("skul", ["unknown mesh 'skul'", "did you mean 'skull'", "gyroid", ".stl"]),
        ("Torus", ["did you mean 'torus'"]),
        ("qqqq", ["unknown mesh 'qqqq': choose", "skull-coarse"]),
        ("no/such/thing", ["no such file"]),
        ("missing.stl", ["'missing.stl'", "no such file"]),
        ("nul\0name", ["nul"]),
        ("x" * 5000, ["x"]),
    ],
)
def test_unknown_names_and_missing_files(given: str, parts: list[str]) -> None:
    with pytest.raises(meshes.MeshError) as caught:
        meshes.load(given)
    for part in parts:
        assert part in str(caught.value)


def test_folders_other_formats_and_units(tmp_path: Path) -> None:
    with pytest.raises(meshes.MeshError, match="not a file"):
        meshes.load(tmp_path)
    other = tmp_path / "notes.docx"
    other.write_text("x")
    with pytest.raises(meshes.MeshError, match=r"unknown format '.docx'; choose one of .stl"):
        meshes.load(other)
    with pytest.raises(meshes.MeshError, match=r"unknown unit 'furlong': choose one of m, cm, mm"):
        meshes.load("cube", unit="furlong")


@pytest.mark.parametrize(("unit", "edge"), [("mm", 0.05), ("m", 20.0), ("in", 1e6), ("mm", 1e200)])
def test_absurd_sizes(tmp_path: Path, unit: str, edge: float) -> None:
    path = tmp_path / "m.obj"
    path.write_text(f"v 0 0 0\nv {edge} 0 0\nv 0 {edge} 0\nf 1 2 3\n")
    with pytest.raises(
        meshes.MeshError, match=rf"from corner to corner if its unit is {unit}; from 0.1 mm"
    ):
        meshes.arrays(path, unit=unit)


def test_a_mesh_without_extent_is_absurd_too(tmp_path: Path) -> None:
    path = tmp_path / "m.obj"
    path.write_text("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n")
    with pytest.raises(meshes.MeshError, match="from corner to corner"):
        meshes.arrays(path)


def test_oversized_file_is_not_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "big.stl"
    with path.open("wb") as stream:
        stream.truncate(SIZE_LIMIT + 1)  # a hole: takes no disk
    monkeypatch.setattr(Path, "read_bytes", lambda _self: pytest.fail("opened"))
    with pytest.raises(meshes.MeshError, match="500 MB, more than the 500"):
        meshes.load(path)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"ply\nformat binary_little_endian 1.0\n" + bytes(range(256)), "PLY"),
        (b"glTF\2\0\0\0" + bytes(200), "binary glTF"),
        (b"PK\3\4" + bytes(200), "a zip archive"),
        (b"\x1f\x8b\x08\0" + bytes(200), "packed with gzip"),
        (b"\xff\xff\xfecreated by" + bytes(200), "a FreeSurfer surface"),
        (bytes(128) + b"DICM" + bytes(100), "a DICOM file"),
        (b"\xef\xbb\xbf\n<!DOCTYPE HTML><title>404</title>" + b" " * 100, "a web page"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "a pointer of Git LFS"),
    ],
)
@pytest.mark.parametrize("name", ["a.stl", "a.obj", "a.off", "a.vtk", "a.gltf", "a.white", "a.gii"])
def test_a_file_of_another_format_than_its_name_says_is_refused_as_that(
    tmp_path: Path, name: str, data: bytes, what: str
) -> None:
    if name == "a.white" and what == "a FreeSurfer surface":
        return
    (tmp_path / name).write_bytes(data)
    with pytest.raises(meshes.MeshError, match=f"{what}.*, not {name[2:].upper()} as its name"):
        meshes.arrays(tmp_path / name, unit="mm")
