"""Legend of the colours as HTML."""

from __future__ import annotations

import html

from app.view import palette


def legend() -> str:
    """HTML legend of the colours."""
    signs = [
        (look.color, f"<b>{html.escape(look.name)}</b>: {html.escape(look.meaning)}")
        for look in palette.LOOKS.values()
    ]
    signs += [
        (palette.BLOCKING, "<b>ring and arrow</b>: the plane that holds the tool back most"),
        (palette.PART, "<b>capsules</b> (layer): the parts of the instrument that are guarded"),
        (palette.PART_NEAR, "<b>capsule with planes</b>, which do not hold it"),
        (palette.PART_HELD, "<b>capsule held back</b>; its discs have the part’s name"),
        (palette.TROCAR, "<b>trocar zone</b>: here the shaft may pass the mesh"),
        (palette.SPHERE, "<b>motion sphere</b>: the reach of one tick's step"),
        (palette.PROXY, "<b>tether</b>: from the tool to the proxy"),
        (palette.FORCE, f"<b>{palette.FORCE_NAME}</b> on the hand: arrow, plot and number"),
        (palette.PROBE, "<b>probe</b> of the inspector"),
    ]
    signs += [
        (look.color, f"<b>inspector, {html.escape(look.name)}</b>: {html.escape(look.meaning)}")
        for state, look in palette.TRIANGLE_STATES.items()
        if state in (palette.TriangleState.CERTIFIED, palette.TriangleState.INACTIVE)
    ]
    rows = "".join(
        "<div style='display:flex;gap:7px;margin-bottom:2px'><span style='flex:none;width:11px;"
        "height:11px;margin-top:3px;border-radius:2px;border:1px solid var(--vf-faint);"
        f"background:{palette.css(color)}'></span>"
        f"<span>{text}</span></div>"
        for color, text in signs
    )
    return (
        f"<div style='margin:0 .75em .5em;font-size:11.5px;line-height:1.3'>{rows}"
        f"<div style='color:var(--vf-faint);margin-top:4px'>{palette.CLASSED}</div>"
        "<div style='color:var(--vf-faint);margin-top:4px'>Filled triangles gave the discs of the "
        "same colour; the stronger a disc’s colour, the larger its share of the push. Of planes "
        "farther off, when there are many, only the rim is drawn.</div></div>"
    )
