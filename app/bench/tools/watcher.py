"""A headless Chromium that displays a page, in a separate process: `-m …watcher URL`.

Separate, so that driving the browser does not load the measured interpreter. Requests on standard
input (`frames`, `join`, `leave`, `again`) are each answered by a line of JSON.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from typing import Any, Self

WINDOW = {"width": 1440, "height": 900}  # [CSS px]

# Software rendering; the rest disables what does not work in a container, and network traffic.
ARGUMENTS = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
_COUNT = """() => {
  window.seen = 0;
  const count = () => { window.seen += 1; requestAnimationFrame(count); };
  requestAnimationFrame(count);
}"""


class NoBrowser(RuntimeError):
    """No browser is available; the message says why."""


def chromium() -> str:
    """Path of a Chromium or Chrome: the variable VF_CHROMIUM, or the usual names.

    Raises:
        NoBrowser: not found.
    """
    names = (os.environ.get("VF_CHROMIUM"), "chromium", "chromium-browser", "google-chrome")
    for name in names:
        if name and (path := shutil.which(name)):
            return path
    raise NoBrowser("no Chromium found: install one, or name it in VF_CHROMIUM")


class Watcher:
    """Starts this module, or a similar one, as a process and communicates with it."""

    def __init__(self, url: str, module: str = "app.bench.tools.watcher") -> None:
        """Open the page and wait until it draws.

        Raises:
            NoBrowser: Playwright or Chromium is missing, or the page did not draw.
        """
        chromium()
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, url],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            self._answer()
        except NoBrowser:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def request(self, word: str) -> dict[str, Any]:
        """Send a request and wait for its answer."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(word + "\n")
            self._process.stdin.flush()
        except OSError as error:
            raise NoBrowser(f"the browser is gone ({error})") from None
        return self._answer()

    def close(self) -> None:
        """End browser and process. Safe to call twice."""
        if self._process.poll() is None:
            assert self._process.stdin is not None
            try:
                self._process.stdin.close()  # ends the child's loop
                self._process.wait(20)
            except (OSError, subprocess.TimeoutExpired):
                self._process.kill()
                self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        answer = json.loads(line) if line else {"error": "the browser's process ended"}
        if "error" in answer:
            raise NoBrowser(str(answer["error"]))
        return dict(answer)


def browse(work: Callable[[Any], None]) -> int:
    """In the separate process: run `work` with a browser; returns the exit code.

    Errors of Playwright, Chromium or the page are sent as the answer to the parent process.
    """
    if sys.platform.startswith("linux"):
        # Unlike this one, a user's browser does not inherit the server's raised priority.
        os.setpriority(os.PRIO_PROCESS, 0, 0)
    try:
        from playwright.sync_api import Error, sync_playwright
    except ImportError as error:
        answer(error=f"Playwright is not installed ({error}): pip install 'vf-sandbox[bench]'")
        return 1
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium(), args=list(ARGUMENTS))
            work(browser)
            browser.close()
    except (Error, NoBrowser) as error:
        answer(error=" ".join(str(error).split())[:300])
        return 1
    return 0


def answer(**fields: Any) -> None:
    """Send an answer to the parent process."""
    print(json.dumps(fields), flush=True)


def _watch(browser: Any, url: str) -> None:
    pages = [_open(browser, url)]
    answer(ready=True)
    for line in sys.stdin:
        word = line.strip()
        if word == "join":
            pages.append(_open(browser, url))
        elif word == "leave" and len(pages) > 1:
            pages.pop().context.close()
        elif word == "again":
            pages.pop(0).context.close()
            pages.insert(0, _open(browser, url))
        answer(frames=pages[0].evaluate("window.seen"), pages=len(pages))


def _open(browser: Any, url: str) -> Any:
    page = browser.new_context(viewport=WINDOW).new_page()
    page.goto(url)
    page.wait_for_selector("canvas", timeout=60_000)
    page.evaluate(_COUNT)
    return page


if __name__ == "__main__":
    sys.exit(browse(lambda browser: _watch(browser, sys.argv[1])))
