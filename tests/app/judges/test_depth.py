"""How deep bodies are in a mesh, against spheres and boxes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from app.judges import boxes, depth


def test_closed_is_every_edge_both_ways() -> None:
    faces = np.array(trimesh.creation.box([1, 1, 1]).faces)
    assert depth.closed(faces)
    assert depth.closed(faces[:, ::-1])
    assert not depth.closed(faces[1:])
    flipped = faces.copy()
    flipped[0] = flipped[0, ::-1]
    assert not depth.closed(flipped)


def test_the_depth_of_points_of_a_box_is_to_its_nearest_side() -> None:
    box = trimesh.creation.box([0.04, 0.06, 0.08])
    for faces in (box.faces, box.faces[:, ::-1]):
        tree = boxes.build(np.array(box.vertices), np.array(faces))
        rng = np.random.default_rng(0)
        for _ in range(100):
            p = rng.uniform(-0.05, 0.05, 3)
            inside = np.array([0.02, 0.03, 0.04]) - np.abs(p)
            true = inside.min() if (inside > 0).all() else -np.linalg.norm(np.minimum(inside, 0))
            assert depth.signed(tree, p, True) == pytest.approx(true, abs=1e-12)
            assert depth.signed(tree, p, False) == pytest.approx(-abs(true), abs=1e-12)


def test_a_capsule_is_as_deep_as_the_deepest_of_its_axis() -> None:
    """In a slab, whose middle is the deepest."""
    box = trimesh.creation.box([1.0, 1.0, 0.02])
    tree = boxes.build(np.array(box.vertices), np.array(box.faces))
    rng = np.random.default_rng(1)
    for _ in range(60):
        a = np.append(rng.uniform(-0.1, 0.1, 2), rng.uniform(-0.03, 0.03))
        b = np.append(rng.uniform(-0.1, 0.1, 2), rng.uniform(-0.03, 0.03))
        low, high = sorted([a[2], b[2]])
        least = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
        deep = 0.01 - least + 2e-3
        axis = np.stack([a, b])
        assert depth.deeper(tree, axis, 2e-3, deep - 2e-6, True)
        assert not depth.deeper(tree, axis, 2e-3, deep + 2e-6, True)
        if low < 0.01 < high:  # without an inside: the axis meets the slab
            assert depth.deeper(tree, axis, 2e-3, 2e-3 - 1e-7, False)
            assert not depth.deeper(tree, axis, 2e-3, 2e-3 + 1e-7, False)


def test_the_winding_number_counts_bodies_around_a_point() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.01)
    one, faces = np.array(ball.vertices), np.array(ball.faces)
    two = np.concatenate([one, 2.0 * one])
    both = np.concatenate([faces, faces + len(one)])
    for x, count in (([0, 0, 0], 2), ([0.015, 0, 0], 1), ([0.03, 0, 0], 0)):
        assert depth.winding(two, both, np.array(x, dtype=float)) == pytest.approx(count, abs=1e-9)
