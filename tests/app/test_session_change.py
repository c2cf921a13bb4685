"""A session that gets another mesh or arm while it runs."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import meshes
import robots
from app.scene.worker import Stopped
from app.session import Session
from app.settings import Options
from app.words import OptionError, Refused
from tests.support.brute import Oracle
from tests.support.headless import moved, wait_until

Wait = Callable[[Callable[[], bool]], None]
Moved = Callable[..., pin.SE3]


@pytest.fixture
def session() -> Iterator[Session]:
    with Session(Options(mesh="cube", robot="point")) as running:
        yield running


def tool(session: Session) -> np.ndarray:
    step = session.latest().step
    assert step is not None
    return np.array(step.tip.translation)


def rests_at(session: Session, point: np.ndarray, within: float = 1e-6) -> Callable[[], bool]:
    return lambda: (
        session.latest().step is not None and float(np.linalg.norm(tool(session) - point)) < within
    )


def test_mesh_and_robot_change_while_running(session: Session) -> None:
    session.drive(moved(session.scene.T_base_start, dz=-0.03))
    wait_until(lambda: session.latest().step is not None)
    wait_until(lambda: session.latest().step.distance < 1e-4)
    words: list[str] = []
    changes: list[dict[str, str]] = [
        {"mesh": "sphere"}, {"robot": "psm"}, {"mesh": "torus", "robot": "ur5"}, {"robot": "panda"},
    ]  # fmt: skip
    for version, change in enumerate(changes, start=2):
        new = session.change(**change, progress=words.append)
        assert session.scene is new
        assert new.version == session.latest().scene == version
        assert (session.options.mesh, session.options.robot) == (new.mesh_name, new.robot)
        # The handle is on the tool, the tool is free and at rest.
        np.testing.assert_allclose(session.handle.translation, tool(session), atol=1e-9)
        truth = Oracle(new.surface.vertices, new.surface.faces)
        assert abs(truth.winding(tool(session))) < 0.5
        assert session.latest().target is None
        goal = moved(session.handle, dx=0.002, dz=0.002)
        session.drive(goal)
        wait_until(rests_at(session, goal.translation, 1e-5))
        assert session.latest().q.shape == robots.load(new.robot).neutral.shape
    assert any("sphere" in word for word in words)
    assert any("panda" in word for word in words)


def test_a_change_that_fails_keeps_what_was_there(session: Session, tmp_path: Path) -> None:
    goal = moved(session.scene.T_base_start, dx=0.003)
    session.drive(goal)
    wait_until(lambda: session.latest().step is not None)
    wait_until(rests_at(session, goal.translation))
    scene, options, handle = session.scene, session.options, session.handle
    broken = tmp_path / "broken.stl"
    broken.write_bytes(b"this is no mesh")
    with pytest.raises(meshes.MeshError, match="no-such-mesh"):
        session.change(mesh="no-such-mesh")
    with pytest.raises(meshes.MeshError, match=r"broken\.stl"):
        session.change(mesh=str(broken))
    with pytest.raises(OptionError, match="unknown robot 'r2d2': choose one of psm, point"):
        session.change(robot="r2d2")
    assert session.scene is scene
    assert session.options is options
    assert session.handle is handle
    again = moved(goal, dz=0.003)
    session.drive(again)
    wait_until(rests_at(session, again.translation))


def test_a_file_in_millimetres_keeps_the_tool_at_its_surface(
    tmp_path: Path, session: Session
) -> None:
    path = tmp_path / "block.stl"
    trimesh.creation.box((40.0, 40.0, 20.0)).export(path)
    scene = session.change(mesh=str(path), unit="mm")
    assert scene.mesh_name == "block.stl"
    assert session.options.unit == "mm"
    np.testing.assert_allclose(np.ptp(scene.vertices_shown, axis=0), [0.04, 0.04, 0.02], atol=1e-9)
    top = scene.surface.vertices[:, 2].max()
    session.drive(moved(scene.T_base_start, dz=-0.02))
    wait_until(lambda: abs(tool(session)[2] - top) < 1e-4)
    assert tool(session)[2] > top
    # A guessed unit and an open mesh are told in words.
    half = trimesh.creation.box((40.0, 40.0, 20.0))
    half.update_faces(np.arange(len(half.faces)) > 2)
    half.export(path)
    notes = " ".join(session.change(mesh=str(path)).notes)
    assert "unit" in notes
    assert "not closed" in notes


def test_one_change_at_a_time(session: Session) -> None:
    entered, go_on = threading.Event(), threading.Event()

    def dawdle(_text: str) -> None:
        entered.set()
        go_on.wait(20.0)

    slow = threading.Thread(target=session.change, kwargs={"mesh": "torus", "progress": dawdle})
    slow.start()
    assert entered.wait(20.0)
    assert session.work.going
    with pytest.raises(Refused, match="another change is under way"):
        session.change(mesh="cone")
    with pytest.raises(Refused, match="another change is under way"), session.work.begin():
        pass
    # The old scene can still be driven and set while the new one is being built.
    session.set(rule="paper")
    go_on.set()
    slow.join()
    assert not session.work.going
    assert session.options.mesh == "torus"
    assert session.options.rule == "paper"


def test_no_session_is_suspended_while_another_mesh_is_on_its_way(session: Session) -> None:
    asked: list[str] = []

    def suspend(_text: str) -> None:
        try:
            session.suspend("a replay is shown")
        except Refused as reason:
            asked.append(str(reason))

    session.change(mesh="stairs", progress=suspend)
    assert set(asked) == {"another change is under way: wait until it is done"}
    assert not session.suspended


def test_a_change_can_be_stopped_wherever_it_is_built(session: Session) -> None:
    scene, options = session.scene, session.options
    with pytest.raises(Stopped, match="nothing is changed"):
        session.change(mesh="stairs", progress=lambda _text: session.work.stop())
    assert (session.scene, session.options) == (scene, options)
    assert session.change(mesh="stairs").mesh_name == "stairs"


def test_parts_of_one_work_are_not_in_each_others_way(session: Session) -> None:
    with session.work.begin() as stop:
        session.change(mesh="stairs", stop=stop)
        with pytest.raises(Refused, match="another change is under way"):
            session.change(mesh="cone")
        session.suspend("a replay is shown", stop)
    assert session.suspended
    session.go_on()
    assert session.change(mesh="cone").mesh_name == "cone"
