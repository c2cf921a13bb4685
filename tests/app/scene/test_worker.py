"""Scenes from a process of their own: the same scenes, the same errors, nothing left behind."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import threading
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numba.core.event
import numpy as np
import pytest
import trimesh

import meshes
import robots
from app.__main__ import main
from app.scene import scene as scenes
from app.scene import worker
from app.scene.measure import measure
from app.session import Session
from app.settings import Options
from meshes.units import choices
from tests.support import work_for_tests

ROOT = Path(__file__).parents[3]

HEAVY = Options(mesh="skull-coarse", robot="point")


def test_a_scene_from_aside_is_the_one_built_here_and_compiles_nothing() -> None:
    arm = robots.load("point")
    words: list[str] = []
    ours = scenes.build(HEAVY, 3)
    scenes.plant(ours, HEAVY)
    got = worker.build(HEAVY, 3, arm, words.append)
    assert got.arm is arm
    assert (got.version, got.mesh_name, got.notes) == (3, ours.mesh_name, ours.notes)
    for name in ("vertices", "faces", "normals", "neighbours", "edges"):
        mine, theirs = getattr(ours.surface, name), getattr(got.surface, name)
        np.testing.assert_array_equal(mine, theirs)
        assert mine.dtype == theirs.dtype
        assert theirs.flags.c_contiguous
        assert not theirs.flags.writeable
    np.testing.assert_array_equal(got.start, ours.start)
    np.testing.assert_array_equal(got.faces_shown, ours.faces_shown)
    assert got.autopilot.pose(1.5) == ours.autopilot.pose(1.5)
    assert any("tree" in word for word in words)
    # Arrays of another kind (writeable, not aligned) would have every kernel compiled again.
    with numba.core.event.install_recorder("numba:compile") as compiled:
        plant = scenes.plant(got, HEAVY)
        plant.controller.step(plant.q0, got.autopilot.pose(2.0))
        got.surface.inside(got.surface.vertices[0])
        got.surface.nearest(got.surface.vertices[0])
    assert not compiled.buffer


def test_errors_from_aside_are_the_errors_of_here(tmp_path: Path) -> None:
    broken = tmp_path / "broken.obj"
    broken.write_text("f 1 2 3\n")
    assert not worker.light(str(broken))
    with pytest.raises(meshes.MeshError) as here:
        scenes.build(Options(mesh=str(broken)), 1)
    with pytest.raises(meshes.MeshError) as there:
        worker.build(Options(mesh=str(broken)), 1, robots.load("psm"))
    assert str(here.value) == str(there.value)


def test_small_things_are_built_here(tmp_path: Path) -> None:
    small, large = tmp_path / "small.stl", tmp_path / "large.stl"
    trimesh.creation.icosphere(3).export(small)
    trimesh.creation.icosphere(5).export(large)
    heavy = {str(large): False, "skull": False, "skull-fine": False}
    quick = {str(small): True, "cube": True, "no-such-mesh": True}
    assert {name: worker.light(name) for name in heavy | quick} == heavy | quick


def test_a_process_that_dies_is_an_error_and_leaves_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def start(*args: Any, **kwargs: Any) -> subprocess.Popen[bytes]:
        started.append(popen(*args, **kwargs))
        threading.Timer(0.2, os.kill, (started[0].pid, signal.SIGKILL)).start()
        return started[0]

    monkeypatch.setattr(subprocess, "Popen", start)
    with pytest.raises(worker.Ended, match="SIGKILL"):
        worker.build(HEAVY, 1, robots.load("point"))
    assert started[0].returncode == -signal.SIGKILL


def test_a_listener_that_raises_ends_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def start(*args: Any, **kwargs: Any) -> subprocess.Popen[bytes]:
        started.append(popen(*args, **kwargs))
        return started[0]

    def refuse(text: str) -> None:
        if started:
            raise RuntimeError(text)

    monkeypatch.setattr(subprocess, "Popen", start)
    with pytest.raises(RuntimeError):
        worker.build(HEAVY, 1, robots.load("point"), refuse)
    assert started[0].returncode is not None


@pytest.fixture
def work(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Functions that this process and the one aside know."""
    known = os.environ.get("PYTHONPATH")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), *([known] if known else [])]))
    return work_for_tests


PLENTY = worker.Allowance(60.0, 4e9)


@pytest.mark.slow
def test_work_beyond_its_allowance_ends_and_says_why(
    work: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "_PATIENCE", 1000.0)
    assert worker.run(partial(work.add, 2, 3), PLENTY) == 5
    with pytest.raises(worker.Ended, match="more than 1 s of processor time"):
        worker.run(work.spin, worker.Allowance(1.0, 4e9))
    for take in (work.fill, work.fill_and_blame_the_file):
        with pytest.raises(worker.Ended, match=r"more than the 0\.3 GB of memory"):
            worker.run(take, worker.Allowance(60.0, 3e8))
    # What waits uses no processor.
    monkeypatch.setattr(worker, "_PATIENCE", 0.01)
    with pytest.raises(worker.Ended, match="not done after 1 s"):
        worker.run(work.wait, worker.Allowance(100.0, 4e9))


def test_it_can_be_stopped_while_it_works_and_before(work: ModuleType) -> None:
    stop = worker.Stop()
    words: list[str] = []

    def listen(text: str) -> None:
        words.append(text)
        if text == "waiting":
            stop()

    with pytest.raises(worker.Stopped):
        worker.run(work.wait, PLENTY, listen, stop)
    assert words[-1] == "waiting"
    with pytest.raises(worker.Stopped):
        worker.run(work.wait, PLENTY, None, stop)
    stop()  # nothing is there to be ended


def test_an_allowance_goes_with_the_files_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "_available_memory", lambda: 4e12)
    sizes = (421, 1_000_000, 500_000_000)
    found = []
    for size in sizes:
        path = tmp_path / "m.3mf"
        with path.open("wb") as file:
            file.truncate(size)
        found.append(worker.allowance(str(path)))
    assert found[1].seconds < 65.0  # no minutes for a megabyte
    assert found[0].memory < found[1].memory < found[2].memory
    monkeypatch.setattr(worker, "_available_memory", lambda: 1e9)
    assert {worker.allowance(str(path)).memory for _ in sizes} == {7.5e8}


def test_a_session_goes_on_when_its_change_is_stopped_or_too_much(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "large.obj"
    trimesh.creation.icosphere(4, 0.03).export(path)
    wanted = {"mesh": str(path), "unit": "m"}
    with Session(Options(mesh="cube", robot="point")) as session:
        scene, options = session.scene, session.options
        with pytest.raises(worker.Stopped):
            session.change(**wanted, progress=lambda _text: session.work.stop())
        monkeypatch.setattr(worker, "allowance", lambda _mesh: worker.Allowance(60.0, 1e6))
        with pytest.raises(ValueError, match="memory"):
            session.change(**wanted)
        assert (session.scene, session.options) == (scene, options)
        monkeypatch.undo()
        assert session.change(**wanted).mesh_name == "large.obj"


def test_mesh_check_is_held_to_an_allowance(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "large.obj"
    trimesh.creation.icosphere(4, 30.0).export(path)
    assert main(["mesh", "check", str(path)]) == 0
    out, err = capsys.readouterr()
    assert "sound" in out
    assert "taken to be in mm" in err
    monkeypatch.setattr(worker, "allowance", lambda _mesh: worker.Allowance(60.0, 1e6))
    assert main(["mesh", "check", str(path), "--unit", "mm"]) == 2
    assert "memory" in capsys.readouterr().err


def test_a_file_is_measured_before_its_unit_is_asked(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(1, 2.0)
    across = float(np.linalg.norm(np.ptp(ball.vertices, axis=0)))
    cases = {"ball.obj": (1.0, None), "small.ply": (0.01, None), "ball.glb": (1.0, "m")}
    cases |= {"millimetres.glb": (30.0, "m"), "large.stl": (30.0, None)}
    for name, (scale, said) in cases.items():
        path = tmp_path / name
        trimesh.Trimesh(ball.vertices * scale, ball.faces).export(path)
        found = measure(str(path), lambda _text: None)
        assert found == (pytest.approx(scale * across, rel=1e-6), said)
    words = choices(3.0, "cm")
    assert next(iter(words)) == "cm"
    assert words["cm"] == "cm, as the file says: 30 mm from corner to corner"
    assert words["m"] == "m: 3 m from corner to corner"
    for size, text in ((1e-9, "0.1 mm to 10 m"), (1e9, "0.1 mm to 10 m")):
        path = tmp_path / "absurd.obj"
        trimesh.Trimesh(ball.vertices * size, ball.faces).export(path, digits=12)
        with pytest.raises(meshes.MeshError, match=re.escape(text)):
            measure(str(path), lambda _text: None)
