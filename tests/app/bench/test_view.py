"""`bench view`: delays, and the browser's window."""

from __future__ import annotations

from typing import Any

import pytest


def test_delays_pair_each_drag_with_the_first_move_after_it() -> None:
    from app.bench.view import delays_of

    log = {
        "sent": [[100.0, 110.0], [500.0, 505.0], [900.0, 901.0], [1300.0, 1302.0]],
        "moved": [90.0, 140.0, 150.0, 560.0, 1310.0],  # the third drag moved nothing
        "drawn": [[90.0, 95.0], [140.0, 170.0], [150.0, 180.0], [560.0, 600.0]],  # nor the fourth's
    }
    assert delays_of(log).tolist() == [[10.0, 30.0, 70.0], [5.0, 55.0, 100.0]]
    with pytest.raises(ValueError, match="no drag moved the tool"):
        delays_of({"sent": [[1.0, 2.0]], "moved": [], "drawn": []})


def test_a_drag_is_measured_in_a_window_as_people_have_one_and_says_in_which() -> None:
    from rich.console import Console

    from app.bench import view
    from app.bench.tools.watcher import WINDOW

    assert (WINDOW["width"], WINDOW["height"], view.RATIO) == (1440, 900, 1.0)
    opened: list[dict[str, Any]] = []

    class Browser:
        def new_page(self, **properties: Any) -> Any:
            opened.append(properties)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        view._serve_requests(Browser(), "http://127.0.0.1:1")
    assert opened == [{"viewport": WINDOW, "device_scale_factor": 1.0}]
    loop = {"rate [Hz]": 1000.0, "punctual": 0.999, "late [us]": {"p99": 50.0}}
    result = {
        "what": "vf-sandbox bench view",
        "triangles": 1000,
        "drags": 12,
        **dict.fromkeys(
            (
                "input to message [ms]",
                "message to moved tool [ms]",
                "input to moved tool [ms]",
                "input to picture [ms]",
            ),
            (10.0, 20.0),
        ),
        "updates/s": 20.0,
        "pictures/s": 7.5,
        "window": {
            **WINDOW,
            "ratio": 1.0,
            "canvas": [597, 675],
            "css": [797, 900],
            "renderer": "ANGLE (SwiftShader)",
            "smoothed": False,
            "pictures": 99,
        },
        "loop while dragging": loop,
        "loop on autopilot": loop,
    }
    console = Console(record=True, width=80, force_terminal=False)
    view.show(result, console)
    said = console.export_text()
    for words in ("7.5 pictures/s", "1440 × 900 at 1", "597 × 675 pixels", "not smoothed"):
        assert words in said
    assert "ANGLE (SwiftShader)" in said
