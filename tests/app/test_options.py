"""An option is one entry: a declaration alone puts it wherever options are."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from app.kinds import Length, Listed, Many, Maybe, OneOf, Repeated, Switch, Whole
from app.kinds import Path as PathKind
from app.options import Checked, Scope, declared, like, option, parse_as
from app.settings import DECLARED, Options
from app.words import OptionError

ROOT = Path(__file__).parents[2]

ONE_ENTRY = """
from dataclasses import dataclass
from app import settings
from app.kinds import Number
from app.options import Scope, declared, option

@dataclass(frozen=True)
class Options(settings.Options):
    damping: float = option(Number(0.0, 9.0, "s/m"), 2.0, "How thick the air is.", Scope.FIXTURE)

# As if it stood in the declaration: nothing else was imported yet.
settings.Options, settings.DECLARED = Options, declared(Options)
"""

USED = """
import contextlib, io, sys, time
from pathlib import Path
from app import cli
from app.recording.read import read
from app.scenarios.file import Scenario, dumps, loads
from app.words import Refused
from app.session import Session

told = io.StringIO()
with contextlib.redirect_stdout(told), contextlib.suppress(SystemExit):
    cli._parsed(["--help"])
assert "--damping NUMBER" in told.getvalue() and "How thick the air is." in told.getvalue()
options, _ = cli._parsed(["--damping", "3", "--mesh", "cube", "--robot", "point"])
assert options.damping == 3.0
for words, line in ((["--damping", "99"], "damping 99 s/m is outside 0 s/m to 9 s/m"),
                    (["--damping", "x"], "damping: 'x' is not a number")):
    try:
        cli._parsed(words)
    except ValueError as error:
        assert str(error) == line, error
    else:
        raise AssertionError(words)

scenario = Scenario("x", "y", options)
assert '"damping": 3.0' in dumps(scenario)
assert loads(dumps(scenario)).options.damping == 3.0

with Session(options) as session:
    session.record(Path(sys.argv[1]))
    begun = session.latest().tick
    while session.latest().tick < begun + 2:  # else the change may be in force at the first row
        time.sleep(0.01)
    assert session.set(damping=99).damping == 9.0
    try:
        session.set(damping="much")
    except Refused as error:
        assert str(error).startswith("damping must be a number from 0 s/m"), error
    begun = session.latest().tick
    while session.latest().tick < begun + 20:
        time.sleep(0.01)
    session.stop_recording()
assert [plant.damping for _, plant in read(Path(sys.argv[1])).plants] == [3.0, 9.0]
print("all of it")
"""


def test_one_entry_is_all_that_an_option_takes(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", ONE_ENTRY + USED, str(tmp_path / "run.vfrec")],
        capture_output=True, text=True, timeout=300, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout == "all of it\n"


def test_what_stands_where_is_as_it_was() -> None:
    """Names in files and on the command line are a promise: they do not follow from a slip."""
    server = {"host", "port", "open", "upload_limit", "record", "scenario"}
    server |= {"master", "enable", "delay", "jitter", "loss"}
    assert {name for name, entry in DECLARED.items() if not entry.recorded} == server | {"frame"}
    shared = {name for name, entry in DECLARED.items() if entry.shared}
    assert set(DECLARED) - shared == server | {"arm", "rate", "stale_after"}
    for name in (
        "corridor", "rule", "radius", "standoff", "approach", "tip_radius", "scale",
        "lock_orientation",
        "tip_speed", "force_gain",
    ):  # fmt: skip
        assert DECLARED[name].scope in (Scope.FIXTURE, Scope.TELEOPERATION), name
    assert all(entry.about and entry.scope for entry in DECLARED.values())


@dataclass(frozen=True)
class Cut(Checked):
    """A cut.

    With a paragraph of its own."""

    file: Path = option(PathKind(), about="Where.", positional=True)
    depth: float | None = option(Maybe(Length(0.0, 1e-2), "all"), 1e-3, "How deep.")
    sides: tuple[str, ...] = option(Many(OneOf("side", ("left", "right"))), ("left",), "Which.")
    passes: tuple[int, ...] = option(Repeated(Whole(1, 9)), (), "Given for each.")
    tools: tuple[str, ...] = option(Listed(OneOf("tool", ("saw", "burr"))), ("saw",), "In a word.")
    dry: bool = option(Switch(), False, "Without doing it.")
    rule: str = like(Options, "rule", "off", "Another help.")


def test_every_kind_of_word_is_read() -> None:
    assert parse_as(Cut, "cut", ["x.txt"]) == Cut(Path("x.txt"))
    words = "x.txt --depth all --sides left right --passes 1 --passes 2 --tools burr,saw,burr --dry"
    assert parse_as(Cut, "cut", words.split()) == Cut(
        Path("x.txt"), None, ("left", "right"), (1, 2), ("burr", "saw"), True
    )
    before = Cut(Path("y"), 2e-3, ("right",), (), ("burr",), True, "all")
    assert parse_as(Cut, "cut", ["z", "--no-dry"], default=before) == Cut(
        Path("z"), 2e-3, ("right",), (), ("burr",), False, "all"
    )


def test_help_is_of_the_declaration(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parse_as(Cut, "cut", ["--help"])
    told = capsys.readouterr().out
    assert told.startswith("A cut.\n\nWith a paragraph of its own.\n")
    for line in (
        "--depth all|LENGTH", "--sides left|right …", "--tools saw|burr,…", "--dry, --no-dry",
        "How deep. (default: 1mm)", "Another help. (default: off)",
    ):  # fmt: skip
        assert line in told


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("--depth 1", "depth: '1' has no unit: write 1mm"),
        ("--depth 1m", "depth 1000mm is outside 0mm to 10mm"),
        ("--sides up", "unknown side 'up': choose one of left, right"),
        ("--passes x", "passes: 'x' is not a whole number"),
        ("--passes 10", "passes 10 is outside 1 to 9"),
        ("--tools ,", "tools must have one value or more"),
        ("--tools saw,axe", "unknown tool 'axe'"),
        ("--rule soft", "unknown rule 'soft'"),
    ],
)
def test_what_a_word_may_not_be(words: str, line: str) -> None:
    with pytest.raises(OptionError) as caught:
        parse_as(Cut, "cut", ["x", *words.split()])
    assert line in str(caught.value)


def test_one_that_is_like_another_has_its_kind() -> None:
    assert declared(Cut)["rule"].kind is DECLARED["rule"].kind
    assert Cut(Path("x")).rule == "off"
