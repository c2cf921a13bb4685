"""Which cases of a long table are tried every day; the rest are slow, and CI's."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def everyday(cases: Iterable[Any], *chosen: Any) -> list[Any]:
    """The cases for `parametrize`, all but the chosen ones marked slow."""
    table = list(cases)
    missing = [case for case in chosen if case not in table]
    assert not missing, f"no such cases: {missing}"
    return [
        case if case in chosen else pytest.param(case, marks=pytest.mark.slow) for case in table
    ]
