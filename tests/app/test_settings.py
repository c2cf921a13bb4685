import math
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.settings import RANGES, Options, in_range, parse
from app.words import (
    OptionError,
    format_length,
    format_point,
    format_speed,
    format_turn,
    parse_corridor,
    parse_length,
    parse_point,
    parse_radius,
    parse_speed,
    parse_turn,
)


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("5mm", 0.005),
        ("0.5 mm", 0.0005),
        ("0", 0.0),
        ("-0.0", 0.0),
        (".5cm", 0.005),
        ("20um", 2e-5),
        ("20µm", 2e-5),
        ("1e-3m", 1e-3),
        ("0.2in", 0.00508),
    ],
)
def test_lengths(text: str, metres: float) -> None:
    assert parse_length(text) == pytest.approx(metres, rel=1e-12)


@pytest.mark.parametrize("text", ["", "mm", "5 parsec", "5mm 3", "nan", "inf", "five", "5MM"])
def test_what_is_no_length_says_how_to_write_one(text: str) -> None:
    with pytest.raises(OptionError, match=r"is not a length: write a number and a unit.*5mm"):
        parse_length(text)
    with pytest.raises(OptionError, match="write auto"):
        parse_radius(text)


@pytest.mark.parametrize("text", ["5", "0.005", "-1", "1e-3", " 20 "])
def test_a_length_without_a_unit_says_both_it_could_be(text: str) -> None:
    number = text.strip()
    for read in (parse_length, parse_radius, parse_corridor):
        with pytest.raises(OptionError, match=rf"has no unit: write {number}mm .*{number}m "):
            read(text)
    with pytest.raises(OptionError, match="has no unit"):
        parse_point(f"0,0,{text}")


@pytest.mark.parametrize(
    ("text", "metres"), [("100mm/s", 0.1), ("0.1m/s", 0.1), ("2 m/s", 2.0), ("10cm/s", 0.1)]
)
def test_speeds(text: str, metres: float) -> None:
    assert parse_speed(text) == pytest.approx(metres, rel=1e-12)
    assert parse_speed(format_speed(metres)) == pytest.approx(metres, rel=1e-12)


@pytest.mark.parametrize("text", ["0.1", "100", "5mm", "m/s", "1mm/min", "1/s", "fast"])
def test_what_is_no_speed_says_how_to_write_one(text: str) -> None:
    with pytest.raises(OptionError, match=r"is not a speed: write .* such as 100mm/s"):
        parse_speed(text)


@given(st.floats(1e-7, 10.0))
def test_a_printed_length_reads_back(metres: float) -> None:
    assert parse_length(format_length(metres)) == pytest.approx(metres, rel=1e-4)


def test_auto_is_a_radius() -> None:
    assert parse_radius("auto") is None
    assert format_length(None) == "auto"


def test_the_command_line_defaults_are_the_options_defaults() -> None:
    assert parse([], "") == Options()
    assert (Options().mesh, Options().robot, Options().rule) == ("skull-closed", "psm", "certified")
    assert (Options().radius, Options().rate) == (5e-3, 1000.0)
    assert (Options().host, Options().port) == ("127.0.0.1", 8080)


def test_the_command_line_is_read() -> None:
    words = "--mesh cube --unit mm --robot point --rule paper --radius auto --rate 500"
    words += " --host 0.0.0.0 --port 0 --standoff 0.05mm --tip-radius 1mm"
    options = parse(words.split(), "")
    assert options == Options(
        mesh="cube", unit="mm", robot="point", rule="paper", radius=None, rate=500.0,
        host="0.0.0.0", port=0, standoff=5e-5, tip_radius=1e-3,
    )  # fmt: skip
    assert options.dt == pytest.approx(2e-3)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("radius", 0.5, "radius 500mm is outside 0.05mm to 20mm"),
        ("radius", math.nan, "radius nan is outside"),
        ("rate", 0.0, "rate 0 Hz is outside 10 Hz to 20000 Hz"),
        ("tip_radius", -1e-3, "tip_radius -1mm is outside 0mm to 5mm"),
        ("port", 70_000, "port 70000 is outside 0 to 65535"),
    ],
)
def test_numbers_out_of_range_are_named(name: str, value: float, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        Options(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("name", sorted(RANGES))
def test_panel_values_are_clamped(name: str) -> None:
    low, high = RANGES[name]
    assert in_range(name, low - 1.0) == low
    assert in_range(name, math.inf) == high
    assert in_range(name, (low + high) / 2) == (low + high) / 2
    with pytest.raises(OptionError, match="must be a number"):
        in_range(name, math.nan)


def test_settings_do_not_load_the_kernels() -> None:
    code = "import sys, app.settings; sys.exit('numba' in sys.modules or 'vf' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_a_printed_place_and_a_printed_turn_read_back(numbers: tuple[float, float, float]) -> None:
    assert parse_point(format_point(numbers)) == pytest.approx(numbers, abs=1e-9, rel=1e-4)
    assert parse_turn(format_turn(numbers)) == pytest.approx(numbers, abs=1e-9, rel=1e-6)


def test_placement_on_the_command_line() -> None:
    options = parse(["--at", "-1cm,0,-12cm", "--rotate", "-90,0,45", "--up=-y"], "")
    assert options.at == pytest.approx((-0.01, 0.0, -0.12))
    assert options.rotate == pytest.approx((-math.pi / 2, 0.0, math.pi / 4))
    assert options.up == "-y"
    assert parse(["--at", "auto"], "").at is None


@pytest.mark.parametrize("words", [["--at", "1,2"], ["--at", "here"], ["--rotate", "1,2,x"],
                                   ["--rotate", "1,2,nan"], ["--rotate", "90"]])  # fmt: skip
def test_what_is_no_placement_says_how_to_write_one(words: list[str]) -> None:
    with pytest.raises(OptionError, match=r"is not a (place|turn|length): write"):
        parse(words, "")
