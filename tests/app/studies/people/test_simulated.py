"""Simulated participants take a study through the sitting and the session that people have."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from app.recording import rerun
from app.recording.read import read
from app.studies.people import reading
from app.studies.people.folder import Study
from app.studies.people.protocol import Condition
from app.studies.people.simulated import operators, taking
from app.studies.people.sitting import Sitting
from app.words import OptionError, Refused

PROTOCOL = """
format = 1
name = "Tiny"
about = "For tests."
title = "A test"
repetitions = 1
rest = 10
seed = 5
[consent]
text = "Yes?"
[[questions]]
id = "age"
text = "How old?"
kind = "number"
low = 18
high = 99
required = true
[[tasks]]
task = "targeting"
targets = 2
[[conditions]]
name = "fixture"
[[conditions]]
name = "delay"
rule = "off"
delay = "200ms"
"""


def study_in(folder: Path) -> Study:
    (folder / "tiny.toml").write_text(PROTOCOL)
    return Study.make(folder / "study", str(folder / "tiny.toml"))


def test_a_participant_that_is_killed_goes_on_and_ends_as_if_it_had_not_been(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = study_in(tmp_path)
    for code in ("S1", "S2"):
        Sitting.enter(study, code, simulated=True)

    class Killed(BaseException):
        pass

    def killed(*_: object) -> None:
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(taking, "measure", killed)  # when the second trial is recorded
        with pytest.raises(Killed):
            taking.take(study.path, "S1", seed=0, effects={})
    files = study.participant("S1")
    assert files.finished() == []
    assert files.trial(0).with_suffix(".vfrec").exists()
    taking.take(study.path, "S1", seed=0, effects={})
    done = files.finished()
    assert Sitting(study, "S1").stage == "thanks"
    assert [one["unfinished"] for one in done] == [1, 0]
    left, whole = (read(files.path / f"trials/000{end}.vfrec") for end in ("-unfinished-1", ""))
    np.testing.assert_array_equal(left.rows["tip"], whole.rows["tip"])
    assert done[0]["completed"]
    assert done[0]["measures"]["contacts"] == 0
    assert done[0]["measures"]["time"] == pytest.approx(done[0]["duration"], abs=0.05)
    assert done[1]["condition"] == "delay"


def test_an_effect_is_a_factor_of_the_errors_in_its_condition_alone() -> None:
    person = operators.operator_of(1, 2)
    assert person == operators.operator_of(1, 2)
    assert person != operators.operator_of(1, 3)
    usual = operators.under(person, Condition("b", delay=0.4), {"a": 0.5})
    half = operators.under(person, Condition("a", scale=0.2), {"a": 0.5})
    assert half.depth_error == 0.5 * usual.depth_error == 0.5 * person.depth_error
    assert half.movement_time == usual.movement_time
    assert usual.visual_delay == person.visual_delay + 0.4


def test_effects_and_folders_are_checked(tmp_path: Path) -> None:
    protocol = reading.read("fixture-under-delay")
    assert taking.effects_of(protocol, ["fixture-delay=0.5"]) == {"fixture-delay": 0.5}
    for word, said in (
        ("fixtur=1", "unknown condition 'fixtur'"),
        ("fixture", "unknown condition ''"),
        ("fixture=x", "a factor from 0 to 10"),
        ("fixture=-1", "a factor from 0 to 10"),
        ("fixture=nan", "a factor from 0 to 10"),
    ):
        with pytest.raises(OptionError, match=said):
            taking.effects_of(protocol, [word])
    study = study_in(tmp_path)
    Sitting.enter(study, "SIM-001")
    with pytest.raises(OptionError, match="SIM-001 is a person"):
        taking.simulate(str(tmp_path / "tiny.toml"), study.path, 1, (), 0, 1)
    with pytest.raises(OptionError, match="another protocol"):
        taking.simulate("paper-cutting", study.path, 1, (), 0, 1)


@pytest.mark.slow
def test_several_in_processes_of_their_own_are_each_balanced(tmp_path: Path) -> None:
    study = study_in(tmp_path)
    protocol = str(tmp_path / "tiny.toml")
    assert taking.simulate(protocol, study.path, 2, ("delay=3",), 0, 2) == 0
    sittings = [Sitting(study, code) for code in study.codes]
    assert [one.stage for one in sittings] == ["thanks", "thanks"]
    assert [one.order for one in sittings] == [["fixture", "delay"], ["delay", "fixture"]]
    for path in study.path.rglob("*.vfrec"):
        # What is recorded is what a session with a clock does, bit for bit.
        assert rerun.first_difference(read(path)) is None
    before = {path: path.read_bytes() for path in study.path.rglob("*.json")}
    assert taking.simulate(protocol, study.path, 2, ("delay=3",), 0, 1) == 0
    assert before == {path: path.read_bytes() for path in study.path.rglob("*.json")}
    assert json.loads((study.path / "participants/SIM-001/tlx.json").read_text())["0"]
    with pytest.raises(Refused):
        sittings[0].consent(True)
