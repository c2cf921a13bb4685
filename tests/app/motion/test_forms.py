"""Shapes over time: where they begin, how fast they are, what ticks are told of them."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import meshes
import vf
from app.motion.declared import Motion, Tracker
from app.motion.forms import FIT, Form, Modes, form_of, frame_of
from app.motion.movement import Movement, courses
from app.motion.vertices import Vertices, read
from app.words import OptionError

DT = 1e-3


def placed(name: str = "heart", scale: float = 1.0) -> tuple[np.ndarray, pin.SE3]:
    T = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.8])), np.array([0.01, -0.02, -0.1]))
    return scale * meshes.arrays(name)[0] @ T.rotation.T + T.translation, T


def beating(amplitude: float = 1.0, dt: float = DT, scale: float = 1.0) -> tuple[Form, pin.SE3]:
    vertices, T = placed(scale=scale)
    return Form(Modes("heart", amplitude, None, 0.0), vertices, dt, FIT), T


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_shapes_are_those_of_the_catalogue_where_the_structure_is(scale: float) -> None:
    form, T = beating(scale=scale)
    heart = meshes.deforming("heart")
    for number in (0, 3, 27, 500):
        phase = number * form.frame / heart.period
        wanted = scale * heart.shape(phase) @ T.rotation.T + T.translation
        np.testing.assert_allclose(form.shape(number), wanted, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(form.vertices(number * form.frame + 1e-9), form.shape(number))
    assert not form.shape(3).flags.writeable


def test_vertices_are_never_faster_than_the_bound_and_do_not_jump() -> None:
    form, _ = beating(1.5)
    times = np.arange(0.0, 0.9, 5e-4)
    shapes = np.array([form.vertices(t)[::50] for t in times])
    speeds = np.linalg.norm(np.diff(shapes, axis=0), axis=2) / 5e-4
    assert 0.7 * form.fastest() < speeds.max() <= form.fastest()


def test_shapes_of_many_vertices_follow_each_other_more_slowly() -> None:
    """By docs/motion.md: 20 ms, ten ticks, or 0.2 µs for each vertex, whichever is longest."""
    assert (frame_of(8, 1e-3), frame_of(8, 0.01)) == (0.02, 0.1)
    assert (frame_of(90_000, 1e-3), frame_of(1_000_000, 1e-3)) == pytest.approx((0.02, 0.2))
    many = np.zeros((200_000, 3))
    form = Form(None, many, 1e-3, placement=(1.0, np.eye(3), np.zeros(3)))
    assert form.frame == pytest.approx(0.04)


@pytest.mark.parametrize("dt", [1e-4, 1e-3, 0.01, 0.1])
@pytest.mark.parametrize("pace", [0.3, 1.0, 2.0])
def test_one_tick_after_the_other_is_told_where_the_vertices_are(dt: float, pace: float) -> None:
    """Each begins with the shape that the last one ended with, number by number."""
    vertices, _ = placed("vessel")
    surface = vf.Surface.from_arrays(vertices, meshes.arrays("vessel")[1])
    movement = Movement(courses([Motion("deforming")], ["vessel"], [surface], dt), None)
    form = movement.forms[0]
    assert form is not None
    assert form.frame >= 10 * dt
    now, moved = vertices, 0
    phase = 0.0
    for _ in range(300):
        told = movement.during(phase, phase + pace * dt)
        phase += pace * dt
        (pair,), (motion,) = told.shapes, told.motions
        assert pair is not None
        assert motion is not None
        first, last = movement.ends(0, pair)
        low, high = motion.blend
        before, after = ((1.0 - s) * first + s * last for s in (low, high))
        assert np.abs(before - now).max() < 1e-15
        # And ends with the true one.
        assert np.abs(after - form.vertices(phase)).max() < 1e-15
        moved += bool((after != before).any())
        now = after
    assert moved > 100


def test_a_tracker_shows_the_shape_at_the_last_sighting() -> None:
    vertices, _ = placed("vessel")
    surface = vf.Surface.from_arrays(vertices, meshes.arrays("vessel")[1])
    tracker = Tracker(rate=20.0, latency=0.03, bound=0.05)
    movement = Movement(courses([Motion("deforming")], ["vessel"], [surface], DT), tracker)
    form = movement.forms[0]
    assert form is not None
    for number in range(1, 400, 7):
        phase = number * DT
        told = movement.during(phase - DT, phase)
        seen = max(int(np.floor((phase - 0.03) * 20.0 + 1e-9)), 0) / 20.0
        (pair,), (motion,) = told.shapes, told.motions
        assert motion is not None
        assert pair is not None
        assert motion.blend == (1.0, 1.0)
        np.testing.assert_array_equal(movement.ends(0, pair)[1], form.vertices(seen))
        (believed,) = movement.believed(phase)
        np.testing.assert_array_equal(believed, form.vertices(seen))
        # The true shape is within the margin.
        off = np.linalg.norm(form.vertices(phase) - form.vertices(seen), axis=1).max()
        assert off <= motion.margin * form.fastest() / tracker.bound + 1e-12


def test_what_does_not_deform_is_refused_by_name() -> None:
    cube = vf.Surface.from_arrays(*meshes.arrays("cube"))
    with pytest.raises(OptionError, match=r"deforming is of heart, liver, vessel.*not of cube"):
        courses([Motion("deforming")], ["cube"], [cube])
    heart = vf.Surface.from_arrays(*meshes.arrays("heart"))
    found = courses([Motion("deforming")], ["cube", "heart"], [cube, heart])
    assert found[0] is None
    assert found[1] is not None
    assert found[1].form is not None
    twice = [Motion("deforming"), Motion("deforming", of="heart")]
    with pytest.raises(OptionError, match="'heart' is deformed by 2"):
        courses(twice, ["cube", "heart"], [cube, heart])
    bent = meshes.arrays("heart")[0].copy()
    bent[7] += 1e-3
    assert form_of([Motion("deforming")], "x", bent, DT)[0] is None


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"kind": "deforming", "move": (0.0, 0.0, 1e-3)}, "takes no move"),
        ({"kind": "deforming", "file": "x.npz"}, "takes no file"),
        ({"kind": "vertices"}, "needs a file"),
        ({"kind": "vertices", "file": "x.npz", "period": 1.0}, "takes no period"),
        ({"kind": "vertices", "file": "x.npz", "amplitude": 0.5}, "takes no amplitude"),
        ({"kind": "breathing", "amplitude": 0.5}, "takes no amplitude"),
    ],
)
def test_what_is_of_another_kind_is_refused(options: dict[str, object], told: str) -> None:
    with pytest.raises(OptionError, match=told):
        Motion(**options)  # type: ignore[arg-type]


def test_a_form_goes_to_another_process() -> None:
    form, _ = beating()
    copy = pickle.loads(pickle.dumps(form))
    np.testing.assert_array_equal(copy.vertices(0.377), form.vertices(0.377))


def recorded(path: Path, frames: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Shapes of a cube in millimetres, upside down."""
    rest = -1e3 * meshes.arrays("cube")[0][:, [1, 0, 2]]
    times = np.cumsum(np.linspace(0.03, 0.05, frames))
    shapes = rest * (1.0 + 0.1 * np.sin(np.arange(frames)))[:, None, None]
    np.savez(path, times=times, vertices=shapes)
    return times, shapes


def test_vertices_come_from_a_file_in_any_frame_and_unit(tmp_path: Path) -> None:
    times, shapes = recorded(tmp_path / "cube.npz")
    vertices, _ = meshes.arrays("cube")
    motion = Motion("vertices", file=str(tmp_path / "cube.npz"), after=0.5)
    form, rigid = form_of([motion], "cube", vertices, DT)
    assert form is not None
    assert rigid == []
    for k, time in enumerate(times):
        number = round((0.5 + time - times[0]) / form.frame)
        at = number * form.frame - 0.5 + times[0]
        wanted = np.array([np.interp(at, times, shapes[:, i, 0]) for i in (0, 5)])
        found = form.shape(number)[[0, 5], 1]
        np.testing.assert_allclose(found, -1e-3 * wanted, rtol=0, atol=1e-12), k
    np.testing.assert_allclose(form.shape(0), vertices, atol=1e-12)
    np.testing.assert_allclose(form.shape(10_000), form.shape(9_999))
    assert form.content
    with pytest.raises(OptionError, match=r"cube\.npz has 2,402 vertices, 'heart' has 10,242"):
        form_of([motion], "heart", meshes.arrays("heart")[0], DT)
    with pytest.raises(OptionError, match="first shape is not that of 'cube'"):
        form_of([motion], "cube", vertices[::-1], DT)


def test_an_npy_has_fifty_shapes_a_second(tmp_path: Path) -> None:
    shapes = np.zeros((3, 4, 3), dtype=np.float32)
    np.save(tmp_path / "a.npy", shapes)
    np.testing.assert_allclose(read(tmp_path / "a.npy").times, [0.0, 0.02, 0.04])
    assert isinstance(read(tmp_path / "a.npy"), Vertices)


@pytest.mark.parametrize(
    ("arrays", "told"),
    [
        ({"vertices": np.zeros((3, 4, 3))}, "there is no 'times'"),
        ({"times": np.arange(3.0), "vertices": np.zeros((3, 4, 2))}, r"\(frames, n, 3\)"),
        ({"times": np.arange(2.0), "vertices": np.zeros((3, 4, 3))}, "a time for each of 3"),
        ({"times": np.arange(1.0), "vertices": np.zeros((1, 4, 3))}, "2 shapes or more"),
        ({"times": np.array([0, 1, 1]), "vertices": np.zeros((3, 4, 3))}, "1 s does not follow"),
        ({"times": np.array([0, 1, np.nan]), "vertices": np.zeros((3, 4, 3))}, "shape 2 is nan"),
        ({"times": np.arange(3), "vertices": np.full((3, 4, 3), np.inf)}, "vertex 0 of shape 0"),
        ({"times": np.arange(3), "vertices": np.full((3, 4, 3), "x")}, "not numbers"),
        ({"times": np.array([None] * 3), "vertices": np.zeros((3, 4, 3))}, r"x\.npz: "),
    ],
)
def test_a_file_of_no_use_is_refused_with_its_name(
    tmp_path: Path, arrays: dict[str, np.ndarray], told: str
) -> None:
    np.savez(tmp_path / "x.npz", **arrays)
    with pytest.raises(OptionError, match=told) as refused:
        read(tmp_path / "x.npz")
    assert "x.npz" in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04broken", b"t,x,y,z\n1,2,3,4\n"])
def test_a_file_that_is_none_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.npz").write_bytes(content)
    with pytest.raises(OptionError, match=r"x\.npz: "):
        read(tmp_path / "x.npz")
    with pytest.raises(OptionError, match="No such file"):
        read(tmp_path / "y.npz")
