"""The front page over HTTP: forms, places and what is refused; rooms are stand-ins."""

from __future__ import annotations

import http.client
import re
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import urlencode

import pytest

from app.studies.people.folder import Study
from app.studies.people.served import places
from app.studies.people.served.front import Front
from app.studies.people.sitting import SCALES, Sitting

PROTOCOL = """
format = 1
name = "Tiny"
about = "For tests."
title = "A <test>"
repetitions = 1
rest = 0
[consent]
text = "First.\\n\\nSecond & last."
[[questions]]
id = "hand"
text = "Which hand?"
kind = "choice"
choices = ["left", "right"]
required = true
[[questions]]
id = "games"
text = "How often?"
kind = "scale"
high = 6
ends = ["never", "daily"]
[[tasks]]
task = "targeting"
[[conditions]]
name = "a"
[[conditions]]
name = "b"
"""


class Room:
    """Stands for a process that serves a page at once."""

    started: list[str] = []  # noqa: RUF012
    port: int | None = 4711
    token = None

    def __init__(self, folder: Path, code: str, host: str, front: str) -> None:
        self.started.append(code)
        self.ended = False

    def nudge(self) -> None:
        pass

    def close(self) -> None:
        self.ended = True


class Browser:
    """Keeps cookies and follows what it is told to."""

    def __init__(self, front: Front) -> None:
        self.front = front
        self.cookies: dict[str, str] = {}
        self.headers: dict[str, str] = {}

    def ask(self, method: str, path: str, form: dict[str, str] | None = None) -> tuple[int, str]:
        connection = http.client.HTTPConnection("127.0.0.1", self.front.port, timeout=10)
        headers = {"Cookie": "; ".join(f"{k}={v}" for k, v in self.cookies.items())}
        if form is not None:
            headers["Content-Type"] = "application/x-www-form-urlencoded"
            headers["Origin"] = f"http://127.0.0.1:{self.front.port}"
        connection.request(
            method, path, None if form is None else urlencode(form), headers | self.headers
        )
        answer = connection.getresponse()
        body = answer.read().decode()
        for name, value in answer.getheaders():
            if name == "Set-Cookie":
                assert "HttpOnly" in value
                assert "SameSite=Strict" in value
                key, _, text = value.partition(";")[0].partition("=")
                self.cookies[key] = text
        connection.close()
        if answer.status == 303:
            to = answer.getheader("Location") or ""
            return self.ask("GET", to) if to.startswith("/") else (303, to)
        return answer.status, body

    def post(self, path: str, **form: str) -> tuple[int, str]:
        return self.ask("POST", path, form)


@pytest.fixture
def front(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Front]:
    (tmp_path / "tiny.toml").write_text(PROTOCOL)
    monkeypatch.setattr(places, "Place", Room)
    monkeypatch.setattr(Room, "started", [])
    front = Front(tmp_path / "study", str(tmp_path / "tiny.toml"), "127.0.0.1", 0, most=2)
    yield front
    front.close()


def done(front: Front, code: str) -> Sitting:
    """Let the room do the next trial."""
    sitting = Sitting(Study.open(front.study.path), code)
    sitting.finish(
        sitting.next_trial, started=datetime(2026, 1, 1, tzinfo=UTC), duration=1.0, completed=True,
        measures={},
    )  # fmt: skip
    return sitting


def test_a_participant_goes_through_all_of_it(front: Front) -> None:
    one = Browser(front)
    status, text = one.ask("GET", "/")
    assert status == 200
    assert "A &lt;test&gt;" in text
    _, text = one.post("/enter", code=" p1 ")
    assert "<p>First.</p><p>Second &amp; last.</p>" in text
    assert not Room.started, "no process before consent"
    _, text = one.post("/consent", agree="yes")
    assert "Which hand?" in text
    assert Room.started == ["P1"]
    status, text = one.post("/answers", **{"q-games": "3"})
    assert status == 400
    assert "needs an answer" in text
    assert 'value="3"' in text, "what was answered is kept"
    assert one.post("/answers", **{"q-hand": "left", "q-games": "3"}) == (
        303, "http://127.0.0.1:4711/",
    )  # fmt: skip
    sitting = done(front, "P1")
    _, text = one.ask("GET", "/go")
    assert len(re.findall('type="range"', text)) == 6
    _, text = one.post("/tlx", **dict.fromkeys(SCALES, "70"))
    assert "/rested" in text
    assert one.post("/rested")[0] == 303
    done(front, "P1")
    _, text = one.post("/tlx", **dict.fromkeys(SCALES, "20"))
    assert "Thank you" in text
    assert sitting.look() == "thanks"
    assert sitting.files.tlx()["0"] == {"condition": "a", **dict.fromkeys(SCALES, 70.0)}
    assert sitting.files.sitting()["answers"] == {"hand": "left", "games": 3.0}


def test_two_at_once_the_third_later(front: Front) -> None:
    one, two, three = Browser(front), Browser(front), Browser(front)
    one.post("/enter", code="P1")
    two.post("/enter", code="P2")
    status, text = three.post("/enter", code="P3")
    assert status == 503
    assert "come back in a moment" in text
    assert "2 people" in text
    assert front.study.codes == ["P1", "P2"], "who is refused is not entered"
    assert one.post("/enter", code="p1")[0] == 200, "who is there keeps the place"
    two.post("/withdraw")
    assert three.post("/enter", code="P3")[0] == 200


def test_who_comes_back_after_the_server_was_killed_goes_on(front: Front) -> None:
    one = Browser(front)
    one.post("/enter", code="P1")
    one.post("/consent", agree="yes")
    again = Front(front.study.path, str(front.study.path / "protocol.toml"), "127.0.0.1", 0)
    try:
        other = Browser(again)
        assert "Which hand?" in other.post("/enter", code="P1")[1]
        assert Sitting(again.study, "P1").number == 0
    finally:
        again.close()


def test_who_declines_or_stops_is_let_go(front: Front) -> None:
    one = Browser(front)
    one.post("/enter", code="P1")
    assert "nothing about you was kept" in one.post("/consent", agree="no")[1]
    assert front.study.codes == []
    one.post("/enter", code="P2")
    one.post("/consent", agree="yes")
    assert "/withdraw" in one.ask("GET", "/stop")[1]
    assert "You have stopped" in one.post("/withdraw")[1]
    assert Sitting(front.study, "P2").stage == "withdrawn"


@pytest.mark.parametrize("code", ["", "a b", "../x", "x" * 30, "<b>", "-"])
def test_what_is_no_code_is_said_and_enters_nobody(front: Front, code: str) -> None:
    status, text = Browser(front).post("/enter", code=code)
    assert status == 400
    assert "letters, digits or hyphens" in text
    assert "<b>" not in text
    assert front.study.codes == []


def test_other_sites_and_names_are_refused(front: Front) -> None:
    for header, value, status in (
        ("Host", "evil.example", 421),
        ("Origin", "http://evil.example", 403),
        ("Origin", "null", 403),
    ):
        one = Browser(front)
        one.headers = {header: value}
        assert one.post("/enter", code="P1")[0] == status, (header, value)
    assert front.study.codes == []
    assert Browser(front).ask("GET", "/nowhere")[0] == 404


def test_a_forged_cookie_leads_to_the_beginning(front: Front) -> None:
    one = Browser(front)
    for code in ("../..", "P9", "%00"):
        one.cookies = {f"vf-study-code-{front.port}": code}
        assert 'action="/enter"' in one.ask("GET", "/go")[1]
        assert 'action="/enter"' in one.post("/consent", agree="no")[1]


def test_others_reach_it_with_the_token_alone(tmp_path: Path) -> None:
    (tmp_path / "tiny.toml").write_text(PROTOCOL)
    front = Front(tmp_path / "open", str(tmp_path / "tiny.toml"), "0.0.0.0", 0)
    try:
        one = Browser(front)
        assert one.ask("GET", "/")[0] == 403
        assert one.ask("GET", "/?" + front.url.partition("?")[2])[0] == 200
        assert one.ask("GET", "/")[0] == 200, "by the cookie"
    finally:
        front.close()
