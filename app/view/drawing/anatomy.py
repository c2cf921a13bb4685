"""Layer: the anatomy, the mesh and the structures beside it."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import vf
from app.judges.meeting import sees
from app.motion.stream import StreamForm
from app.scene.moment import Moment, seen_from
from app.scene.scene import Scene
from app.structure import Structure
from app.view import palette
from app.view.drawing.heat.bands import Scale
from app.view.drawing.heat.layer import Heat
from app.view.drawing.nodes import place
from app.view.part import Clients, Part
from app.view.units import VIEW_SCALE, to_buffer

TRANSLUCENT = 0.3
GHOST_OPACITY = 0.25
INSIDE = 1e-4  # the ghost without a margin is so much inside, so that the structure is seen [m]
OFTEN = 20_000  # vertices of a ghost that is drawn anew as often as a shape; more more seldom
GROWN = 1e-4  # changes of the margin that are not drawn [m]
HOLD = 1.0  # a structure stays translucent so long after it last hid the tip [s]
RESHAPED = 0.08  # between two shapes of a structure that deforms, on the page [s]
TURNS = 15  # in so many frames all structures are tested for whether they hide the tip


class Follows:
    """What is drawn of a mesh, as the mesh deforms: each vertex goes with the nearest of the mesh.

    Args:
        vertices, shown: (n, 3) and (k, 3) at rest, of the mesh and of what is drawn [m].
    """

    def __init__(self, vertices: NDArray[np.float64], shown: NDArray[np.float64]) -> None:
        self.due = -np.inf  # monotonic time of the next shape [s]
        self.phase = -1.0  # of the motion, of the shape that was drawn last [s]
        self._vertices, self._shown = vertices, shown
        self._of = np.asarray(cKDTree(vertices).query(shown)[1])

    def shape(self, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
        """What is drawn (k, 3) of a shape (n, 3) [m]."""
        return np.asarray(self._shown + (vertices - self._vertices)[self._of])


class _Drawn:
    """One structure: its node, and what decides how it is drawn."""

    def __init__(self, surface: vf.Surface, color: palette.Rgb, opacity: float) -> None:
        self.surface = surface
        self.mesh: viser.MeshHandle | None = None
        self.color, self.opacity = color, opacity
        self.visible = True  # by its own switch
        self.hidden_at = -np.inf  # monotonic time when it last hid the tip [s]
        self.whole = True  # not cut
        self.pose: pin.SE3 | None = None  # T_rest_now; None: it rests
        self.ghost: viser.MeshHandle | None = None  # where the guard believes it
        self.margin = -1.0  # that the ghost was drawn with [m]
        self.grown_at = -np.inf  # monotonic time of that [s]
        self.follows: Follows | None = None  # how what is drawn of it deforms

    def hides(self, eyes: Sequence[NDArray[np.float64]], p_tip: NDArray[np.float64]) -> bool:
        return self.whole and any(
            np.isfinite(eye).all()
            and not sees(
                self.surface, seen_from(self.pose, eye / VIEW_SCALE), seen_from(self.pose, p_tip)
            )
            for eye in eyes
        )


class Anatomy(Part):
    """The drawn meshes (possibly decimated), opaque or translucent."""

    def __init__(self, api: viser.SceneApi) -> None:
        self._api = api
        self._scene: Scene | None = None
        self._drawn: list[_Drawn] = []
        self._visible = True
        self._translucent = False  # by the layer switch
        self._ghosts = True  # likewise
        self._turn = 0
        self._heat = Heat(api)
        self.chosen = 0
        """Number of the structure that is chosen on the page; 0 is the mesh."""

    @property
    def margins(self) -> Scale | None:
        """The scale of the margins that are drawn; None: none are."""
        shown = self._visible and any(
            drawn.visible and self._heat.covers(k) for k, drawn in enumerate(self._drawn)
        )
        return self._heat.scale if shown else None

    def set_scene(self, scene: Scene) -> None:
        for drawn in self._drawn:
            if drawn.ghost is not None:
                drawn.ghost.remove()
        for drawn in self._drawn[1:]:
            if drawn.mesh is not None:
                drawn.mesh.remove()
        looks = enumerate(zip(scene.options.anatomy, scene.surfaces, strict=True))
        same = self._scene is not None and _sources(self._scene) == _sources(scene)
        switches = [drawn.visible for drawn in self._drawn]
        if self.chosen >= len(scene.surfaces):
            self.chosen = 0
        self._scene = scene
        self._heat.set_scene(scene)
        self._drawn = [
            _Drawn(surface, palette.structure_colour(own, k), own.opacity)
            for k, (own, surface) in looks
        ]
        if same:  # another arm, another place
            for drawn, visible in zip(self._drawn, switches, strict=True):
                drawn.visible = visible
        self.cut(None)
        for k in range(1, len(self._drawn)):
            self.cut(None, k)
        for k, (drawn, course) in enumerate(zip(self._drawn, scene.courses, strict=False)):
            if course is not None and course.form is not None:
                drawn.follows = Follows(drawn.surface.vertices, scene.looks(k)[0])
        self._add_ghosts(scene)

    def cut(
        self, part: tuple[NDArray[np.float64], NDArray[np.int64]] | None, number: int = 0
    ) -> None:
        """Draw this part of a structure, vertices (n, 3) [m] and faces (m, 3); None: all of it."""
        scene = self._scene
        if scene is None or not number < len(self._drawn):
            return
        drawn = self._drawn[number]
        drawn.whole = part is None
        if drawn.follows is not None:
            drawn.follows.phase = -1.0
        looks, faces_shown, fronts = scene.looks(number)
        vertices, faces = (looks, faces_shown) if part is None else part
        fronts_only = fronts and part is None
        name = f"/anatomy/structure{number}" if number else "/anatomy/mesh"
        drawn.mesh = self._add(name, drawn, vertices, faces, fronts_only)
        self._heat.set_shape(number, vertices, faces, fronts_only)

    def looks(self, shown: Moment, number: int) -> NDArray[np.float64]:
        """What is drawn of a structure (n, 3), where it rests, in the shape that it has now [m]."""
        assert self._scene is not None
        follows, shape = self._drawn[number].follows, shown.shape(number)
        if follows is None or shape is None:
            return self._scene.looks(number)[0]
        return follows.shape(shape)

    def show(self, visible: bool) -> None:
        """Layer switch."""
        self._visible = visible
        self._draw()

    def show_structure(self, number: int, visible: bool) -> None:
        """Switch of one structure; 0 is the mesh."""
        if 0 <= number < len(self._drawn):
            self._drawn[number].visible = visible
            self._draw()

    def shows(self, number: int) -> bool:
        """Whether the switch of a structure is on."""
        return 0 <= number < len(self._drawn) and self._drawn[number].visible

    def show_ghosts(self, on: bool) -> None:
        """Layer switch of where the guard believes structures to be."""
        self._ghosts = on
        self._draw()

    def show_margins(self, on: bool) -> None:
        """Layer switch of the heat map of margins."""
        self._heat.on = on
        self._draw()

    def set_translucent(self, on: bool) -> None:
        """Layer switch of the translucency."""
        self._translucent = on
        self._draw()

    def set_looks(self, structures: Sequence[Structure]) -> None:
        """Colours and opacities, in the order of `Options.anatomy`."""
        for k, (drawn, own) in enumerate(zip(self._drawn, structures, strict=False)):
            drawn.color, drawn.opacity = palette.structure_colour(own, k), own.opacity

    def frame(self, shown: Moment, clients: Clients) -> None:
        self.set_looks(shown.options.anatomy)
        self._heat.set_margins(shown.options.anatomy)
        self._move(shown)
        eyes = [np.asarray(client.camera.position) for client in clients.values()]
        self.keep_tip_visible(eyes, np.array(shown.tip.translation))

    def keep_tip_visible(
        self, eyes: Iterable[NDArray[np.float64]], p_tip: NDArray[np.float64]
    ) -> None:
        """Make a mesh translucent while it hides p_tip (3,) [m] from an eye (3,), scene units."""
        eyes = list(eyes)
        self._turn = (self._turn + 1) % TURNS
        for drawn in (*self._drawn[:1], *self._drawn[1 + self._turn :: TURNS]):
            if drawn.visible and drawn.hides(eyes, p_tip):
                drawn.hidden_at = time.monotonic()
        self._draw()

    def _move(self, shown: Moment) -> None:
        """Put all structures where they are, and their ghosts where the guard believes them."""
        for k, drawn in enumerate(self._drawn):
            pose = shown.pose(k)
            if pose is None and drawn.pose is None:
                continue
            drawn.pose = pose
            place(drawn.mesh, pose)
            place(drawn.ghost, shown.believed(k))
            self._heat.move(k, pose)
            self._deform(k, drawn, shown)
            self._grow(k, drawn, shown)

    def _deform(self, k: int, drawn: _Drawn, shown: Moment) -> None:
        """Give a structure that deforms its shape, every `RESHAPED` seconds."""
        follows, now, phase = drawn.follows, time.monotonic(), shown.telemetry.phase
        if follows is None or shown.shape(k) is None or now < follows.due or phase == follows.phase:
            return
        follows.due, follows.phase = now + RESHAPED, phase
        vertices = shown.shape(k)
        if drawn.mesh is not None and drawn.whole and vertices is not None:
            looks = follows.shape(vertices)
            drawn.mesh.vertices = to_buffer(looks)
            self._heat.deform(k, looks)

    def _grow(self, k: int, drawn: _Drawn, shown: Moment) -> None:
        """Draw the ghost as large as the margin for what the guard does not know makes it."""
        ghost, now, margin = drawn.ghost, time.monotonic(), shown.margin(k)
        if ghost is None or self._scene is None:
            return
        if now < drawn.grown_at + RESHAPED * max(1.0, len(ghost.vertices) / OFTEN):
            return
        follows, shape = drawn.follows, shown.shape(k, believed=True)
        deforms = follows is not None and shown.shape(k) is not None
        if not deforms and abs(margin - drawn.margin) < GROWN:
            return
        drawn.grown_at, drawn.margin = now, margin
        looks, faces, _ = self._scene.looks(k)
        if follows is not None and deforms:
            known = shown.shape(k) if shape is None else shape
            assert known is not None
            looks = follows.shape(known)
        ghost.vertices = to_buffer(grown(looks, faces, margin or -INSIDE))

    def _add_ghosts(self, scene: Scene) -> None:
        for k, drawn in enumerate(self._drawn):
            course = scene.courses[k] if scene.courses else None
            streamed = course is not None and isinstance(course.form, StreamForm)
            if course is None or not (streamed or scene.options.tracker is not None):
                continue
            vertices, faces, _ = scene.looks(k)
            drawn.ghost = self._api.add_mesh_simple(
                f"/anatomy/ghost{k}",
                vertices=to_buffer(grown(vertices, faces, -INSIDE)),
                faces=faces.astype(np.uint32),
                color=palette.GHOST,
                opacity=GHOST_OPACITY,
                side="front",
                cast_shadow=False,
                receive_shadow=False,
                visible=self._visible and drawn.visible and self._ghosts,
            )

    def _opacity(self, drawn: _Drawn) -> float | None:
        hides = time.monotonic() < drawn.hidden_at + HOLD
        opacity = min(drawn.opacity, TRANSLUCENT) if self._translucent or hides else drawn.opacity
        return None if opacity == 1.0 else opacity

    def _draw(self) -> None:
        for k, drawn in enumerate(self._drawn):
            mesh = drawn.mesh
            if mesh is None:
                continue
            opacity, visible = self._opacity(drawn), self._visible and drawn.visible
            self._heat.draw(k, visible, opacity)
            plain = visible and not self._heat.covers(k)
            if mesh.opacity != opacity:
                mesh.opacity = opacity
            if mesh.visible != plain:
                mesh.visible = plain
            if tuple(mesh.color) != drawn.color:
                mesh.color = drawn.color
            ghost = drawn.ghost
            if ghost is not None and ghost.visible != (visible and self._ghosts):
                ghost.visible = visible and self._ghosts

    def _add(
        self,
        name: str,
        drawn: _Drawn,
        vertices: NDArray[np.float64],
        faces: NDArray[np.int64],
        fronts_only: bool,
    ) -> viser.MeshHandle:
        mesh = self._api.add_mesh_simple(
            name,
            vertices=to_buffer(vertices),
            faces=faces.astype(np.uint32),
            color=drawn.color,
            flat_shading=True,
            # Without a graphics card the back faces take a third of the rendering time.
            side="front" if fronts_only else "double",
            opacity=self._opacity(drawn),
            cast_shadow=False,
            visible=self._visible and drawn.visible,
        )
        if drawn.pose is not None:
            place(mesh, drawn.pose)
        return mesh


def grown(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], margin: float
) -> NDArray[np.float64]:
    """Vertices (n, 3) moved outwards by a margin [m], along the means of their faces' normals."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)  # twice the area long
    sums = np.column_stack(
        [
            np.bincount(faces.ravel(), np.repeat(normals[:, axis], 3), len(vertices))
            for axis in range(3)
        ]
    )
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.asarray(vertices + margin * sums / np.maximum(lengths, 1e-300))


def _sources(scene: Scene) -> list[tuple[str, str | None, str | None]]:
    return [own.source for own in scene.options.anatomy]
