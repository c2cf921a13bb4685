"""Files of scenarios: read back exactly, or refused in one line."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st

import meshes
import vf
from app.scenarios.file import (
    SETTINGS,
    Scenario,
    ScenarioError,
    Viewpoint,
    Waypoint,
    dumps,
    loads,
    read,
    write,
)
from app.scenarios.presets import PRESETS, find
from app.scene import scene as scenes
from app.settings import Options, number
from app.structure import Structure
from app.words import OptionError

DOCUMENT = Path(__file__).parents[3] / "docs" / "scenarios.md"


def test_the_documents_example_is_a_scenario(tmp_path: Path) -> None:
    text = DOCUMENT.read_text().partition("```json\n")[2].partition("```")[0]
    scenario = loads(text, tmp_path)
    assert scenario.options.mesh == str(tmp_path / "bones" / "skull.stl")
    assert len(scenario.proxy) == 2


lengths = st.floats(1e-6, 1.0)
numbers = st.floats(-0.9, 0.9)
points = st.tuples(numbers, numbers, numbers)
words = st.text(st.characters(categories=("L", "N", "P", "S")), min_size=1, max_size=30)


def within(name: str) -> st.SearchStrategy[float]:
    return st.floats(number(name).low, number(name).high)


structures = st.builds(
    Structure,
    file=st.sampled_from([*meshes.names(), "temporal-bone"]),
    label=st.none() | st.sampled_from(["3", "facial nerve", "a:b.c"]),
    name=st.none() | words,
    colour=st.none() | st.just("#0a0b0c"),
    opacity=st.floats(0.05, 1.0),
    margin=st.none() | st.floats(0.0, 0.05),
    guard=st.sampled_from([None, "tip", "tool"]),
    guarded=st.booleans(),
    unit=st.sampled_from([None, "mm"]),
)


options = st.builds(
    Options,
    structures=st.lists(structures, max_size=3).map(tuple),
    margin=within("margin"),
    guarded=st.booleans(),
    colour=st.none() | st.just("#0a0b0c"),
    opacity=within("opacity"),
    mesh=st.sampled_from(meshes.names()),
    unit=st.sampled_from([None, "mm", "in"]),
    at=st.none() | points,
    rotate=st.tuples(*[st.floats(-7.0, 7.0)] * 3),
    up=st.sampled_from(meshes.UPS),
    damage=st.sampled_from(["none", "holes"]),
    seed=st.integers(0, 2**63 - 1),
    repair=st.booleans(),
    flip=st.booleans(),
    corridor=st.none() | within("corridor"),
    robot=st.sampled_from(["psm", "point"]),
    rule=st.sampled_from(sorted(vf.RULES)),
    radius=st.none() | within("radius"),
    standoff=within("standoff"),
    approach=within("approach"),
    tip_radius=within("tip_radius"),
    scale=within("scale"),
    lock_orientation=st.booleans(),
    tip_speed=within("tip_speed"),
    force_gain=within("force_gain"),
)


waypoints = st.lists(st.tuples(st.floats(0.0, 600.0), points), max_size=5, unique_by=lambda w: w[0])


scenarios = st.builds(
    Scenario,
    name=words,
    about=words,
    options=options,
    proxy=waypoints.map(lambda found: tuple(Waypoint(*w) for w in sorted(found))),
    wxyz=st.none() | numbers.map(lambda a: (math.cos(a), 0.0, math.sin(a), 0.0)),
    camera=st.none()
    | st.sampled_from(["arm", "follow"])
    | st.builds(lambda p: Viewpoint(p, (p[0] + 0.1, p[1], p[2])), points),
    paused=st.booleans(),
)


@examples(max_examples=50)
@given(scenarios)
def test_a_file_is_read_back_exactly(scenario: Scenario) -> None:
    again = loads(dumps(scenario))
    assert again == scenario
    assert dumps(again) == dumps(scenario)


def test_every_setting_of_a_scenario_is_in_its_file_and_no_other() -> None:
    content = json.loads(dumps(PRESETS["saddle"]))
    extra = {"format", "name", "about", "proxy", "wxyz", "camera", "paused"}
    assert set(content) == set(SETTINGS) | extra
    # What is of the server or of the machine is not part of what is shared.
    left = {field for field in vars(Options()) if field not in SETTINGS}
    assert left == {
        "rate", "host", "port", "open", "stale_after", "upload_limit", "record", "scenario",
        "arm", "master", "enable", "delay", "jitter", "loss",
    }  # fmt: skip
    assert content["radius"] == "1mm"
    assert content["proxy"][0] == {"time": 1.5, "at": "-8mm,-8mm,14mm"}


def test_a_scenario_does_not_touch_what_is_of_the_server() -> None:
    mine = Options(host="0.0.0.0", port=1, rate=500.0)
    options = PRESETS["saddle"].applied(mine)
    assert (options.host, options.port, options.rate) == ("0.0.0.0", 1, 500.0)
    assert options.mesh == "saddle-slab"
    assert PRESETS["saddle"] == replace(PRESETS["saddle"], options=options)


def test_meshes_are_found_from_where_the_file_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = tmp_path / "scenarios", tmp_path / "elsewhere"
    (here / "bones").mkdir(parents=True)
    there.mkdir()
    bone = here / "bones" / "bone.ply"
    meshes.save(bone, *meshes.arrays("cube"))
    written = Scenario("mine", "A cube.", Options(mesh=str(bone), unit="mm"))
    write(written, here / "mine.json")
    assert json.loads((here / "mine.json").read_text())["mesh"] == "bones/bone.ply"
    monkeypatch.chdir(there)
    again = find(str(here / "mine.json"))
    assert again == written
    assert scenes.build(again.options, 1).mesh_name == "bone.ply"
    # For one who saves it beside the mesh, without telling where that was.
    assert json.loads(dumps(written))["mesh"] == "bone.ply"
    for elsewhere in (there, tmp_path / "scenarios-2"):
        elsewhere.mkdir(exist_ok=True)
        with pytest.raises(ScenarioError, match=r"bone\.ply is not in .* or below: keep"):
            write(written, elsewhere / "mine.json")
        assert not (elsewhere / "mine.json").exists()


@pytest.mark.parametrize("key", ["mesh", "path"])
def test_a_scenario_names_no_file_outside_its_folder(key: str, tmp_path: Path) -> None:
    here = tmp_path / "here"
    (here / "deep").mkdir(parents=True)
    secret = tmp_path / "secret.stl"
    secret.write_bytes(b"")
    (here / "bone.stl").write_bytes(b"")
    (here / "link.stl").symlink_to(secret)
    (here / "way").symlink_to(tmp_path)
    (here / "inner.stl").symlink_to(here / "bone.stl")
    for name in (
        "../secret.stl", "deep/../../secret.stl", "./../secret.stl", str(secret), "link.stl",
        "way/secret.stl", "/dev/zero", "deep/../bone.stl"):  # fmt: skip
        with pytest.raises(ScenarioError, match=rf'^"{key}": .*in the scenario\'s own folder'):
            loads(changed(**{key: name}), here)
    for name in ("bone.stl", "./bone.stl", "deep/bone.stl", "inner.stl", "..bone.stl"):
        found = getattr(loads(changed(**{key: name}), here).options, key)
        assert Path(found) == here / name
    # The folder may itself be reached by a link.
    (tmp_path / "there").symlink_to(here)
    assert loads(changed(**{key: "bone.stl"}), tmp_path / "there")


def test_a_name_that_is_no_file_is_one_of_the_catalogue(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r'"mesh": unknown mesh "secret": choose one of skull'):
        loads(changed(mesh="secret"), tmp_path)


def changed(**changes: object) -> str:
    content = json.loads(dumps(PRESETS["saddle"]))
    content.update(changes)
    return json.dumps(content)


POINT = {"time": 0.0, "at": "0mm,0mm,0mm"}


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "this is not JSON"),
        ("{", "this is not JSON"),
        ("[" * 50_000, "this is not JSON"),
        ("[1]", "a scenario is a JSON object {…}, not [1]"),
        ("{}", '"format" must be 1, the version of scenarios: it has none'),
        (changed(format=2), '"format" must be 1, the version of scenarios: not 2'),
        (changed(format=True), '"format" must be 1'),
        (changed(format="1"), '"format" must be 1'),
        ('{"format": 1, "format": 1}', 'the key "format" is there twice'),
        (changed(paint="red"), 'unknown key "paint": choose from format, name, about, mesh'),
        (changed(host="0.0.0.0"), 'unknown key "host": choose from'),
        ('{"format": 1, "name": "x"}', '"about" is missing'),
        (changed(name=3), '"name": 3: must be a text'),
        (changed(name="two\nlines"), "name must be one line of 1 to 60 printable characters"),
        (changed(about=""), "about must be one line of 1 to 300"),
        (changed(about="x" * 301), "about must be one line of 1 to 300"),
        (changed(rule="soft"), "unknown rule 'soft': choose one of certified, paper, all, off"),
        (changed(robot="r2d2"), "unknown robot 'r2d2': choose one of psm, point, panda, ur5"),
        (changed(damage="smashed"), "unknown damage 'smashed': choose one of none, "),
        (changed(up="w"), "unknown axis 'w': choose one of z, -z"),
        (changed(camera="hand"), "unknown camera 'hand': choose one of arm, anatomy, site"),
        (changed(unit="parsec"), "unknown unit 'parsec': choose one of m, cm, mm, in"),
        (changed(unit=3), '"unit": 3: must be a text or null'),
        (changed(at="0,0,1e300m"), "at 0m,0m,1e+300m is more than 2 m from the origin"),
        (changed(at="0,0,3"), "has no unit: write 3mm for millimetres, 3m for metres"),
        (changed(rotate="0,1e298,0"), "rotate 0,1e+298,0 is outside -720 to 720 degrees"),
        (changed(tip_speed="1e9m/s"), "tip_speed 1e+09 m/s is outside 0.001 m/s to 2 m/s"),
        (changed(tip_speed="fast"), "'fast' is not a speed"),
        (changed(mesh="x" * 5000), "mesh must be a path of 1 to 4096 characters without a NUL"),
        (changed(camera={"eye": "0,0,1m"}), 'must be a name or {"eye": "x,y,z", "look_at"'),
        (changed(camera={"eye": "0,0,1m", "look_at": "auto"}), "'auto' is not a place"),
        (changed(camera={"eye": "0,0,21m", "look_at": "0,0,0"}), "camera's eye at 0mm,0mm,21000mm"),
        (changed(camera={"eye": "1m,0,0", "look_at": "1m,0,0"}), "eye must be 0.1 mm or more from"),
        (changed(camera=["arm"]), '"camera": ["arm"]: must be a text or null'),
        (changed(radius=5), '"radius": 5: must be a text such as "5mm" or "auto"'),
        (changed(radius="5 furlongs"), "\"radius\": \"5 furlongs\": '5 furlongs' is not a length"),
        (changed(radius="1e999m"), "radius inf is outside"),
        (changed(radius="5m"), "radius 5000mm is outside 0.05mm to 20mm"),
        (changed(at="here"), "\"at\": \"here\": 'here' is not a place"),
        (changed(rotate="0,0,nan"), "is not a turn"),
        (changed(seed=-1), "seed -1 is outside 0 to 9223372036854775807"),
        (changed(seed=1.0), '"seed": 1.0: must be a whole number'),
        (changed(seed=10**30), "seed 1000000000000000000000000000000 is outside 0 to"),
        (changed(repair=1), '"repair": 1: must be true or false'),
        (changed(paused="no"), '"paused": "no": must be true or false'),
        (changed(scale=True), '"scale": true: must be a number'),
        (changed(scale=9), "scale 9 is outside 0.05 to 2"),
        (changed(scale=10**400), '"scale": 1000'),
        (changed().replace('"scale": 1.0', '"scale": NaN'), "NaN is not a usable number"),
        (changed().replace('"scale": 1.0', '"scale": 1e999'), "scale inf is outside"),
        (changed().replace('"scale": 1.0', f'"scale": {"9" * 5000}'), "this is not JSON"),
        (changed(proxy={}), '"proxy": {}: must be a list of {"time": seconds, "at": "x,y,z"}'),
        (changed(proxy=[1]), "has a waypoint that is not"),
        (changed(proxy=[{**POINT, "speed": 1}]), "has a waypoint that is not"),
        (changed(proxy=[{**POINT, "at": [0, 0, 0]}]), "must be a text"),
        (changed(proxy=[{**POINT, "at": "auto"}]), "'auto' is not a place: write x,y,z"),
        (changed(proxy=[{**POINT, "at": "0,0,3m"}]), "is more than 2 m from the origin"),
        (changed(proxy=[{**POINT, "at": "0,0,1e999m"}]), "is more than 2 m from the origin"),
        (changed(proxy=[{**POINT, "time": -1}]), "time -1 s is outside 0 s to 600 s"),
        (changed(proxy=[POINT, POINT]), "time 0 s must be after the one before (0 s)"),
        (changed(proxy=[POINT, {**POINT, "time": 1e6}]), "time 1e+06 s is outside 0 s to 600 s"),
        (changed(proxy=[{**POINT, "time": k} for k in range(201)]), "201 waypoints: at most 200"),
        (changed(wxyz=[1, 0, 0]), '"wxyz": [1, 0, 0]: must be four numbers w, x, y, z'),
        (changed(wxyz=[0, 0, 0, 0]), "wxyz must be a unit quaternion"),
        (changed(mesh="bone\0.stl"), "mesh must be a path of 1 to 4096 characters"),
        (changed(mesh="bone.stl"), "there is no file to find this one from"),
        (changed(path="cut.txt"), '"path": "cut.txt": there is no file to find this one from'),
        (changed(about="x" * 200_000), "bytes are more than a scenario has (100,000)"),
    ],
)  # fmt: skip
def test_what_is_no_scenario_is_told_in_one_line(text: str, line: str) -> None:
    with pytest.raises(OptionError) as caught:
        loads(text)
    message = str(caught.value)
    assert line in message
    assert "\n" not in message
    assert len(message) < 500


@examples(max_examples=50)
@given(st.binary(max_size=300) | st.text(max_size=100).map(str.encode))
def test_whatever_is_in_a_file_it_is_refused_properly(content: bytes) -> None:
    with pytest.raises(OptionError):
        loads(content)


junk = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
)


@examples(max_examples=50)
@given(st.sampled_from(sorted({*SETTINGS, "proxy", "wxyz", "camera", "paused", "name"})), junk)
def test_whatever_a_key_has_for_a_value(key: str, value: object) -> None:
    told = ""
    try:
        scenario = loads(changed(**{key: value}))
        assert loads(dumps(scenario)) == scenario
    except OptionError as error:
        told = str(error)
    assert "\n" not in told


def test_a_file_that_is_not_there_or_too_long_is_named(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"nowhere\.json: cannot be read"):
        read(tmp_path / "nowhere.json")
    with pytest.raises(ScenarioError, match="cannot be read"):
        read(tmp_path)
    long = tmp_path / "long.json"
    long.write_bytes(b" " * 200_000)
    with pytest.raises(ScenarioError, match=r"long\.json: 100,001 bytes are more"):
        read(long)


def test_a_file_without_a_folder_finds_meshes_by_their_names_alone() -> None:
    files = {"scan.stl": "/kept/scan.stl/scan.stl", "cut.csv": "/data/cut.csv"}
    text = changed(mesh="scan.stl", path="cut.csv")
    found = loads(text, find=files.get)
    assert (found.options.mesh, found.options.path) == (files["scan.stl"], files["cut.csv"])
    assert json.loads(dumps(found))["mesh"] == "scan.stl"
    for mesh in ("other.stl", "../scan.stl", "a/scan.stl", "scan.stl/scan.stl"):
        with pytest.raises(ScenarioError, match="is not known here: bring it first"):
            loads(changed(mesh=mesh), find=files.get)
    with pytest.raises(ScenarioError, match="relative"):
        loads(changed(mesh="/kept/scan.stl/scan.stl"), find=files.get)
