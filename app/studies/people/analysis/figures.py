"""Figures of a study's report, as SVG."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from app.studies.people.analysis.contrasts import Contrast
from app.studies.people.analysis.data import Data
from app.studies.people.analysis.learning import Curve
from app.studies.people.analysis.quantities import MEASURES, SCALES, WORKLOAD, Quantity
from app.studies.results import drawing

# Okabe and Ito, without yellow.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
GREY, INK = "#b8b8b8", "#333333"
WIDE = 9.0  # of a figure [inch]
COLUMNS = 4


def colour(conditions: Sequence[str], name: str) -> str:
    return COLOURS[conditions.index(name) % len(COLOURS)]


def people(data: Data, task: str) -> str:
    """Each participant's mean under each condition, joined by lines, for all measures of a task."""
    drawn = [(q, m) for q in MEASURES if (m := data.means(task, q.name))]
    figure, axes = _grid(len(drawn))
    for ax, (quantity, means) in zip(axes, drawn, strict=False):
        _lines(ax, means, data.conditions, quantity)
        ax.set_title(quantity.titled, fontsize=9)
    return drawing.svg(figure)


def workload(data: Data) -> str:
    """The six ratings by condition: mean and standard deviation of the participants."""
    figure, axes = drawing.axes(1, (WIDE, 3.2))
    ax, width = axes[0], 0.7 / len(data.conditions)
    for k, condition in enumerate(data.conditions):
        places, middle, spread = [], [], []
        for j, scale in enumerate(SCALES):
            values = [
                one[condition] for one in data.means(WORKLOAD, scale).values() if condition in one
            ]
            if values:
                places.append(j + (k - 0.5 * (len(data.conditions) - 1)) * width)
                middle.append(float(np.mean(values)))
                spread.append(float(np.std(values, ddof=1)) if len(values) > 1 else 0.0)
        ax.bar(places, middle, 0.9 * width, yerr=spread, color=colour(data.conditions, condition),
               alpha=0.8, label=condition, error_kw={"lw": 0.8, "ecolor": INK})  # fmt: skip
    ax.set_xticks(range(len(SCALES)), SCALES)
    ax.set_ylim(0.0, 100.0)
    ax.set_ylabel("rating, 0 to 100")
    ax.legend(fontsize=8, frameon=False, ncols=len(data.conditions), loc="upper right")
    return drawing.svg(figure)


def forest(contrasts: Sequence[Contrast]) -> str:
    """Effect sizes with their intervals; filled where there is a difference after correction."""
    shown = [one for one in contrasts if one.comparison is not None]
    figure, axes = drawing.axes(1, (WIDE, 0.9 + 0.24 * max(len(shown), 1)))
    ax = axes[0]
    ax.axvline(0.0, color=INK, lw=0.8)
    for k, one in enumerate(shown):
        c = one.comparison
        assert c is not None
        ends = np.clip([c.effect_low, c.effect_high], -_REACH, _REACH)
        ink = COLOURS[0] if one.significant else "#777777"
        ax.plot(ends, [k, k], color=ink, lw=1.4, solid_capstyle="butt")
        ax.plot(np.clip(c.effect, -_REACH, _REACH), k, "o", ms=5, color=ink,
                mfc=ink if one.significant else "white")  # fmt: skip
    ax.set_yticks(
        range(len(shown)),
        [f"{one.task}, {one.quantity.label}: {one.second} − {one.first}" for one in shown],
    )
    ax.tick_params(axis="y", labelsize=7)
    ax.set_ylim(len(shown) - 0.4, -0.6)
    ax.set_xlabel("effect size d_z with its 95 % interval")
    ax.grid(axis="x", lw=0.4, color="#dddddd")
    return drawing.svg(figure)


_REACH = 6.0  # of the axis of effects


def learning(curves: Sequence[Curve]) -> str:
    """The measures of a task over the number of the trial, conditions evened out."""
    shown = [one for one in curves if len(one.number) > 1]
    figure, axes = _grid(len(shown))
    for ax, one in zip(axes, shown, strict=False):
        scale, ink = one.quantity.scale, COLOURS[0] if one.significant else "#777777"
        ax.fill_between(one.number, scale * one.low, scale * one.high, color=ink, alpha=0.2, lw=0)
        ax.plot(one.number, scale * one.mean, color=ink, lw=1.4, marker="o", ms=3)
        ax.set_title(one.quantity.titled, fontsize=9)
        ax.set_xlabel("trial of the task", fontsize=8)
        ax.xaxis.get_major_locator().set_params(integer=True)
    return drawing.svg(figure)


def _grid(count: int):  # type: ignore[no-untyped-def]
    """Axes for as many drawings, `COLUMNS` in a row; those left over are hidden."""
    columns = min(COLUMNS, max(count, 1))
    rows = math.ceil(max(count, 1) / columns)
    figure, axes = drawing.axes((rows, columns), (WIDE, 2.4 * rows))
    for ax in axes[count:]:
        ax.set_visible(False)
    return figure, axes


def _lines(  # type: ignore[no-untyped-def]
    ax, means: Mapping[str, Mapping[str, float]], conditions: Sequence[str], quantity: Quantity
) -> None:
    for one in means.values():
        places = [k for k, name in enumerate(conditions) if name in one]
        ax.plot(places, [quantity.scale * one[conditions[k]] for k in places], color=GREY,
                lw=0.7, marker=".", ms=3)  # fmt: skip
    for k, name in enumerate(conditions):
        values = [quantity.scale * one[name] for one in means.values() if name in one]
        if values:
            ax.plot([k - 0.22, k + 0.22], [float(np.mean(values))] * 2,
                    color=colour(conditions, name), lw=3)  # fmt: skip
    ax.set_xticks(range(len(conditions)), conditions, fontsize=7)
    if len(conditions) > 2 or max(map(len, conditions)) > 12:
        ax.tick_params(axis="x", rotation=25)
    ax.set_xlim(-0.5, len(conditions) - 0.5)
