"""Texts of the inspector, as HTML. Pure functions."""

from __future__ import annotations

import html

import numpy as np
from numpy.typing import NDArray

from app.view import palette
from app.view.drawing.fixture import MIN_PUSH
from app.view.inspector.compare import Forecasts
from app.view.inspector.inspection import Inspection, Subject
from vf import Cover, Edge, Feature, Rule, TriangleReport, Verdict

NEAREST = 8  # rows of the list of triangles

_BOX = "margin:0 .75em .5em;font-size:12px;line-height:1.35"
_SMALL = "color:var(--vf-faint);font-size:11px"

STATES = tuple(palette.TRIANGLE_STATES)
_BY_CONDITION = {
    Verdict.FACE: palette.TriangleState.FACE,
    Verdict.RIDGE: palette.TriangleState.RIDGE,
    Verdict.SHARED: palette.TriangleState.RIDGE,
    Verdict.VALLEY: palette.TriangleState.VALLEY,
}
_BY_VERDICT = np.array(
    [
        STATES.index(_BY_CONDITION.get(Verdict(v), palette.TriangleState.INACTIVE)) if v else -1
        for v in range(max(Verdict) + 1)
    ]
)
_EDGES = {
    Edge.RIDGE: "a ridge",
    Edge.VALLEY: "a valley",
    Edge.FLAT: "flat",
    Edge.BOUNDARY: "a boundary",
    Edge.NON_MANIFOLD: "shared by more than two faces",
}
_SHORT = {
    Verdict.FACE: "Condition 1",
    Verdict.RIDGE: "Condition 2",
    Verdict.VALLEY: "Condition 3",
    Verdict.SHARED: "Condition 2, shared",
    Verdict.BEHIND: "passed over: tool behind it",
    Verdict.APART: "passed over: neighbour nearer",
    Verdict.BEHIND_VALLEY: "passed over: tool behind it",
    Verdict.OPEN: "passed over: open edge",
    Verdict.NO_AREA: "passed over: no area",
    Verdict.OUTSIDE: "outside the sphere",
}


def reason(report: TriangleReport, subject: Subject) -> str:
    """Why the paper's conditions gave a triangle a plane, or none."""
    it = "its closest point"
    corner = report.feature >= Feature.VERTEX_0
    on = "in a corner" if corner else "on an edge"
    match report.verdict:
        case Verdict.FACE:
            return f"Condition 1: {it} is inside the face and the tool is in front of it."
        case Verdict.RIDGE | Verdict.SHARED:
            if corner:
                text = f"Condition 2: {it} is a corner, and a neighbour’s is the same: "
            else:
                text = f"Condition 2: {it} is on a ridge, and the neighbour’s is the same: "
            text += "one plane for both, facing the tool."
            if report.verdict is Verdict.SHARED:
                text += f" It is listed as that of {subject.name(report.owner)}."
            return text
        case Verdict.VALLEY:
            return (
                f"Condition 3: {it} is {on} that is a valley and the tool is in front of the face: "
                "the face’s plane goes on beyond its edge."
            )
        case Verdict.BEHIND:
            return f"Passed over: {it} is inside the face, but the tool is behind the face."
        case Verdict.APART:
            return (
                f"Passed over: closest point {on}, neighbour’s closest point differs. The "
                "neighbour is nearer: its conditions decide."
            )
        case Verdict.BEHIND_VALLEY:
            return f"Passed over: {it} is {on} that is a valley, but the tool is behind the face."
        case Verdict.OPEN:
            return (
                f"Passed over: {it} is {on} without one single neighbour (a hole or a seam), "
                "which the paper’s conditions do not foresee."
            )
        case Verdict.NO_AREA:
            return "Passed over: the triangle has no area, so it has no normal."
    beyond = report.distance - subject.radius - subject.options.tip_radius
    if beyond > 0.0:
        return f"Not examined: {beyond * 1e3:.2f} mm beyond the motion sphere."
    return "Not examined: too many triangles are nearer."


def certified_reason(report: TriangleReport, inspection: Inspection) -> str:
    """Why the certified rule gave a triangle a plane, or none."""
    subject, explanation = inspection.subject, inspection.explanation
    match report.cover:
        case Cover.GAVE:
            rule = Rule(explanation.certified.rules[report.certified])
            kind = {
                Rule.FACE: "its face’s plane",
                Rule.VALLEY: "its face’s plane, which goes on across a valley",
            }.get(rule, "a plane that faces the tool from its closest part")
            return f"Gave a plane: {kind}."
        case Cover.BEHIND_ONE:
            return f"Needs none: wholly behind the plane of {subject.name(report.covered_by)}."
        case Cover.BEHIND_SEVERAL:
            return "Needs none: its part in the sphere is behind the planes taken together."
    if explanation.inside:
        return "Not examined: the tool is inside, so the planes only lead towards the way out."
    return "Not examined: outside the sphere in which the planes are valid."


def triangle(inspection: Inspection, chosen: int) -> str:
    """The report on one triangle."""
    subject, explanation = inspection.subject, inspection.explanation
    if chosen < 0:
        return _box("No triangle in the motion sphere. Click one, or move nearer.")
    report = explanation.of(chosen)
    row = explanation.row(chosen)
    state = palette.TRIANGLE_STATES[state_of(report)]
    rank = f"no. {row + 1:,} of {explanation.total:,} by distance" if row >= 0 else state.name
    side = "in front" if report.height >= 0.0 else "behind"
    rows = [
        _row("closest point", _feature(report)),
        _row("", "(" + ", ".join(f"{c * 1e3:.2f}" for c in report.point) + ") mm"),
        _row("distance", f"{report.distance * 1e3:.3f} mm"),
        _row("tool is", f"{side} ({report.height * 1e3:+.3f} mm)"),
    ]
    for across in report.across:
        rows.append(_row(f"across edge {across.edge}", _EDGES[across.kind]))
        if across.neighbour >= 0:
            gap = "the same" if across.same else f"{across.gap * 1e3:.3f} mm away"
            rows.append(_row(f"{subject.name(across.neighbour)}’s closest pt", gap))
    head = (
        f"<div style='{_BOX};margin-bottom:.2em'><span class='vf-triangle' "
        f"data-triangle='{chosen}' style='display:inline-block;padding:1px 8px;border-radius:3px;"
        f"font-weight:600;color:{_text_color(state.color)};background:{palette.css(state.color)}'>"
        f"{html.escape(subject.name(chosen))}</span> <span style='{_SMALL}'>{rank}</span></div>"
    )
    verdict = (
        f"<div class='vf-reason' style='border-left:4px solid {palette.css(state.color)};"
        "padding:2px 0 2px 7px;margin:3px 0;background:var(--vf-plate)'>"
        f"{html.escape(reason(report, subject))}</div>"
    )
    table = f"<table style='width:100%;border-collapse:collapse'>{''.join(rows)}</table>"
    more = f"<div style='{_SMALL}'>Certified: {html.escape(certified_reason(report, inspection))}"
    more += f"</div>{_plane(inspection, report)}"
    return head + f"<div style='{_BOX}'>{verdict}{table}{more}</div>"


def nearest(inspection: Inspection, chosen: int) -> str:
    """The list of the nearest triangles, and the number of each state."""
    subject, explanation = inspection.subject, inspection.explanation
    first = max(0, min(explanation.row(chosen) - NEAREST // 2, len(explanation) - NEAREST))
    lines = []
    for report in explanation[first : first + NEAREST]:
        state = palette.TRIANGLE_STATES[state_of(report)]
        push, _ = inspection.push(report.triangle)
        mark = "background:var(--vf-plate);font-weight:600" if report.triangle == chosen else ""
        pushes = " ◀" if push > MIN_PUSH else ""
        lines.append(
            f"<tr style='{mark}'><td style='padding:0 4px 0 0'>"
            f"<span style='color:{palette.css(state.color)}'>■</span> "
            f"{html.escape(subject.name(report.triangle))}</td><td style='text-align:right;"
            f"padding-right:6px'>{report.distance * 1e3:.2f}</td>"
            f"<td style='font-size:11px'>{html.escape(_SHORT[report.verdict])}{pushes}</td></tr>"
        )
    note = ""
    if explanation.total > len(explanation):
        note = (
            f"<div style='{_SMALL}'>Only the nearest {len(explanation):,} of "
            f"{explanation.total:,} triangles are examined and drawn.</div>"
        )
    wall = float(inspection.multipliers[inspection.planes.rules == Rule.CORRIDOR].sum())
    if wall > MIN_PUSH:
        note += f"<div>The corridor’s wall pushes the tool back by {wall * 1e3:.3f} mm.</div>"
    table = "<table style='width:100%;border-collapse:collapse;font-size:11.5px'>"
    return f"<div style='{_BOX}'>{table}{''.join(lines)}</table>{note}{_counts(inspection)}</div>"


def parts(inspection: Inspection) -> str:
    """Which parts of the instrument have planes, and what holds each; only the tip: empty."""
    subject, planes, pushes = inspection.subject, inspection.planes, inspection.multipliers
    if subject.step is None or not subject.options.guards_tool or planes.capsules is None:
        return ""
    capsules = subject.scene.arm.capsules
    lines = []
    for k, capsule in enumerate(capsules) if len(capsules) > 1 else ():
        mine = np.flatnonzero(planes.capsules == k)
        text = "no plane near"
        if len(mine):
            text = f"{len(mine)} plane{'s' if len(mine) > 1 else ''}"
            push = float(pushes[mine].sum())
            most = int(planes.triangles[mine[pushes[mine].argmax()]])
            if push > MIN_PUSH:
                text = f"held back by {push * 1e3:.3f} mm, {text}"
                text += f", most by {subject.name(most)}" if most >= 0 else ""
        lines.append(_row(capsule.name, text))
    table = f"<table style='width:100%;border-collapse:collapse'>{''.join(lines)}</table>"
    return f"<div class='vf-parts' style='{_BOX};font-size:11.5px'>{table}</div>" if lines else ""


def comparison(compared: Forecasts) -> str:
    """Table of the forecasts, a row for each rule."""
    forecasts, x = compared.of, compared.x
    cell = "padding:0 0 0 4px;text-align:right;white-space:nowrap"
    columns = [
        ("planes", "how many half-spaces", [f"{t.planes:,}" for t in forecasts]),
        (
            "leak",
            "share of the surface in the sphere on the allowed side of every plane (sampled)",
            [_highlight(_percent(t.leaking), t.leaking > 0.0) for t in forecasts],
        ),
        (
            "blocked",
            "share of the free space in the sphere that the planes forbid (sampled)",
            [_percent(t.blocked) for t in forecasts],
        ),
    ]
    if any(np.isfinite(t.step) for t in forecasts):
        columns += [
            (
                "step, µm",
                "how far the tip would go in the next tick",
                [f"{t.step * 1e6:.0f}" for t in forecasts],
            ),
            (
                "end gap, µm",
                "from where it would go to the surface",
                [_highlight(f"{t.gap * 1e6:.0f}", t.crosses) for t in forecasts],
            ),
        ]
        crossing = [t.rule for t in forecasts if t.crosses]
        note = f"Would go through the surface: {', '.join(crossing)}." if crossing else ""
        moves = "<br>".join(
            f"{t.rule}: ({', '.join(f'{c * 1e6:+.0f}' for c in t.p_tip - x)}) µm" for t in forecasts
        )
        moves = f"<div style='{_SMALL}'>Tip would move by (x, y, z)<br>{moves}</div>"
    else:
        note, moves = "No step: there is no proxy to follow here.", ""
    heads = "".join(
        f"<th style='{cell};font-weight:400;color:var(--vf-soft)' title='{html.escape(hint)}'>"
        f"{name}</th>"
        for name, hint, _ in columns
    )
    lines = "".join(
        f"<tr><th style='text-align:left;font-weight:600'>{t.rule}</th>"
        + "".join(f"<td style='{cell}'>{values[k]}</td>" for _, _, values in columns)
        + "</tr>"
        for k, t in enumerate(forecasts)
    )
    moment = "At the probe." if compared.tick is None else f"All after tick {compared.tick:,}."
    return (
        f"<div class='vf-rules' style='{_BOX}'><div style='{_SMALL}'>{moment}</div>"
        "<table style='width:100%;border-collapse:collapse;"
        f"font-size:11px;font-variant-numeric:tabular-nums'><tr><th></th>{heads}</tr>"
        f"{lines}</table><div style='{_SMALL}'>{html.escape(note)}</div>{moves}"
        f"<div style='{_SMALL}'>Leak: surface on the allowed side of all planes. Blocked: free "
        "space behind one.</div></div>"
    )


def region(inspection: Inspection) -> str:
    """The allowed share of the sphere."""
    solid = inspection.region
    if solid is None:
        return ""
    if not len(solid.faces):
        return _box("Allowed region: no room that could be drawn.")
    return _box(
        f"Allowed region: {solid.share:.0%} of the sphere (drawn as a polyhedron inside it)."
    )


def state_of(report: TriangleReport) -> palette.TriangleState:
    """State of a triangle, which gives its colour."""
    return STATES[int(states(np.array([report.verdict]), np.array([report.cover]))[0])]


def states(verdicts: NDArray[np.int8], covers: NDArray[np.int8]) -> NDArray[np.int8]:
    """Indices into `STATES` of triangles with these verdicts and covers (k,)."""
    found = _BY_VERDICT[verdicts]
    only = (found == STATES.index(palette.TriangleState.INACTIVE)) & (covers == Cover.GAVE)
    return np.where(only, STATES.index(palette.TriangleState.CERTIFIED), found).astype(np.int8)


def structure(inspection: Inspection) -> str:
    """The structure that is inspected, where the scene has several."""
    name = inspection.subject.structure
    return _box(f"Structure: {name}") if name else ""


def _plane(inspection: Inspection, report: TriangleReport) -> str:
    """The plane of a triangle in force, and how far it pushed the tip back."""
    subject, planes = inspection.subject, inspection.planes
    under = report.triangle
    rows = np.flatnonzero(planes.triangles == under)
    if not len(rows) and subject.rule == "paper" and report.owner >= 0:
        under = report.owner
        rows = np.flatnonzero(planes.triangles == under)
    if not len(rows):
        text = f"No plane in force (rule {subject.rule})."
        return f"<div class='vf-push' style='margin-top:3px'>{text}</div>"
    k = int(rows[0])
    normal = ", ".join(f"{c:+.2f}" for c in planes.normals[k])
    slack, of = subject.room(planes, k), ""
    if planes.of_axis is not None and planes.of_axis[k]:
        of = f" of the {html.escape(subject.part(planes, k))}"
    text = f"Plane{of} (rule {subject.rule}): n = ({normal}), {slack * 1e3:.3f} mm "
    text += "to its axis’ bound." if of else "from here."
    if subject.step is not None:
        push, share = inspection.push(under)
        if push > MIN_PUSH:
            most = " It blocks the way." if push == inspection.multipliers.max() else ""
            strong = f"Active in the QP: pushed back by {push * 1e3:.3f} mm, {share:.0%}.{most}"
            text += f"<br><b>{strong}</b>"
        else:
            text += "<br>Not active in the QP now."
    return f"<div class='vf-push' style='margin-top:3px'>{text}</div>"


def _counts(inspection: Inspection) -> str:
    explanation = inspection.explanation
    found = states(explanation.verdicts, explanation.covers)
    parts = [
        f"<span style='white-space:nowrap'><span style='color:{palette.css(look.color)}'>■</span> "
        f"{html.escape(look.name)}: {(found == k).sum():,}</span>"
        for k, look in enumerate(palette.TRIANGLE_STATES.values())
    ]
    return f"<div style='margin-top:4px;font-size:11px'>{' &nbsp;'.join(parts)}</div>"


def _feature(report: TriangleReport) -> str:
    if report.feature == Feature.FACE:
        return "inside the face"
    if report.feature <= Feature.EDGE_2:
        return f"on edge {report.feature - Feature.EDGE_0}"
    return f"corner {report.feature - Feature.VERTEX_0}"


def _percent(share: float) -> str:
    if not np.isfinite(share):
        return "–"
    return f"{share:.0%}" if share == 0.0 or share >= 0.01 else "<1%"


def _highlight(text: str, on: bool) -> str:
    color = palette.css(palette.VERMILION)
    return f"<b style='color:{color}'>{text}</b>" if on else text


def _text_color(color: palette.Rgb) -> str:
    """Black or white, whichever has more contrast to a colour."""
    return "#000" if 0.3 * color[0] + 0.59 * color[1] + 0.11 * color[2] > 120 else "#fff"


def _box(text: str) -> str:
    return f"<div style='{_BOX}'>{html.escape(text)}</div>"


def _row(name: str, value: str) -> str:
    return (
        f"<tr><td style='color:var(--vf-soft);padding:0'>{html.escape(name)}</td>"
        f"<td style='text-align:right;padding:0'>{html.escape(value)}</td></tr>"
    )
