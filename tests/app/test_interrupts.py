"""Signals that are waited for."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from app.interrupts import interrupts

ROOT = Path(__file__).parents[2]
WAITS = """
from app.interrupts import interrupts
for _ in range(1000):
    with interrupts() as wait:
        print("ready", flush=True)
        wait()
print("done", flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_one_that_came_before_the_wait_ends_it(number: signal.Signals) -> None:
    before = signal.signal(number, signal.default_int_handler)
    try:
        with interrupts() as wait:
            os.kill(os.getpid(), number)
            wait()
            with pytest.raises(KeyboardInterrupt):  # while closing it is as always
                signal.raise_signal(number)
        assert signal.getsignal(number) is signal.default_int_handler
        assert signal.set_wakeup_fd(-1) == -1
    finally:
        signal.signal(number, before)


def test_what_is_ignored_stays_ignored() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interrupts():
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_none_is_lost_on_the_way_into_the_wait() -> None:
    with subprocess.Popen(
        [sys.executable, "-u", "-c", WAITS], stdout=subprocess.PIPE, text=True, cwd=ROOT,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as process:  # fmt: skip
        patience = threading.Timer(60.0, process.kill)
        patience.start()
        try:
            assert process.stdout is not None
            told = 0
            for line in process.stdout:
                if line == "done\n":
                    break
                process.send_signal(signal.SIGINT)
                told += 1
            assert process.wait(timeout=10) == 0
        finally:
            patience.cancel()
            process.kill()
    assert told == 1000
