"""Subcommands of `vf-sandbox`: one module each, found by name, imported only when asked for.

A module offers `main(arguments: list[str]) -> int`, given the words after its name; what it
returns is the exit code. The first line of its docstring is its line in `vf-sandbox --help`.
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Callable

from app.console import reason
from app.words import OptionError

USAGE_ERROR = 2
INTERRUPTED = 130


def answer(program: str, work: Callable[[], int]) -> int:
    """The exit code of some work; what a user can act upon is said in one line instead of raised.

    Args:
        program: as it was called, such as "vf-sandbox mesh".
    """
    try:
        return work()
    except BrokenPipeError:
        raise  # nobody reads what is printed: see `console.closing`
    except SystemExit as end:  # after help, or what is no option
        return end.code if isinstance(end.code, int) else USAGE_ERROR
    except MemoryError:
        return _complain(program, "there is not enough memory for that")
    except (ValueError, OSError) as error:
        return _complain(program, reason(error))


def one_of(program: str, kinds: dict[str, type], arguments: list[str]) -> tuple[str, list[str]]:
    """A command's first word, one of `kinds`, and the words after it.

    Raises:
        OptionError: an unknown word.
        SystemExit: after a list of them all, for none (2) or for --help (0).
    """
    if not arguments or arguments[0] in ("-h", "--help"):
        print(f"usage: {program} {{{','.join(kinds)}}} [options]\n")
        width = max(map(len, kinds))
        for name, kind in kinds.items():
            about = (kind.__doc__ or "").strip().partition("\n\n")[0]
            indent = " " * (width + 4)
            print(
                textwrap.fill(
                    " ".join(about.split()), 79, initial_indent=f"  {name:{width}}  ",
                    subsequent_indent=indent,
                )
            )  # fmt: skip
        raise SystemExit(0 if arguments else USAGE_ERROR)
    if arguments[0] not in kinds:
        raise OptionError(f"unknown command '{arguments[0]}': choose one of {', '.join(kinds)}")
    return arguments[0], arguments[1:]


def interrupted(program: str, so_far: str) -> int:
    """Say what an interrupted command leaves; returns its exit code."""
    print(f"{program}: interrupted: {so_far}", file=sys.stderr)
    return INTERRUPTED


def _complain(program: str, message: str) -> int:
    print(f"{program}: error: {message}", file=sys.stderr)
    return USAGE_ERROR
