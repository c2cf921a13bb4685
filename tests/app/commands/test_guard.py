"""`vf-sandbox guard` as a user runs it."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from app.__main__ import main
from tests.support.counterparts import ROOT, counterpart, free_port


def started(*words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-u", "-m", "app", "guard", *words],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=ROOT,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip


def said_until(process: subprocess.Popen[str], words: str) -> str:
    assert process.stdout is not None
    before = ""
    for line in process.stdout:
        before += line
        if re.search(words, line):
            return before
    raise AssertionError(f"{words!r} was not said:\n{before}")


def test_it_guards_without_a_page_until_ctrl_c(tmp_path: Path) -> None:
    arm_port, console_port = free_port(), free_port()
    log = tmp_path / "arm.npz"
    guard = started(
        "--arm", f"socket://127.0.0.1:{arm_port}?age=200ms", "--master",
        f"socket://127.0.0.1:{console_port}?age=200ms", "--structure", "sphere", "--margin", "1mm",
    )  # fmt: skip
    try:
        said = said_until(guard, "Ready")
        assert "Guarding sphere" in said
        assert "The arm is not enabled yet" in said
        assert "Not a medical device" in said
        with (
            counterpart("arm", arm_port, "--log", str(log)) as arm,
            counterpart("console", console_port, "--follow") as console,
        ):
            said_until(guard, r"DISABLED.*arm \d+ Hz")
            time.sleep(0.3)
            console.tell("enable")
            said_until(guard, "^ENABLED; arm")
            time.sleep(1.0)
            assert "body/servo_cf" in console.asked()["heard"]
            console.quit()
            arm.quit()
        said_until(guard, "ENABLED, holds: the arm is silent")
        guard.send_signal(signal.SIGINT)
        assert guard.stdout is not None
        rest = guard.stdout.read()
        assert guard.wait(30) == 0
        assert "Closing." in rest
        assert "Traceback" not in rest
    finally:
        guard.kill()
    found = np.load(log)
    assert len(found["goals"]) > 100
    assert "state_command enable" in found["words"].tolist()
    # Nothing moved before: the first set-point is at the joints that the arm began with.
    assert np.abs(found["goals"][0, 1:] - found["told"][0]).max() < 1e-2


def test_with_enable_and_the_autopilot_it_needs_no_console(tmp_path: Path) -> None:
    port = free_port()
    log = tmp_path / "arm.npz"
    guard = started("--arm", f"socket://127.0.0.1:{port}?age=200ms", "--mesh", "sphere",
                    "--enable", "--page", "--port", "0")  # fmt: skip
    try:
        said = said_until(guard, "Ready")
        page = re.search(r"http://127\.0\.0\.1:\d+", said)
        assert page is not None
        with urllib.request.urlopen(page[0], timeout=30) as answer:
            assert answer.status == 200
        with counterpart("arm", port, "--log", str(log)) as arm:
            time.sleep(4.0)
            arm.quit()
        guard.send_signal(signal.SIGINT)
        assert guard.wait(30) == 0
    finally:
        guard.kill()
    assert np.ptp(np.load(log)["truth"], axis=0).max() > 0.01


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ((), "what is to be guarded?"),
        (("--mesh", "sphere", "--master", "page"), "--master page needs --page"),
        (("--mesh", "sphere", "--arm", "serial:1"), "choose one of sim, socket://HOST:PORT"),
        (("--mesh", "nothing-there"), "nothing-there"),
        (("--mesh", "sphere", "--loss", "200%"), "loss 2 is outside 0 to 1"),
        (("--mesh", "sphere", "--delay", "80"), "not a time with its unit"),
    ],
)
def test_what_cannot_be_is_refused_at_once(
    words: tuple[str, ...], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["guard", *words]) == 2
    shown = capsys.readouterr()
    assert reason in " ".join((shown.err + shown.out).split())


def test_a_port_that_is_taken_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
        assert main(["guard", "--mesh", "sphere", "--arm", f"socket://127.0.0.1:{port}"]) == 2
    assert f"127.0.0.1:{port}: cannot listen there" in capsys.readouterr().err
