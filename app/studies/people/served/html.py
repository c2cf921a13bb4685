"""The pages of the front: code, consent, questions, workload, rest, thanks. No scripts."""

from __future__ import annotations

import math
from html import escape

from app.studies.people.protocol import Protocol, Question
from app.studies.people.sitting import SCALES, Sitting

_STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0; background: #eef1f4; color: #1d2329;
  font: 17px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 680px; margin: 7vh auto; padding: 34px 42px 30px; background: #fff;
  border-radius: 14px; box-shadow: 0 2px 14px rgba(20, 40, 60, .1); }
h1 { font-size: 27px; line-height: 1.25; margin: 0 0 .6em; }
p { margin: 0 0 1em; }
fieldset, .field { border: 0; margin: 0 0 1.5em; padding: 0; }
legend, .field > label { font-weight: 600; padding: 0; margin-bottom: .35em; display: block; }
.choice { display: flex; gap: .6em; align-items: center; padding: .45em .2em; }
.choice input { width: 20px; height: 20px; flex: none; }
input[type=text], input[type=number], textarea { font: inherit; width: 100%; padding: .55em .7em;
  border: 1px solid #9aa7b3; border-radius: 8px; }
input[type=range] { width: 100%; accent-color: #0072b2; height: 28px; }
.ends { display: flex; justify-content: space-between; font-size: 14px; color: #55606b; }
.about { color: #55606b; font-size: 15px; margin: -.2em 0 .3em; }
button, .button { font: inherit; font-weight: 600; padding: .65em 1.5em; border: 0; cursor: pointer;
  border-radius: 9px; background: #0072b2; color: #fff; text-decoration: none;
  display: inline-block; }
button:focus-visible, a:focus-visible, input:focus-visible { outline: 3px solid #56b4e9;
  outline-offset: 2px; }
button.quiet { background: none; color: #55606b; font-weight: 400; text-decoration: underline; }
.wrong { background: #fdecea; color: #8a1f11; padding: .7em 1em; border-radius: 8px; }
.bar { height: 10px; border-radius: 5px; background: #e3e8ed; overflow: hidden; margin: 0 0 1.4em; }
.bar div { height: 100%; background: #009e73; }
footer { margin-top: 1.8em; font-size: 14px; color: #55606b; }
footer a { color: inherit; }
@media (max-width: 720px) { main { margin: 0; min-height: 100vh; border-radius: 0;
  padding: 26px 20px; box-shadow: none; } button, .button { width: 100%; text-align: center; } }
"""
RATED = {
    "mental": (
        "Mental demand",
        "How much thinking and deciding was needed?",
        "Low",
        "High",
    ),
    "physical": ("Physical demand", "How much physical effort was needed?", "Low", "High"),
    "temporal": ("Temporal demand", "How hurried did you feel?", "Low", "High"),
    "performance": ("Performance", "How well did you do what was asked?", "Perfect", "Failure"),
    "effort": ("Effort", "How hard did you have to work for it?", "Low", "High"),
    "frustration": ("Frustration", "How irritated, stressed or annoyed were you?", "Low", "High"),
}
"""Title, question and ends of each scale of the NASA-TLX."""


def page(title: str, body: str, *, again: float | None = None, stop: bool = False) -> str:
    """A whole page.

    Args:
        again: the browser loads it again after this time [s].
        stop: with a link to stop taking part.
    """
    refresh = "" if again is None else f'<meta http-equiv="refresh" content="{math.ceil(again)}">'
    end = '<footer><a href="/stop">I do not want to go on</a></footer>' if stop else ""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"{refresh}<title>{escape(title)}</title><style>{_STYLE}</style></head>"
        f"<body><main><h1>{escape(title)}</h1>{body}{end}</main></body></html>"
    )


def paragraphs(text: str) -> str:
    """Text whose paragraphs are apart by empty lines."""
    parts = (" ".join(part.split()) for part in text.strip().split("\n\n"))
    return "".join(f"<p>{escape(part)}</p>" for part in parts)


def _wrong(message: str) -> str:
    return f'<p class="wrong" role="alert">{escape(message)}</p>' if message else ""


def enter(protocol: Protocol, wrong: str = "", code: str = "") -> str:
    """Where a participant enters the code."""
    return page(
        protocol.title,
        f"{_wrong(wrong)}"
        '<form method="post" action="/enter"><div class="field"><label for="code">Your code</label>'
        '<p class="about">As you were given it. With the same code you come back to where you '
        "were.</p>"
        f'<input type="text" id="code" name="code" value="{escape(code)}" maxlength="24" required '
        'autofocus autocomplete="off" autocapitalize="characters" spellcheck="false"></div>'
        "<button>Begin</button></form>",
    )


def consent(sitting: Sitting, wrong: str = "") -> str:
    """What the participant agrees to."""
    own = sitting.study.protocol.consent
    return page(
        sitting.study.protocol.title,
        f"{paragraphs(own.text)}{_wrong(wrong)}"
        '<form method="post" action="/consent"><label class="choice">'
        '<input type="checkbox" name="agree" value="yes" required>'
        f"<span>{escape(own.agree)}</span></label><p></p>"
        "<button>I take part</button></form>"
        '<form method="post" action="/consent">'
        '<button class="quiet" name="agree" value="no">I do not take part</button></form>',
    )


def questions(sitting: Sitting, wrong: str = "", given: dict[str, str] | None = None) -> str:
    """The questions before the training."""
    rows = "".join(_question(one, given or {}) for one in sitting.study.protocol.questions)
    return page(
        "Some questions first",
        f'{_wrong(wrong)}<form method="post" action="/answers">{rows}<button>Continue</button>'
        "</form>",
        stop=True,
    )


def _question(one: Question, given: dict[str, str]) -> str:
    name, value = f"q-{escape(one.id)}", given.get(one.id, "")
    needed = " required" if one.required else ""
    if one.kind == "choice":
        fields = "".join(
            f'<label class="choice"><input type="radio" name="{name}" value="{escape(choice)}"'
            f"{' checked' if choice == value else ''}{needed}><span>{escape(choice)}</span></label>"
            for choice in one.choices
        )
        return f"<fieldset><legend>{escape(one.text)}</legend>{fields}</fieldset>"
    if one.kind == "scale":
        middle = value or f"{math.floor(0.5 * (one.low + one.high)):g}"
        ends = one.ends or (f"{one.low:g}", f"{one.high:g}")
        field = _slider(name, one.low, one.high, 1.0, middle, *ends)
    elif one.kind == "number":
        field = (
            f'<input type="number" id="{name}" name="{name}" min="{one.low:g}" '
            f'max="{one.high:g}" step="any" value="{escape(value)}"{needed}>'
        )
    else:
        field = (
            f'<input type="text" id="{name}" name="{name}" maxlength="1000" '
            f'value="{escape(value)}"{needed}>'
        )
    return f'<div class="field"><label for="{name}">{escape(one.text)}</label>{field}</div>'


def _slider(
    name: str, low: float, high: float, step: float, value: str, left: str, right: str
) -> str:
    return (
        f'<input type="range" id="{name}" name="{name}" min="{low:g}" max="{high:g}" '
        f'step="{step:g}" value="{escape(value)}">'
        f'<div class="ends"><span>{escape(left)}</span><span>{escape(right)}</span></div>'
    )


def workload(sitting: Sitting, wrong: str = "") -> str:
    """The NASA-TLX about the block that was done last."""
    rows = "".join(
        f'<div class="field"><label for="{name}">{RATED[name][0]}</label>'
        f'<p class="about">{RATED[name][1]}</p>'
        f"{_slider(name, 0, 100, 5, '50', *RATED[name][2:])}</div>"
        for name in SCALES
    )
    return page(
        "How was this part?",
        f"{_wrong(wrong)}<p>About the part you have just done. Move each slider to where it fits."
        f'</p><form method="post" action="/tlx">{rows}<button>Continue</button></form>',
        stop=True,
    )


def rest(sitting: Sitting) -> str:
    """A rest between two blocks."""
    left = sitting.rest_left
    done = f'<div class="bar"><div style="width:{100 * sitting.progress:.0f}%"></div></div>'
    if left > 0.0:
        wait = f"{left / 60:.0f} minutes" if left > 90 else f"{math.ceil(left)} seconds"
        body = f"<p>Lean back and rest your hand and eyes, for about {wait} more.</p>"
        return page("Time for a rest", done + body, again=min(left, 10.0), stop=True)
    body = (
        "<p>Take as long as you like. The next part may feel different.</p>"
        '<form method="post" action="/rested"><button>Go on</button></form>'
    )
    return page("Time for a rest", done + body, stop=True)


def wait() -> str:
    """While the participant's session is starting."""
    return page(
        "One moment",
        "<p>Your session is being prepared. This page goes on by itself.</p>",
        again=2.0,
        stop=True,
    )


def stop() -> str:
    """Whether the participant really wants to stop."""
    return page(
        "Do you want to stop?",
        "<p>You can stop now without giving a reason. What you have done so far is kept under your "
        "code; tell the person who runs the study if you want it deleted.</p>"
        '<form method="post" action="/withdraw"><button>Yes, stop</button></form>'
        '<p></p><a href="/go">No, go on</a>',
    )


def over(sitting: Sitting | None) -> str:
    """The end: thanks."""
    if sitting is None:
        return page("Thank you", "<p>You do not take part, and nothing about you was kept.</p>")
    said = (
        "All of it is done. Thank you very much for taking part!"
        if sitting.stage == "thanks"
        else "You have stopped. Thank you for what you have done."
    )
    return page(
        "Thank you",
        f"<p>{said}</p><p>Your code is <b>{escape(sitting.code)}</b>. Keep it if you may want your "
        "data deleted later. You can close this page.</p>",
    )


def full(most: int) -> str:
    """All places are taken."""
    people = "one person" if most == 1 else f"{most} people"
    return page(
        "Please come back in a moment",
        f"<p>This computer can take {people} at a time so that everyone’s instrument follows "
        "without delay, and all places are taken just now. Nothing is lost: try again in some "
        'minutes, with the same code.</p><p><a class="button" href="/">Try again</a></p>',
    )
