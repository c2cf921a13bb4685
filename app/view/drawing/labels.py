"""Labels in the scene, placed so that no two overlap in any client's picture and none is cut off.

A label has one of its corners or edges at its point. Where it would overlap a more important label
or the picture's edge, another corner or edge is tried; without room it is hidden. As this depends
on the camera, each client has its own label nodes.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, get_args

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import ArrayLike, NDArray

from app.scene.moment import Moment
from app.view.camera import NEAR_PLANE
from app.view.part import Clients, Part

FloatArray = NDArray[np.float64]

Anchor = Literal[
    "top-left", "top-center", "top-right",
    "center-left", "center-center", "center-right",
    "bottom-left", "bottom-center", "bottom-right",
]  # fmt: skip
"""Part of the label at its point: a "bottom-left" label is above it and to its right."""

# All labels, most important first; the less important make room.
IMPORTANCE = (
    "/crossing/label",
    "/fixture/blocks",
    *(f"/fixture/part{k}" for k in range(8)),
    "/proxy/gizmo_name",
    "/proxy/ball_name",
    "/tool/force_label",
    "/inspector/chosen/name",
    "/probe/name",
    "/probe/fixture/blocks",
    *(f"/probe/fixture/part{k}" for k in range(8)),
    "/probe/T1",
    "/probe/T2",
    "/corridor/name",
    "/ruler/site/label",
    "/ruler/anatomy/label",
)

# Smallest gaps to other labels [px]: at a new place, and at the place it has. The hysteresis avoids
# flicker.
NEW_GAP, KEPT_GAP = 4.0, 1.0

EM = 12.0  # font size at scale 1 [px], from LabelRenderer.tsx of viser 1.1
# viser uses the browser's font. These are upper bounds for the common ones.
LINE = 1.35  # line height [em]
PADDING = 0.2  # of the background, both sides together, in line heights
NARROW, WIDE = frozenset(" .,:;'|!ijl·"), frozenset("mwMW%@#&✕…—")
WIDTHS = {"narrow": 0.36, "usual": 0.7, "wide": 1.0}  # [em]

PICTURE = (1280.0, 720.0)  # width and height assumed for a scene file [px]


@dataclass(eq=False)
class Label:
    """A text at a point of the scene. Its owner sets the attributes, `Labels` draws it.

    Attributes:
        anchor: the preferred one.
        scale: of the font.
        text: one line.
        position: its point (3,), scene units; replaced as a whole.
        visible: whether it is drawn if there is room.
    """

    anchor: Anchor
    scale: float
    text: str = ""
    position: tuple[float, float, float] | FloatArray = (0.0, 0.0, 0.0)
    visible: bool = False


class Camera(NamedTuple):
    """A pinhole camera.

    Attributes:
        position: (3,), scene units.
        R: its axes as columns (3, 3): right, down, forward.
        fov: vertical field of view [rad].
        width, height: of the picture [px].
    """

    position: FloatArray
    R: FloatArray
    fov: float
    width: float
    height: float


class Box(NamedTuple):
    """A rectangle in a picture [px], y downwards."""

    left: float
    top: float
    right: float
    bottom: float


UNBOUNDED = Box(-np.inf, -np.inf, np.inf, np.inf)


class Candidate(NamedTuple):
    """A label to be placed: its point (u, v) and size in the picture [px], preferred anchor."""

    u: float
    v: float
    width: float
    height: float
    anchor: Anchor


# Text and position [scene units] by name.
Texts = dict[str, tuple[str, tuple[float, float, float]]]


class Labels(Part):
    """All labels of a page. Parts `add` theirs; the view thread calls `place` each frame."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._labels: dict[str, Label] = {}
        self._clients: dict[int, _ClientLabels] = {}

    def add(self, name: str, text: str = "", *, anchor: Anchor, scale: float = 0.8) -> Label:
        """Make a label, not visible yet.

        Args:
            name: an unused one of `IMPORTANCE`.

        Raises:
            ValueError: for another name.
        """
        if name not in IMPORTANCE or name in self._labels:
            raise ValueError(f"{name!r} is not in IMPORTANCE, or is used already")
        label = Label(anchor, scale, text)
        self._labels[name] = label
        return label

    def __getitem__(self, name: str) -> Label:
        return self._labels[name]

    def frame(self, shown: Moment, clients: Clients) -> None:
        self.place(clients)

    def place(self, clients: Mapping[int, viser.ClientHandle]) -> None:
        """Draw each client's labels."""
        for gone in self._clients.keys() - clients.keys():
            del self._clients[gone]
        labels = self._wanted()
        for client_id, client in clients.items():
            if client_id not in self._clients:
                self._clients[client_id] = _ClientLabels(client.scene, self._labels)
            camera = client.camera
            picture = camera.image_width, camera.image_height
            eye = Camera(camera.position, _axes(camera.wxyz), camera.fov, *picture)
            with client.atomic():
                self._clients[client_id].show(labels, eye, Box(0.0, 0.0, *picture))

    @contextmanager
    def in_scene(self) -> Iterator[None]:
        """Context in which the shared scene has labels, for a scene file.

        They are placed for the camera of new clients, those outside its picture too, as the file's
        reader turns the camera; the clients' own labels do not change.
        """
        camera = self._server.initial_camera
        position = np.asarray(camera.position, dtype=np.float64)
        axes = _look_at(position, camera.look_at)
        eye = Camera(position, axes, float(camera.fov), *PICTURE)
        shared = _ClientLabels(self._server.scene, self._labels)
        try:
            shared.show(self._wanted(), eye, UNBOUNDED)
            yield
        finally:
            shared.remove()

    def _wanted(self) -> Texts:
        """The visible labels, most important first."""
        wanted: Texts = {}
        for name in IMPORTANCE:
            label = self._labels.get(name)
            if label is not None and label.visible:
                x, y, z = map(float, label.position)
                wanted[name] = label.text, (x, y, z)
        return wanted


@dataclass
class _ClientLabels:
    """The label nodes of one client, or of the shared scene."""

    api: viser.SceneApi
    labels: Mapping[str, Label]
    anchors: dict[str, Anchor | None] = field(default_factory=dict)
    """By name, as placed last."""

    def __post_init__(self) -> None:
        self._last: tuple[object, ...] = ()
        # All at once: a client's node hides the shared one of that name, which `in_scene` makes.
        self._nodes = {
            name: self.api.add_label(
                _node(name),
                label.text,
                anchor=label.anchor,
                font_screen_scale=label.scale,
                visible=False,
            )
            for name, label in self.labels.items()
        }

    def show(self, labels: Texts, eye: Camera, bounds: Box) -> None:
        """Place labels for a camera and draw those with room within bounds."""
        now = (labels, eye.position.tobytes(), eye.R.tobytes(), *eye[2:])
        if now == self._last:
            return
        self._last = now
        points = np.array([position for _, position in labels.values()]).reshape(-1, 3)
        places, in_front = project(points, eye)
        wanted = {}
        rows = zip(labels.items(), places.tolist(), in_front, strict=True)
        for (name, (text, _)), (u, v), seen in rows:
            if seen:
                label = self.labels[name]
                wanted[name] = Candidate(u, v, *size(text, label.scale), label.anchor)
        self.anchors = arrange(wanted, self.anchors, bounds)
        for name, node in self._nodes.items():
            anchor = self.anchors.get(name)
            if anchor is not None:
                node.text, node.position = labels[name]
                node.anchor = anchor
            node.visible = anchor is not None

    def remove(self) -> None:
        """Remove the nodes."""
        for node in self._nodes.values():
            node.remove()


def arrange(
    wanted: Mapping[str, Candidate], last: Mapping[str, Anchor | None], bounds: Box
) -> dict[str, Anchor | None]:
    """An anchor for each label so that no two overlap; None: no room.

    Args:
        wanted: by name, most important first.
        last: the result before.
        bounds: each label is within them.
    """
    taken: list[Box] = []
    placed: dict[str, Anchor | None] = {}
    for name, label in wanted.items():
        placed[name] = None
        for anchor in choices(label.anchor):
            it = box(label, anchor)
            gap = KEPT_GAP if last.get(name) == anchor else NEW_GAP
            if _within(it, bounds) and not any(_overlap(it, other, gap) for other in taken):
                placed[name] = anchor
                taken.append(it)
                break
    return placed


def choices(anchor: Anchor) -> tuple[Anchor, ...]:
    """The anchors in the order they are tried: the preferred one, corners (the opposite one last),
    middles of edges."""
    return _CHOICES[anchor]


def box(label: Candidate, anchor: Anchor) -> Box:
    """The rectangle of a label with an anchor."""
    vertical, horizontal = anchor.split("-")
    left = label.u - _SHARES[horizontal] * label.width
    top = label.v - _SHARES[vertical] * label.height
    return Box(left, top, left + label.width, top + label.height)


@functools.lru_cache(maxsize=64)
def size(text: str, scale: float) -> tuple[float, float]:
    """Upper bounds of width and height of a label with its background [px]."""
    letter = EM * scale
    width = sum(WIDTHS["narrow" if c in NARROW else "wide" if c in WIDE else "usual"] for c in text)
    return letter * (width + PADDING * LINE), letter * LINE * (1.0 + PADDING)


def project(points: FloatArray, eye: Camera) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Pixels (n, 2) of points (n, 3), scene units, and which points are in front of the camera.

    The pixels of the other points are meaningless.
    """
    right, down, forward = ((points - eye.position) @ eye.R).T
    in_front = forward > NEAR_PLANE
    focal = 0.5 * eye.height / np.tan(0.5 * eye.fov)
    scale = focal / np.where(in_front, forward, 1.0)
    middle = 0.5 * np.array([eye.width, eye.height])
    return middle + np.column_stack([scale * right, scale * down]), in_front


def _choices(anchor: Anchor) -> tuple[Anchor, ...]:
    corners: tuple[Anchor, ...] = ("top-left", "top-right", "bottom-left", "bottom-right")
    edges: tuple[Anchor, ...] = ("center-left", "center-right", "bottom-center", "top-center")

    def turned(other: Anchor) -> int:
        return sum(a != b for a, b in zip(other.split("-"), anchor.split("-"), strict=True))

    return tuple(dict.fromkeys((anchor, *sorted(corners, key=turned), *edges)))


_CHOICES: dict[Anchor, tuple[Anchor, ...]] = {a: _choices(a) for a in get_args(Anchor)}
_SHARES = {"left": 0.0, "top": 0.0, "center": 0.5, "right": 1.0, "bottom": 1.0}


def _overlap(a: Box, b: Box, gap: float) -> bool:
    return (
        a.left < b.right + gap
        and b.left < a.right + gap
        and a.top < b.bottom + gap
        and b.top < a.bottom + gap
    )


def _within(a: Box, bounds: Box) -> bool:
    return (
        bounds.left <= a.left
        and bounds.top <= a.top
        and a.right <= bounds.right
        and a.bottom <= bounds.bottom
    )


def _node(name: str) -> str:
    """Name of a node without further slashes, which would make intermediate nodes."""
    return f"/labels/{name[1:].replace('/', ' ')}"


def _axes(wxyz: FloatArray) -> FloatArray:
    """A camera's axes as columns (3, 3): right, down, forward."""
    w, x, y, z = wxyz
    return np.asarray(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix())


def _look_at(place: FloatArray, look_at: ArrayLike) -> FloatArray:
    """The axes (3, 3) of a level camera that looks from one point to another."""
    forward = np.asarray(look_at, dtype=np.float64) - place
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.column_stack([right, np.cross(forward, right), forward])
