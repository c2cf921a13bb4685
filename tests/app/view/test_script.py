"""The page's own script in what viser serves."""

from __future__ import annotations

import gzip
import http.client
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from app.session import Session
from app.settings import Options
from app.view import Page
from app.view.script import adding, script


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with Session(Options(mesh="cube", robot="point", rate=500.0)) as session:
        yield session


def test_the_page_is_served_with_its_script_first(session: Session) -> None:
    page = Page(session, "127.0.0.1", 0)
    try:
        for coding in ("gzip", "identity"):
            connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=30)
            connection.request("GET", "/", headers={"Accept-Encoding": coding})
            answer = connection.getresponse()
            body = answer.read()
            assert answer.status == 200
            assert int(answer.headers["Content-Length"]) == len(body)
            text = (gzip.decompress(body) if coding == "gzip" else body).decode()
            assert text.count(script()) == 1
            assert text.index(script()) < text.index("<script", text.index(script()))
            assert text.index("<script") == text.index(f"<script>{script()}")
            connection.close()
    finally:
        page.close()


def test_only_pages_get_the_script() -> None:
    response = SimpleNamespace(headers={"Content-Type": "image/png"}, body=b"<head>")
    assert adding(lambda *_: response)(None, None).body == b"<head>"  # type: ignore
    assert adding(lambda *_: None)(None, None) is None  # type: ignore[arg-type]
