"""Bounds on the steady cruise of a region claim: on the commanded speed, and on the error of the commanded force.

In the path frame, the steady velocity is U* = (v, 0), and the commanded velocity of the steady cruise is W* = (v + ω,
0). ψ is the angle between the body frame {B} and the path, c = |cos ψ| and s = |sin ψ|. The drag of surge is that at
speed v c, the drag of sway that at speed v s, each with a linear and a quadratic term. ω is affine in the true drag. So
the remaining force error is also affine in the true drag, up to a term in ω². The norm of an affine function is convex.
So, on each arc of headings, the largest error is at a vertex of the parameter ranges.

In a current, the difference of commanded and required force is a function of the current (c_x, c_y) and the
heading ψ. This function has bounded second derivatives and is nearly affine in the true drag. It is interpolated on a
grid. In a cell of the grid, the norm of the multilinear interpolation is at most the largest norm at the corners. The
function differs from the interpolation by at most Σ M_i h_i²/8, where M_i bounds its second derivative in variable i,
and h_i is the cell's width in this variable. The computation is in double precision, with a margin far above its
rounding errors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.region_claim import CruiseClaim, axis_pairs
from surctl.certcheck.region_exact import middle, root_up

__all__ = ["MEAN_SHARE", "Trim", "drift_speed", "offset_speed", "quarter", "steady_trim", "trim"]

MEAN_SHARE = Fraction(17, 20)
"""Mean share, over the heading ψ, of the quadratic drag that acts along the path: 1 at ψ = 0, and 0.71 at ψ = 45°."""

_ARCS = 96


@dataclass(frozen=True)
class Trim:
    """Bounds on the steady cruise over all true parameters and headings.

    Attributes:
        omega: least and largest ω [m/s], the difference of commanded speed and cruise speed.
        command: least and largest commanded speed v + ω [m/s].
        linear, quadratic: coefficients [N] of the commanded trim force at the largest ω, which on a body axis is
            `linear` c + `quadratic` c², with c the cosine of the axis to the path.
        backward: largest backward trim force [N] at the least ω; 0 if the trim force points forward.
        total: largest |commanded − required force| [N].
        drift: largest |ω_y| [m/s]; ω_y is the commanded speed across the path, against a current.
        aside: largest |y*| [m]; y* is the steady offset from the path at which the law commands ω_y.
        across: trim force [N] that the commanded speed ω_y adds on a body axis perpendicular to the path.
        tilt: ratio of |ω_y| to the commanded speed along the path.
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
        """Return the largest |trim force| [N] on an axis with direction cosines ≤ c along and ≤ s across the path."""
        return max(self.linear * c + self.quadratic * (c + self.tilt * s) ** 2, self.backward) + self.across * s

    @property
    def turning(self) -> Fraction:
        """Return a bound on the derivative of the trim force in {B} with respect to the heading [N/rad]."""
        return max(abs(self.linear), self.backward) + self.quadratic * Fraction(3, 2)


def quarter(arcs: int) -> list[tuple[Fraction, Fraction]]:
    """Return rational points (cos, sin) on the unit circle from (1, 0) to (0, 1)."""
    ts = [Fraction(j, arcs) for j in range(arcs + 1)]
    return [((1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)) for t in ts]


def offset_speed(claim: CruiseClaim, linear: Fraction, quadratic: Fraction) -> Fraction:
    """Return ω [m/s] for true drag coefficients that are means over surge and sway."""
    v = claim.cruise
    stiffness = claim.mass_model * claim.k_v + claim.linear_model + 2 * MEAN_SHARE * claim.quadratic_model * v
    missing = (linear - claim.linear_model) * v + MEAN_SHARE * (quadratic - claim.quadratic_model) * v * v
    return missing / stiffness


def drift_speed(
    claim: CruiseClaim, linear: Fraction, quadratic: Fraction, flow: tuple[Fraction, Fraction], speed: Fraction
) -> tuple[Fraction, Fraction]:
    """Return (ω_x, ω_y) [m/s] for the velocity through the water `flow` = (v − c_x, −c_y) with norm `speed`."""
    v, velocity_gain = claim.cruise, claim.mass_model * claim.k_v
    pull = linear + MEAN_SHARE * quadratic * speed
    fed = claim.linear_model + MEAN_SHARE * claim.quadratic_model * v
    stiff = velocity_gain + claim.linear_model
    return (
        (pull * flow[0] - fed * v) / (stiff + 2 * MEAN_SHARE * claim.quadratic_model * v),
        pull * flow[1] / (stiff + MEAN_SHARE * claim.quadratic_model * v),
    )


def _parabola(slope: Fraction, bend: Fraction, low: Fraction, high: Fraction) -> Fraction:
    candidates = [low, high]
    if bend and low < (top := -slope / (2 * bend)) < high:
        candidates.append(top)
    return max(abs(slope * x + bend * x * x) for x in candidates)


def _largest(axes: Iterator[tuple[tuple[Fraction, Fraction], tuple[Fraction, Fraction]]]) -> Fraction:
    """Return the largest norm over α of a force with one term slope x + bend x² for x = cos α and one for x = sin α."""
    most, points = Fraction(0), quarter(_ARCS)
    for (a1, b1), (a2, b2) in axes:
        for (c_high, s_low), (c_low, s_high) in pairwise(points):
            most = max(most, _parabola(a1, b1, c_low, c_high) ** 2 + _parabola(a2, b2, s_low, s_high) ** 2)
    return root_up(most)


def trim(claim: CruiseClaim) -> Trim:
    """Return the bounds of the steady cruise in still water over all parameters and headings of the claim."""
    v, velocity_gain = claim.cruise, claim.mass_model * claim.k_v
    linear_hat, quadratic_hat = claim.linear_model, claim.quadratic_model
    vertices = list(
        product(
            [(a, b) for a, b in axis_pairs(claim.linear, claim.asymmetry) if a <= b],  # surge and sway may be swapped
            axis_pairs(claim.quadratic, claim.asymmetry),
        )
    )
    omegas = [offset_speed(claim, middle(pair), middle(square)) for pair, square in vertices]
    low, high = min(omegas), max(omegas)
    command = (v + low, v + high)
    bend = quadratic_hat * max(low * low, high * high)  # the term in ω², which is not affine

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


Array = NDArray[np.float64]

_SIDE, _HEADINGS = 24, 180
_MARGIN = 1 + 1e-9
_SHARE = float(MEAN_SHARE)


def _flow_bounds(claim: CruiseClaim) -> tuple[Fraction, Fraction, Fraction, Fraction]:
    """Return the least and largest ω_x, the largest |ω_y| [m/s], and the largest |commanded − required force| [N]."""
    v, velocity_gain = float(claim.cruise), float(claim.mass_model * claim.k_v)
    hat, hat2, most = float(claim.linear_model), float(claim.quadratic_model), float(claim.current)
    x, y = np.meshgrid(np.linspace(-most, most, 2 * _SIDE + 1), np.linspace(0, most, _SIDE + 1))  # ±c_y: mirrored
    step = most / _SIDE * _MARGIN
    near = np.hypot(x, y) <= most + 1.5 * step  # every cell that meets the disc, with all its corners
    flow = np.stack([v - x[near], -y[near]])
    speed = np.hypot(*flow)
    psi = np.linspace(0, np.pi, _HEADINGS + 1)  # {B} turned by π is the same vehicle
    c, s = np.cos(psi), np.sin(psi)
    stiff = np.array([velocity_gain + hat + 2 * _SHARE * hat2 * v, velocity_gain + hat + _SHARE * hat2 * v])
    low, high, drift, total = np.inf, -np.inf, 0.0, 0.0
    ranges = [[(float(a), float(b)) for a, b in axis_pairs(pair, claim.asymmetry)]
              for pair in (claim.linear, claim.quadratic)]  # fmt: skip
    ends = []
    for (x1, x2), (q1, q2) in product(*ranges):
        needed = ((x1 + x2) / 2 + _SHARE * (q1 + q2) / 2 * speed) * flow
        omega = (needed - np.array([[(hat + _SHARE * hat2 * v) * v], [0.0]])) / stiff[:, None]
        ends.append(omega)
        low, high, drift = min(low, omega[0].min()), max(high, omega[0].max()), max(drift, np.abs(omega[1]).max())
        desired = omega + np.array([[v], [0.0]])
        lack = []
        for (a, b), xx, qq in (((c, s), x1, q1), ((-s, c), x2, q2)):
            w, n, o = (np.outer(z[0], a) + np.outer(z[1], b) for z in (desired, flow, omega))
            lack.append(velocity_gain * o + hat * w + hat2 * w * np.abs(w) - xx * n - qq * n * np.abs(n))
        total = max(total, float(np.hypot(*lack).max()))
    wide = max(float(np.hypot(*(a - b)).max()) for a in ends for b in ends)
    drag, square = float(claim.linear[1]), float(claim.quadratic[1])
    fast = v + most + 2 * step
    # second derivatives by the current (of ω and of the forces) and by ψ (of rotated quadratic and linear forces)
    bend = 4 * _SHARE * square / stiff[1]
    curved = 2 * bend * step**2 / 8  # ω differs from its interpolation in (c_x, c_y)
    low, high, drift = low - curved, high + curved, drift + curved
    desired_speed = float(v + high + drift)  # `steady_trim` rejects a command that points backwards
    slope = (drag + 2 * _SHARE * square * fast) / stiff[1]
    turn = velocity_gain + hat + 2 * hat2 * desired_speed
    by_current = turn * bend + 2 * hat2 * slope**2 + 2 * square
    force = velocity_gain * (abs(low) + abs(high) + drift) + hat * desired_speed + drag * fast
    by_heading = np.sqrt(2) * (4 * force + 9 * (hat2 * desired_speed**2 + square * fast**2))
    total += 2 * by_current * step**2 / 8 + by_heading * (np.pi / _HEADINGS) ** 2 / 8
    total += hat2 * wide**2  # the part that is not affine in the true drag
    up, down = (Fraction(int(value * 10**9) + k, 10**9) for value, k in ((high, 2), (low, -2)))
    return down, up, _up(drift), _up(total)


def _up(value: float) -> Fraction:
    return Fraction(int(value * _MARGIN * 10**9) + 2, 10**9)


def steady_trim(claim: CruiseClaim) -> Trim:
    """Return the bounds of the steady cruise over all parameters, headings and currents of the claim.

    Raises:
        Rejected: the commanded velocity of the steady cruise would point backwards.
    """
    if not claim.current:
        return trim(claim)
    low, high, drift, total = _flow_bounds(claim)
    v, velocity_gain = claim.cruise, claim.mass_model * claim.k_v
    hat, hat2 = claim.linear_model, claim.quadratic_model
    if v + low <= 0:
        raise Rejected("in the strongest current the steady command may point backwards")
    return Trim(
        omega=(low, high),
        command=(v + low, v + high),
        linear=velocity_gain * high + hat * (v + high),
        quadratic=hat2 * (v + high) ** 2,
        backward=max(-(velocity_gain * low + hat * (v + low)), Fraction(0)),
        total=total,
        drift=drift,
        aside=drift * claim.lookahead / (v + low),
        across=(velocity_gain + hat) * drift,
        tilt=drift / (v + high),
    )
