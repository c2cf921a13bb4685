"""Cuts without and with the margins of their registration: paired, judged on the true anatomy."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import meshes
import vf
from app.commands import call
from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats
from app.scene import scene as scenes
from app.studies import batch
from app.studies.experiments import playback, protocol, registration, site
from app.studies.experiments.protocol import Outcome, Trial
from app.studies.results import margins

SHORT = Trial("cutting", "certified", mesh="skull-coarse", noise=0.7e-3, rate=50.0, length=4e-3)
# Their registrations put the skull too deep in eight, too high in four.
NUMBERS = range(12, 24)


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    return [
        protocol.run(dataclasses.replace(SHORT, number=number, margin=margin))
        for number in NUMBERS
        for margin in (0.0, 2.0)
    ]


def test_fewer_and_shallower_injuries_with_margins(outcomes: list[Outcome]) -> None:
    without, with_margins = margins.split(outcomes)
    for one, other in zip(without, with_margins, strict=True):
        # The same registration: what differs is the guard.
        assert (one.fre, one.tre) == (other.fre, other.tre)
        assert one.finished
        assert other.finished
        assert (one.injured > 0) == (one.deepest > 0.0)
        assert other.deepest < one.deepest
    hurt = [sum(o.injured > 0 for o in side) for side in (without, with_margins)]
    assert hurt[0] >= 4
    assert hurt[1] <= hurt[0] // 3
    depth = [np.mean([max(o.deepest, 0.0) for o in side]) for side in (without, with_margins)]
    assert depth[1] < 0.1 * depth[0]
    assert margins.injured_share(with_margins) < 0.2 * margins.injured_share(without)
    # The price: bone is left.
    left = {name: (np.mean(a), np.mean(b)) for name, a, b in margins.rows(outcomes)}
    before, after = left["bone left under the cut [mm]"]
    assert after > before + 0.5
    assert sum(o.crossings + o.outside for o in outcomes) == 0


def test_injuries_are_of_the_true_surface_by_another_way_to_measure() -> None:
    """The tip's ticks beyond it, by the surface's own inside test and distance."""
    recorded = protocol.record(dataclasses.replace(SHORT, number=14))
    assert recorded.outcome.injured > 0
    place = site.build(SHORT.mesh, SHORT.length)
    true = place.guarded(place.T_base_skull)
    tips = recorded.run.tips
    inside = np.array([true.inside(p) for p in tips])
    gaps = np.array([true.nearest(p)[0] for p in tips])
    assert recorded.outcome.injured == inside.sum()
    deepest = gaps[inside].max() if inside.any() else -gaps.min()
    assert recorded.outcome.deepest == pytest.approx(deepest, abs=1e-9)
    registered = place.guarded(recorded.T_base_registered)
    assert not any(registered.inside(p) for p in tips)  # of which the guard knows


def test_the_map_has_the_unit_of_the_noise_of_the_experiments() -> None:
    """Errors of simulated registrations, by their measurement and fit, at points of the cut."""
    place = site.build("skull-coarse")
    rng = np.random.default_rng(5)
    T = place.T_base_skull
    targets = place.inner[0][:: len(place.inner[0]) // 12]
    true = meshes.transformed(T, targets)
    squared = np.zeros(len(targets))
    for _ in range(3000):
        seen = registration.measure(meshes.transformed(T, place.fiducials), 0.5e-3, rng)
        found = registration.fit(place.fiducials, seen)
        squared += ((meshes.transformed(found.T, targets) - true) ** 2).sum(axis=1)
    trial = dataclasses.replace(SHORT, noise=0.5e-3, margin=1.0)
    added = protocol.margin_map(trial, T)
    assert added is not None
    np.testing.assert_allclose(added.at(true), np.sqrt(squared / 3000), rtol=0.04)


def test_the_guard_has_the_map_at_the_registered_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    class Noted(vf.MeshFixture):
        def __init__(self, surface: vf.Surface, *words: object, **more: object) -> None:
            made.append((surface, more["margin"]))
            super().__init__(surface, *words, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(vf, "MeshFixture", Noted)
    recorded = protocol.record(dataclasses.replace(SHORT, length=1.5e-3, margin=2.0))
    ((surface, margin),) = made
    place = site.build(SHORT.mesh, 1.5e-3)
    there = meshes.transformed(recorded.T_base_registered, place.fiducials)
    np.testing.assert_allclose(margin, meshes.margins(surface.vertices, there, 0.7e-3, 2.0))


def test_without_noise_or_factor_nothing_is_added() -> None:
    T = np.eye(4)
    assert protocol.margin_map(SHORT, T) is None
    assert protocol.margin_map(dataclasses.replace(SHORT, noise=0.0, margin=2.0), T) is None
    assert playback.options(SHORT).registration is None


def test_a_trial_with_margins_has_its_own_file_and_the_same_randomness() -> None:
    more = dataclasses.replace(SHORT, margin=2.0)
    assert more.key == f"{SHORT.key}-margin2"
    assert more.generator(1).random() == SHORT.generator(1).random()


def test_a_study_has_margins_of_what_has_a_fixture() -> None:
    trials = batch.grid(
        experiments=["cutting"], operators=1, meshes=["skull-coarse"], rules=["off", "certified"],
        noise=[1e-3], margins=[0.0, 1.0, 2.0],
    )  # fmt: skip
    assert [(t.rule, t.margin) for t in trials] == [
        ("off", 0.0), ("certified", 0.0), ("certified", 1.0), ("certified", 2.0),
    ]  # fmt: skip


def test_pairs_are_complete(outcomes: list[Outcome]) -> None:
    with pytest.raises(ValueError, match="every trial is needed without and with"):
        margins.rows(outcomes[:-1])
    assert margins.compared([1.0, 2.0, 3.0], [2.0, 3.0, 4.0]) is None
    found = margins.compared([1.0, 2.0, 4.0], [0.0, 1.0, 1.0])
    assert found is not None
    assert found.difference == pytest.approx(-5.0 / 3.0)


def test_what_is_said_is_what_was_counted(outcomes: list[Outcome]) -> None:
    without, with_margins = margins.split(outcomes)
    first = margins.verdicts(outcomes)[0]
    hurt = [sum(o.injured > 0 for o in side) for side in (without, with_margins)]
    assert f"{hurt[0]} of 12 without margins, {hurt[1]} of 12 with" in first
    assert f"{1e3 * max(o.deepest for o in without):+.2f}" in first
    page = margins.render(outcomes)
    assert page.count("<svg") == 1
    assert "Margins in silico: 12 pairs of cuts" in page
    values = json.loads(json.dumps(outcomes[1].to_json()))
    assert Outcome.from_json(values).trial.margin == 2.0


def test_the_command_compares_pairs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["margins", "--mesh", "skull-coarse", "--rate", "50", "--length", "2mm", "--trials",
             "2", "--factor", "1.5", "--out", str(tmp_path)]  # fmt: skip
    assert call("experiment", words) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "2 pairs of cuts" in out
    assert "Margins: 1.5 times the target registration error" in out
    assert {"trials.csv", "report.html"} <= {p.name for p in tmp_path.iterdir()}
    head, *rows = (tmp_path / "trials.csv").read_text("utf-8").splitlines()
    assert {"margin", "injured", "deepest"} <= set(head.split(","))
    assert len(rows) == 4


@pytest.mark.slow
def test_the_engine_repeats_a_trial_with_margins() -> None:
    trial = dataclasses.replace(SHORT, experiment="tracing", rate=100.0, length=2e-3, margin=2.0)
    recorded = protocol.record(trial)
    scene = playback.scene(recorded)
    plant = scenes.plant(scene, playback.options(trial))
    assert plant.options.registration is not None
    orders = Orders(plant, Command(None, 0), autopilot=True)
    engine, stats = Engine(orders), LoopStats()
    played = np.array([engine.advance(orders, stats)[0].q for _ in recorded.joints])
    assert (played == recorded.joints).all()
