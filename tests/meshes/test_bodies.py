"""Cavities are judged by what is around them, whatever became of the wall around them.

Nests of shells are made so that it is known what lies inside what; the judge is how they were made.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st

from meshes.checks.health import health
from meshes.checks.repair import repair

Mesh = tuple[np.ndarray, np.ndarray]
WHOLE, HOLED, TORN, FINNED, UNWELDED = "whole", "holed", "torn", "finned", "unwelded"


@dataclass
class Shell:
    """A ball, rightly wound for where it is: bone looks outwards, a cavity into itself.

    ``against`` is its triangle, if any, that is a fin wound against an earlier fin.
    """

    centre: np.ndarray
    radius: float
    depth: int
    harm: str
    against: int | None = None
    inside: list[Shell] = field(default_factory=list)

    @property
    def wall(self) -> bool:
        return self.harm != WHOLE

    def everyone(self) -> list[Shell]:
        return [self, *(one for child in self.inside for one in child.everyone())]


def grown(
    rng: np.random.Generator, harms: tuple[str, ...], centre: np.ndarray, radius: float, depth: int
) -> Shell:
    shell = Shell(centre, radius, depth, str(rng.choice(harms)))
    # One or two inside, on either side of the middle.
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    for side in (-1.0, 1.0)[: int(rng.integers(0, 3)) if depth < 3 else 0]:
        at = centre + side * 0.42 * radius * axis
        shell.inside.append(grown(rng, harms, at, radius * rng.uniform(0.25, 0.38), depth + 1))
    return shell


def triangles(shell: Shell, rng: np.random.Generator) -> np.ndarray:
    """Corners (m, 3, 3) of one shell with its damage."""
    ball = trimesh.creation.icosphere(2, shell.radius)
    ball.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
    corners = np.asarray(ball.triangles) + shell.centre
    if shell.depth % 2:
        corners = corners[:, ::-1]
    towards = rng.normal(size=3)
    side = (corners.mean(axis=1) - shell.centre) @ (towards / np.linalg.norm(towards))
    if shell.harm == HOLED:  # a round hole of up to a tenth of the area
        corners = corners[side < shell.radius * rng.uniform(0.8, 0.95)]
    elif shell.harm == TORN:
        corners = np.delete(corners, rng.choice(len(corners), len(corners) // 20), axis=0)
    elif shell.harm == FINNED:
        tips: list[np.ndarray] = []
        for corner in corners[rng.choice(len(corners), 3, replace=False)]:
            tip = corner[0] + (corner[0] - shell.centre) * rng.choice([-0.02, 0.02])
            corners = np.concatenate([corners, [[corner[0], corner[1], tip]]])
            tips.append(tip)
        # Two fins with one tip share the edge from it to the corner, and both walk it that way:
        # they are a patch of two faces wound against each other. Three with one tip share an edge
        # of three faces: each is a patch by itself.
        later = [b for b in range(3) for a in range(b) if np.array_equal(tips[a], tips[b])]
        if len(later) == 1:
            shell.against = len(corners) - 3 + later[0]
    return corners


def assembled(parts: list[np.ndarray], loose: list[bool]) -> Mesh:
    """Vertices and faces, welded where coordinates are equal, but for the loose parts."""
    vertices, faces, first = [], [], 0
    for corners, unwelded in zip(parts, loose, strict=True):
        points = corners.reshape(-1, 3)
        number = np.arange(len(points))
        if not unwelded:
            points, number = np.unique(points, axis=0, return_inverse=True)
        vertices.append(points)
        faces.append(number.reshape(-1, 3) + first)
        first += len(points)
    return np.vstack(vertices), np.vstack(faces)


def nest(seed: int, harms: tuple[str, ...]) -> tuple[Shell, Mesh, np.ndarray]:
    """A nest, its mesh, and for each face the shell that it is of."""
    rng = np.random.default_rng(seed)
    root = grown(rng, harms, np.zeros(3), 0.05, 0)
    shells = root.everyone()
    parts = [triangles(shell, rng) for shell in shells]
    mesh = assembled(parts, [shell.harm == UNWELDED for shell in shells])
    return root, mesh, np.repeat(np.arange(len(parts)), [len(part) for part in parts])


def clashing(root: Shell, of: np.ndarray) -> np.ndarray:
    """The faces wound against the other face, an earlier one, of their patch of two."""
    shells = enumerate(root.everyone())
    rows = [
        np.flatnonzero(of == k)[shell.against] for k, shell in shells if shell.against is not None
    ]
    return np.array(rows, dtype=np.int64)


def nested(shell: Shell, walls: int = 0, loose: int = 0) -> int:
    """Closed bodies that are seen to lie in something.

    Of unwelded walls only all triangles together are seen, which of two such walls are none.
    """
    count = int(not shell.wall and (walls > 0 or loose % 2 == 1))
    unwelded = shell.harm == UNWELDED
    return count + sum(
        nested(child, walls + (not unwelded), loose + unwelded) for child in shell.inside
    )


SEEDS = st.integers(0, 10_000)


@given(seed=SEEDS)
@example(seed=170)  # two fins with one tip
@settings(max_examples=25, deadline=None)
def test_a_rightly_wound_nest_is_left_as_it_is_however_damaged(seed: int) -> None:
    """No body or patch is turned, and no face but those wound against their own patch."""
    root, (vertices, faces), of = nest(seed, (WHOLE, WHOLE, HOLED, TORN, FINNED, UNWELDED))
    against = clashing(root, of)
    report = health(vertices, faces, examine=0)
    assert report.count("flipped faces") == len(against)
    assert report.count("inside-out bodies") == 0
    assert report.count("nested bodies") == nested(root)
    result = repair(vertices, faces, tolerance=0.0)
    assert (result.changes.turned_bodies, result.changes.turned_patches) == (0, 0)
    assert result.changes.flipped == len(against)
    faces[against] = faces[against][:, [0, 2, 1]]
    np.testing.assert_array_equal(result.vertices[result.faces], vertices[faces])


@given(seed=SEEDS)
@example(seed=310)  # two fins with one tip, in a whole wall
@example(seed=361)  # and in an open one
@settings(max_examples=20, deadline=None)
def test_an_inverted_nest_is_turned_as_a_whole_or_not_at_all(seed: int) -> None:
    """But for the faces wound against their own patch, which are made to agree with it first."""
    root, (vertices, faces), of = nest(seed, (WHOLE, WHOLE, HOLED, TORN, FINNED))
    inverted = faces[:, [0, 2, 1]]
    against = clashing(root, of)
    agreeing = faces.copy()
    agreeing[against] = inverted[against]
    result = repair(vertices, inverted, tolerance=0.0)
    assert health(vertices, inverted, examine=0).count("inside-out bodies") == (not root.wall)
    # An open wall has no outside to be known by: nor has what is in it.
    wanted = agreeing[:, [0, 2, 1]] if root.wall else agreeing
    assert result.changes.flipped == len(against)
    np.testing.assert_array_equal(result.vertices[result.faces], vertices[wanted])
    if root.wall:
        flipped = repair(vertices, inverted, tolerance=0.0, flip=True)
        np.testing.assert_array_equal(flipped.vertices[flipped.faces], vertices[agreeing])


@given(seed=SEEDS, harm=st.sampled_from([HOLED, TORN, FINNED, UNWELDED]))
@settings(max_examples=15, deadline=None)
def test_a_body_beside_a_broken_wall_is_judged_by_itself(seed: int, harm: str) -> None:
    rng = np.random.default_rng(seed)
    wall = Shell(np.zeros(3), 0.05, 0, harm)
    away = rng.normal(size=3)
    away *= rng.uniform(0.062, 0.2) / np.linalg.norm(away)
    beside = Shell(away, 0.01, 1, WHOLE)  # it looks into itself, but is in nothing
    mesh = assembled([triangles(wall, rng), triangles(beside, rng)], [harm == UNWELDED, False])
    report = health(*mesh, examine=0)
    assert (report.count("inside-out bodies"), report.count("nested bodies")) == (1, 0)
    assert repair(*mesh, tolerance=0.0).changes.turned_bodies == 1


def enclosed(shell: Shell, winding: dict[int, int], around: int = 0) -> float:
    """Volume [m³] where the winding number is not zero, from the inside of one shell on."""
    volume = trimesh.creation.icosphere(2, 1.0).volume
    here = around + winding[id(shell)]
    own = shell.radius**3 - sum(child.radius**3 for child in shell.inside)
    return (here != 0) * own * volume + sum(
        enclosed(child, winding, here) for child in shell.inside
    )


@given(seed=SEEDS)
@settings(max_examples=20, deadline=None)
def test_the_enclosed_volume_is_where_the_winding_number_is_not_zero(seed: int) -> None:
    root, (vertices, faces), of = nest(seed, (WHOLE,))
    rng = np.random.default_rng(seed)
    shells = root.everyone()
    turned = rng.random(len(shells)) < 0.5
    winding = {
        id(shell): (-1) ** shell.depth * (-1) ** int(turn)
        for shell, turn in zip(shells, turned, strict=True)
    }
    hurt = np.where(turned[of][:, None], faces[:, ::-1], faces)
    found = health(vertices, hurt, examine=0).volume
    assert found == pytest.approx(enclosed(root, winding), rel=1e-9, abs=1e-18)
    assert health(vertices, hurt[:, ::-1], examine=0).volume == pytest.approx(found, rel=1e-12)


def test_the_two_bodies_of_an_inverted_file_do_not_cancel() -> None:
    box = trimesh.creation.box((0.03, 0.02, 0.01))
    two = np.vstack([box.faces[:, ::-1], box.faces + 8])
    vertices = np.vstack([box.vertices, box.vertices + np.array([0.1, 0.0, 0.0])])
    report = health(vertices, two)
    assert report.volume == pytest.approx(12e-6)
    assert report.count("inside-out bodies") == 1
    assert health(vertices, two[1:]).volume is None
