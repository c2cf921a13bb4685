"""A file's unit is said, or the only possible one, or has to be said: it is never off by 1000."""

from __future__ import annotations

import pickle
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import meshes
from meshes import units
from tests.support.mesh_files import tetrahedron


def usable(size: float) -> bool:
    """[m]: what any unit is allowed to make of a mesh."""
    return 1e-4 <= size <= 10.0


@given(st.floats(-6.0, 6.0).map(lambda power: 10.0**power))
def test_no_unit_is_assumed_where_the_other_is_possible_too(across: float) -> None:
    in_mm, in_m = usable(across * 1e-3), usable(across)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        if in_mm and in_m:
            with pytest.raises(meshes.UnitNeeded) as asked:
                units.resolved_unit("part.stl", across, None)
            assert asked.value.sizes == {"mm": across * 1e-3, "m": across}
        elif in_mm or in_m:
            assert units.resolved_unit("part.stl", across, None) == ("mm" if in_mm else "m")
            assert [w.category for w in caught] == [meshes.UnitGuess]
        else:
            with pytest.raises(meshes.MeshError, match=r"0\.1 mm to 10 m is possible"):
                units.resolved_unit("part.stl", across, None)


@given(st.floats(-6.0, 6.0).map(lambda power: 10.0**power), st.sampled_from([*meshes.UNITS]))
def test_what_is_said_is_not_asked_again(across: float, unit: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for given_, said in ((unit, None), (None, unit), (unit, "in")):
            if usable(across * meshes.UNITS[unit]):
                assert units.resolved_unit("part.stl", across, given_, said) == unit
            else:
                with pytest.raises(meshes.MeshError):
                    units.resolved_unit("part.stl", across, given_, said)
    for name, words in units.choices(across, unit).items():
        assert usable(across * meshes.UNITS[name])
        number, of = re.fullmatch(
            rf"{name}(?:, as the file says)?: (\S+) (mm|m) from corner to corner", words
        ).groups()  # type: ignore[union-attr]
        assert float(number) * meshes.UNITS[of] == pytest.approx(
            across * meshes.UNITS[name], rel=1e-3
        )


@pytest.mark.parametrize("across", [0.11, 3.0, 4.95, 5.05, 9.9])
def test_siblings_of_one_set_are_never_read_a_thousand_apart(tmp_path: Path, across: float) -> None:
    path = tetrahedron(tmp_path / "tip.obj", across)
    for way in (meshes.load, meshes.arrays):
        with pytest.raises(meshes.UnitNeeded) as asked:
            way(path)
        said = str(asked.value)
        assert f"{across:.4g} mm" in said
        assert f"{across:.4g} m " in said or f"{across * 1e3:.4g} mm " in said
        assert "--unit mm or --unit m" in said
    assert np.ptp(meshes.arrays(path, unit="mm")[0], axis=0).max() < 0.01
    again = pickle.loads(pickle.dumps(asked.value))
    assert (str(again), again.sizes) == (said, asked.value.sizes)


def test_what_only_one_unit_can_be_is_told(tmp_path: Path) -> None:
    for across, unit in ((0.07, "m"), (35.0, "mm"), (250.0, "mm")):
        path = tetrahedron(tmp_path / "m.obj", across)
        with pytest.warns(meshes.UnitGuess, match=rf"taken to be in {unit} .*say the unit"):
            vertices, _ = meshes.arrays(path)
        assert np.linalg.norm(np.ptp(vertices, axis=0)) == pytest.approx(
            across * meshes.UNITS[unit]
        )
