"""The same commands give the same joints, to the bit."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pinocchio as pin
import pytest

from app import session as sessions
from app.mailbox import Mailbox
from app.messages import Command, Telemetry
from app.replay import run_headless
from app.session import Session
from app.settings import Options


def joints(run: list[Telemetry]) -> bytes:
    return np.array([telemetry.q for telemetry in run]).tobytes()


def wandering(start: pin.SE3, count: int, seed: int) -> Iterator[Command]:
    """Jumps, rotations, silence, clutch and drags around and below the start."""
    rng = np.random.default_rng(seed)
    for k in range(1, count + 1):
        if k % 25 != 1:
            yield None  # type: ignore[misc]
            continue
        target = pin.SE3(
            start.rotation @ pin.exp3(0.3 * rng.standard_normal(3)),
            start.translation + rng.uniform([-0.02, -0.02, -0.03], [0.02, 0.02, 0.005]),
        )
        yield Command(target, k, clutch=k % 150 == 1, held=k % 100 == 1)


@pytest.mark.parametrize(("mesh", "robot"), [("gear", "point"), ("stairs", "psm")])
@pytest.mark.parametrize("rule", ["certified", "paper"])
def test_two_runs_of_the_same_commands_are_bit_identical(mesh: str, robot: str, rule: str) -> None:
    options = Options(mesh=mesh, robot=robot, rule=rule)
    start = run_headless(options, [], 1)[0].step
    assert start is not None
    runs = [run_headless(options, wandering(start.tip, 900, seed=7), 900) for _ in range(2)]
    assert joints(runs[0]) == joints(runs[1])
    other = run_headless(options, wandering(start.tip, 900, seed=8), 900)
    assert joints(other) != joints(runs[0])
    # It was a run worth repeating: free, in contact, held and clutched.
    met = [t.step for t in runs[0] if t.step is not None]
    assert any(len(step.planes) for step in met)
    assert any(t.target is None for t in runs[0])


def test_the_autopilot_repeats_itself() -> None:
    options = Options(mesh="cube", robot="psm")
    first, second = (run_headless(options, [], 1500, autopilot=True) for _ in range(2))
    assert joints(first) == joints(second)
    assert np.ptp([t.q for t in first], axis=0).max() > 1e-3


def test_a_live_session_is_repeated_from_its_record(
    tape: type[Mailbox],
    wait_until: Callable[[Callable[[], bool]], None],
    moved: Callable[..., pin.SE3],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tapes: list = []

    def recorded(value: object = None) -> Mailbox:
        tapes.append(tape(value))
        return tapes[-1]

    monkeypatch.setattr(sessions, "Mailbox", recorded)
    options = Options(mesh="saddle-slab", robot="psm")
    with Session(options) as session:
        start = session.scene.T_base_start
        for dx, dz in ((0.004, -0.02), (-0.01, -0.025), (0.02, -0.018), (0.0, 0.004)):
            tick = session.latest().tick
            session.drive(moved(start, dx=dx, dz=dz))
            wait_until(lambda tick=tick: session.latest().tick > tick + 150)
    live = tapes[1].items[1:]
    commands = [Command(t.target, t.sequence) for t in live]
    assert joints(run_headless(options, commands, len(commands))) == joints(live)
