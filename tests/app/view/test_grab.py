"""Drags of the tool: what a pointer's way turns into, and who is obeyed."""

from __future__ import annotations

from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from app.session import Session
from app.settings import Options
from app.view import camera
from app.view.clients import grab
from app.view.clients.client_input import GIZMO, ClientInput

SHARE = st.floats(-1.0, 1.0)


@given(st.tuples(SHARE, SHARE, SHARE, SHARE).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_the_axes_of_a_camera_are_its_own(wxyz: tuple[float, ...]) -> None:
    w, x, y, z = np.array(wxyz) / np.linalg.norm(wxyz)
    expected = Rotation.from_quat([x, y, z, w]).as_matrix()
    np.testing.assert_allclose(camera.axes_of(np.array([w, x, y, z])), expected, atol=1e-12)


@given(SHARE, SHARE)
def test_turning_carries_the_near_side_with_the_pointer(right: float, down: float) -> None:
    axes = Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix()
    pose = pin.SE3(Rotation.from_rotvec([1.0, 0.2, 0.1]).as_matrix(), np.array([0.1, 0.2, 0.3]))
    moved = 1e-3 * np.array([right, down])
    new = grab.turned(pose, axes, moved)
    np.testing.assert_array_equal(new.translation, pose.translation)
    near = -axes[:, 2]  # of the tool, towards the camera
    way = (new.rotation @ pose.rotation.T - np.eye(3)) @ near
    np.testing.assert_allclose(way, np.pi * (axes[:, :2] @ moved), atol=1e-5)


UNIT = (
    st.tuples(SHARE, SHARE, SHARE)
    .map(np.array)
    .filter(lambda v: np.linalg.norm(v) > 0.1)
    .map(lambda v: v / np.linalg.norm(v))
)


@given(UNIT, UNIT, st.floats(1e-4, 0.1))
def test_the_plane_of_a_drag_holds_the_way_down_or_faces_the_viewer(
    view: np.ndarray, down: np.ndarray, far: float
) -> None:
    normal = grab.facing(view, far * down)
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    assert normal @ view >= 0.5 - 1e-12, "seen from its front, and not edge-on"
    if np.linalg.norm(np.cross(view, down)) > 0.5 + 1e-9:
        assert abs(normal @ down) < 1e-9
        # No plane that contains the way down faces the viewer more.
        for angle in np.linspace(0.0, np.pi, 37):
            other = Rotation.from_rotvec(angle * down).apply(normal)
            assert abs(other @ view) <= normal @ view + 1e-9
    else:
        np.testing.assert_array_equal(normal, view)
    np.testing.assert_allclose(grab.facing(view, np.zeros(3)), view)


@given(UNIT, UNIT, SHARE, SHARE)
def test_a_pointer_takes_the_place_it_holds_with_it(
    view: np.ndarray, down: np.ndarray, right: float, up: float
) -> None:
    held, eye = np.array([0.02, -0.01, 0.3]), np.array([0.02, -0.01, 0.3]) - 0.2 * view
    normal = grab.facing(view, down)
    way = 0.2 * view + 0.03 * np.cross(view, [right, up, 0.3])
    shift = grab.on_plane(held, normal, eye, way)
    assert shift is not None
    assert abs(normal @ shift) < 1e-9, "it stays in the plane"
    seen = held + shift - eye
    np.testing.assert_allclose(np.cross(seen, way), 0.0, atol=1e-9)
    assert seen @ way > 0.0
    assert grab.on_plane(held, normal, eye, -way) is None, "behind the viewer"
    along = np.cross(normal, [0.3, 0.5, 0.7])
    assert grab.on_plane(held, normal, eye, along + 0.1 * np.linalg.norm(along) * normal) is None


def pose(z: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([0.0, 0.0, z]))


def test_of_two_things_below_the_pointer_the_first_is_dragged() -> None:
    session, client = MagicMock(), SimpleNamespace(client_id=3)
    server = SimpleNamespace(get_clients=lambda: {3: client, 4: client})
    told = MagicMock()
    entry = ClientInput(session, server, MagicMock(), told)  # type: ignore[arg-type]
    try:
        driven = lambda: [call.args[0].translation[2] for call in session.drive.call_args_list]  # noqa: E731
        assert entry.drag(GIZMO, client, 3, "start", lambda: pose(0.1))  # type: ignore[arg-type]
        for phase in ("start", "update", "end"):
            assert not entry.drag(grab.TOOL, client, 3, phase, lambda: pose(9.0))  # type: ignore[arg-type]
        told.assert_not_called()
        assert not entry.drag(grab.TOOL, client, 4, "start", lambda: pose(9.0))  # type: ignore[arg-type]
        told.assert_called_once()
        assert entry.drag(GIZMO, client, 3, "update", lambda: pose(0.2))  # type: ignore[arg-type]
        assert entry.drag(GIZMO, client, 3, "end", lambda: pose(0.3))  # type: ignore[arg-type]
        assert entry.owner is None
        assert driven() == pytest.approx([0.1, 0.2, 0.3])
        assert entry.drag(grab.TOOL, client, 4, "start", lambda: pose(0.4))  # type: ignore[arg-type]
        assert entry.owner == 4
    finally:
        entry.close()


@pytest.fixture(scope="module")
def session() -> Session:  # type: ignore[misc]
    with Session(Options(mesh="sphere", robot="point")) as session:
        yield session


class Hand:
    """A grab without a browser: messages of a drag run at once."""

    def __init__(self, session: Session) -> None:
        self.told = MagicMock()
        self.input = SimpleNamespace(drag=self._drag)
        source = MagicMock()
        source.now.return_value.scene = session.scene
        source.now.return_value.pose.return_value = None
        self.session, self.shown = session, True
        self.grab = grab.Grab(
            session,
            source,
            self.input,  # type: ignore[arg-type]
            self.told,
            lambda: self.shown,
        )

    def _drag(self, grip: str, client: object, number: int, phase: str, read: object) -> bool:
        self.session.drive(read(), held=phase != "end")  # type: ignore[operator]
        return True

    def move(self, phase: str, keys: str | None, pointer: list[float], screen: list[float]) -> None:
        client = SimpleNamespace(client_id=0)
        # A camera that looks down, its right along x: down on the screen is −y.
        looking_down = np.array([0.0, 1.0, 0.0, 0.0])
        self.grab._drag(
            client, phase, keys, np.array(pointer), np.array(screen), looking_down,
            np.array([0.0, 0.0, 50.0]),
        )  # type: ignore[arg-type]  # fmt: skip


def test_a_drag_goes_on_where_another_key_is_pressed(session: Session) -> None:
    session.reset()
    hand = Hand(session)
    start = session.handle.translation.copy()
    hand.move("start", None, [0.0, 0.0, 0.0], [0.5, 0.5])
    hand.move("update", None, [0.5, 0.0, 0.0], [0.6, 0.5])
    np.testing.assert_allclose(session.handle.translation - start, [5e-3, 0.0, 0.0], atol=1e-12)
    hand.move("end", None, [0.5, 0.0, 0.0], [0.6, 0.5])
    hand.move("start", grab.DEPTH, [0.5, 0.0, 0.0], [0.6, 0.5])
    hand.move("update", grab.DEPTH, [0.5, 0.2, 0.0], [0.6, 0.4])
    # Up on the screen is away from the camera, which is down.
    np.testing.assert_allclose(session.handle.translation - start, [5e-3, 0.0, -2e-3], atol=1e-12)
    hand.move("end", grab.DEPTH, [0.5, 0.2, 0.0], [0.6, 0.4])
    assert hand.told.call_count == 1, "each client is told once"


def test_nothing_is_dragged_where_the_proxy_is_not_shown(session: Session) -> None:
    hand = Hand(session)
    hand.shown = False
    before = session.handle.translation.copy()
    hand.move("start", None, [0.0, 0.0, 0.0], [0.5, 0.5])
    np.testing.assert_array_equal(session.handle.translation, before)
    assert "not shown" in hand.told.call_args.args[1]


def test_slides_on_what_the_pointer_is_over_and_stays_where_there_is_nothing(
    session: Session,
) -> None:
    session.reset()
    hand = Hand(session)
    centre = session.scene.surface.vertices.mean(axis=0) * 100.0
    hand.move("start", grab.SURFACE, [0.0, 0.0, 50.0 - 1e-3], [0.5, 0.5])
    # The camera is at (0, 0, 50): aim at the middle of the sphere from there.
    hand.move("update", grab.SURFACE, list(centre), [0.5, 0.4])
    p = session.handle.translation
    distance = session.scene.surface.nearest(p)[0]
    assert 0.0 < distance <= grab.PRESSED * 1.01
    assert session.scene.surface.inside(p)
    before = p.copy()
    hand.move("update", grab.SURFACE, [40.0, 40.0, 40.0], [0.5, 0.4])
    np.testing.assert_array_equal(session.handle.translation, before)


def test_the_wheel_moves_what_is_held_and_the_drag_goes_on_from_there(session: Session) -> None:
    session.reset()
    hand = Hand(session)
    looking_down = np.array([0.0, 1.0, 0.0, 0.0])
    client = SimpleNamespace(client_id=0, camera=SimpleNamespace(wxyz=looking_down))
    start = session.handle.translation.copy()
    reach = hand.grab.reach
    reach(client, 3.0, 0.0)  # type: ignore[arg-type]  # nobody holds it
    np.testing.assert_array_equal(session.handle.translation, start)
    assert not hand.grab.holds
    hand.move("start", None, [0.0, 0.0, 0.0], [0.5, 0.5])
    assert hand.grab.holds
    reach(client, 5.0, 0.2)  # type: ignore[arg-type]  # two notches more, away from the camera
    np.testing.assert_allclose(
        session.handle.translation - start, [0, 0, -2 * grab.NOTCH], atol=1e-12
    )
    turn = pin.log3(session.handle.rotation @ session.scene.T_base_start.rotation.T)
    np.testing.assert_allclose(turn, [0.0, 0.0, -0.2], atol=1e-9)
    for wrong in (np.nan, np.inf):
        reach(client, wrong, 0.0)  # type: ignore[arg-type]
    reach(client, 5.0, 0.2)  # type: ignore[arg-type]
    hand.move("update", None, [0.5, 0.0, 0.0], [0.6, 0.5])
    np.testing.assert_allclose(
        session.handle.translation - start, [5e-3, 0.0, -2 * grab.NOTCH], atol=1e-12
    )
    hand.move("end", None, [0.5, 0.0, 0.0], [0.6, 0.5])
    assert not hand.grab.holds
