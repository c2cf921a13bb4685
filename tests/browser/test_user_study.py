"""A study taken in a real browser: a tab that is closed, a server that is killed, a full house."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from app.recording.read import read
from app.studies.people.folder import Study
from app.studies.people.served.room import AWAY

pytestmark = pytest.mark.slow

PROTOCOL = """
format = 1
name = "Tiny"
about = "For tests."
title = "A short study"
repetitions = 1
rest = 1
[consent]
text = "You will move a simulated instrument."
[[questions]]
id = "hand"
text = "Which hand do you use?"
kind = "choice"
choices = ["left", "right"]
required = true
[[tasks]]
task = "targeting"
targets = 1
limit = 8
[[conditions]]
name = "with"
sound = true
[[conditions]]
name = "without"
rule = "off"
delay = "200ms"
[[training]]
task = "targeting"
condition = "with"
until = { time = 60 }
most = 1
"""
SERVER = """
import signal, sys
from pathlib import Path
from app.studies.people.served.front import Front
front = Front(Path(sys.argv[1]), sys.argv[2], "127.0.0.1", 0, most=2)
print(front.url, flush=True)
try:
    signal.sigwait([signal.SIGTERM])
finally:
    front.close()
"""
PATIENCE = 180_000  # for a process to start on a loaded machine [ms]


class Server:
    """The front page in a process of its own, that can be killed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.start()

    def start(self) -> None:
        code = "import signal; signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])\n"
        self.process = subprocess.Popen(
            [
                sys.executable, "-c", code + SERVER, str(self.folder / "study"),
                str(self.folder / "tiny.toml"),
            ],
            stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def end(self) -> None:
        self.process.terminate()
        self.process.wait(60)


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    (tmp_path / "tiny.toml").write_text(PROTOCOL)
    server = Server(tmp_path)
    yield server
    server.end()


@pytest.fixture
def new_tab(browser: Any) -> Iterator[Callable[[], Any]]:
    tabs: list[Any] = []

    def open_it() -> Any:
        tab = browser.new_context(
            viewport={"width": 1440, "height": 900}, device_scale_factor=0.4
        ).new_page()
        tab.set_default_timeout(PATIENCE)
        tabs.append(tab)
        return tab

    yield open_it
    for tab in tabs:
        tab.context.close()


def enter(tab: Any, server: Server, code: str) -> None:
    tab.goto(server.url)
    tab.get_by_label("Your code").fill(code)
    tab.get_by_role("button", name="Begin").click()


def begin(tab: Any, server: Server, code: str) -> None:
    """From the code to the page of the first trial."""
    enter(tab, server, code)
    tab.get_by_role("checkbox").check()
    tab.get_by_role("button", name="I take part").click()
    tab.get_by_label("right").check()
    tab.get_by_role("button", name="Continue").click()
    start(tab).wait_for()


def start(tab: Any) -> Any:
    return tab.get_by_role("button", name="Start")


def trials(server: Server, code: str) -> list[dict[str, Any]]:
    return Study.open(server.folder / "study").participant(code).finished()


def until(condition: Callable[[], object], what: str) -> None:
    due = time.monotonic() + PATIENCE / 1e3
    while not condition():
        assert time.monotonic() < due, what
        time.sleep(0.1)


def test_a_sitting_survives_a_closed_tab_and_a_killed_server(
    server: Server, new_tab: Callable[[], Any]
) -> None:
    tab = new_tab()
    begin(tab, server, "p1")
    assert "Training" in tab.inner_text("body")
    assert "with" not in tab.inner_text(".vf-task h1")
    start(tab).click()
    until(lambda: len(trials(server, "P1")) == 1, "the training")
    kept = trials(server, "P1")

    # A trial is begun, and the tab closed: it is to be done again.
    start(tab).click()
    tab.wait_for_timeout(500)
    tab.context.close()
    time.sleep(AWAY + 2.0)  # who is back before that goes on with the trial
    again = new_tab()
    enter(again, server, "P1")
    start(again).wait_for()
    assert trials(server, "P1") == kept

    # The server is killed while the trial is done.
    start(again).click()
    again.wait_for_timeout(500)
    server.kill()
    again.context.close()
    server.start()
    tab = new_tab()
    enter(tab, server, "P1")
    start(tab).wait_for()
    assert trials(server, "P1") == kept
    start(tab).click()
    tab.get_by_role("link", name="Continue").click()
    tab.get_by_role("heading", name="How was this part?").wait_for()
    tab.get_by_label("Effort").fill("80")
    tab.get_by_role("button", name="Continue").click()
    tab.get_by_role("button", name="Go on").click()
    start(tab).click()
    tab.get_by_role("link", name="Continue").click()
    tab.get_by_role("button", name="Continue").click()
    tab.get_by_text("Thank you very much").wait_for()

    done = trials(server, "P1")
    assert done[:1] == kept
    assert [one["unfinished"] for one in done] == [0, 2, 0]
    assert [one["training"] for one in done] == [True, False, False]
    assert [one["condition"] for one in done] == ["with", "with", "without"]
    for one in done:
        path = server.folder / "study/participants/P1/trials" / one["recording"]
        recording = read(path)
        assert not recording.cut
        ticks = len(recording.rows)
        # The recording ends a look at the tip later than the trial.
        assert one["duration"] <= ticks * recording.dt + 0.1
        assert one["measures"]["time"] == pytest.approx(ticks * recording.dt, abs=1e-6)
    about = json.loads((server.folder / "study/participants/P1/sitting.json").read_text())
    assert about["stage"] == "thanks"
    assert about["answers"] == {"hand": "right"}
    assert Study.open(server.folder / "study").participant("P1").tlx()["0"]["effort"] == 80


def test_two_at_once_have_a_page_each_and_the_third_is_told_to_come_back(
    server: Server, new_tab: Callable[[], Any]
) -> None:
    one, two, three = new_tab(), new_tab(), new_tab()
    begin(one, server, "P1")
    begin(two, server, "P2")
    assert one.url != two.url
    enter(three, server, "P3")
    three.get_by_text("come back in a moment").wait_for()
    start(one).click()
    start(two).click()
    until(lambda: trials(server, "P1") and trials(server, "P2"), "both trials")
    two.get_by_role("link", name="I do not want to go on").click()
    two.get_by_role("button", name="Yes, stop").click()
    two.get_by_text("You have stopped").wait_for()
    three.get_by_role("link", name="Try again").click()
    enter(three, server, "P3")
    three.get_by_role("button", name="I take part").wait_for()
    assert Study.open(server.folder / "study").codes == ["P1", "P2", "P3"]
