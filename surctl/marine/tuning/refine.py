"""Local refinement of gains by exact gradients: a quasi-Newton method reduces smooth surrogates of the metrics.

The method is L-BFGS-B in the logarithms of the gains, because the cost is piecewise smooth, the bounds are intervals,
and a step needs one cost value and one gradient. The surrogates only guide the descent; other modules evaluate the true
metrics of the refined gains.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.marine.control import Gains
from surctl.marine.simulation import Case
from surctl.marine.tuning.gradient import SURROGATES, DifferentiableRun, prepare

__all__ = ["WEIGHTS", "Refinement", "refine"]

Array = NDArray[np.float64]

WEIGHTS: Mapping[str, float] = MappingProxyType({"deviation": 1.0, "clearance": 4.0, "effort": 0.1, "remaining": 1.0})
"""Weight of each surrogate in the cost, after scaling by hull radius, surge thrust limit and path length."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """Result of a refinement.

    Attributes:
        gains: the gains with the least cost found; they are the original gains if no lower cost was found.
        cost: cost of the refined gains.
        history: one tuple for each start, with the cost at the start and then the cost after each iteration.
    """

    gains: Gains
    cost: float
    history: tuple[tuple[float, ...], ...]


def refine(
    cases: Sequence[Case],
    gains: Gains,
    ranges: Mapping[str, tuple[float, float]],
    *,
    weights: Mapping[str, float] = WEIGHTS,
    floor: float = 0.05,
    steps: int = 600,
    starts: int = 1,
    iterations: int = 20,
    seed: int = 0,
) -> Refinement:
    """Minimise a cost from the given gains, and from further random starts within the ranges.

    The cost of a case is w_d deviation/R² + w_c (max(0, floor − clearance)/R)² + w_e effort/F² + w_r remaining/L. Here
    w_d to w_r are the weights, R the hull radius, F the surge thrust limit and L the path length; deviation, clearance,
    effort and remaining are smooth surrogates of metrics (`SURROGATES`). The cost of several cases is the sum of their
    costs.

    Args:
        cases: cases that `prepare` accepts; their own gains are replaced.
        gains: gains of the first start; every gain that is not in `ranges` keeps its value from them.
        ranges: range (low, high) of each gain by name, with 0 < low < high; a start value outside the range moves to
            the nearest bound.
        weights: weights by the names of `SURROGATES`; a missing weight is 0.
        floor: clearance [m] below which a case adds cost. The cost uses a smooth minimum of the clearance, which is up
            to about 0.1 m below the least clearance.
        steps: number of control steps of every run.
        starts: number of starting points of the descent.
        iterations: largest number of quasi-Newton iterations for each start; an iteration evaluates cost and gradient
            up to about three times.
        seed: seed of the random starts after the first, and of drift and waves.

    Raises:
        InputError: there is no case, a range is not valid, a gain or weight is unknown, or a case has no gradient.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases, refine
        >>> gains = load_gains("default")
        >>> cases = build_cases([load_scenario("pool-behind")], gains=gains, law="paper")
        >>> refined = refine(cases, gains, {"k_v": (0.8, 4.0)}, steps=60, iterations=2)
        >>> round(refined.gains["k_v"], 2), round(refined.history[0][0], 3), round(refined.cost, 3)
        (0.8, 1.026, 1.02)
    """
    from scipy.optimize import minimize

    names = tuple(ranges)
    _check(cases, gains, ranges, weights)
    runs = [prepare(case, names, steps=steps, seed=seed) for case in cases]
    low, high = (np.log([ranges[name][k] for name in names]) for k in (0, 1))
    rng = np.random.default_rng([seed, 3])
    points = [np.clip(np.log([max(gains[name], 1e-12) for name in names]), low, high)]
    points += [rng.uniform(low, high) for _ in range(starts - 1)]
    cost = _cost_of(runs, weights, floor)
    best, least, history = points[0], cost(points[0])[0], []
    for point in points:
        values = [cost(point)[0]]
        result = minimize(
            cost,
            point,
            jac=True,
            method="L-BFGS-B",
            bounds=list(zip(low, high, strict=True)),
            callback=_keep(values),
            options={"maxiter": iterations, "maxfun": 3 * iterations},
        )
        history.append(tuple(values))
        if result.fun < least:
            best, least = result.x, float(result.fun)
    provenance = f"refined by gradients from {gains.name!r}: {', '.join(names)}"
    chosen = dict(zip(names, np.exp(best).tolist(), strict=True))
    return Refinement(gains.with_values(chosen, provenance=provenance), least, tuple(history))


def _keep(values: list[float]) -> Callable[..., None]:
    def keep(intermediate_result: object) -> None:  # SciPy passes the result by this name
        values.append(float(intermediate_result.fun))  # type: ignore[attr-defined]

    return keep


def _cost_of(
    runs: Sequence[DifferentiableRun], weights: Mapping[str, float], floor: float
) -> Callable[[Array], tuple[float, Array]]:
    # the logarithms of the gains (k,) → cost and gradient
    def cost(logs: Array) -> tuple[float, Array]:
        values, total, slope = np.exp(logs), 0.0, np.zeros(len(logs))
        for run in runs:
            vehicle = run.case.vehicle
            hull = vehicle["radius"]
            scale = {
                "deviation": 1 / hull**2,
                "effort": 1 / vehicle["Fu_max"] ** 2,
                "remaining": 1 / run.case.scenario.path.length,
            }
            linear = {name: weights.get(name, 0.0) * s for name, s in scale.items()}
            surrogates = run.surrogates(values)
            missing = max(0.0, floor - surrogates["clearance"]) / hull
            pay = weights.get("clearance", 0.0)
            total += sum(linear[name] * surrogates[name] for name in linear) + pay * missing**2
            slope += run.gradient(values, {**linear, "clearance": -2 * pay * missing / hull})
        if not (np.isfinite(total) and np.isfinite(slope).all()):
            return 1e9, np.zeros(len(logs))  # the line search then shortens its step
        return total, slope * values

    return cost


def _check(
    cases: Sequence[Case], gains: Gains, ranges: Mapping[str, tuple[float, float]], weights: Mapping[str, float]
) -> None:
    if not cases:
        raise InputError("has nothing to simulate", key="refine", remedy="give at least one case")
    for name in weights:
        if name not in SURROGATES:
            raise InputError("no such surrogate", key=name, remedy=nearest(name, SURROGATES))
    for name, (low, high) in ranges.items():
        if not 0 < low < high < np.inf:
            raise InputError("is not a range", key=name, value=(low, high), remedy="give 0 < low < high")
        gains.with_values({name: low}).with_values({name: high})  # raises InputError for a bound that is not allowed
