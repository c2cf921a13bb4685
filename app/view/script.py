"""The page's own script, put into viser's HTML on its way to the browser: `page.js`."""

from __future__ import annotations

import functools
import gzip
from collections.abc import Callable
from importlib import resources
from typing import Any

from websockets.http11 import Request, Response

HEAD = b"<head>"  # the script stands right behind it, before anything of viser's

Answer = Callable[[Any, Request], Response | None]


def adding(theirs: Answer) -> Answer:
    """What answers HTTP requests, with our script added to every page that it answers with."""

    @functools.wraps(theirs)
    def ours(connection: Any, request: Request) -> Response | None:
        response = theirs(connection, request)
        if response is None or not response.headers.get("Content-Type", "").startswith("text/html"):
            return response
        zipped = response.headers.get("Content-Encoding") == "gzip"
        response.body = _with_script(bytes(response.body), zipped)
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))
        return response

    return ours


@functools.cache
def script() -> str:
    """The text of the script."""
    return resources.files("app.view").joinpath("page.js").read_text(encoding="utf-8")


@functools.lru_cache(maxsize=4)
def _with_script(body: bytes, zipped: bool) -> bytes:
    """An HTML page with the script at the beginning of its head; both as they are sent."""
    page = gzip.decompress(body) if zipped else body
    page = page.replace(HEAD, HEAD + f"<script>{script()}</script>".encode(), 1)
    return gzip.compress(page) if zipped else page
