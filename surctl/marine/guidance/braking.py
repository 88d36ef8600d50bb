"""Braking with thrust lag and drag: stopping distance, largest closing speed, fastest obstacle.

While the robot brakes towards an obstacle in the direction n, m v̇ = F + f − D(v − c) and Ḟ = (u − F)/τ, with the speed
v along n, the thrust F, its time constant τ, the command u ≤ −F_b with the guaranteed braking force F_b, the drag D,
the speed c of the water and any other force f. Let v_o be the largest speed of the obstacle towards the robot, and s =
v + v_o. The stopping distance is S = m z²/(2F') with z = s + τ max(F + F_b, 0)/m and F' = F_b − f − D(v_o + c); with
the least drag, it is B ≤ S.

`analysis/15_braking_barrier/proof.md` proves in eight steps that a robot that brakes whenever the measured range is
below `range_needed` never hits the obstacle. `surctl verify` proves steps 1 and 2 as the claims `braking-keeps`,
`braking-retreat` and `braking-mass`; certificates (`surctl.marine.verification.braking`) prove steps 4 to 6 for one
vehicle, one law, and one `Watch`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf, isfinite, sqrt
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_number
from surctl.marine.vehicle import Vehicle, steady_speed

LEAST_THRUST = 0.85
"""Share of the vehicle's stated thrust that counts as guaranteed for braking."""

_SUMMANDS = 4000  # terms of the upper sum, which is then less than 0.2 % too long


@dataclass(frozen=True)
class Brakes:
    """The braking data of a vehicle in the worst case, with the same values for surge and sway.

    Attributes:
        masses: least and largest mass [kg], > 0.
        least: F_b > 0, guaranteed thrust against the motion [N].
        most: F⁺, largest thrust towards the obstacle when braking begins [N].
        lag: time constant τ ≥ 0 of the thrust [s].
        linear: least and largest linear drag [N s/m].
        quadratic: least and largest quadratic drag [N s²/m²].
        disturbance: f ≥ 0, other force towards the obstacle [N].
        current: c ≥ 0, speed of the water towards the obstacle [m/s].
    """

    masses: tuple[float, float]
    least: float
    most: float
    lag: float
    linear: tuple[float, float] = (0.0, 0.0)
    quadratic: tuple[float, float] = (0.0, 0.0)
    disturbance: float = 0.0
    current: float = 0.0

    def __post_init__(self) -> None:
        for name in ("masses", "linear", "quadratic"):
            low, high = getattr(self, name)
            positive = low > 0 if name == "masses" else low >= 0
            if not (positive and low <= high and isfinite(high)):
                remedy = "give the least value first, and no negative value"
                raise InputError("is not a range", key=name, value=(low, high), remedy=remedy)
        for name, unit in {"least": "N", "most": "N", "lag": "s", "disturbance": "N", "current": "m/s"}.items():
            check_number(name, getattr(self, name), unit=unit, zero=name not in ("least", "most"))

    def largest_drag(self, speed: float) -> float:
        """Return the drag force D(v) ≥ 0 [N] at a speed v ≥ 0 [m/s], for the largest drag coefficients."""
        return self.linear[1] * speed + self.quadratic[1] * speed**2

    def left(self, obstacle: float) -> float:
        """Return the net braking force F' = F_b − f − D(v_o + c) [N] for an obstacle's speed v_o; may be negative."""
        return self.least - self.disturbance - self.largest_drag(obstacle + self.current)

    def acceleration(self, obstacle: float) -> float:
        """Return a⁺ [m/s²], the largest acceleration of the robot towards the obstacle."""
        return (self.most + self.disturbance + self.largest_drag(obstacle + self.current)) / self.masses[0]


@dataclass(frozen=True)
class Watch:
    """Delay and accuracy of the measurements on which a braking decision is based.

    Attributes:
        period: T > 0, time between two braking decisions [s].
        age: age of a measured range when the law uses it [s], ≥ 0.
        range_error: ε ≥ 0, largest error of a measured range [m].
        speed_error: e_v ≥ 0, largest error of the robot's measured speed [m/s].
    """

    period: float = 0.05
    age: float = 0.0
    range_error: float = 0.0
    speed_error: float = 0.0

    def __post_init__(self) -> None:
        for name, unit in {"period": "s", "age": "s", "range_error": "m", "speed_error": "m/s"}.items():
            check_number(name, getattr(self, name), unit=unit, zero=name != "period")


def brakes_of(
    vehicle: Vehicle,
    *,
    share: float = LEAST_THRUST,
    spread: float | None = None,
    disturbance: float = 0.0,
    current: float = 0.0,
) -> Brakes:
    """Return the braking data of a vehicle in the worst case of its ranges; without sway force, of surge alone.

    Args:
        share: share of the vehicle's largest thrust that is guaranteed for braking, in (0, 1].
        spread: relative error of mass and drag; the thrust in the vehicle's file then counts as the largest thrust.
            None: use the ranges in the vehicle's file; a parameter without a range counts as exact.
        disturbance, current: values of the attributes `disturbance` and `current` of the result.
    """
    if not 0 < share <= 1:
        raise InputError("must be in (0, 1]", key="share", value=share, remedy="give a share of the thrust")
    if spread is not None and not 0 <= spread < 1:
        raise InputError("must be in [0, 1)", key="spread", value=spread, remedy="give a share, for instance 0.2")

    def ends(*names: str) -> tuple[float, float]:
        ranges = [_ends(vehicle, name, spread) for name in names]
        return min(low for low, _ in ranges), max(high for _, high in ranges)

    axes = slice(2 if vehicle["Fv_max"] > 0 else 1)
    most = [vehicle[n] if spread is not None else _ends(vehicle, n, None)[1] for n in ("Fu_max", "Fv_max")[axes]]
    most += [vehicle[name] for axis, name in vehicle.form.reverse() if axis < 2]
    return Brakes(
        ends(*("m11", "m22")[axes]),
        share * float(min(vehicle.thrust_limit[axes])),
        max(most),
        vehicle["thrust_lag"],
        ends(*("Xu", "Yv")[axes]),
        ends(*("Xuu", "Yvv")[axes]),
        disturbance,
        current,
    )


def _ends(vehicle: Vehicle, name: str, spread: float | None) -> tuple[float, float]:
    value, stated = vehicle[name], vehicle.parameters[name].range
    if spread is not None:
        return value * (1 - spread), value * (1 + spread)
    return stated or (value, value)


def stopping_distance(brakes: Brakes, speed: float, *, obstacle: float = 0.0, thrust: float | None = None) -> float:
    """Return the stopping distance S [m] in closed form; S ignores that drag helps to brake.

    S is infinite if the obstacle is so fast that braking cannot prevent a collision.

    Args:
        speed: speed v of the robot towards the obstacle [m/s].
        obstacle: speed v_o ≥ 0 of the obstacle towards the robot [m/s].
        thrust: present thrust F [N]; default: the largest thrust F⁺.
    """
    left = brakes.left(obstacle)
    if left <= 0:
        return inf
    closing, swing = max(speed + obstacle, 0.0), _swing(brakes, thrust)
    return max(m * (closing + swing / m) ** 2 / (2 * left) for m in brakes.masses)


def stopping_distance_with_drag(
    brakes: Brakes, speed: float, *, obstacle: float = 0.0, thrust: float | None = None
) -> float:
    """Return the stopping distance B ≤ S [m] if the least drag helps to brake; see `stopping_distance`."""
    if brakes.left(obstacle) <= 0:
        return inf
    own, swing = max(speed, -obstacle), _swing(brakes, thrust)
    bounds = (_above(brakes, mass, own + swing / mass, obstacle) for mass in brakes.masses)
    return max(float(above.step * np.sum(above.integrand)) for above in bounds)


def tabled_stopping_distance(brakes: Brakes, fastest: float, *, obstacle: float = 0.0) -> Callable[..., float]:
    """Return `stopping_distance_with_drag` as a function of the speed, from a table for one obstacle speed.

    The tabulated distance is up to 1 % longer than the exact distance, and never shorter.

    Args:
        fastest: largest speed of the robot for which the table holds a distance [m/s].
        obstacle: speed v_o ≥ 0 of the obstacle towards the robot [m/s].
    """
    swing, left = _swing(brakes, None), brakes.left(obstacle)
    tables = []
    for mass in brakes.masses if left > 0 else ():
        above = _above(brakes, mass, fastest + swing / mass, obstacle)
        # B is convex, so linear interpolation between the upper sums is an upper bound too
        tables.append((mass, above, np.concatenate([[0.0], np.cumsum(above.step * above.integrand)])))

    def interpolated(brakes: Brakes, speed: float, *, obstacle: float, thrust: float | None = None) -> float:
        closing = max(speed, -obstacle) + obstacle
        return max(
            (float(np.interp(closing + swing / mass, above.places, total)) for mass, above, total in tables),
            default=inf,
        )

    return interpolated


def _swing(brakes: Brakes, thrust: float | None) -> float:
    """Return the impulse [N s] towards the obstacle that the thrust lag adds after the command to brake, τ(F + F_b)."""
    return brakes.lag * max((brakes.most if thrust is None else thrust) + brakes.least, 0.0)


class _Above(NamedTuple):
    """Upper bound on the derivative of the stopping distance with drag, on each interval of a grid of speeds."""

    step: float
    places: NDArray[np.float64]  # ends of the steps, starting with 0
    integrand: NDArray[np.float64]  # the bound on each step


def _above(brakes: Brakes, mass: float, top: float, obstacle: float) -> _Above:
    step = (top + obstacle) / _SUMMANDS
    v = -obstacle + step * np.arange(1, _SUMMANDS + 1)
    through = v - brakes.current
    linear = np.where(through > 0, *brakes.linear)
    quadratic = np.where(through > 0, *brakes.quadratic)
    force = brakes.least - brakes.disturbance + through * (linear + quadratic * abs(through))
    places = np.asarray(step * np.arange(_SUMMANDS + 1), dtype=np.float64)
    return _Above(step, places, np.maximum.accumulate(mass * (v + obstacle) / force))


def range_needed(
    brakes: Brakes,
    watch: Watch,
    speed: float,
    *,
    obstacle: float = 0.0,
    thrust: float | None = None,
    fastest: float | None = None,
    stopping: Callable[..., float] = stopping_distance,
) -> float:
    """Return the smallest measured range [m] at which another period without braking is safe (step 4 of the proof).

    Args:
        brakes, obstacle: see `stopping_distance`.
        watch: delay and accuracy of the measurements.
        speed: measured speed v of the robot [m/s].
        thrust: thrust F⁺ at the end of the period [N]; default: the largest thrust.
        fastest: largest measured speed V of the robot since the echo that gave the range [m/s]; default: `speed`.
        stopping: function for the stopping distance, `stopping_distance` or `stopping_distance_with_drag`.
    """
    v, period, gain = speed + watch.speed_error, watch.period, brakes.acceleration(obstacle)
    before = (v if fastest is None else fastest + watch.speed_error) + obstacle
    left = stopping(brakes, v + gain * period, obstacle=obstacle, thrust=thrust)
    return watch.range_error + before * watch.age + (v + obstacle) * period + gain * period**2 / 2 + left


def fastest_obstacle(brakes: Brakes) -> float:
    """Return the largest obstacle speed v_o [m/s] for which braking guarantees that no collision happens.

    This speed solves D(v_o + c) = F_b − f for the largest drag.
    """
    force = brakes.least - brakes.disturbance
    if force <= 0:
        return 0.0
    return max(steady_speed(force, brakes.linear[1], brakes.quadratic[1]) - brakes.current, 0.0)


_LEAST_LEFT = 0.02  # lower bound of F' as a share of F_b; for an obstacle too fast for braking it causes a retreat


@dataclass(frozen=True, eq=False)
class BrakeSymbols:
    """The data of `Brakes` without disturbance and current, as scalar expressions; `period` T is that of `Watch`.

    `linear` and `quadratic` are the largest drag coefficients.
    """

    lightest: ca.SX
    heaviest: ca.SX
    least: ca.SX
    most: ca.SX
    lag: ca.SX
    linear: ca.SX
    quadratic: ca.SX
    period: ca.SX

    def left(self, obstacle: ca.SX) -> ca.SX:
        """Return the net braking force F' [N], limited to at least 2 % of the guaranteed thrust F_b."""
        return ca.fmax(self.least - self._drag(obstacle), _LEAST_LEFT * self.least)

    def acceleration(self, obstacle: ca.SX) -> ca.SX:
        """Return a⁺ [m/s²], the largest acceleration of the robot towards the obstacle."""
        return (self.most + self._drag(obstacle)) / self.lightest

    def _drag(self, speed: ca.SX) -> ca.SX:
        return self.linear * speed + self.quadratic * speed * speed


def closing_bound(brakes: BrakeSymbols, distance: ca.SX, *, obstacle: ca.SX) -> ca.SX:
    """Return the largest safe speed towards the obstacle [m/s]; a negative speed requires a retreat.

    `distance` is the clearance minus its largest error [m], `obstacle` the speed v_o ≥ 0 of the obstacle towards the
    robot [m/s]. The bound is exact for range measurements without delay and error.
    """
    gain, period, roots = brakes.acceleration(obstacle), brakes.period, []
    swing = brakes.lag * (brakes.most + brakes.least)
    for m in (brakes.lightest, brakes.heaviest):
        k, lost = m / (2 * brakes.left(obstacle)), swing / m
        remaining = distance + gain * period * period / 2 - k * lost * lost
        slope = period + 2 * k * lost
        roots.append(2 * remaining / (slope + ca.sqrt(slope * slope + 4 * k * ca.fmax(remaining, 0))))
    return ca.fmin(*roots) - obstacle - gain * period


def sideways_force(brakes: Brakes, sideways: float, *, obstacle: float = 0.0) -> float:
    """Return the largest additional drag force towards an obstacle [N] at a sideways speed w [m/s], for any heading.

    For the velocity −v_o n + w t (n towards the obstacle, t perpendicular to n), drag that acts on each axis
    separately, and coefficients in [low, high], the drag along n is at most (high v_o + (high − low) w/2) + high v_o² +
    √2 high v_o w + (2 high − low) w²/(3√3).
    """
    (low, high), (low2, high2) = brakes.linear, brakes.quadratic
    square = (2 * high2 - low2) * sideways**2 / (3 * sqrt(3))
    return (high - low) * sideways / 2 + sqrt(2) * high2 * (obstacle + brakes.current) * sideways + square


def beside(brakes: Brakes, sideways: float, *, obstacle: float = 0.0) -> Brakes:
    """Return the braking data with `sideways_force` added to the disturbance force."""
    return replace(brakes, disturbance=brakes.disturbance + sideways_force(brakes, sideways, obstacle=obstacle))
