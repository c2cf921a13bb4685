"""What the words of a command line ask for: the page, a command, or one line on what is wrong."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import pkgutil
import sys
import textwrap

import app.commands
from app.choices import check_mesh
from app.commands import answer
from app.console import closing, prepare
from app.scenarios.file import Scenario
from app.scenarios.presets import find
from app.settings import OptionError, Options, parse

ABOUT = """Drag a simulated surgical tool over anatomy; virtual fixtures keep it out.

Starts the control loop and a page for the browser, and prints the page's address; or runs one of
the commands:
"""
EXAMPLES = """
Examples:
  vf-sandbox --mesh gear --rule paper --radius 0.5mm
  vf-sandbox --scenario slide-into-the-orbit --open
  vf-sandbox --mesh scan.stl --unit mm --robot point --tip-radius 1mm
  vf-sandbox mesh check scan.stl --unit mm

vf-sandbox COMMAND --help tells more of a command, vf-sandbox --version the version."""


def run(words: list[str]) -> int:
    """Do it; returns the exit code.

    Raises:
        KeyboardInterrupt: it was interrupted; that has been said.
    """
    prepare()
    program = "vf-sandbox"
    with closing():
        try:
            if words and not words[0].startswith("-"):
                program = f"vf-sandbox {words[0]}"
                return _command(words[0], words[1:])
            if words == ["--version"]:
                import vf

                print(f"vf-sandbox {vf.__version__}")
                return 0
            return answer(program, lambda: _page(words))
        except KeyboardInterrupt:
            print(f"{program}: interrupted", file=sys.stderr)
            raise


def _page(words: list[str]) -> int:
    """Check all that can be checked at once, then start."""
    from app.serving import serve

    options, scenario = _wanted(words)
    check_mesh(options.mesh)
    return serve(options, scenario)


def _wanted(words: list[str]) -> tuple[Options, Scenario | None]:
    """What the words say, where they say nothing the scenario they name."""
    about = _about()
    options = parse(words, about)
    if options.scenario is None:
        return options, None
    scenario = find(options.scenario)
    options = parse(words, about, scenario.applied(Options()))
    if options.mesh != scenario.options.mesh:
        raise OptionError(
            f"--mesh {options.mesh} with --scenario {options.scenario}: the scenario is made for "
            f"the mesh {scenario.options.mesh}; leave one of the two out"
        )
    return options, scenario


def _command(name: str, rest: list[str]) -> int:
    known = _commands()
    if name not in known:

        def refuse() -> int:
            raise OptionError(
                f"unknown command '{name}': the commands are {', '.join(known)}; without one the "
                "page starts"
            )

        return answer("vf-sandbox", refuse)
    return int(importlib.import_module(f"app.commands.{name}").main(rest))


def _about() -> str:
    """The help text: what the page is, and a line for each command, read without importing it."""
    lines = [ABOUT]
    for name in _commands():
        spec = importlib.util.find_spec(f"app.commands.{name}")
        source = spec.loader.get_source(spec.name) if spec else None  # type: ignore[union-attr]
        doc = ast.get_docstring(ast.parse(source or "")) or ""
        lines.append(
            textwrap.fill(
                doc.splitlines()[0] if doc else "",
                width=79,
                initial_indent=f"  {name:11} ",
                subsequent_indent=" " * 14,
            )
        )
    return "\n".join([*lines, EXAMPLES])


def _commands() -> list[str]:
    return sorted(module.name for module in pkgutil.iter_modules(app.commands.__path__))
