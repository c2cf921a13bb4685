import math
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.kinds import Length, Maybe, Number, Place, Speed, Turn
from app.options import parse_as
from app.settings import DECLARED, Options, kind_of, number
from app.words import OptionError, format_length, parse_length, parse_speed

RADIUS, CORRIDOR, AT = (DECLARED[name].kind for name in ("radius", "corridor", "at"))
NUMBERS = sorted(name for name in DECLARED if isinstance(kind_of(name), Number))


def parse(words: list[str]) -> Options:
    return parse_as(Options, "vf-sandbox", words)


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
        RADIUS.parse(text)


@pytest.mark.parametrize("text", ["5", "0.005", "-1", "1e-3", " 20 "])
def test_a_length_without_a_unit_says_both_it_could_be(text: str) -> None:
    number = text.strip()
    for read in (parse_length, RADIUS.parse, CORRIDOR.parse):
        with pytest.raises(OptionError, match=rf"has no unit: write {number}mm .*{number}m "):
            read(text)
    with pytest.raises(OptionError, match="has no unit"):
        AT.parse(f"0,0,{text}")


@pytest.mark.parametrize(
    ("text", "metres"), [("100mm/s", 0.1), ("0.1m/s", 0.1), ("2 m/s", 2.0), ("10cm/s", 0.1)]
)
def test_speeds(text: str, metres: float) -> None:
    assert parse_speed(text) == pytest.approx(metres, rel=1e-12)
    assert parse_speed(Speed(0.0, 9.0).format(metres)) == metres


@pytest.mark.parametrize("text", ["0.1", "100", "5mm", "m/s", "1mm/min", "1/s", "fast"])
def test_what_is_no_speed_says_how_to_write_one(text: str) -> None:
    with pytest.raises(OptionError, match=r"is not a speed: write .* such as 100mm/s"):
        parse_speed(text)


@given(st.floats(1e-7, 10.0))
def test_a_printed_length_reads_back(metres: float) -> None:
    assert parse_length(format_length(metres)) == pytest.approx(metres, rel=1e-4)


def test_auto_is_a_radius() -> None:
    assert RADIUS.parse("auto") is None
    assert CORRIDOR.parse("off") is None
    assert AT.parse(" Auto") is None
    assert format_length(None) == "auto"


def test_the_command_line_defaults_are_the_options_defaults() -> None:
    assert parse([]) == Options()
    assert (Options().mesh, Options().robot, Options().rule) == ("skull-closed", "psm", "certified")
    assert (Options().radius, Options().rate) == (5e-3, 1000.0)
    assert (Options().host, Options().port) == ("127.0.0.1", 8080)


def test_the_command_line_is_read() -> None:
    words = "--mesh cube --unit mm --robot point --rule paper --radius auto --rate 500"
    words += " --host 0.0.0.0 --port 0 --standoff 0.05mm --tip-radius 1mm"
    options = parse(words.split())
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


@pytest.mark.parametrize("name", NUMBERS)
def test_panel_values_are_clamped(name: str) -> None:
    kind = number(name)
    low, high = kind.low, kind.high
    assert kind.clamped(name, low - 1.0) == low
    assert kind.clamped(name, math.inf) == high
    assert kind.clamped(name, -(10**400)) == low
    assert kind.clamped(name, (low + high) / 2) == (low + high) / 2
    for value in (math.nan, "1", True, None):
        with pytest.raises(OptionError, match=rf"{name} (nan|must be a number)"):
            kind.clamped(name, value)


def test_settings_do_not_load_the_kernels() -> None:
    code = "import sys, app.settings; sys.exit('numba' in sys.modules or 'vf' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_a_place_and_a_turn_read_back_exactly(numbers: tuple[float, float, float]) -> None:
    for kind in (Place(), Turn(), Maybe(Place(), "auto")):
        assert kind.parse(kind.format(numbers)) == numbers
        assert kind.from_json(kind.to_json(numbers)) == numbers


@given(st.floats(0.0, 10.0))
def test_a_number_reads_back_exactly(value: float) -> None:
    for kind in (Number(0.0, 10.0), Length(0.0, 10.0), Speed(0.0, 10.0)):
        assert kind.parse(kind.format(value)) == value
        assert kind.from_json(kind.to_json(value)) == value


def test_placement_on_the_command_line() -> None:
    options = parse(["--at", "-1cm,0,-12cm", "--rotate", "-90,0,45", "--up=-y"])
    assert options.at == pytest.approx((-0.01, 0.0, -0.12))
    assert options.rotate == pytest.approx((-math.pi / 2, 0.0, math.pi / 4))
    assert options.up == "-y"
    assert parse(["--at", "auto"]).at is None


@pytest.mark.parametrize("words", [["--at", "1,2"], ["--at", "here"], ["--rotate", "1,2,x"],
                                   ["--rotate", "1,2,nan"], ["--rotate", "90"]])  # fmt: skip
def test_what_is_no_placement_says_how_to_write_one(words: list[str]) -> None:
    with pytest.raises(OptionError, match=r"is not a (place|turn|length): write"):
        parse(words)
