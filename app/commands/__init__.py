"""The commands of `vf-sandbox`: one module each, imported on demand.

A module has `KINDS`: for each subcommand the dataclass of its options, whose docstring is its help,
and the function that runs it and returns the exit code. A command without subcommands has one entry
named "". The optional `MISSING` says how to install a missing library.

Commands are dispatched here and not by tyro, whose subcommands would need the modules of all
commands to print help or to refuse a name.
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Callable, Mapping
from importlib import import_module

from app.console import reason
from app.options import parse_as
from app.words import OptionError

USAGE_ERROR = 2
INTERRUPTED = 130
COMMANDS = {
    "bench": "Measure: run time, other libraries, the control thread, the page, files, an hour of "
    "operation.",
    "experiment": "The paper's experiments with a simulated operator: tracing, cutting, power, "
    "replay.",
    "guard": "Guard a real arm: between a master and an arm that are elsewhere, over sockets.",
    "mesh": "Meshes: list the catalogue, check a file, repair it, make one from a volume.",
    "replay": "Repeat a recorded session without page and clock, compare it bit for bit, write it "
    "as CSV or MCAP.",
    "study": "Many simulated trials over a grid of operators, skulls, rules and noise, on Dask.",
    "user-study": "A study with people, or simulated ones: serve, simulate, analyse, delete.",
    "verify": "Attack the fixtures with adversarial hands and judge every step by an independent "
    "oracle.",
}
"""Help of each command."""


def call(command: str, words: list[str]) -> int:
    """Run one of `COMMANDS` with the words after its name; returns the exit code."""
    program = f"vf-sandbox {command}"
    module = import_module(f"app.commands.{command.replace('-', '_')}")

    def work() -> int:
        called, rest, name = program, words, ""
        if "" not in module.KINDS:
            kinds = {
                name: (kind.__doc__ or "").partition("\n\n")[0]
                for name, (kind, _) in module.KINDS.items()
            }
            if not words or words[0] in ("-h", "--help"):
                print(f"usage: {program} {{{','.join(kinds)}}} [options]\n")
                print(listing(kinds))
                return 0 if words else USAGE_ERROR
            name, rest = one_of(kinds, words[0]), words[1:]
            called = f"{program} {name}"
        kind, do = module.KINDS[name]
        options = parse_as(kind, called, rest)
        try:
            return int(do(options))
        except ImportError as error:
            if not hasattr(module, "MISSING"):
                raise
            raise OptionError(f"{error}: {module.MISSING}") from None

    return answer(program, work)


def one_of(known: Mapping[str, str], word: str, more: str = "") -> str:
    """The word, if it is a known command.

    Raises:
        OptionError: an unknown command.
    """
    if word not in known:
        raise OptionError(f"unknown command '{word}': choose one of {', '.join(known)}{more}")
    return word


def listing(known: Mapping[str, str]) -> str:
    """Names with their help, in 79 columns."""
    width = max(map(len, known))
    return "\n".join(
        textwrap.fill(
            " ".join(about.split()),
            79,
            initial_indent=f"  {name:{width}}  ",
            subsequent_indent=" " * (width + 4),
        )
        for name, about in known.items()
    )


def answer(program: str, work: Callable[[], int]) -> int:
    """The exit code of some work; expected errors are printed in one line instead of raised.

    Args:
        program: prefix of the message, such as "vf-sandbox mesh".
    """
    try:
        return work()
    except BrokenPipeError:
        raise  # handled by `console.flushed_output`
    except SystemExit as end:  # after help or a usage error
        return end.code if isinstance(end.code, int) else USAGE_ERROR
    except MemoryError:
        return _complain(program, "there is not enough memory for that")
    except (ValueError, OSError) as error:
        return _complain(program, reason(error))


def interrupted(program: str, so_far: str) -> int:
    """Print what an interrupted command has done so far; returns its exit code."""
    print(f"{program}: interrupted: {so_far}", file=sys.stderr)
    return INTERRUPTED


def _complain(program: str, message: str) -> int:
    print(f"{program}: error: {message}", file=sys.stderr)
    return USAGE_ERROR
