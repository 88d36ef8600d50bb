"""Sensitivity of a column to the axes: Sobol' indices of first and total order, with confidence intervals."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.tuning.table import SweepTable

__all__ = ["Sensitivity", "sensitivity"]

_RESAMPLES = 500
_CONFIDENCE = 0.95
_ENOUGH = 64  # points of a sample from which the intervals contain the truth in at least 95 % of the drawn functions


@dataclass(frozen=True)
class Sensitivity:
    """Sobol' indices: the share of a column's variance, over the ranges of the axes, that each axis causes.

    Attributes:
        column: name of the column.
        axes: names of the axes.
        first: first-order index of each axis: the share of the variance that this axis causes alone.
        total: total-order index of each axis: the share of the variance that this axis causes, alone or together with
            other axes; the sum over the axes may exceed 1.
        first_interval: 95 % bootstrap confidence interval (low, high) of each first-order index.
        total_interval: 95 % bootstrap confidence interval (low, high) of each total-order index.
        constant: whether the column is constant; if it is, every index is 0.
        base: number of points in each of the two independent samples.
    """

    column: str
    axes: tuple[str, ...]
    first: tuple[float, ...]
    total: tuple[float, ...]
    first_interval: tuple[tuple[float, float], ...]
    total_interval: tuple[tuple[float, float], ...]
    constant: bool
    base: int

    @property
    def warning(self) -> str:
        """Why the intervals are too short; empty if they have their confidence."""
        if self.constant or self.base >= _ENOUGH:
            return ""
        return f"the samples have {self.base} points: below {_ENOUGH}, intervals miss the truth more often than stated"

    def to_dict(self) -> dict[str, Any]:
        """Return the indices as plain data for JSON."""
        return asdict(self)


def sensitivity(table: SweepTable, column: str, *, seed: int = 0) -> Sensitivity:
    """Return Sobol' indices of a column from a sweep over a Saltelli design (Saltelli et al. 2010, scipy.stats).

    Args:
        table: result of a sweep over a design that `saltelli` returned.
        column: name of any column of the sweep.
        seed: seed of the bootstrap.

    Raises:
        InputError: the sweep has another design, or the column is unknown or not finite everywhere.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases, sensitivity, sweep
        >>> from surctl.tuning import parse_axis, saltelli
        >>> cases = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> design = saltelli([parse_axis("scenario.cruise=0.1..0.2"), parse_axis("k_v=1.2..3")], base=16)
        >>> found = sensitivity(sweep(cases, design, linear=False), "time_s")
        >>> found.axes, [round(share, 2) for share in found.total]
        (('scenario.cruise', 'k_v'), [1.0, 0.0])
    """
    values = table.column(column)
    if table.dataset.attrs["design"] != "saltelli":
        raise InputError(
            "needs the points of a Saltelli design",
            key="sensitivity",
            value=column,
            remedy="sweep with --sensitivity",
        )
    names = tuple(json.loads(table.dataset.attrs["axes"]))
    lost = int((~np.isfinite(values)).sum())
    if lost:
        raise InputError(
            f"is not a finite number at {lost} of {values.size} points",
            key="sensitivity",
            value=column,
            remedy="choose another column or narrower ranges",
        )
    parts = values.reshape(len(names) + 2, -1)
    base = parts.shape[1]
    if np.ptp(values) == 0:
        none, interval = (0.0,) * len(names), ((0.0, 0.0),) * len(names)
        return Sensitivity(column, names, none, none, interval, interval, True, base)
    estimate = _indices(parts)
    rng = np.random.default_rng(seed)
    draws = np.array([_indices(parts[:, rng.integers(0, base, base)]) for _ in range(_RESAMPLES)])
    tail = 50 * (1 - _CONFIDENCE)
    low, high = np.percentile(draws, [tail, 100 - tail], axis=0)
    intervals = [tuple((float(a), float(b)) for a, b in zip(low[k], high[k], strict=True)) for k in (0, 1)]
    first, total = (tuple(float(v) for v in row) for row in estimate)
    return Sensitivity(column, names, first, total, intervals[0], intervals[1], False, base)


def _indices(parts: NDArray[np.float64]) -> NDArray[np.float64]:
    # first-order and total-order indices (2, axes) from values (2 + axes, base) at A, B and mixed samples
    from scipy.stats import sobol_indices

    result = sobol_indices(
        func={"f_A": parts[:1], "f_B": parts[1:2], "f_AB": parts[2:, None, :]}, n=parts.shape[1]
    )  # SciPy returns indices of 0 for a resample without variance
    return np.stack([np.atleast_1d(result.first_order).reshape(-1), np.atleast_1d(result.total_order).reshape(-1)])
