"""The self-test at the start: it passes, and any wrong answer ends the start."""

import numpy as np
import pytest

import robots
import vf
from vf import selftest


def test_this_machine_passes() -> None:
    vf.check_kernels()
    assert len(list(selftest._answers())) > 10


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("certified_planes", lambda *_: vf.Planes.none(5e-3)),
        ("paper_planes", lambda *_: vf.Planes.none(5e-3)),
        ("force", lambda *_: np.array([0.0, np.nan, 0.0])),
        ("force", lambda *_: np.array([0.0, 0.15 + 2e-9, 0.0])),
    ],
)
def test_a_wrong_answer_ends_the_start_and_says_which(monkeypatch, name: str, wrong) -> None:
    controller = vf.Controller(robots.load("point"), [])
    monkeypatch.setattr(selftest, name, wrong)
    with pytest.raises(RuntimeError, match=r"wrong answer for the .* instead of .*__pycache__"):
        controller.warm_up()
