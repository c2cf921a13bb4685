"""Tab "Signals": plots of the last twenty seconds, and the trail of the tool's tip.

Samples are taken while a client is connected, also while the plots are off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.control.messages import Telemetry
from app.scene.moment import Moment, Placed
from app.scene.scene import Scene
from app.settings import Options
from app.view import palette
from app.view.context import PageContext
from app.view.drawing import trail
from app.view.part import Clients, Part
from app.view.tabs.depth import nearest_of, signed_distance

FloatArray = NDArray[np.float64]

SPAN = 20.0  # of the plots [s]
PERIOD = 0.1  # between two samples [s]
PLOT_PERIOD = 0.5  # between two updates: a browser redraws all plots [s]
LENGTH = round(SPAN / PERIOD)

WHEN_OFF, ALWAYS, NEVER = "when rule is off", "always", "never"


@dataclass(frozen=True)
class Curve:
    """One curve of a plot."""

    name: str
    color: palette.Rgb


@dataclass(frozen=True)
class Plot:
    """One plot: title with unit, curves, and the least upper end of its y axis."""

    title: str
    curves: tuple[Curve, ...]
    least: float


PLOTS = (
    Plot("Tip to surface [mm], inside < 0", (Curve("distance", palette.BLUE),), 1.0),
    Plot("Proxy to tool [mm]", (Curve("error", palette.PROXY),), 1.0),
    Plot(f"{palette.FORCE_NAME.capitalize()} [N]", (Curve("force", palette.FORCE),), 1.0),
    Plot(
        "Planes",
        tuple(
            Curve(palette.LOOKS[rule].name.split(",")[0], palette.LOOKS[rule].color)
            for rule in palette.CONDITIONS
        ),
        4.0,
    ),
    Plot(
        "Structure moved, at the tip [mm]",
        (Curve("true", palette.BLUE), Curve("believed", palette.ORANGE)),
        1.0,
    ),
    Plot(
        "Tick, median and worst [µs]",
        (Curve("median", palette.BLUE), Curve("worst", palette.ORANGE)),
        100.0,
    ),
)
MOTION = 4
"""Number of the plot that is there only where structures move."""
CURVES = sum(len(plot.curves) for plot in PLOTS)


def sample(telemetry: Telemetry, structures: Sequence[Placed]) -> FloatArray | None:
    """One value per curve, in the order and units of `PLOTS`; None before the first tick."""
    step, stats = telemetry.step, telemetry.stats
    if step is None:
        return None
    p_tip = np.array(step.tip.translation)
    gap = 0.0 if telemetry.target is None else np.linalg.norm(telemetry.target.translation - p_tip)
    return np.array(
        [
            _depth(structures, p_tip) * 1e3,
            gap * 1e3,
            np.linalg.norm(step.force),
            *(int((step.planes.rules == rule).sum()) for rule in palette.CONDITIONS),
            *(1e3 * length for length in _moved(structures, p_tip)),
            stats.tick_median * 1e6,
            stats.tick_worst * 1e6,
        ]
    )


def _depth(structures: Sequence[Placed], p_tip: FloatArray) -> float:
    """Distance from the tip to the nearest structure where it truly is [m]; inside: negative."""
    nearest = nearest_of(structures, p_tip)
    return signed_distance(nearest.surface, nearest.seen(p_tip))


def _moved(structures: Sequence[Placed], p_tip: FloatArray) -> tuple[float, float]:
    """How far from rest the nearest structure that moves is at the tip [m]: truly, and believed."""
    moving = [one for one in structures if one.pose is not None]
    if not moving:
        return 0.0, 0.0
    nearest = nearest_of(moving, p_tip)
    resting = nearest.seen(p_tip)
    assert nearest.believed is not None
    believed = nearest.believed.act(resting)
    return float(np.linalg.norm(p_tip - resting)), float(np.linalg.norm(believed - resting))


class History:
    """The samples of the last `SPAN` seconds of simulated time."""

    def __init__(self) -> None:
        self._times = np.zeros(LENGTH)
        self._values = np.zeros((LENGTH, CURVES))
        self._count = 0

    def add(self, time: float, values: FloatArray) -> None:
        """Append values (`CURVES`,) at a time [s]; one that is not later clears the history."""
        if self._count and time <= self._times[self._count - 1]:
            self.clear()
        if self._count == LENGTH:
            self._times[:-1] = self._times[1:]
            self._values[:-1] = self._values[1:]
            self._count -= 1
        self._times[self._count] = time
        self._values[self._count] = values
        self._count += 1

    def clear(self) -> None:
        """Remove all samples."""
        self._count = 0

    def shown(self) -> tuple[FloatArray, FloatArray]:
        """Times (n,) relative to the newest sample, −`SPAN` to 0 [s], and values (n, `CURVES`)."""
        if self._count == 0:
            return np.zeros(1), np.zeros((1, CURVES))
        times = self._times[: self._count] - self._times[self._count - 1]
        recent = times >= -SPAN
        return times[recent], self._values[: self._count][recent]


class Signals(Part):
    """The tab; switched off, it sends nothing."""

    def __init__(self, context: PageContext) -> None:
        gui = context.server.gui
        self._source = context.source
        self._history = History()
        self._trail = trail.Trail(context.server.scene)
        self._cleared = False
        self._due = True  # draw in the next frame
        self._scene: Scene = context.session.scene
        self._session: tuple[History, trail.Path, Scene] | None = None  # kept during a replay
        self._sample_time = -math.inf  # simulated time of the newest sample [s]
        self._plot_time = 0.0  # simulated time of the last plot [s]
        self._trail_time = 0.0  # simulated time of the trail's newest point [s]
        with context.left.add_tab("Signals"):
            self._on = gui.add_checkbox(
                "Plot", True, hint="Off, the plots stand still; what they miss is kept for later."
            )
            self._plots = [self._add(gui, plot, plot is PLOTS[-1]) for plot in PLOTS]
            moves = self._scene.moves
            self._plots[MOTION].visible = moves
            self._mode = gui.add_dropdown(
                "Trail",
                (WHEN_OFF, ALWAYS, NEVER),
                initial_value=WHEN_OFF,
                hint="Paint the path of the tool’s tip into the scene, coloured by its depth.",
            )
            clear = gui.add_button("Clear trail and plots", color="gray")
            gui.add_html(trail.legend())

        @clear.on_click
        async def _clear(_event: Any) -> None:
            self._cleared = True

        @self._on.on_update
        async def _switch(_event: Any) -> None:
            self._due = True

    def set_scene(self, scene: Scene) -> None:
        self._swap_history()
        if scene.version == self._scene.version:
            return
        self._scene = scene
        self._plots[MOTION].visible = scene.moves
        self._clear_all()

    def frame(self, shown: Moment, clients: Clients) -> None:
        telemetry = shown.telemetry
        self._swap_history()
        if self._cleared:
            self._cleared = False
            self._clear_all()
        if telemetry.scene != self._scene.version or telemetry.step is None:
            return
        if telemetry.time < self._sample_time:  # a replay moved backwards
            self._history.clear()
            self._trail.path.break_line()
            self._restart()
        around = shown.guarded or shown.structures[:1]
        self._extend_trail(telemetry, shown.options, around)
        if not 0.0 <= telemetry.time - self._sample_time < PERIOD:
            self._sample_time = telemetry.time
            values = sample(telemetry, around)
            if values is not None:
                self._history.add(telemetry.time, values)
                self._due |= not 0.0 <= telemetry.time - self._plot_time < PLOT_PERIOD
        if self._due and self._on.value:
            self._due = False
            self._plot_time = telemetry.time
            self._draw()

    def _swap_history(self) -> None:
        """Give a replay its own history, and restore the session's after it."""
        if self._source.live == (self._session is None):
            return
        if self._session is None:
            self._session = self._history, self._trail.path, self._scene
            self._history, self._trail.path = History(), trail.Path()
        else:
            self._history, self._trail.path, self._scene = self._session
            self._session = None
        self._trail.draw()
        self._restart()

    def _restart(self) -> None:
        """Sample and draw in the next frame: the simulated time has jumped."""
        self._sample_time = self._plot_time = self._trail_time = -math.inf
        self._due = True

    def _extend_trail(
        self, telemetry: Telemetry, options: Options, around: Sequence[Placed]
    ) -> None:
        mode = self._mode.value
        if mode == NEVER or (mode == WHEN_OFF and options.rule != "off"):
            self._trail.path.break_line()
            return
        if 0.0 <= telemetry.time - self._trail_time < 0.5 * PERIOD:
            return
        self._trail_time = telemetry.time
        assert telemetry.step is not None
        p_tip = np.array(telemetry.step.tip.translation)
        if self._trail.path.add(p_tip, _depth(around, p_tip)):
            self._trail.draw()

    def _clear_all(self) -> None:
        self._history.clear()
        self._trail.path.clear()
        self._trail.draw()
        self._restart()

    def _draw(self) -> None:
        times, values = self._history.shown()
        column = 0
        for plot, node in zip(PLOTS, self._plots, strict=True):
            n = len(plot.curves)
            node.data = (times, *(values[:, column + k].copy() for k in range(n)))
            column += n

    def _add(self, gui: Any, plot: Plot, last: bool) -> Any:
        small = "10px sans-serif"
        return gui.add_uplot(
            data=(np.array([-SPAN, 0.0]), *(np.zeros(2) for _ in plot.curves)),
            series=(
                {"label": "s"},
                *(
                    {"label": c.name, "stroke": palette.css(c.color), "width": 1.5}
                    for c in plot.curves
                ),
            ),
            title=plot.title,
            scales={
                "x": {"time": False, "auto": False, "range": (-SPAN, 0.0)},
                "y": {
                    "range": {
                        "min": {"pad": 0.1, "soft": 0.0, "mode": 1},
                        "max": {"pad": 0.1, "soft": plot.least, "mode": 1},
                    }
                },
            },
            axes=(
                {
                    "show": last,
                    "size": 22,
                    "font": small,
                    "gap": 2,
                    "label": "before now [s]",
                    "labelSize": 14,
                    "labelFont": small,
                    "labelGap": 0,
                },
                {"size": 42, "font": small, "gap": 2},
            ),
            legend={"show": len(plot.curves) > 1, "live": False},
            cursor={"show": False},
            height=100 if last else 66,
            padding=(4, 8, 4, 0),
        )
