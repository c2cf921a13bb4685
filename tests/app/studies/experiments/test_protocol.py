"""Whole trials, short ones: repeatable, judged, and true to the set-up."""

import dataclasses
import json
import math

import numpy as np
import pytest

import meshes
from app.studies.experiments import judge, protocol, site
from app.studies.experiments.description import EXPERIMENTS
from app.studies.experiments.operators import Operator
from app.studies.experiments.protocol import Outcome, Trial
from app.studies.results import analysis, report
from app.words import OptionError

SHORT = Trial("cutting", "certified", mesh="skull-coarse", rate=50.0, length=2e-3)


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    return [
        protocol.run(dataclasses.replace(SHORT, experiment=experiment, rule=rule, number=number))
        for experiment in EXPERIMENTS
        for number in range(2)
        for rule in ("off", "certified")
    ]


def of(outcomes: list[Outcome], experiment: str) -> list[Outcome]:
    return [o for o in outcomes if o.trial.experiment == experiment]


def untimed(outcome: Outcome) -> str:
    return json.dumps(dataclasses.replace(outcome, elapsed=0.0, driving=0.0).to_json())


def test_a_trial_repeats_bit_for_bit_and_survives_its_file(outcomes: list[Outcome]) -> None:
    first = of(outcomes, "cutting")[1]
    assert untimed(protocol.run(first.trial)) == untimed(first)
    assert untimed(Outcome.from_json(json.loads(untimed(first)))) == untimed(first)
    other = protocol.run(dataclasses.replace(first.trial, seed=1))
    assert untimed(other) != untimed(first)


def test_the_fixture_keeps_its_word(outcomes: list[Outcome]) -> None:
    assert analysis.violations(outcomes) == 0
    for o in of(outcomes, "cutting"):
        assert o.finished
        assert len(o.stations) == 2
        if o.trial.assisted:  # no deeper than the registration is wrong
            assert o.penetration.max() < 3.0 * o.tre + 5e-5
            assert o.penetration.min() > -3.0 * o.tre - 1e-4
            assert np.abs(o.deviation).max() < protocol.Trial("cutting", "off").width + 3.0 * o.tre


def test_the_judge_sees_what_the_fixture_prevents() -> None:
    """The same hand without a fixture passes the surface that the fixture would have guarded."""
    trial = dataclasses.replace(SHORT, rule="off")
    recorded = protocol.record(trial)
    place = site.build(trial.mesh, trial.length)
    vertices, faces = place.inner
    guarded = meshes.transformed(recorded.T_base_registered, vertices)
    assert judge.crossings(guarded, faces, recorded.run.tips) > 0


def test_without_errors_the_cut_is_the_plan() -> None:
    steady = dataclasses.replace(
        Operator(), movement_noise=0.0, tremor=0.0, depth_bias=0.0, depth_error=0.0,
        image_error=0.0, press_noise=0.0,
    )  # fmt: skip
    for rule in ("off", "certified"):
        o = protocol.run(dataclasses.replace(SHORT, rule=rule, noise=0.0), steady)
        assert o.tre < 1e-12
        np.testing.assert_allclose(o.deviation, 0.0, atol=2e-5)
        # Of the coarse skull's inner surface the chords run some tens of microns off.
        np.testing.assert_allclose(o.penetration, 0.0, atol=8e-5)


def test_modes_of_tracing_share_the_day_and_skulls_are_new() -> None:
    trace = Trial("tracing", "off")
    assert trace.generator(0).random() == Trial("tracing", "certified").generator(0).random()
    assert (
        SHORT.generator(0).random() != dataclasses.replace(SHORT, rule="off").generator(0).random()
    )
    assert protocol.operator_of(trace) == Operator()
    someone = dataclasses.replace(SHORT, operator=3)
    assert protocol.operator_of(someone) == protocol.operator_of(
        dataclasses.replace(someone, rule="off")
    )
    assert protocol.operator_of(someone) != protocol.operator_of(
        dataclasses.replace(someone, operator=4)
    )


def test_the_report_holds_all_it_shows(outcomes: list[Outcome], tmp_path) -> None:
    for experiment in EXPERIMENTS:
        mine = of(outcomes, experiment)
        written = {path.name: path for path in report.write(mine, tmp_path / experiment)}
        page = written["report.html"].read_text("utf-8")
        assert page.count("<svg") >= 2
        assert "http://" not in page.replace("http://www.w3.org", "").replace(
            "http://purl.org", ""
        ).replace("http://creativecommons.org", "")
        assert "<script" not in page
        rows = written["trials.csv"].read_text("utf-8").splitlines()
        assert len(rows) == 1 + len(mine)
        assert len({o.trial.key for o in mine}) == len(mine)
    lines = {line.name: line for line in analysis.cutting(of(outcomes, "cutting"))}
    compared = lines["|penetration depth|"].comparison
    assert compared is not None
    assert compared.sizes == (4, 4)
    off = [o for o in of(outcomes, "cutting") if not o.trial.assisted]
    assert compared.off[0] == pytest.approx(
        1e3 * np.mean([np.abs(o.penetration) for o in off]), rel=1e-12
    )


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"experiment": "sewing"}, "tracing, cutting"),
        ({"rule": "all"}, "off, certified, paper"),
        ({"mesh": "cube"}, "skull-fine"),
        ({"noise": 1.0}, "0mm to 5mm"),
        ({"rate": 1.0}, "50 Hz to 5000 Hz"),
        ({"seed": -1}, "seed"),
    ],
)
def test_what_is_no_trial_is_refused(change: dict, word: str) -> None:
    with pytest.raises(OptionError, match=word):
        dataclasses.replace(SHORT, **change)


def test_a_length_beyond_the_plan_is_refused() -> None:
    with pytest.raises(OptionError, match="30 mm"):
        site.build("skull-coarse", 0.05)


WRONG = {
    "trial": [[], {"experiment": "cutting"}],
    "duration": [-1.0, 1e300, math.nan, "long"],
    "finished": [1],
    "sal": [1.0, math.nan],
    "sparc": [-1e300],
    "fre": [-1e-3, 5.0],
    "tre": [math.inf],
    "stations": [[], [[0.0], [1.0]], [[1e300]], [["0"]], 3],
    "deviation": [[[2.0]], [[True]]],
    "penetration": [[[math.nan]], None],
    "removed": [-1.0, 2.0],
    "injured": [-1, 0.5],
    "deepest": [2.0, math.nan],
    "crossings": [-1, 0.5],
    "outside": [True],
    "ticks": [10**400],
    "statuses": [[], {"SOLVED": -1}, {"SOLVED": "x"}],
    "submovements": [-1],
    "corrections": [None],
    "elapsed": [-1.0],
    "driving": [math.inf],
    "trajectory": [[[0.0, 0.0]], [[0.0, 0.0, 0.0, 1e300]], "x"],
}


def test_a_trial_s_file_is_checked_value_by_value() -> None:
    sound = protocol.run(SHORT).to_json()
    assert Outcome.from_json(sound).trial == SHORT
    assert sorted(WRONG) == sorted(field.name for field in dataclasses.fields(Outcome))
    for name, wrong in WRONG.items():
        for value in wrong:
            with pytest.raises(OptionError) as caught:
                Outcome.from_json({**sound, name: value})
            assert name in str(caught.value), (name, value)
            assert "\n" not in str(caught.value)
        with pytest.raises(OptionError, match=f"has no '{name}'"):
            Outcome.from_json({key: value for key, value in sound.items() if key != name})
    for field in dataclasses.fields(SHORT):
        with pytest.raises(OptionError):
            Outcome.from_json({**sound, "trial": {**sound["trial"], field.name: [1e300]}})
    with pytest.raises(OptionError, match=r"unknown key 'colour'"):
        Outcome.from_json({**sound, "colour": 1})
    with pytest.raises(OptionError, match="must be a JSON object"):
        Outcome.from_json([sound])
