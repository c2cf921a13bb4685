"""Files that VTK 9.7 itself wrote: triangle strips of a ball, packed with LZ4 and with LZMA."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

import meshes
from meshes.packed import lz4_block, unxz

# By vtkXMLPolyDataWriter, of vtkStripper on vtkSphereSource (radius 30, 8 around, 5 high): the
# points (Float32), and corners and ends of the strips (Int64), each as base64.
WRITTEN = {
    "LZ4": (
        "AQAAAACAAAA4AQAAwQAAAA==FQABACXwQQsAYQDwwaS0qRAARKS0qUEcAHEeXgQnpLSpDADApLSpwQAAcEEAAHBB"
        "JAAEBAAAJAD6AQAAcEEAAHBBpLSpwTYyuyYcABHwJAAHGADBwQAAcMEAAHBBpLSpNAAATAAAJAAHGAAAkABTwTYy"
        "OyeQAFPBHl6EJ5AABBgABEgAACwABEgAF8FIAAAYAFTBqGWMp2QAcS6NxqcAAPAkAAcYAABIAADYAAAwAABIAAAE"
        "AAEkAAPYAFDBpLSpwQ==",
        "AQAAAACAAAAgAgAA6QAAAA==EwABABMCCAATBQgAEwYIABMJCAATCggAEw0IABMBCAATEAgAExMIABMPCAATEggA"
        "Ew4IABMRCAAEAgATFAkAExcIABMYCAATAwgAEwQIABMHCAAEcAAEiAAEAgAEsAATCBEABLAAEwwQAASwAASoAAQC"
        "AAQwABMLEQAEMAAEwAAMMAAEKAAE0AAEKAAEAgAEyAAESAEEyAAESAEEyAAEwAAEMAEE2AATFkkAExkIABMVCAAE"
        "GAEEMAEEMAAEIAEEMAAEKAAEaAEEgAEESAAEYAAEIAAEGAAEWAAEMAAEmACAFgAAAAAAAAA=",
        "AQAAAACAAABQAAAALwAAAA==IhcAAQASHgcAIwAkCAATKAgAEy8IABM2CAATOggAEz4IABNBCACARAAAAAAAAAA=",
    ),
    "LZMA": (
        "AQAAAACAAAA4AQAAoAAAAA==/Td6WFoAAAFpIt42A8BnuAIhARYAAAAAscF2YuABNwBfXQAAa7pZRCYHDuT5heC/"
        "Q+CtOsGnsHfCmkqvP2SYPu3Y9RAR6pv/G+o3RQM8TYwOFTBFcrrk6FbH4DISDcNTJnxfstc9fhjuzDi+J6/zMjaC"
        "p45CfDeOVYfJEeibGWbICgAAPDC6lAABe7gCAAAAgaIOKD4wDYsCAAAAAAFZWg==",
        "AQAAAACAAAAgAgAAoAAAAA==/Td6WFoAAAFpIt42A8BloAQhARYAAAAAYvj0t+ACHwBdXQAAan77E3KJgx5m7GGu"
        "7q3SrSNe/RWlGThqUY8Pg+5a8PJOY6cuI3FTksnpNICbYEuOgMj05A6y+Yjo6EFtIAswQ0XxllHSEkGrjjdbpaI/"
        "DH34BxX8e37q6fMhzPcAAAAAcH5M9AABeaAEAAAAFYA9ED4wDYsCAAAAAAFZWg==",
        "AQAAAACAAABQAAAAVAAAAA==/Td6WFoAAAFpIt42AsAhUCEBFgB8SS0a4ABPABldAAuANFJpF3rHFuDEmgPkiB/2"
        "t4siyrDHNgUAAAAANFBWowABMVBt47CNkEKZDQEAAAAAAVla",
    ),
}


def file(packer: str) -> str:
    points, corners, ends = WRITTEN[packer]
    none = "AAAAAACAAAAAAAAA"  # as VTK writes an empty array

    def cells(kind: str, corners: str, ends: str) -> str:
        return (
            f'<{kind}><DataArray type="Int64" Name="connectivity" format="binary">{corners}'
            f'</DataArray><DataArray type="Int64" Name="offsets" format="binary">{ends}'
            f"</DataArray></{kind}>"
        )

    return (
        '<?xml version="1.0"?><VTKFile type="PolyData" version="0.1" byte_order="LittleEndian" '
        f'header_type="UInt32" compressor="vtk{packer}DataCompressor"><PolyData><Piece '
        'NumberOfPoints="26" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="10" '
        'NumberOfPolys="0"><Points><DataArray type="Float32" Name="Points" '
        f'NumberOfComponents="3" format="binary">{points}</DataArray></Points>'
        + cells("Strips", corners, ends)
        + cells("Polys", none, none)
        + "</Piece></PolyData></VTKFile>"
    )


@pytest.mark.parametrize("packer", list(WRITTEN))
def test_packed_files_of_vtk_are_read(tmp_path: Path, packer: str) -> None:
    path = tmp_path / "ball.vtp"
    path.write_text(file(packer))
    vertices, faces = meshes.arrays(path, unit="mm")
    ball = trimesh.Trimesh(vertices, faces, process=False)
    assert ball.is_volume
    assert ball.volume > 0
    assert (len(vertices), len(faces)) == (26, 48)
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 0.030, rtol=1e-6)


@pytest.mark.parametrize("packer", list(WRITTEN))
def test_damaged_ones_are_refused(tmp_path: Path, packer: str) -> None:
    path = tmp_path / "ball.vtp"
    points = WRITTEN[packer][0]
    for damaged in (points[:-8], points[:60] + points[80:], points[:50] + "////" + points[54:]):
        path.write_text(file(packer).replace(points, damaged))
        with pytest.raises(meshes.MeshError, match=r"damaged|cut off|not finite"):
            meshes.arrays(path, unit="mm")


def test_an_lz4_block_by_its_description() -> None:
    """Five literals; a match of 3 back, 7 long, that overlaps itself; 20 literals at last."""
    last = bytes(range(20))
    block = bytes([0x53]) + b"abcde" + bytes([3, 0]) + bytes([0xF0, 5]) + last
    whole = b"abcde" + b"cdecdec" + last
    assert lz4_block(block, len(whole)) == whole
    for length in range(len(block)):
        with pytest.raises(meshes.MeshError):
            lz4_block(block[:length], len(whole))
    for size in (0, len(whole) - 1, len(whole) + 1):
        with pytest.raises(meshes.MeshError):
            lz4_block(block, size)
    for back in (0, 6):  # nothing, and before the beginning
        with pytest.raises(meshes.MeshError, match="damaged"):
            lz4_block(block.replace(bytes([3, 0]), bytes([back, 0])), len(whole))
    with pytest.raises(meshes.MeshError, match="damaged"):
        unxz(b"not xz at all", 5)
