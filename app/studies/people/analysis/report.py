"""The report of a study: one page of HTML, with everything in it."""

from __future__ import annotations

from html import escape

from app.console import count
from app.studies.people.analysis import figures, mixed, power, words
from app.studies.people.analysis.found import Analysis
from app.studies.people.analysis.quantities import WORKLOAD
from app.studies.results import html

SIMULATED = (
    "Simulated participants. They test the protocol and the analysis, and predict what a model of "
    "an operator does; they are no evidence about people."
)
NOT_A_DEVICE = "Measured in a simulator for research and teaching, which is not a medical device."
_STYLE = (
    "h2{margin-top:2.2em;border-bottom:2px solid #0072b2;padding-bottom:.15em}h3{margin-top:1.6em}"
    ".w{overflow-x:auto}.f li{margin:.3em 0}.n{color:#555;font-size:13px}"
    "nav a{margin-right:1em}tr:nth-child(even) td{background:#f7f9fb}"
    "body{max-width:1080px}td,th{white-space:nowrap}.p td{white-space:normal}"
    "summary{cursor:pointer}"
)
_SECTIONS = (
    ("found", "Findings"), ("people", "Participants"), ("tasks", "Tasks"), ("tlx", "Workload"),
    ("effects", "Effects"), ("model", "Mixed models"), ("learning", "Learning"),
    ("next", "The next study"), ("how", "How it was computed"),
)  # fmt: skip
_HOW = (
    "The value of a participant under a condition is the mean over the repetitions of the task; "
    "training does not count. Conditions are compared in pairs by two-sided paired t-tests. "
    "“Corrected” is Holm’s correction over all comparisons of this study, workload included: with "
    "no effect at all, at most 5 % of such studies have a false finding, or more than one. d_z is "
    "the mean difference over the standard deviation of the differences, with its interval by the "
    "noncentral t. The signed ranks (Wilcoxon) do not assume normal differences, and are not "
    "corrected. Intervals have 95 % each and are not corrected.",
    "Mixed models have all trials: condition, block and repetition as effects, a random intercept "
    "for each participant and for each participant under a condition, by REML; their tests have "
    "(participants − 1) × (conditions − 1) degrees of freedom and are not corrected.",
    "Learning is the slope over the trials of a task with the means of the conditions evened out, "
    "tested over participants, corrected over all curves.",
    "The number for the next study is that of a single paired t-test at 5 %; “cautious” takes the "
    "end of the effect’s interval that is nearer to none. A result without significance does not "
    "show that there is no difference: look at its interval.",
)


def render(found: Analysis) -> str:
    """The report.

    Raises:
        ImportError: matplotlib is not installed.
    """
    data = found.data
    parts = [html.said([data.about, NOT_A_DEVICE], "n")]
    if data.simulated:
        many = "" if data.simulated == len(data.people) else f"{data.simulated} of them are: "
        parts.append(html.said([many + SIMULATED], "c"))
    parts.append("<nav>" + "".join(f"<a href='#{i}'>{n}</a>" for i, n in _SECTIONS) + "</nav>")
    made = (_findings, _people, _tasks, _workload, _effects, _models, _learning, _next)
    for (anchor, name), section in zip(_SECTIONS, made, strict=False):
        parts.append(f"<h2 id='{anchor}'>{name}</h2>{section(found)}")
    parts.append(f"<h2 id='how'>How it was computed</h2>{html.said([*_HOW, found.versions], 'n')}")
    return html.document(f"{data.title}: analysis", "".join(parts), _STYLE)


def _findings(found: Analysis) -> str:
    lines = "".join(f"<li>{escape(line)}</li>" for line in words.findings(found.contrasts))
    return html.said(words.about(found.data)) + f"<ul class='f'>{lines}</ul>"


def _people(found: Analysis) -> str:
    data = found.data
    rows = [
        [p.code, str(p.number), " → ".join(p.order), p.stage,
         f"{len(p.measured)} of {data.wanted}", str(len(p.trials) - len(p.measured)),
         str(sum(not one.completed for one in p.measured)),
         str(sum(one.unfinished for one in p.trials)),
         f"{len(p.tlx)} of {len(data.conditions)}"]
        for p in data.people
    ]  # fmt: skip
    heading = ("code", "row of the square", "order", "stage", "trials", "in training",
               "goal not reached", "begun again", "ratings")  # fmt: skip
    missing = [*words.incomplete(data), *data.problems]
    table = f"<details><summary>Each participant</summary>{_wide(html.table(heading, rows))}"
    return html.said(missing, "c") + table + "</details>"


def _tasks(found: Analysis) -> str:
    data, parts = found.data, list[str]()
    for task in data.tasks:
        parts.append(f"<h3>{escape(task)}</h3>")
        parts.append(_wide(html.table(*words.descriptions(data, task))))
        if any(data.means(task, name) for name in ("time", "sparc", "contacts")):
            parts.append(figures.people(data, task))
        rows = [words.compared(one)[1:] for one in found.contrasts if one.task == task]
        parts.append(_wide(html.table(words.COMPARED[1:], rows)))
    heading, rows = words.touched(data)
    if rows:
        parts.append("<h3>Contacts by structure</h3>")
        parts.append(_wide(html.table(heading, rows)))
        parts.append(html.said(["A trial, mean of the participants’ means; not tested."], "n"))
    parts.append(html.said(["*: a difference after correction."], "n"))
    return "".join(parts)


def _workload(found: Analysis) -> str:
    data = found.data
    if not any(one.tlx for one in data.people):
        return html.said(["No block was rated."])
    rows = [words.compared(one)[1:] for one in found.contrasts if one.task == WORKLOAD]
    return (
        _wide(html.table(*words.descriptions(data, WORKLOAD)))
        + figures.workload(data)
        + _wide(html.table(words.COMPARED[1:], rows))
        + html.said(["More is more load; of performance, 0 is perfect."], "n")
    )


def _effects(found: Analysis) -> str:
    if not any(one.comparison for one in found.contrasts):
        return html.said(["No comparison was possible."])
    note = "Filled: a difference after correction. Intervals beyond ±6 are cut off."
    return figures.forest(found.contrasts) + html.said([note], "n")


def _models(found: Analysis) -> str:
    if found.models is None:
        return html.said([f"Left out: {mixed.MISSING}."], "c")
    rows = [row for one in found.models for row in words.modelled(one)]
    return _wide(html.table(words.MODEL, rows)) + html.said(
        [f"Effects of conditions are differences from {found.data.conditions[0]}."], "n"
    )


def _learning(found: Analysis) -> str:
    parts = []
    for task in found.data.tasks:
        own = [one for one in found.curves if one.task == task]
        parts.append(f"<h3>{escape(task)}</h3>")
        if any(len(one.number) > 1 for one in own):
            parts.append(figures.learning(own))
        parts.append(_wide(html.table(words.LEARNT[1:], [words.learnt(one)[1:] for one in own])))
    return "".join(parts)


def _next(found: Analysis) -> str:
    people = max((len(one.codes) for one in found.contrasts), default=0)
    parts = [_wide(html.table(words.NEXT, words.next_study(found.contrasts)))]
    if people >= 2:
        least = power.detectable(people)
        parts.append(html.said([
            f"With {count(people, 'participant')}, as here, a single test finds an effect d_z of "
            f"{least:.2f} or more with a power of 80 %."
        ]))  # fmt: skip
    return "".join(parts)


def _wide(table: str) -> str:
    return f"<div class='w'>{table}</div>"
