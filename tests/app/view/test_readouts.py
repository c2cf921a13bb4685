"""Banner for each state, texts for each outcome and solver."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import vf
from app.control.messages import LoopStats, Telemetry
from app.scene.moment import Moment
from app.session import Session
from app.settings import Options
from app.view import palette
from app.view.tabs import legend, readouts
from app.view.tabs.depth import whereabouts
from app.view.tabs.measuring import Measuring
from tests.support.headless import wait_until
from vf.qp.least_squares import Solver


@pytest.fixture(scope="module")
def running() -> Iterator[Session]:
    with Session(Options(mesh="sphere", rate=200.0)) as session:
        yield session


@pytest.fixture
def session(running: Session) -> Session:
    running.resume()
    running.set(rule="certified")
    running.set(standoff=20e-6)
    running.reset()
    wait_until(lambda: running.latest().step is not None and says(running, "Ready"))
    return running


def extras(session: Session, **changes: Any) -> readouts.Extras:
    telemetry, where = session.latest(), None
    if telemetry.step is not None:
        p_tip = telemetry.step.tip.translation
        radius = session.options.tip_radius
        where = whereabouts(session.scene, telemetry.q, p_tip, radius, session.crossing)
    parts = tuple(capsule.name for capsule in session.scene.arm.capsules)
    made = readouts.Extras(0, 0.0, tuple(session.scene.arm.joints), where=where, parts=parts)
    return replace(made, **changes)


def text(html: str) -> str:
    return re.sub(r"<[^>]*>", "", html)


def banner(session: Session, telemetry: Telemetry | None = None, **changes: Any) -> str:
    return text(
        readouts.banner(
            telemetry or session.latest(),
            session.options,
            extras(session, **changes),
            session.master.clutched,
        )
    )


def says(session: Session, words: str) -> bool:
    return words in banner(session)


def below(session: Session, depth: float) -> pin.SE3:
    """The start pose moved down by a depth [m]."""
    start = session.scene.T_base_start
    return pin.SE3(start.rotation, start.translation - np.array([0.0, 0.0, depth]))


def step_of(session: Session) -> vf.Step:
    step = session.latest().step
    assert step is not None
    return step


def into(session: Session) -> pin.SE3:
    """A pose at half the depth of the mesh below the start."""
    low = session.scene.surface.vertices[:, 2].min()
    high = session.scene.surface.vertices[:, 2].max()
    return below(session, session.scene.T_base_start.translation[2] - 0.5 * (low + high))


def test_a_proxy_in_the_anatomy_is_held_back_and_a_higher_standoff_leads_out(
    session: Session,
) -> None:
    session.drive(below(session, 1e-3))
    wait_until(lambda: says(session, "Free."))
    session.drive(into(session))
    wait_until(lambda: says(session, "The fixture holds the blade back (1 plane)"))
    wait_until(lambda: step_of(session).distance < 1e-4)
    session.pause()
    wait_until(lambda: says(session, "Paused. Run"))
    session.set(standoff=5e-4)
    tick = session.latest().tick
    session.single_step()
    # The status alone is not enough: the new standoff shows before the step is done.
    wait_until(lambda: session.latest().tick > tick)
    assert step_of(session).status is vf.Status.RECOVERING
    assert "Recovering" in banner(session, replace(session.latest(), paused=False))


def test_a_tool_inside_the_anatomy_is_reported(session: Session) -> None:
    session.set(rule="off")
    session.drive(into(session))
    wait_until(lambda: says(session, "No fixture (rule off)"))
    wait_until(
        lambda: np.allclose(step_of(session).tip.translation, into(session).translation),
    )
    session.set(rule="certified")
    wait_until(lambda: says(session, "Inside the anatomy"))
    session.pause()
    wait_until(lambda: says(session, "Paused. The tool is inside the anatomy."))
    session.resume()
    session.reset()
    wait_until(lambda: says(session, "Ready"))
    surface = session.scene.surface
    assert not surface.inside(np.array(step_of(session).tip.translation))


def test_clutch_autopilot_and_stale_commands_are_reported(session: Session) -> None:
    session.clutch(True)
    wait_until(lambda: says(session, "Clutched"))
    assert session.master.clutched
    session.clutch(False)
    assert not session.master.clutched
    session.set_autopilot(True)
    wait_until(lambda: says(session, "Autopilot"))
    session.reset()
    session.drive(below(session, 1e-3), held=True)
    wait_until(lambda: says(session, "Stale"))


def test_a_joint_at_its_limit_is_named(session: Session) -> None:
    # Insertion is the PSM's third joint; half a metre up is out of its reach.
    session.drive(below(session, -0.5))
    wait_until(lambda: says(session, "Joint limit: insertion (lower)"))


def test_held_and_refused_ticks_have_a_reason(session: Session) -> None:
    telemetry = session.latest()
    assert telemetry.step is not None
    target = session.scene.T_base_start
    for status, words in ((vf.Status.HELD, "Held: no safe step"), (vf.Status.REFUSED, "Refused")):
        step = replace(telemetry.step, status=status, solver=Solver.INFEASIBLE)
        said = banner(session, replace(telemetry, step=step, target=target))
        assert words in said
    step = replace(telemetry.step, status=vf.Status.HELD, solver=Solver.INFEASIBLE)
    assert "no step allowed" in banner(session, replace(telemetry, step=step, target=target))


def test_a_silent_loop_is_the_most_urgent_state(session: Session) -> None:
    assert "silent for 3 s" in banner(session, replace(session.latest(), paused=True), silent=3.2)
    assert "Ready" in banner(session, silent=0.1)


def test_a_loop_that_ended_has_no_rate_and_no_outcome(session: Session) -> None:
    wait_until(lambda: session.latest().stats.rate > 0.0)
    running, ended = (
        text(readouts.readouts(session.latest(), session.options, extras(session, ended=why)))
        for why in ("", "signal SIGKILL")
    )
    assert "rate0Hz" not in running
    assert "SOLVED" in running.split("Control loop")[0]
    assert "rate0Hz" in ended
    assert "SOLVED" not in ended.split("Control loop")[0]
    assert "SIGKILL" in banner(session, ended="signal SIGKILL")


@pytest.mark.parametrize("solver", list(Solver))
def test_each_solver_and_status_has_a_text(session: Session, solver: Solver) -> None:
    telemetry = session.latest()
    assert telemetry.step is not None
    counts = {status: 1000 + k for k, status in enumerate(vf.Status)}
    telemetry = replace(
        telemetry, step=replace(telemetry.step, solver=solver), stats=LoopStats(counts=counts)
    )
    table = text(readouts.readouts(telemetry, session.options, extras(session)))
    assert palette.SOLVER_HELP[solver] in table
    for status, count in counts.items():
        assert f"{status.name} {palette.STATUS_HELP[status]}{count:,}" in table


def test_read_outs_differ_so_that_the_watchdog_restarts(session: Session) -> None:
    telemetry = session.latest()
    first, second = (
        readouts.readouts(telemetry, session.options, extras(session, count=k)) for k in (1, 2)
    )
    assert first != second
    assert text(first) == text(second)


def test_every_kind_of_plane_is_counted_and_in_the_legend(session: Session) -> None:
    telemetry = session.latest()
    assert telemetry.step is not None
    signs = text(legend.legend())
    for k, rule in enumerate(vf.Rule):
        m = k + 2
        planes = vf.Planes(
            normals=np.tile([0.0, 0.0, 1.0], (m, 1)),
            offsets=np.full(m, -1.0),
            points=np.zeros((m, 3)),
            triangles=np.zeros(m, dtype=np.int64),
            rules=np.full(m, int(rule), dtype=np.int8),
            radius=5e-3,
        )
        step = replace(telemetry.step, planes=planes, multipliers=np.zeros(m))
        table = text(
            readouts.readouts(replace(telemetry, step=step), session.options, extras(session))
        )
        assert f"{palette.LOOKS[rule].name}{m}" in table
        assert palette.LOOKS[rule].name in signs


def test_triangles_within_reach_of_the_tips_ball_are_counted(session: Session) -> None:
    telemetry = session.latest()
    assert telemetry.step is not None
    step = telemetry.step
    gap = session.scene.surface.nearest(step.tip.translation)[0]
    lower = pin.SE3(step.tip.rotation, step.tip.translation - [0.0, 0.0, gap - step.radius - 3e-3])
    telemetry = replace(telemetry, step=replace(step, tip=lower))  # 3 mm from the motion sphere
    for tip_radius, counted, name in (
        (0.0, False, "triangles in sphere"),
        (2e-3, False, "triangles in ball’s reach"),
        (4e-3, True, "triangles in ball’s reach"),
    ):
        options = replace(session.options, tip_radius=tip_radius)
        found = Measuring().measure(Moment(session.scene, options, telemetry, False), 0, "")
        assert (found.in_sphere > 0) == counted
        assert name in text(readouts.readouts(telemetry, options, found))


def test_conditions_are_named_as_the_paper_s_where_its_rule_is_chosen(session: Session) -> None:
    wait_until(lambda: session.latest().step is not None)
    shown = session.latest()
    for rule, name in (("paper", "■</span> Condition 2"), ("certified", "■</span> like Condition")):
        options = replace(session.options, rule=rule)
        table = readouts.readouts(shown, options, extras(session))
        assert name in table
        assert ("like Condition" in table) == (rule != "paper")
    assert "that rule does not ask for them" in legend.legend()
