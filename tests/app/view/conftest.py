"""What tests of the page share."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from app.control.messages import Telemetry
from app.settings import Options
from tests.support.runs import run_headless


@pytest.fixture(scope="module")
def telemetry() -> list[Telemetry]:
    """The point pushed without a fixture from above a sphere into it."""
    options = Options(mesh="sphere", robot="point", rule="off")
    start = run_headless(options, [], 1)[0].step.tip
    from app.control.messages import Command

    goal = pin.SE3(start.rotation, start.translation - np.array([0.0, 0.0, 0.02]))
    return run_headless(options, [Command(goal, 1)], 150)
