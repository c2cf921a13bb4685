"""Figures of reports by matplotlib, as SVG that stands in a page of HTML."""

from __future__ import annotations

import io
from typing import Any


def axes(
    layout: tuple[int, int] | int, size: tuple[float, float], **options: Any
) -> tuple[Any, Any]:
    """A figure and its axes, row by row.

    Args:
        layout: numbers of rows and columns, or of rows.
        size: width and height [inch].
        options: of `matplotlib.figure.Figure.subplots`.

    Raises:
        ImportError: matplotlib is not installed.
    """
    # Without pyplot, which has global state and needs a window system.
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasSVG(figure)
    rows, columns = layout if isinstance(layout, tuple) else (layout, 1)
    found = figure.subplots(rows, columns, squeeze=False, **options).ravel()
    for ax in found:
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(labelsize=8)
    return figure, found


def svg(figure: Any) -> str:
    """A figure as an element of HTML."""
    out = io.StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    text = out.getvalue()
    return text[text.index("<svg") :]
