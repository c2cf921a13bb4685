"""The measurements' structure, their checks, and that a wrong answer is caught. No timings."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.optimize import minimize

import meshes
import robots
import vf
from app.bench import loop, peers, queries, runtime, soak, solvers
from app.bench.queries import Peer
from app.bench.tools import reference, report, settings
from app.bench.tools import route as routes
from app.bench.tools.machine import write
from app.commands import call
from app.words import OptionError
from meshes.builtin import cache, ladder

SMALL = ladder.Source("organic", ladder.organic, "organic")


@pytest.fixture(autouse=True, scope="module")
def the_same_everywhere(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The built-in shape whatever is installed, and a cache of this run's own."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setattr(cache, "folder", lambda: folder)
        patch.setattr(ladder, "source", lambda path=None, unit=None: SMALL)
        yield


@pytest.fixture(scope="module")
def small(the_same_everywhere: None) -> vf.Surface:
    vertices, faces = ladder.rungs(SMALL, (10_240,))[10_240]
    arm = robots.load("psm")
    return vf.Surface.from_arrays(meshes.place(vertices, arm.tip(arm.neutral)), faces)


@pytest.fixture(scope="module")
def bodies(small: vf.Surface) -> queries.Bodies:
    rng = np.random.default_rng(4)
    faces = rng.integers(len(small.faces), size=30)
    middle = small.vertices[small.faces[faces]].mean(axis=1)
    height = rng.uniform(2e-5, 4e-3, (30, 1))
    return queries.Bodies.of(small, middle + height * small.normals[faces])


def test_rungs_have_exactly_the_counts_asked_for_and_one_shape() -> None:
    rungs = ladder.rungs(SMALL, (1_024, 4_096, 16_384))
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
    rungs = ladder.rungs(SMALL)
    assert tuple(rungs) == ladder.SIZES == settings.SIZES
    assert len(rungs[51_978][0]) == 25_991
    assert len(rungs[989_376][0]) == 494_690


def test_a_shape_that_will_not_shrink_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    stubborn = replace(SMALL, key="test-stubborn")
    monkeypatch.setattr(
        ladder.fast_simplification, "simplify", lambda points, faces, target_count: (points, faces)
    )
    with pytest.raises(meshes.MeshError, match="closed manifold"):
        ladder.rungs(stubborn, (1_024,))
    with pytest.raises(meshes.MeshError, match="at least 128"):
        ladder.rungs(SMALL, (64,))


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
    assert len(result["ratios"]) == 4 + 2
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


def test_distances_of_the_reference_are_the_least_of_all_points_of_a_triangle() -> None:
    rng = np.random.default_rng(5)
    corners = rng.normal(size=(40, 3, 3))
    corners[0, 2] = corners[0, 1]  # an edge
    corners[1] = corners[1, :1]  # a point
    weights = rng.dirichlet((0.5, 0.5, 0.5), size=4000)
    for x in rng.normal(size=(10, 3)):
        exact = reference.distances(corners, x)
        sampled = np.linalg.norm(np.einsum("sk,tkj->tsj", weights, corners) - x, axis=2)
        assert (exact <= sampled.min(axis=1) + 1e-12).all()
        assert (exact >= sampled.min(axis=1) - 0.1).all()


def test_every_installed_library_agrees_about_nearest_and_ball(bodies: queries.Bodies) -> None:
    held = queries.Holders(bodies, lambda _: None)
    every = range(len(bodies.points))
    asked = queries.nearest(bodies, held)
    assert {"vf: Surface.nearest"} == {peer.name for peer in asked if peer.ours}
    for peer in asked:
        answers = [peer.read(peer.ask(k)) for k in every]
        agrees, words = queries.check_near(bodies, answers, every)
        assert agrees, (peer.name, words)
    for radius in (1e-3, 5e-3):
        for peer in queries.ball(bodies, held, radius):
            answers = [peer.read(peer.ask(k)) for k in every]
            agrees, words = queries.check_ball(bodies, answers, every, radius)
            assert agrees, (peer.name, radius, words)


def test_wrong_answers_are_caught_and_not_timed(bodies: queries.Bodies) -> None:
    surface, points = bodies.surface, bodies.points
    right = Peer(
        "right", lambda k: surface.nearest(points[k]), lambda r: (r[0] * 1e3, r[1]), ours=True
    )
    far = replace(right, name="far", read=lambda r: (r[0] * 1e3 + 2e-3, r[1]), ours=False)
    other = replace(right, name="other", read=lambda r: (r[0] * 1e3, (r[1] + 5000) % 10_000))
    none = replace(right, name="none", read=lambda r: (r[0] * 1e3, -1))

    def check(answers: list, chosen: list[int]) -> tuple[bool, str]:
        return queries.check_near(bodies, answers, chosen)

    entries = {e["name"]: e for e in peers.compare([right, far, other, none], check, 30, 2)}
    assert entries["right"]["agrees"]
    assert entries["right"]["calls"] == 60
    for name in ("far", "other", "none"):
        assert not entries[name]["agrees"], name
        assert entries[name]["calls"] == 0

    every = list(range(30))
    sets = [np.sort(surface.within(x, 4e-3).triangles) for x in points]
    assert max(map(len, sets)) > 3
    assert queries.check_ball(bodies, sets, every, 4e-3)[0]
    assert not queries.check_ball(bodies, [s[1:] for s in sets], every, 4e-3)[0]
    strangers = [np.append(s, (s.max(initial=0) + 5000) % 10_000) for s in sets]
    assert not queries.check_ball(bodies, strangers, every, 4e-3)[0]


def test_planes_with_a_hole_are_caught(bodies: queries.Bodies) -> None:
    planes = [vf.certified_planes(bodies.surface, x, 5e-3) for x in bodies.points]
    every = list(range(len(planes)))
    assert peers._check_planes(bodies, planes, every, 5e-3)[0]
    holed = [
        replace(p, normals=p.normals[1:], offsets=p.offsets[1:]) if len(p) else p for p in planes
    ]
    assert not peers._check_planes(bodies, holed, every, 5e-3)[0]


def test_the_reference_qp_is_the_optimum_of_a_general_solver() -> None:
    rng = np.random.default_rng(6)
    for case in range(20):
        J, d = rng.normal(size=(6, 6)), rng.normal(size=6)
        G, b = rng.normal(size=(4, 6)), -rng.uniform(0.0, 0.5, 4)
        lower, upper = -rng.uniform(0.1, 1.0, 6), rng.uniform(0.1, 1.0, 6)
        dq = reference.least_squares(J, d, 1e-3, G, b, lower, upper)
        H, g = J.T @ J + 1e-3 * np.eye(6), J.T @ d
        peer = minimize(
            lambda x, H=H, g=g: 0.5 * x @ H @ x - g @ x,
            np.zeros(6),
            jac=lambda x, H=H, g=g: H @ x - g,
            bounds=list(zip(lower, upper, strict=True)),
            constraints={"type": "ineq", "fun": lambda x, G=G, b=b: G @ x - b},
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert (G @ dq >= b - 1e-9).all(), case
        assert (dq >= lower - 1e-9).all(), case
        assert (dq <= upper + 1e-9).all(), case
        assert 0.5 * dq @ H @ dq - g @ dq <= peer.fun + 1e-7, case


def test_every_installed_solver_agrees_and_a_wrong_one_is_caught(small: vf.Surface) -> None:
    arm = robots.load("psm")
    _, problems = peers._route_samples(small, arm, routes.plan(small, arm, spots=2), 12)
    assert problems
    every = list(range(len(problems)))
    for peer in solvers.peers(problems, {}):
        answers = [peer.read(peer.ask(k)) for k in every]
        agrees, words = solvers.check(problems, answers, every)
        assert agrees, (peer.name, words)
    still = [np.zeros(6) for _ in problems]
    assert not solvers.check(problems, still, every)[0]
    free = [np.linalg.solve(p.H, p.J.T @ p.d) for p in problems]
    assert not solvers.check(problems, free, every)[0]
    assert not solvers.check(problems, [np.full(6, np.nan)] * len(every), every)[0]


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
    assert "choose one of runtime, peers, loop" in capsys.readouterr().err
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


def test_delays_pair_each_drag_with_the_first_move_after_it() -> None:
    from app.bench.view import delays_of

    log = {
        "sent": [[100.0, 110.0], [500.0, 505.0], [900.0, 901.0], [1300.0, 1302.0]],
        "moved": [90.0, 140.0, 150.0, 560.0, 1310.0],  # the third drag moved nothing
        "drawn": [[90.0, 95.0], [140.0, 170.0], [150.0, 180.0], [560.0, 600.0]],  # nor the fourth's
    }
    assert delays_of(log).tolist() == [[10.0, 30.0, 70.0], [5.0, 55.0, 100.0]]
    with pytest.raises(ValueError, match="no drag moved the tool"):
        delays_of({"sent": [[1.0, 2.0]], "moved": [], "drawn": []})


def sampled(**series: list[float]) -> list[dict[str, float]]:
    """Samples of an uneventful soak, but for what is given."""
    calm = {"nodes": 40, "controls": 90, "messages": 900, "threads": 9, "clients": 1, "backlog": 3}
    return [
        {"memory [MB]": 500.0, **calm, **{name: values[k] for name, values in series.items()}}
        for k in range(60)
    ]


@pytest.mark.parametrize(
    ("name", "values", "word"),
    [
        ("memory [MB]", [500.0 + k for k in range(60)], "memory grew by"),
        ("nodes", [40 + k // 5 for k in range(60)], "nodes grew from"),
        ("messages", [900 + 5 * k for k in range(60)], "messages grew from"),
        ("threads", [9 + k // 6 for k in range(60)], "threads grew from"),
        ("backlog", [3] * 59 + [5000], "5,000 messages behind"),
        ("clients", [1] * 30 + [3] * 30, "3 clients"),
    ],
)
def test_a_soak_complains_of_what_grows(name: str, values: list[float], word: str) -> None:
    assert soak.complaints(sampled()) == []
    (complaint,) = soak.complaints(sampled(**{name: values}))
    assert word in complaint


def test_a_soak_forgives_a_warm_up_and_a_spike() -> None:
    warming = [300.0 + 20 * min(k, 10) for k in range(60)]
    warming[40] = 900.0
    assert soak.complaints(sampled(**{"memory [MB]": warming})) == []


def test_a_drag_is_measured_in_a_window_as_people_have_one_and_says_in_which() -> None:
    from rich.console import Console

    from app.bench import view
    from app.bench.tools.watcher import WINDOW

    assert (WINDOW["width"], WINDOW["height"], view.RATIO) == (1440, 900, 1.0)
    opened: list[dict[str, Any]] = []

    class Browser:
        def new_page(self, **properties: Any) -> Any:
            opened.append(properties)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        view._serve_requests(Browser(), "http://127.0.0.1:1")
    assert opened == [{"viewport": WINDOW, "device_scale_factor": 1.0}]
    loop = {"rate [Hz]": 1000.0, "punctual": 0.999, "late [us]": {"p99": 50.0}}
    result = {
        "what": "vf-sandbox bench view",
        "triangles": 1000,
        "drags": 12,
        **dict.fromkeys(
            (
                "input to message [ms]",
                "message to moved tool [ms]",
                "input to moved tool [ms]",
                "input to picture [ms]",
            ),
            (10.0, 20.0),
        ),
        "updates/s": 20.0,
        "pictures/s": 7.5,
        "window": {
            **WINDOW,
            "ratio": 1.0,
            "canvas": [597, 675],
            "css": [797, 900],
            "renderer": "ANGLE (SwiftShader)",
            "smoothed": False,
            "pictures": 99,
        },
        "loop while dragging": loop,
        "loop on autopilot": loop,
    }
    console = Console(record=True, width=80, force_terminal=False)
    view.show(result, console)
    said = console.export_text()
    for words in ("7.5 pictures/s", "1440 × 900 at 1", "597 × 675 pixels", "not smoothed"):
        assert words in said
    assert "ANGLE (SwiftShader)" in said
