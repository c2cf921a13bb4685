"""The PD-tree: its invariants, and its queries against brute force on nasty soups."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh

import vf
from tests.support import naive
from vf.tree import pdtree
from vf.tree.build import LEAF
from vf.tree.nearest import PATIENCE, UNFINISHED, nearest_face


def _soups() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(5)

    def loose(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        corners = np.asarray(corners, dtype=float)
        return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)

    one = rng.normal(size=(1, 3, 3))
    tiny = rng.normal(size=(500, 1, 3)) + 1e-4 * rng.normal(size=(500, 3, 3))
    line = np.cumsum(rng.random((300, 3, 1)), axis=1) * np.array([1.0, 2.0, -1.0])
    steps = 2.0 ** -np.arange(900.0)
    exponential = steps[:, None, None] * (
        np.array([1.0, 0, 0]) + 0.1 * rng.normal(size=(900, 3, 3))
    )
    grid = np.stack(np.meshgrid(*[np.arange(12.0)] * 2, [0.0]), -1).reshape(-1, 1, 3)
    return {
        "one": loose(one),
        "seven": loose(rng.normal(size=(7, 3, 3))),
        "random": loose(rng.normal(size=(700, 3, 3))),
        "all equal": loose(np.repeat(one, 1000, axis=0)),
        "a point, many times": loose(np.ones((200, 3, 3))),
        "duplicates": loose(np.repeat(rng.normal(size=(80, 3, 3)), 9, axis=0)),
        "collinear": loose(line),
        "one huge, many tiny": loose(np.concatenate([1e3 * rng.normal(size=(1, 3, 3)), tiny])),
        "exponentially spaced": loose(exponential),
        "two far clusters": loose(np.concatenate([tiny, tiny[:3] + 1e6])),
        "flat grid": loose(grid + np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])),
        "sorted squares": loose((np.arange(600.0) ** 2)[:, None, None] + rng.random((600, 3, 3))),
    }


SOUPS = _soups()


def _waiting(children: list[range]) -> int:
    """Nodes that wait at a time in a walk that has one child after the other."""
    waiting = np.ones(len(children), dtype=int)
    for node, own in enumerate(children):
        for child in own:
            waiting[child] = waiting[node] + len(own) - 1
    return int(waiting.max())


def _links(tree):
    """Children of every node, and first triangle and count (k, 2), which are its children's.

    Children come after their parents, so a walk from the end finds them done.
    """
    children = [range(0)] * len(tree.nodes)
    triangles = np.empty((len(tree.nodes), 2), dtype=np.int64)
    for node in range(len(children) - 1, -1, -1):
        link = tree.nodes[node, 15]
        assert link == int(link)
        if link > 0:
            first, count = divmod(int(link), 8)
            assert node < first
            assert 2 <= count <= 4
            assert first + count <= len(children)
            own = children[node] = range(first, first + count)
            for child, sibling in itertools.pairwise(own):
                assert triangles[sibling, 0] == triangles[child].sum()
            triangles[node] = triangles[first, 0], triangles[own, 1].sum()
        else:
            triangles[node] = divmod(int(-link), 64)
    return children, triangles


def check_tree(surface: vf.Surface) -> None:
    """Every claim that `Tree` makes about its arrays."""
    tree = surface.tree
    m = len(surface.faces)
    assert (np.sort(tree.order) == np.arange(m)).all()
    corners = surface.vertices[surface.faces]
    assert (tree.corners.reshape(-1, 3, 3) == corners[tree.order]).all()

    children, triangles = _links(tree)
    first, count = triangles.T
    leaves = [node for node, own in enumerate(children) if not own]
    assert triangles[0].tolist() == [0, m]
    assert (count >= 1).all()
    assert (count[leaves] <= LEAF).all()
    covered = np.zeros(m, dtype=int)
    for leaf in leaves:
        covered[first[leaf] : first[leaf] + count[leaf]] += 1
    assert (covered == 1).all()
    # Each node but the root is the child of exactly one.
    assert sorted(itertools.chain(*children)) == list(range(1, len(children)))

    assert _waiting(children) + 1 <= pdtree.STACK

    R = tree.nodes[:, 6:15].reshape(-1, 3, 3)
    assert np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max() < 1e-12
    scale = np.abs(surface.vertices).max()
    for node in range(len(children)):
        own = tree.corners[first[node] : first[node] + count[node]].reshape(-1, 3)
        box = tree.nodes[node]
        outside = np.abs((own - box[:3]) @ R[node].T) - box[3:6]
        assert outside.max() <= 1e-15 * scale + 1e-15, node


@pytest.mark.parametrize("name", list(SOUPS))
def test_invariants(name):
    check_tree(vf.Surface.from_arrays(*SOUPS[name]))


def test_invariants_of_a_real_mesh():
    check_tree(naive.catalogue("skull-coarse"))


@pytest.mark.parametrize("name", list(SOUPS))
def test_queries_equal_brute_force(name):
    vertices, faces = SOUPS[name]
    surface = vf.Surface.from_arrays(vertices, faces)
    brute = naive.Brute(surface)
    corners = vertices[faces]
    rng = np.random.default_rng(17)
    for trial in range(40):
        pick = corners[rng.integers(len(corners))]
        edge = max(np.linalg.norm(pick[1] - pick[0]), 1e-9)
        x = rng.dirichlet((1, 1, 1)) @ pick + naive.unit(rng) * edge * rng.choice([0, 0.1, 1, 30])
        radius = edge * 10.0 ** rng.uniform(-1, 1)
        ids, distances = brute.within(x, radius)
        # Coordinates' rounding decides about triangles exactly on the sphere.
        hair = 1e-9 * radius + 1e-13 * np.abs(pick).max()
        radius = naive.clear_radius(distances, radius, hair)
        expected = np.sort(ids[distances <= radius])
        contacts = surface.within(x, radius)
        case = f"{name}, trial {trial}, x {x.tolist()}, radius {radius!r}"
        assert (np.sort(contacts.triangles) == expected).all(), case
        distance, triangle, point = surface.nearest(x)
        assert distance == pytest.approx(brute.nearest(x), rel=1e-9, abs=hair), case
        assert np.linalg.norm(point - x) == pytest.approx(distance, rel=1e-9, abs=hair), case
        on = naive.closest(corners[[triangle]], x)[1][0]
        assert on == pytest.approx(distance, rel=1e-9, abs=hair), case


@pytest.mark.parametrize("name", list(SOUPS))
def test_the_nearest_triangle_does_not_depend_on_what_was_asked_before(name):
    vertices, faces = SOUPS[name]
    surface = vf.Surface.from_arrays(vertices, faces)
    rng = np.random.default_rng(5)
    # Corners and midpoints of edges, where several triangles are equally near, among others.
    ends = vertices[faces[rng.integers(len(faces), size=30)][:, :2]]
    points = np.concatenate([ends[:, 0], ends.mean(axis=1), ends.mean(axis=1) + 0.1])
    fresh = []
    for x in points:
        surface._guess = -1
        fresh.append(surface.nearest(x))
    for k in rng.permutation(len(points)):
        distance, triangle, point = surface.nearest(points[k])
        assert (distance, triangle) == fresh[k][:2]
        assert (point == fresh[k][2]).all()
    assert surface.nearest(points[0] + 1.0, limit=1e-9)[1] == -1


def test_a_walk_that_takes_long_ends_with_the_same_answer():
    """In the middle of a ball all of the surface is at nearly one distance."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    surface = vf.Surface.from_arrays(ball.vertices, ball.faces)
    x = np.zeros(3)
    nodes, corners, _order, _errors = surface.tree
    assert nearest_face(nodes, corners, x, np.inf, -1, PATIENCE)[1] == UNFINISHED
    assert (x == 0.0).all()
    distance, triangle, point = surface.nearest(x)
    exact = ball.triangles_center[triangle] @ ball.face_normals[triangle]
    assert distance == pytest.approx(ball.face_normals[0] @ ball.triangles_center[0], rel=0.1)
    assert distance == pytest.approx(np.linalg.norm(point), abs=1e-12)
    assert distance == pytest.approx(exact, abs=1e-12)
    assert distance <= (ball.triangles_center * ball.face_normals).sum(axis=1).min() + 1e-12


def test_the_ball_is_closed():
    """Dyadic coordinates: the distance is exact, and a triangle on the sphere counts."""
    surface = vf.Surface.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    x = [0.25, 0.25, 0.5]
    assert len(surface.within(x, 0.5)) == 1
    assert len(surface.within(x, np.nextafter(0.5, 0))) == 0
    assert len(surface.within([0.25, 0.25, 0.0], 0.0)) == 1


@pytest.mark.parametrize("radius", [100.0, 2.0, 1.01])
def test_more_contacts_than_the_first_buffer_holds(radius):
    """The ball around all, whose boxes are taken whole, and balls with boxes on the rim."""
    ball = trimesh.creation.icosphere(subdivisions=5)  # 20,480 triangles
    surface = vf.Surface.from_arrays(ball.vertices, ball.faces)
    x = [0.5, 0.0, 0.0]
    contacts = surface.within(x, radius)
    ids, distances = naive.Brute(surface).within(x, radius)
    ids, distances = ids[distances <= radius], distances[distances <= radius]
    assert len(ids) > 2048
    order = np.argsort(contacts.triangles)
    assert (contacts.triangles[order] == np.sort(ids)).all()
    assert contacts.distances[order] == pytest.approx(distances[np.argsort(ids)], abs=1e-13)


def test_contacts_say_where_they_are_closest_though_the_centre_has_moved_on():
    surface = vf.Surface.from_arrays(*SOUPS["flat grid"])
    corners = surface.vertices[surface.faces]
    x = np.array([3.3, 4.6, 0.7])
    contacts = surface.within(x, 2.0)
    centre = x.copy()
    x += 100.0
    assert len(contacts) > 5
    for row, triangle in enumerate(contacts.triangles):
        point, distances = naive.closest(corners[[triangle]], centre)
        assert contacts.points[row] == pytest.approx(point[0], abs=1e-12)
        assert contacts.distances[row] == pytest.approx(distances[0], abs=1e-12)
        single = vf.closest_point(corners[triangle], centre)
        assert contacts.features[row] == single[1]


@pytest.mark.parametrize(
    "given",
    [
        np.array([[1.0, 9.0], [2.0, 9.0], [3.0, 9.0]])[:, 0],  # a column
        np.array([3.0, 2.0, 1.0])[::-1],
        np.array([1, 2, 3]),
        np.array([1, 2, 3], dtype=np.float32),
        np.array([1.0, 2.0, 3.0], dtype=">f8"),
        [1, 2, 3],
        (1.0, 2.0, 3.0),
    ],
    ids=["column", "reversed", "integers", "single", "big-endian", "list", "tuple"],
)
def test_a_point_may_come_as_any_array(given):
    """The compiled queries are called without numba's look at the types of their arguments."""
    surface = vf.Surface.from_arrays(*SOUPS["flat grid"])
    x = np.array([1.0, 2.0, 3.0])
    kept = np.array(given)
    distance, triangle, point = surface.nearest(given)
    assert (distance, triangle) == surface.nearest(x)[:2]
    assert (point == surface.nearest(x)[2]).all()
    assert (np.asarray(given) == kept).all()
    for radius in (4.0, 4):
        assert (surface.within(given, radius).triangles == surface.within(x, 4.0).triangles).all()
    for limit in (4, np.float32(4.0), np.int64(4)):
        assert surface.nearest(given, limit)[:2] == (distance, triangle)
    assert surface.nearest(given, 1)[1] == -1


def test_nearest_within_a_limit():
    surface = vf.Surface.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    assert surface.nearest([0.2, 0.2, 3.0], limit=3.5)[0] == 3.0
    distance, triangle, point = surface.nearest([0.2, 0.2, 3.0], limit=2.5)
    assert (distance, triangle) == (np.inf, -1)
    assert (point == [0.2, 0.2, 3.0]).all()
