"""The command line as a user meets it: exit codes and one clear line for what is wrong."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from app.__main__ import bind_problem

ROOT = Path(__file__).parents[2]


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "app", *words],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=ROOT,
    )


def complaint(result: subprocess.CompletedProcess[str]) -> str:
    """The one line on stderr of a run that was refused."""
    assert result.returncode == 2, result
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert "Traceback" not in result.stderr
    return lines[0]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            ["--robot", "r2d2", "--port", "0"],
            "vf-sandbox: error: unknown robot 'r2d2': choose one of psm, point, panda, ur5",
        ),
        (
            ["--rule", "soft", "--port", "0"],
            "vf-sandbox: error: unknown rule 'soft': choose one of certified, paper, all, off",
        ),
        (["--rate", "1e9"], "vf-sandbox: error: rate 1e+09 is outside 10 to 20000"),
        (["--port", "70000"], "vf-sandbox: error: port 70000 is outside 0 to 65535"),
        (["--radius", "1m"], "vf-sandbox: error: radius 1000mm is outside 0.05mm to 20mm"),
    ],
)
def test_values_that_are_refused(words: list[str], line: str) -> None:
    assert complaint(run(*words)) == line


def test_an_unknown_mesh_lists_the_known_ones() -> None:
    line = complaint(run("--mesh", "skul", "--port", "0"))
    assert line.startswith("vf-sandbox: error: unknown mesh 'skul'")
    assert "cube" in line
    assert "torus" in line


def test_a_file_that_is_no_mesh_is_named(tmp_path: Path) -> None:
    path = tmp_path / "notes.stl"
    path.write_text("not a mesh")
    assert str(path) in complaint(run("--mesh", str(path), "--port", "0"))


@pytest.mark.parametrize("option", ["--radius", "--standoff", "--tip-radius"])
def test_a_bad_length_says_how_to_write_one(option: str) -> None:
    line = complaint(run(option, "5 furlongs"))
    assert "'5 furlongs' is not a length: write a number and a unit" in line
    assert "such as 5mm" in line


def test_an_unknown_command_is_named() -> None:
    line = complaint(run("frobnicate"))
    assert "unknown command 'frobnicate'" in line
    assert "the page starts" in line


def test_an_unknown_option_is_a_usage_error() -> None:
    result = run("--frobnicate", "1")
    assert result.returncode == 2
    assert "--frobnicate" in result.stderr
    assert "Traceback" not in result.stderr


def test_help_shows_the_defaults() -> None:
    result = run("--help")
    assert result.returncode == 0
    for word in ("--mesh", "skull", "--radius", "5mm", "--port", "8080", "127.0.0.1"):
        assert word in result.stdout
    commands = [path.stem for path in (ROOT / "app" / "commands").glob("[a-z]*.py")]
    assert commands
    for command in commands:
        assert f"vf-sandbox {command}: " in result.stdout


def test_a_taken_port_is_told_before_anything_is_built() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        result = run("--port", str(port))
        line = complaint(result)
        assert f"port {port} on 127.0.0.1 is taken" in line
        assert "--port" in line
        assert result.stdout == ""
        assert bind_problem("127.0.0.1", port) is not None
    assert bind_problem("127.0.0.1", port) is None


@pytest.mark.parametrize("host", ["203.0.113.7", "no such host"])
def test_an_address_that_is_not_ours_is_told_and_does_not_hang(host: str) -> None:
    line = complaint(run("--host", host))
    assert f"cannot listen on host '{host}', port 8080" in line
    assert "such as 127.0.0.1" in line


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_page_comes_up_says_where_and_closes_on_interrupt(
    number: signal.Signals, page_of_command: Callable[..., str]
) -> None:
    told = page_of_command("--mesh", "cube", "--robot", "point", "--port", "0", end=number)
    assert "loading the mesh cube" in told
    assert "preparing the kernels" in told
