"""Which test files `-m smoke` takes."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
# `-m smoke`: a part of every layer, in half a minute. Other files are not even imported for it.
SMOKE = {
    ROOT / "tests" / name
    for name in (
        "test_examples.py", "test_layers.py", "test_project.py",
        "vf/test_planes.py", "vf/test_selftest.py", "vf/test_types.py",
        "vf/tree/test_closest.py", "vf/rules/test_paper.py", "vf/qp/test_least_squares.py",
        "vf/tick/test_haptics.py",
        "robots/test_psm.py", "meshes/test_formats.py", "meshes/test_units.py",
        "app/control/test_engine.py", "app/control/test_mailbox.py", "app/test_settings.py",
        "app/control/test_teleoperation.py",
    )
}  # fmt: skip
