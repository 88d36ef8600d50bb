"""The barrier with inertia: how near an obstacle may be before a vehicle with thrust lag must brake.

Along the latched direction n (robot → obstacle), m11 = m22 = m turn Coriolis forces into none, and
m v̇ = F + f − D(v − c), Ḟ = (u − F)/τ: v own speed, F thrust, u ≤ −F_b while it brakes, D drag, c current, f whatever
else pushes. With v_o the most that the obstacle comes on, s = v + v_o, and z = s + τ max(F + F_b, 0)/m:

1. z ≥ s and ż ≤ −(F_b − f + D(v − c))/m ≤ −F'/m while s ≥ 0, with F' = F_b − f − D(v_o + c), the largest drag, as D is
   odd and rising. (Where the brake gives more than F_b, F < −F_b: there z is s, and the same holds.)
2. S = m z²/(2F') then has Ṡ = m z ż/F' ≤ −z ≤ −s, and the clearance l̇ ≥ −s: l − S does not fall. While s < 0 it
   grows, as F falls, if s = 0 is put in S. So braking keeps l ≥ S ≥ 0. This is `stopping_distance`:
   m s²/(2F') + s τ(F + F_b)/F' + τ²(F + F_b)²/(2F' m), convex in m, so that the two ends of the mass range are the
   worst; it rises with s and F. (Nor need s = 0 be put in: for s = −r < 0 < z, drag of the retreat pushes with
   D(v_o + c + r), and l − S does not fall as long as z (D(v_o + c + r) + f − F_b) ≤ r F'; where z ≤ 0, S is 0. A
   shorter lag changes nothing: then z falls faster.)
3. Drag helps: B with B'(z) = max over v ≤ z of m(v + v_o)/(F_b − f + D(v − c)) (least drag ahead, largest astern) keeps
   l ≥ B just so: Ḃ ≤ −(v + v_o). B = m G(v_0 + τ(F + F_b)/m), G convex: a perspective, convex in m. This is
   `stopping_way`, by an upper sum; 1.1 to 2.2 times less than S.
4. Sampling: what is measured is `age` old and ε wrong, v is e_v wrong, and for a period T any thrust may act. If
   d − ε − (V + v_o) age − (v + e_v + v_o) T − a⁺T²/2 ≥ S(v + e_v + a⁺T, F⁺), V the largest own speed since the echo and
   a⁺ = (F⁺ + f + D(v_o + c))/m_min, then l ≥ S at the next decision too. Else full brake along n, until the test
   passes again; l ≥ S all the while, by 2. So it never hits what it has once been far enough from.
5. Distance to a convex body is convex in the position: what is true along the n of the last decision that did not
   brake is true of the clearance.
6. A law that brakes as soon as v exceeds its own bound b(d) by x(b), what its velocity loop needs to ask for F_b, keeps
   l ≥ S (or B) as well, if wherever it does not, d − ε is at least the range of step 4 at v = b + x, down to d = 0.

Assumed: one obstacle at a time (braking before one does not lead into another), |v_o| bounded for ever, m11 = m22.
Sideways speed w at the start of braking adds `sideways_force`, since drag by axis is not along the velocity; ahead, at
a, it helps with (X a + X2 a²/√2) less that force at least, whatever the heading. Along the velocity, drag is pushed up
by X2 w min(v_o + c, w/2) at most. A hull that turns at r rad/s while it brakes, nothing being
asked across, turns what the lag still delivers: z = s + (τ max(F + F_b, 0) + rτ²|F_across|)/m obeys step 1 with (rτ)²F
as further push. Each axis is limited by itself: on a diagonal, the largest thrust is √2 that of one axis.

The steps are claims of `surctl verify` (`braking-keeps`, `-retreat`, `-mass`); step 3 as a table that is checked cell
by cell, steps 4 to 6 for a vehicle, a watch and a law are certificates (`surctl.verification.braking`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf, isfinite, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.vehicle import Vehicle

__all__ = [
    "LEAST_THRUST",
    "Brakes",
    "Watch",
    "admissible",
    "allowed_speed",
    "beside",
    "brakes_of",
    "fastest_obstacle",
    "range_needed",
    "sideways_force",
    "stopping_distance",
    "stopping_distance_with_drag",
    "tabled_stopping_distance",
]

LEAST_THRUST = 0.85
"""Share of the stated thrust that is counted on."""

_SUMMANDS = 4000  # of the upper sum: less than 0.2 % too long


@dataclass(frozen=True)
class Brakes:
    """What is counted on to stop a vehicle, surge and sway alike.

    Attributes:
        masses: least and largest [kg], > 0.
        least: F_b > 0, thrust against the motion that is surely there [N].
        most: F⁺, thrust that may still push when braking begins [N].
        lag: τ ≥ 0 of the thrust [s].
        linear: least and largest linear drag [N s/m].
        quadratic: least and largest quadratic drag [N s²/m²].
        push: f ≥ 0, other force towards the obstacle [N].
        current: c ≥ 0, of the water towards the obstacle [m/s].

    Raises:
        InputError: a number out of these bounds.
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
        """Check."""
        for name in ("masses", "linear", "quadratic"):
            low, high = getattr(self, name)
            positive = low > 0 if name == "masses" else low >= 0
            if not (positive and low <= high and isfinite(high)):
                raise InputError("is not a range", key=name, value=(low, high), remedy="least first, none negative")
        for name, strict in (
            ("least", True),
            ("most", True),
            ("lag", False),
            ("disturbance", False),
            ("current", False),
        ):
            value = getattr(self, name)
            if not isfinite(value) or value < 0 or (strict and value == 0):
                bound = "must be greater than 0" if strict else "must be at least 0"
                raise InputError(bound, key=name, value=value, remedy="correct the number")

    def largest_drag(self, speed: float) -> float:
        """D(v) ≥ 0 at the largest coefficients [N]."""
        return self.linear[1] * speed + self.quadratic[1] * speed**2

    def left(self, obstacle: float) -> float:
        """F' [N]: of the braking force, before an obstacle that comes on at v_o [m/s]; may be negative."""
        return self.least - self.disturbance - self.largest_drag(obstacle + self.current)

    def acceleration(self, obstacle: float) -> float:
        """a⁺ [m/s²], the most by which it may gain on the obstacle."""
        return (self.most + self.disturbance + self.largest_drag(obstacle + self.current)) / self.masses[0]


@dataclass(frozen=True)
class Watch:
    """What the decision knows, and how late.

    Attributes:
        period: T > 0 between two decisions [s].
        age: ≥ 0 of a range when it is used [s].
        range_error: ε ≥ 0 [m].
        speed_error: e_v ≥ 0 [m/s].

    Raises:
        InputError: a number out of these bounds.
    """

    period: float = 0.05
    age: float = 0.0
    range_error: float = 0.0
    speed_error: float = 0.0

    def __post_init__(self) -> None:
        """Check."""
        for name in ("period", "age", "range_error", "speed_error"):
            value = getattr(self, name)
            if not isfinite(value) or value < 0 or (name == "period" and value == 0):
                raise InputError("is out of its bounds", key=name, value=value, remedy="none negative, period above 0")


def brakes_of(
    vehicle: Vehicle,
    *,
    share: float = LEAST_THRUST,
    spread: float | None = None,
    disturbance: float = 0.0,
    current: float = 0.0,
) -> Brakes:
    """A vehicle at the worst of its ranges.

    Args:
        vehicle: whose numbers count.
        share: of the stated thrust that is surely there, in (0, 1].
        spread: mass and drag are off by this share, and the thrust is at most the stated one; None takes the ranges
            of the vehicle's file, in which a number without a range is exact.
        push, current: see `Brakes`.
    """
    if not 0 < share <= 1:
        raise InputError("must be in (0, 1]", key="share", value=share, remedy="give a share of the thrust")
    if spread is not None and not 0 <= spread < 1:
        raise InputError("must be in [0, 1)", key="spread", value=spread, remedy="give a share, for instance 0.2")

    def ends(*names: str) -> tuple[float, float]:
        ranges = [_ends(vehicle, name, spread) for name in names]
        return min(low for low, _ in ranges), max(high for _, high in ranges)

    limits = ("Fu_max", "Fv_max")
    most = [vehicle[n] if spread is not None else _ends(vehicle, n, None)[1] for n in limits]
    return Brakes(
        ends("m11", "m22"),
        share * min(vehicle[name] for name in limits),
        max(most),
        vehicle["thrust_lag"],
        ends("Xu", "Yv"),
        ends("Xuu", "Yvv"),
        disturbance,
        current,
    )


def _ends(vehicle: Vehicle, name: str, spread: float | None) -> tuple[float, float]:
    value, stated = vehicle[name], vehicle.parameters[name].range
    if spread is not None:
        return value * (1 - spread), value * (1 + spread)
    return stated or (value, value)


def stopping_distance(brakes: Brakes, speed: float, *, obstacle: float = 0.0, thrust: float | None = None) -> float:
    """S [m], closed form, without the help of drag; inf when the obstacle is too fast to be braked for.

    Args:
        brakes: what stops.
        speed: v, own, towards the obstacle [m/s].
        obstacle: v_o ≥ 0 [m/s].
        thrust: F, what pushes now [N]; default the most.
    """
    left = brakes.left(obstacle)
    if left <= 0:
        return inf
    closing, swing = max(speed + obstacle, 0.0), _swing(brakes, thrust)
    return max(m * (closing + swing / m) ** 2 / (2 * left) for m in brakes.masses)


def stopping_distance_with_drag(
    brakes: Brakes, speed: float, *, obstacle: float = 0.0, thrust: float | None = None
) -> float:
    """B [m], with the least help of drag, at most S; see `stopping_distance`."""
    if brakes.left(obstacle) <= 0:
        return inf
    own, swing = max(speed, -obstacle), _swing(brakes, thrust)
    return max(_upper_sum(brakes, m, own + swing / m, obstacle) for m in brakes.masses)


def tabled_stopping_distance(brakes: Brakes, fastest: float, *, obstacle: float = 0.0) -> Callable[..., float]:
    """`stopping_way` for many speeds before one obstacle, from a table; up to 1 % longer, never shorter.

    Args:
        brakes: what stops, with the most thrust still pushing.
        fastest: largest own speed that will be asked for [m/s].
        obstacle: v_o ≥ 0 [m/s].
    """
    swing, left = _swing(brakes, None), brakes.left(obstacle)
    tables = []
    for mass in brakes.masses if left > 0 else ():
        above = _above(brakes, mass, fastest + swing / mass, obstacle)
        # B is convex, so that between two places of an upper sum the chord lies above it
        tables.append((mass, above, np.concatenate([[0.0], np.cumsum(above.step * above.integrand)])))

    def interpolated(brakes: Brakes, speed: float, *, obstacle: float, thrust: float | None = None) -> float:
        closing = max(speed, -obstacle) + obstacle
        return max(
            (float(np.interp(closing + swing / mass, above.places, total)) for mass, above, total in tables),
            default=inf,
        )

    return interpolated


def _swing(brakes: Brakes, thrust: float | None) -> float:
    """τ(F + F_b) [N s], what the lag leaves of the thrust that pushes."""
    return brakes.lag * max((brakes.most if thrust is None else thrust) + brakes.least, 0.0)


class _Above(NamedTuple):
    """B' at most over each step, and where the steps end, the first place 0."""

    step: float
    places: NDArray[np.float64]
    integrand: NDArray[np.float64]


def _above(brakes: Brakes, mass: float, top: float, obstacle: float) -> _Above:
    step = (top + obstacle) / _SUMMANDS
    v = -obstacle + step * np.arange(1, _SUMMANDS + 1)
    through = v - brakes.current
    linear = np.where(through > 0, *brakes.linear)
    quadratic = np.where(through > 0, *brakes.quadratic)
    force = brakes.least - brakes.disturbance + through * (linear + quadratic * abs(through))
    places = np.asarray(step * np.arange(_SUMMANDS + 1), dtype=np.float64)
    return _Above(step, places, np.maximum.accumulate(mass * (v + obstacle) / force))


def _upper_sum(brakes: Brakes, mass: float, top: float, obstacle: float) -> float:
    above = _above(brakes, mass, top, obstacle)
    return float(above.step * np.sum(above.integrand))


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
    """Range [m] that must be read for another period without braking to be safe (step 4 above).

    Args:
        brakes, obstacle: see `stopping_distance`.
        watch: what is known.
        speed: v as measured [m/s].
        thrust: F⁺ at the end of the period [N]; default the most.
        fastest: V, the largest own speed since the echo as measured [m/s]; default `speed`.
        way: `stopping_distance` or `stopping_way`.
    """
    v, period, gain = speed + watch.speed_error, watch.period, brakes.acceleration(obstacle)
    before = (v if fastest is None else fastest + watch.speed_error) + obstacle
    left = stopping(brakes, v + gain * period, obstacle=obstacle, thrust=thrust)
    return watch.range_error + before * watch.age + (v + obstacle) * period + gain * period**2 / 2 + left


def admissible(
    brakes: Brakes,
    watch: Watch,
    measured: float,
    speed: float,
    *,
    obstacle: float = 0.0,
    thrust: float | None = None,
    fastest: float | None = None,
) -> float:
    """h [m] ≥ 0 where another period without braking is safe at a range that is `measured`; −inf if never."""
    return measured - range_needed(brakes, watch, speed, obstacle=obstacle, thrust=thrust, fastest=fastest)


def allowed_speed(brakes: Brakes, watch: Watch, measured: float, *, obstacle: float = 0.0) -> float:
    """Largest own speed [m/s] for which `admissible` holds, V the same speed.

    Too near even for standing still relative to the obstacle, it goes on with its slope there: it asks for a retreat.

    −inf where the obstacle is too fast to be braked for.
    """
    left = brakes.left(obstacle)
    if left <= 0:
        return -inf
    gain, late = brakes.acceleration(obstacle), watch.age + watch.period
    gained, swing = gain * watch.period, _swing(brakes, None)
    rest = measured - watch.range_error - gain * watch.period**2 / 2 + late * gained
    closing = inf
    for m in brakes.masses:
        k, lost = m / (2 * left), swing / m
        remaining, slope = rest - k * lost**2, late + 2 * k * lost
        closing = min(closing, 2 * remaining / (slope + sqrt(slope**2 + 4 * k * max(remaining, 0.0))))
    return closing - watch.speed_error - obstacle - gained


def fastest_obstacle(brakes: Brakes) -> float:
    """Speed [m/s] of an obstacle up to which braking guarantees anything: D(v_o + c) = F_b − f, the largest drag."""
    force, linear, quadratic = brakes.least - brakes.disturbance, brakes.linear[1], brakes.quadratic[1]
    if force <= 0:
        return 0.0
    if linear == quadratic == 0:
        return inf
    return max(2 * force / (linear + sqrt(linear**2 + 4 * quadratic * force)) - brakes.current, 0.0)


def sideways_force(brakes: Brakes, sideways: float, *, obstacle: float = 0.0) -> float:
    """Most [N] that drag by axis pushes towards an obstacle beyond D(v_o), at a sideways speed w [m/s], any heading.

    Drag along −n of the velocity −v_o n + w t, n at any angle to the axes, each coefficient anywhere in its range
    [low, high], is at most (high v_o + (high − low) w/2) + high v_o² + √2 high v_o w + (2 high − low) w²/(3√3).
    """
    (low, high), (low2, high2) = brakes.linear, brakes.quadratic
    square = (2 * high2 - low2) * sideways**2 / (3 * sqrt(3))
    return (high - low) * sideways / 2 + sqrt(2) * high2 * (obstacle + brakes.current) * sideways + square


def beside(brakes: Brakes, sideways: float, *, obstacle: float = 0.0) -> Brakes:
    """The same with `sideways_force` as further push."""
    return replace(brakes, disturbance=brakes.disturbance + sideways_force(brakes, sideways, obstacle=obstacle))
