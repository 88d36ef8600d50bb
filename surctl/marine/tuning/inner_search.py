"""A search for the inner gains k_v, k_r and k_psi that have the margins of derived gains."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from surctl.marine.tuning.vehicle_rule import inner_start, rule
from surctl.marine.vehicle import Vehicle, plant_parameters
from surctl.marine.verification.cascade import Cascade, build_cascades
from surctl.marine.verification.linear import DISK_PLACES, corner_margin, open_loop
from surctl.verification.linear import LEAST_DISK_MARGIN, screened_peaks

__all__ = ["searched_inner"]

Array = NDArray[np.float64]

_TARGET = 0.42  # nominal margin at commands and measurements together at which the first search stops
_ABOVE = 1.15  # the second search stops at this multiple of the least disk margin, which its grid misses by 10 %
_CORNERS = 3  # most corners that the second search adds, the worst one each time
_FACTORS = (1.6, 1.25, 1.1)  # of the three gains in the neighbourhoods of the search
_NEIGHBOURS = np.array(  # exponents of the factor for k_v, k_r, k_psi
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1], [0, 1, -1], [1, 1, 1]]
)
_NEIGHBOURS = np.vstack([_NEIGHBOURS, -_NEIGHBOURS]).astype(float)
_LEAST, _MOST = np.array([0.7, 0.5, 0.5]), np.array([2.0, 4.0, 4.0])  # bounds of the search, as shares of the formulae
_ROUNDS = 4  # largest number of neighbourhoods for each factor
_SLOW = 0.25  # share of the cruise speed at which the margin is checked too
_UNSTABLE = 1e-3  # margin of an unstable loop in the search


def searched_inner(vehicle: Vehicle, cruise: float, dt: float, near: Array | None = None) -> tuple[Array, float]:
    """Return the inner gains (3,) of the formulae, or better ones, and their disk margin at the worst corner.

    The first search raises the nominal margin. If the disk margin is below `LEAST_DISK_MARGIN` then, a second one
    raises it. `near` is the result at a similar speed.
    """
    start = inner_start(vehicle, cruise=cruise, dt=dt)
    best, factors = (start, _FACTORS) if near is None else (near, _FACTORS[1:])

    def nominal(inner: Array, above: float) -> Array:
        return _margins(vehicle, inner, cruise, dt, above=above)

    best = _climbed(nominal, start, best, factors, _TARGET)
    margin, plant = _corner_margin(vehicle, best, cruise, dt)
    plants = [vehicle]
    for _ in range(_CORNERS):
        if margin >= LEAST_DISK_MARGIN or plant in plants:
            break
        plants.append(plant)

        def uncertain(inner: Array, _: float, plants: Sequence[Vehicle] = tuple(plants)) -> Array:
            each = [_estimates(vehicle, inner, cruise, dt, speed=cruise, plant=one) for one in plants]
            return np.asarray(np.min(each, axis=0))

        tried = _climbed(uncertain, start, best, _FACTORS, _ABOVE * LEAST_DISK_MARGIN)
        reached, plant = _corner_margin(vehicle, tried, cruise, dt)
        if reached > margin:
            best, margin = tried, reached
    return best, margin


def _climbed(
    value: Callable[[Array, float], Array], start: Array, best: Array, factors: Sequence[float], target: float
) -> Array:
    """Return inner gains (3,) with a larger value, searched from `best`.

    The search goes to the best neighbour until the target is reached or none is better; then the steps become smaller.
    The gains stay within `_LEAST` and `_MOST` times those of the formulae, `start`.
    """
    reached = float(value(best[None], 0.0)[0])
    for factor in factors:
        for _ in range(_ROUNDS):
            if reached >= target:
                return best
            around = np.clip(best * factor**_NEIGHBOURS, start * _LEAST, start * _MOST)
            values = value(around, reached)
            at = int(np.argmax(values))
            if values[at] <= reached:
                break
            best, reached = around[at], float(values[at])
    return best


def _corner_margin(vehicle: Vehicle, inner: Array, cruise: float, dt: float) -> tuple[float, Vehicle]:
    values = rule(vehicle, inner, cruise=cruise, dt=dt)
    return corner_margin(vehicle, values, cruise=cruise, dt=dt)[:2]


def _margins(vehicle: Vehicle, inner: Array, cruise: float, dt: float, *, above: float) -> Array:
    """Return estimates (n,) of the nominal disk margin, at commands and measurements together, of n gain sets (n, 3).

    The margin is the least of two speeds; the second speed is evaluated only where the first margin is larger than
    `above`. An unstable loop gets a number below 0.001 that is the larger, the slower its pole grows.
    """
    worst = _estimates(vehicle, inner, cruise, dt, speed=cruise)
    better = np.flatnonzero(worst > max(above, _UNSTABLE))
    if better.size:
        worst[better] = np.minimum(worst[better], _estimates(vehicle, inner[better], cruise, dt, speed=_SLOW * cruise))
    return worst


def _estimates(
    vehicle: Vehicle, inner: Array, cruise: float, dt: float, *, speed: float, plant: Vehicle | None = None
) -> Array:
    # of the vehicle at both places together; of a plant, the lesser of both places
    cascades = _cascades(vehicle, inner, cruise, speed, dt, plant or vehicle)
    places = ("both",) if plant is None else DISK_PLACES[:2]
    peaks = np.max([screened_peaks(open_loop(cascades, place)) for place in places], axis=0)
    growth = np.maximum(cascades.poles[:, 0].real, 0.0)
    return np.where(np.isfinite(peaks), 1 / peaks, _UNSTABLE / (1 + growth))


def _cascades(vehicle: Vehicle, inner: Array, cruise: float, speed: float, dt: float, plant: Vehicle) -> Cascade:
    rows = [rule(vehicle, one, cruise=cruise, dt=dt) for one in inner]
    actual, model = (np.tile(plant_parameters(one), (len(inner), 1)) for one in (plant, vehicle))
    gains = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    form = vehicle.form
    return build_cascades(
        actual, gains, cruise=np.full(len(inner), speed), dt=dt, model=model, form=plant.form, model_form=form
    )
