"""A trial played in the page's engine moves the joints of the trial, bit for bit."""

import numpy as np
import pytest

from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats
from app.scene import scene as scenes
from app.studies.experiments import playback, protocol
from app.studies.experiments.protocol import Trial
from tests.support.commands import page_of_command


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["off", "certified"])
def test_the_engine_repeats_the_trial(rule: str) -> None:
    trial = Trial("tracing", rule, mesh="skull-coarse", rate=100.0, length=2e-3)
    recorded = protocol.record(trial)
    plant = scenes.plant(playback.scene(recorded), playback.options(trial))
    orders = Orders(plant, Command(None, 0), autopilot=True)
    engine, stats = Engine(orders), LoopStats()
    played = np.array([engine.advance(orders, stats)[0].q for _ in recorded.joints])
    assert (played == recorded.joints).all()
    last = engine.advance(orders, stats)[0]
    assert last.target is not None
    np.testing.assert_array_equal(last.target.translation, recorded.run.goals[-1])


@pytest.mark.slow
def test_a_trial_opens_in_the_page() -> None:
    words = "experiment replay --rate 100 --length 2mm --port 0"
    told = page_of_command(*words.split())
    assert "cutting-skull-certified" in told
