"""Ratios of the rows of `bench runtime`."""

from __future__ import annotations

from typing import Any


def ratios(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Ratios of rates: largest to smallest mesh, and certified to paper's rule.

    `without inside test` subtracts that test's time from the tick of the paper's rule: the paper
    does not have it, and only a rule without the guarantee needs it in every tick.
    """
    result: list[dict[str, Any]] = []
    table = {(row["rule"], row["radius [m]"], row["triangles"]): row for row in rows}
    sizes = sorted({row["triangles"] for row in rows})
    for rule, radius in dict.fromkeys((row["rule"], row["radius [m]"]) for row in rows):
        small, large = table[rule, radius, sizes[0]], table[rule, radius, sizes[-1]]
        result.append(
            {
                "what": f"{rule}: rate at {sizes[-1]:,} / at {sizes[0]:,}",
                "radius [m]": radius,
                "ratio": large["rate [kHz]"] / small["rate [kHz]"],
            }
        )
    for radius in dict.fromkeys(row["radius [m]"] for row in rows):
        ours, paper = (table.get((rule, radius, sizes[-1])) for rule in ("certified", "paper"))
        if ours and paper:
            bare = paper["tick [us]"]["median"] - paper["stages [us]"]["inside test"]
            result.append(
                {
                    "what": f"certified / paper at {sizes[-1]:,}",
                    "radius [m]": radius,
                    "ratio": ours["rate [kHz]"] / paper["rate [kHz]"],
                    "without inside test": bare / ours["tick [us]"]["median"],
                }
            )
    return result


def of_instrument(rows: list[dict[str, Any]], tools: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Median ticks with the whole instrument guarded over those with the tip alone.

    Args:
        rows: with the tip guarded.
        tools: the same meshes, rules and radii with the whole instrument guarded.
    """
    table = {(row["rule"], row["radius [m]"], row["triangles"]): row for row in rows}
    result = []
    for tool in tools:
        tip = table[tool["rule"], tool["radius [m]"], tool["triangles"]]
        times = [row["tick [us]"]["median"] for row in (tool, tip)]
        result.append(
            {
                "what": f"tick of the whole instrument / of the tip at {tool['triangles']:,}, "
                f"{times[0]:.0f} / {times[1]:.0f} µs",
                "radius [m]": tool["radius [m]"],
                "ratio": times[0] / times[1],
            }
        )
    return result
