"""Every value that comes from outside has a kind, and is refused by name where it is not of it."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest

import meshes
import robots
import vf
from app import choices, kinds
from app.bench.tools import settings as bench_settings
from app.kinds import (
    File,
    Kind,
    Length,
    Maybe,
    Number,
    OneOf,
    Place,
    Switch,
    Text,
    Turn,
    Whole,
    bare,
)
from app.options import Checked, declared, option
from app.scenarios.file import Scenario, Waypoint
from app.scenarios.presets import PRESETS
from app.settings import DECLARED, Options
from app.studies.experiments import protocol, site
from app.words import OptionError
from meshes.builtin import damage, ladder


def outside(kind: Kind) -> list[Any]:
    """What a kind has to refuse."""
    none = [] if isinstance(kind, Maybe) else [None]
    limit = bare(kind)
    if isinstance(limit, Number):
        return [limit.low - 1.0, limit.high * 1.01 + 1.0, 1e300, -1e300, math.inf, -math.inf,
                math.nan, 10**400, -(10**400), "5mm", True, [1.0], *none]  # fmt: skip
    if isinstance(limit, Whole):
        return [limit.low - 1, limit.high + 1, 10**400, 1.5, math.nan, "1", False, *none]
    if isinstance(limit, OneOf):
        return ["parsec", "", limit.known[0].upper() + " ", 1, True, *none]
    if isinstance(limit, File):
        return ["", "a\0b", "x" * 5000, 3, b"x", *none]
    if isinstance(limit, Text):
        return ["", "\x1b[2J", "two\nlines", "x" * (limit.most + 1), 3, *none]
    if isinstance(limit, Switch):
        return [0, 1, "yes", *none]
    if isinstance(limit, Place):
        return [(0.0, 0.0, 1e300), (0.0, math.nan, 0.0), (2.0, 2.0, 2.0), (0.0, 0.0), "here", 1.0,
                [0.0, 0.0, 0.0], ("0", "0", "0"), *none]  # fmt: skip
    if isinstance(limit, Turn):
        return [(0.0, 1e298, 0.0), (math.inf, 0.0, 0.0), (0.0, 0.0), "0,0,90", None]
    return []


def test_a_field_that_is_not_declared_is_refused() -> None:
    @dataclasses.dataclass(frozen=True)
    class Another(Checked):
        known: int = option(Whole(0, 2), 1)
        new: float = 1.0

    with pytest.raises(KeyError, match="new"):
        Another()


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        pytest.param(kind, name, value, id=f"{kind.__name__}-{name}-{kinds.shown(value)}")
        for kind in (Options, Waypoint, Scenario, protocol.Trial)
        for name, entry in declared(kind).items()
        for value in outside(entry.kind)
    ],
)
def test_what_is_outside_a_limit_is_refused_by_name(kind: type, name: str, value: Any) -> None:
    sound: dict[type, dict[str, Any]] = {
        Options: {},
        Waypoint: {"time": 0.0, "at": (0.0, 0.0, 0.0)},
        Scenario: {"name": "x", "about": "y"},
        protocol.Trial: {"experiment": "cutting", "rule": "off"},
    }
    assert kind(**sound[kind])
    with pytest.raises(OptionError) as caught:
        kind(**{**sound[kind], name: value})
    message = str(caught.value)
    limit = bare(declared(kind)[name].kind)
    called = limit.what if isinstance(limit, OneOf) else name
    assert called in message
    assert "\n" not in message
    assert len(message) < 400
    if isinstance(limit, OneOf):
        assert ", ".join(limit.known) in message


def test_the_ends_of_every_range_are_in_it() -> None:
    for entry in DECLARED.values():
        limit = bare(entry.kind)
        if isinstance(limit, Number | Whole):
            limit.check("x", limit.low)
            limit.check("x", limit.high)
        if isinstance(limit, OneOf):
            for name in limit.known:
                limit.check("x", name)
    Length(1e-6, 1e-3).check("x", 2e-6)


def test_the_choices_are_those_of_the_libraries() -> None:
    assert robots.names() == choices.ROBOTS
    assert vf.RULES == choices.RULES
    assert vf.GUARDS == choices.GUARDS
    assert meshes.UPS == choices.AXES
    assert damage.kinds() == choices.DAMAGES
    assert meshes.FRAMES == choices.FRAMES
    assert sorted(meshes.UNITS) == sorted(choices.UNITS)
    assert meshes.names() == choices.MESHES
    assert {*meshes.catalogue(), *meshes.absent()} == {*choices.MESHES, *choices.FROM_PACKAGES}
    assert tuple(PRESETS) == choices.SCENARIOS
    assert sorted(meshes.WRITABLE) == sorted(bench_settings.FORMATS)
    assert ladder.SIZES == bench_settings.SIZES
    assert sorted(site.SEGMENTS) == sorted(choices.SKULLS)
