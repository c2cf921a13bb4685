"""The documentation as a site (Sphinx): python -m sphinx -W docs build/site

The pages are the Markdown files beside this one, which read as well where they are. The reference
is made from the docstrings: plain text with sections as Google writes them.
"""

from __future__ import annotations

import ast
import inspect
import re
from enum import EnumType
from pathlib import Path

from sphinx.application import Sphinx

import vf

HERE = Path(__file__).parent

project = "vf-sandbox"
author = "The vf-sandbox contributors"
copyright = author
release = vf.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = f"vf-sandbox {release}"
html_copy_source = False

myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("ArrayLike", "Arrays", "FloatArray", "IntArray")}
napoleon_use_ivar = True  # attributes are said in a class's own docstring
default_role = "code"  # what stands between single backticks in a docstring


def escape(
    app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """Bars are lengths in a docstring (|y − x|) and stars are products: neither is markup."""
    for number, line in enumerate(lines):
        if not line.lstrip().startswith((":", "..")):
            pieces = re.split(r"(`+[^`]+`+)", line)
            pieces[::2] = [re.sub(r"([|*])", r"\\\1", piece) for piece in pieces[::2]]
            line = "".join(pieces)
        lines[number] = re.sub(r"(?<!`)(`[^`]+`)(?=\w)", r"\1\\ ", line)  # the plural of a name


def list_members(
    app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """An enumeration's members, each with the comment beside it."""
    if isinstance(thing, EnumType):
        comments = dict(re.findall(r"^ +(\w+) = [^#\n]*# (.*)$", inspect.getsource(thing), re.M))
        lines += [
            f"* ``{m.name}`` = {m.value}: {comments.get(m.name, '')}".rstrip(": ") for m in thing
        ]
        lines.append("")


def name_types(
    app: Sphinx, what: str, name: str, thing: object, options: object, words: str, result: str
) -> tuple[str, str]:
    """Names of array types as they are written, also where Sphinx says how it keeps them."""
    keeps = r"TypeAliasForwardRef\('(\w+)'\)"
    return tuple(re.sub(keeps, r"\1", part) if part else part for part in (words, result))


def show_examples(app: Sphinx, document: str, content: list[str]) -> None:
    """Below the table of the examples, each of them: a title, its prose, its code."""
    if document != "examples/README":
        return
    for path in sorted((HERE / "examples").glob("*.py")):
        tree = ast.parse(source := path.read_text("utf-8"))
        title, _, prose = (ast.get_docstring(tree) or "").partition("\n")
        code = "\n".join(source.splitlines()[tree.body[0].end_lineno :]).strip()
        content[0] += f"\n## {title.rstrip('.')}\n{prose}\n\n```python\n{code}\n```\n"


def setup(app: Sphinx) -> None:
    app.connect("autodoc-process-docstring", list_members, priority=100)  # napoleon's is 500
    app.connect("autodoc-process-docstring", escape, priority=900)
    app.connect("autodoc-process-signature", name_types)
    app.connect("source-read", show_examples)
