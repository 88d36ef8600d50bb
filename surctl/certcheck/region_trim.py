"""The steady cruise of a region claim: where it settles for constant parameters, and what the heading still stirs.

Path frame, U* = (v, 0), command W* = (v + ω, 0). With ψ the angle between {B} and the path, c = |cos ψ| and
s = |sin ψ|, the axes of {B} carry (drag of surge at v c, of sway at v s): per axis linear in c plus quadratic in c.
ω is affine in the true drag, so that what is left over is affine too, up to a term in ω²: its norm is convex, and
the vertices of the parameters and arcs of the heading decide.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise, product

from surctl.certcheck.region_claim import CruiseClaim
from surctl.certcheck.region_exact import middle, root_up

__all__ = ["MEAN_SHARE", "Trim", "axis_pairs", "drift_speed", "offset_speed", "quarter", "trim"]

MEAN_SHARE = Fraction(17, 20)
"""Share of quadratic drag that is counted on along the path, between 1 at ψ = 0 and 0.71 at ψ = 45°."""

_ARCS = 96


@dataclass(frozen=True)
class Trim:
    """Bounds over all true parameters and headings.

    Attributes:
        omega: least and largest ω [m/s].
        command: least and largest v + ω [m/s].
        linear, quadratic: of the command's trim force, linear c + quadratic c² per axis, at the largest ω [N].
        backward: the same at the least ω if it points backwards, else 0 [N].
        total: largest |commanded − needed| force [N].
        drift: largest |ω_y| [m/s], what the command steers against a current.
        aside: largest |y*| [m] that this takes.
        across: what it adds to the trim force of an axis across the path [N].
        tilt: |ω_y| over the commanded speed along.
    """

    omega: tuple[Fraction, Fraction]
    command: tuple[Fraction, Fraction]
    linear: Fraction
    quadratic: Fraction
    backward: Fraction
    total: Fraction
    drift: Fraction = Fraction(0)
    aside: Fraction = Fraction(0)
    across: Fraction = Fraction(0)
    tilt: Fraction = Fraction(0)

    def along(self, c: Fraction, s: Fraction) -> Fraction:
        """Largest |trim force| on an axis at direction cosine ≤ c from the path and ≤ s from across it [N]."""
        return max(self.linear * c + self.quadratic * (c + self.tilt * s) ** 2, self.backward) + self.across * s

    @property
    def turning(self) -> Fraction:
        """Largest derivative of the trim force in {B} with the heading [N/rad]: 2 √2 c s ≤ 3/2."""
        return max(abs(self.linear), self.backward) + self.quadratic * Fraction(3, 2)


def quarter(arcs: int) -> list[tuple[Fraction, Fraction]]:
    """Rational points (cos, sin) from (1, 0) to (0, 1) on the unit circle."""
    ts = [Fraction(j, arcs) for j in range(arcs + 1)]
    return [((1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)) for t in ts]


def axis_pairs(least: Fraction, largest: Fraction, asymmetry: Fraction) -> list[tuple[Fraction, Fraction]]:
    """Vertices of {(a, b): least ≤ a, b ≤ largest, |a − b| ≤ asymmetry (a + b)/2}."""
    vertices = {(least, least), (largest, largest)}
    if asymmetry >= 2:
        other = [(least, largest)]
    else:
        ratio = (2 + asymmetry) / (2 - asymmetry)
        other = [(least, min(least * ratio, largest)), (max(largest / ratio, least), largest)]
    vertices |= {pair for a, b in other for pair in ((a, b), (b, a))}
    return sorted(vertices)


def offset_speed(claim: CruiseClaim, linear: Fraction, quadratic: Fraction) -> Fraction:
    """ω [m/s] for mean true drag coefficients of surge and sway."""
    v = claim.cruise
    stiffness = claim.mass_model * claim.k_v + claim.linear_model + 2 * MEAN_SHARE * claim.quadratic_model * v
    missing = (linear - claim.linear_model) * v + MEAN_SHARE * (quadratic - claim.quadratic_model) * v * v
    return missing / stiffness


def drift_speed(
    claim: CruiseClaim, linear: Fraction, quadratic: Fraction, flow: tuple[Fraction, Fraction], speed: Fraction
) -> tuple[Fraction, Fraction]:
    """(ω_x, ω_y) [m/s] where the water passes with `flow` = (v − c_x, −c_y), of this (rational) speed."""
    v, velocity_gain = claim.cruise, claim.mass_model * claim.k_v
    pull = linear + MEAN_SHARE * quadratic * speed
    fed = claim.linear_model + MEAN_SHARE * claim.quadratic_model * v
    stiff = velocity_gain + claim.linear_model
    return (
        (pull * flow[0] - fed * v) / (stiff + 2 * MEAN_SHARE * claim.quadratic_model * v),
        pull * flow[1] / (stiff + MEAN_SHARE * claim.quadratic_model * v),
    )


def _parabola(slope: Fraction, bend: Fraction, low: Fraction, high: Fraction) -> Fraction:
    """Largest |slope x + bend x²| on [low, high]."""
    candidates = [low, high]
    if bend and low < (top := -slope / (2 * bend)) < high:
        candidates.append(top)
    return max(abs(slope * x + bend * x * x) for x in candidates)


def _largest(axes: Iterator[tuple[tuple[Fraction, Fraction], tuple[Fraction, Fraction]]]) -> Fraction:
    """Largest norm of two axes, each slope x + bend x², with x = cos and x = sin of one angle."""
    most, points = Fraction(0), quarter(_ARCS)
    for (a1, b1), (a2, b2) in axes:
        for (c_high, s_low), (c_low, s_high) in pairwise(points):
            most = max(most, _parabola(a1, b1, c_low, c_high) ** 2 + _parabola(a2, b2, s_low, s_high) ** 2)
    return root_up(most)


def trim(claim: CruiseClaim) -> Trim:
    """Bounds of the steady cruise over everything that the claim leaves open, in still water."""
    v, velocity_gain = claim.cruise, claim.mass_model * claim.k_v
    linear_hat, quadratic_hat = claim.linear_model, claim.quadratic_model
    vertices = list(
        product(
            [(a, b) for a, b in axis_pairs(*claim.linear, claim.asymmetry) if a <= b],  # surge and sway may be swapped
            axis_pairs(*claim.quadratic, claim.asymmetry),
        )
    )
    omegas = [offset_speed(claim, middle(pair), middle(square)) for pair, square in vertices]
    low, high = min(omegas), max(omegas)
    command = (v + low, v + high)
    bend = quadratic_hat * max(low * low, high * high)  # the term in ω², left out of what is affine

    def unbalanced() -> Iterator[tuple[tuple[Fraction, Fraction], tuple[Fraction, Fraction]]]:
        for (pair, square), omega in zip(vertices, omegas, strict=True):
            slope = velocity_gain * omega + linear_hat * (v + omega)
            square_hat = quadratic_hat * (v * v + 2 * v * omega)
            first, second = ((slope - x * v, square_hat - xx * v * v) for x, xx in zip(pair, square, strict=True))
            yield first, second

    backward = -(velocity_gain * low + linear_hat * command[0])
    return Trim(
        omega=(low, high),
        command=command,
        linear=velocity_gain * high + linear_hat * command[1],
        quadratic=quadratic_hat * command[1] ** 2,
        backward=max(backward, Fraction(0)),
        total=_largest(unbalanced()) + bend,
    )
