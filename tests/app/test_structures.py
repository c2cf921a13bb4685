"""Settings of structures: on the command line, in JSON, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from app.cli import _parsed
from app.options import declared, parse_as, plain, raw
from app.settings import DECLARED, MOST, Options
from app.structure import Structure, split
from app.words import OptionError

KIND = DECLARED["structures"].kind


def parse(line: str) -> Options:
    return parse_as(Options, "vf-sandbox", line.split())


def test_what_follows_a_structure_is_its_own() -> None:
    found = parse(
        "--margin 3mm --mesh cube --structure nerve.stl --margin 1mm --guard tip --name facial "
        "--structure=map.nrrd:3 --colour=#CC8844 --opacity 0.5 --no-guarded --unit mm "
        "--robot point --margin 2mm --guard tool"
    )
    assert found.structures == (
        Structure("nerve.stl", name="facial", margin=1e-3, guard="tip"),
        Structure("map.nrrd", "3", colour="#cc8844", opacity=0.5, guarded=False, unit="mm"),
    )
    # What stands before them, or behind another option, is of the session.
    assert (found.margin, found.guard, found.robot, found.unit) == (2e-3, "tool", "point", None)
    assert parse("--structure a.stl").margin == 0.0
    assert parse("--structure a.stl --port 1 --guarded").structures == (Structure("a.stl"),)


def test_every_field_of_a_structure_is_an_option_behind_it() -> None:
    values = {
        "label": "3", "name": "x", "colour": "#010203", "opacity": "0.25", "margin": "2mm",
        "guard": "tip", "unit": "cm",
    }  # fmt: skip
    assert set(values) | {"file", "guarded"} == set(declared(Structure))
    words = " ".join(f"--{name} {value}" for name, value in values.items())
    (found,) = parse(f"--structure a.stl {words} --no-guarded").structures
    assert found == Structure("a.stl", "3", "x", "#010203", 0.25, 2e-3, "tip", False, "cm")
    about = DECLARED["structures"].about
    assert all(f"--{name}" in about for name in values if name != "label")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("--margin 1", "structures: '1' has no unit: write 1mm"),
        ("--margin 1m", "structures: margin 1000mm is outside 0mm to 50mm"),
        ("--guard all", "structures: unknown guard 'all': choose one of tip, tool"),
        ("--colour red", "structures: colour must be a colour such as #cc8844"),
        ("--opacity 0", "structures: opacity 0 is outside 0.05 to 1"),
        ("--unit ell", "structures: unknown unit 'ell': choose one of m, cm, mm, in"),
    ],
)
def test_a_wrong_value_is_refused_by_name(words: str, line: str) -> None:
    with pytest.raises(OptionError) as caught:
        parse(f"--structure nerve.stl {words}")
    assert line in str(caught.value)


def test_a_structure_without_a_file_is_a_usage_error() -> None:
    with pytest.raises(SystemExit):
        parse("--structure")


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("head.nrrd:3", ("head.nrrd", "3")),
        ("head.nrrd:Left kidney", ("head.nrrd", "Left kidney")),
        ("temporal-bone:dura", ("temporal-bone", "dura")),
        ("scan:1.stl", ("scan:1.stl", None)),
        ("a:b/c", ("a:b/c", None)),
        ("cube", ("cube", None)),
        (":3", (":3", None)),
        ("cube:", ("cube:", None)),
    ],
)
def test_a_label_follows_its_file(text: str, parts: tuple[str, str | None]) -> None:
    assert split(text) == parts
    one = Structure(text)
    assert (one.file, one.label) == parts


def test_json_has_what_differs_and_is_read_back() -> None:
    found = (Structure("a.stl"), Structure("b.nrrd", "3", margin=1e-3, guarded=False))
    content = KIND.to_json(found)
    assert content == [
        {"file": "a.stl"}, {"file": "b.nrrd", "label": "3", "margin": "1mm", "guarded": False},
    ]  # fmt: skip
    assert KIND.from_json(json.loads(json.dumps(content))) == found
    assert plain(json.loads(json.dumps(raw(found))), KIND) == found


@pytest.mark.parametrize(
    ("content", "line"),
    [
        ("nerve.stl", "must be a list"),
        (["nerve.stl"], "must be an object with file, label, name"),
        ([{}], '"file" is missing in a structure'),
        ([{"file": "a", "size": 3}], "unknown key 'size': choose from file, label, name"),
        ([{"file": "a", "margin": 3}], '"margin": 3: must be a text such as "5mm"'),
        ([{"file": "a", "guarded": "no"}], "must be true or false"),
    ],
)
def test_wrong_json_is_refused(content: object, line: str) -> None:
    with pytest.raises(OptionError) as caught:
        KIND.from_json(content)
    assert line in str(caught.value)


@pytest.mark.parametrize("content", ["x", 3, [{}], [{"file": "a"}], [3]])
def test_wrong_recorded_values_are_refused(content: object) -> None:
    with pytest.raises(OptionError):
        Options(structures=plain(content, KIND))


def test_the_mesh_is_the_first_structure() -> None:
    options = Options(
        mesh="bones/map.nrrd:Left kidney", margin=1e-3, guarded=False, colour="#010203",
        opacity=0.5, structures=(Structure("a.stl", name="a"),),
    )  # fmt: skip
    first, second = options.anatomy
    assert first == Structure(
        "bones/map.nrrd", "Left kidney", "Left kidney", "#010203", 0.5, 1e-3, guarded=False
    )
    assert second is options.structures[0]
    assert Options(mesh="bones/skull.stl").anatomy[0].name == "skull.stl"


def test_too_many_are_refused() -> None:
    with pytest.raises(OptionError, match=f"at most {MOST}"):
        Options(structures=(Structure("a.stl"),) * (MOST + 1))


def test_without_a_mesh_the_first_structure_is_it() -> None:
    assert _parsed(["--structure", "a.stl"])[0].mesh == "none"
    assert _parsed(["--structure", "a.stl", "--mesh", "cube"])[0].mesh == "cube"
    assert _parsed(["--robot", "point"])[0].mesh == Options().mesh
    given = replace(Options(), mesh="none")
    assert given.anatomy[0].file == "none"
