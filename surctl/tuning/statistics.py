"""Statistics of runs: shares with upper bounds, and Sobol' indices with intervals and their warning."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.plotted import Plotted
from surctl.tuning.design import Design


@dataclass(frozen=True)
class Share:
    """The number of runs in which an event happens, out of a number of independent runs.

    Attributes:
        count: number of runs with the event, between 0 and `runs`.
        runs: number of all runs, at least 1.

    Raises:
        InputError: `runs` is less than 1, or `count` is not between 0 and `runs`.
    """

    count: int
    runs: int

    def __post_init__(self) -> None:
        """Check `runs` and `count`."""
        if self.runs < 1:
            raise InputError("must be at least 1", key="runs", value=self.runs, remedy="simulate at least one run")
        if not 0 <= self.count <= self.runs:
            remedy = f"give 0 to {self.runs}"
            raise InputError("is not between 0 and the number of runs", key="count", value=self.count, remedy=remedy)

    @property
    def rate(self) -> float:
        """Observed share of the runs with the event."""
        return self.count / self.runs

    def at_most(self, confidence: float = 0.95) -> float:
        """Return the exact one-sided upper bound of the true rate (Clopper and Pearson, Biometrika 26, 1934).

        Raises:
            InputError: the confidence is not between 0 and 1.
        """
        if not 0 < confidence < 1:
            raise InputError(
                "must be between 0 and 1", key="confidence", value=confidence, remedy="give for instance 0.95"
            )
        from scipy.stats import beta  # this import takes half a second

        return 1.0 if self.count == self.runs else float(beta.ppf(confidence, self.count + 1, self.runs - self.count))


_RESAMPLES = 500
_CONFIDENCE = 0.95
_ENOUGH = 64  # points of a sample from which the intervals contain the truth in at least 95 % of the drawn functions


@dataclass(frozen=True)
class SobolIndices(Plotted):
    """The share of a column's variance, over the ranges of the axes, that each axis causes; `plot()` draws it.

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

    PLOT = "surctl.report.system_plots:plot_sobol_indices"

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

    def headline(self) -> str:
        """Return all indices without their intervals in one line, the axis with the largest share first."""
        if self.constant:
            return f"{self.column} is constant over these ranges: it does not depend on any axis"
        shares = sorted(zip(self.total, self.first, self.axes, strict=True), reverse=True)
        shown = ", ".join(f"{name} {alone:.2f} ({total:.2f})" for total, alone, name in shares)
        return f"{self.column}: share of the variance (with interactions): {shown}"

    def lines(self) -> list[str]:
        """Return a headline, and a line of text for each axis."""
        if self.constant:
            return [self.headline()]
        head = (
            f"{self.column}: share of the variance due to each axis, alone and with interactions, with 95 % intervals"
        )
        shares = zip(self.axes, self.first, self.first_interval, self.total, self.total_interval, strict=True)
        shown = [
            f"{name:<16} {f:6.3f} ({a[0]:.3f} … {a[1]:.3f})  {t:6.3f} ({b[0]:.3f} … {b[1]:.3f})"
            for name, f, a, t, b in shares
        ]
        return [head, *shown, *([f"  warning: {self.warning}"] if self.warning else [])]


def sobol_indices(design: Design, values: NDArray[np.float64], column: str) -> SobolIndices:
    """Return Sobol' indices of a column of a sweep over a Saltelli design (Saltelli et al. 2010, scipy.stats).

    Args:
        design: a design that `saltelli` returned.
        values: (n,) the column at its points.
        column: name of the column.

    Raises:
        InputError: the design is another, or the column is not finite everywhere.

    Example:
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning import SystemSweep, parse_axis, saltelli, sobol_indices, sweep
        >>> design = saltelli([parse_axis("k=1..2"), parse_axis("start.speed=0.9..1.1")], base=16)
        >>> way = sweep(SystemSweep(cart_system(), 5.0), design).mean("way")
        >>> [round(share, 2) for share in sobol_indices(design, way, "way").total]
        [0.91, 0.06]
    """
    if design.kind != "saltelli":
        raise InputError(
            "needs the points of a Saltelli design", key="sensitivity", value=column, remedy="sweep with --sensitivity"
        )
    names = design.names
    lost = int((~np.isfinite(values)).sum())
    if lost:
        problem = f"is not a finite number at {lost} of {values.size} points"
        raise InputError(problem, key="sensitivity", value=column, remedy="choose another column or narrower ranges")
    parts = values.reshape(len(names) + 2, -1)
    base = parts.shape[1]
    if np.ptp(values) == 0:
        none, interval = (0.0,) * len(names), ((0.0, 0.0),) * len(names)
        return SobolIndices(column, names, none, none, interval, interval, True, base)
    estimate = _indices(parts)
    rng = np.random.default_rng(0)
    draws = np.array([_indices(parts[:, rng.integers(0, base, base)]) for _ in range(_RESAMPLES)])
    tail = 50 * (1 - _CONFIDENCE)
    low, high = np.percentile(draws, [tail, 100 - tail], axis=0)
    intervals = [tuple((float(a), float(b)) for a, b in zip(low[k], high[k], strict=True)) for k in (0, 1)]
    first, total = (tuple(float(v) for v in row) for row in estimate)
    return SobolIndices(column, names, first, total, intervals[0], intervals[1], False, base)


def _indices(parts: NDArray[np.float64]) -> NDArray[np.float64]:
    # first-order and total-order indices (2, axes) from values (2 + axes, base) at A, B and mixed samples
    from scipy import stats

    result = stats.sobol_indices(
        func={"f_A": parts[:1], "f_B": parts[1:2], "f_AB": parts[2:, None, :]}, n=parts.shape[1]
    )  # SciPy returns indices of 0 for a resample without variance
    return np.stack([np.atleast_1d(result.first_order).reshape(-1), np.atleast_1d(result.total_order).reshape(-1)])
