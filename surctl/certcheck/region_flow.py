"""Bounds on the steady cruise in a constant current, over all currents, headings and true vehicles of a claim.

At the steady cruise, the difference of commanded and required force is a function of the current (c_x, c_y) and the
heading ψ. This function has bounded second derivatives and is nearly affine in the true drag. It is interpolated on a
grid. In a cell of the grid, the norm of the multilinear interpolation is at most the largest norm at the corners. The
function differs from the interpolation by at most Σ M_i h_i²/8, where M_i bounds its second derivative in variable i,
and h_i is the cell's width in this variable. The computation is in double precision, with a margin far above its
rounding errors.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import product

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.region_claim import CruiseClaim
from surctl.certcheck.region_trim import MEAN_SHARE, Trim, axis_pairs, trim

__all__ = ["steady_trim"]

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
    low, high, drift, total, wide = np.inf, -np.inf, 0.0, 0.0, 0.0
    ranges = [[(float(a), float(b)) for a, b in axis_pairs(*pair, claim.asymmetry)]
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
    desired_speed = float(v + max(abs(low), abs(high)) + drift)
    # second derivatives by the current (of ω and of the forces) and by ψ (of rotated quadratic and linear forces)
    bend = 4 * _SHARE * square / stiff[1]
    slope = (drag + 2 * _SHARE * square * fast) / stiff[1]
    turn = velocity_gain + hat + 2 * hat2 * desired_speed
    by_current = turn * bend + 2 * hat2 * slope**2 + 2 * square
    force = velocity_gain * max(abs(low), abs(high), drift) * 2 + hat * desired_speed + drag * fast
    by_heading = np.sqrt(2) * (4 * force + 9 * (hat2 * desired_speed**2 + square * fast**2))
    # ω also differs from its interpolation in (c_x, c_y)
    curved = 2 * bend * step**2 / 8
    total += 2 * by_current * step**2 / 8 + by_heading * (np.pi / _HEADINGS) ** 2 / 8
    total += hat2 * wide**2  # the part that is not affine in the true drag
    up, down = (Fraction(int(value * 10**9) + k, 10**9) for value, k in ((high + curved, 2), (low - curved, -2)))
    return down, up, _up(drift + curved), _up(total)


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
