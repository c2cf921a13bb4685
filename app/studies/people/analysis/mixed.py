"""Linear mixed models by statsmodels: all trials of a task, as few or many as there are of each.

A measure = condition + block + repetition, with a random intercept for each participant and, where
conditions are repeated, for each participant under each condition. Fitted by REML. Tests of the
fixed effects are Wald tests with (P − 1)(C − 1) degrees of freedom of the denominator, P
participants and C conditions: exact for complete data, where the F is that of the analysis of
variance with repeated measures, and cautious otherwise.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from app.studies.people.analysis.data import Data
from app.studies.people.analysis.quantities import MEASURES, Quantity
from app.studies.results.statistics import LEVEL

FloatArray = NDArray[np.float64]

MISSING = "statsmodels is not installed: pip install 'vf-sandbox[study]'"


@dataclass(frozen=True)
class Row:
    """A value under a condition, in a block and repetition."""

    participant: str
    condition: str
    block: int
    repetition: int
    value: float


@dataclass(frozen=True)
class Effect:
    """A fixed effect, in the unit of the values: estimate, interval at `LEVEL`, p.

    `name` is a condition compared with the first one, or "block" or "repetition", of which it is
    the change from one to the next.
    """

    name: str
    estimate: float
    low: float
    high: float
    p: float


@dataclass(frozen=True)
class Mixed:
    """A fitted model.

    Attributes:
        task, quantity: what it is of.
        trials, participants: how many there are.
        effects: of the conditions but the first, of block and repetition where these vary.
        f, degrees, p: of the conditions together; degrees of numerator and denominator.
        spreads: standard deviations of participants, of participants under a condition (NaN: the
            model has none) and of trials.
        problem: why there is no fit, or what it lacks; empty: nothing.
    """

    task: str
    quantity: Quantity
    trials: int
    participants: int
    effects: tuple[Effect, ...] = ()
    f: float = math.nan
    degrees: tuple[int, int] = (0, 0)
    p: float = math.nan
    spreads: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    problem: str = ""


def fit_all(data: Data) -> list[Mixed]:
    """The models of all tasks and measures.

    Raises:
        ImportError: statsmodels is not installed.
    """
    import statsmodels.regression.mixed_linear_model  # noqa: F401

    found = []
    for task in data.tasks:
        for quantity in MEASURES:
            rows = [
                Row(p.code, one.condition, one.block, one.repetition,
                    one.measures.get(quantity.name, math.nan))
                for p in data.people for one in p.measured if one.task == task
            ]  # fmt: skip
            found.append(fit(task, quantity, rows, data.conditions))
    return found


def fit(task: str, quantity: Quantity, rows: Sequence[Row], conditions: Sequence[str]) -> Mixed:
    """The model of values, those that are not finite left out; never fails but for the import.

    Args:
        conditions: in order; the others are compared with the first one that has values.

    Raises:
        ImportError: statsmodels is not installed.
    """
    rows = [row for row in rows if math.isfinite(row.value)]
    people = sorted({row.participant for row in rows})
    names = [name for name in conditions if any(row.condition == name for row in rows)]
    blank = Mixed(task, quantity, len(rows), len(people))
    values = np.array([row.value for row in rows])
    if len(people) < 2 or len(names) < 2:
        return _without(blank, "two participants and two conditions are needed")
    spread, size = float(values.std()), float(np.abs(values).max())
    if spread <= 1e-9 * size or not spread:
        return _without(blank, "all values are equal")
    fixed, labels = _fixed(rows, names)
    cells = {(row.participant, row.condition) for row in rows}
    repeated = len(rows) > len(cells)
    if len(rows) <= fixed.shape[1] + 1 or np.linalg.matrix_rank(fixed) < fixed.shape[1]:
        return _without(blank, "too few trials for the effects of the model")
    try:
        result, caution = _fitted(values / spread, fixed, rows, people if repeated else [])
    except (ValueError, np.linalg.LinAlgError) as error:
        return _without(blank, f"no fit ({' '.join(str(error).split())})")
    variances = [float(np.asarray(result.cov_re).squeeze())]
    variances += [float(result.vcomp[0]) if repeated else 0.0, float(result.scale)]
    own, here, trial = (max(v, 0.0) * spread**2 for v in variances)
    beta = np.asarray(result.fe_params) * spread
    try:
        covariance = np.linalg.inv(_information(fixed, rows, own, here, trial))
    except np.linalg.LinAlgError:
        return _without(blank, "no fit (the trials of a participant do not vary)")
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if not np.isfinite(errors).all() or not (errors > 0.0).all():
        return _without(blank, "no fit (the errors of the effects are not defined)")
    df = max((len(people) - 1) * (len(names) - 1), 1)
    reach = float(stats.t.ppf(0.5 + 0.5 * LEVEL, df))
    effects = tuple(
        Effect(name, float(b), float(b - reach * e), float(b + reach * e),
               float(2.0 * stats.t.sf(abs(b) / e, df)))
        for name, b, e in zip(labels, beta[1:], errors[1:], strict=True)
    )  # fmt: skip
    some = slice(1, len(names))
    f = float(beta[some] @ np.linalg.solve(covariance[some, some], beta[some])) / (len(names) - 1)
    return Mixed(
        task, quantity, len(rows), len(people), effects, f, (len(names) - 1, df),
        float(stats.f.sf(f, len(names) - 1, df)),
        (math.sqrt(own), math.sqrt(here) if repeated else math.nan, math.sqrt(trial)),
        caution,
    )  # fmt: skip


def _without(blank: Mixed, problem: str) -> Mixed:
    return Mixed(blank.task, blank.quantity, blank.trials, blank.participants, problem=problem)


def _fixed(rows: Sequence[Row], names: Sequence[str]) -> tuple[FloatArray, list[str]]:
    """The design (n, k) of the fixed effects, intercept first, and the names of the others."""
    columns = [np.ones(len(rows))]
    labels = list(names[1:])
    columns += [np.array([float(row.condition == name) for row in rows]) for name in names[1:]]
    for label in ("block", "repetition"):
        values = np.array([float(getattr(row, label)) for row in rows])
        if np.ptp(values) > 0.0:
            columns.append(values - values.mean())
            labels.append(label)
    return np.stack(columns, axis=1), labels


def _information(
    fixed: FloatArray, rows: Sequence[Row], own: float, here: float, trial: float
) -> FloatArray:
    """Of the fixed effects (k, k), from the variances: Xᵀ V⁻¹ X.

    That of statsmodels is by differences of the likelihood, which fail where a variance is 0.
    """
    found = np.zeros((fixed.shape[1],) * 2)
    for person in {row.participant for row in rows}:
        mine = np.array([row.participant == person for row in rows])
        names = np.array([row.condition for row in rows])[mine]
        v = own + here * (names[:, None] == names) + trial * np.eye(len(names))
        found += fixed[mine].T @ np.linalg.solve(v, fixed[mine])
    return found


def _fitted(values: FloatArray, fixed: FloatArray, rows: Sequence[Row], people: Sequence[str]):  # type: ignore[no-untyped-def]
    """The result of statsmodels and what it lacks; `people`: whose conditions vary, or none."""
    from statsmodels.regression.mixed_linear_model import MixedLM, VCSpec

    groups = np.array([row.participant for row in rows])
    components = None
    if people:
        matrices, columns = [], []
        for person in people:  # sorted, as statsmodels has them
            own = [row.condition for row in rows if row.participant == person]
            levels = sorted(set(own))
            matrices.append(np.array([[float(c == level) for level in levels] for c in own]))
            columns.append(levels)
        components = VCSpec(["condition"], [columns], [matrices])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = MixedLM(values, fixed, groups, exog_re=np.ones((len(rows), 1)), exog_vc=components)
        result = model.fit(reml=True, method=["lbfgs", "powell"])
    caution = "" if result.converged else "the fit did not converge"
    if not caution and any("boundary" in str(one.message).lower() for one in caught):
        caution = "a spread is 0"
    return result, caution
