"""Axes of a sweep as text, designs that choose its points, random draws, default range of a gain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_known, check_once

_SPREAD = 4.0

MOST_POINTS = 10_000_000
"""Largest number of points of a sweep: the points and one column of the table must fit in memory."""

SEED = "seed"
"""Name of the axis that sets the seed of every run instead of a gain or a plant parameter."""


@dataclass(frozen=True)
class Axis:
    """One parameter of a parameter sweep, with its values in ascending order.

    Raises:
        InputError: there is no value, a value is not finite, the values do not ascend, or a value of the parameter
            `seed` is not a whole number ≥ 0.
    """

    name: str
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        values = tuple(float(v) for v in self.values)
        key = f"axis {self.name}"
        if not values or not all(map(math.isfinite, values)):
            raise InputError("needs finite values", key=key, value=values, remedy="write at least one number")
        if any(not b > a for a, b in pairwise(values)):
            raise InputError("needs values in ascending order, each once", key=key, value=values, remedy="sort them")
        _check_seeds(self.name, values)
        object.__setattr__(self, "values", values)


@dataclass(frozen=True)
class Span:
    """One parameter of a sweep and its range low … high.

    The points are evenly spaced on a linear scale, or on a log scale if `log` is true.

    Raises:
        InputError: a bound is not finite, the range is empty or reversed, or a logarithmic range does not start above
            0.
    """

    name: str
    low: float
    high: float
    log: bool = False

    def __post_init__(self) -> None:
        key, shown = f"axis {self.name}", f"{self.low:g}..{self.high:g}"
        if not (math.isfinite(self.low) and math.isfinite(self.high)):
            raise InputError("needs finite bounds", key=key, value=shown, remedy="write numbers")
        if not self.low < self.high:
            problem = "is an empty range" if self.low == self.high else "is a reversed range"
            raise InputError(problem, key=key, value=shown, remedy="write LOW..HIGH with LOW below HIGH")
        if self.log and not self.low > 0:
            raise InputError("has no logarithm", key=key, value=shown, remedy="start above 0 or omit :log")
        _check_seeds(self.name, (self.low, self.high))

    def axis(self, count: int) -> Axis:
        """Return an axis with `count` ≥ 2 values over the range; the first value is low, the last value is high."""
        if count < 2:
            raise InputError(
                "a range needs at least two points", key=f"axis {self.name}", value=count, remedy="write :2 or more"
            )
        if count > MOST_POINTS:
            remedy = f"write at most {MOST_POINTS}"
            raise InputError("too many points", key=f"axis {self.name}", value=count, remedy=remedy)
        spaced = np.geomspace if self.log else np.linspace
        inner = (float(f"{value:.15g}") for value in spaced(self.low, self.high, count)[1:-1])  # 1.15, not 1.15 + 2e-16
        return Axis(self.name, (self.low, *inner, self.high))

    def at(self, share: np.ndarray) -> np.ndarray:
        """Convert shares of the range (0 ≤ share < 1, any shape) to values.

        For the parameter `seed`, the values are whole numbers, and equally distributed shares give equally likely
        values.
        """
        if self.name == SEED:
            return np.floor(self.low + share * (self.high + 1.0 - self.low))
        if self.log:
            values = np.exp(math.log(self.low) + share * (math.log(self.high) - math.log(self.low)))
        else:
            values = self.low + share * (self.high - self.low)
        return np.clip(values, self.low, self.high)  # rounding must not exceed the parameter's bounds


def parse_axis(text: str) -> Axis | Span:
    """Parse the axis of a sweep from its command-line text.

    `k_v=1,1.5,2` lists values. `k_v=0.5..3:9` gives nine values from 0.5 to 3, and `k_v=0.5..3:9:log` spaces them
    evenly in the logarithm. `k_v=0.5..3` and `k_v=0.5..3:log` are ranges, in which the design of the sweep chooses the
    values.

    Raises:
        InputError: the text has none of the forms above, or its values are not valid.

    Example:
        >>> from surctl.tuning import parse_axis
        >>> parse_axis("k_v=0.5..4:4:log")
        Axis(name='k_v', values=(0.5, 1.0, 2.0, 4.0))
        >>> parse_axis("lookahead=0.3..1.2")
        Span(name='lookahead', low=0.3, high=1.2, log=False)
    """
    name, equals, spec = (part.strip() for part in text.partition("="))
    low, dots, rest = spec.partition("..")
    try:
        if not (name and equals and spec):
            raise ValueError
        if not dots:
            return Axis(name, tuple(float(v) for v in spec.split(",")))
        high, *how = rest.split(":")
        log = how[-1:] == ["log"]
        span = Span(name, float(low), float(high), log)
        counts = how[:-1] if log else how
        if len(counts) > 1:
            raise ValueError
        return span.axis(int(counts[0])) if counts else span
    except ValueError:
        remedy = "write PARAMETER=V1,V2,... or PARAMETER=LOW..HIGH:COUNT, and append :log for logarithmic spacing"
        raise InputError("is not an axis", key="axis", value=text, remedy=remedy) from None


def _check_seeds(name: str, values: tuple[float, ...]) -> None:
    if name == SEED and any(not 0 <= v <= 2**53 or v != int(v) for v in values):
        raise InputError("must be whole numbers, at least 0", key="axis seed", value=values, remedy="write 0,1,2,...")


def default_range(gain: str, value: float) -> tuple[float, float]:
    """Return the default search range of a gain: from a quarter of its value to four times the value, in order.

    Raises:
        InputError: the value is 0.
    """
    if value == 0:
        raise InputError("is 0 and so has no default range", key=f"--gain {gain}", remedy=f"write {gain}=LOW..HIGH")
    return min(value / _SPREAD, value * _SPREAD), max(value / _SPREAD, value * _SPREAD)


DesignName = Literal["grid", "lhs", "sobol"]
DESIGNS: tuple[DesignName, ...] = get_args(DesignName)


@dataclass(frozen=True, eq=False)
class Design:
    """The points of a parameter sweep, with the axes and the design that they come from.

    Attributes:
        kind: `grid`, `lhs`, `sobol` or `saltelli`.
        axes: the swept axes; all are `Axis` for a grid, otherwise all are `Span`.
        points: (n, len(axes)) values of the parameters at the n points; the points of a grid are in C order.
        description: text that determines the points completely; two designs with equal texts have equal points.
    """

    kind: str
    axes: tuple[Axis, ...] | tuple[Span, ...]
    points: NDArray[np.float64] = field(repr=False)
    description: str

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return tuple(axis.name for axis in self.axes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a column of results: for a grid, the number of values of each axis; otherwise (n,)."""
        lengths = tuple(len(axis.values) for axis in self.axes if isinstance(axis, Axis))
        return lengths if self.kind == "grid" else (len(self.points),)


ONE_POINT = Design("grid", (), np.zeros((1, 0)), "one point")
"""The design without axes: one point, with the numbers that are not swept."""


def grid(axes: Sequence[Axis]) -> Design:
    """Return the design with every combination of the axes' values.

    Raises:
        InputError: there is no axis, or an axis occurs twice.

    Example:
        >>> from surctl.tuning import grid, parse_axis
        >>> design = grid([parse_axis("k_v=1,2"), parse_axis("lookahead=0.4..0.8:3")])
        >>> design.points.round(3).tolist()
        [[1.0, 0.4], [1.0, 0.6], [1.0, 0.8], [2.0, 0.4], [2.0, 0.6], [2.0, 0.8]]
    """
    axes = tuple(axes)
    _check_names(axes)
    # one axis at a time, because a table of indices for all axes would need more memory
    shape = tuple(len(axis.values) for axis in axes)
    _check_size(math.prod(shape))
    points = np.empty((math.prod(shape), len(axes)))
    for k, axis in enumerate(axes):
        place = [1] * len(shape)
        place[k] = shape[k]
        points[:, k] = np.broadcast_to(np.reshape(axis.values, place), shape).reshape(-1)
    return Design("grid", axes, points, f"grid {axes!r}")


def spread(kind: Literal["lhs", "sobol"], spans: Sequence[Span], *, count: int, seed: int = 0) -> Design:
    """Return points that fill ranges: a Latin hypercube (`lhs`) or scrambled Sobol' points (`sobol`) of scipy.stats.

    Args:
        kind: `lhs` or `sobol`.
        spans: the ranges.
        count: number of points; Sobol' points are best balanced if it is a power of two.
        seed: seed of the design; it does not set the seed of the runs.

    Raises:
        InputError: there is no axis, an axis occurs twice, or there is no point.

    Example:
        >>> from surctl.tuning import Span, spread
        >>> design = spread("lhs", [Span("k_v", 0.5, 3.0), Span("lookahead", 0.3, 1.2)], count=5, seed=2)
        >>> sorted(((design.points[:, 0] - 0.5) // 0.5).tolist())  # one point in each fifth of a range
        [0.0, 1.0, 2.0, 3.0, 4.0]
    """
    spans = _spans(spans, kind)
    if count < 1:
        raise InputError("must be at least 1", key="points", value=count, remedy="write the number of points")
    _check_size(count)
    from scipy.stats import qmc  # takes a second to import

    if kind == "lhs":
        unit = qmc.LatinHypercube(len(spans), rng=seed).random(count)
    else:
        # the first points of the sequence are the same for every number of points
        unit = qmc.Sobol(len(spans), rng=seed).random_base2(_power(count))[:count]
    return Design(kind, spans, _filled(spans, unit), f"{kind} {spans!r} {count} {seed}")


def saltelli(axes: Sequence[Axis | Span], *, base: int, seed: int = 0) -> Design:
    """Return the base·(d + 2) points from which Sobol' indices of d axes are computed (Saltelli et al. 2010).

    A and B are two samples: the two halves of the columns of Sobol' points. The result contains A, then B, then for
    each axis a copy of A with the values of this axis from B.

    Args:
        axes: d ranges.
        base: number of points in A, which is also the number in B; a power of two, at least 4.
        seed: seed of the points.

    Raises:
        InputError: there are fewer than two axes, an axis occurs twice or lists values, or the base is not a power of
            two.

    Example:
        >>> from surctl.tuning import parse_axis, saltelli
        >>> design = saltelli([parse_axis("k_v=0.5..3"), parse_axis("lookahead=0.3..1.2")], base=4)
        >>> a, b, a_with_b, _ = design.points.reshape(4, 4, 2)
        >>> bool((a_with_b[:, 0] == b[:, 0]).all()), bool((a_with_b[:, 1] == a[:, 1]).all())
        (True, True)
    """
    spans = _spans(axes, "sensitivity")
    if len(spans) < 2:
        raise InputError(
            "needs at least two axes", key="sensitivity", value=spans[0].name, remedy="add another parameter"
        )
    if base < 4 or base & (base - 1):
        raise InputError(
            "must be a power of two, at least 4", key="points", value=base, remedy=f"write {2 ** max(2, _power(base))}"
        )
    _check_size(base * (len(spans) + 2))
    from scipy.stats import qmc

    unit = qmc.Sobol(2 * len(spans), rng=seed).random_base2(_power(base))
    a, b = unit[:, : len(spans)], unit[:, len(spans) :]
    crossed = [np.where(np.arange(len(spans)) == k, b, a) for k in range(len(spans))]
    return Design(
        "saltelli", spans, _filled(spans, np.concatenate([a, b, *crossed])), f"saltelli {spans!r} {base} {seed}"
    )


def random_draws(spans: Sequence[Span], *, count: int, seed: int = 0) -> dict[str, NDArray[np.float64]]:
    """Return independent random numbers in ranges, by name: uniform, or uniform in the logarithm for `log`.

    The first numbers are the same for every count.

    Example:
        >>> from surctl.tuning import Span, random_draws
        >>> draws = random_draws([Span("plant.mass", 0.8, 1.2), Span("start.speed", 0, 1)], count=3)
        >>> {name: values.round(2).tolist() for name, values in draws.items()}
        {'plant.mass': [1.05, 0.82, 1.13], 'start.speed': [0.27, 0.02, 0.91]}
    """
    unit = np.random.default_rng(seed).random((count, len(spans)))
    return {span.name: span.at(unit[:, k]) for k, span in enumerate(spans)}


def make_design(kind: DesignName | str, axes: Sequence[Axis | Span], *, count: int | None = None) -> Design:
    """Build the design that `kind` names, from axes in the command-line notation.

    Raises:
        InputError: the design is not valid, an axis lists values where a range is needed or has a range where values
            are needed, or the number of points is missing.

    Example:
        >>> from surctl.tuning import make_design, parse_axis
        >>> design = make_design("sobol", [parse_axis("k_v=0.5..3"), parse_axis("lookahead=0.3..1.2")], count=8)
        >>> design.kind, design.names, design.points.shape
        ('sobol', ('k_v', 'lookahead'), (8, 2))
    """
    check_known(kind, DESIGNS, key="design")
    if kind == "grid":
        if count is not None:
            raise InputError(
                "applies only to lhs and sobol", key="points", value=count, remedy="for a grid write LOW..HIGH:COUNT"
            )
        for axis in axes:
            if isinstance(axis, Span):
                remedy = f"write {axis.name}={axis.low:g}..{axis.high:g}:COUNT, or choose --design lhs"
                raise InputError("a grid needs the number of values", key=f"axis {axis.name}", remedy=remedy)
        return grid([axis for axis in axes if isinstance(axis, Axis)])
    spans = _spans(axes, kind)
    if count is None:
        raise InputError("is missing", key="points", remedy=f"give the number of points of {kind}: --points N")
    return spread("lhs" if kind == "lhs" else "sobol", spans, count=count)


def _spans(axes: Sequence[Axis | Span], kind: str) -> tuple[Span, ...]:
    _check_names(axes)
    for axis in axes:
        if isinstance(axis, Axis):
            problem = f"{kind} needs a range, not values"
            raise InputError(problem, key=f"axis {axis.name}", value=axis.values, remedy=f"write {axis.name}=LOW..HIGH")
    return tuple(axis for axis in axes if isinstance(axis, Span))


def _check_names(axes: Sequence[Axis | Span]) -> None:
    if not axes:
        raise InputError("nothing to sweep", key="axis", remedy="name at least one parameter")
    check_once((axis.name for axis in axes), "is swept twice", key="axis", remedy="name each parameter once")


def _check_size(count: int) -> None:
    if count > MOST_POINTS:
        raise InputError("are too many", key="points", value=count, remedy=f"use at most {MOST_POINTS} in one sweep")


def _filled(spans: Sequence[Span], unit: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([span.at(unit[:, k]) for k, span in enumerate(spans)], axis=1)


def _power(count: int) -> int:
    # least k with 2^k ≥ count
    return max(0, count - 1).bit_length()
