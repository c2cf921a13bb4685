"""Dispatches the command line: starts the page, runs a command, or prints one line of error."""

from __future__ import annotations

import sys
from dataclasses import replace

from app.choices import NO_MESH, check_mesh
from app.commands import COMMANDS, answer, call, listing, one_of
from app.console import flushed_output, prepare
from app.options import parse_as
from app.scenarios.file import Scenario
from app.scenarios.presets import find
from app.settings import Options
from app.words import OptionError

ABOUT = f"""Drag a simulated surgical tool over anatomy; virtual fixtures keep it out.

Starts the control loop and a page for the browser, and prints the page's address; or runs one of
the commands:

{listing(COMMANDS)}

Examples:
  vf-sandbox --mesh gear --rule paper --radius 0.5mm
  vf-sandbox --scenario slide-into-the-orbit --open
  vf-sandbox --mesh bone.stl --structure nerve.stl --margin 1mm --unit mm
  vf-sandbox --mesh scan.stl --unit mm --robot point --tip-radius 1mm
  vf-sandbox mesh check scan.stl --unit mm

vf-sandbox COMMAND --help tells more of a command, vf-sandbox --version the version."""


def run(words: list[str]) -> int:
    """Run the command line `words`; returns the exit code.

    Raises:
        KeyboardInterrupt: interrupted; the message has been printed.
    """
    prepare()
    program = "vf-sandbox"
    with flushed_output():
        try:
            if words and not words[0].startswith("-"):
                program = f"vf-sandbox {words[0]}"
                more = "; without one the page starts"
                return answer(
                    "vf-sandbox", lambda: call(one_of(COMMANDS, words[0], more), words[1:])
                )
            if words == ["--version"]:
                import vf

                print(f"vf-sandbox {vf.__version__}")
                return 0
            return answer(program, lambda: _page(words))
        except KeyboardInterrupt:
            print(f"{program}: interrupted", file=sys.stderr)
            raise


def _page(words: list[str]) -> int:
    """Check the options before the libraries are imported, then start the page."""
    from app.serving import serve

    options, scenario = _parsed(words)
    check_mesh(options.mesh)
    for one in options.structures:
        check_mesh(one.file)
    return serve(options, scenario)


def _parsed(words: list[str]) -> tuple[Options, Scenario | None]:
    """Options from the words; the defaults are those of the scenario they name, if any."""
    options = parse_as(Options, "vf-sandbox", words, ABOUT)
    if options.scenario is None:
        if options.structures and not any(word.split("=")[0] == "--mesh" for word in words):
            options = replace(options, mesh=NO_MESH)  # the first structure is the mesh
        return options, None
    scenario = find(options.scenario)
    options = parse_as(Options, "vf-sandbox", words, ABOUT, scenario.applied(Options()))
    if options.mesh != scenario.options.mesh:
        raise OptionError(
            f"--mesh {options.mesh} with --scenario {options.scenario}: the scenario is made for "
            f"the mesh {scenario.options.mesh}; leave one of the two out"
        )
    return options, scenario
