"""`bench soak`: what counts as growth."""

from __future__ import annotations

import pytest

from app.bench import soak


def sampled(**series: list[float]) -> list[dict[str, float]]:
    """Samples of an uneventful soak, but for what is given."""
    calm = {"nodes": 40, "controls": 90, "messages": 900, "threads": 9, "clients": 1, "backlog": 3}
    return [
        {"memory [MB]": 500.0, **calm, **{name: values[k] for name, values in series.items()}}
        for k in range(60)
    ]


@pytest.mark.parametrize(
    ("name", "values", "word"),
    [
        ("memory [MB]", [500.0 + k for k in range(60)], "memory grew by"),
        ("nodes", [40 + k // 5 for k in range(60)], "nodes grew from"),
        ("messages", [900 + 5 * k for k in range(60)], "messages grew from"),
        ("threads", [9 + k // 6 for k in range(60)], "threads grew from"),
        ("backlog", [3] * 59 + [5000], "5,000 messages behind"),
        ("clients", [1] * 30 + [3] * 30, "3 clients"),
    ],
)
def test_a_soak_complains_of_what_grows(name: str, values: list[float], word: str) -> None:
    assert soak.complaints(sampled()) == []
    (complaint,) = soak.complaints(sampled(**{name: values}))
    assert word in complaint


def test_a_soak_forgives_a_warm_up_and_a_spike() -> None:
    warming = [300.0 + 20 * min(k, 10) for k in range(60)]
    warming[40] = 900.0
    assert soak.complaints(sampled(**{"memory [MB]": warming})) == []
