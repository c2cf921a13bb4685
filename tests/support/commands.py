"""The command line run as a user runs it, in a process of its own."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

from tests.support.controls import controls_of, gone

ROOT = Path(__file__).parents[2]


def page_of_command(*words: str, end: signal.Signals = signal.SIGINT) -> str:
    """Run a command that opens a page, fetch the page, end the command as asked: what it said."""
    with subprocess.Popen(
        [sys.executable, "-u", "-m", "app", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env={**os.environ, "COLUMNS": "200"},
        # A shell's background jobs ignore interrupts, and so would what they start.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as process:
        try:
            assert process.stdout is not None
            before: list[str] = []
            address = None
            for line in process.stdout:
                before.append(line)
                if address := re.search(r"Open (http://127\.0\.0\.1:\d+)", line):
                    break
            assert address is not None, (before, process.stderr and process.stderr.read())
            with urllib.request.urlopen(address[1], timeout=30) as page:
                assert page.status == 200
            controls = controls_of(process.pid)
            assert len(controls) == 1
            process.send_signal(end)
            out, err = process.communicate(timeout=30)
        finally:
            process.kill()
    assert process.returncode == 0, err
    assert "Closing." in out
    assert "Traceback" not in err
    assert gone(controls[0])
    return "".join(before)
