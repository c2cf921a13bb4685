"""All that is computed of a study."""

from __future__ import annotations

import importlib.metadata
from dataclasses import dataclass

from app.studies.people.analysis import contrasts, learning, mixed
from app.studies.people.analysis.contrasts import Contrast
from app.studies.people.analysis.data import Data
from app.studies.people.analysis.learning import Curve
from app.studies.people.analysis.mixed import Mixed

_PACKAGES = ("vf-sandbox", "numpy", "scipy", "statsmodels")


@dataclass(frozen=True)
class Analysis:
    """The analysis of a study.

    Attributes:
        data: what was measured.
        contrasts: pairs of conditions compared.
        models: mixed models; None: statsmodels is not installed.
        curves: of learning.
        versions: of the packages, in a sentence.
    """

    data: Data
    contrasts: tuple[Contrast, ...]
    models: tuple[Mixed, ...] | None
    curves: tuple[Curve, ...]
    versions: str


def analysed(data: Data) -> Analysis:
    """The analysis of data."""
    models: tuple[Mixed, ...] | None
    try:
        models = tuple(mixed.fit_all(data))
    except ImportError:
        models = None
    return Analysis(
        data, tuple(contrasts.compare(data)), models, tuple(learning.curves(data)), _versions()
    )


def _versions() -> str:
    found = []
    for name in _PACKAGES:
        try:
            found.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            found.append(f"no {name}")
    return f"Computed with {', '.join(found)}."
