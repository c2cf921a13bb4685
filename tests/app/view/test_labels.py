"""Where labels are placed: apart, the more important first, and still while nothing moves."""

from __future__ import annotations

import contextlib
import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import ImageFont

from app.scene import scene as scenes
from app.settings import Options
from app.view import labels, ruler
from app.view.labels import Camera, Candidate, Labels, arrange, box, choices, size
from app.view.ruler import Rulers

PIXELS = st.floats(-500.0, 2500.0)
ANCHORS = tuple(labels._CHOICES)
wanted_labels = st.lists(
    st.builds(
        Candidate, PIXELS, PIXELS, st.floats(10.0, 400.0), st.floats(8.0, 40.0),
        st.sampled_from(ANCHORS),
    ),
    max_size=13,
)  # fmt: skip
crowds = st.lists(
    st.builds(
        Candidate, st.floats(0.0, 60.0), st.floats(0.0, 30.0), st.floats(20.0, 90.0), st.just(16.0),
        st.sampled_from(ANCHORS),
    ),
    max_size=13,
)  # fmt: skip
befores = st.dictionaries(st.integers(0, 12).map(str), st.sampled_from((*ANCHORS, None)))


def corners(label: Candidate, anchor: str) -> np.ndarray:
    """Rows of the lowest and highest corner (2, 2) [px] of a label, from what its anchor says."""
    vertical, horizontal = anchor.split("-")
    x = {"left": 0.0, "center": -label.width / 2, "right": -label.width}[horizontal]
    y = {"top": 0.0, "center": -label.height / 2, "bottom": -label.height}[vertical]
    low = np.array([label.u + x, label.v + y])
    return np.array([low, low + np.array([label.width, label.height])])


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """How far two boxes are from each other along the axis where they are farther [px]."""
    return float(np.maximum(a[0] - b[1], b[0] - a[1]).max())


@given(wanted=st.one_of(wanted_labels, crowds), before=befores)
def test_labels_are_apart_and_give_way_only_to_more_important_ones(
    wanted: list[Candidate], before: dict[str, Any]
) -> None:
    named = {str(k): label for k, label in enumerate(wanted)}
    placed = arrange(named, before)
    assert list(placed) == list(named)
    boxes: list[np.ndarray] = []
    for name, label in named.items():
        anchor = placed[name]
        if anchor is None:
            # Every place it could have is too near to a label before it.
            for other in ANCHORS:
                if other == "center-center" != label.anchor:
                    continue  # its point would be under it
                it = corners(label, other)
                assert any(apart(it, b) < labels.NEW_GAP + 1e-9 for b in boxes)
            continue
        it = corners(label, anchor)
        assert all(apart(it, b) > labels.KEPT_GAP - 1e-9 for b in boxes)
        boxes.append(it)
    assert arrange(named, placed) == placed, "nothing moves while nothing changes"
    for name in list(named)[:1]:
        assert placed[name] == named[name].anchor, "the first stands where it wants to"


def test_a_label_stands_where_its_anchor_says() -> None:
    label = Candidate(100.0, 50.0, 40.0, 16.0, "top-left")
    assert box(label, "top-left") == (100.0, 50.0, 140.0, 66.0)  # below its point, to the right
    assert box(label, "bottom-right") == (60.0, 34.0, 100.0, 50.0)
    assert box(label, "center-center") == (80.0, 42.0, 120.0, 58.0)


def test_what_is_tried_first_is_what_is_preferred_then_the_corners() -> None:
    for anchor in ANCHORS:
        tried = choices(anchor)
        assert tried[0] == anchor
        assert len(set(tried)) == len(tried) == (9 if anchor == "center-center" else 8)
    assert choices("top-left")[:4] == ("top-left", "top-right", "bottom-left", "bottom-right")


def test_a_label_does_not_flicker_while_another_grazes_it() -> None:
    """Under the same small motion to and fro it changes its place once at most."""
    low = Candidate(100.0, 100.0, 60.0, 16.0, "bottom-left")
    placed: dict[str, Any] = {}
    seen = []
    for k in range(40):
        # The lower one's upper side is at 84 px: half a pixel from the other, then three.
        high = Candidate(100.0, 83.5 - 2.5 * (k % 2), 60.0, 16.0, "bottom-left")
        placed = arrange({"high": high, "low": low}, placed)
        seen.append(placed["low"])
    assert sum(a != b for a, b in itertools.pairwise(seen)) <= 1


def test_a_point_is_where_a_camera_sees_it() -> None:
    """By the matrices that graphics cards are given: view, then perspective, then the window."""
    rng = np.random.default_rng(3)
    for fov in (np.deg2rad(40.0), np.deg2rad(2.0)):
        R, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        R[:, 2] *= np.linalg.det(R)
        eye = Camera(rng.normal(size=3), R, fov, 640.0, 360.0)
        points = eye.place + (rng.normal(size=(50, 3)) * [0.3, 0.3, 1.0] @ R.T) * 20.0
        places, in_front = labels.project(points, eye)
        view = np.eye(4)
        view[:3, :3] = np.column_stack([R[:, 0], -R[:, 1], -R[:, 2]]).T
        view[:3, 3] = -view[:3, :3] @ eye.place
        near, far, f = 0.02, 2000.0, 1.0 / np.tan(fov / 2.0)
        lens = np.array(
            [
                [f * eye.height / eye.width, 0, 0, 0],
                [0, f, 0, 0],
                [0, 0, (far + near) / (near - far), 2 * far * near / (near - far)],
                [0, 0, -1, 0],
            ]
        )
        clip = np.column_stack([points, np.ones(50)]) @ view.T @ lens.T
        np.testing.assert_array_equal(in_front, clip[:, 2] > -clip[:, 3])
        assert 0 < in_front.sum() < 50
        x, y = (clip[:, :2] / clip[:, 3:]).T
        expected = np.column_stack([(x + 1) / 2 * eye.width, (1 - y) / 2 * eye.height])
        np.testing.assert_allclose(places[in_front], expected[in_front], rtol=1e-9, atol=1e-6)


TEXTS = (
    "proxy", "handle · client 12", "blocks: takes 0.35 mm off each step", "planned cut",
    "✕ crossed at tick 1,234,567", "simulated force 3.2 N", "#123,456", "T1", "50 mm", "probe",
)  # fmt: skip


@pytest.mark.parametrize("text", TEXTS)
def test_a_label_is_taken_for_at_least_as_large_as_in_the_widest_usual_font(text: str) -> None:
    """DejaVu Sans, which browsers take on a Linux without others; matplotlib brings it."""
    import matplotlib

    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    font = ImageFont.truetype(str(path), 1000)
    line = sum(font.getmetrics()) / 1000.0
    width, height = size(text, 0.8)
    assert font.getlength(text) / 1000.0 + 0.2 * line < width / (0.8 * 12.0)
    assert 1.2 * line < height / (0.8 * 12.0)


class Nodes:
    """Stands in for a scene: keeps what was made in it, counts what is sent."""

    def __init__(self) -> None:
        self.made: dict[str, Any] = {}
        self.sent = 0

    def add_label(self, name: str, text: str, **more: Any) -> Any:
        outer = self

        class Node(SimpleNamespace):
            def __setattr__(self, field: str, value: Any) -> None:
                outer.sent += getattr(self, field, None) != value
                super().__setattr__(field, value)

        self.made[name] = Node(text=text, position=None, remove=lambda: None, **more)
        self.sent = 0
        return self.made[name]


def looker(distance: float) -> Any:
    """A client that looks along y from there at the origin, z upwards."""
    s = np.sqrt(0.5)
    return SimpleNamespace(
        scene=Nodes(),
        atomic=contextlib.nullcontext,
        camera=SimpleNamespace(
            position=np.array([0.0, -distance, 0.0]),
            wxyz=np.array([s, -s, 0.0, 0.0]),
            fov=np.deg2rad(40.0),
            image_width=1280,
            image_height=720,
        ),
    )


def test_each_client_is_shown_what_there_is_room_for_where_it_looks_from() -> None:
    page = Labels(SimpleNamespace())
    crossing = page.add("/crossing/label", "crossed", anchor="top-left")
    name = page.add("/proxy/gizmo_name", "proxy", anchor="top-left")
    page.add("/tool/force_label", "1 N", anchor="top-left")  # not to be seen
    crossing.visible = name.visible = True
    name.position = (1.0, 0.0, 0.3)
    near, far = looker(10.0), looker(2000.0)
    page.place({0: near, 1: far})
    shown = {
        k: {node for node, handle in client.scene.made.items() if handle.visible}
        for k, client in enumerate((near, far))
    }
    assert shown == {
        0: {"/labels/crossing label", "/labels/proxy gizmo_name"},
        1: {"/labels/crossing label"},
    }
    node = near.scene.made["/labels/proxy gizmo_name"]
    assert (node.text, node.position, node.anchor) == ("proxy", (1.0, 0.0, 0.3), "top-left")

    near.scene.sent = far.scene.sent = 0
    page.place({0: near, 1: far})
    assert near.scene.sent == far.scene.sent == 0, "what did not change is not sent again"
    crossing.visible = False
    page.place({0: near, 1: far})
    assert far.scene.made["/labels/proxy gizmo_name"].visible, "there is room for it now"

    # A label behind the eye has no place in the picture, and is in nobody's way.
    crossing.visible, crossing.position = True, (0.0, -50.0, 0.0)
    page.place({0: near})
    assert not near.scene.made["/labels/crossing label"].visible
    assert near.scene.made["/labels/proxy gizmo_name"].visible
    again = looker(10.0)
    page.place({2: again})
    assert again.scene.made["/labels/proxy gizmo_name"].visible


def test_every_label_has_its_place_in_the_order() -> None:
    page = Labels(SimpleNamespace())
    page.add("/tool/force_label", anchor="top-left")
    for wrong in ("/tool/force_label", "/tool/weight"):
        with pytest.raises(ValueError, match=wrong):
            page.add(wrong, anchor="top-left")
    assert len(set(labels.IMPORTANCE)) == len(labels.IMPORTANCE)


def test_scale_bars_that_are_switched_off_stay_off_in_another_scene(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ruler, "site_half_height", lambda _scene: 0.01)
    page, bars = Labels(SimpleNamespace()), []

    def line(*_: object, **more: Any) -> SimpleNamespace:
        bars.append(SimpleNamespace(visible=True))
        return bars[-1]

    rulers = Rulers(SimpleNamespace(add_line_segments=line), page)
    built = scenes.build(Options(mesh="cube", robot="point"), 1)
    shown = lambda: [*(bar.visible for bar in bars[-2:]), page["/ruler/site/label"].visible]  # noqa: E731
    rulers.set_scene(built)
    assert shown() == [True, True, True]
    assert (
        page["/ruler/site/label"].text == "5 mm"
    )  # at most 0.3 of a quarter of the diagonal, 69 mm
    rulers.show(False)
    rulers.set_scene(built)
    assert shown() == [False, False, False]
