"""Hostile and damaged files: one line, bounded memory, nothing opened that is not the mesh's."""

from __future__ import annotations

import base64
import io
import json
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import meshes
from tests.support import measured_reader
from tests.support.mesh_files import FILES

MEMORY = 150_000_000  # [byte] that refusing a small file may take
TIME = 5.0  # [s]

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
PLY = (
    "ply\nformat {0} 1.0\nelement vertex {1}\nproperty float x\nproperty float y\n"
    "property float z\nelement face {2}\nproperty list {3} int vertex_indices\nend_header\n"
)
NUMBERS = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
INDICES = struct.pack("<3H", 0, 1, 2)
BUFFER = NUMBERS + INDICES + b"\0\0"


def header(**changes: Any) -> dict[str, Any]:
    """A glTF of one triangle; ``changes`` replace whole members."""
    uri = "data:application/octet-stream;base64," + base64.b64encode(BUFFER).decode()
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"uri": uri, "byteLength": len(BUFFER)}],
        "bufferViews": [
            {"buffer": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 6},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
             "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
        ],
        **changes,
    }  # fmt: skip


def gltf(**changes: Any) -> bytes:
    return json.dumps(header(**changes)).encode()


def accessors(first: dict[str, Any], second: dict[str, Any] | None = None) -> bytes:
    a, b = header()["accessors"]
    return gltf(accessors=[{**a, **first}, {**b, **(second or {})}])


def glb(content: dict[str, Any], claim: int | None = None) -> bytes:
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<2I", len(text) if claim is None else claim, 0x4E4F534A) + text
    chunks += struct.pack("<2I", len(BUFFER), 0x004E4942) + BUFFER
    return b"glTF" + struct.pack("<2I", 2, 12 + len(chunks)) + chunks


CORNERS = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in
                  ((0, 0, 0), (10, 0, 0), (0, 10, 0), (0, 0, 10)))  # fmt: skip
FACES = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in
                ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)))  # fmt: skip
MESH = f"<mesh><vertices>{CORNERS}</vertices><triangles>{FACES}</triangles></mesh>"
OBJECT = f'<object id="1">{MESH}</object>'
ITEM = '<item objectid="1"/>'


def model(objects: str = OBJECT, items: str = ITEM, attributes: str = 'unit="millimeter"') -> str:
    space = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
    production = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
    return (
        f'<?xml version="1.0"?><model {attributes} xmlns="{space}" xmlns:p="{production}">'
        f"<resources>{objects}</resources><build>{items}</build></model>"
    )


def packed(text: str | bytes, name: str = "3D/3dmodel.model", **others: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, text)
        for other, content in others.items():
            archive.writestr(f"3D/{other}.model", content)
    return stream.getvalue()


def bomb() -> bytes:
    """420 MB of spaces in 420 kB."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:  # noqa: SIM117
        with archive.open("3D/3dmodel.model", "w") as part:
            for _ in range(42):
                part.write(b" " * 10_000_000)
    return stream.getvalue()


def nested(levels: int, each: int = 2) -> str:
    """Objects that place the one before them twice: 2^levels bodies."""
    text = OBJECT
    for k in range(2, levels + 2):
        text += f'<object id="{k}"><components>'
        text += f'<component objectid="{k - 1}"/>' * each + "</components></object>"
    return text


def laughs() -> str:
    entities = '<!ENTITY a0 "ha">' + "".join(
        f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 12)
    )
    return (
        model()
        .replace("<model", f"<!DOCTYPE x [{entities}]><model", 1)
        .replace("<resources>", "<resources>&a11;")
    )


def stl(count: int, *numbers: float) -> bytes:
    body = struct.pack(f"<{len(numbers)}f", *numbers)
    return b"x".ljust(80) + struct.pack("<I", count) + body


BAD: dict[str, tuple[str, str | bytes | Callable[[], bytes]]] = {
    "stl: claims 4 billion triangles": ("m.stl", stl(2**32 - 1)),
    "stl: one byte too many": ("m.stl", stl(0) + b"x"),
    "stl: infinite corner": ("m.stl", stl(1, *[0.0] * 5, float("inf"), *[0.0] * 6) + b"\0\0"),
    "stl: a PNG": ("m.stl", b"\x89PNG\r\n\x1a\n" + bytes(200)),
    "stl: a zip": ("m.stl", packed("x")),
    "stl: HTML": ("m.stl", "<!doctype html><html><body>404</body></html>" * 5),
    "stl: ascii with nan": (
        "m.stl",
        "solid s\nfacet normal 0 0 1\nouter loop\nvertex nan 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
        "endloop\nendfacet\nendsolid s\n",
    ),
    "stl: ascii of no facets": ("m.stl", "solid facet\nendsolid facet\n" * 10),
    "stl: all corners at one place": ("m.stl", stl(1, *[1.0] * 12) + b"\0\0"),
    "obj: three faces, no vertices": ("m.obj", "f 1 2 3\n" * 3),
    "obj: nan": ("m.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    "obj: 1e400": ("m.obj", "v 1e400 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    "obj: index 2^40": ("m.obj", TRIANGLE + f"f 1 2 {2**40}\n"),
    "obj: index -2^63": ("m.obj", TRIANGLE + f"f 1 2 {-(2**63)}\n"),
    "obj: fraction as index": ("m.obj", TRIANGLE + "f 1 2 2.5\n"),
    "obj: face of nothing": ("m.obj", TRIANGLE + "f\n"),
    "obj: NUL bytes": ("m.obj", b"v 0 0 0\nv \0 0 0\nf 1 2 1\n"),
    "obj: one long line": ("m.obj", "v " + "1" * 1_000_000),
    "obj: UTF-16, cut off": ("m.obj", (TRIANGLE + "f 1 2 3\n").encode("utf-16")[:-1]),
    "obj: material path and no mesh": ("m.obj", "mtllib ../../../etc/passwd\nusemtl /etc/passwd\n"),
    "ply: unknown format": ("m.ply", PLY.format("ternary", 3, 1, "uchar")),
    "ply: negative count": ("m.ply", PLY.format("ascii", -3, 1, "uchar") + "0 0 0\n"),
    "ply: 10 GB of vertices, ascii": (
        "m.ply", PLY.format("ascii", 10**9, 10**9, "uchar") + "0 0 0\n",
    ),
    "ply: 10 GB of vertices, binary": (
        "m.ply", PLY.format("binary_little_endian", 10**9, 1, "uchar").encode() + BUFFER,
    ),
    "ply: 10 GB of faces, binary": (
        "m.ply",
        PLY.format("binary_little_endian", 3, 10**9, "uchar").encode() + BUFFER,
    ),
    "ply: a list of 2^31 corners": (
        "m.ply",
        PLY.format("binary_little_endian", 3, 1, "int").encode()
        + NUMBERS + struct.pack("<4i", 2**31 - 1, 0, 1, 2),
    ),
    "ply: index -1": (
        "m.ply",
        PLY.format("binary_little_endian", 3, 1, "uchar").encode()
        + NUMBERS + b"\3" + struct.pack("<3i", 0, 1, -1),
    ),
    "ply: header without end": ("m.ply", "ply\nformat ascii 1.0\nelement vertex 3\n"),
    "ply: no positions": (
        "m.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty float a\nend_header\n0\n",
    ),
    "ply: count is a word": ("m.ply", PLY.format("ascii", "three", 1, "uchar") + "0 0 0\n"),
    "off: 10 GB claimed": ("m.off", "OFF\n1000000000 1000000000 0\n0 0 0\n"),
    "off: counts are words": ("m.off", "OFF\nthree one zero\n0 0 0\n"),
    "off: negative index": ("m.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n"),
    "off: nan": ("m.off", "OFF\n3 1 0\nnan 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"),
    "off: fewer faces than told": ("m.off", "OFF\n3 5 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"),
    "off: only the word": ("m.off", "OFF"),
    "glb: chunk of 4 GB": ("m.glb", glb(header(), claim=2**32 - 1)),
    "glb: JSON of nothing": ("m.glb", glb({})),
    "glb: buffer in a file": ("m.glb", glb(header(buffers=[{"uri": "/etc/passwd"}]))),
    "glb: no glTF": ("m.glb", b"GIF89a" + bytes(100)),
    "glb: old version": ("m.glb", b"glTF" + struct.pack("<3I", 1, 20, 0) + b"{}"),
    "gltf: no JSON": ("m.gltf", "Dear surgeon"),
    "gltf: a list": ("m.gltf", "[1, 2, 3]"),
    "gltf: nested a hundred thousand deep": ("m.gltf", "[" * 100_000),
    "gltf: points without data, 10 GB": (
        "m.gltf", gltf(accessors=[{"componentType": 5126, "count": 10**9, "type": "VEC3"}] * 2),
    ),
    "gltf: points claimed beyond the data": ("m.gltf", accessors({"count": 10**7})),
    "gltf: negative count": ("m.gltf", accessors({"count": -3})),
    "gltf: unknown type": ("m.gltf", accessors({"type": "VEC99"})),
    "gltf: two hundred thousand nodes": ("m.gltf", gltf(nodes=[{"mesh": 0}] * 200_000)),
    "gltf: one mesh placed fifty thousand times": (
        "m.gltf",
        gltf(accessors=[{**header()["accessors"][0]},
                        {"componentType": 5123, "count": 2000, "type": "SCALAR"}],
             nodes=[{"mesh": 0}] * 50_000),
    ),
    "gltf: index beyond the vertices": (
        "m.gltf",
        gltf(buffers=[{"uri": "data:;base64," + base64.b64encode(
            NUMBERS + struct.pack("<3H", 0, 1, 900)).decode(), "byteLength": 42}]),
    ),
    "gltf: Draco": ("m.gltf", gltf(extensionsRequired=["KHR_draco_mesh_compression"])),
    "gltf: buffer above the folder": ("m.gltf", gltf(buffers=[{"uri": "../secret.bin"}])),
    "gltf: buffer above, hidden": ("m.gltf", gltf(buffers=[{"uri": "%2e%2e/secret.bin"}])),
    "gltf: absolute path": ("m.gltf", gltf(buffers=[{"uri": "/etc/passwd"}])),
    "gltf: file URL": ("m.gltf", gltf(buffers=[{"uri": "file:///etc/passwd"}])),
    "gltf: web address": ("m.gltf", gltf(buffers=[{"uri": "http://127.0.0.1:9/x.bin"}])),
    "gltf: a device": ("m.gltf", gltf(buffers=[{"uri": "../../../../../../dev/zero"}])),
    "gltf: NUL in the name": ("m.gltf", gltf(buffers=[{"uri": "a\0b"}])),
    "gltf: a link out": ("m.gltf", gltf(buffers=[{"uri": "link.bin"}])),
    "gltf: missing buffer": ("m.gltf", gltf(buffers=[{"uri": "gone.bin"}])),
    "3mf: no zip": ("m.3mf", "hello"),
    "3mf: cut off": ("m.3mf", packed(model())[:-40]),
    "3mf: empty zip": ("m.3mf", b"PK\5\6" + bytes(18)),
    "3mf: no model": ("m.3mf", packed(model(), "other.txt")),
    "3mf: bomb": ("m.3mf", bomb),
    "3mf: bodies of bodies of bodies": (
        "m.3mf", packed(model(nested(28), '<item objectid="29"/>')),
    ),
    "3mf: too deep": ("m.3mf", packed(model(nested(40, 1), '<item objectid="41"/>'))),
    "3mf: in a circle": (
        "m.3mf",
        packed(model('<object id="1"><components><component objectid="1"/></components></object>')),
    ),
    "3mf: unknown object": ("m.3mf", packed(model(items='<item objectid="7"/>'))),
    "3mf: nothing placed": ("m.3mf", packed(model(items=""))),
    "3mf: unknown unit": ("m.3mf", packed(model(attributes='unit="furlong"'))),
    "3mf: words as numbers": ("m.3mf", packed(model(OBJECT.replace('x="10"', 'x="ten"')))),
    "3mf: nan": ("m.3mf", packed(model(OBJECT.replace('x="10"', 'x="nan"')))),
    "3mf: index too large": ("m.3mf", packed(model(OBJECT.replace('v3="3"', 'v3="33"')))),
    "3mf: a transform of three numbers": (
        "m.3mf", packed(model(items='<item objectid="1" transform="1 0 0"/>')),
    ),
    "3mf: not XML": ("m.3mf", packed("\0\1\2")),
    "3mf: entities of entities": ("m.3mf", packed(laughs())),
    "3mf: entity from a file": (
        "m.3mf",
        packed(model().replace("<model", '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>'
                               "<model", 1).replace("<resources>", "<resources>&e;")),
    ),
}  # fmt: skip


class Reader:
    """Has files read by a process of its own, see `measured_reader.py`."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def refusal(self, path: Path, content: bytes, memory: int = MEMORY) -> str:
        """The reason a file is refused with, after what must hold of every refusal was checked."""
        path.write_bytes(content)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps(str(path)), file=self._process.stdin, flush=True)
        answer = self._process.stdout.readline()
        assert answer, f"the reader crashed: exit code {self._process.wait(10)}"
        message, peak, spent = json.loads(answer)
        assert message is not None, "not refused"
        assert path.name in message
        assert "\n" not in message
        assert "root:" not in message  # of /etc/passwd
        assert "TOP SECRET" not in message
        assert peak < memory + 8 * len(content), f"{peak / 1e6:.0f} MB"
        assert spent < TIME, f"{spent:.1f} s of processor time"
        return str(message)


@pytest.fixture(scope="module")
def reader() -> Iterator[Reader]:
    command = [sys.executable, measured_reader.__file__]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield Reader(process)


@pytest.mark.parametrize("case", BAD)
def test_refused_in_one_line_in_time_and_bounded_memory(
    tmp_path: Path, reader: Reader, case: str
) -> None:
    folder = tmp_path / "inside"
    folder.mkdir()
    (tmp_path / "secret.bin").write_bytes(BUFFER)  # sound, were it opened
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    name, content = BAD[case]
    if callable(content):
        content = content()
    reader.refusal(folder / name, content if isinstance(content, bytes) else content.encode())


@pytest.mark.parametrize(
    ("case", "reason"),
    [
        ("gltf: buffer above the folder", "'../secret.bin', which is not beside it"),
        ("gltf: a link out", "'link.bin', which is not beside it"),
        ("gltf: missing buffer", "'gone.bin', which is missing"),
        ("gltf: points without data, 10 GB", "places 333,333,333 triangles"),
        ("gltf: Draco", "KHR_draco_mesh_compression): save it without"),
        ("3mf: bomb", "unpack to 420 MB"),
        ("3mf: bodies of bodies of bodies", "places 1,073,741,824 triangles"),
        ("3mf: in a circle", "nested deeper than 32, or in a circle"),
        ("3mf: unknown unit", "unknown unit 'furlong': 3MF has micron"),
        ("3mf: unknown object", "object '7' is referred to"),
    ],
)
def test_reasons_say_what_is_wrong(tmp_path: Path, reader: Reader, case: str, reason: str) -> None:
    folder = tmp_path / "inside"
    folder.mkdir()
    (tmp_path / "secret.bin").write_bytes(BUFFER)
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    name, content = BAD[case]
    content = content() if callable(content) else content
    content = content if isinstance(content, bytes) else content.encode()
    assert reason in reader.refusal(folder / name, content)


def test_sound_gltf_with_and_without_a_file_beside(tmp_path: Path) -> None:
    wanted = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    (tmp_path / "m.gltf").write_bytes(gltf())
    np.testing.assert_allclose(meshes.arrays(tmp_path / "m.gltf")[0], wanted)
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "a b.bin").write_bytes(BUFFER)
    beside = [{"uri": "parts/a%20b.bin", "byteLength": len(BUFFER)}]
    # Pictures are not needed, so not even looked for.
    pictures: dict[str, Any] = {
        "images": [{"uri": "../../etc/passwd"}], "textures": [{"source": 0}],
    }  # fmt: skip
    (tmp_path / "m.gltf").write_bytes(gltf(buffers=beside, **pictures))
    np.testing.assert_allclose(meshes.arrays(tmp_path / "m.gltf")[0], wanted)
    vertices, faces = meshes.arrays("torus")
    for name, content in trimesh.Trimesh(vertices, faces).export(file_type="gltf").items():
        (tmp_path / name).write_bytes(content)
    back = meshes.arrays(tmp_path / "model.gltf")
    assert trimesh.Trimesh(*back).volume == pytest.approx(
        trimesh.Trimesh(vertices, faces).volume, rel=1e-5
    )


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("micron", 1e-6), ("millimeter", 1e-3), ("centimeter", 0.01), ("inch", 0.0254),
     ("foot", 0.3048), ("meter", 1.0)],
)  # fmt: skip
def test_3mf_knows_its_unit(tmp_path: Path, unit: str, metres: float) -> None:
    size = 0.02 / metres  # a corner of 20 mm
    path = tmp_path / "m.3mf"
    path.write_bytes(
        packed(model(OBJECT.replace('"10"', f'"{size!r}"'), attributes=f'unit="{unit}"'))
    )
    vertices, faces = meshes.arrays(path)
    np.testing.assert_allclose(np.ptp(vertices, axis=0), 0.02)
    assert trimesh.Trimesh(vertices, faces).volume == pytest.approx(0.02**3 / 6)


def test_3mf_components_transforms_and_parts(tmp_path: Path) -> None:
    other = model(f'<object id="5">{MESH}</object>', "")
    move, mirror = "1 0 0 0 1 0 0 0 1 100 0 0", "-1 0 0 0 1 0 0 0 1 0 0 0"
    quarter = "0 1 0 -1 0 0 0 0 1 0 0 7"  # x to y, y to -x, then 7 up
    objects = OBJECT + (
        f'<object id="2"><components><component objectid="1" transform="{quarter}"/>'
        '<component objectid="5" p:path="/3D/part.model"/></components></object>'
    )
    items = f'<item objectid="2" transform="{move}"/><item objectid="1" transform="{mirror}"/>'
    path = tmp_path / "m.3mf"
    path.write_bytes(packed(model(objects, items), part=other))
    vertices, faces = meshes.arrays(path)
    corner = np.array([(0, 0, 0), (10, 0, 0), (0, 10, 0), (0, 0, 10)], dtype=float)
    turned = np.column_stack([-corner[:, 1], corner[:, 0], corner[:, 2] + 7])
    aside = np.array([100.0, 0.0, 0.0])
    wanted = np.vstack([turned + aside, corner + aside, corner * (-1, 1, 1)])
    np.testing.assert_allclose(vertices * 1e3, wanted, atol=1e-12)
    assert trimesh.Trimesh(vertices, faces, process=False).volume == pytest.approx(3e-6 / 6)
    # Written by another program.
    mesh = trimesh.Trimesh(*meshes.arrays("star-prism"), process=False)
    mesh.apply_scale(1e3)
    mesh.export(path)
    back = meshes.arrays(path)
    assert len(back[1]) == len(mesh.faces)
    assert trimesh.Trimesh(*back).volume == pytest.approx(mesh.volume * 1e-9, rel=1e-5)


def test_a_lying_directory_does_not_unpack_more_than_it_says(
    tmp_path: Path, reader: Reader
) -> None:
    """The size in the zip's directory is what is added up; more than it is never read."""
    data = bytearray(packed(model() + " " * 5_000_000))
    where = data.rindex(b"PK\1\2")
    data[where + 24 : where + 28] = struct.pack("<I", 2_000)  # uncompressed size
    reader.refusal(tmp_path / "m.3mf", bytes(data), memory=2_000_000)


@given(
    name=st.sampled_from(sorted(FILES)),
    edits=st.lists(
        st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 8), st.binary(max_size=8)),
        min_size=1, max_size=6,
    ),
)  # fmt: skip
@settings(
    max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_fuzzed_files_give_a_mesh_or_a_line(
    tmp_path: Path, name: str, edits: list[tuple[float, int, bytes]]
) -> None:
    file, sound = FILES[name]
    data = bytearray(sound)
    for place, drop, insert in edits:
        start = int(place * len(data))
        data[start : start + drop] = insert
    path = tmp_path / file
    path.write_bytes(data)
    reason = ""
    try:
        vertices, faces = meshes.arrays(path, unit="cm")
    except meshes.MeshError as error:
        reason = str(error)
    else:
        assert np.isfinite(vertices).all()
        assert 0 <= faces.min() <= faces.max() < len(vertices)
    assert "\n" not in reason
