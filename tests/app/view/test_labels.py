"""Placement of labels: no overlaps, priority by importance, no flicker."""

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
from app.view.drawing import labels
from app.view.drawing.labels import (
    UNBOUNDED,
    Box,
    Camera,
    Candidate,
    Labels,
    arrange,
    box,
    choices,
    size,
)
from app.view.drawing.ruler import Rulers

PIXELS = st.floats(-500.0, 2500.0)
ANCHORS = tuple(labels._CHOICES)
wanted_labels = st.lists(
    st.builds(
        Candidate, PIXELS, PIXELS, st.floats(10.0, 400.0), st.floats(8.0, 40.0),
        st.sampled_from(ANCHORS),
    ),
    max_size=13,
)  # fmt: skip
crowded_labels = st.lists(
    st.builds(
        Candidate, st.floats(0.0, 60.0), st.floats(0.0, 30.0), st.floats(20.0, 90.0), st.just(16.0),
        st.sampled_from(ANCHORS),
    ),
    max_size=13,
)  # fmt: skip
bounds = st.sampled_from((UNBOUNDED, Box(0.0, 0.0, 1280.0, 720.0), Box(0.0, 0.0, 100.0, 60.0)))
last_anchors = st.dictionaries(st.integers(0, 12).map(str), st.sampled_from((*ANCHORS, None)))


def corners(label: Candidate, anchor: str) -> np.ndarray:
    """Lowest and highest corner, as rows (2, 2) [px], of a label with an anchor."""
    vertical, horizontal = anchor.split("-")
    x = {"left": 0.0, "center": -label.width / 2, "right": -label.width}[horizontal]
    y = {"top": 0.0, "center": -label.height / 2, "bottom": -label.height}[vertical]
    low = np.array([label.u + x, label.v + y])
    return np.array([low, low + np.array([label.width, label.height])])


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Gap of two boxes along the axis where it is larger [px]."""
    return float(np.maximum(a[0] - b[1], b[0] - a[1]).max())


@given(wanted=st.one_of(wanted_labels, crowded_labels), before=last_anchors, bounds=bounds)
def test_labels_do_not_overlap_and_yield_only_to_more_important_ones_and_the_edge(
    wanted: list[Candidate], before: dict[str, Any], bounds: Box
) -> None:
    named = {str(k): label for k, label in enumerate(wanted)}
    placed = arrange(named, before, bounds)

    def inside(it: np.ndarray) -> bool:
        return bool((it[0] >= bounds[:2]).all() and (it[1] <= bounds[2:]).all())

    assert list(placed) == list(named)
    boxes: list[np.ndarray] = []
    for name, label in named.items():
        anchor = placed[name]
        if anchor is None:
            # With every anchor it is too close to a more important label, or cut off.
            for other in ANCHORS:
                if other == "center-center" != label.anchor:
                    continue  # it would cover its own point
                it = corners(label, other)
                assert not inside(it) or any(apart(it, b) < labels.NEW_GAP + 1e-9 for b in boxes)
            continue
        it = corners(label, anchor)
        assert inside(it)
        assert all(apart(it, b) > labels.KEPT_GAP - 1e-9 for b in boxes)
        boxes.append(it)
    assert arrange(named, placed, bounds) == placed, "the same input gives the same placement"
    for name in list(named)[:1]:
        if inside(corners(named[name], named[name].anchor)):
            assert placed[name] == named[name].anchor, (
                "the most important label has its preferred anchor"
            )


def test_a_label_is_placed_by_its_anchor() -> None:
    label = Candidate(100.0, 50.0, 40.0, 16.0, "top-left")
    assert box(label, "top-left") == (100.0, 50.0, 140.0, 66.0)  # below its point, to the right
    assert box(label, "bottom-right") == (60.0, 34.0, 100.0, 50.0)
    assert box(label, "center-center") == (80.0, 42.0, 120.0, 58.0)


def test_anchors_are_tried_from_the_preferred_one_over_the_corners() -> None:
    for anchor in ANCHORS:
        tried = choices(anchor)
        assert tried[0] == anchor
        assert len(set(tried)) == len(tried) == (9 if anchor == "center-center" else 8)
    assert choices("top-left")[:4] == ("top-left", "top-right", "bottom-left", "bottom-right")


def test_a_label_at_the_edge_of_the_picture_turns_inwards_or_is_hidden() -> None:
    picture = Box(0.0, 0.0, 200.0, 100.0)

    def placed(u: float, v: float) -> Any:
        return arrange({"it": Candidate(u, v, 60.0, 16.0, "bottom-left")}, {}, picture)["it"]

    assert placed(100.0, 50.0) == "bottom-left"
    assert placed(190.0, 50.0) == "bottom-right"
    assert placed(100.0, 5.0) == "top-left"
    assert placed(190.0, 5.0) == "top-right"
    assert placed(-5.0, 50.0) is None


def test_a_label_does_not_flicker_while_another_grazes_it() -> None:
    """While the other one oscillates by 2.5 px it changes its anchor once at most."""
    low = Candidate(100.0, 100.0, 60.0, 16.0, "bottom-left")
    placed: dict[str, Any] = {}
    seen = []
    for k in range(40):
        # The lower one's top is at 84 px: gaps of 0.5 px and 3 px in turn.
        high = Candidate(100.0, 83.5 - 2.5 * (k % 2), 60.0, 16.0, "bottom-left")
        placed = arrange({"high": high, "low": low}, placed, UNBOUNDED)
        seen.append(placed["low"])
    assert sum(a != b for a, b in itertools.pairwise(seen)) <= 1


def test_points_are_projected_as_by_the_matrices_of_a_graphics_card() -> None:
    rng = np.random.default_rng(3)
    for fov in (np.deg2rad(40.0), np.deg2rad(2.0)):
        R, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        R[:, 2] *= np.linalg.det(R)
        eye = Camera(rng.normal(size=3), R, fov, 640.0, 360.0)
        points = eye.position + (rng.normal(size=(50, 3)) * [0.3, 0.3, 1.0] @ R.T) * 20.0
        places, in_front = labels.project(points, eye)
        view = np.eye(4)
        view[:3, :3] = np.column_stack([R[:, 0], -R[:, 1], -R[:, 2]]).T
        view[:3, 3] = -view[:3, :3] @ eye.position
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
def test_the_size_of_a_label_bounds_that_in_the_widest_common_font(text: str) -> None:
    """DejaVu Sans, the default of many Linux systems; part of matplotlib."""
    import matplotlib

    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    font = ImageFont.truetype(str(path), 1000)
    line = sum(font.getmetrics()) / 1000.0
    width, height = size(text, 0.8)
    assert font.getlength(text) / 1000.0 + 0.2 * line < width / (0.8 * 12.0)
    assert 1.2 * line < height / (0.8 * 12.0)


class Nodes:
    """A stand-in for viser's scene: stores the nodes, counts changed attributes."""

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


def client_at(distance: float) -> Any:
    """A client whose camera looks along y at the origin, from a distance, z up."""
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


def test_each_client_has_the_labels_with_room_in_its_own_picture() -> None:
    page = Labels(SimpleNamespace())
    crossing = page.add("/crossing/label", "crossed", anchor="top-left")
    name = page.add("/proxy/gizmo_name", "proxy", anchor="top-left")
    page.add("/tool/force_label", "1 N", anchor="top-left")  # not visible
    crossing.visible = name.visible = True
    name.position = (1.0, 0.0, 0.3)
    near, far = client_at(10.0), client_at(2000.0)
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
    assert near.scene.sent == far.scene.sent == 0, "nothing unchanged is sent"
    crossing.visible = False
    page.place({0: near, 1: far})
    assert far.scene.made["/labels/proxy gizmo_name"].visible, "there is room for it now"

    # A label behind the camera is not drawn and takes no room.
    crossing.visible, crossing.position = True, (0.0, -50.0, 0.0)
    page.place({0: near})
    assert not near.scene.made["/labels/crossing label"].visible
    assert near.scene.made["/labels/proxy gizmo_name"].visible
    again = client_at(10.0)
    page.place({2: again})
    assert again.scene.made["/labels/proxy gizmo_name"].visible


def test_every_label_has_one_rank_of_importance() -> None:
    page = Labels(SimpleNamespace())
    page.add("/tool/force_label", anchor="top-left")
    for wrong in ("/tool/force_label", "/tool/weight"):
        with pytest.raises(ValueError, match=wrong):
            page.add(wrong, anchor="top-left")
    assert len(set(labels.IMPORTANCE)) == len(labels.IMPORTANCE)


def test_scale_bars_that_are_switched_off_stay_off_in_another_scene() -> None:
    page, bars = Labels(SimpleNamespace()), []

    def line(*_: object, **more: Any) -> SimpleNamespace:
        bars.append(SimpleNamespace(visible=True))
        return bars[-1]

    rulers = Rulers(SimpleNamespace(add_line_segments=line), page)
    built = scenes.build(Options(mesh="cube", robot="point"), 1)
    shown = lambda: [*(bar.visible for bar in bars[-2:]), page["/ruler/site/label"].visible]  # noqa: E731
    rulers.set_scene(built)
    assert shown() == [True, True, True]
    # At most 0.3 of half the view's height, a quarter of the cube's diagonal of 69 mm.
    assert page["/ruler/site/label"].text == "5 mm"
    rulers.show(False)
    rulers.set_scene(built)
    assert shown() == [False, False, False]
