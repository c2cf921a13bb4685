"""Inserts the page's own script, `page.js`, into the HTML that viser serves."""

from __future__ import annotations

import functools
import gzip
from collections.abc import Callable
from importlib import resources
from typing import Any

from websockets.http11 import Request, Response

HEAD = b"<head>"  # the script follows it and so runs before viser's

Answer = Callable[[Any, Request], Response | None]


def adding(answer: Answer) -> Answer:
    """Wrap a handler of HTTP requests: add the script to every HTML page it answers with."""

    @functools.wraps(answer)
    def wrapped(connection: Any, request: Request) -> Response | None:
        response = answer(connection, request)
        if response is None or not response.headers.get("Content-Type", "").startswith("text/html"):
            return response
        zipped = response.headers.get("Content-Encoding") == "gzip"
        response.body = _with_script(bytes(response.body), zipped)
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))
        return response

    return wrapped


@functools.cache
def script() -> str:
    """The text of the script."""
    return resources.files("app.view").joinpath("page.js").read_text(encoding="utf-8")


@functools.lru_cache(maxsize=4)
def _with_script(body: bytes, zipped: bool) -> bytes:
    """An HTML page, gzipped or not, with the script at the beginning of its head."""
    page = gzip.decompress(body) if zipped else body
    page = page.replace(HEAD, HEAD + f"<script>{script()}</script>".encode(), 1)
    return gzip.compress(page) if zipped else page
