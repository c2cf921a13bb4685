"""Plots of the tab "Signals", and the trail."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
import trimesh

import vf
from app.control.messages import LoopStats, Telemetry
from app.scene.moment import Moment, Placed
from app.settings import Options
from app.view import palette
from app.view.drawing import trail
from app.view.tabs import signals
from app.view.tabs.depth import signed_distance


def test_signed_distance_is_negative_inside_only() -> None:
    solid = trimesh.creation.icosphere(subdivisions=3, radius=0.01)
    surface = vf.Surface.from_arrays(solid.vertices, solid.faces)
    assert signed_distance(surface, [0.0, 0.0, 0.012]) == pytest.approx(0.002, abs=1e-4)
    assert signed_distance(surface, [0.0, 0.0, 0.007]) == pytest.approx(-0.003, abs=2e-4)
    sheet = vf.Surface.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    assert signed_distance(sheet, [0.1, 0.1, -0.2]) == pytest.approx(0.2)


@pytest.fixture(scope="module")
def surface() -> vf.Surface:
    from app.scene import scene

    return scene.build(Options(mesh="sphere", robot="point"), 1).surface


def test_a_sample_has_the_ticks_values_in_the_plots_units(
    telemetry: list[Telemetry], surface: vf.Surface
) -> None:
    around = [Placed(Options().anatomy[0], surface)]
    assert signals.sample(replace(telemetry[0], step=None), around) is None
    last = replace(telemetry[-1], stats=LoopStats(tick_median=40e-6, tick_worst=90e-6))
    values = signals.sample(last, around)
    assert values is not None
    p = last.step.tip.translation
    true = trimesh.proximity.signed_distance(
        trimesh.Trimesh(surface.vertices * 1e3, surface.faces, process=False), [p * 1e3]
    )[0]
    assert true > 1.0, "trimesh counts the inside as positive; the tool must have gone in"
    assert values[0] == pytest.approx(-true, abs=1e-6)
    assert values[1] == pytest.approx(1e3 * np.linalg.norm(last.target.translation - p))
    assert values[2] == pytest.approx(np.linalg.norm(last.step.force))
    assert (values[3:6] == 0.0).all()
    assert values[6:] == pytest.approx([0.0, 0.0, 40.0, 90.0])
    assert len(values) == signals.CURVES


def test_an_earlier_time_clears_the_history() -> None:
    history = signals.History()
    for time in (1.0, 1.1, 1.2, 0.5):
        history.add(time, np.full(signals.CURVES, time))
    times, values = history.shown()
    assert times.tolist() == [0.0]
    assert (values == 0.5).all()


def test_plots_are_sampled_while_off_and_drawn_when_switched_on(
    telemetry: list[Telemetry],
) -> None:
    from app.scene import scene

    options = Options(mesh="sphere", robot="point")
    sphere = scene.build(options, 1, warm=False)
    context: Any = MagicMock()
    context.source.live = True
    tab = signals.Signals(context)
    tab.set_scene(sphere)
    tab._on.value = False

    def frame(shot: Telemetry) -> None:
        tab.frame(Moment(sphere, options, shot, clutched=False), {})

    for shot in telemetry:
        frame(shot)
    times, _ = tab._history.shown()
    assert len(times) == 2, "150 ms at a sample each 100 ms"
    plots = [SimpleNamespace(data=None) for _ in signals.PLOTS]
    tab._plots = plots
    frame(telemetry[-1])
    assert plots[0].data is None, "switched off, nothing is sent"
    tab._on.value = True
    switched = tab._on.on_update.call_args.args[0]
    asyncio.run(switched(None))
    frame(telemetry[-1])  # of a paused loop: no new tick
    assert all(len(plot.data[0]) == 2 for plot in plots), "drawn at once, with the earlier samples"
    context.source.live = False  # a replay begins
    frame(telemetry[0])
    assert len(tab._history.shown()[0]) == 1


def test_plots_of_several_curves_have_a_legend() -> None:
    stage: Any = MagicMock()
    signals.Signals(stage)
    added = stage.server.gui.add_uplot.call_args_list
    assert len(added) == len(signals.PLOTS)
    for call, plot in zip(added, signals.PLOTS, strict=True):
        assert call.kwargs["legend"]["show"] == (len(plot.curves) > 1)
        assert [s["label"] for s in call.kwargs["series"][1:]] == [c.name for c in plot.curves]


def test_the_plots_scroll_over_the_last_twenty_seconds() -> None:
    history = signals.History()
    times, values = history.shown()
    assert len(times) == 1
    assert (values == 0.0).all()
    for k in range(3 * signals.LENGTH):
        history.add(k * signals.PERIOD, np.full(signals.CURVES, float(k)))
    times, values = history.shown()
    assert times[-1] == 0.0
    assert -signals.SPAN <= times[0] < -0.95 * signals.SPAN
    assert (np.diff(times) > 0.0).all()
    assert values[-1, 0] == 3 * signals.LENGTH - 1
    history.add(3 * signals.LENGTH * signals.PERIOD + 15.0, np.zeros(signals.CURVES))
    times, _ = history.shown()
    assert times[0] >= -signals.SPAN, "a gap in time counts for the span"
    history.clear()
    assert len(history.shown()[0]) == 1


def test_the_trail_is_bounded_skips_jumps_and_keeps_the_newest() -> None:
    path = trail.Path()
    for k in range(2 * trail.LENGTH):
        path.add(np.array([k * 1e-3, 0.0, 0.0]), -k * 1e-6)
    assert path.count == trail.LENGTH
    assert path.segments[-1, 1, 0] == pytest.approx((2 * trail.LENGTH - 1) * 1e-3)
    np.testing.assert_allclose(path.segments[1:, 0], path.segments[:-1, 1])
    last = path.segments[-1, 1].copy()
    ahead = np.array([1.0, 0.0, 0.0])
    assert not path.add(last + 0.1 * trail.MIN_STEP * ahead, 0.0), "less than the shortest segment"
    assert not path.add(last + 2.0 * trail.MAX_STEP * ahead, 0.0), "a reset"
    assert path.add(last + (2.0 * trail.MAX_STEP + 1e-3) * ahead, 0.0)
    assert np.linalg.norm(np.diff(path.segments[-1], axis=0)) == pytest.approx(1e-3)
    path.break_line()
    assert not path.add(last, 0.0)
    path.clear()
    assert path.count == 0


def test_the_trail_is_darker_with_depth_and_has_another_colour_outside() -> None:
    depths = np.linspace(0.0, 2.0 * trail.MAX_DEPTH, 9)
    shades = trail.colors(-depths[1:]).astype(float)
    lightness = shades @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(lightness[:4]) < -10.0).all()
    assert (np.diff(lightness[4:]) == 0.0).all(), "no darker than the darkest"
    outside = trail.colors(np.array([0.0, 1e-3]))
    assert (outside == palette.SKY).all()
