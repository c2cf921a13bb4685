"""Read-outs and banner as HTML, from one tick's telemetry. Pure functions."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import vf
from app.control.messages import Telemetry
from app.control.watch import Crossing
from app.settings import Options
from app.view import palette
from app.view.drawing.fixture import MIN_PUSH
from app.view.tabs.depth import Whereabouts
from app.view.tabs.rows import NAME, UNIT, VALUE, Motion, motion_rows, row, section, table

SILENCE = 0.7  # a control loop without new telemetry for longer is reported [s]
# A watchdog in CSS: each read-out replaces these elements and so restarts their animations. Three
# seconds without one (a dead server, a blocked tab) the numbers fade and the note appears.
_WATCHDOG = (
    "<style>@keyframes vf-fade{to{opacity:.3}}@keyframes vf-note{to{opacity:1}}"
    ".vf-numbers{animation:vf-fade .3s 3s forwards}"
    ".vf-old{animation:vf-note .3s 3s forwards;opacity:0;pointer-events:none;position:absolute;"
    "z-index:1;left:.75em;right:.75em;top:38%;padding:6px 9px;border-left:5px solid "
    f"{palette.css(palette.VERMILION)};background:var(--vf-plate);color:var(--vf-ink);font-size:12.5px}}</style>"
    "<div class='vf-old'>Old numbers: no data from the sandbox for three seconds.</div>"
)


@dataclass(frozen=True)
class Extras:
    """What `app.view.tabs.measuring` adds to the telemetry.

    Attributes:
        in_sphere: number of triangles within the motion sphere, enlarged by the tip's radius.
        speed: mean speed of the tool tip since the last read-out [m/s].
        joints: names of the arm's joints.
        silent: time since the last new telemetry [s].
        count: number of the read-out; makes each HTML differ from the last.
        where: position relative to the anatomy; None: no tick yet.
        unwatched: ticks that were not tested for a crossing.
        ended: why the control loop ended by itself; empty: it did not.
        parts: names of the arm's capsules.
        structures: where the scene has several, names of those that are guarded, by fixture.
        motion: where structures move; None: none does.
        stream: where vertices come from, and what is wrong with them; empty: they do not.
    """

    in_sphere: int
    speed: float
    joints: tuple[str, ...]
    silent: float = 0.0
    count: int = 0
    where: Whereabouts | None = None
    unwatched: int = 0
    ended: str = ""
    parts: tuple[str, ...] = ()
    structures: tuple[str, ...] = ()
    motion: Motion | None = None
    stream: str = ""


def readouts(telemetry: Telemetry, options: Options, extras: Extras) -> str:
    """The table of read-outs."""
    stats, step = telemetry.stats, telemetry.step
    rows = [section("Tool")]
    if step is None:
        rows.append(row("waiting for the first tick", ""))
    else:
        rows += [
            *_distance_rows(extras),
            *motion_rows(step, extras.motion),
            row("tool speed", f"{extras.speed * 1e3:.1f}", "mm/s"),
            row("proxy to tool", _error(telemetry), "mm"),
            _force_row(float(np.linalg.norm(step.force))),
            section("Fixture"),
            row("rule", options.rule),
            row("guarded", "whole tool" if options.guards_tool else "tip"),
            row("motion sphere", f"{step.radius * 1e3:.2f}", "mm"),
            row(_reach_name(extras), f"{extras.in_sphere:,}", " "),
            row("active planes", f"{len(step.planes):,}", " "),
            *_by_condition(step, options.rule),
            *_by_part(step, options, extras),
            *_by_structure(step, extras),
            row("QP", palette.SOLVER_HELP[step.solver]),
            row("outcome", "loop ended" if extras.ended else step.status.name),
        ]
    rows += [
        section("Control loop"),
        row("rate", "0" if extras.ended else f"{stats.rate:,.0f}", "Hz"),
        row("tick, median", f"{stats.tick_median * 1e6:,.0f}", "µs"),
        row("tick, worst of 1 s", f"{stats.tick_worst * 1e6:,.0f}", "µs"),
        row("overruns", f"{stats.overruns:,}", " "),
    ]
    outcomes = [section("Ticks by outcome")]
    outcomes += [
        row(s.name, f"{stats.counts.get(s, 0):,}", gloss=palette.STATUS_HELP[s]) for s in vf.Status
    ]
    mark = f"class='vf-numbers' data-count='{extras.count}'"
    return (
        f"<div style='position:relative'>{_WATCHDOG}{table(rows, mark)}{table(outcomes, mark)}"
        "</div>"
    )


def banner(telemetry: Telemetry, options: Options, extras: Extras, clutched: bool) -> str:
    """The state in one line, with a colour for its urgency; above it a crossing, until a reset."""
    text, color = _state(telemetry, options, extras, clutched)
    where = extras.where
    if where is None:
        return _line(text, color)
    if where.crossing is not None:
        return _line(
            text, palette.css(palette.ALARM), _crossing_text(where, where.crossing, extras)
        )
    if where.in_mesh:
        verb = "is" if len(where.in_mesh) == 1 else "are"
        remark = f"The {_listed(where.in_mesh)} {verb} in the mesh"
        remark += "." if options.guards_tool else ": only the tip is guarded."
        return _line(text, color, remark=remark)
    return _line(text, color)


def note(text: str) -> str:
    """The banner with any text."""
    return _line(text, palette.css(palette.BLUE))


def _line(text: str, color: str, latch: str = "", remark: str = "") -> str:
    parts = [html.escape(text)]
    if latch:
        # White on red, on light and dark panels.
        style = f"display:inline-block;padding:0 5px;margin:0 -5px;background:{color};color:#fff"
        parts.insert(0, f"<b style='{style}'>{html.escape(latch)}</b>")
    if remark:
        orange = palette.css(palette.ORANGE)
        parts.append(f"<span style='border-bottom:2px solid {orange}'>{html.escape(remark)}</span>")
    return (
        "<div class='vf-banner' "
        f"style='margin:0 .75em .35em;padding:3px 9px;border-left:5px solid {color};"
        "background:var(--vf-plate);color:var(--vf-ink);font-size:12.5px;line-height:1.35;"
        # At least three lines high, so that the controls below keep their place.
        f"min-height:calc(4.05em + 6px)'>{'<br>'.join(parts)}</div>"
    )


def _crossing_text(where: Whereabouts, crossing: Crossing, extras: Extras) -> str:
    """Where the tip met the mesh, where it is now, and what to do."""
    what = "Crossed" if crossing.centre else "Touched by the tip’s ball"
    if where.inside:
        now = f"{where.distance * 1e3:.2f} mm deep in the anatomy: Reset."
    elif where.beyond:
        now = f"On the far side, {where.from_crossing * 1e3:.2f} mm from there: Reset."
    elif where.overlaps:
        now = f"The tip’s ball overlaps the mesh by {-where.gap * 1e3:.2f} mm: Reset."
    else:
        now = "Back on the near side; Reset clears this."
    of = f" of {crossing.structure}" if extras.structures else ""
    return (
        f"{what} at tick {crossing.tick:,}, triangle #{crossing.triangle:,}{of} "
        f"(rule {crossing.rule}). {now}"
    )


def _reach_name(extras: Extras) -> str:
    ball = extras.where is not None and extras.where.tip_radius > 0.0
    return "triangles in ball’s reach" if ball else "triangles in sphere"


def _distance_rows(extras: Extras) -> list[str]:
    """Distance, depth and crossings, whatever the rule."""
    where = extras.where
    if where is None:
        return [row("distance to surface", "–", "mm"), row("depth below surface", "–", "mm")]
    distance = f"{where.distance * 1e3:.3f}"
    if where.tip_radius > 0.0:
        rows = [
            row("tip’s centre to surface", distance, "mm"),
            row("tip’s ball to surface", f"{where.gap * 1e3:.3f}", "mm"),
        ]
    else:
        rows = [row("distance to surface", distance, "mm")]
    if where.beyond:
        rows.append(row("depth below crossing", f"{where.from_crossing * 1e3:.3f}", "mm"))
    else:
        outside = "0.000" if where.closed else "–"  # an open mesh has no inside
        rows.append(row("depth below surface", distance if where.inside else outside, "mm"))
    if extras.structures:
        rows.insert(0, row("nearest structure", _short(where.structure)))
    if len(extras.parts) > 1:
        nearest = where.part_gap if np.isfinite(where.part_gap) else 0.0
        rows.append(row(f"nearest part: {where.part}", f"{nearest * 1e3:.3f}", "mm"))
    seen, name = "none", "crossing"
    if where.crossing is not None:
        name = "crossing" if where.crossing.centre else "touch"
        seen = f"tick {where.crossing.tick:,}"
    if extras.unwatched:
        seen += f"; {extras.unwatched:,} ticks unseen"
    rows.append(row(name, seen, alarm=where.crossing is not None))
    return rows


def _state(
    telemetry: Telemetry, options: Options, extras: Extras, clutched: bool
) -> tuple[str, str]:
    """Text and colour of the most urgent state."""
    step = telemetry.step
    orange, red = palette.css(palette.ORANGE), palette.css(palette.VERMILION)
    calm, busy = palette.css(palette.GREEN), palette.css(palette.BLUE)
    if extras.ended:
        text = f"The control loop ended ({extras.ended}). The tool is held; nothing is lost."
        return f"{text} Restart it below.", red
    if extras.silent > SILENCE:
        return f"The control loop has been silent for {extras.silent:.0f} s.", red
    where = extras.where
    inside = where is not None and where.inside
    if telemetry.paused:
        place = "The tool is inside the anatomy. " if inside else ""
        return f"Paused. {place}Run, or step tick by tick.", orange
    if telemetry.stale:
        return "Stale: no message from the dragging client, the tool holds.", red
    if telemetry.lost and extras.stream:
        return f"Stale: no new vertices from {extras.stream}: the tool holds.", red
    if telemetry.lost:
        return "Stale tracker: a structure was not seen for too long, the tool holds.", red
    if step is not None and step.status == vf.Status.OVERTAKEN:
        depth = f"{step.violation * 1e3:.3f} mm"
        if options.tracker is not None:
            # Whether it is there only a tracker that is not late would know.
            return f"Overtaken: the anatomy, seen late, may be in the tool by up to {depth}.", red
        return f"Overtaken: the anatomy came faster than the arm yields, by up to {depth}.", red
    if step is not None and step.status == vf.Status.INSIDE:
        return "Inside the anatomy: only motion towards the outside passes.", red
    if step is not None and step.status == vf.Status.REFUSED:
        return "Refused: the proxy is not usable, the tool holds.", red
    if clutched:
        return "Clutched: the handle moves alone, the tool holds.", orange
    if telemetry.target is None and not telemetry.autopilot:
        if inside:
            return "The tool rests inside the anatomy: drag it, or Reset.", red
        return "Ready: drag the tool or the gizmo.", calm
    if step is None:
        return "Starting …", calm
    if step.status == vf.Status.HELD:
        return f"Held: no safe step this tick (QP: {palette.SOLVER_HELP[step.solver]}).", red
    at_limit = [
        f"{name} ({'upper' if side > 0 else 'lower'})"
        for name, side in zip(extras.joints, step.limits, strict=False)
        if side != 0
    ]
    if at_limit:
        return f"Joint limit: {', '.join(at_limit)}.", orange
    if options.rule == "off":
        return "No fixture (rule off): nothing stops the tool.", orange
    if step.status == vf.Status.RECOVERING:
        to = "standoff" if extras.motion is None else "standoff and margin"
        return f"Recovering: the tool is led out to the {to}.", orange
    if len(step.planes) and bool((step.multipliers > MIN_PUSH).any()):
        force = f"{palette.FORCE_NAME} {np.linalg.norm(step.force):.2f} N"
        who = holders(step, extras.structures)
        verb = "hold" if len(who) > 1 else "holds"
        return f"{_listed(who) or 'The fixture'} {verb} the {_held(step, options, extras)}: " + (
            f"{force}."
        ), busy
    if step.status == vf.Status.SHORTENED:
        return "Only a part of the step was safe.", busy
    if inside:
        return "Inside the anatomy, and no plane holds the tool back.", red
    if where is not None and where.overlaps:
        return f"The tip’s ball overlaps the mesh by {-where.gap * 1e3:.2f} mm.", orange
    if telemetry.autopilot:
        return "Autopilot: a scripted proxy is moving.", calm
    if where is not None and not where.free:
        return "No plane holds the tool back.", calm
    return "Free.", calm


def _held(step: vf.Step, options: Options, extras: Extras) -> str:
    """What is held back and by how many planes, part by part: "tool back (2 planes)"."""
    counts = _counts(step, extras, step.multipliers > MIN_PUSH)
    total = sum(counts.values())
    planes = f"{total} plane{'s' if total > 1 else ''}"
    if not options.guards_tool or len(extras.parts) < 2:
        return f"tool back ({planes})"
    held = [name for name, n in counts.items() if n]
    if len(held) > 1:
        planes += ": " + ", ".join(f"{name} {counts[name]}" for name in held)
    return f"{_listed(held)} back ({planes})"


def _counts(step: vf.Step, extras: Extras, counted: NDArray[np.bool_]) -> dict[str, int]:
    """How many of the planes that are counted (m,) each part of the instrument has."""
    capsules = step.planes.capsules
    if capsules is None:
        capsules = np.zeros(len(step.planes), dtype=np.int64)
    names = extras.parts or ("tool",)
    return {name: int((counted & (capsules == k)).sum()) for k, name in enumerate(names)}


def holders(step: vf.Step, structures: Sequence[str]) -> list[str]:
    """Names of the structures whose planes hold the tool, the one that pushes most first."""
    fixtures, pushes = step.planes.fixtures, step.multipliers
    if fixtures is None:
        return []
    most = {k: float(pushes[fixtures == k].max(initial=0.0)) for k in range(len(structures))}
    held = sorted((k for k in most if most[k] > MIN_PUSH), key=lambda k: -most[k])
    return [structures[k] for k in held]


def _by_structure(step: vf.Step, extras: Extras) -> list[str]:
    if not extras.structures:
        return []
    who = holders(step, extras.structures)
    more = f" and {len(who) - 1} more" if len(who) > 1 else ""
    return [row("held by", _short(who[0]) + more if who else "–")]


def _short(name: str) -> str:
    """A name that fits beside another word."""
    return name if len(name) <= 22 else f"{name[:21]}…"


def _listed(names: Sequence[str]) -> str:
    """Names in a sentence: "a", "a and b", "a, b and c"."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def _by_part(step: vf.Step, options: Options, extras: Extras) -> list[str]:
    if not options.guards_tool or len(extras.parts) < 2:
        return []
    counts = _counts(step, extras, np.ones(len(step.planes), dtype=bool))
    return [row(f"of the {name}", f"{n:,}", " ") for name, n in counts.items()]


def _by_condition(step: vf.Step, in_force: str) -> list[str]:
    rows = []
    for rule, look in palette.LOOKS.items():
        n = int((step.planes.rules == rule).sum())
        of_paper = rule in palette.CONDITIONS
        # The three conditions are always listed, so that the rows below keep their place.
        if n or of_paper:
            # Other rules do not ask for them: their planes are only classed so.
            name = f"like {look.name}" if of_paper and in_force != "paper" else look.name
            dot = f"<span style='color:{palette.css(look.color)}'>■</span> {html.escape(name)}"
            rows.append(
                f"<tr><td style='{NAME};padding-left:8px'>{dot}</td>"
                f"<td style='{VALUE}'>{n}</td><td></td></tr>"
            )
    return rows


def _force_row(force: float) -> str:
    color = palette.css(palette.FORCE)
    return (
        f"<tr><td style='{NAME}'>{palette.FORCE_NAME}</td>"
        f"<td style='{VALUE};color:{color};font-weight:600'>{force:.2f}</td>"
        f"<td style='{UNIT}'>N</td></tr>"
    )


def _error(telemetry: Telemetry) -> str:
    if telemetry.target is None or telemetry.step is None:
        return "–"
    gap = telemetry.target.translation - telemetry.step.tip.translation
    return f"{np.linalg.norm(gap) * 1e3:.2f}"
