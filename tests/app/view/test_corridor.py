"""The corridor, from options and session to the planes of a tick."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import meshes
import vf
from app.options import parse_as
from app.scene import scene as scenes
from app.session import Session
from app.settings import Options
from app.view.controls.corridor import far_end
from app.words import OptionError, Refused

SKULL = Options(mesh="skull-coarse", robot="point", corridor=1e-3)


def test_a_tool_driven_aside_stops_at_the_width() -> None:
    scene = scenes.build(SKULL, 1)
    plant = scenes.plant(scene, SKULL)
    path = scene.planned_path
    assert path is not None
    above = pin.SE3(scene.T_base_start)
    above.translation = path[15] + [0.0, 0.0, 3e-3]
    q = scene.arm.inverse(above, start=scene.start)
    aside = pin.SE3(above)
    aside.translation = above.translation + np.array([4e-3, 0.0, 0.0])
    for _ in range(400):
        step = plant.controller.step(q, aside)
        q = step.q
    assert step.tip.translation[0] - path[15, 0] == pytest.approx(1e-3 - 20e-6, abs=3e-6)
    assert vf.Rule.CORRIDOR in step.planes.rules


def test_the_width_is_set_clamped_and_switched_off_while_running() -> None:
    session = Session(replace(SKULL, corridor=None))
    assert len(session._writer.orders.plant.controller.fixtures) == 1
    assert session.set(corridor=0.5).corridor == 0.02
    assert session.set(corridor=2e-3).corridor == 2e-3
    corridor = session._writer.orders.plant.controller.fixtures[1]
    assert isinstance(corridor, vf.CorridorFixture)
    assert corridor.width == 2e-3
    np.testing.assert_allclose(corridor.direction, [0.0, 0.0, -1.0], atol=0.2)
    assert abs(corridor.direction[0]) < 1e-12  # the sagittal plane
    assert session.set(corridor=None).corridor is None
    assert len(session._writer.orders.plant.controller.fixtures) == 1


def test_without_a_path_there_is_no_corridor() -> None:
    options = Options(mesh="cube", robot="point", corridor=1e-3)
    session = Session(options)
    assert any("No path is planned" in note for note in session.scene.notes)
    assert len(session._writer.orders.plant.controller.fixtures) == 1
    with pytest.raises(Refused, match="no path is planned"):
        session.set(corridor=1e-3)


def test_a_path_from_a_file_is_taken_to_the_base_frame(tmp_path: Path) -> None:
    file = tmp_path / "path.csv"
    file.write_text("# on top of the cube\n-10, 0, 20\n0 0 20\n10, 8, 20  # end\n", "utf-8")
    options = Options(mesh="cube", robot="point", corridor=1e-3, path=str(file))
    scene = scenes.build(options, 1)
    expected = meshes.transformed(
        scene.T_base_mesh, np.array([[-10, 0, 20], [0, 0, 20], [10, 8, 20]]) * 1e-3
    )
    np.testing.assert_allclose(scene.planned_path, expected, atol=1e-15)
    assert len(scenes.plant(scene, options).controller.fixtures) == 2


@pytest.mark.parametrize(
    ("text", "word"),
    [("1 2\n", "line 1"), ("1 2 3\nx y z\n", "line 2"), ("1 2 3\n", "two"), ("1 2 inf\n", "line")],
)
def test_what_is_no_path_is_refused(tmp_path: Path, text: str, word: str) -> None:
    file = tmp_path / "path.txt"
    file.write_text(text, "utf-8")
    with pytest.raises(meshes.MeshError, match=word):
        meshes.read_path(file)


def test_the_width_on_the_command_line() -> None:
    assert parse_as(Options, "vf-sandbox", ["--corridor", "2mm"]).corridor == 2e-3
    assert parse_as(Options, "vf-sandbox", ["--corridor", "off"]).corridor is None
    with pytest.raises(OptionError, match="outside"):
        parse_as(Options, "vf-sandbox", ["--corridor", "1m"])


def test_the_name_of_the_cut_stands_at_the_end_that_is_away_from_the_tip() -> None:
    ends = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0]])
    assert far_end(ends, np.array([0.001, 0.0, 0.0]), last=0) == 1
    assert far_end(ends, np.array([0.029, 0.0, 0.0]), last=1) == 0
    # Half-way it stays where it is.
    for last in (0, 1):
        assert far_end(ends, np.array([0.0145, 0.0, 0.0]), last) == last
        assert far_end(ends, np.array([0.0155, 0.0, 0.0]), last) == last
