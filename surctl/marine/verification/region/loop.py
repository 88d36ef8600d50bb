"""The cruise as a linear differential inclusion in floating point, for the search; the checker computes its own.

The state ξ = (x, y, U_x, U_y[, F_x, F_y]) holds the deviations of position, velocity and, with thrust lag, thrust from
the steady cruise, in the path frame. Each shell ℓ_low ≤ V ≤ ℓ_high of the Lyapunov function V = ξᵀPξ has its own
bounds: thrust saturation matters only in the outer shells, and forces that change with the heading matter only in the
inner shells.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.region_claim import axis_pairs, read_claim
from surctl.certcheck.region_trim import steady_trim
from surctl.marine.verification.region.claim import RegionClaim

Array = NDArray[np.float64]

_SHARE = 0.85  # share of quadratic drag along the path, averaged over the heading
_SLACK = 1.005  # factor on bounds that are sampled here and proved by the checker
_HEADINGS = np.linspace(0, np.pi / 2, 181)
_DIRECTIONS = np.linspace(0, np.pi, 33)[:-1]


@dataclass(frozen=True)
class Steady:
    """Bounds of the steady cruise: range of ω [m/s], largest error and coefficients of the trim force.

    ω is the difference of commanded speed and cruise speed, `total` the largest error of the trim force [N]. On an axis
    with direction cosine c, the trim force is at most `linear` c + `quadratic` c² [N]. In a current, `drift` is the
    largest |ω_y|, `aside` the largest cross-track error |y*| of the steady cruise, and `across` the force that these
    two add.
    """

    omega: tuple[float, float]
    total: float
    linear: float
    quadratic: float
    backward: float
    drift: float = 0.0
    aside: float = 0.0
    across: float = 0.0
    tilt: float = 0.0

    def along(self, c: Array, s: Array) -> Array:
        """Return the largest trim force [N] on an axis with direction cosine c to the path and s to the normal."""
        return np.maximum(self.linear * c + self.quadratic * (c + self.tilt * s) ** 2, self.backward) + self.across * s


def offset_slopes(claim: RegionClaim) -> tuple[float, float]:
    """Return the slopes of ω [m/s] of `steady_cruise` in the mean factors of the linear and of the quadratic drag."""
    mass, linear, quadratic = claim.model
    v, mean = claim.cruise, _SHARE * quadratic
    stiffness = mass * claim.gains["k_v"] + linear + 2 * mean * v
    return linear * v / stiffness, mean * v * v / stiffness


def steady_cruise(claim: RegionClaim) -> Steady:
    """Return bounds of the steady cruise over all true parameters and headings; a current uses the checker's bounds."""
    if claim.current:
        trim = steady_trim(read_claim(claim.document(offset=1.0, ultimate_bound=(1.0, 1.0))))
        return Steady(
            (float(trim.omega[0]), float(trim.omega[1])),
            *(float(n) for n in (trim.total, trim.linear, trim.quadratic, trim.backward)),
            *(float(n) for n in (trim.drift, trim.aside, trim.across, trim.tilt)),
        )
    mass, linear, quadratic = claim.model
    v, velocity_gain = claim.cruise, mass * claim.gains["k_v"]
    stiffness = velocity_gain + linear + 2 * _SHARE * quadratic * v
    c, s = np.cos(_HEADINGS), np.sin(_HEADINGS)
    omegas, total = [], 0.0
    for (x1, x2), (q1, q2) in product(*(axis_pairs(ends, claim.asymmetry) for ends in (claim.linear, claim.quadratic))):
        omega = (((x1 + x2) / 2 - linear) * v + _SHARE * ((q1 + q2) / 2 - quadratic) * v * v) / stiffness
        w = v + omega
        command = [velocity_gain * omega * n + linear * w * n + quadratic * w * w * n * n for n in (c, s)]
        drag = [x * v * n + q * v * v * n * n for x, q, n in ((x1, q1, c), (x2, q2, s))]
        total = max(total, np.max(np.hypot(command[0] - drag[0], command[1] - drag[1])))
        omegas.append(omega)
    low, high = min(omegas), max(omegas)
    bend = quadratic * max(low * low, high * high)
    return Steady(
        (low, high),
        1.012 * total + bend,
        velocity_gain * high + linear * (v + high),
        quadratic * (v + high) ** 2,
        max(0.0, -(velocity_gain * low + linear * (v + low))),
    )


@dataclass(frozen=True)
class Gains:
    """Largest norms of deviations in the region V ≤ 1, and the least thrust share φ in this region.

    The deviations are those of position (x, y), velocity, commanded velocity, commanded force and delivered force.
    """

    x: float
    y: float
    velocity: float
    desired: float
    command: float
    thrust: float
    share: float


@dataclass(frozen=True)
class Bounds:
    """Bounds in one shell, by their names in the linear inclusion (see `certcheck.region_inclusion.Shell`)."""

    steer: tuple[float, float]
    catch: tuple[float, float]
    model_drag: tuple[float, float]
    drag: tuple[float, float]
    share: float
    held: float
    disturbance: float
    desired_rate: float
    aside: float = 0.0


def bounds(claim: RegionClaim, steady: Steady, gains: Gains, low: float, high: float) -> Bounds | None:
    """Return the bounds in the shell low ≤ V ≤ high; None if the law has another form in a part of the shell."""
    mass, linear, quadratic = claim.model
    k1, ahead, v, cap = claim.gains["k1"], claim.gains["lookahead"], claim.cruise, claim.cap
    radius, floor = _SLACK * np.sqrt(high), np.sqrt(low)
    x, y = gains.x * radius, gains.y * radius
    fast, slow = v + steady.omega[1], v + steady.omega[0]
    wide = y + steady.aside
    most = cap * ahead / np.hypot(ahead, wide) * 0.9999
    away = max(map(abs, steady.omega)) / k1
    if most <= fast or k1 * x >= slow or x + away + claim.place_error >= claim.gains["wait"] / 2:
        return None
    steer = (slow - k1 * x, min(fast + k1 * x, cap))
    catch = (min(k1, (most - fast) / x), k1)
    desired_speed = fast + steady.drift
    model_drag = (linear, linear + quadratic * (desired_speed + min(cap, desired_speed + gains.desired * radius)))
    drag = (claim.linear[0], claim.linear[1] + claim.quadratic[1] * (2 * (v + claim.current) + gains.velocity * radius))
    velocity_gain = mass * claim.gains["k_v"]
    turning = max(abs(steady.linear), steady.backward) + 1.5 * steady.quadratic
    still = claim.yaw_rate * (claim.period + claim.lag[1]) * turning
    outside = steady.total + claim.force
    disturbance = outside if claim.lag[1] else 0.0
    still += outside - disturbance
    slant = max(np.sqrt(k1 * k1 * (1 + (wide / ahead) ** 2) + (steer[1] / ahead) ** 2), cap / ahead)
    steepest = linear + 2 * quadratic * cap
    far = (_SLACK * gains.y + steady.aside + claim.place_error) / ahead  # on V ≤ 1: the held command is earlier
    still += (velocity_gain + steepest) * np.sqrt(k1**2 * (1 + far**2) + (cap / ahead) ** 2) * claim.place_error
    still += velocity_gain * claim.velocity_error
    return Bounds(
        steer,
        catch,
        model_drag,
        drag,
        min(1.0, gains.share / radius),
        max(_SLACK * still, 1e-3) / floor,
        max(_SLACK * disturbance, 1e-3) / floor,
        (velocity_gain + steepest) * slant,
        steady.aside,
    )


def force_gain(claim: RegionClaim, slope: float, steer: float, catch: float, aside: float = 0.0) -> tuple[Array, Array]:
    """Return two matrices (2, n) that map ξ to the deviations of the commanded velocity and of the commanded force."""
    desired, velocity_gain = np.zeros((2, claim.size)), claim.model[0] * claim.gains["k_v"]
    desired[0, 0], desired[1, 1] = -catch, -steer / claim.gains["lookahead"]
    desired[1, 0] = catch * aside / claim.gains["lookahead"]
    return desired, (velocity_gain + slope) * desired - velocity_gain * np.eye(claim.size)[2:4]


def gains_of(claim: RegionClaim, steady: Steady, P: Array, at: Bounds) -> Gains:
    """Return the largest norms in the region V ≤ 1 of P; `at` holds the bounds of its outermost shell."""
    covariance, eye = np.linalg.inv(P), np.eye(claim.size)

    def largest(rows: Array) -> float:
        return float(np.sqrt(np.linalg.eigvalsh(rows @ covariance @ rows.T)[-1]))

    corners = list(product(at.steer, at.catch))
    middle = sum(at.model_drag) / 2
    share = np.inf
    for slope in at.model_drag:
        for s, k in corners:
            rows = force_gain(claim, slope, s, k, at.aside)[1]
            n = np.stack([np.cos(_DIRECTIONS), np.sin(_DIRECTIONS)])
            deviation = np.sqrt(np.einsum("in,ij,jn->n", n, rows @ covariance @ rows.T, n))
            share = min(share, float(np.min((claim.thrust - steady.along(*np.abs(n))) / deviation)) * 0.99)
    return Gains(
        np.sqrt(covariance[0, 0]),
        np.sqrt(covariance[1, 1]),
        largest(eye[2:4]),
        max(largest(force_gain(claim, middle, s, k, at.aside)[0]) for s, k in corners),
        max(largest(force_gain(claim, middle, s, k, at.aside)[1]) for s, k in corners),
        largest(eye[4:6]) if claim.size == 6 else 0.0,
        share,
    )


@dataclass(frozen=True)
class Loop:
    """The loop at one vertex of the parameters: state matrix A, input matrices B, and output matrices.

    A (n, n) is the state matrix. B (n, q k) holds the matrices of the k uncertain inputs side by side, in the order of
    `wind`. The matrices `desired`, `force` and `speed` (q, n) map ξ to the deviations of commanded velocity, commanded
    force and velocity; `braking` gives the acceleration U̇. If P has no entry between x and y, the two axes decouple
    and each loop holds one axis (q = 1), except if the thrust lags and the vehicle turns, or if a current displaces the
    vehicle (q = 2).
    """

    A: Array
    B: Array
    desired: Array
    force: Array
    speed: Array
    states: NDArray[np.intp]
    braking: Array
    wind: tuple[int, ...]


def loops(claim: RegionClaim, at: Bounds) -> Iterator[Loop]:
    """Yield the loop at every vertex of the linear inclusion of a shell."""
    size, lag, eye = claim.size, claim.lag[1] > 0, np.eye(claim.size)
    share, quarter = (1 + at.share) / 2, np.array([[0.0, -1.0], [1.0, 0.0]])
    visited: set[tuple[float, ...]] = set()
    wind = tuple(
        j for j in (1, 2, 3, 4, 5, 6) if (j != 2 or at.share < 1) and (j != 4 or claim.period) and (j != 6 or lag)
    )
    for m, s, k, r, t in product(
        sorted(set(claim.mass)), at.steer, sorted(set(at.catch)),
        (claim.yaw_rate if lag else 0.0,), sorted(set(claim.lag)),
    ):  # fmt: skip  # the loop for the opposite turn is the mirror image
        desired, force = force_gain(claim, sum(at.model_drag) / 2, s, k, at.aside)
        A = np.zeros((size, size))
        A[:2, 2:4] = np.eye(2)
        A[2:4] -= sum(at.drag) / 2 / m * eye[2:4]
        if lag:
            A[2:4] += eye[4:6] / m
            A[4:6] += (share * force - eye[4:6]) / t + r * quarter @ eye[4:6]
            inner, gain = eye[:, 4:6], 1 / t
        else:
            A[2:4] += share * force / m
            inner, gain = eye[:, 2:4], 1 / m
        entry = {
            1: gain * share * inner,
            2: gain * inner,
            3: -eye[:, 2:4] / m,
            4: gain * inner,
            5: gain * inner,
            6: eye[:, 2:4] / m,
        }
        B, every = np.hstack([entry[j] for j in wind]), np.arange(size)
        if (lag and claim.yaw_rate) or at.aside:
            yield Loop(A, B, desired, force, eye[2:4], every, np.hstack([A, B])[2:4], wind)
            continue
        for axis, name in ((0, k), (1, s)):
            if (axis, name, m, t) in visited:
                continue
            visited.add((axis, name, m, t))
            own = every[axis::2]
            row = np.ix_(every[axis : axis + 1], own)
            part = np.hstack([A[:, own], B[:, axis::2]])[2 + axis : 3 + axis]
            yield Loop(
                A[np.ix_(own, own)], B[own][:, axis::2], desired[row], force[row], eye[2:4][row], own, part, wind
            )
