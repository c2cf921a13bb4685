"""The figures of the report, drawn by matplotlib: beside the paper's Figures 10, 11 and 12."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.studies.experiments.protocol import Outcome
from app.studies.experiments.site import THICKNESS
from app.studies.results import analysis, drawing

COLORS = {False: "#0072b2", True: "#d55e00"}  # Okabe and Ito: off, assisted
NAMES = {False: "teleoperation", True: "with the fixture"}


def section(outcomes: Sequence[Outcome]) -> str:
    """Figure 10: the tip's path over the skull's cross-section along the cut, as SVG."""
    figure, axes = drawing.axes(2, (9.0, 5.2), sharex=True)
    for ax, side in zip(axes, analysis.split(outcomes), strict=True):
        for outcome in side:
            s, _, h, _ = 1e3 * outcome.trajectory.T
            ax.plot(s, h, lw=0.6, color=COLORS[outcome.trial.assisted], alpha=0.8)
        length = max((o.stations[-1] for o in outcomes), default=0.03) * 1e3
        ax.fill_between([0, length], -1e3 * THICKNESS, 0.0, color="#dececb", zorder=0)
        ax.axhline(-1e3 * THICKNESS, color="#555", lw=0.8)
        ax.set_ylim(-4.2, 1.4)
        ax.set_ylabel("height over the bone [mm]")
        if side:
            ax.set_title(NAMES[side[0].trial.assisted], fontsize=10)
    axes[-1].set_xlabel("along the cut [mm]; bone shaded, below it what must be spared")
    return drawing.svg(figure)


def top(outcomes: Sequence[Outcome], width: float) -> str:
    """Figure 11: the cuts from above, as SVG. `width` of the corridor [m]."""
    figure, axes = drawing.axes(2, (9.0, 4.4), sharex=True)
    for ax, side in zip(axes, analysis.split(outcomes), strict=True):
        for outcome in side:
            s, middle = 1e3 * outcome.stations, 1e3 * outcome.deviation
            ax.fill_between(s, middle - 0.3, middle + 0.3, alpha=0.25, lw=0,
                            color=COLORS[outcome.trial.assisted])  # fmt: skip
            ax.plot(s, middle, lw=1.2, color=COLORS[outcome.trial.assisted])
        ax.axhline(0.0, color="#333", lw=0.8, ls="--")
        for edge in (-1e3 * width, 1e3 * width):
            ax.axhline(edge, color="#999", lw=0.8, ls=":")
        ax.set_ylim(-2.0, 2.0)
        ax.set_ylabel("aside [mm]")
        if side:
            ax.set_title(NAMES[side[0].trial.assisted], fontsize=10)
    axes[-1].set_xlabel("along the cut [mm]; dashed: the plan, dotted: the corridor")
    return drawing.svg(figure)


def boxes(outcomes: Sequence[Outcome]) -> str:
    """Figure 12: box plots of path deviation and penetration at the stations, as SVG."""
    figure, axes = drawing.axes((1, 2), (9.0, 3.8))
    off, on = analysis.split(outcomes)
    for ax, values, title in (
        (axes[0], [analysis.deviations(side) for side in (off, on)], "|cutting-path deviation|"),
        (axes[1], [analysis.penetrations(side, signed=True) for side in (off, on)],
         "penetration depth, signed"),
    ):  # fmt: skip
        drawn = ax.boxplot(values, widths=0.5, patch_artist=True, showmeans=True)
        for box, assisted in zip(drawn["boxes"], (False, True), strict=True):
            box.set_facecolor(COLORS[assisted])
            box.set_alpha(0.45)
        ax.set_xticks([1, 2], [NAMES[False], NAMES[True]])
        ax.set_title(title, fontsize=10)
        ax.set_ylabel("[mm]")
    axes[1].axhline(0.0, color="#555", lw=0.8)
    return drawing.svg(figure)


def pairs(without: Sequence[Outcome], with_margins: Sequence[Outcome]) -> str:
    """Deepest point and path deviation of each cut, without and with margins, joined; as SVG."""
    figure, axes = drawing.axes((1, 2), (9.0, 3.8))
    for ax, values, title in (
        (axes[0], lambda o: 1e3 * o.deepest, "deepest point beyond the true inner surface"),
        (axes[1], lambda o: analysis.deviations([o]).mean(), "|cutting-path deviation|"),
    ):
        for before, after in zip(without, with_margins, strict=True):
            ax.plot([1, 2], [values(before), values(after)], lw=0.7, marker="o", ms=3,
                    color=COLORS[True], alpha=0.6)  # fmt: skip
        ax.set_xticks([1, 2], ["without margins", "with margins"])
        ax.set_xlim(0.6, 2.4)
        ax.set_title(title, fontsize=10)
        ax.set_ylabel("[mm]")
    axes[0].axhline(0.0, color="#555", lw=0.8)
    return drawing.svg(figure)


def speeds(outcomes: Sequence[Outcome]) -> str:
    """Spectra of the tip's speed, whose arc length is the smoothness, as SVG."""
    figure, axes = drawing.axes(1, (9.0, 3.4))
    for outcome in outcomes:
        points, time = outcome.trajectory[:, :3], outcome.trajectory[:, 3]
        rate = 1.0 / (time[1] - time[0])
        speed = np.linalg.norm(np.diff(points, axis=0), axis=1) * rate
        spectrum = np.abs(np.fft.rfft(speed))
        f = np.fft.rfftfreq(len(speed), 1.0 / rate)
        shown = f <= 20.0
        axes[0].semilogy(f[shown], spectrum[shown] / spectrum[0], lw=0.5, alpha=0.6,
                         color=COLORS[outcome.trial.assisted])  # fmt: skip
    axes[0].set_ylim(1e-4, 1.5)
    axes[0].set_xlabel("frequency [Hz]")
    axes[0].set_ylabel("|V(f)| / |V(0)|")
    return drawing.svg(figure)
