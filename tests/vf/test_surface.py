"""Surfaces: queries on the whole catalogue, adjacency and edge kinds, inside and outside."""

from __future__ import annotations

import hashlib
import re
import struct

import numpy as np
import pytest
import trimesh

import meshes
import vf
from tests.support import naive

BOUNDARY, FLAT, NON_MANIFOLD = vf.Edge.BOUNDARY, vf.Edge.FLAT, vf.Edge.NON_MANIFOLD
RIDGE, VALLEY = vf.Edge.RIDGE, vf.Edge.VALLEY


def box(size: float = 2.0, at: tuple[float, float, float] = (0, 0, 0)) -> vf.Surface:
    solid = trimesh.creation.box((size,) * 3)
    return vf.Surface.from_arrays(solid.vertices + np.array(at), solid.faces)


def hinge(angle: float) -> vf.Surface:
    """T0 in z = 0 at x < 0, T1 rising from the y axis at `angle` over x > 0; both face up."""
    c, s = np.cos(angle), np.sin(angle)
    return vf.Surface.from_arrays(
        [[0, -1, 0], [0, 1, 0], [-1, 0, 0], [c, 0, s]], [[0, 1, 2], [1, 0, 3]]
    )


# Queries


@pytest.mark.parametrize("name", [*naive.NAMES, pytest.param(naive.HUGE, marks=pytest.mark.slow)])
def test_queries_equal_brute_force_on_the_catalogue(name):
    surface = naive.catalogue(name)
    brute = naive.Brute(surface)
    rng = np.random.default_rng(23)
    centre = 0.5 * (surface.vertices.min(axis=0) + surface.vertices.max(axis=0))
    edge = surface.median_edge
    queries = 12 if len(surface.faces) > 50_000 else 30
    for trial in range(queries):
        if trial % 3 == 0:  # near, on either side
            x = naive.around(surface, rng, 2 * edge)
        elif trial % 3 == 1:  # anywhere in the box, often deep inside
            x = centre + rng.uniform(-0.5, 0.5, 3) * np.ptp(surface.vertices, axis=0)
        else:  # far
            x = centre + surface.size * naive.unit(rng) * rng.uniform(0.5, 3)
        radius = edge * 10.0 ** rng.uniform(-1, 1)
        if trial % 3:
            radius += surface.nearest(x)[0]
        ids, distances = brute.within(x, radius)
        radius = naive.clear_radius(distances, radius, 1e-14)
        case = f"{name}, trial {trial}, x {x.tolist()}, radius {radius!r}"
        contacts = surface.within(x, radius)
        expected = np.sort(ids[distances <= radius])
        assert (np.sort(contacts.triangles) == expected).all(), case
        corners = surface.vertices[surface.faces[contacts.triangles]]
        points, near = naive.closest(corners, x)
        assert np.abs(contacts.distances - near).max(initial=0) < 1e-12, case
        assert np.abs(contacts.points - points).max(initial=0) < 1e-9, case
        assert surface.nearest(x)[0] == pytest.approx(brute.nearest(x), abs=1e-13), case


# What comes in


def test_arrays_are_copied_read_only_and_in_the_callers_order():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)
    faces = np.array([[3, 1, 0], [2, 1, 3], [0, 1, 2], [0, 2, 3]], dtype=np.uint8)
    surface = vf.Surface.from_arrays(vertices, faces)
    assert surface.vertices.dtype == np.float64
    assert (surface.vertices == vertices).all()
    assert (surface.faces == faces).all()
    vertices[:] = 7
    faces[:] = 0
    assert surface.vertices[0, 0] == 0
    assert surface.faces[0, 0] == 3
    for array in (
        surface.vertices, surface.faces, surface.normals, surface.neighbours, surface.edges,
        *surface.tree,
    ):  # fmt: skip
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_size_edge_and_normals():
    surface = vf.Surface.from_arrays([[0, 0, 1], [3, 0, 1], [0, 4, 1], [9, 9, 9]], [[0, 1, 2]])
    assert surface.median_edge == 4.0
    assert surface.size == 5.0  # of what a face uses
    assert (surface.normals == [[0, 0, 1]]).all()
    line = vf.Surface.from_arrays([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]])
    assert (line.normals == 0).all()


TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("vertices", "faces", "words"),
    [
        (TRIANGLE, [[0, 1, 3]], ["3", "0 … 2"]),
        (TRIANGLE, [[0, 1, -1]], ["-1", "0 … 2"]),
        (TRIANGLE, np.empty((0, 3), dtype=int), ["0", "face"]),
        (TRIANGLE, [[0, 1, 2, 0]], ["(1, 4)"]),
        (TRIANGLE, [0, 1, 2], ["(3,)"]),
        (TRIANGLE, [[0.0, 1.0, 2.0]], ["float64"]),
        ([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], ["(3, 2)"]),
        ([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]], [[0, 1, 2]], ["1", "nan"]),
        ([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]], [[0, 1, 2]], ["2", "inf"]),
    ],
)
def test_bad_arrays_are_refused_by_their_value(vertices, faces, words):
    with pytest.raises(ValueError, match=re.escape(words[0])) as refusal:
        vf.Surface.from_arrays(vertices, faces)
    for word in words[1:]:
        assert word in str(refusal.value)


@pytest.mark.parametrize("x", [[0, 0], [0, 0, np.nan], [np.inf, 0, 0], [[0, 0, 0]]])
@pytest.mark.parametrize("query", ["within", "nearest", "winding", "inside"])
def test_bad_points_are_refused(query, x):
    surface = box()
    arguments = (x, 1.0) if query == "within" else (x,)
    with pytest.raises(ValueError, match="three finite numbers"):
        getattr(surface, query)(*arguments)


@pytest.mark.parametrize("radius", [-1e-3, np.nan])
def test_a_ball_without_a_radius_is_refused(radius):
    with pytest.raises(ValueError, match=str(radius)):
        box().within([0, 0, 0], radius)


# Adjacency and edge kinds


@pytest.mark.parametrize(
    ("degrees", "kind"),
    [(90, VALLEY), (10, VALLEY), (170, VALLEY), (1e-3, VALLEY), (0, FLAT),
     (-1e-3, RIDGE), (-10, RIDGE), (-90, RIDGE), (-170, RIDGE)],
)  # fmt: skip
@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e3])
def test_a_hinge_is_a_ridge_or_a_valley_by_its_angle(degrees, kind, scale):
    surface = hinge(np.radians(degrees))
    rng = np.random.default_rng(1)
    moved = scale * (surface.vertices @ naive.rotation(rng).T + rng.normal(size=3))
    surface = vf.Surface.from_arrays(moved, surface.faces)
    if degrees == 0:
        # Rotated coordinates are flat within rounding: 1e-16 of some lengths.
        assert surface.edges[0, 0] == FLAT
    assert surface.edges.tolist() == [[kind, BOUNDARY, BOUNDARY], [kind, BOUNDARY, BOUNDARY]]
    assert surface.neighbours.tolist() == [[1, -1, -1], [0, -1, -1]]


def test_a_hinge_seen_from_below_has_the_other_kind():
    surface = hinge(np.radians(40))
    flipped = vf.Surface.from_arrays(surface.vertices, surface.faces[:, ::-1])
    assert flipped.edges[0, 1] == flipped.edges[1, 1] == RIDGE  # 2→1→0: the edge is the second


def test_edge_kinds_of_solids():
    cube = box()
    diagonal = cube.edges == FLAT
    assert diagonal.sum() == 12  # six sides, each diagonal seen from two faces
    assert (cube.edges[~diagonal] == RIDGE).all()
    hole = vf.Surface.from_arrays(cube.vertices, cube.faces[:, ::-1])
    assert sorted(hole.edges.ravel()) == [VALLEY] * 24 + [FLAT] * 12
    ball = trimesh.creation.icosphere(2)
    assert (vf.Surface.from_arrays(ball.vertices, ball.faces).edges == RIDGE).all()
    block = naive.catalogue("l-block")
    assert set(block.edges.ravel()) == {RIDGE, VALLEY, FLAT}


def test_edges_with_one_and_three_faces():
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]]
    surface = vf.Surface.from_arrays(vertices, [[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    assert (surface.edges[:, 0] == NON_MANIFOLD).all()
    assert (surface.neighbours[:, 0] == -2).all()
    assert (surface.edges[:, 1:] == BOUNDARY).all()
    assert (surface.neighbours[:, 1:] == -1).all()


def test_unwelded_corners_are_no_neighbours():
    surface = hinge(0.5)
    loose = vf.Surface.from_arrays(surface.vertices[surface.faces.ravel()], [[0, 1, 2], [3, 4, 5]])
    assert (loose.edges == BOUNDARY).all()


def test_neighbours_of_a_mesh_against_an_edge_dictionary():
    surface = naive.catalogue("gyroid")
    owners: dict[frozenset[int], list[tuple[int, int]]] = {}
    for i, face in enumerate(surface.faces.tolist()):
        for k in range(3):
            owners.setdefault(frozenset((face[k], face[(k + 1) % 3])), []).append((i, k))
    for i, face in enumerate(surface.faces.tolist()):
        for k in range(3):
            others = [o for o, _ in owners[frozenset((face[k], face[(k + 1) % 3]))] if o != i]
            assert surface.neighbours[i, k] == (others[0] if len(others) == 1 else -2)


@pytest.mark.parametrize("name", ["torus", "saddle-slab", "skull-coarse"])
def test_edge_kinds_agree_with_trimesh(name):
    surface = naive.catalogue(name)
    # In millimetres: trimesh's tolerances are absolute.
    mesh = trimesh.Trimesh(1e3 * surface.vertices, surface.faces, process=False)
    convex = dict(zip(map(frozenset, mesh.face_adjacency.tolist()),
                      mesh.face_adjacency_convex, strict=True))  # fmt: skip
    angle = dict(zip(map(frozenset, mesh.face_adjacency.tolist()),
                     mesh.face_adjacency_angles, strict=True))  # fmt: skip
    checked = 0
    for i in range(len(surface.faces)):
        for k in range(3):
            pair = frozenset((i, int(surface.neighbours[i, k])))
            if angle[pair] > 1e-4:
                assert surface.edges[i, k] == (RIDGE if convex[pair] else VALLEY)
                checked += 1
    assert checked > len(surface.faces)


# Inside


# Far groups of triangles act as one. All that is asked of the number is to tell 0 from 1.
ROUGH = 0.02


def _probe(surface: vf.Surface, rng: np.random.Generator) -> np.ndarray:
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    return rng.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low))


@pytest.mark.parametrize("name", ["skull-coarse", "torus", "gyroid", "gear", "thin-plate"])
def test_winding_equals_the_sum_of_solid_angles(name):
    surface = naive.catalogue(name)
    corners = surface.vertices[surface.faces]
    rng = np.random.default_rng(2)
    for trial in range(30):
        x = _probe(surface, rng) if trial % 2 else naive.around(surface, rng, 1e-3)
        assert surface.winding(x) == pytest.approx(naive.winding(corners, x), abs=ROUGH), x


def test_winding_of_an_open_mesh_equals_the_sum_of_solid_angles():
    whole = naive.catalogue("sphere")
    half = whole.faces[whole.vertices[whole.faces].mean(axis=1)[:, 2] < whole.vertices[:, 2].mean()]
    surface = vf.Surface.from_arrays(whole.vertices, half)
    rng = np.random.default_rng(2)
    for _ in range(60):
        x = _probe(surface, rng)
        exact = naive.winding(surface.vertices[surface.faces], x)
        assert surface.winding(x) == pytest.approx(exact, abs=ROUGH), x


@pytest.mark.parametrize("name", naive.NAMES)
def test_every_catalogue_mesh_is_closed(name):
    assert naive.catalogue(name).closed


@pytest.mark.parametrize("flip", [False, True])
def test_inside_of_a_torus_by_formula(flip):
    major, minor = 30e-3, 10e-3
    solid = trimesh.creation.torus(major, minor, major_sections=128, minor_sections=64)
    faces = solid.faces[:, ::-1] if flip else solid.faces
    surface = vf.Surface.from_arrays(solid.vertices, faces)
    rng = np.random.default_rng(4)
    seen = {False: 0, True: 0}
    for _ in range(400):
        x = rng.uniform(-45e-3, 45e-3, 3) * [1, 1, 0.3]
        ring = np.hypot(np.hypot(x[0], x[1]) - major, x[2])
        if abs(ring - minor) > 0.2e-3:  # the polyhedron differs from the torus by less
            expected = bool(ring < minor)
            assert surface.inside(x) is expected, x.tolist()
            seen[expected] += 1
    assert min(seen.values()) > 50


@pytest.mark.parametrize("name", ["l-block", "star-prism", "skull-coarse", "stairs"])
def test_inside_agrees_with_the_parity_of_a_ray(name):
    surface = naive.catalogue(name)
    corners = surface.vertices[surface.faces]
    rng = np.random.default_rng(6)
    x = np.array([_probe(surface, rng) for _ in range(150)])
    x = x[[surface.nearest(p)[0] > 1e-5 for p in x]]
    expected = [naive.parity(corners, p, naive.unit(rng)) for p in x]
    assert 0 < sum(expected) < len(x)
    assert [surface.inside(p) for p in x] == expected


def test_inside_of_damaged_but_closed_cubes():
    cube = box()
    inside, outside = [0.3, -0.2, 0.9], [0.3, -0.2, 1.1]
    for faces in (cube.faces, cube.faces[::-1], cube.faces[:, ::-1], np.repeat(cube.faces, 2, 0),
                  np.concatenate([cube.faces, cube.faces[:5]]),
                  np.concatenate([cube.faces, cube.faces[:, ::-1]])):  # fmt: skip
        surface = vf.Surface.from_arrays(cube.vertices, faces)
        assert surface.closed
        assert surface.inside(inside)
        assert not surface.inside(outside)
    loose = vf.Surface.from_arrays(cube.vertices[cube.faces.ravel()], np.arange(36).reshape(-1, 3))
    assert loose.closed
    assert loose.inside(inside)
    assert not loose.inside(outside)


def test_a_zero_area_face_does_not_open_a_closed_mesh():
    cube = box()
    surface = vf.Surface.from_arrays(cube.vertices, [*cube.faces.tolist(), [0, 0, 1], [2, 2, 2]])
    assert surface.closed
    assert surface.inside([0, 0, 0])


def test_two_interpenetrating_bodies():
    a, b = box(), box(at=(1.0, 0.4, 0.3))
    both = vf.Surface.from_arrays(
        np.concatenate([a.vertices, b.vertices]), np.concatenate([a.faces, b.faces + 8])
    )
    assert both.closed
    for x in ([-0.8, -0.8, -0.8], [1.9, 0.4, 0.3]):
        assert both.inside(x), x
    # What they have in common cannot be told from the cavity of a hollow body.
    assert both.winding([0.5, 0.5, 0.5]) == pytest.approx(2.0, abs=0.01)
    assert not both.inside([0.5, 0.5, 0.5])
    for x in ([1.5, -0.9, 0.3], [-1.1, 0, 0], [1.0, 1.5, 0.3]):
        assert not both.inside(x), x


def _prism(sides: int, lid: bool) -> vf.Surface:
    """A vessel's wall along z from 0 to 2, closed at the bottom if asked."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vertices = np.concatenate([ring, ring + np.array([0, 0, 2]), [[0, 0, 0]]])
    k = np.arange(sides)
    n = (k + 1) % sides
    faces = [np.stack([k, n, k + sides], 1), np.stack([n, n + sides, k + sides], 1)]
    if lid:
        faces.append(np.stack([n, k, np.full(sides, 2 * sides)], 1))
    return vf.Surface.from_arrays(vertices, np.concatenate(faces))


@pytest.mark.parametrize("lid", [False, True], ids=["tube", "cup"])
def test_an_open_vessel_has_no_inside(lid):
    surface = _prism(16, lid)
    assert not surface.closed
    for x in ([0, 0, 1], [0, 0, 0.01], [0.9, 0, 1], [0, 0, 5]):
        assert not surface.inside(x)


def test_a_double_sheet_has_no_inside():
    sheet = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    faces = [[0, 1, 2], [2, 1, 3]]
    for second in ([[0, 1, 2], [2, 1, 3]], [[0, 2, 1], [2, 3, 1]], [[0, 3, 1], [0, 2, 3]]):
        surface = vf.Surface.from_arrays(sheet, faces + second)
        for x in ([0.4, 0.4, 1e-3], [0.4, 0.4, -1e-3], [0.1, 0.9, 0.0]):
            assert not surface.inside(x), (second, x)


def test_a_fin_leaves_no_free_point_inside():
    """A fin opens the cube: guarding both sides everywhere is allowed, a false inside is not."""
    cube = box()
    fin = [[1.0, 0.0, -0.5], [1.0, 0.0, 0.5], [2.0, 0.0, 0.0]]
    surface = vf.Surface.from_arrays(
        [*cube.vertices.tolist(), *fin], [*cube.faces.tolist(), [8, 9, 10]]
    )
    for x in ([1.3, 0.01, 0.0], [1.3, -0.01, 0.0], [1.01, 0.5, 0.0]):
        assert not surface.inside(x)


@pytest.mark.parametrize("flipped", [[4, 6], [0], [0, 3, 7], [1, 2, 3, 4, 5, 6]])
def test_a_free_point_over_a_flipped_face_is_not_inside(flipped):
    """With inconsistent winding the winding number wanders in free space: just above a flipped
    face of a closed cube it is one. Whoever believes it lets the tool through that face."""
    cube = box()
    faces = cube.faces.copy()
    faces[flipped] = faces[flipped][:, ::-1]
    surface = vf.Surface.from_arrays(cube.vertices, faces)
    rng = np.random.default_rng(9)
    centres = cube.vertices[cube.faces].mean(axis=1)
    for centre, normal in zip(centres, cube.normals, strict=True):
        for height in (1e-3, 0.1, 1.0):
            x = centre + height * normal + 1e-4 * rng.normal(size=3)
            assert not surface.inside(x), (flipped, x.tolist(), surface.winding(x))


def test_a_catalogue_mesh_by_name_is_the_same_surface():
    vertices, faces = meshes.arrays("cube")
    surface = naive.catalogue("cube")
    assert (surface.vertices == vertices).all()
    assert (surface.faces == faces).all()


def test_a_checksum_tells_meshes_apart_and_stays_the_same() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3]])
    surface = vf.Surface.from_arrays(vertices, faces)
    again = vf.Surface.from_arrays(vertices.tolist(), faces.astype(np.int32))
    assert surface.checksum == again.checksum
    # Written down, so that a file recorded today is recognised by a later version.
    parts = [b"(4, 3)<f8", struct.pack("<12d", *vertices.ravel())]
    parts += [b"(2, 3)<i8", struct.pack("<6q", *faces.ravel())]
    assert surface.checksum == hashlib.sha256(b"".join(parts)).hexdigest()
    moved = vertices.copy()
    moved[3, 2] = np.nextafter(1.0, 2.0)
    others = [(moved, faces), (vertices, faces[:, [1, 2, 0]]), (vertices, faces[:1])]
    assert all(vf.Surface.from_arrays(*other).checksum != surface.checksum for other in others)
