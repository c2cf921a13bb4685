"""Geometric queries for `bench peers`, for every library that is installed.

Peers get coordinates in millimetres relative to the mesh's centre: trimesh has absolute tolerances
that are too coarse in metres, and Open3D and fcpw compute in single precision. Query points are
converted to the library's types beforehand, which is not timed.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import vf
from app.bench.tools.reference import Centroids, distances

FloatArray = NDArray[np.float64]
Near = tuple[float, int]  # distance [mm], triangle

CONTACTS = 1_000_000  # upper bound of the triangles in a ball
TOLERANCE = 1e-3
"""Tolerance of distances [mm]: a micrometre, the resolution of single precision here."""


@dataclass(frozen=True)
class Peer:
    """One way to make a query.

    Attributes:
        name: for the table.
        ask: makes query k; this is timed.
        read: converts its result into a comparable answer; not timed.
        note: remark for a fair comparison.
        ours: whether it is `vf`.
    """

    name: str
    ask: Callable[[int], Any]
    read: Callable[[Any], Any]
    note: str = ""
    ours: bool = False


@dataclass(frozen=True)
class Bodies:
    """The mesh and the query points in the coordinates of `vf` and of the peers.

    Attributes:
        surface: arm base frame [m].
        middle: (3,) origin of the peers' coordinates, arm base frame [m].
        points: (k, 3) arm base frame [m].
        vertices: (n, 3) peers' coordinates [mm].
        centroids: the reference, also used as scipy's peer.
        missing: why a library is missing, by its name.
    """

    surface: vf.Surface
    middle: FloatArray
    points: FloatArray
    vertices: FloatArray
    centroids: Centroids
    missing: dict[str, str]

    @staticmethod
    def of(surface: vf.Surface, points: FloatArray) -> Bodies:
        """Bodies of a surface for query points (k, 3) [m]."""
        middle = 0.5 * (surface.vertices.min(axis=0) + surface.vertices.max(axis=0))
        vertices = (surface.vertices - middle) * 1e3
        return Bodies(surface, middle, points, vertices, Centroids(vertices, surface.faces), {})

    @property
    def queries(self) -> FloatArray:
        """The points (k, 3) in the peers' coordinates [mm]."""
        return (self.points - self.middle) * 1e3

    def module(self, name: str, package: str) -> Any | None:
        """An optional library, or None with the reason in `missing`."""
        try:
            return importlib.import_module(name)
        except Exception as error:  # also of a broken installation
            self.missing[package] = " ".join(f"{type(error).__name__}: {error}".split())[:100]
            return None


class Holders:
    """The data structure of each library."""

    def __init__(self, bodies: Bodies, say: Callable[[str], None]) -> None:
        self._bodies = bodies
        self._faces = bodies.surface.faces
        say("building coal's tree")
        self.coal = bodies.module("coal", "coal")
        if self.coal is not None:
            self.coal_mesh = self.coal.BVHModelOBBRSS()
            self.coal_mesh.beginModel(len(self._faces), len(bodies.vertices))
            self.coal_mesh.addVertices(bodies.vertices)
            self.coal_mesh.addTriangles(self._faces.astype(np.uint32))
            self.coal_mesh.endModel()
        say("building trimesh's tree")
        self.trimesh = bodies.module("trimesh", "trimesh")
        if self.trimesh is not None and bodies.module("rtree", "rtree (for trimesh)") is None:
            self.trimesh = None
        if self.trimesh is not None:
            self.trimesh_mesh = self.trimesh.Trimesh(bodies.vertices, self._faces, process=False)
            self.trimesh.proximity.closest_point(self.trimesh_mesh, bodies.queries[:1])
        say("building Open3D's tree")
        self.open3d = bodies.module("open3d", "open3d")
        if self.open3d is not None:
            tensor = self.open3d.core.Tensor
            self.open3d_scene = self.open3d.t.geometry.RaycastingScene()
            self.open3d_scene.add_triangles(
                tensor(bodies.vertices.astype(np.float32)), tensor(self._faces.astype(np.uint32))
            )
        say("building libigl's tree")
        self.igl = bodies.module("igl", "libigl")
        if self.igl is not None:
            self.igl_tree = self.igl.AABB()
            self.igl_tree.init(bodies.vertices, self._faces)
        say("building fcpw's tree")
        self.fcpw = bodies.module("fcpw", "fcpw")
        if self.fcpw is not None:
            self.fcpw_scenes = {}
            for wide in (False, True):
                scene = self.fcpw.scene_3D()
                scene.set_object_count(1)
                scene.set_object_vertices(np.asfortranarray(bodies.vertices, dtype=np.float32), 0)
                scene.set_object_triangles(np.asfortranarray(self._faces, dtype=np.int32), 0)
                scene.build(self.fcpw.aggregate_type.bvh_surface_area, wide, False)
                self.fcpw_scenes[wide] = scene


def nearest(bodies: Bodies, held: Holders) -> list[Peer]:
    """Nearest triangle and its distance; answers are `Near`."""
    surface, points, queries = bodies.surface, bodies.points, bodies.queries
    peers = [
        Peer(
            "vf: Surface.nearest",
            lambda k: surface.nearest(points[k]),
            lambda r: (r[0] * 1e3, r[1]),
            "double; distance, triangle, point",
            ours=True,
        )
    ]
    if held.fcpw is not None:
        fcpw = held.fcpw
        single = queries.astype(np.float32)
        for wide, scene in held.fcpw_scenes.items():

            def ask_fcpw(k: int, scene: Any = scene) -> Any:
                answer = fcpw.interaction_3D()
                scene.find_closest_point(single[k], answer)
                return answer

            def read_fcpw(k: int, ask: Callable[[int], Any] = ask_fcpw) -> Any:
                answer = ask(k)
                return answer.d, answer.primitive_index, answer.p

            name = "fcpw: find_closest_point" + (", vectorised" if wide else "")
            peers += [
                Peer(
                    name,
                    ask_fcpw,
                    lambda r: (float(r.d), int(r.primitive_index)),
                    "single precision; an object yet to be read",
                ),
                Peer(
                    f"{name}, read",
                    read_fcpw,
                    lambda r: (float(r[0]), int(r[1])),
                    "single precision; distance, triangle, point",
                ),
            ]
    if held.igl is not None:
        rows = [np.ascontiguousarray(q[None]) for q in queries]
        faces, vertices = surface.faces, bodies.vertices
        peers.append(
            Peer(
                "libigl: AABB.squared_distance",
                lambda k: held.igl_tree.squared_distance(vertices, faces, rows[k]),
                lambda r: (float(np.sqrt(r[0][0])), int(r[1][0])),
                "double",
            )
        )
    if held.open3d is not None:
        tensors = [held.open3d.core.Tensor(q[None].astype(np.float32)) for q in queries]
        peers.append(
            Peer(
                "Open3D: compute_closest_points",
                lambda k: held.open3d_scene.compute_closest_points(tensors[k]),
                # The answer has point and triangle, but no distance.
                lambda r: (float("nan"), int(r["primitive_ids"].numpy()[0])),
                "single precision; made for batches",
            )
        )
    if held.coal is not None:
        coal, mesh = held.coal, held.coal_mesh
        poses = [coal.Transform3s(np.eye(3), q) for q in queries]
        origin, speck, request = coal.Transform3s(), coal.Sphere(1e-9), coal.DistanceRequest()

        def ask_coal(k: int) -> Any:
            answer = coal.DistanceResult()
            coal.distance(mesh, origin, speck, poses[k], request, answer)
            return answer

        peers.append(
            Peer(
                "coal: distance, OBBRSS mesh to a point-like sphere",
                ask_coal,
                lambda r: (float(r.min_distance) + 1e-9, int(r.b1)),
                "double",
            )
        )
    peers.append(
        Peer(
            "scipy: cKDTree on centroids, widened, then exact in numpy",
            lambda k: bodies.centroids.nearest(queries[k]),
            lambda r: r,
            "the tree's own answer, the nearest centroid, is another triangle",
        )
    )
    if held.trimesh is not None:
        closest = held.trimesh.proximity.closest_point
        peers.append(
            Peer(
                "trimesh: proximity.closest_point",
                lambda k: closest(held.trimesh_mesh, queries[k : k + 1]),
                lambda r: (float(r[1][0]), int(r[2][0])),
                "double, in mm: its tolerances are absolute",
            )
        )
    return peers


def ball(bodies: Bodies, held: Holders, radius: float) -> list[Peer]:
    """Every triangle cut by the ball of `radius` [m]; answers are sorted arrays of triangles."""
    surface, points, queries = bodies.surface, bodies.points, bodies.queries
    r = radius * 1e3  # [mm]
    peers = [
        Peer(
            "vf: Surface.within",
            lambda k: surface.within(points[k], radius),
            lambda contacts: np.sort(contacts.triangles),
            "double; triangles, the rest when asked for",
            ours=True,
        ),
        Peer(
            "vf: Surface.within, points and distances read",
            lambda k: _everything(surface.within(points[k], radius)),
            np.sort,
            "double; triangles, closest points, features, distances",
            ours=True,
        ),
    ]
    if held.fcpw is not None:
        fcpw = held.fcpw
        spheres = [fcpw.bounding_sphere_3D(q.astype(np.float32), r * r) for q in queries]
        scene = held.fcpw_scenes[False]

        def ask_fcpw(k: int) -> Any:
            found = fcpw.interaction_3D_list()
            scene.intersect(spheres[k], found, False)
            return found

        peers += _objects("fcpw: intersect", ask_fcpw, _fcpw_triangles, "single precision")
        peers.append(
            Peer(
                "fcpw: intersect, triangles and points read",
                lambda k: [(one.primitive_index, one.p) for one in ask_fcpw(k)],
                lambda found: np.sort([triangle for triangle, _ in found]),
                "single precision; no distances",
            )
        )
    if held.coal is not None:
        coal, mesh, origin = held.coal, held.coal_mesh, held.coal.Transform3s()
        poses = [coal.Transform3s(np.eye(3), q) for q in queries]
        sphere, request = coal.Sphere(r), coal.CollisionRequest()
        request.num_max_contacts = CONTACTS
        request.enable_contact = True

        def ask_coal(k: int) -> Any:
            answer = coal.CollisionResult()
            coal.collide(mesh, origin, sphere, poses[k], request, answer)
            return answer

        peers += _objects("coal: collide, mesh with sphere", ask_coal, _coal_triangles, "double")
    peers.append(
        Peer(
            "scipy: cKDTree on centroids, widened, then exact in numpy",
            lambda k: bodies.centroids.within(queries[k], r),
            lambda found: np.sort(found[0]),
        )
    )
    if held.trimesh is not None:
        tree, closest_point = held.trimesh_mesh.triangles_tree, held.trimesh.triangles.closest_point
        corners = bodies.centroids.corners

        def ask_trimesh(k: int) -> Any:
            q = queries[k]
            near = np.fromiter(tree.intersection(np.concatenate([q - r, q + r])), dtype=np.int64)
            closest = closest_point(corners[near], np.broadcast_to(q, (len(near), 3)))
            return near[((closest - q) ** 2).sum(axis=1) <= r * r]

        peers.append(
            Peer("trimesh: triangles_tree, then closest_point", ask_trimesh, np.sort, "in mm")
        )
    return peers


def _everything(contacts: vf.Contacts) -> NDArray[np.int64]:
    """The triangles, after closest points, features and distances have been computed."""
    assert len(contacts.points) == len(contacts.features) == len(contacts.distances)
    return contacts.triangles


def _fcpw_triangles(found: Any) -> list[int]:
    return [one.primitive_index for one in found]


def _coal_triangles(found: Any) -> list[int]:
    return [one.b1 for one in found.getContacts()]


def _objects(
    name: str, ask: Callable[[int], Any], triangles: Callable[[Any], list[int]], note: str
) -> list[Peer]:
    """Two peers for a library that returns a list of objects: without and with reading it."""
    return [
        Peer(name, ask, lambda found: np.sort(triangles(found)), f"{note}; a list yet to be read"),
        Peer(f"{name}, triangles read", lambda k: triangles(ask(k)), np.sort, f"{note}; triangles"),
    ]


def check_near(bodies: Bodies, answers: Sequence[Near], chosen: Sequence[int]) -> tuple[bool, str]:
    """Compare nearest triangles with the reference: (agrees, description).

    Compared is the distance of the returned triangle, since several may be equally near.
    """
    queries, worst = bodies.queries, 0.0
    for (distance, triangle), k in zip(answers, chosen, strict=True):
        if not 0 <= triangle < len(bodies.surface.faces):
            return False, f"triangle {triangle} does not exist"
        true, _ = bodies.centroids.nearest(queries[k])
        own = float(distances(bodies.centroids.corners[triangle : triangle + 1], queries[k])[0])
        worst = max(worst, own - true, 0.0 if np.isnan(distance) else abs(distance - true))
    return worst <= TOLERANCE, f"off by {worst * 1e6:.2g} nm at most"


def check_ball(
    bodies: Bodies, answers: Sequence[NDArray[Any]], chosen: Sequence[int], radius: float
) -> tuple[bool, str]:
    """Compare sets of triangles with the reference: (agrees, description).

    Triangles within the tolerance of the sphere may be included or not.
    """
    r, queries = radius * 1e3, bodies.queries
    missing = extra = total = 0
    for answer, k in zip(answers, chosen, strict=True):
        near, exact = bodies.centroids.within(queries[k], r + TOLERANCE)
        sure = near[exact <= r - TOLERANCE]
        missing += len(np.setdiff1d(sure, answer))
        extra += len(np.setdiff1d(answer, near))
        total += len(near)
    if missing or extra:
        return False, f"{missing} missing, {extra} too many of {total}"
    return True, f"the same {total / max(len(chosen), 1):,.0f} on average"
