"""Scenes from a process of their own: the same scenes, the same errors, nothing left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from pathlib import Path
from typing import Any

import numba.core.event
import numpy as np
import pytest
import trimesh

import meshes
import robots
from app import aside
from app import scene as scenes
from app.settings import Options

HEAVY = Options(mesh="skull-coarse", robot="point")


def test_a_scene_from_aside_is_the_one_built_here_and_compiles_nothing() -> None:
    arm = robots.load("point")
    words: list[str] = []
    ours = scenes.build(HEAVY, 3)
    scenes.plant(ours, HEAVY)
    got = aside.build(HEAVY, 3, arm, words.append)
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
    assert not aside.light(Options(mesh=str(broken)))
    with pytest.raises(meshes.MeshError) as here:
        scenes.build(Options(mesh=str(broken)), 1)
    with pytest.raises(meshes.MeshError) as there:
        aside.build(Options(mesh=str(broken)), 1, robots.load("psm"))
    assert str(here.value) == str(there.value)


def test_small_things_are_built_here(tmp_path: Path) -> None:
    small, large = tmp_path / "small.stl", tmp_path / "large.stl"
    trimesh.creation.icosphere(3).export(small)
    trimesh.creation.icosphere(5).export(large)
    heavy = {str(large): False, "skull": False, "skull-fine": False}
    quick = {str(small): True, "cube": True, "no-such-mesh": True}
    assert {name: aside.light(Options(mesh=name)) for name in heavy | quick} == heavy | quick


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
    with pytest.raises(aside.Ended, match="SIGKILL"):
        aside.build(HEAVY, 1, robots.load("point"))
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
        aside.build(HEAVY, 1, robots.load("point"), refuse)
    assert started[0].returncode is not None
