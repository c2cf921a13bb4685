"""`bench runtime`, `loop` and `meshes` and the command line: their structure, no timings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import meshes
import robots
import vf
from app.bench import loop, runtime
from app.bench.tools import bare, report, settings
from app.bench.tools import route as routes
from app.bench.tools.machine import write
from app.commands import call
from app.words import OptionError
from meshes.builtin import ladder


def test_rungs_have_exactly_the_counts_asked_for_and_one_shape() -> None:
    rungs = ladder.rungs(ladder.source(), (1_024, 4_096, 16_384))
    assert [len(faces) for _, faces in rungs.values()] == [1_024, 4_096, 16_384]
    assert list(rungs) == [1_024, 4_096, 16_384]
    volumes = []
    for vertices, faces in rungs.values():
        body = trimesh.Trimesh(vertices, faces, process=False)
        assert body.is_volume
        assert len(vertices) == len(faces) // 2 + 2  # Euler: closed, genus 0
        volumes.append(body.volume)
    assert np.ptp(volumes) < 0.02 * volumes[-1]
    assert np.ptp(rungs[16_384][0], axis=0).max() == pytest.approx(ladder.BUNNY)


@pytest.mark.slow
def test_the_full_ladder_has_the_papers_counts() -> None:
    rungs = ladder.rungs(ladder.source())
    assert tuple(rungs) == ladder.SIZES == settings.SIZES
    assert len(rungs[51_978][0]) == 25_991
    assert len(rungs[989_376][0]) == 494_690


def test_a_shape_that_will_not_shrink_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    stubborn = replace(ladder.source(), key="test-stubborn")
    monkeypatch.setattr(
        ladder.fast_simplification, "simplify", lambda points, faces, target_count: (points, faces)
    )
    with pytest.raises(meshes.MeshError, match="closed manifold"):
        ladder.rungs(stubborn, (1_024,))
    with pytest.raises(meshes.MeshError, match="at least 128"):
        ladder.rungs(ladder.source(), (64,))


def test_the_course_is_free_at_its_start_and_goes_below_the_skin(small: vf.Surface) -> None:
    arm = robots.load("psm")
    route = routes.plan(small, arm, spots=6)
    assert len(route.starts) == 6
    assert route.pits == (True, False) * 3
    for spot, start in enumerate(route.starts):
        targets = route.targets(spot)
        assert len(targets) == routes.TICKS
        np.testing.assert_allclose(
            arm.tip(start).translation, targets[0].translation, atol=1e-6, err_msg=str(spot)
        )
        assert not small.inside(targets[0].translation), spot
        assert any(small.inside(target.translation) for target in targets), spot


@pytest.mark.slow
def test_runtime_reports_every_row_and_its_parts(tmp_path: Path) -> None:
    options = settings.Runtime(
        sizes=(2_048, 8_192), radii=(2e-3, None), ticks=400, passes=1, out=tmp_path
    )
    shares: list[float] = []
    result = runtime.run(options, lambda _: None, shares.append)
    assert shares[-1] == 1.0
    rows = result["rows"]
    table = {
        r["radius [m]"]: r for r in rows if (r["rule"], r["triangles"]) == ("certified", 8_192)
    }
    assert {(r["rule"], r["radius [m]"], r["triangles"]) for r in rows} == {
        (rule, radius, size)
        for rule in ("certified", "paper")
        for radius in (2e-3, None)
        for size in (2_048, 8_192)
    }
    for row in rows:
        assert row["ticks"] == 400
        assert sum(state["share"] for state in row["states"].values()) == pytest.approx(1.0)
        assert row["states"]["touching"]["share"] + row["states"]["concavity"]["share"] > 0.1, row
        assert row["tick [us]"]["p1"] <= row["tick [us]"]["median"] <= row["tick [us]"]["p99"]
        assert sum(row["parts [us]"].values()) == pytest.approx(row["tick [us]"]["median"])
        assert row["rate [kHz]"] == pytest.approx(1e3 / row["tick [us]"]["median"])
        assert sum(row["statuses"].values()) == row["ticks"]
        assert row["statuses"].get("refused", 0) == 0
    tools = result["whole instrument"]
    assert {(r["rule"], r["radius [m]"], r["triangles"]) for r in tools} == {
        ("certified", radius, 8_192) for radius in (2e-3, None)
    }
    for row in tools:
        assert row["ticks"] == 400
        assert row["statuses"].get("held", 0) == 0
        assert row["planes"]["mean"] > table[row["radius [m]"]]["planes"]["mean"]
    assert len(result["ratios"]) == 4 + 2 + 2
    ratio = result["ratios"][-2]
    assert ratio["what"].startswith("tick of the whole instrument / of the tip at 8,192, ")
    assert ratio["ratio"] == pytest.approx(
        tools[0]["tick [us]"]["median"] / table[2e-3]["tick [us]"]["median"]
    )
    floor = result["floor [us]"]
    assert 0.0 < floor["p1"] <= floor["median"] <= floor["p99"]
    assert floor["p1"] < min(row["tick [us]"]["median"] for row in rows)
    stored = json.loads(write(tmp_path, "runtime", result).read_text())
    assert len(stored["rows"]) == len(rows)


def test_the_figure_is_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    row = {
        "rule": "certified", "radius [m]": 5e-3, "triangles": 1000, "rate [kHz]": 10.0,
        "tick [us]": {"p1": 90.0, "median": 100.0, "p99": 200.0},
    }  # fmt: skip
    result = {
        "rows": [row, {**row, "triangles": 10_000}],
        "source": "test",
        "published": {"points": [{"triangles": 51_978, "rate [kHz]": 7.73}]},
    }
    report.figure(result, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes()[:4] == b"\x89PNG"


def test_ticks_that_a_stall_swallowed_count_as_late() -> None:
    starts = np.arange(1000) * 1e-3
    ticks = np.column_stack([starts, np.full(1000, 2e-5), np.full(1000, 1e-4)])
    row = loop.summary(ticks, 1.0, 1000.0)
    assert row["punctual"] == 1.0
    assert row["rate [Hz]"] == pytest.approx(1000.0)
    assert row["longest stall [ms]"] == pytest.approx(1.0)
    stalled = np.delete(ticks, slice(300, 400), axis=0)
    row = loop.summary(stalled, 1.0, 1000.0)
    assert row["punctual"] == pytest.approx(0.9)
    assert row["longest stall [ms]"] == pytest.approx(101.0)
    assert loop.summary(np.empty((0, 3)), 1.0, 1000.0)["punctual"] == 0.0


def test_a_loop_that_does_nothing_ticks_at_its_deadlines() -> None:
    rows = bare.measure(200.0, 0.2)
    assert 2 <= len(rows) <= 40
    starts, late, _ = rows.T
    assert (late >= 0.0).all()
    deadlines = starts - late
    # 5 ms after the one before, or later where a stall is not made up for.
    assert (np.diff(deadlines) >= 5e-3 - 1e-6).all()


def test_the_loop_is_watched_without_a_browser() -> None:
    options = settings.Loop(
        mesh="cube", seconds=0.5, phases=("idle", "dragging"), browser=False, rate=200.0
    )
    result = loop.run(options, lambda _: None, lambda _: None)
    assert [row["phase"] for row in result["phases"]] == ["idle", "dragging"]
    assert result["browser"] == "no browser asked for"
    for row in result["phases"]:
        assert 0 < row["ticks"] <= 110
        assert 0.0 <= row["punctual"] <= 1.0
        assert row["frames/s"] is None


def test_a_missing_browser_is_said_not_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("VF_CHROMIUM", raising=False)
    options = settings.Loop(mesh="cube", seconds=0.1, phases=("idle",), rate=200.0)
    result = loop.run(options, lambda _: None, lambda _: None)
    assert result["browser"].startswith("no browser: no Chromium found")


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (settings.Runtime, {"sizes": (5,)}),
        (settings.Runtime, {"ticks": 0}),
        (settings.Runtime, {"rules": ()}),
        (settings.Peers, {"radii": (None,)}),
        (settings.Peers, {"queries": -1}),
        (settings.Loop, {"phases": ("dancing",)}),
        (settings.Loop, {"seconds": 0.0}),
    ],
)
def test_unusable_options_are_refused(kind: type, values: dict) -> None:
    with pytest.raises(OptionError):
        kind(**values)


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--sizes", "2048", "--radii", "2mm", "--ticks", "200", "--passes", "1"]
    assert call("bench", ["runtime", *words, "--out", str(tmp_path)]) == 0
    assert "written" in capsys.readouterr().out
    stored = json.loads((tmp_path / "runtime.json").read_text())
    assert stored["rows"][0]["radius [m]"] == 2e-3
    assert call("bench", ["walk"]) == 2
    assert "choose one of runtime, structures, motion, peers, loop" in capsys.readouterr().err
    assert call("bench", ["runtime", *words, "--rules", "magic"]) == 2
    assert "unknown rule 'magic'" in capsys.readouterr().err
    assert call("bench", ["loop", "--phases", "dancing"]) == 2
    assert (
        "idle, dragging, loading, joining, examining, recording, replaying"
        in capsys.readouterr().err
    )


def test_from_a_file_to_a_guarded_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--mesh", "torus", "--passes", "1", "--formats", "stl", "--out", str(tmp_path)]
    assert call("bench", ["meshes", *words]) == 0
    assert "STL file to a ready fixture" in capsys.readouterr().out
    stored = json.loads((tmp_path / "meshes.json").read_text())
    assert stored["turned back"] == stored["flipped"] > 0
    assert all(seconds > 0.0 for seconds in stored["seconds"].values())
    assert call("bench", ["meshes", "--formats", "doc"]) == 2
    assert "choose one of stl, ply, obj, off, glb" in capsys.readouterr().err
