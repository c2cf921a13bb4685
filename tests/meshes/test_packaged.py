"""Anatomy read from other packages' data, and what is said where they are not installed."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

import meshes
from meshes.builtin import packaged

needs_nilearn = pytest.mark.skipif(not packaged.has_nilearn(), reason="nilearn is not installed")


@needs_nilearn
def test_the_cortex_is_two_closed_hemispheres_left_and_right() -> None:
    vertices, faces = meshes.arrays("cortex")
    assert len(faces) == 40_960
    whole = trimesh.Trimesh(vertices * 1e3, faces, process=False)
    left, right = sorted(whole.split(), key=lambda side: side.centroid[0])
    for side in (left, right):
        assert side.is_watertight
        assert side.euler_number == 2
        # An adult's hemisphere takes some half a litre [mm³].
        assert 4e5 < side.volume < 6e5
    assert left.centroid[0] < -20.0 < 20.0 < right.centroid[0]
    # Longest from front to back, and deepest (the temporal lobes) in the front half.
    assert np.argmax(whole.extents) == 1
    assert vertices[np.argmin(vertices[:, 2]), 1] > vertices[:, 1].min() + 0.05


@needs_nilearn
@pytest.mark.slow
@pytest.mark.parametrize(("name", "least"), [("brain", 300_000), ("brain-fine", 1_000_000)])
def test_the_brain_is_one_closed_outward_body_of_a_brains_size(name: str, least: int) -> None:
    vertices, faces = meshes.arrays(name)
    assert least < len(faces) < 1.4 * least
    whole = trimesh.Trimesh(vertices * 1e3, faces, process=False)
    assert whole.is_watertight
    assert whole.is_winding_consistent
    assert whole.body_count == 1
    assert 1.5e6 < whole.volume < 2.0e6  # ventricles included [mm³]
    # The finer one is the same brain in the same place.
    coarse = meshes.arrays("brain")[0]
    for end in (np.min, np.max):
        np.testing.assert_allclose(end(vertices, axis=0), end(coarse, axis=0), atol=2e-4)


def test_a_bunny_is_read_as_data_and_no_code_of_its_package_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "pymeshfix"
    (package / "examples").mkdir(parents=True)
    (package / "__init__.py").write_text("raise AssertionError('the package was imported')")
    solid = trimesh.creation.box((1.0, 3.0, 2.0))  # y is up
    solid.export(package / "examples" / "StanfordBunny.ply")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    assert packaged.has_bunny()
    vertices, faces = packaged.bunny()
    np.testing.assert_allclose(
        np.ptp(vertices, axis=0), np.array([1.0, 2.0, 3.0]) * 0.1557 / 3.0, atol=1e-9
    )
    assert trimesh.Trimesh(vertices, faces).volume > 0.0


def test_what_is_not_on_this_machine_is_said_with_its_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    everywhere = {"cortex", "brain", "brain-fine", "bunny"}
    assert set(meshes.absent()) | set(meshes.catalogue()) >= everywhere
    assert not set(meshes.absent()) & set(meshes.catalogue())
    remedy = {"moon": "pip install 'vf-sandbox[space]'"}
    monkeypatch.setattr(sys.modules["meshes.load"], "absent", lambda: remedy)
    with pytest.raises(meshes.MeshError, match=r"'moon' is not on this machine: pip install.*spac"):
        meshes.load("moon")
