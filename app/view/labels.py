"""The labels of the scene: whoever looks at it sees no two of them overlap.

A label stands with one of its corners or edges at its point. Where that would lie on a more
important label it takes another, and where all are taken it is not drawn. That depends on where one
looks from, so each client has labels of its own.
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

from app.recording.playback import Moment
from app.view.camera import NEAR_PLANE
from app.view.part import Clients, Part

FloatArray = NDArray[np.float64]

Anchor = Literal[
    "top-left", "top-center", "top-right",
    "center-left", "center-center", "center-right",
    "bottom-left", "bottom-center", "bottom-right",
]  # fmt: skip
"""Which part of the label is at its point: "bottom-left" stands above it and to its right."""

# All labels, the most important first; it is the less important that give way.
IMPORTANCE = (
    "/crossing/label",
    "/fixture/blocks",
    "/proxy/gizmo_name",
    "/proxy/ball_name",
    "/tool/force_label",
    "/inspector/chosen/name",
    "/probe/name",
    "/probe/fixture/blocks",
    "/probe/T1",
    "/probe/T2",
    "/corridor/name",
    "/ruler/site/label",
    "/ruler/anatomy/label",
)

# Distances between labels [px]. A label goes only to a place that is clear, and leaves it only when
# that is taken: it does not flicker while two of them graze each other.
NEW_GAP, KEPT_GAP = 4.0, 1.0

EM = 12.0  # height of the letters of a label of scale 1 [px], see LabelRenderer.tsx of viser 1.1
# viser draws in the browser's own font. These are upper bounds for those of the usual systems.
LINE = 1.35  # height of a line, in heights of a letter
PADDING = 0.2  # of the white behind it, in heights of a line, both sides together
NARROW, WIDE = frozenset(" .,:;'|!ijl·"), frozenset("mwMW%@#&✕…—")
WIDTHS = {"narrow": 0.36, "usual": 0.7, "wide": 1.0}  # in heights of a letter

PICTURE = (1280.0, 720.0)  # width and height a scene file is composed for [px]


@dataclass(eq=False)
class Label:
    """Words at a point of the scene. Its owner sets these; what is seen of them is `Labels`'s.

    Attributes:
        anchor: where it stands by preference.
        scale: of its letters.
        text: its words, in one line.
        position: its point (3,), scene units; replaced as a whole.
        visible: whether it is to be seen where there is room for it.
    """

    anchor: Anchor
    scale: float
    text: str = ""
    position: tuple[float, float, float] | FloatArray = (0.0, 0.0, 0.0)
    visible: bool = False


class Camera(NamedTuple):
    """How somebody looks at the scene.

    Attributes:
        place: the camera's (3,), scene units.
        R: its axes as columns (3, 3): right, down, forward.
        fov: vertical field of view [rad].
        width, height: of the picture [px].
    """

    place: FloatArray
    R: FloatArray
    fov: float
    width: float
    height: float


class Box(NamedTuple):
    """A rectangle in a picture [px]: y goes down."""

    left: float
    top: float
    right: float
    bottom: float


class Candidate(NamedTuple):
    """A label to be placed: its point (u, v) in the picture and its size [px], its preference."""

    u: float
    v: float
    width: float
    height: float
    anchor: Anchor


# By name: text, and position in scene units.
Texts = dict[str, tuple[str, tuple[float, float, float]]]


class Labels(Part):
    """All labels of a page. Owners `add` theirs; the view thread calls `place` each frame."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._labels: dict[str, Label] = {}
        self._clients: dict[int, _ClientLabels] = {}  # by client

    def add(self, name: str, text: str = "", *, anchor: Anchor, scale: float = 0.8) -> Label:
        """A new label, not visible yet.

        Args:
            name: one of `IMPORTANCE` that no other label has.

        Raises:
            ValueError: another name.
        """
        if name not in IMPORTANCE or name in self._labels:
            raise ValueError(f"{name!r} is not in IMPORTANCE, or there already")
        label = Label(anchor, scale, text)
        self._labels[name] = label
        return label

    def __getitem__(self, name: str) -> Label:
        return self._labels[name]

    def frame(self, shown: Moment, clients: Clients) -> None:
        """Place them, when all other parts have set theirs."""
        self.place(clients)

    def place(self, clients: Mapping[int, viser.ClientHandle]) -> None:
        """Show every client its labels. From the view thread, once the frame's are all set."""
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
                self._clients[client_id].show(labels, eye)

    @contextmanager
    def in_scene(self) -> Iterator[None]:
        """Meanwhile the labels are part of the scene that all clients share, to be written to a
        file; as they are seen from where new clients look. Nobody's own labels change by that."""
        camera = self._server.initial_camera
        place = np.asarray(camera.position, dtype=np.float64)
        axes = _look_at(place, camera.look_at)
        eye = Camera(place, axes, float(camera.fov), *PICTURE)
        sight = _ClientLabels(self._server.scene, self._labels)
        try:
            sight.show(self._wanted(), eye)
            yield
        finally:
            sight.remove()

    def _wanted(self) -> Texts:
        """The labels that are to be seen, the most important first."""
        wanted: Texts = {}
        for name in IMPORTANCE:
            label = self._labels.get(name)
            if label is not None and label.visible:
                x, y, z = map(float, label.position)
                wanted[name] = label.text, (x, y, z)
        return wanted


@dataclass
class _ClientLabels:
    """The labels that one client is shown; or all of them, where it is the shared scene."""

    api: viser.SceneApi
    labels: Mapping[str, Label]
    anchors: dict[str, Anchor | None] = field(default_factory=dict)
    """Where the labels were placed last."""

    def __post_init__(self) -> None:
        self._last: tuple[object, ...] = ()
        # A client's own node takes the place of a shared one of that name: all are made at once.
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

    def show(self, labels: Texts, eye: Camera) -> None:
        """Place these labels as seen by an eye, and show those that there is room for."""
        now = (labels, eye.place.tobytes(), eye.R.tobytes(), *eye[2:])
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
        self.anchors = arrange(wanted, self.anchors)
        for name, node in self._nodes.items():
            anchor = self.anchors.get(name)
            if anchor is not None:
                node.text, node.position = labels[name]
                node.anchor = anchor
            node.visible = anchor is not None

    def remove(self) -> None:
        """Take them out of the scene."""
        for node in self._nodes.values():
            node.remove()


def arrange(
    wanted: Mapping[str, Candidate], last: Mapping[str, Anchor | None]
) -> dict[str, Anchor | None]:
    """An anchor for each label so that no two overlap; None: there is no room for it.

    Args:
        wanted: by name, the most important first.
        last: where they were placed before.
    """
    taken: list[Box] = []
    placed: dict[str, Anchor | None] = {}
    for name, label in wanted.items():
        placed[name] = None
        for anchor in choices(label.anchor):
            it = box(label, anchor)
            gap = KEPT_GAP if last.get(name) == anchor else NEW_GAP
            if not any(_overlap(it, other, gap) for other in taken):
                placed[name] = anchor
                taken.append(it)
                break
    return placed


def choices(anchor: Anchor) -> tuple[Anchor, ...]:
    """The anchors of a label in the order they are tried: as preferred, then with another corner
    at the point, the one across last, then with the middle of an edge."""
    return _CHOICES[anchor]


def box(label: Candidate, anchor: Anchor) -> Box:
    """The rectangle of a label with that anchor at its point."""
    vertical, horizontal = anchor.split("-")
    left = label.u - _SHARES[horizontal] * label.width
    top = label.v - _SHARES[vertical] * label.height
    return Box(left, top, left + label.width, top + label.height)


@functools.lru_cache(maxsize=64)
def size(text: str, scale: float) -> tuple[float, float]:
    """Width and height of a label with its white background [px]: upper bounds."""
    letter = EM * scale
    width = sum(WIDTHS["narrow" if c in NARROW else "wide" if c in WIDE else "usual"] for c in text)
    return letter * (width + PADDING * LINE), letter * LINE * (1.0 + PADDING)


def project(points: FloatArray, eye: Camera) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Where points (n, 3), scene units, are in a picture (n, 2) [px], and which the eye is before.

    The others, behind the eye or beside it, have no place in the picture: theirs means nothing.
    """
    right, down, forward = ((points - eye.place) @ eye.R).T
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


def _node(name: str) -> str:
    """Side by side in the scene: nested names would make nodes for all that is between."""
    return f"/labels/{name[1:].replace('/', ' ')}"


def _axes(wxyz: FloatArray) -> FloatArray:
    """A camera's axes as columns (3, 3): right, down, forward."""
    w, x, y, z = wxyz
    return np.asarray(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix())


def _look_at(place: FloatArray, look_at: ArrayLike) -> FloatArray:
    """The axes (3, 3) of a camera that looks from one place to another, level."""
    forward = np.asarray(look_at, dtype=np.float64) - place
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.column_stack([right, np.cross(forward, right), forward])
