"""What the tests of the benchmarks share: a small shape, the same on every machine."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import meshes
import robots
import vf
from meshes.builtin import cache, ladder

SMALL = ladder.Source("organic", ladder.organic, "organic")


@pytest.fixture(autouse=True, scope="module")
def the_same_everywhere(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The built-in shape whatever is installed, and a cache of this run's own."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setattr(cache, "folder", lambda: folder)
        patch.setattr(ladder, "source", lambda path=None, unit=None: SMALL)
        yield


@pytest.fixture(scope="module")
def small(the_same_everywhere: None) -> vf.Surface:
    vertices, faces = ladder.rungs(SMALL, (10_240,))[10_240]
    arm = robots.load("psm")
    return vf.Surface.from_arrays(meshes.place(vertices, arm.tip(arm.neutral)), faces)
