"""The heading of printed results, and the figure of `bench runtime`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from app.words import format_length


def header(result: dict[str, Any], console: Console) -> None:
    """Print title and machine."""
    about = result["machine"]
    load = about["load before"]
    console.print(f"[bold]{result['what']}[/]")
    if "source" in result:
        console.print(f"shape: {result['source']}")
    console.print(
        f"machine: {about['processor']}, {about['cores']} cores, {about['system']}, "
        f"Python {about['python']}" + (f", load {load:.1f} before" if load is not None else "")
    )


def figure(result: dict[str, Any], file: Path) -> None:
    """Rate over triangles, both logarithmic, as the paper's Figure 7.

    Raises:
        ImportError: matplotlib is not installed.
    """
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    rows = result["rows"]
    rules = list(dict.fromkeys(row["rule"] for row in rows))
    radii = list(dict.fromkeys(row["radius [m]"] for row in rows))
    markers = "osD^vP"
    colours = ["#0072b2", "#d55e00", "#009e73", "#cc79a7"]
    plot, axes = pyplot.subplots(figsize=(8.0, 5.5), dpi=150)
    for i, rule in enumerate(rules):
        for k, radius in enumerate(radii):
            line = [row for row in rows if row["rule"] == rule and row["radius [m]"] == radius]
            sizes = [row["triangles"] for row in line]
            axes.plot(
                sizes,
                [row["rate [kHz]"] for row in line],
                marker=markers[k % len(markers)],
                color=colours[i % len(colours)],
                alpha=1.0 - 0.14 * k,
                label=f"{rule}, r = {format_length(radius)}",
            )
            if k == 0:  # one band per rule shows the spread
                slow = [1e3 / row["tick [us]"]["p99"] for row in line]
                fast = [1e3 / row["tick [us]"]["p1"] for row in line]
                axes.fill_between(sizes, slow, fast, color=colours[i % len(colours)], alpha=0.12)
    points: Sequence[dict[str, float]] = result["published"]["points"]
    axes.plot(
        [p["triangles"] for p in points],
        [p["rate [kHz]"] for p in points],
        "kx--",
        label="published (C++, i7-8700), other hardware",
    )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("triangles")
    axes.set_ylabel("rate of whole ticks [kHz], median")
    axes.set_title(f"PSM, {result['source']}", fontsize=9)
    axes.grid(which="both", alpha=0.25)
    axes.legend(fontsize=7, ncols=2)
    plot.tight_layout()
    plot.savefig(file)
    pyplot.close(plot)
