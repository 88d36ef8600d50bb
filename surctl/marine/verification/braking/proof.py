"""Proof of a claim about braking: compute its tables, and let the independent checker decide."""

from __future__ import annotations

import time
from dataclasses import dataclass
from math import ceil, floor, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import check_document, seal
from surctl.marine.guidance.braking import LEAST_THRUST
from surctl.marine.verification.braking.claim import BrakingClaim
from surctl.verification.certified import Certified

__all__ = [
    "BrakingProof",
    "DistanceTable",
    "Encounter",
    "distance_table",
    "encounter",
    "figures",
    "figures_needed",
    "largest_obstacle",
    "prove_braking",
]

_CELLS, _RETREATS = 40, 64
_DIGITS = 9  # decimals of a knot or slope
_LIFT = 1e-4  # relative step by which a slope is raised until its cell is valid
_FIGURES = 1e4  # a distance is rounded up to 0.1 mm
_NEGLECTED = 1e-9
_SPARE = -1e-13

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Encounter:
    """The encounter of the vehicle with one obstacle.

    Attributes:
        obstacle: approach speed of the obstacle [m/s].
        through: speed of the vehicle astern through the water at closing speed 0 [m/s].
        disturbance: largest disturbance force towards the obstacle [N].
        swing: impulse that the thrust still delivers because of its lag [N s].
    """

    obstacle: float
    through: float
    disturbance: float
    swing: float


def encounter(claim: BrakingClaim, obstacle: float) -> Encounter:
    """Return the speeds and forces of the encounter with an obstacle that approaches at `obstacle` [m/s]."""
    b, through = claim.brakes, obstacle + claim.brakes.current
    swing = b.lag * (claim.thrust_ahead + b.least) + claim.turn * b.lag**2 * claim.across
    return Encounter(obstacle, through, _disturbance(claim, through), swing)


def _disturbance(claim: BrakingClaim, through: float, slowest: float = 0.0) -> float:
    b, ratio, turned = claim.brakes, claim.ratio, claim.turn * claim.brakes.lag
    w = min(claim.sideways, sqrt(max(claim.fastest**2 - slowest**2, 0.0)) + 3e-9)  # the checker rounds its root up
    (low, high), (low2, high2) = _drag_ranges(claim)
    coupled, fast = (ratio - 1) / (2 * sqrt(ratio)), max(through, claim.fastest)
    side = high2 * min(through * w, w**2 / 2) + coupled * w * (high + high2 * (fast + w))
    if claim.drag == "axes":
        side = (high - low) * w / 2 + sqrt(2) * high2 * through * w + (2 * high2 - low2) * w**2 / (3 * sqrt(3))
    lost = ratio * turned**2 * max(claim.thrust_ahead, b.least)
    if ratio > 1:
        coriolis = claim.turn * b.masses[1] * (ratio - 1) * (fast * (ratio + 1) / (2 * sqrt(ratio)) + w)
        lost += ((coupled + ratio * turned) * claim.across + coriolis) * (1 + 1e-8)
    # the factors cover the checker's roots, which are rounded up
    return b.disturbance + side * (1 + 2e-8) + lost


def _drag_ranges(claim: BrakingClaim) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ranges of linear and quadratic drag; unequal masses weight the axes of the hull differently."""
    ratio = claim.ratio if claim.drag == "axes" else 1.0
    linear, quadratic = ((low / ratio, high * ratio) for low, high in (claim.brakes.linear, claim.brakes.quadratic))
    return linear, quadratic


def _largest_drag(claim: BrakingClaim, speed: float) -> float:
    (_, linear), (_, quadratic) = _drag_ranges(claim)
    return linear * speed + quadratic * speed**2


def largest_obstacle(claim: BrakingClaim) -> float:
    """Return the largest obstacle speed [m/s] that leaves some braking force, rounded down to 0.1 mm/s; 0 if none."""
    low, high = 0.0, 100.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if _left(claim, middle) >= 0 else (low, middle)
    return floor(low * _FIGURES + _NEGLECTED) / _FIGURES


def _left(claim: BrakingClaim, obstacle: float) -> float:
    through = obstacle + claim.brakes.current
    return claim.brakes.least - _disturbance(claim, through) - _largest_drag(claim, through)


@dataclass(frozen=True)
class DistanceTable:
    """The convex function G(z) [m/kg]; for a vehicle of mass m [kg], the braking distance is m G(z) [m].

    z is the closing speed plus the speed that the lagging thrust still adds. The table holds knots z [m/s] and the
    slopes G' at the knots; between two knots, G' is linear. `retreats` is whether the distance may be evaluated at
    closing speeds below 0; if not, it is that at 0.
    """

    at: Encounter
    knots: Vector
    slopes: Vector
    retreats: bool = True

    def worst(self, claim: BrakingClaim, closing: float) -> float:
        """Return the braking distance [m] at a closing speed [m/s], for the worse end of the mass range."""
        closing = closing if self.retreats else max(closing, 0.0)
        return max(claim.ratio * m * self.value(closing + self.at.swing / m) for m in claim.brakes.masses)

    def value(self, z: float) -> float:
        """Return G(max(z, 0)) [m/kg]."""
        if z <= 0:
            return 0.0
        if z > self.knots[-1]:  # no closing speed is larger, so G continues with its last slope
            return self.value(float(self.knots[-1])) + float(self.slopes[-1]) * (z - float(self.knots[-1]))
        k = int(np.searchsorted(self.knots, z, side="right")) - 1
        k = min(k, len(self.knots) - 2)
        widths = np.diff(self.knots)
        before = float(np.sum(widths[:k] * (self.slopes[:k] + self.slopes[1 : k + 1]) / 2))
        t = z - float(self.knots[k])
        rise = float((self.slopes[k + 1] - self.slopes[k]) / widths[k])
        return before + float(self.slopes[k]) * t + rise * t * t / 2


def distance_table(claim: BrakingClaim, obstacle: float) -> DistanceTable:
    """Return the table for an obstacle that approaches at `obstacle` [m/s], up to the highest z that the claim needs.

    `DistanceTable` defines z.
    """
    b, at = claim.brakes, encounter(claim, obstacle)
    fastest = claim.fastest + claim.watch.speed_error
    gain = (claim.thrust_ahead + at.disturbance + _largest_drag(claim, max(at.through, fastest))) / b.masses[0]
    top = fastest + obstacle + gain * claim.watch.period + at.swing / b.masses[0] + 0.01
    if claim.ratio > 1:  # the lag then adds more than the largest closing speed, beyond which G is straight
        top = min(top, claim.fastest + obstacle)
    knots = np.linspace(0.0, top, _CELLS + 1)
    if 0 < at.through < top:  # drag changes its sign at `through`
        knots = np.unique(np.append(knots[abs(knots - at.through) > top / (4 * _CELLS)], at.through))
    knots = np.round(knots, _DIGITS)
    slopes = np.maximum.accumulate(knots / _force(claim, at, knots))
    slopes[1] = max(slopes[1], knots[1] / float(_force(claim, at, knots[:1])[0]))  # at 0, G' rises by 1/force at least
    for k in range(len(knots) - 1):
        while _lack(claim, at, knots[k : k + 2], slopes[k : k + 2]) > 0:
            slopes[max(k, 1) : k + 2] *= 1 + _LIFT
    slopes = np.maximum.accumulate(np.ceil(slopes * (1 + 1e-7) * 10**_DIGITS) / 10**_DIGITS)
    slopes = np.array([round(float(g), _DIGITS) for g in slopes])
    return DistanceTable(at, knots, slopes, _retreats(claim, at, knots, slopes))


def _retreats(claim: BrakingClaim, at: Encounter, knots: Vector, slopes: Vector) -> bool:
    """Return whether drag during a retreat costs less distance than the retreat gains, as in the checker."""
    most = at.swing / claim.brakes.masses[0]
    widest = max(min(most, claim.fastest - at.obstacle), 0.0)
    speeds = widest * np.arange(_RETREATS + 1) / _RETREATS
    pairs = zip(at.through + speeds[1:], at.obstacle + speeds[:-1], strict=True)
    over = np.array([_largest_drag(claim, float(v)) + _disturbance(claim, float(v), float(own)) for v, own in pairs])
    over -= claim.brakes.least
    cost = claim.ratio * np.interp(most - speeds[:-1], knots, slopes) * over
    return not np.any((over > 0) & (cost > speeds[:-1]))


def _lack(claim: BrakingClaim, at: Encounter, z: Vector, g: Vector) -> float:
    """Return an upper bound of z minus G'(z) times the braking force between two knots, by Bernstein coefficients.

    The slopes G' at the two knots are valid if this bound is ≤ 0.
    """
    h = float(z[1] - z[0])
    middle = np.polynomial.Polynomial.fit(z, g, 1, domain=[z[0], z[1]], window=[0.0, h])
    inner = z[0] + h * np.array([0.1, 0.5, 0.9])  # on a cell the force is a quadratic polynomial
    force = np.polynomial.Polynomial.fit(inner, _force(claim, at, inner), 2, domain=[z[0], z[1]], window=[0.0, h])
    c = np.zeros(4)
    product = np.polynomial.polynomial.polymul(middle.coef, force.coef)
    c[: len(product)] = product
    c[:2] -= (z[0], 1.0)
    ends = (c[0], c[0] + c[1] * h / 3, c[0] + 2 * c[1] * h / 3 + c[2] * h**2 / 3, np.polyval(c[::-1], h))
    return float(_SPARE - min(ends[1:] if z[0] == 0 else ends))


def _force(claim: BrakingClaim, at: Encounter, z: Vector) -> Vector:
    """Return the braking force [N] at closing speed z [m/s], with the drag that helps least to brake."""
    b, v, (linear, quadratic) = claim.brakes, z - at.through, _drag_ranges(claim)
    share = 1.0 if claim.drag == "along" else 1 / sqrt(2)
    ahead = linear[0] * v + share * quadratic[0] * v**2
    return b.least - at.disturbance + np.where(v >= 0, ahead, linear[1] * v - quadratic[1] * v**2)


def figures(claim: BrakingClaim, tables: list[DistanceTable]) -> dict[str, Any]:
    """Return the claim's table for each speed: closed-form distance, braking distance and range needed [m].

    The values are rounded up to 0.1 mm.
    """
    rows: dict[str, list[list[float]]] = {"closed_m": [], "distance_m": [], "needed_m": []}
    for speed in claim.speeds:
        entries = [_figures(claim, table, speed) for table in tables]
        for k, name in enumerate(rows):
            rows[name].append([ceil(entry[k] * _FIGURES - _NEGLECTED) / _FIGURES for entry in entries])
    return {"speeds_m_per_s": list(claim.speeds), **rows}


def _figures(claim: BrakingClaim, table: DistanceTable, speed: float) -> tuple[float, float, float]:
    b, at = claim.brakes, table.at
    closing, left = speed + at.obstacle, b.least - at.disturbance - _largest_drag(claim, at.through)
    closed = max(claim.ratio * m * (closing + at.swing / m) ** 2 / (2 * left) for m in b.masses)
    return closed, table.worst(claim, closing), figures_needed(claim, table, speed, since=speed)


def figures_needed(claim: BrakingClaim, table: DistanceTable, speed: float, *, since: float) -> float:
    """Return the range needed [m] at the measured own speed `speed`; `since` is the largest own speed since the echo.

    The vehicle brakes if the measured range is less than the range needed. `guidance.braking.range_needed` returns the
    range needed without the speed that the vehicle gains during a retreat. The speeds are in m/s.
    """
    b, at, w = claim.brakes, table.at, claim.watch
    closing = speed + w.speed_error + at.obstacle
    astern = max(at.through, b.current + min(w.speed_error - speed, claim.fastest))
    gain = (claim.thrust_ahead + _disturbance(claim, astern) + _largest_drag(claim, astern)) / b.masses[0]
    travelled = max(closing * w.period + gain * w.period**2 / 2, 0.0)
    late = max(since + w.speed_error + at.obstacle, 0.0) * w.age
    later = min(closing + gain * w.period, claim.fastest + at.obstacle)
    return w.range_error + late + travelled + table.worst(claim, later)


_SHARES = (LEAST_THRUST, 0.7, 0.55, 0.45, 0.3)  # of the thrust limit, as braking forces to try


@dataclass(frozen=True)
class BrakingProof(Certified):
    """The result of an attempt to prove a claim about braking.

    Attributes:
        claim: the claim.
        range_needed: detection range [m] that is enough at the robot's highest speed in the claim, for the fastest
            obstacle.
        seconds: total time of the attempt [s].
        check_seconds: duration of the check by the independent checker [s].
    """

    claim: BrakingClaim
    range_needed: float
    seconds: float
    check_seconds: float

    @property
    def sentence(self) -> str:
        """Return the verdict in one line."""
        if self.verdict != "proved":
            return f"unknown: {self.reason}"
        claim, quickest = self.claim, max(self.claim.obstacles)
        what = f"obstacles that approach at up to {quickest:g} m/s" if quickest else "obstacles at rest"
        return (
            f"proved: no contact with {what}, provided they are detected at {self.range_needed:.2f} m or more "
            f"(robot at {max(claim.speeds):g} m/s); checked in {self.check_seconds:.2f} s"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        return {
            **self.decided(),
            "range_needed_m": self.range_needed,
            "seconds": self.seconds,
            "check_seconds": self.check_seconds,
        }


def prove_braking(claim: BrakingClaim) -> BrakingProof:
    """Compute the tables of the claim and let the checker decide.

    For a law of a vehicle with unequal masses, smaller braking forces are tried too: the velocity loop commands them at
    a smaller excess over the speed bound, and the proof may count on any force up to the guaranteed one.
    """
    began = time.perf_counter()
    first = _attempt(claim, began)
    if first.verdict == "proved" or claim.law is None or claim.ratio == 1:
        return first
    forces = [share * claim.law.limit for share in _SHARES]
    attempts = (_attempt(claim.braking_with(force), began) for force in forces if force != claim.brakes.least)
    return next((attempt for attempt in attempts if attempt.verdict == "proved"), first)


def _attempt(claim: BrakingClaim, began: float) -> BrakingProof:
    limit = largest_obstacle(claim)
    if max(claim.obstacles) >= limit:
        pushed = _disturbance(claim, claim.brakes.current)
        reason = f"this claim assumes a braking force of {claim.brakes.least:.3g} N and up to {pushed:.3g} N against it"
        reason += " by disturbances, turning, unequal masses and thrust across"
        reason += f", so that drag leaves none from {limit:.4g} m/s on" if limit > 0 else ": none is left, even at rest"
        return BrakingProof(claim, "unknown", {}, reason, 0.0, time.perf_counter() - began, 0.0)
    tables = [distance_table(claim, obstacle) for obstacle in claim.obstacles]
    table = figures(claim, tables)
    distances = [{"knots": t.knots.tolist(), "slopes": t.slopes.tolist()} for t in tables]
    document = seal("braking", claim.document(table, limit), {"proof": {"distances": distances}})
    checked = check_document(document)
    good = checked.accepted
    return BrakingProof(
        claim,
        "proved" if good else "unknown",
        document if good else {},
        checked.reason,
        table["needed_m"][-1][-1] if good else 0.0,
        time.perf_counter() - began,
        checked.seconds,
    )
