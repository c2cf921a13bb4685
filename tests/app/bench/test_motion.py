"""`bench motion`: its rows and what moves in them, no timings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vf
from app.bench import motion
from app.bench.tools import settings
from app.commands import call
from meshes.builtin import ladder


def test_every_kind_of_motion_is_timed(tmp_path: Path) -> None:
    options = settings.Motion(size=2_048, ticks=200, passes=1, seconds=0, out=tmp_path)
    shares: list[float] = []
    result = motion.run(options, lambda _: None, shares.append)
    assert shares == [1.0]
    names = [row["what"] for row in result["rows"]]
    assert names == ["still", "rigid", "deforming", "rigid and deforming"]
    assert all(row["planes"] > 0.0 for row in result["rows"])
    assert result["rows"][0]["ratio"] == 1.0
    assert result["taken over [ms]"]["median"] > 0.0
    assert result["beside the loop"] == []


def test_the_loop_is_watched_with_and_without_shapes(tmp_path: Path) -> None:
    options = settings.Motion(size=2_048, seconds=0.8, out=tmp_path)
    vertices, faces = ladder.rungs(ladder.source(), (2_048,))[2_048]
    bare, still, deforming = motion._beside(options, vertices, faces)
    assert [row["what"] for row in (bare, still, deforming)] == [
        "does nothing", "still", "deforming",
    ]  # fmt: skip
    assert (still["shapes"], deforming["shapes"]) == (0, 40)  # one every 20 ms
    for row in (bare, still, deforming):
        assert 0 < row["ticks"] <= 801
        assert 0.0 <= row["prompt"] <= row["punctual"] <= 1.0


def test_what_moves_is_as_fast_as_said() -> None:
    x = np.random.default_rng(0).uniform(-0.1, 0.1, (3_000, 3))
    first, second = motion._shapes(x)
    way = np.linalg.norm(second - first, axis=1).max()
    assert way / (motion.FRAME * motion.DT) == pytest.approx(motion.DEFORMED)
    there, back = motion._motions(np.array([0.0, 0.1, 0.2]))[motion.BOTH]
    assert isinstance(there[0], vf.Motion)
    assert there[0].end == back[0].start
    gone = there[0].start.inverse() * there[0].end
    turned = np.arccos(0.5 * (np.trace(gone.rotation) - 1.0))
    assert turned / motion.DT == pytest.approx(motion.TURN, rel=1e-6)
    centre = np.array([0.0, 0.1, 0.2])
    moved = there[0].end.act(there[0].start.actInv(centre)) - centre
    assert np.linalg.norm(moved) / motion.DT == pytest.approx(motion.SPEED, rel=1e-2)
    assert there[0].blend == back[0].blend[::-1]


def test_the_command_prints_the_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [
        "motion",
        "--size",
        "2048",
        "--ticks",
        "200",
        "--passes",
        "1",
        "--seconds",
        "0",
        "--out",
        str(tmp_path),
    ]
    assert call("bench", words) == 0
    assert "a new shape of" in capsys.readouterr().out
    assert (tmp_path / "motion.json").exists()
