"""Subcommands of `vf-sandbox`: one module each, found by name, imported only when asked for.

A module offers `main(arguments: list[str]) -> int`, given the words after its name; what it
returns is the exit code. The first line of its docstring is its line in `vf-sandbox --help`.
"""
