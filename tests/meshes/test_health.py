"""The health report finds what was done to a mesh: exact counts, against other libraries."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

import meshes
import vf
from meshes.builtin.damage import SHARE, damage
from meshes.checks import probe
from meshes.checks.health import health
from meshes.checks.report import MEANING, Health
from meshes.checks.topology import topology

Mesh = tuple[np.ndarray, np.ndarray]


def joined(*parts: Mesh) -> Mesh:
    starts = np.cumsum([0] + [len(v) for v, _ in parts])
    return (
        np.vstack([v for v, _ in parts]),
        np.vstack([f + start for (_, f), start in zip(parts, starts[:-1], strict=True)]),
    )


def ball(radius: float, at: tuple[float, float, float] = (0, 0, 0), inwards: bool = False) -> Mesh:
    mesh = trimesh.creation.icosphere(2, radius)
    faces = np.asarray(mesh.faces, dtype=np.int64)
    return np.asarray(mesh.vertices) + at, faces[:, ::-1] if inwards else faces


def kinds_of(report: Health) -> set[str]:
    return {finding.kind for finding in report.findings}


def injected(mesh: Mesh) -> int:
    return max(1, round(SHARE * len(mesh[1])))


@pytest.mark.parametrize(
    ("name", "genus"),
    [("cube", 0), ("torus", 1), ("gear", 1), ("gyroid", 31), ("skull-coarse", 2), ("stairs", 0)],
)
def test_clean_meshes_are_sound_and_measured_as_trimesh_measures_them(
    name: str, genus: int
) -> None:
    vertices, faces = meshes.arrays(name)
    report = health(vertices, faces)
    other = trimesh.Trimesh(vertices, faces, process=False)
    assert report.sound
    assert report.watertight
    assert report.consistent
    assert report.exact
    assert (report.genus, report.components, report.boundary_lengths) == (genus, 1, ())
    assert report.volume == pytest.approx(other.volume, rel=1e-9)
    assert report.area == pytest.approx(other.area, rel=1e-9)
    assert 2 - 2 * genus == other.euler_number
    np.testing.assert_allclose(report.extents, other.extents)
    lengths = np.linalg.norm(np.diff(vertices[faces[:, [0, 1, 2, 0]]], axis=1), axis=2)
    np.testing.assert_allclose(report.edge_percentiles, np.percentile(lengths, [0, 5, 50, 95, 100]))


@pytest.mark.slow
def test_a_surface_gives_the_same_report() -> None:
    mesh = damage("slivers", meshes.arrays("torus"), 3)
    a, b = health(*mesh), health(vf.Surface.from_arrays(*mesh))
    assert json.dumps(a.as_dict()) == json.dumps(b.as_dict())


def test_unwelded() -> None:
    vertices, faces = meshes.arrays("torus")
    report = health(*damage("unwelded", (vertices, faces)))
    assert report.count("repeated vertices") == 3 * len(faces) - len(vertices)
    assert report.count("boundary loops") == len(faces)
    assert report.components == len(faces)
    loops = next(f for f in report.findings if f.kind == "boundary loops")
    assert "0 are left" in loops.text
    assert not report.watertight


@pytest.mark.parametrize("name", ["torus", "skull-coarse", "gear"])
def test_flipped_duplicated_and_deleted_faces_are_all_found(name: str) -> None:
    mesh = meshes.arrays(name)
    vertices, faces = mesh
    count = injected(mesh)
    flipped = damage("flipped", mesh, 5)
    report = health(*flipped)
    (finding,) = (f for f in report.findings if f.defect)
    assert (finding.kind, finding.count) == ("flipped faces", count)
    assert np.array_equal(finding.ids, np.flatnonzero((flipped[1] != faces).any(axis=1)))

    report = health(*damage("duplicated", mesh, 5))
    (finding,) = (f for f in report.findings if f.defect)
    assert (finding.kind, finding.count) == ("duplicate faces", count)
    assert np.array_equal(finding.ids, len(faces) + np.arange(count))
    assert report.genus == health(*mesh).genus

    holed = damage("holes", mesh, 5)
    report = health(*holed)
    other = trimesh.Trimesh(*holed, process=False)
    rim = trimesh.grouping.group_rows(other.edges_sorted, require_count=1)
    finding = next(f for f in report.findings if f.kind == "boundary loops")
    assert {tuple(sorted(e)) for e in finding.ids.tolist()} == {
        tuple(e) for e in other.edges_sorted[rim].tolist()
    }
    length = np.linalg.norm(np.diff(vertices[other.edges_sorted[rim]], axis=1), axis=2).sum()
    assert sum(report.boundary_lengths) == pytest.approx(length)


def test_inside_out_fin_sheet_and_slivers() -> None:
    mesh = meshes.arrays("torus")
    report = health(*damage("inside-out", mesh))
    assert report.count("inside-out bodies") == 1
    assert report.count("flipped faces") == 0
    assert report.volume == pytest.approx(health(*mesh).volume)

    report = health(*damage("fin", mesh, 2))
    assert report.components == 2
    assert report.count("boundary loops") == 1
    size = float(np.linalg.norm(np.ptp(mesh[0], axis=0)))
    assert report.boundary_lengths[0] == pytest.approx(8 * 0.05 * size)

    half = damage("sheet", mesh)
    report = health(*half)
    assert report.count("boundary loops") == 2
    assert report.genus == 0
    assert report.count("unused vertices") == len(mesh[0]) - len(np.unique(half[1]))

    vertices, faces = damage("slivers", mesh, 2)
    report = health(vertices, faces)
    added = faces[len(mesh[1]) :]
    assert report.count("degenerate faces") + report.count("slivers") == injected(mesh)
    collapsed = (added[:, 2] == added[:, 0]).sum()
    assert collapsed == -(-injected(mesh) // 5)
    noisy = np.arange(len(added)) % 2 == 0
    assert report.count("slivers") == (noisy & (added[:, 2] != added[:, 0])).sum()


def test_holes_that_touch_at_a_vertex_are_one_loop_round_both() -> None:
    # A 4 x 4 grid of squares with two squares missing that share only a corner.
    n = 5
    x, y = np.meshgrid(np.arange(n) * 1e-3, np.arange(n) * 1e-3, indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(n * n)])
    faces = []
    for i in range(n - 1):
        for j in range(n - 1):
            if (i, j) in ((1, 1), (2, 2)):
                continue
            a, b, c, d = i * n + j, (i + 1) * n + j, (i + 1) * n + j + 1, i * n + j + 1
            faces += [(a, b, c), (a, c, d)]
    f = np.array(faces)
    f[::3] = f[::3, ::-1]  # the walk must not lean on the winding
    report = health(vertices, f)
    np.testing.assert_allclose(report.boundary_lengths, [16e-3, 8e-3])
    assert report.count("pinched vertices") == 1
    assert report.genus == 0
    assert report.count("flipped faces") == len(f[::3])


def test_non_manifold_edges_and_pinched_vertices() -> None:
    # A third wing on the edge (0, 1) of two faces; two tetrahedra on one vertex.
    wings = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]]) * 1e-2
    report = health(wings, np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]))
    finding = next(f for f in report.findings if f.kind == "non-manifold edges")
    assert sorted(finding.ids[0].tolist()) == [0, 1]
    assert (finding.count, report.genus, report.components) == (1, None, 1)
    tetra = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 1e-2
    vertices = np.vstack([corners, -corners[1:]])
    other = np.array([0, 4, 5, 6])[tetra][:, ::-1]
    report = health(vertices, np.vstack([tetra, other]))
    assert report.count("pinched vertices") == 1
    assert (report.watertight, report.genus, report.components) == (True, 0, 2)
    assert report.volume == pytest.approx(2 * 1e-6 / 6)


def test_a_moebius_strip_has_one_side() -> None:
    n = 24
    turn = np.linspace(0, 2 * np.pi, n, endpoint=False)
    middle = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    across = 0.2 * np.column_stack(
        [np.cos(turn) * np.cos(turn / 2), np.sin(turn) * np.cos(turn / 2), np.sin(turn / 2)]
    )
    vertices = 0.05 * np.vstack([middle + across, middle - across])
    faces = []
    for k in range(n):
        a, b = k, n + k
        c, d = (k + 1, n + k + 1) if k < n - 1 else (n, 0)
        faces += [(a, b, c), (c, b, d)]
    report = health(vertices, np.array(faces))
    assert report.count("one-sided patches") == 1
    assert (report.genus, len(report.boundary_lengths), report.consistent) == (None, 1, False)


def test_nested_bodies_follow_the_outermost() -> None:
    hollow = joined(ball(0.03), ball(0.02, inwards=True))
    report = health(*hollow)
    assert report.sound
    assert report.count("nested bodies") == 1
    assert report.volume == pytest.approx(
        trimesh.Trimesh(*ball(0.03)).volume - trimesh.Trimesh(*ball(0.02)).volume
    )
    assert health(*damage("inside-out", hollow)).count("inside-out bodies") == 1
    # Side by side, and a box that only overlaps: nobody is inside anybody.
    apart = joined(ball(0.03), ball(0.02, (0.1, 0, 0), inwards=True), ball(0.02, (0.028, 0.028, 0)))
    report = health(*apart)
    assert report.count("nested bodies") == 0
    assert report.count("inside-out bodies") == 1


def brute_pairs(mesh: Mesh) -> set[tuple[int, int]]:
    """Faces that cut each other, by Möller-Trumbore of every edge with every triangle."""
    vertices, faces = mesh
    a, b, c = vertices[faces].transpose(1, 0, 2)
    pairs = set()
    for f, corners in enumerate(faces):
        for k in range(3):
            i, j = corners[k], corners[(k + 1) % 3]
            p, d = vertices[i], vertices[j] - vertices[i]
            h = np.cross(d, c - a)
            det = ((b - a) * h).sum(axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                u = ((p - a) * h).sum(axis=1) / det
                q = np.cross(p - a, b - a)
                w = (q @ d) / det
                t = ((c - a) * q).sum(axis=1) / det
                cut = (u > 0) & (w > 0) & (u + w < 1) & (t > 0) & (t < 1)
            cut &= ~(faces == i).any(axis=1) & ~(faces == j).any(axis=1)
            pairs |= {(min(f, g), max(f, g)) for g in np.flatnonzero(cut).tolist()}
    return pairs


def test_self_intersections_as_brute_force_finds_them() -> None:
    mesh = damage("interpenetrating", ball(0.03), 1)
    wanted = brute_pairs(mesh)
    report = health(*mesh)
    finding = next(f for f in report.findings if f.kind == "self-intersections")
    assert len(wanted) > 20
    assert finding.count == len(wanted)
    assert set(finding.ids.tolist()) == {f for pair in wanted for f in pair}
    sampled = health(*mesh, examine=100)
    assert not sampled.exact
    assert "100 sampled faces" in str([f.text for f in sampled.findings])
    assert health(*mesh, examine=0).count("self-intersections") == 0


def tetrahedra(sizes: np.ndarray, places: np.ndarray) -> Mesh:
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    vertices = corners * sizes[:, None, None] + places[:, None, :]
    return vertices.reshape(-1, 3), (faces + 4 * np.arange(len(sizes))[:, None, None]).reshape(
        -1, 3
    )


def crowds(n: int) -> dict[str, Mesh]:
    """Meshes of ``n`` faces of which each one is near, or cuts, all others."""
    rng = np.random.default_rng(0)
    one = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0]])
    apart = np.arange(3 * n).reshape(-1, 3)
    return {
        "random": (rng.uniform(-0.05, 0.05, (3 * n, 3)), apart),
        "nearly one": (np.tile(one, (n, 1)) + rng.uniform(-1e-4, 1e-4, (3 * n, 3)), apart),
        "one": (np.tile(one, (n, 1)), apart),
        "overlapping bodies": tetrahedra(
            np.full(n // 4, 0.05), rng.uniform(-1e-3, 1e-3, (n // 4, 3))
        ),
        "nested bodies": tetrahedra(np.linspace(0.02, 0.05, n // 4), np.zeros((n // 4, 3))),
    }


@pytest.mark.parametrize("name", list(crowds(4)))
def test_a_crowd_of_faces_takes_no_more_than_its_share_and_that_is_told(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = crowds(400)[name]
    whole = health(*mesh)
    assert whole.exact
    assert not {"crowded faces", "undecided bodies"} & kinds_of(whole)
    monkeypatch.setattr(probe, "effort", lambda _faces: 20_000)
    report = health(*mesh)
    assert 0 < report.examined < len(mesh[1])
    found = next(f for f in report.findings if f.kind == "crowded faces")
    assert found.count == report.examined
    assert f"only {report.examined} of {len(mesh[1])} were" in found.text
    json.dumps(report.as_dict())
    pairs = whole.count("self-intersections")
    assert report.count("self-intersections") <= pairs
    if "bodies" not in name:
        return
    # Which lie inside which is not known: nothing is said of it, and nothing is turned.
    assert report.count("undecided bodies") == 100
    assert report.volume is None
    assert not report.sound
    assert not {"inside-out bodies", "nested bodies"} & kinds_of(report)
    turned = mesh[0], mesh[1][:, ::-1]
    mended = meshes.repair(*turned)
    assert mended.changes.turned_bodies == 0
    assert any("100 closed bodies, not turned" in line for line in mended.changes.left)


def test_a_million_triangles_that_overlap_may_take_a_bounded_share_each() -> None:
    """What a surface takes is far from what is allowed, and that is far from a square."""
    for n in (1_000, 1_000_000):
        assert 50 * n < probe.effort(n) < 1_000 * n + 1e8


def test_one_and_many_are_worded_as_such() -> None:
    one = {f.kind: f.text for f in health(np.eye(3), np.array([[0, 1, 2]])).findings}
    assert one["boundary loops"].startswith("1 boundary loop,")
    hollow = joined(ball(0.03), ball(0.01, inwards=True))
    (told,) = health(*hollow).findings
    assert told.text == "1 closed body lies inside another"
    lid = np.vstack([hollow[1][1:], hollow[1][1:2]])  # a hole, and a face twice
    texts = [f.text for f in health(hollow[0], lid, examine=0).findings]
    assert "1 face repeats another" in texts
    changes = meshes.repair(hollow[0], lid).changes
    assert "dropped 1 repeated face" in changes.lines()
    assert "1 boundary loop: holes are not filled" in changes.left
    assert "1 open patch has no outside: see which way it looks" in changes.left


@pytest.mark.parametrize(("name", "wall"), [("thin-plate", 0.5e-3), ("cube", 0.04)])
def test_walls_of_known_thickness(name: str, wall: float) -> None:
    vertices, faces = meshes.arrays(name)
    assert health(vertices, faces).wall == pytest.approx(wall, rel=1e-9)
    turned = damage("flipped", damage("inside-out", (vertices, faces)))
    assert health(*turned).wall == pytest.approx(wall, rel=1e-9)


def test_the_skulls_bone_is_two_millimetres_thick() -> None:
    report = health(*meshes.arrays("skull"))
    assert 1.9e-3 < report.wall < 2.05e-3
    thin = meshes.arrays("thin-plate")[0] * (1, 1, 0.1)
    assert health(thin, meshes.arrays("thin-plate")[1]).count("thin walls") > 0


def test_every_finding_has_a_meaning_and_json() -> None:
    mesh = joined(damage("slivers", meshes.arrays("torus")), damage("holes", ball(0.03)))
    report = health(*mesh)
    assert {"degenerate faces", "boundary loops", "non-manifold edges"} <= kinds_of(report)
    for finding in report.findings:
        assert finding.meaning
        assert f"{finding.count:,}" in finding.text
    back = json.loads(json.dumps(report.as_dict(most_ids=3)))
    assert back["sound"] is False
    assert {f["kind"] for f in back["findings"]} == kinds_of(report)
    assert all(len(f["ids"]) <= 3 for f in back["findings"])
    with pytest.raises(ValueError, match=r"unknown finding 'rust': choose one of .*slivers"):
        report.count("rust")
    assert set(MEANING) >= kinds_of(report)


@pytest.mark.parametrize(
    ("vertices", "faces", "reason"),
    [
        (np.zeros((3, 2)), [[0, 1, 2]], r"\(3, 2\)"),
        (np.zeros((3, 3)), [[0, 1]], r"\(1, 2\)"),
        (np.zeros((3, 3)), [[0.0, 1.0, 2.0]], "float64"),
        (np.zeros((3, 3)), np.empty((0, 3), int), "without faces"),
        (np.zeros((3, 3)), [[0, 1, 7]], "7, of 3"),
        (np.full((3, 3), np.nan), [[0, 1, 2]], "the first is vertex 0"),
    ],
)
def test_no_mesh_no_report(vertices: np.ndarray, faces: object, reason: str) -> None:
    with pytest.raises(meshes.MeshError, match=reason):
        health(vertices, faces)


def test_a_mesh_of_nothing_but_degenerate_faces_is_reported_too() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]]) * 1e-2
    report = health(vertices, np.array([[0, 1, 2], [0, 0, 1], [1, 1, 1]]))
    assert report.count("degenerate faces") == 3
    assert report.components == 1


@pytest.mark.parametrize("seed", range(6))
def test_adjacency_of_random_soups_against_a_dictionary(seed: int) -> None:
    rng = np.random.default_rng(seed)
    faces = np.array([rng.choice(14, 3, replace=False) for _ in range(25)])
    t = topology(faces, 14)
    table: dict[tuple[int, int], list[int]] = {}
    for f, face in enumerate(faces.tolist()):
        for k in range(3):
            table.setdefault(tuple(sorted((face[k], face[(k + 1) % 3]))), []).append(3 * f + k)
    assert t.edges == len(table)
    assert t.boundary_edges == sum(len(h) == 1 for h in table.values())
    assert t.non_manifold_edges == sum(len(h) > 2 for h in table.values())
    for halves in table.values():
        for h in halves:
            if len(halves) == 2:
                assert t.opposite[h] == sum(halves) - h
            else:
                assert t.opposite[h] == (-1 if len(halves) == 1 else -2)
    # Every rim edge lies in one loop, and consecutive half-edges of a loop meet.
    rim = [h for halves in table.values() if len(halves) == 1 for h in halves]
    assert len(set(t.boundary.tolist())) == len(t.boundary)
    assert set(rim) <= set(t.boundary.tolist())
    for start, end in zip(t.boundary_starts[:-1], t.boundary_starts[1:], strict=True):
        loop = t.boundary[start:end]
        ends = [
            {int(faces[h // 3, h % 3]), int(faces[h // 3, (h % 3 + 1) % 3])} for h in loop.tolist()
        ]
        for one, next_ in zip(ends, ends[1:] + ends[:1], strict=True):
            assert one & next_
