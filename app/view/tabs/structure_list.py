"""Folder "Structures" of the tab "Mesh": a list of them, and the settings of the chosen one."""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import viser

from app.kinds import Length, bare
from app.options import declared
from app.scene.moment import Moment
from app.structure import Structure
from app.view import palette
from app.view.context import PageContext
from app.view.controls.fields import NumberField, bind, obey, show
from app.view.drawing.fixture import MIN_PUSH
from app.view.tabs.depth import part_gaps

EYE, GUARD, CHOOSE = "eye", "guard", "choose"  # the orders of the list's buttons
AS_SESSION = "as the session"
# Drawn, as few fonts have the sign.
_EYE = (
    "<svg viewBox='0 0 16 10' width='14' height='10' style='vertical-align:-1px' fill='none' "
    "stroke='currentColor' stroke-width='1.2'><path d='M1 5Q8-3 15 5Q8 13 1 5Z'/>"
    "<circle cx='8' cy='5' r='2' fill='currentColor'/></svg>"
)
FAR = 9.999  # distances beyond this are not written [m]


class StructureList:
    """All structures in a row each, with buttons; below it the controls of the chosen one.

    A part of the tab "Mesh", which calls it.

    The rows change only with settings. The distances and which structure holds the tool are a style
    sheet beside them, so that a row that is being clicked stays the same element.
    """

    def __init__(
        self,
        context: PageContext,
        remove: Callable[[viser.ClientHandle | None, int], None],
    ) -> None:
        """`remove` takes the structure of a number out of the scene; it may block."""
        self._session, self._source = context.session, context.source
        self._anatomy, self._input = context.anatomy, context.client_input
        self._notify = context.notify
        self._controls: list[Any] = []
        gui = context.server.gui
        with gui.add_folder("Structures"):
            self._list = gui.add_html("")
            self._orders = gui.add_text("Order of the list", "")
            self._state = gui.add_html("")
            self._choice: Any = gui.add_dropdown(
                "Chosen",
                ("–",),
                initial_value="–",
                hint="Also by a click on its name above. Section and Examine are of this one.",
            )
            limits = bare(declared(Structure)["margin"].kind)
            assert isinstance(limits, Length)
            margin = gui.add_number(
                "Margin [mm]", 0.0, min=0.0, max=limits.high * 1e3, step=0.1,
                hint="Distance the tool keeps from this structure beyond the standoff; what a "
                "registration adds comes on top.",
            )  # fmt: skip
            self._guarded = gui.add_checkbox(
                "Guarded", True, hint="Off, this structure does not stop the tool."
            )
            self._guard = gui.add_dropdown(
                "Keeps out",
                (AS_SESSION, "tool", "tip"),
                initial_value=AS_SESSION,
                hint="The whole instrument, or its tip alone.",
            )
            self._visible = gui.add_checkbox("Visible", True)
            self._opacity = gui.add_slider("Opacity", 0.05, 1.0, 0.05, 1.0)
            self._colour = gui.add_rgb("Colour", palette.BONE)
            self._remove = gui.add_button(
                "Remove structure",
                hint="Take it out of the scene; the mesh stays.",
                icon=viser.Icon.TRASH,
                color="gray",
            )
        self._margin = NumberField(
            margin,
            (0.0, limits.high * 1e3),
            context.client_input,
            context.notify,
            lambda typed: self._set(margin=typed * 1e-3),
            lambda: 1e3 * (self._own().margin or 0.0),
        )
        self._controls += [margin]
        self._bind(self._guarded, lambda value: self._set(guarded=bool(value)))
        self._bind(self._guard, lambda value: self._set(guard=_guard(value)))
        self._bind(self._opacity, lambda value: self._set(opacity=float(value)))
        self._bind(self._colour, lambda value: self._set(colour=_hex(value)))
        self._bind(self._visible, lambda value: self._anatomy.show_structure(self._number, value))
        self._bind(self._choice, lambda value: self._choose(_number_of(value)))

        # A plain function: viser runs it in its thread pool, so it may block.
        @self._remove.on_click
        def _removed(event: viser.GuiEvent[Any]) -> None:
            remove(event.client, self._number)

        @self._orders.on_update
        async def _ordered(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                self._input.submit(self._act, event.client, str(event.target.value))

    @property
    def _number(self) -> int:
        """Of the chosen structure."""
        return self._anatomy.chosen

    def read_out(self, shown: Moment) -> None:
        self._sync(shown)
        self._state.content = _state(_distances(shown), _holding(shown))

    def _sync(self, shown: Moment) -> None:
        """Show the settings in force."""
        live = self._source.live
        structures = shown.options.anatomy
        seen = [self._anatomy.shows(k) for k in range(len(structures))]
        rows = _rows(structures, seen, self._number, shown.scene.added_range)
        if rows != self._list.content:
            self._list.content = rows
        names = tuple(f"{k}: {own.name}" for k, own in enumerate(structures))
        if names != tuple(self._choice.options):
            self._choice.options = names
        number = min(self._number, len(structures) - 1)
        show(self._choice, names[number])
        own = structures[number]
        show(self._guarded, own.guarded)
        show(self._guard, own.guard or AS_SESSION)
        show(self._visible, seen[number])
        show(self._opacity, own.opacity)
        show(self._colour, palette.structure_colour(own, number))
        self._margin.sync()
        for control in self._controls:
            control.disabled = not live and control not in (self._visible, self._choice)
        # The mesh is guarded as the session says.
        self._guard.disabled = not live or number == 0
        self._remove.disabled = not live
        self._remove.visible = number > 0

    def _own(self) -> Structure:
        """The settings of the chosen structure."""
        structures = self._source.shown.options.anatomy
        return structures[min(self._number, len(structures) - 1)]

    def _set(self, **changes: Any) -> None:
        if self._number == 0 and set(changes) == {"guard"}:
            return
        self._session.set_structure(self._number, **changes)

    def _choose(self, number: int) -> None:
        if 0 <= number < len(self._source.shown.options.anatomy):
            self._anatomy.chosen = number

    def _bind(self, control: Any, take: Callable[[Any], object]) -> None:
        """Pass a control's new value to `take`, then show the value in force."""
        self._controls.append(control)
        bind(control, self._input, self._notify, take, self._show_now)

    def _take(self, client: viser.ClientHandle, take: Callable[[Any], object], value: Any) -> None:
        obey(client, self._notify, take, value, self._show_now)

    def _show_now(self) -> None:
        self._sync(self._source.now() if self._source.live else self._source.shown)

    def _act(self, client: viser.ClientHandle, text: str) -> None:
        """An order of one of the list's buttons: what, and the structure's number."""
        what, _, rest = text.partition(" ")
        number = _number_of(rest.partition(" ")[0])
        structures = self._source.shown.options.anatomy
        if not 0 <= number < len(structures):
            return  # no button of the page says that
        if what == EYE:
            seen = self._anatomy.shows(number)
            self._take(client, lambda on: self._anatomy.show_structure(number, on), not seen)
        elif what == CHOOSE:
            self._take(client, self._choose, number)
        elif what == GUARD and self._source.live:
            self._take(
                client,
                lambda on: self._session.set_structure(number, guarded=on),
                not structures[number].guarded,
            )


def _rows(
    structures: Sequence[Structure],
    seen: Sequence[bool],
    chosen: int,
    added: Sequence[tuple[float, float]] = (),
) -> str:
    """The list as HTML; `added` is the range that a registration adds to each margin [m]."""
    rows = []
    for k, own in enumerate(structures):
        name = html.escape(str(own.name))
        marks = ("vf-off" if not own.guarded else "", "vf-chosen" if k == chosen else "")
        swatch = palette.css(palette.structure_colour(own, k))
        eye, shield = _EYE if seen[k] else "–", "☑" if own.guarded else "☐"
        rows.append(
            f"<tr class='vf-s{k} {' '.join(marks)}'>"
            f"<td>{_button(EYE, k, eye, f'Show {name}', seen[k])}</td>"
            f"<td>{_button(GUARD, k, shield, f'Guard {name}', own.guarded)}</td>"
            f"<td class='vf-name' title='{name}'><button data-vf-order='{CHOOSE} {k}'>"
            f"<span class='vf-swatch' style='background:{swatch}'></span>{name}</button></td>"
            f"<td>{_margin(own, added[k] if k < len(added) else None)}</td>"
            "<td class='vf-distance'></td></tr>"
        )
    head = (
        "<tr><th></th><th></th><th class='vf-name'>structure</th>"
        "<th title='kept beyond the standoff [mm]'>margin</th>"
        "<th title='from the tool [mm]'>nearest</th></tr>"
    )
    widths = "".join(f"<col style='width:{width}'>" for width in ("22px", "20px", "auto"))
    widths += f"<col style='width:{62 if added else 42}px'><col style='width:56px'>"
    table = f"<table class='vf-structures'>{widths}{head}{''.join(rows)}</table>"
    return f"<div class='vf-orders'>{table}</div>"


def _margin(own: Structure, added: tuple[float, float] | None) -> str:
    """A structure's margin [mm], or its range."""
    margin = own.margin or 0.0
    if added is None:
        return f"{1e3 * margin:.3g}"
    low, high = (f"{1e3 * (margin + more):.2f}" for more in added)
    title = f"its own {1e3 * margin:.3g} mm, and what the registration adds"
    return f"<span title='{title}'>{low}{f'–{high}' if high != low else ''}</span>"


def _button(order: str, number: int, sign: str, label: str, on: bool) -> str:
    return (
        f"<button data-vf-order='{order} {number}' aria-label='{label}' "
        f"aria-pressed='{str(on).lower()}' title='{label}'>{sign}</button>"
    )


def _state(distances: Sequence[float], holding: Sequence[int]) -> str:
    """A style sheet that writes distances [m] into the rows, and marks those that hold the tool."""
    lines = [
        f".vf-s{k} .vf-distance::after{{content:'{_mm(distance)}'}}"
        for k, distance in enumerate(distances)
    ]
    held = palette.css(palette.PART_HELD)
    lines += [
        f".vf-s{k} .vf-name{{box-shadow:inset 3px 0 {held};padding-left:6px!important}}"
        for k in holding
    ]
    return f"<style>{''.join(lines)}</style>"


def _mm(distance: float) -> str:
    return f"{1e3 * distance:.2f}" if abs(distance) < FAR else "–"


def _distances(shown: Moment) -> list[float]:
    """From the tool to each structure [m]; negative: they overlap. Empty before the first tick."""
    scene, step = shown.scene, shown.telemetry.step
    if step is None or shown.telemetry.scene != scene.version:
        return []
    options, p_tip = shown.options, np.array(step.tip.translation)
    found = []
    for one in shown.structures:
        gap = one.surface.nearest(one.seen(p_tip))[0] - options.tip_radius
        if options.rule == "certified" and options.guard_of(one.own) == "tool":
            q, arm = shown.telemetry.q, scene.arm
            parts = part_gaps(one.surface, arm, q, options.trocar, one.pose)
            gap = min(gap, float(parts.min()))
        found.append(gap)
    return found


def _holding(shown: Moment) -> list[int]:
    """Numbers of the structures whose planes hold the tool."""
    step = shown.telemetry.step
    if step is None or step.planes.fixtures is None:
        return []
    fixtures = set(step.planes.fixtures[step.multipliers > MIN_PUSH].tolist())
    structures = shown.options.anatomy
    on = [k for k, own in enumerate(structures) if own.guarded]
    return [k for f, k in enumerate(on) if f in fixtures]


def _number_of(text: object) -> int:
    """The number at the beginning of a text; −1: there is none."""
    word = str(text).partition(":")[0]
    return int(word) if word.isdecimal() and len(word) < 6 else -1


def _guard(value: object) -> str | None:
    return None if value == AS_SESSION else str(value)


def _hex(value: Any) -> str:
    red, green, blue = (int(part) for part in value)
    return f"#{red:02x}{green:02x}{blue:02x}"
