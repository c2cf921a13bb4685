"""A registration as an option, in a scene, in a session, in scenarios and recordings."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import meshes
from app.kinds import Points
from app.options import parse_as, plain, raw
from app.recording import playback, rerun
from app.recording.read import read
from app.scenarios.file import Scenario, dumps, loads
from app.scene import scene as scenes
from app.scene import structures
from app.session import Session
from app.settings import DECLARED, Options
from app.structure import Registration, Structure
from app.words import OptionError
from tests.support import structured
from tests.support.headless import wait_until

KIND = DECLARED["registration"].kind
# Corners of a tetrahedron below the cube, whose balls are above it: margins differ by half.
FIDUCIALS = np.array(
    [[-0.02, -0.02, -0.02], [0.025, -0.01, -0.02], [0.0, 0.03, -0.015], [0.0, 0.0, -0.05]]
)
TEXT = "# fiducials, mm\n-20 -20 -20\n25, -10, -20\n\n0 30 -15  # vertex\n0 0 -50\n"
FLE = 0.4e-3
OWN = Registration(tuple(map(tuple, FIDUCIALS.tolist())), FLE)


def naive(points: np.ndarray, fle: float = FLE, factor: float = 2.0) -> np.ndarray:
    """Fitzpatrick's formula as it is printed, in loops over lines in space."""
    middle = FIDUCIALS.mean(axis=0)
    inertia = (FIDUCIALS - middle).T @ (FIDUCIALS - middle)
    axes = np.linalg.eigh(inertia)[1].T
    found = []
    for point in points:
        total = 0.0
        for axis in axes:
            off = np.linalg.norm(np.cross(point - middle, axis))
            of_all = [np.linalg.norm(np.cross(one - middle, axis)) for one in FIDUCIALS]
            total += off**2 / np.mean(np.square(of_all))
        found.append(factor * fle / np.sqrt(len(FIDUCIALS)) * np.sqrt(1.0 + total / 3.0))
    return np.array(found)


def in_mesh(scene: scenes.Scene, points: np.ndarray) -> np.ndarray:
    """Points of the base frame in the mesh's own."""
    inverse = np.linalg.inv(scene.T_base_mesh)
    return points @ inverse[:3, :3].T + inverse[:3, 3]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return structured.balls(tmp_path_factory.mktemp("balls"))


@pytest.fixture(scope="module")
def file(folder: Path) -> Path:
    path = folder.parent / "fiducials.txt"
    path.write_text(TEXT)
    return path


@pytest.fixture(scope="module")
def scene(folder: Path) -> scenes.Scene:
    options = structured.options(folder, registration=OWN, rotate=(0.0, 0.3, 1.0))
    return scenes.build(options, 1)


@pytest.fixture(params=[False, True], ids=["thread", "process"])
def session(request: pytest.FixtureRequest, folder: Path, file: Path) -> Iterator[Session]:
    own = Registration(str(file), FLE)
    with Session(structured.options(folder, registration=own), process=request.param) as running:
        yield running


# As an option


def test_it_is_given_on_the_command_line() -> None:
    words = "--registration f.txt --fle 0.5mm --factor 3 --structure a.stl --margin 1mm"
    found = parse_as(Options, "test", words.split())
    assert found.registration == Registration("f.txt", 0.5e-3, 3.0)
    assert found.structures == (Structure("a.stl", margin=1e-3),)
    assert parse_as(Options, "test", ["--registration=off"], default=found).registration is None
    points = parse_as(Options, "test", ["--registration", "0,0,0;1cm,0,0; 0,2mm,0"]).registration
    assert points is not None
    assert points.fiducials == ((0, 0, 0), (0.01, 0, 0), (0, 0.002, 0))


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("--fle 0mm", "registration: fle 0mm is outside 0.001mm to 20mm"),
        ("--fle 1", "registration: '1' has no unit: write 1mm"),
        ("--factor 0", "registration: factor 0 is outside 0.1 to 10"),
    ],
)
def test_a_wrong_value_is_refused_by_name(words: str, line: str) -> None:
    with pytest.raises(OptionError) as caught:
        parse_as(Options, "test", f"--registration f.txt {words}".split())
    assert line.split(" is outside")[0] in str(caught.value)


@pytest.mark.parametrize(
    ("fiducials", "line"),
    [
        (((0.0, 0.0, 0.0),) * 2, "fiducials must be 3 to 1000 points, or a file, not 2"),
        ((1.0, 2.0, 3.0), "fiducials 1 must be three lengths"),
        (((0.0, 0.0, 0.0), (0.0, 0.0, 3.0), (0.0, 0.0, 0.0)), "fiducials 2 0m,0m,3m is more"),
        ([[0.0] * 3] * 3, "fiducials must be 3 to 1000 points, or a file, not"),
        ("", "fiducials must be a path"),
        (None, "or a file, not None"),
    ],
)
def test_fiducials_that_are_none_are_refused(fiducials: object, line: str) -> None:
    with pytest.raises(OptionError) as caught:
        Registration(fiducials)  # type: ignore[arg-type]
    assert line in str(caught.value)


def test_json_and_the_command_line_read_back_what_they_write() -> None:
    kind = Points(3, 1000)
    thirds = ((1 / 3, 0.0, -1e-9), (0.1, 0.2, 0.3), (-1.0, 0.0, 0.0))
    for value in ("some.txt", "1,2,3", thirds):
        assert kind.parse(kind.format(value)) == value
        assert kind.from_json(json.loads(json.dumps(kind.to_json(value)))) == value
    assert kind.parse(kind.format("0,0,0;0,0,0")) == "./0,0,0;0,0,0"  # the name of a file
    for own in (OWN, Registration("f.txt", 1e-3, 1.5)):
        assert KIND.from_json(json.loads(json.dumps(KIND.to_json(own)))) == own
        assert plain(json.loads(json.dumps(raw(own))), KIND) == own
    assert KIND.to_json(None) == "off"
    with pytest.raises(OptionError, match='"fiducials" is missing in a registration'):
        KIND.from_json({"fle": "1mm"})


# In a scene


def test_the_controller_has_fitzpatrick_s_margins_and_those_of_the_structures(
    scene: scenes.Scene,
) -> None:
    plant = scenes.plant(scene, scene.options)
    fixtures = plant.controller.fixtures
    assert len(fixtures) == 4
    own = [0.0, *structured.MARGINS.values()]
    for fixture, surface, margin, (least, most) in zip(
        fixtures, scene.surfaces, own, scene.added_range, strict=True
    ):
        wanted = naive(in_mesh(scene, surface.vertices))
        assert (least, most) == (pytest.approx(wanted.min()), pytest.approx(wanted.max()))
        assert most > 1.05 * least
        of_face = margin + wanted[surface.faces].max(axis=1)
        found = fixture.margins_at(np.arange(len(surface.faces)))
        np.testing.assert_allclose(found, of_face, rtol=1e-9)
    # The start is clear of them.
    tip = np.array(scene.T_base_start.translation)
    for surface, margin, (_, most) in zip(scene.surfaces, own, scene.added_range, strict=True):
        assert surface.nearest(tip)[0] > margin + most


def test_a_file_is_replaced_by_what_is_in_it(folder: Path, file: Path) -> None:
    own = Registration(str(file), FLE)
    built = scenes.build(structured.options(folder, registration=own), 1, warm=False)
    assert built.options.registration == OWN
    assert scenes.settled(structured.options(folder, registration=own), built) == built.options
    assert structures.files_of(built.options)[0] == "cube"


def test_without_one_nothing_is_different(folder: Path) -> None:
    built = scenes.build(structured.options(folder), 1, warm=False)
    assert built.added is None
    assert built.added_range == ()
    (fixture, *_) = scenes.plant(built, built.options).controller.fixtures
    assert fixture.margins.margin == 0.0
    assert len(fixture.margins.own) == 0


@pytest.mark.parametrize(
    ("text", "changes", "line"),
    [
        (None, {}, "cannot read a set of fiducials from .*none.txt"),
        ("0 0 0\n1 2\n3 3 3\n", {}, "line 2: '1 2' is not x y z of a point of a set of fiducials"),
        ("0 0 0\n1 2 3\n", {}, "has 2 points: a registration needs three or more"),
        ("0 0 0\n1 2 nan\n3 3 3\n", {}, "line 2"),
        ("0 0 0\n" * 1001, {}, "line 1001: a set of fiducials has 1,000 points at most"),
        ("0 0 0\n5000 0 0\n0 5 0\n", {}, "fiducials 2 .*more than 2 m from the origin"),
        ("0 0 0\n1 1 1\n2 2 2\n", {}, "3 fiducials lie on one line"),
        ("0 0 0\n1 0 0\n0 1 0\n", {"fle": 3e-3}, "off by .* mm at cube .*at most 50 mm"),
    ],
)
def test_what_gives_no_margins_is_refused(
    text: str | None, changes: dict[str, float], line: str, folder: Path, tmp_path: Path
) -> None:
    path = tmp_path / "none.txt"
    if text is not None:
        path.write_text(text)
    own = replace(Registration(str(path)), **changes)
    with pytest.raises(ValueError, match=line):
        scenes.build(structured.options(folder, registration=own), 1, warm=False)


# In a session


def test_the_tool_stops_at_the_margin_of_the_place(session: Session) -> None:
    """As far from the nerve as its own margin and the map say, in another process too."""
    number, own = 2, structured.MARGINS["nerve"]
    wait_until(lambda: session.latest().step is not None)
    start, surface = session.scene.T_base_start, session.scene.surfaces[2]
    middle = surface.vertices.mean(axis=0)
    session.drive(pin.SE3(start.rotation, middle))

    def rests() -> bool:
        step = session.latest().step
        tip = np.array(step.tip.translation)
        gap, triangle, _ = surface.nearest(tip)
        corners = in_mesh(session.scene, surface.vertices[surface.faces[triangle]])
        wanted = own + naive(corners).max() + session.options.standoff
        return wanted - 1e-9 <= gap < wanted + 1e-4

    wait_until(rests)
    # Its own margin is set while it runs, and the map stays.
    session.set_structure(number, margin=0.0)
    own = 0.0
    wait_until(rests)
    assert session.crossing is None


def test_another_mesh_has_no_registration_and_another_arm_keeps_it(session: Session) -> None:
    assert session.options.registration == OWN
    session.set(standoff=30e-6)
    assert session.options.registration == OWN
    session.change(robot="psm")
    assert session.options.registration == OWN
    assert session.scene.added is not None
    session.change(mesh="sphere")
    assert session.options.registration is None
    assert session.scene.added is None


def test_it_is_replayed_without_its_file(folder: Path, tmp_path: Path) -> None:
    path, kept = tmp_path / "f.txt", tmp_path / "one.vfrec"
    path.write_text(TEXT)
    own = Registration(str(path), FLE)
    with Session(structured.options(folder, registration=own, rate=500.0)) as session:
        session.record(kept)
        nerve = session.scene.surfaces[2].vertices.mean(axis=0)
        session.drive(pin.SE3(session.scene.T_base_start.rotation, nerve))
        wait_until(lambda: session.latest().tick > 300)
        session.set_structure(2, margin=2e-3)
        tick = session.latest().tick
        wait_until(lambda: session.latest().tick > tick + 100)
    path.unlink()
    recording = read(kept)
    assert recording.places[0].options.registration == OWN
    assert np.abs(recording.rows["force"]).max() > 0.0  # the margins held it
    assert rerun.first_difference(recording) is None
    (built,) = playback.build_scenes(recording, 1)
    np.testing.assert_array_equal(built.added_range, session.scene.added_range)
    # Without the map the same orders lead elsewhere.
    without = tuple(
        replace(one, options=replace(one.options, registration=None)) for one in recording.places
    )
    assert rerun.first_difference(replace(recording, places=without)) is not None


def test_a_scenario_has_its_file_beside_it_or_the_points(folder: Path, file: Path) -> None:
    place = folder.parent
    scenario = Scenario(
        "a", "b.", structured.options(folder, registration=Registration(str(file), FLE, 1.5))
    )
    text = dumps(scenario, place)
    assert json.loads(text)["registration"] == {
        "fiducials": "fiducials.txt", "fle": "0.4mm", "factor": 1.5,
    }  # fmt: skip
    assert loads(text, place) == scenario
    pointed = replace(scenario, options=replace(scenario.options, registration=OWN))
    text = dumps(pointed, place)
    assert json.loads(text)["registration"]["fiducials"][0] == "-20mm,-20mm,-20mm"
    assert loads(text, place) == pointed
    for odd, line in (
        ("../f.txt", "may not lead out"),
        ("/etc/passwd", "write the path of a file"),
    ):
        content = json.loads(text) | {"registration": {"fiducials": odd}}
        with pytest.raises(OptionError, match=line):
            loads(json.dumps(content), place)
    content = json.loads(text) | {"registration": {"fiducials": ["0,0,0", "x", "0,0,1cm"]}}
    with pytest.raises(OptionError, match='"registration"'):
        loads(json.dumps(content), place)


def test_the_map_is_that_of_the_margins_in_any_frame() -> None:
    made = meshes.margin_map(FIDUCIALS, FLE)
    points = np.random.default_rng(1).normal(scale=0.05, size=(20, 3))
    np.testing.assert_allclose(made.at(points), naive(points), rtol=1e-12)
    T = np.eye(4)
    T[:3, :3] = pin.exp3(np.array([0.3, -1.0, 0.4]))
    T[:3, 3] = [0.1, -0.2, 0.3]
    there = points @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(made.moved(T).at(there), naive(points), rtol=1e-12)
