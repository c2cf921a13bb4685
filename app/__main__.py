"""The command line: `vf-sandbox` starts the page, `vf-sandbox <command> …` runs a command."""

from __future__ import annotations

import sys

from app import interrupts


def main(arguments: list[str] | None = None) -> int:
    """Run the command line (default: `sys.argv`); returns the exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    interrupts.install()
    try:
        from app.cli import run

        return run(words)
    except KeyboardInterrupt as stop:
        return interrupts.exit_code(stop)
    finally:
        if arguments is None:
            interrupts.uninstall()


if __name__ == "__main__":
    sys.exit(main())
