"""Sessions with their real control thread, robots, meshes and controller."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import meshes
from app.devices.page import FARTHEST_PROXY
from app.session import Session
from app.settings import Options
from app.words import OptionError, Refused
from tests.support.brute import Oracle
from tests.support.everyday import everyday
from tests.support.headless import moved, wait_until

Wait = Callable[[Callable[[], bool]], None]
Moved = Callable[..., pin.SE3]

CATALOGUE = [name for name in meshes.names() if "fine" not in name]


@pytest.fixture
def session() -> Iterator[Session]:
    with Session(Options(mesh="cube", robot="point")) as running:
        yield running


def tool(session: Session) -> np.ndarray:
    step = session.latest().step
    assert step is not None
    return np.array(step.tip.translation)


def seen(session: Session, sequence_of: int) -> bool:
    return session.latest().sequence >= sequence_of


def rests_at(session: Session, point: np.ndarray, within: float = 1e-6) -> Callable[[], bool]:
    return lambda: (
        session.latest().step is not None and float(np.linalg.norm(tool(session) - point)) < within
    )


@pytest.mark.parametrize("robot", ["point", "psm"])
@pytest.mark.parametrize("mesh", everyday(CATALOGUE, "skull", "thin-plate", "gear"))
def test_the_tool_follows_when_free_and_stays_out_of_every_mesh(
    mesh: str, robot: str, tapes: list[Any]
) -> None:
    # How near the tip comes: with the whole instrument guarded an inclined blade is there first.
    with Session(Options(mesh=mesh, robot=robot, guard="tip")) as session:
        surface, start = session.scene.surface, session.scene.T_base_start
        free = moved(start, dx=0.003, dy=-0.002, dz=0.004)
        session.drive(free)
        wait_until(lambda: session.latest().step is not None)
        wait_until(rests_at(session, free.translation))
        # Into the highest corner that is not on the middle line, where one skull is slit open.
        beside = surface.vertices[np.abs(surface.vertices[:, 0] - start.translation[0]) > 4e-3]
        summit = beside[np.argmax(beside[:, 2])]
        inside = moved(pin.SE3(start.rotation, summit.copy()), dz=-0.01)
        session.drive(inside)
        first = session.latest().tick
        wait_until(lambda: session.latest().tick > first + 600)
    truth = Oracle(surface.vertices, surface.faces)
    path = np.array([start.translation] + [t.step.tip.translation for t in tapes[1].items[1:]])
    assert truth.crossings(path) == 0
    for point in path[:: len(path) // 3]:
        assert abs(truth.winding(point)) < 0.5
    # It did push: the proxy is out of reach and the tool came near the surface all the same.
    assert session.latest().step.distance < 5e-4
    # The record is of every tick, so the path that was judged is the path that was made.
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 2e-3


def test_the_proxy_may_be_anything_sensible_and_nothing_else(session: Session) -> None:
    good = moved(session.scene.T_base_start, dx=0.004)
    session.drive(good)
    wait_until(lambda: session.latest().step is not None)
    wait_until(rests_at(session, good.translation))
    R, p = good.rotation, good.translation
    mirrored = R.copy()
    mirrored[:, 0] *= -1.0
    bad = {
        "not finite": [
            pin.SE3(R, np.array([math.nan, 0.0, 0.0])),
            pin.SE3(R, np.array([0.0, math.inf, 0.0])),
            pin.SE3(np.full((3, 3), math.nan), p),
        ],
        "not a rotation": [pin.SE3(1.1 * R, p), pin.SE3(mirrored, p), pin.SE3(0.0 * R, p)],
        "at most 2 m": [
            pin.SE3(R, np.array([0.0, 0.0, FARTHEST_PROXY + 0.01])),
            pin.SE3(R, np.array([1e300, 0.0, 0.0])),
        ],
    }
    sequence = session.latest().sequence
    for reason, poses in bad.items():
        for pose in poses:
            with pytest.raises(Refused, match=reason):
                session.drive(pose, held=True)
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 20)
    telemetry = session.latest()
    assert telemetry.sequence == sequence
    assert telemetry.target.isApprox(good, 1e-12)
    np.testing.assert_allclose(tool(session), p, atol=1e-6)
    again = moved(good, dy=0.004)
    session.drive(again)
    wait_until(rests_at(session, again.translation))


def test_the_caller_may_go_on_using_its_pose(session: Session) -> None:
    pose = pin.SE3(session.scene.T_base_start)
    session.drive(pose)
    pose.translation = np.array([0.0, 0.0, 1.0])
    wait_until(lambda: session.latest().target is not None)
    assert session.latest().target.isApprox(session.scene.T_base_start, 1e-12)


def test_pause_single_step_and_resume(session: Session) -> None:
    session.drive(moved(session.scene.T_base_start, dx=0.25))
    session.pause()
    wait_until(lambda: session.latest().paused)
    before = session.latest()
    for k in range(1, 4):
        session.single_step()
        wait_until(lambda k=k: session.latest().tick >= before.tick + k)
    assert session.latest().tick == before.tick + 3
    assert session.latest().paused
    session.resume()
    wait_until(lambda: session.latest().tick > before.tick + 20)
    assert not session.latest().paused
    # From a running session a single step pauses first.
    session.single_step()
    wait_until(lambda: session.latest().paused)
    tick = session.latest().tick
    sequence = session.latest().sequence
    session.drive(moved(session.scene.T_base_start, dx=0.2))
    wait_until(lambda: session.latest().sequence > sequence)
    assert session.latest().tick <= tick + 1


def test_reset_brings_tool_handle_and_proxy_home(session: Session) -> None:
    goal = moved(session.scene.T_base_start, dx=0.02)
    session.drive(goal)
    wait_until(lambda: session.latest().step is not None)
    wait_until(rests_at(session, goal.translation))
    session.reset()
    wait_until(rests_at(session, session.scene.T_base_start.translation, 1e-12))
    assert session.handle.isApprox(session.scene.T_base_start, 1e-12)
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 50)
    np.testing.assert_array_equal(session.latest().q, session.scene.start)


def test_recall_puts_handle_and_proxy_onto_the_tool(session: Session) -> None:
    session.drive(moved(session.scene.T_base_start, dz=-0.03))
    wait_until(lambda: session.latest().step is not None)
    wait_until(lambda: session.latest().step.distance < 1e-4)
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 50)
    before = tool(session)
    session.recall()
    sequence = session.latest().sequence
    wait_until(
        lambda: session.latest().sequence >= sequence and session.latest().target is not None
    )
    wait_until(lambda: np.linalg.norm(session.latest().target.translation - before) < 1e-5)
    np.testing.assert_allclose(session.handle.translation, before, atol=1e-5)
    wait_until(lambda: np.linalg.norm(session.latest().step.force) < 1e-2)


def test_a_scaled_handle_moves_the_proxy_less_and_a_new_scale_does_not_jump(
    session: Session,
) -> None:
    start = session.scene.T_base_start
    assert session.set(scale=0.2).scale == 0.2
    session.drive(moved(start, dx=0.02))
    wait_until(lambda: session.latest().target is not None)
    np.testing.assert_allclose(
        session.latest().target.translation, moved(start, dx=0.004).translation, atol=1e-12
    )
    assert session.set(scale=0.5).scale == 0.5
    sequence = session.latest().sequence
    session.drive(moved(start, dx=0.02))
    wait_until(lambda: session.latest().sequence > sequence)
    np.testing.assert_allclose(
        session.latest().target.translation, moved(start, dx=0.004).translation, atol=1e-12
    )
    session.drive(moved(start, dx=0.04))
    wait_until(lambda: session.latest().sequence > sequence + 1)
    np.testing.assert_allclose(
        session.latest().target.translation, moved(start, dx=0.014).translation, atol=1e-12
    )


def test_the_clutch_frees_the_handle_and_latches_anew_on_release(session: Session) -> None:
    start = session.scene.T_base_start
    goal = moved(start, dx=0.01)
    session.drive(goal)
    wait_until(lambda: session.latest().step is not None)
    wait_until(rests_at(session, goal.translation))
    session.clutch(True)
    sequence = session.latest().sequence
    session.drive(moved(start, dy=0.03), held=True)
    wait_until(lambda: session.latest().sequence > sequence and session.latest().target is None)
    held = tool(session)
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 50)
    np.testing.assert_array_equal(tool(session), held)
    np.testing.assert_array_equal(session.latest().step.force, 0.0)
    session.clutch(False)
    wait_until(lambda: session.latest().target is not None)
    # The proxy is where the tool is, though the handle is elsewhere ...
    np.testing.assert_allclose(session.latest().target.translation, held, atol=1e-9)
    np.testing.assert_allclose(session.handle.translation, moved(start, dy=0.03).translation)
    # ... and moves as the handle moves from there.
    session.drive(moved(start, dy=0.03, dz=0.005))
    wait_until(rests_at(session, held + np.array([0.0, 0.0, 0.005])))


def test_a_drag_that_goes_silent_holds_the_tool() -> None:
    options = Options(mesh="cube", robot="point", stale_after=0.1)
    with Session(options) as session:
        far = moved(session.scene.T_base_start, dz=0.25)
        session.drive(far, held=True)
        wait_until(lambda: session.latest().stale)
        stopped = tool(session)
        assert stopped[2] < far.translation[2] - 0.05
        session.touch()
        wait_until(lambda: tool(session)[2] > stopped[2] + 1e-3)
        session.drive(far, held=False)
        wait_until(rests_at(session, far.translation))
        assert not session.latest().stale


def test_settings_change_while_running_and_are_clamped(session: Session) -> None:
    session.drive(moved(session.scene.T_base_start, dz=-0.03))
    wait_until(lambda: session.latest().step is not None)
    wait_until(lambda: session.latest().step.distance < 1e-4)
    assert session.set(radius=1e-3).radius == 1e-3
    wait_until(lambda: session.latest().step.radius == 1e-3)
    assert session.set(radius=1e3).radius == 2e-2
    assert session.set(radius=-1.0).radius == 5e-5
    assert session.set(radius=None).radius is None
    assert session.set(force_gain=1e9).force_gain == 1000.0
    assert session.set(standoff=1.0).standoff == 1e-3
    assert session.set(scale=-3.0).scale == 0.05
    assert session.set(tip_radius=2e-3).tip_radius == 2e-3
    top = session.scene.surface.vertices[:, 2].max()
    wait_until(lambda: abs(tool(session)[2] - top - 3e-3) < 1e-5)  # tip radius and standoff
    for name in ("radius", "force_gain", "tip_radius"):
        with pytest.raises(Refused, match=f"{name} nan"):
            session.set(**{name: math.nan})
        with pytest.raises(Refused, match=f"{name} must be a number"):
            session.set(**{name: "1"})
    for name in ("mesh", "robot", "rate", "host", "nothing"):
        with pytest.raises(Refused, match=f"{name} is none of what is set live: corridor, margin"):
            session.set(**{name: 1})
    assert session.options == Options(
        mesh="cube", robot="point", radius=None, standoff=1e-3, tip_radius=2e-3, scale=0.05,
        force_gain=1000.0,
    )  # fmt: skip


def test_the_rule_changes_while_running(session: Session) -> None:
    below = moved(session.scene.T_base_start, dz=-0.03)
    top = session.scene.surface.vertices[:, 2].max()
    session.drive(below)
    wait_until(lambda: session.latest().step is not None)
    for rule in ("paper", "all", "certified"):
        assert session.set(rule=rule).rule == rule
        wait_until(lambda: abs(tool(session)[2] - top) < 1e-4)
        tick = session.latest().tick
        wait_until(lambda tick=tick: session.latest().tick > tick + 50)
        assert tool(session)[2] > top
    with pytest.raises(Refused, match="unknown rule 'soft': choose one of certified, paper, all"):
        session.set(rule="soft")
    assert session.options.rule == "certified"
    session.set(rule="off")
    wait_until(rests_at(session, below.translation))


def test_the_autopilot_drives_until_a_hand_takes_over(session: Session) -> None:
    session.set_autopilot(True)
    wait_until(lambda: session.latest().autopilot and session.latest().target is not None)
    wait_until(lambda: session.latest().step.distance < 1e-4)
    session.set_autopilot(False)
    wait_until(lambda: not session.latest().autopilot)
    assert session.latest().target.isApprox(session.handle, 1e-6)
    session.set_autopilot(True)
    wait_until(lambda: session.latest().autopilot)
    goal = moved(session.scene.T_base_start, dx=0.002)
    session.drive(goal)
    wait_until(lambda: not session.latest().autopilot)
    wait_until(rests_at(session, goal.translation))


def test_a_locked_orientation_holds_and_its_release_does_not_jump(session: Session) -> None:
    start = session.scene.T_base_start
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, 0.4)
    session.drive(pin.SE3(turn @ start.rotation, start.translation))
    assert session.set(lock_orientation=True).lock_orientation
    goal = moved(start, dx=0.002)
    session.drive(pin.SE3(turn @ turn @ goal.rotation, goal.translation))
    wait_until(lambda: session.latest().target is not None)
    wait_until(rests_at(session, goal.translation))
    np.testing.assert_allclose(session.latest().target.rotation, turn @ start.rotation, atol=1e-12)
    sequence = session.latest().sequence
    assert not session.set(lock_orientation=False).lock_orientation
    session.drive(session.handle)
    wait_until(lambda: seen(session, sequence + 1))
    np.testing.assert_allclose(session.latest().target.rotation, turn @ start.rotation, atol=1e-12)
    session.drive(pin.SE3(turn @ session.handle.rotation, goal.translation))
    wait_until(lambda: seen(session, sequence + 2))
    np.testing.assert_allclose(
        session.latest().target.rotation, turn @ turn @ start.rotation, atol=1e-12
    )


def test_a_nudge_moves_the_handle_by_so_much_and_bad_ones_are_refused(session: Session) -> None:
    start = np.array(session.handle.translation)
    session.set(scale=0.5)
    session.nudge([1e-3, 0.0, 0.0])
    session.nudge(np.array([1e-3, -1e-4, 0.0]))
    np.testing.assert_allclose(session.handle.translation - start, [2e-3, -1e-4, 0.0], atol=1e-12)
    wait_until(rests_at(session, start + np.array([1e-3, -5e-5, 0.0])))
    for bad in ([math.nan, 0.0, 0.0], [1.0, 2.0], [100.0, 0.0, 0.0]):
        with pytest.raises(Refused):
            session.nudge(bad)
    np.testing.assert_allclose(session.handle.translation - start, [2e-3, -1e-4, 0.0], atol=1e-12)
    session.set_autopilot(True)
    wait_until(lambda: session.latest().autopilot and session.latest().target is not None)
    session.nudge([0.0, 0.0, 1e-4])
    wait_until(lambda: not session.latest().autopilot)


def test_the_tip_speed_limit_is_clamped_and_holds_between_any_two_ticks(session: Session) -> None:
    assert session.set(tip_speed=99.0).tip_speed == 2.0
    assert session.set(tip_speed=-1.0).tip_speed == 1e-3
    assert session.set(tip_speed=0.02).tip_speed == 0.02
    with pytest.raises(Refused, match="tip_speed"):
        session.set(tip_speed=math.nan)
    wait_until(lambda: session.latest().step is not None)
    session.drive(moved(session.scene.T_base_start, dx=0.004))
    seen_at: list[tuple[int, np.ndarray]] = []

    def arrived() -> bool:
        telemetry = session.latest()
        seen_at.append((telemetry.tick, np.array(telemetry.step.tip.translation)))
        return rests_at(session, session.handle.translation)()

    wait_until(arrived)
    ticks, tips = np.array([t for t, _ in seen_at]), np.array([p for _, p in seen_at])
    moved_by = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    assert (moved_by <= 0.02 * session.options.dt * np.diff(ticks) * 1.001 + 1e-12).all()


def test_a_session_closes_cleanly_whatever_it_was_doing() -> None:
    for prepare in (
        lambda s: None,
        lambda s: s.start(),
        lambda s: (s.start(), s.pause()),
        lambda s: (s.start(), s.set_autopilot(True)),
    ):
        session = Session(Options(mesh="cube", robot="point"))
        prepare(session)
        session.close()
        session.close()
        assert session.latest().tick >= 0
    assert "control" not in {thread.name for thread in threading.enumerate()}


def test_unknown_names_list_the_valid_ones() -> None:
    with pytest.raises(OptionError, match="unknown robot 'x': choose one of psm, point, panda, ur"):
        Session(Options(robot="x"))
    with pytest.raises(OptionError, match="unknown rule 'x': choose one of certified, paper, all"):
        Session(Options(rule="x"))
    with pytest.raises(meshes.MeshError, match="skull"):
        Session(Options(mesh="x"))


@pytest.mark.parametrize("ran", [True, False])
def test_a_suspended_session_takes_no_order_and_goes_on_as_it_was(
    session: Session, tmp_path: Path, ran: bool
) -> None:
    start = session.scene.T_base_start
    session.drive(moved(start, dx=0.002, dz=-0.001), held=True)
    wait_until(lambda: session.latest().tick > 20)
    if not ran:
        session.pause()
    wait_until(lambda: session.latest().paused is not ran)
    options, scene, handle = session.options, session.scene, session.handle
    session.suspend("a replay is shown")
    assert session.suspended
    wait_until(lambda: session.latest().paused)
    orders: list[Callable[[], object]] = [
        lambda: session.drive(moved(start, dx=0.004)),
        lambda: session.nudge([1e-3, 0.0, 0.0]),
        session.recall,
        lambda: session.clutch(True),
        session.pause,
        session.resume,
        session.single_step,
        session.reset,
        lambda: session.set_autopilot(True),
        lambda: session.put(start),
        lambda: session.perform(session.scene.autopilot),
        lambda: session.set(rule="off"),
        lambda: session.set(radius=1e-3),
        lambda: session.set(force_gain=10.0),
        lambda: session.set(standoff=1e-4),
        lambda: session.set(tip_radius=1e-3),
        lambda: session.set(corridor=None) if options.corridor else session.set(rule="all"),
        lambda: session.set(scale=0.5),
        lambda: session.set(lock_orientation=True),
        lambda: session.set(tip_speed=0.1),
        lambda: session.change(mesh="stairs"),
        lambda: session.record(tmp_path / "run.vfrec"),
        lambda: session.suspend("another"),
    ]
    for order in orders:
        with pytest.raises(Refused, match="a replay is shown"):
            order()
    session.touch()  # of a drag that is not told yet
    assert (session.options, session.scene) == (options, scene)
    assert session.handle is handle
    assert not list(tmp_path.iterdir())
    tick = session.latest().tick
    session.go_on()
    session.go_on()
    assert not session.suspended
    if ran:
        # The drag was let go: it does not go stale.
        wait_until(lambda: session.latest().tick > tick + 700)
        assert not session.latest().stale
    else:
        assert session.latest().tick == tick
        session.resume()
    wait_until(rests_at(session, np.array(moved(start, dx=0.002, dz=-0.001).translation)))
    assert session.change(mesh="stairs").mesh_name == "stairs"
