"""The names that settings take, for help and to be refused before the libraries load.

They repeat what the libraries know, because importing those takes a second;
`tests/app/test_limits.py` compares them.
"""

from __future__ import annotations

import difflib
from pathlib import Path

from app.words import OptionError

ROBOTS = ("psm", "point", "panda", "ur5")
RULES = ("certified", "paper", "all", "off")
AXES = ("z", "-z", "y", "-y", "x", "-x")
UNITS = ("m", "cm", "mm", "in")
FRAMES = ("RAS", "LPS")
DAMAGES = (
    "none", "unwelded", "flipped", "inside-out", "holes", "duplicated", "jittered", "slivers",
    "fin", "interpenetrating", "sheet",
)  # fmt: skip
MESHES = (
    "skull-closed", "skull", "skull-coarse", "skull-fine", "skull-fused", "skull-precut", "cube",
    "sphere", "cylinder", "cone", "torus", "gear", "l-block", "stairs", "star-prism", "thin-plate",
    "saddle-slab", "gyroid",
)  # fmt: skip
"""Those made by formula, which are there on every machine."""
FROM_PACKAGES = ("cortex", "brain", "brain-fine", "bunny")
"""Those that are there where their package is installed."""
SCENARIOS = (
    "push-on-the-skull", "slide-into-the-orbit", "thin-plate-both-sides", "valley-of-the-gear",
    "saddle", "unclean-mesh-paper", "unclean-mesh-certified", "million-triangles",
)  # fmt: skip
SKULLS = ("skull", "skull-coarse", "skull-fine")
"""Those that the experiments cut."""


def check_mesh(name: str) -> None:
    """Refuse what is neither a name of the catalogue nor looks like a file.

    Raises:
        OptionError: naming the nearest and all of the catalogue.
    """
    known = (*MESHES, *FROM_PACKAGES)
    if name in known or Path(name).suffix or len(Path(name).parts) > 1 or _exists(name):
        return
    near = difflib.get_close_matches(name.lower(), known, n=1)
    hint = f" (did you mean '{near[0]}'?)" if near else ""
    raise OptionError(
        f"unknown mesh '{name}'{hint}: choose one of {', '.join(MESHES)}, "
        f"where their package is installed {', '.join(FROM_PACKAGES)}, or give a file's path"
    )


def _exists(name: str) -> bool:
    try:
        return Path(name).exists()
    except (OSError, ValueError):
        return False
