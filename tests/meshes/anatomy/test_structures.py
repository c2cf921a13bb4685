"""Structures: closed surfaces within half a voxel, of the voxels' volume; files and folders."""

from __future__ import annotations

import time
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

import meshes
from meshes.anatomy.smooth import FARTHEST, label_surface
from tests.support import label_files as maps
from tests.support import volume_files as files

UNIT = np.diag([1e-3, 1e-3, 1e-3, 1.0])


def centred(n: int) -> np.ndarray:
    """(n, n, n, 3) voxel indices about a middle that is on no symmetry of the grid."""
    return np.stack(np.indices((n, n, n)), axis=-1) - (n / 2 - 0.7)


def shapes() -> dict[str, np.ndarray]:
    p = centred(28)
    rng = np.random.default_rng(3)
    return {
        "ball": np.linalg.norm(p, axis=-1) < 9.2,
        "plane": p @ [0.1, 0.15, 0.98] < 0.3,
        "sheet": np.abs(p @ [0.36, 0.48, 0.8]) < 0.5,
        "straight sheet": np.abs(p[..., 1]) < 0.6,
        "straight tube": (np.abs(p[..., 1]) < 0.6) & (np.abs(p[..., 2]) < 0.6),
        "oblique tube": np.linalg.norm(np.cross(p, [0.6, 0.48, 0.64]), axis=-1) < 0.9,
        "shell": np.abs(np.linalg.norm(p, axis=-1) - 9.0) < 0.6,
        "one voxel": np.abs(p).max(axis=-1) < 0.6,
        "noise": rng.random((16, 16, 16)) < 0.4,
        "everything": np.ones((5, 6, 7), dtype=bool),
    }


def windings(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Winding numbers by the solid angles of the triangles (Van Oosterom and Strackee)."""
    found = []
    for part in np.array_split(points, len(points) // 200 + 1):
        a, b, c = (vertices[faces][None, :, n] - part[:, None] for n in range(3))
        la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
        volumes = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
        rest = la * lb * lc + sum(
            np.einsum("pfi,pfi->pf", x, y) * z for x, y, z in ((a, b, lc), (b, c, la), (c, a, lb))
        )
        found.append(np.arctan2(volumes, rest).sum(axis=1) / (2 * np.pi))
    return np.concatenate(found)


@pytest.mark.parametrize("name", list(shapes()))
def test_a_surface_is_closed_and_parts_the_voxels_as_the_map_does(name: str) -> None:
    inside = shapes()[name]
    vertices, faces = label_surface(inside, UNIT)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    points = np.argwhere(np.pad(inside, 1) >= 0) - 1  # and a layer around
    near = cKDTree(vertices * 1e3).query(points)[0] < 1.8
    points = points[near][:: max(1, near.sum() // 300)]
    padded = np.pad(inside, 1)
    expected = padded[tuple((points + 1).T)]
    assert expected.any()
    assert not expected.all()
    np.testing.assert_allclose(windings(vertices * 1e3, faces, points), expected, atol=1e-6)


@pytest.mark.parametrize("name", list(shapes()))
def test_no_vertex_is_farther_from_the_border_than_said(name: str) -> None:
    """The border is the union of voxel faces, found here face by face."""
    inside = np.pad(shapes()[name], 1)
    vertices, _faces = label_surface(shapes()[name], UNIT)
    squares = []  # middle and axis of each face between a voxel inside and one outside
    for axis in range(3):
        lower = np.argwhere(np.diff(inside.astype(np.int8), axis=axis) != 0) - 1.0
        lower[:, axis] += 0.5
        squares.append(np.column_stack([lower, np.full(len(lower), axis)]))
    border = np.concatenate(squares)
    tree = cKDTree(border[:, :3])
    for point in vertices * 1e3:
        around = border[tree.query_ball_point(point, 1.5)]
        away = np.abs(around[:, :3] - point)
        rows = np.arange(len(around))
        across = away[rows, around[:, 3].astype(int)].copy()
        away = np.maximum(away - 0.5, 0.0)  # within the square
        away[rows, around[:, 3].astype(int)] = across
        assert np.linalg.norm(away, axis=1).min() <= FARTHEST + 1e-9


@pytest.mark.parametrize("name", list(shapes()))
def test_the_volume_is_that_of_the_voxels_and_thin_parts_stay_whole(name: str) -> None:
    inside = shapes()[name]
    vertices, faces = label_surface(inside, UNIT)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.volume * 1e9 == pytest.approx(np.count_nonzero(inside), rel=0.01)
    if "sheet" in name or "tube" in name:
        if name != "oblique tube":
            assert mesh.body_count == 1
        # In the middle, away from its rims, it is about as thick as a voxel's volume says.
        report = meshes.health(vertices, faces, examine=10**6)
        assert report.wall is None or report.wall > 0.35e-3


@pytest.mark.parametrize("seed", range(4))
def test_no_triangles_cross_each_other_wherever_vertices_lie_between_their_voxels(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Vertices at random places on their grid lines: harder than any smoothing."""
    from meshes.anatomy import smooth

    rng = np.random.default_rng(seed)
    random = rng.random((15, 15, 15)) < rng.uniform(0.2, 0.8)
    spread = 0.5 - FARTHEST, 0.5 + FARTHEST
    for name, pick in (
        ("smoothed", None),
        ("anywhere", lambda lower, *_: rng.uniform(*spread, len(lower))),
        ("at the ends", lambda lower, *_: rng.choice(spread, len(lower))),
    ):
        with monkeypatch.context() as patched:
            if pick is not None:
                patched.setattr(smooth, "_smoothed", pick)
                patched.setattr(smooth, "_filled", lambda share, *_: share)
            report = meshes.health(*label_surface(random, UNIT), examine=10**9)
        assert report.exact
        assert report.sound, (name, [one.text for one in report.findings])


def rms_angle(vertices: np.ndarray, faces: np.ndarray, wanted: np.ndarray) -> float:
    """[degree] of the faces' normals to those that are wanted, by area."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    cosines = np.clip((mesh.face_normals * wanted).sum(axis=1), -1.0, 1.0)
    return float(np.sqrt(np.average(np.degrees(np.arccos(cosines)) ** 2, weights=mesh.area_faces)))


def test_a_ball_is_round_and_a_plane_is_flat() -> None:
    p = centred(48)
    inside = np.linalg.norm(p, axis=-1) < 20.0
    vertices, faces = label_surface(inside, np.eye(4))
    middle = 48 / 2 - 0.7
    away = np.linalg.norm(vertices - middle, axis=1) - 20.0
    assert away.std() < 0.08  # [voxel]; 0.29 without smoothing
    outwards = vertices[faces].mean(axis=1) - middle
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    assert rms_angle(vertices, faces, outwards) < 5.0  # 20 without smoothing
    normal = np.array([0.36, 0.48, 0.8])
    vertices, faces = label_surface(p @ normal < 0.1, np.eye(4))
    inner = (np.abs(vertices - middle) < 16).all(axis=1)
    assert ((vertices - middle) @ normal - 0.1)[inner].std() < 0.06


def test_smoothing_goes_along_with_the_grid(tmp_path: Path) -> None:
    """The surface of a turned, mirrored, oblong grid is that of the straight one, transformed."""
    inside = shapes()["ball"]
    T = files.affine(files.TURN @ np.diag([0.8, 1.0, -1.25]), inside.shape)
    straight, faces = label_surface(inside, np.eye(4))
    turned, mirrored = label_surface(inside, T)
    np.testing.assert_allclose(turned, straight @ T[:3, :3].T + T[:3, 3], atol=1e-9)
    np.testing.assert_array_equal(mirrored, faces[:, ::-1])
    assert trimesh.Trimesh(turned, mirrored, process=False).volume > 0


@pytest.mark.parametrize("ending", ["seg.nrrd", "nii.gz", "mha", "mgz"])
def test_all_labels_of_a_file_lie_in_one_frame(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"x.{ending}"
    if ending == "seg.nrrd":
        maps.write_seg_nrrd(path)
    else:
        write = {"nii.gz": files.write_nifti, "mha": files.write_metaimage}
        write.get(ending, files.write_mgh)(path, maps.LABELS, maps.T_MM)
    stages: list[tuple[float, str]] = []
    found = meshes.structures(path, progress=lambda share, text: stages.append((share, text)))
    assert [one.label for one in found] == [1, 2, 5, 9]
    for one in found:
        assert one.frame == "RAS"
        mesh = trimesh.Trimesh(one.vertices, one.faces, process=False)
        assert mesh.is_volume
        voxels = np.argwhere(one.label == maps.LABELS)
        centre = maps.T_MM[:3, :3] @ voxels.mean(axis=0) + maps.T_MM[:3, 3]
        # The diagonals of the triangles are not symmetric, and smoothing follows them.
        np.testing.assert_allclose(mesh.center_mass * 1e3, centre, atol=0.05)
        expected = len(voxels) * abs(np.linalg.det(maps.T_MM[:3, :3]))
        assert mesh.volume * 1e9 == pytest.approx(expected, rel=0.01)
    assert ending != "seg.nrrd" or [one.name for one in found] == list(maps.NAMES.values())
    shares = [share for share, _text in stages]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)


@pytest.mark.parametrize(
    ("chosen", "names"),
    [
        ([5], ["tube"]),
        (["5"], ["tube"]),
        (["sheet", 1], ["Left kidney", "sheet"]),
        (["left KIDNEY", 1], ["Left kidney"]),
    ],
)
def test_labels_are_chosen_by_number_or_name(
    tmp_path: Path, chosen: list[int | str], names: list[str]
) -> None:
    path = maps.write_seg_nrrd(tmp_path / "x.seg.nrrd")
    assert [one.name for one in meshes.structures(path, chosen)] == names


@pytest.mark.parametrize(
    ("chosen", "why"), [(7, "no label 7"), ("shete", "did you mean 'sheet'"), (0, "no label 0")]
)
def test_labels_that_are_not_there_are_refused(tmp_path: Path, chosen: int | str, why: str) -> None:
    path = maps.write_seg_nrrd(tmp_path / "x.seg.nrrd")
    with pytest.raises(meshes.MeshError) as caught:
        meshes.structures(path, [chosen])
    assert why in str(caught.value)
    assert "choose of 1 Left kidney, 2 sheet, 5 tube, 9 drop" in str(caught.value)


def test_too_many_triangles_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = maps.write_seg_nrrd(tmp_path / "x.seg.nrrd")
    monkeypatch.setattr("meshes.anatomy.structures.MOST_TRIANGLES", 1500)
    with pytest.raises(meshes.MeshError, match="choose some of its 4 labels"):
        meshes.structures(path)
    assert len(meshes.structures(path, [9])) == 1


def test_a_mesh_file_is_one_structure_and_a_folder_one_a_file(tmp_path: Path) -> None:
    for name, mesh, frame in (("b.stl", "cube", "LPS"), ("a.ply", "torus", "LPS")):
        meshes.save(tmp_path / name, *meshes.arrays(mesh), unit="mm", frame=frame, overwrite=False)
    (one,) = meshes.structures(tmp_path / "b.stl", unit="mm")
    assert (one.name, one.label, one.frame, one.colour) == ("b", None, "LPS", None)
    found = meshes.structures(tmp_path, unit="mm")
    assert [one.name for one in found] == ["a", "b"]
    np.testing.assert_allclose(np.ptp(found[0].vertices, axis=0), [0.08, 0.08, 0.02], atol=1e-6)
    assert [one.name for one in meshes.structures(tmp_path, ["b"], unit="mm")] == ["b"]
    with pytest.raises(meshes.MeshError, match="no structure 'c': choose of a, b"):
        meshes.structures(tmp_path, ["c"], unit="mm")
    (cube,) = meshes.structures("cube")
    assert cube.name == "cube"
    with pytest.raises(meshes.MeshError, match="label maps only"):
        meshes.structures(tmp_path / "b.stl", unit="mm", spacing=(1e-3, 1e-3, 1e-3))


def test_a_folder_of_both_frames_becomes_one_and_an_unknown_one_is_refused(tmp_path: Path) -> None:
    vertices, faces = meshes.arrays("l-block")
    for name, frame in (("left.stl", "LPS"), ("right.ply", "RAS")):
        meshes.save(tmp_path / name, vertices, faces, unit="mm", frame=frame, overwrite=False)
    left, right = meshes.structures(tmp_path, unit="mm")
    assert (left.frame, right.frame) == ("RAS", "RAS")
    np.testing.assert_allclose(
        left.vertices.mean(axis=0) * [-1, -1, 1], right.vertices.mean(axis=0), atol=1e-3
    )
    meshes.save(tmp_path / "who.off", vertices, faces, unit="mm", frame=None, overwrite=False)
    with pytest.raises(meshes.MeshError, match="'who' does not say its patient frame"):
        meshes.structures(tmp_path, unit="mm")


def test_label_maps_in_a_folder_of_meshes_are_left_out_with_a_warning(tmp_path: Path) -> None:
    meshes.save(tmp_path / "a.stl", *meshes.arrays("cube"), unit="mm", frame=None, overwrite=False)
    maps.write_seg_nrrd(tmp_path / "case.seg.nrrd")
    with pytest.warns(UserWarning, match=r"and not case\.seg\.nrrd: give the file itself"):
        assert [one.name for one in meshes.structures(tmp_path, unit="mm")] == ["a"]


def test_files_of_one_stem_keep_their_endings_and_an_empty_folder_is_refused(
    tmp_path: Path,
) -> None:
    with pytest.raises(meshes.MeshError, match="no mesh files"):
        meshes.structures(tmp_path)
    for name in ("a.stl", "a.ply"):
        meshes.save(tmp_path / name, *meshes.arrays("cube"), unit="mm", frame=None, overwrite=False)
    assert [one.name for one in meshes.structures(tmp_path, unit="mm")] == ["a.ply", "a.stl"]


@pytest.mark.slow
def test_fifteen_labels_of_256_cubed_take_less_than_30_s(tmp_path: Path) -> None:
    """To surfaces ready for fixtures; in processor time, as machines are shared."""
    import vf

    rng = np.random.default_rng(0)
    p = np.stack(np.indices((256, 256, 256), dtype=np.float32), axis=-1)
    values = np.zeros((256, 256, 256), dtype=np.uint8)
    for label in range(1, 16):
        centre, radii = rng.uniform(40, 216, 3), rng.uniform(15, 40, 3)
        values[(((p - centre.astype("f4")) / radii.astype("f4")) ** 2).sum(axis=-1) < 1] = label
    del p
    keys = maps.slicer_keys([(0, k, f"organ {k}", (k, 2 * k, 3 * k)) for k in range(1, 16)])
    path = files.write_nrrd(tmp_path / "x.seg.nrrd", values, np.diag([0.8] * 3 + [1]), extra=keys)
    begin = time.process_time()
    found = meshes.structures(path)
    surfaces = [vf.Surface.from_arrays(one.vertices, one.faces) for one in found]
    assert time.process_time() - begin < 30.0
    assert len(surfaces) == 15
    assert sum(len(one.faces) for one in found) > 300_000


@pytest.mark.slow
def test_grey_and_white_matter_of_an_average_brain(tmp_path: Path) -> None:
    """Folds a few voxels thin that touch each other everywhere, from nilearn's data files."""
    nilearn = pytest.importorskip("nilearn")
    import nibabel

    data = Path(nilearn.__file__).parent / "datasets/data"
    read = [
        nibabel.load(data / f"mni_icbm152_{kind}_tal_nlin_sym_09a_converted.nii.gz")
        for kind in ("gm", "wm")
    ]
    grey, white = (np.asarray(one.dataobj) / np.asarray(one.dataobj).max() for one in read)
    values = np.where(white > 0.5, 2, np.where(grey > 0.5, 1, 0)).astype(np.uint8)
    path = tmp_path / "brain.nii.gz"
    nibabel.save(nibabel.Nifti1Image(values, read[0].affine), path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        listed = meshes.labels(path)
        found = meshes.structures(path)
    for label, one in zip(listed, found, strict=True):
        mesh = trimesh.Trimesh(one.vertices, one.faces, process=False)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume == pytest.approx(label.volume, rel=0.01)
