"""Pages of HTML that are one file: titles, tables, sentences and figures."""

from __future__ import annotations

import html
from collections.abc import Sequence

_STYLE = (
    "body{font:15px/1.45 system-ui,sans-serif;max-width:960px;margin:2em auto;padding:0 1em}"
    "table{border-collapse:collapse;font-size:13px}td,th{padding:.25em .6em;text-align:right;"
    "border-bottom:1px solid #ddd}td:first-child,th:first-child{text-align:left}"
    ".p td{text-align:left}svg{max-width:100%;height:auto}.c{background:#fff3e0;padding:.6em}"
)


def document(title: str, body: str, style: str = "") -> str:
    """A page with a title over a body of HTML; `style` is added to the usual one."""
    return (
        "<!doctype html><html lang='en'><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width'>"
        f"<title>{html.escape(title)}</title><style>{_STYLE}{style}</style>"
        f"<h1>{html.escape(title)}</h1>{body}</html>\n"
    )


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], kind: str = "") -> str:
    """A table; `kind` is its class: `p` has all columns on the left."""
    head = "".join(f"<th>{html.escape(c)}</th>" for c in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>" for row in rows
    )
    begin = f"<table class='{kind}'>" if kind else "<table>"
    return f"{begin}<tr>{head}</tr>{body}</table>"


def said(sentences: Sequence[str], kind: str = "") -> str:
    """Paragraphs; `kind` is their class: `c` is a caution."""
    begin = f"<p class='{kind}'>" if kind else "<p>"
    return "".join(f"{begin}{html.escape(line)}</p>" for line in sentences)
