"""The command line as a user meets it: exit codes and one clear line for what is wrong."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import tomllib
from pathlib import Path

import pytest

import vf
from app import choices
from app.__main__ import main
from app.commands import COMMANDS
from app.serving import bind_problem
from tests.support.commands import page_of_command

ROOT = Path(__file__).parents[2]


def run(*words: str, **changes: str) -> subprocess.CompletedProcess[str]:
    """Run a command in 80 columns; `changes` are of the environment."""
    environment = {**os.environ, "COLUMNS": "80", **changes}
    return subprocess.run(
        [sys.executable, "-m", "app", *words],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=ROOT,
        env=environment,
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
            "vf-sandbox: error: unknown rule 'soft': choose one of certified, paper, all, off, "
            "nearest, sdf",
        ),
        (["--rate", "1e9"], "vf-sandbox: error: rate 1e+09 Hz is outside 10 Hz to 20000 Hz"),
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
    files = (ROOT / "app" / "commands").glob("[a-z]*.py")
    modules = {path.stem.replace("_", "-") for path in files}
    assert set(COMMANDS) == modules
    for command in COMMANDS:
        assert re.search(rf"^  {command} +[A-Z]", result.stdout, re.MULTILINE), command
    for known in (choices.ROBOTS, choices.RULES, choices.AXES, choices.UNITS):
        assert "|".join(known) in result.stdout
    told = re.sub(r"[\s│|]+", "", result.stdout)
    for known in (choices.DAMAGES, choices.MESHES, choices.SCENARIOS):
        assert all(name in told for name in known)
    assert max(map(len, result.stdout.splitlines())) <= 80


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
def test_the_page_comes_up_says_where_and_closes_on_interrupt(number: signal.Signals) -> None:
    told = page_of_command("--mesh", "cube", "--robot", "point", "--port", "0", end=number)
    assert "loading the mesh cube" in told
    assert "preparing the kernels" in told


# Every command, with help, in 80 columns, in any encoding, into any pipe

HELPS = [
    ["--help"],
    *([name, "--help"] for name in ("mesh", "bench", "experiment", "study", "verify", "replay")),
    *(["mesh", name, "--help"] for name in ("list", "check", "repair", "from-volume", "labels")),
    *(["experiment", name, "--help"] for name in ("tracing", "power", "calibrate", "replay")),
    *(["bench", name, "--help"] for name in ("runtime", "peers", "loop", "view", "soak")),
]


@pytest.mark.parametrize("words", HELPS, ids=" ".join)
def test_every_help_fits_80_columns(
    words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert all(len(line) <= 80 for line in out.splitlines() if not line.startswith("usage:"))


def test_the_version_is_that_of_the_library() -> None:
    told = run("--version")
    assert told.returncode == 0
    assert told.stdout == f"vf-sandbox {vf.__version__}\n"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "version" not in project["project"]
    assert project["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "vf.__version__"}


WRONG = [
    (["mesh", "frob"], "choose one of list, check, repair, from-volume, labels"),
    (["mesh", "check", "no/such.stl"], "no/such.stl"),
    (["mesh", "check", "cube", "--unit", "parsec"], "unknown unit 'parsec': choose one of m, cm"),
    (["mesh", "repair", "cube", "/proc/nowhere/x.ply"], "/proc/nowhere"),
    (["experiment", "sewing"], "choose one of tracing, cutting, margins, power, calibrate, replay"),
    (["experiment", "cutting", "--rule", "all"], "unknown rule 'all': choose one of certified, pa"),
    (["experiment", "cutting", "--noise", "1"], "'1' has no unit: write 1mm for millimetres"),
    (["experiment", "cutting", "--rate", "1e300"], "rate 1e+300 Hz is outside 50 Hz to 5000 Hz"),
    (["experiment", "replay", "--trial", "no.json"], "no.json: no such file or directory"),
    (["experiment", "replay", "--port", "-1"], "port -1 is outside 0 to 65535"),
    (["experiment", "power", "--seeds", "0"], "seeds 0 is outside 1 to 100000"),
    (["study", "--meshes", "skull,cube"], "unknown skull 'cube': choose one of skull, skull-coar"),
    (["study", "--rules", "off,soft"], "unknown rule 'soft': choose one of off, certified, paper"),
    (["study", "--noise", "0.35"], "'0.35' has no unit: write 0.35mm for millimetres"),
    (["study", "--length", "9m"], "length 9000mm is outside 1mm to 30mm"),
    (["study", "--workers", "-1"], "workers -1 is outside 0 to 1000"),
    (["study", "--operators", "1", "--out", "/proc/nowhere"], "/proc/nowhere"),
    (["verify", "--mesh", "skul"], "unknown mesh 'skul' (did you mean 'skull'?)"),
    (["verify", "--seed", "-1"], "seed -1 is outside 0 to"),
    (["replay", "no.vfrec"], "no.vfrec: cannot be read (No such file"),
    (["replay", "."], ".: cannot be read (Is a directory)"),
    (
        ["bench", "walk"],
        "choose one of runtime, structures, motion, peers, loop, rooms, devices, view,",
    ),
    (["bench", "runtime", "--rules", "soft"], "unknown rule 'soft'"),
    (["bench", "runtime", "--radii", "5"], "'5' has no unit: write 5mm for millimetres"),
    (["bench", "loop", "--rate", "1e300"], "rate 1e+300 Hz is outside 10 Hz to 20000 Hz"),
    (["bench", "meshes", "--out", "/proc/nowhere"], "/proc/nowhere"),
    (["--mesh", "skul"], "unknown mesh 'skul' (did you mean 'skull'?)"),
    (["--damage", "rust"], "unknown damage 'rust': choose one of none, unwelded"),
    (["--unit", "parsec"], "unknown unit 'parsec': choose one of m, cm, mm, in"),
    (["--at", "0,0,1e300m"], "at 0m,0m,1e+300m is more than 2 m from the origin"),
    (["--rotate", "0,0,1e298"], "rotate 0,0,1e+298 is outside -720 to 720 degrees"),
    (["--tip-speed", "1"], "'1' is not a speed: write a number and mm/s or m/s"),
    (["--radius", "5"], "'5' has no unit: write 5mm for millimetres, 5m for metres"),
    (["--seed", "-1"], "seed -1 is outside 0 to"),
    (["--scenario", "./"], "unknown scenario './': choose one of push-on-the-skull"),
    (["--scenario", "/proc"], "/proc: cannot be read (Is a directory)"),
]


@pytest.mark.parametrize(("words", "reason"), WRONG, ids=lambda x: " ".join(x)[:40])
def test_what_is_wrong_is_one_line_of_plain_words(
    words: list[str],
    reason: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("vf-sandbox")
    assert ": error: " in err
    assert reason in err
    assert err.count("\n") == 1
    assert "Errno" not in err
    assert list(tmp_path.iterdir()) == []


def test_choices_are_refused_before_the_libraries_load() -> None:
    code = """
import sys
from app.__main__ import main
for words in (["--robot", "r2d2"], ["--mesh", "skul"], ["--scenario", "sadle"], ["--help"],
              ["verify", "--rule", "soft"], ["study", "--rules", "soft"],
              ["experiment", "cutting", "--mesh", "cube"], ["bench", "runtime", "--rules", "x"],
              ["mesh", "check", "cube", "--unit", "parsec"]):
    main(words)
    loaded = {"numba", "pinocchio", "trimesh", "viser", "vf", "meshes"} & set(sys.modules)
    if loaded:
        sys.exit(f"{words}: {loaded}")
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "encoding",
    ["ascii", *(pytest.param(name, marks=pytest.mark.slow) for name in ("latin-1", "utf-8"))],
)
def test_output_is_printed_in_any_encoding(encoding: str) -> None:
    words = ["mesh", "check", "torus", "--examine", "0"]
    told = subprocess.run(
        [sys.executable, "-m", "app", *words],
        capture_output=True,
        timeout=120,
        cwd=ROOT,
        env={**os.environ, "PYTHONIOENCODING": encoding, "PYTHONUTF8": "0", "LC_ALL": "C"},
    )
    assert told.returncode == 0, told.stderr
    size = {"ascii": b"80 x 80 x 20 mm", "latin-1": b"80 \xd7 80 \xd7 20 mm",
            "utf-8": "80 × 80 × 20 mm".encode()}  # fmt: skip
    assert size[encoding] in told.stdout
    assert b"?" not in told.stdout


@pytest.mark.parametrize(
    "words",
    [
        ["--help"],
        pytest.param(["mesh", "check", "torus", "--examine", "0"], marks=pytest.mark.slow),
    ],
    ids=lambda words: words[0],
)
def test_whoever_reads_may_stop(words: list[str]) -> None:
    read, write = os.pipe()
    with subprocess.Popen(
        [sys.executable, "-m", "app", *words], stdout=write, stderr=subprocess.PIPE, cwd=ROOT
    ) as process:
        os.close(write)
        os.close(read)
        _, err = process.communicate(timeout=60)
    assert err == b""
    assert process.returncode == 141


@pytest.mark.slow
def test_a_closed_and_a_full_output_are_no_traceback() -> None:
    closed = subprocess.run(
        ["sh", "-c", f'exec "{sys.executable}" -m app mesh check torus --examine 0 >&-'],
        capture_output=True, text=True, timeout=60, cwd=ROOT,
    )  # fmt: skip
    assert closed.returncode == 0
    assert closed.stderr == ""
    if Path("/dev/full").exists():
        with Path("/dev/full").open("w") as full:
            told = subprocess.run(
                [sys.executable, "-m", "app", "mesh", "check", "torus", "--examine", "0"],
                stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, cwd=ROOT,
            )  # fmt: skip
        assert told.returncode == 2
        assert told.stderr == "vf-sandbox mesh: error: no space left on device\n"


# Ctrl-C

LONG: list[list[str]] = [
    ["mesh", "check", "skull-fine", "--examine", "1000000"],
    ["verify", "--mesh", "cube", "--steps", "100000000"],
    ["experiment", "calibrate", "--trials", "100"],
    ["experiment", "cutting", "--trials", "1000", "--mesh", "skull-coarse", "--out", "{folder}"],
    ["study", "--workers", "0", "--meshes", "skull-coarse", "--out", "{folder}"],
    ["bench", "runtime", "--out", "{folder}"],
]


@pytest.mark.parametrize("words", LONG, ids=lambda words: " ".join(words[:2]))
@pytest.mark.parametrize(
    "delay",
    [pytest.param(d, marks=pytest.mark.slow) for d in (0.2, 0.7, 1.5, 2.5, 4.0, 6.0)],
)
def test_an_interrupt_at_any_moment_ends_any_command(
    words: list[str], delay: float, tmp_path: Path
) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", ANNOUNCED, *(w.format(folder=tmp_path / "out") for w in words)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as process:  # fmt: skip
        patience = threading.Timer(60.0, process.kill)
        patience.start()
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "armed\n"
            # At whatever it is doing after so long: any moment will do.
            threading.Event().wait(delay)
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=60)
        finally:
            patience.cancel()
            process.kill()
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "interrupted" in err.splitlines()[-1]
    assert not list(tmp_path.rglob("*.part"))


ANNOUNCED = """
import sys
from app import interrupts
from app.__main__ import main
interrupts.install()
print("armed", flush=True)
sys.argv[0] = "vf-sandbox"
sys.exit(main())
"""
