"""Sessions with several structures: each with its margin, changed while they run, replayed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import meshes
from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats
from app.recording import playback, rerun
from app.recording.format import RecordingError
from app.recording.read import read
from app.scenarios.file import Scenario, dumps, loads, write
from app.scenarios.file import read as read_scenario
from app.scenarios.staging import present, stage
from app.scene import scene as scenes
from app.session import Session
from app.settings import Options
from app.structure import Structure
from app.words import Refused
from tests.support import structured
from tests.support.headless import wait_until

STANDOFF = Options().standoff


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return structured.balls(tmp_path_factory.mktemp("balls"))


@pytest.fixture(params=[False, True], ids=["thread", "process"])
def session(request: pytest.FixtureRequest, folder: Path) -> Iterator[Session]:
    with Session(structured.options(folder), process=request.param) as running:
        yield running


def at_centre(session: Session, number: int) -> pin.SE3:
    """A goal in the middle of a ball."""
    start = session.scene.T_base_start
    middle = session.scene.surfaces[number].vertices.mean(axis=0)
    return pin.SE3(start.rotation, middle)


def gap(session: Session, number: int) -> float:
    """From the tip to a structure [m]."""
    step = session.latest().step
    assert step is not None
    return float(session.scene.surfaces[number].nearest(np.array(step.tip.translation))[0])


def held(session: Session, number: int) -> bool:
    """Whether planes of this structure alone hold the tool."""
    step = session.latest().step
    if step is None or step.planes.fixtures is None:
        return False
    on = [k for k, own in enumerate(session.options.anatomy) if own.guarded]
    return {on[f] for f in step.planes.fixtures[step.multipliers > 1e-9]} == {number}


def rests(session: Session) -> None:
    """Wait until the tool does not move any more."""
    last = [np.full(3, np.nan)]

    def same() -> bool:
        step = session.latest().step
        assert step is not None
        before, last[0] = last[0], np.array(step.tip.translation)
        tick = session.latest().tick
        wait_until(lambda: session.latest().tick > tick + 20)
        return bool(np.linalg.norm(last[0] - before) < 1e-9)

    wait_until(same)


def test_each_structure_keeps_the_tool_at_its_margin(session: Session) -> None:
    assert [own.name for own in session.options.anatomy] == ["cube", *structured.NAMES]
    for number, name in enumerate(structured.NAMES, 1):
        session.reset()
        session.drive(at_centre(session, number))
        wait_until(lambda number=number: held(session, number))
        rests(session)
        margin = structured.MARGINS[name]
        assert margin + STANDOFF - 1e-9 <= gap(session, number) < margin + STANDOFF + 1e-4
    assert session.crossing is None


def test_margin_and_switch_are_set_while_it_runs(session: Session) -> None:
    number = 2
    session.drive(at_centre(session, number))
    wait_until(lambda: held(session, number))
    options = session.set_structure(number, margin=3e-3)
    assert options is session.options
    assert session.options.structures[number - 1].margin == 3e-3
    # A larger margin leads the tool out to it.
    wait_until(lambda: gap(session, number) >= 3e-3 + STANDOFF - 1e-6)
    session.set_structure(number, margin=0.0)
    wait_until(lambda: gap(session, number) < 1e-4)
    assert session.crossing is None
    session.set_structure(number, guarded=False)
    surface = session.scene.surfaces[number]
    wait_until(lambda: surface.inside(np.array(session.latest().step.tip.translation)))
    # What is not guarded is not judged either.
    assert session.crossing is None
    assert session.unwatched == 0
    session.reset()
    session.set_structure(number, guarded=True)
    session.set(rule="off")
    session.drive(at_centre(session, number))
    wait_until(lambda: session.crossing is not None)
    assert session.crossing is not None
    assert session.crossing.structure == "nerve"


def test_looks_change_without_a_new_plant(session: Session) -> None:
    plant = session._writer.orders.plant
    session.set_structure(1, colour="#010203", opacity=0.25, name="outer")
    assert session.options.structures[0].colour == "#010203"
    session.set_structure(0, opacity=0.5, colour="#030201")
    assert session.options.anatomy[0].opacity == 0.5
    assert session._writer.orders.plant is plant
    session.set_structure(1, margin=99.0)  # clamped, as every number
    assert session.options.structures[0].margin == 0.05
    assert session._writer.orders.plant is not plant


def test_what_cannot_be_set_of_a_structure_is_refused(session: Session) -> None:
    before = session.options
    for number, changes, words in (
        (4, {"margin": 0.0}, "no structure 4: they are 0 to 3"),
        (-1, {"margin": 0.0}, "no structure -1"),
        (1, {"file": "x.stl"}, "file is none of what is set of a structure: margin, guard"),
        (1, {"guard": "all"}, "unknown guard 'all': choose one of tip, tool"),
        (1, {"colour": "red"}, "colour must be a colour"),
        (1, {"margin": float("nan")}, "margin"),
        (0, {"name": "x"}, "name is none of what is set live"),
    ):
        with pytest.raises(Refused, match=words):
            session.set_structure(number, **changes)
    assert session.options == before


def test_another_arm_keeps_the_structures_and_another_mesh_drops_them(session: Session) -> None:
    session.set_structure(1, margin=4e-3)
    scene = session.change(robot="psm")
    assert len(scene.structures) == 3
    assert session.options.structures[0].margin == 4e-3
    session.drive(at_centre(session, 1))
    wait_until(lambda: held(session, 1))
    session.set_structure(0, guarded=False, margin=1e-3, opacity=0.5, colour="#010203")
    session.change(mesh="gear")
    # Another mesh is guarded, whatever the one before was.
    assert session.options.anatomy == (Structure("gear", name="gear", margin=0.0),)
    assert session.scene.surfaces == (session.scene.surface,)
    session.drive(session.scene.T_base_start)
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 20)


def test_a_session_with_changes_is_replayed_bit_for_bit(
    session: Session, folder: Path, tmp_path: Path
) -> None:
    tape = session.record(tmp_path / "run.vfrec")
    session.drive(at_centre(session, 1))
    wait_until(lambda: held(session, 1))
    session.set_structure(1, margin=2e-3)
    session.drive(at_centre(session, 2))
    wait_until(lambda: held(session, 2))
    session.set_structure(2, guarded=False)
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 50)
    last = session.latest()
    session.stop_recording()
    recording = read(tape.path)
    (place,) = recording.places
    assert [own.name for own in place.options.structures] == list(structured.NAMES)
    assert [one.checksum for one in place.structures] == [
        surface.checksum for surface in session.scene.surfaces[1:]
    ]
    margins = [options.structures[0].margin for _, options in recording.plants]
    assert margins[0] == structured.MARGINS["dura"]
    assert margins[-1] == 2e-3
    assert rerun.first_difference(recording) is None
    # The page's replay, too.
    built = playback.build_scenes(recording, 100, session.scene)
    assert built == (session.scene,)
    player = playback.Player(recording, built)
    moment = player.moment(len(player) - 1)
    assert not moment.options.structures[1].guarded
    assert moment.telemetry.tick >= last.tick


def test_a_structure_that_has_changed_is_refused_by_name(folder: Path, tmp_path: Path) -> None:
    own = tmp_path / "dura.stl"
    own.write_bytes((folder / "dura.stl").read_bytes())
    options = structured.options(folder, structures=(Structure(str(own), unit="mm"),))
    with Session(options) as session:
        tape = session.record(tmp_path / "run.vfrec")
        wait_until(lambda: session.latest().tick > 20)
    recording = read(tape.path)
    assert rerun.first_difference(recording) is None
    vertices, faces = meshes.arrays(str(own), unit="mm")
    meshes.save(own, vertices * 1.001, faces, unit="mm", overwrite=True)
    with pytest.raises(
        RecordingError, match=r"the structure 'dura' of '.*dura.stl' is not the one"
    ):
        rerun.first_difference(recording)


def test_a_scenario_has_its_structures_in_a_file(folder: Path) -> None:
    options = structured.options(folder, structures=(
        Structure(str(folder / "dura.stl"), margin=1e-3, unit="mm", colour="#010203"),
        Structure(str(folder), "nerve", guarded=False, unit="mm"),
        Structure("temporal-bone", "dura"),
    ))  # fmt: skip
    scenario = Scenario("ear", "Three structures.", options)
    path = folder / "ear.json"
    write(scenario, path)
    assert '"dura.stl"' in path.read_text()
    assert read_scenario(path).options.structures == options.structures
    text = dumps(scenario)
    with pytest.raises(ValueError, match="there is no file to find this one from"):
        loads(text)
    found = loads(text, find=lambda name: f"/kept/{name}")
    assert found.options.structures[0].file == "/kept/dura.stl"
    for file in ("../dura.stl", "/etc/dura.stl"):
        with pytest.raises(ValueError, match=r"structures.*in the scenario's own folder"):
            loads(text.replace('"dura.stl"', f'"{file}"'), folder)
    with pytest.raises(ValueError, match=r'"structures".*unknown mesh "cub": choose one of'):
        loads(text.replace('"dura.stl"', '"cub"'), folder)
    with pytest.raises(ValueError, match=r'"structures".*unknown key'):
        loads(text.replace('"colour": "#010203"', '"paint": "red"'), folder)


def test_a_scenario_of_a_session_is_staged_in_another(folder: Path) -> None:
    with Session(structured.options(folder)) as session:
        session.set_structure(3, margin=4e-3)
        scenario = present(session, "mine", "As it was.")
    with Session(Options(mesh="cube", robot="point")) as session:
        stage(scenario, session)
        assert session.options.structures == scenario.options.structures
        assert session.options.structures[2].margin == 4e-3
        assert len(session.scene.structures) == 3


def test_the_guard_of_a_structure_is_its_own(folder: Path) -> None:
    """With a structure that holds the tip alone, the shaft may pass through it."""
    options = structured.options(folder, robot="psm")
    scene = scenes.build(options, 1)
    plant = scenes.plant(scene, options)
    tip_only = replace(options, structures=tuple(
        replace(own, guard="tip") for own in scene.options.structures
    ))  # fmt: skip
    fixtures = scenes.plant(scene, tip_only).controller.fixtures
    assert [fixture.guard for fixture in fixtures] == [None, "tip", "tip", "tip"]
    assert [fixture.name for fixture in fixtures] == ["cube", *structured.NAMES]
    assert [fixture.guard for fixture in plant.controller.fixtures] == [None] * 4


def test_with_nothing_guarded_the_tool_goes_anywhere(folder: Path) -> None:
    options = structured.options(folder, guarded=False)
    scene = scenes.build(options, 1)
    off = replace(options, structures=tuple(
        replace(own, guarded=False) for own in scene.options.structures
    ))  # fmt: skip
    plant = scenes.plant(scene, off)
    assert plant.guarded == []
    goal = pin.SE3(scene.T_base_start.rotation, scene.surface.vertices.mean(axis=0))
    engine = Engine(Orders(plant, Command(goal, 1)))
    for _ in range(1000):
        telemetry, _ = engine.advance(engine.seen, LoopStats())
    assert telemetry.step is not None
    assert np.linalg.norm(telemetry.step.tip.translation - goal.translation) < 1e-4
