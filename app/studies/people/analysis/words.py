"""What an analysis found, in cells and sentences, for the terminal and the report."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from app.console import count
from app.studies.people.analysis import power
from app.studies.people.analysis.contrasts import Contrast
from app.studies.people.analysis.data import Data, Person
from app.studies.people.analysis.learning import Curve
from app.studies.people.analysis.mixed import Mixed
from app.studies.people.analysis.quantities import MEASURES, TLX, WORKLOAD, Quantity

COMPARED = (
    "task", "measure", "difference", "mean [95 %]", "p", "p, corrected", "p, signed ranks",
    "d_z [95 %]", "n",
)  # fmt: skip
NEXT = ("task", "measure", "difference", "d_z", "for 80 %", "for 90 %", "for 80 %, cautious")
LEARNT = ("task", "measure", "from the first trial to the last [95 %]", "p", "p, corrected", "n")
MODEL = ("task", "measure", "effect", "estimate [95 %]", "p", "together", "spread: participants",
         "participant × condition", "trials", "n", "note")  # fmt: skip
NONE = "–"


def number(value: float, digits: int = 3) -> str:
    """A number with this many digits; a dash for one that is not finite."""
    return f"{value:.{digits}g}" if math.isfinite(value) else NONE


def p_value(p: float) -> str:
    if not math.isfinite(p):
        return NONE
    return "< 0.0001" if p < 1e-4 else f"{p:.2g}" if p < 0.01 else f"{p:.2f}"


def between(one: Contrast) -> str:
    return f"{one.second} − {one.first}"


def compared(one: Contrast) -> list[str]:
    """A row of `COMPARED`."""
    begin = [one.task, one.quantity.titled, between(one)]
    c, scale = one.comparison, one.quantity.scale
    if c is None:
        return [*begin, one.why, *[NONE] * 4, str(len(one.codes))]
    return [
        *begin, f"{scale * c.difference:+.3g} [{scale * c.low:+.3g}, {scale * c.high:+.3g}]",
        p_value(c.p), p_value(one.corrected) + (" *" if one.significant else ""),
        p_value(one.wilcoxon), f"{c.effect:+.2f} [{c.effect_low:+.2f}, {c.effect_high:+.2f}]",
        str(len(one.codes)),
    ]  # fmt: skip


def findings(contrasts: Sequence[Contrast]) -> list[str]:
    """The differences there are after correction, one sentence each; or that there is none."""
    said = []
    for one in contrasts:
        c = one.comparison
        if c is None or not one.significant:
            continue
        more = c.difference > 0.0
        unit = f" {one.quantity.unit}" if one.quantity.unit else ""
        ends = sorted(one.quantity.scale * abs(x) for x in (c.low, c.high))
        good = "" if one.quantity.more is None else "better; "
        good = "worse; " if good and more != one.quantity.more else good
        said.append(
            f"{_subject(one)}: {number(one.quantity.scale * abs(c.difference))}{unit} "
            f"{'more' if more else 'less'} with {one.second} than with {one.first} ({good}"
            f"95 %: {number(ends[0])} to {number(ends[1])}{unit}; p {_p(one.corrected)} after "
            f"correction, {count(len(one.codes), 'participant')})."
        )
    tested = sum(one.comparison is not None for one in contrasts)
    if not tested:
        return ["No comparison was possible: every test needs two participants."]
    if not said:
        return [f"None of {count(tested, 'comparison')} shows a difference after correction."]
    return said


def _subject(one: Contrast) -> str:
    return one.quantity.label if one.task == WORKLOAD else f"{one.task}, {one.quantity.label}"


def about(data: Data) -> list[str]:
    """Who took part, and what is missing."""
    done = sum(one.complete for one in data.people)
    trials = sum(len(one.measured) for one in data.people)
    said = [
        f"{count(len(data.people), 'participant')}, {done} of them complete; "
        f"{trials:,} of {count(data.wanted * len(data.people), 'trial')} done, and "
        f"{sum(len(p.trials) - len(p.measured) for p in data.people)} in training."
    ]
    given_up = sum(not one.completed for p in data.people for one in p.measured)
    if given_up:
        said.append(
            f"Ended before the goal was reached: {count(given_up, 'trial')}. Such trials count "
            "like the others; their times are shorter than what the task would have taken."
        )
    holes = [
        f"{missing} of {quantity.label} in {task}"
        for task in data.tasks for quantity in MEASURES
        if (missing := data.missing(task, quantity.name))
    ]  # fmt: skip
    if holes:
        said.append(f"Values that are not defined, left out: {', '.join(holes)}.")
    return said


def incomplete(data: Data) -> list[str]:
    """Those who are not complete, by code, one sentence each."""
    return [
        f"{one.code}: {_state(one)}, {len(one.measured)} of {data.wanted} trials and "
        f"{len(one.tlx)} of {len(data.conditions)} ratings. What there is counts wherever both "
        "conditions of a comparison were done."
        for one in data.people
        if not one.complete
    ]


def _state(person: Person) -> str:
    if person.stage == "withdrawn":
        return "withdrew"
    return f"not finished (now at: {person.stage})"


def descriptions(data: Data, task: str) -> tuple[list[str], list[list[str]]]:
    """Mean ± standard deviation over the participants' means: heading, a row for each measure."""
    quantities = (TLX,) if task == WORKLOAD else MEASURES
    rows = []
    for quantity in quantities:
        means = data.means(task, quantity.name)
        rows.append([quantity.titled, *(_spread(quantity, means, c) for c in data.conditions)])
    return ["measure", *data.conditions], rows


def _spread(quantity: Quantity, means: dict[str, dict[str, float]], condition: str) -> str:
    values = [quantity.scale * one[condition] for one in means.values() if condition in one]
    if not values:
        return NONE
    deviation = f" ± {number(float(np.std(values, ddof=1)), 2)}" if len(values) > 1 else ""
    return f"{number(float(np.mean(values)))}{deviation} (n = {len(values)})"


def touched(data: Data) -> tuple[list[str], list[list[str]]]:
    """Contacts with each structure, a trial, mean of the participants: heading and rows."""
    rows = []
    for task in data.tasks:
        for name in data.structures:
            means = data.means(task, name)
            if means:
                cells = []
                for condition in data.conditions:
                    values = [one[condition] for one in means.values() if condition in one]
                    cells.append(number(float(np.mean(values))) if values else NONE)
                rows.append([task, name.removeprefix("contacts "), *cells])
    return ["task", "structure", *data.conditions], rows


def next_study(contrasts: Sequence[Contrast]) -> list[list[str]]:
    """Rows of `NEXT`: participants that the next study needs to find such effects."""
    rows = []
    for one in contrasts:
        c = one.comparison
        if c is None:
            continue
        cautious = power.cautious(c)
        rows.append(
            [one.task, one.quantity.label, between(one), f"{c.effect:+.2f}",
             _needed(c.effect, 0.8), _needed(c.effect, 0.9),
             _needed(cautious, 0.8) if cautious else "not known: may be none"]
        )  # fmt: skip
    return rows


def _needed(effect: float, wanted: float) -> str:
    found = power.needed(effect, wanted)
    return f"over {power.MOST:,}" if found is None else f"{found:,}"


def learnt(one: Curve) -> list[str]:
    """A row of `LEARNT`."""
    scale = one.quantity.scale
    change = NONE
    if math.isfinite(one.change):
        change = (
            f"{scale * one.change:+.3g} [{scale * one.change_low:+.3g}, "
            f"{scale * one.change_high:+.3g}]"
        )
    mark = " *" if one.significant else ""
    return [one.task, one.quantity.titled, change, p_value(one.p), p_value(one.corrected) + mark,
            str(one.participants)]  # fmt: skip


def modelled(one: Mixed) -> list[list[str]]:
    """Rows of `MODEL`, one for each effect."""
    scale = one.quantity.scale
    begin = [one.task, one.quantity.titled]
    if not one.effects:
        return [[*begin, NONE, NONE, NONE, NONE, NONE, NONE, NONE, str(one.participants),
                 one.problem]]  # fmt: skip
    together = f"F({one.degrees[0]}, {one.degrees[1]}) = {number(one.f)}, p {_p(one.p)}"
    spreads = [number(scale * spread, 2) for spread in one.spreads]
    return [
        [*begin, effect.name,
         f"{scale * effect.estimate:+.3g} [{scale * effect.low:+.3g}, {scale * effect.high:+.3g}]",
         p_value(effect.p),
         *([together, *spreads, str(one.participants), one.problem] if k == 0 else [""] * 6)]
        for k, effect in enumerate(one.effects)
    ]  # fmt: skip


def _p(p: float) -> str:
    text = p_value(p)
    return text if text.startswith("<") else f"= {text}"
