"""Rows of the table of read-outs as HTML, and those of structures that move."""

from __future__ import annotations

import html
from dataclasses import dataclass

import numpy as np

import vf
from app.view import palette

HEAD = "padding:5px 0 1px;font-weight:600;color:var(--vf-faint);font-size:11px"
NAME = "padding:0 8px 0 0;color:var(--vf-soft);white-space:nowrap"
VALUE = "padding:0;text-align:right;white-space:nowrap"
UNIT = "padding:0 0 0 5px;color:var(--vf-faint)"
GLOSS = "color:var(--vf-faint);font-size:10.5px"
ALARM = f"padding:0 5px;background:{palette.css(palette.ALARM)};color:#fff"


@dataclass(frozen=True)
class Motion:
    """Read-outs of structures that move.

    Attributes:
        contacts: ticks in which the tip met them where they truly are; None: not known.
        tracked: whether the guard knows of them by a tracker.
        margin: added to their margins for what is not known [m].
        age: since the oldest of them was last seen [s]; inf: one was not seen yet.
    """

    contacts: int | None
    tracked: bool = False
    margin: float = 0.0
    age: float = 0.0


def motion_rows(step: vf.Step, motion: Motion | None) -> list[str]:
    """Of structures that move: distances and contacts are those of the true anatomy."""
    if motion is None:
        return []
    met = "–" if motion.contacts is None else f"{motion.contacts:,}"
    rows = [
        row("tip met the true anatomy", met, " ", alarm=bool(motion.contacts)),
        row("overtaken by", f"{step.violation * 1e3:.3f}", "mm", alarm=step.violation > 0.0),
    ]
    if motion.tracked:
        age = "–" if np.isinf(motion.age) else f"{motion.age:.2f}"
        rows += [
            row("margin for what is not known", f"{motion.margin * 1e3:.2f}", "mm"),
            row("age of the last sighting", age, "s"),
        ]
    return rows


def table(rows: list[str], mark: str) -> str:
    return (
        f"<table {mark} style='width:calc(100% - 1.5em);margin:0 .75em .5em;font-size:12px;"
        "line-height:1.32;border-collapse:collapse;font-variant-numeric:tabular-nums'>"
        + "".join(rows)
        + "</table>"
    )


def section(title: str) -> str:
    return f"<tr><td colspan=3 style='{HEAD}'>{html.escape(title)}</td></tr>"


def row(name: str, value: str, unit: str = "", gloss: str = "", *, alarm: bool = False) -> str:
    """One row. Numbers have a unit, " " for a count; a text without a unit spans two columns.

    An alarm is white on red, as the banner is, which may be scrolled out of view.
    """
    if gloss:
        gloss = f" <span style='{GLOSS}'>{html.escape(gloss)}</span>"
    text = html.escape(value)
    if alarm:
        text = f"<b style='{ALARM}'>{text}</b>"
    return f"<tr><td style='{NAME}'>{html.escape(name)}{gloss}</td>" + (
        f"<td style='{VALUE}'>{text}</td><td style='{UNIT}'>{unit}</td></tr>"
        if unit
        else f"<td colspan=2 style='{VALUE}'>{text}</td></tr>"
    )
