"""Prints results as tables and draws the figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from app.console import Column, show_table
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


def runtime(result: dict[str, Any], console: Console) -> None:
    """Tables of `bench runtime`."""
    header(result, console)
    for build in result["builds"]:
        stages = ", ".join(f"{name} {t:.2f}" for name, t in build["stages [s]"].items())
        console.print(
            f"surface of {build['triangles']:,}: {build['total [s]']:.2f} s ({stages}), "
            f"inside test {build['inside test [s]']:.2f} s, arrays {build['arrays [MB]']:.0f} MB"
        )
    rows = result["rows"]
    parts = [name for name in rows[0]["parts [us]"] if name != "rest"]
    names = ("rule", "r", "triangles", "in ball", "planes", "kHz", "p1", "median", "p99")
    cells = []
    for row in rows:
        tick, split = row["tick [us]"], row["parts [us]"]
        listed = f"{row['stages [us]']['list of the ball']:.0f}" if row["rule"] == "paper" else "–"
        cells.append(
            (
                row["rule"],
                format_length(row["radius [m]"]),
                f"{row['triangles']:,}",
                f"{row['in the ball']:,.0f}",
                f"{row['planes']['mean']:,.1f}",
                f"{row['rate [kHz]']:.2f}",
                *(f"{tick[key]:.0f}" for key in ("p1", "median", "p99")),
                *(f"{split[name]:.1f}" for name in parts),
                f"{split['rest']:.1f}",
                listed,
            )
        )
    show_table(
        console,
        [Column(name, left=name == "rule") for name in (*names, *parts, "rest", "list")],
        cells,
        labels=3,
        title="One tick of the PSM, medians in µs. The planes column of the certified rule is one "
        "tree walk that finds and chooses them; 'list' is the sphere query that the paper's rule "
        "starts with, timed on its own and part of its planes column.",
    )
    states = []
    for row in rows:
        shares = (
            f"{100 * state['share']:.0f} %"
            + (f" {state['tick [us]']:.0f}" if state["tick [us]"] is not None else "")
            for state in row["states"].values()
        )
        states.append(
            (row["rule"], format_length(row["radius [m]"]), f"{row['triangles']:,}", *shares)
        )
    show_table(
        console,
        [
            Column(name, left=name == "rule")
            for name in ("rule", "r", "triangles", *rows[0]["states"])
        ],
        states,
        labels=3,
        title="The same by contact state: share of the ticks, median in µs",
    )
    floor = result["floor [us]"]
    console.print(
        f"a tick that meets nothing: {floor['median']:.1f} µs "
        f"(p1 {floor['p1']:.1f}, p99 {floor['p99']:.0f})"
    )
    for ratio in result["ratios"]:
        bare = ratio.get("without inside test")
        console.print(
            f"{ratio['what']}, r = {format_length(ratio['radius [m]'])}: {ratio['ratio']:.2f}"
            + (f" ({bare:.2f} without the inside test)" if bare is not None else "")
        )


def peers(result: dict[str, Any], console: Console) -> None:
    """Tables of `bench peers`."""
    header(result, console)
    for task in result["tasks"]:
        rows = []
        for entry in task["entries"]:
            good = entry["agrees"]
            rows.append(
                (
                    escape(entry["name"]),
                    *(f"{entry['us'][k]:.1f}" if good else "–" for k in ("median", "p99")),
                    f"{entry['ratio']:.2f}" if good else "–",
                    escape(entry["check"]) if good else f"[red]wrong: {escape(entry['check'])}[/]",
                    escape(entry["note"]),
                )
            )
        show_table(
            console,
            [
                Column("library", left=True),
                Column("median [µs]"),
                Column("p99 [µs]"),
                Column("× ours"),
                Column("answers", left=True),
                Column("note", left=True),
            ],
            rows,
            title=task["what"],
        )
    for name, why in result["missing"].items():
        console.print(f"not compared: {name} ({why})")


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
