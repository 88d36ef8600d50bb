"""A second implementation of law and vehicle in rational numbers, to compare with a region's linear inclusion.

At sampled positions, parameters and headings, the true derivative must equal A ξ + Σ B_j w_j exactly, and every w_j
must lie within its bound (`surctl.certcheck.region_inclusion` defines them). The headings are rational points of the
unit circle, and the positions have a rational slant √(y_e² + Δ²)/Δ.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

from surctl.certcheck.document import Rejected
from surctl.certcheck.region_claim import CruiseClaim, axis_pairs
from surctl.certcheck.region_exact import Matrix, inverse, middle, quadratic, root_down, root_up
from surctl.certcheck.region_inclusion import Shell, vertex
from surctl.certcheck.region_trim import Trim, drift_speed, offset_speed, quarter

__all__ = ["Vehicle", "check_identity", "commanded_thrust", "commanded_velocity", "true_rate"]

Pair = tuple[Fraction, Fraction]

_SAMPLES = 4


@dataclass(frozen=True)
class Vehicle:
    """A true vehicle: mass, drag of surge and sway, time constant of the thrust, yaw rate, and current; SI units."""

    mass: Fraction
    linear: Pair
    square: Pair
    lag: Fraction
    turn: Fraction
    current: Pair = (Fraction(0), Fraction(0))


def turned(heading: Pair, vector: Pair) -> Pair:
    """Return the vector rotated by ψ, where heading = (cos ψ, sin ψ)."""
    c, s = heading
    return c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]


def _back(heading: Pair, vector: Pair) -> Pair:
    return turned((heading[0], -heading[1]), vector)


def _drag(linear: Pair, square: Pair, v: Pair) -> Pair:
    first, second = (a * x + b * x * abs(x) for a, b, x in zip(linear, square, v, strict=True))
    return first, second


def commanded_velocity(claim: CruiseClaim, x_e: Fraction, y_e: Fraction, slant: Fraction) -> Pair:
    """Return the velocity command in the path frame: equations (8)–(12) of the paper with U ≥ 0 and the speed cap."""
    along = min(max(claim.cruise - claim.k1 * x_e, Fraction(0)), claim.cap / slant)
    return along, -along * y_e / claim.lookahead


def commanded_thrust(claim: CruiseClaim, desired: Pair, nu: Pair) -> Pair:
    """Return the thrust D(ν_d)ν_d + m k_v (ν_d − ν) in the body frame {B}, with the thrust limit on each axis."""
    hat = _drag((claim.linear_model,) * 2, (claim.quadratic_model,) * 2, desired)
    free = (d + claim.mass_model * claim.k_v * (w - v) for d, w, v in zip(hat, desired, nu, strict=True))
    first, second = (min(max(f, -claim.thrust), claim.thrust) for f in free)
    return first, second


def true_rate(
    claim: CruiseClaim, boat: Vehicle, heading: Pair, state: list[Fraction], slant: Fraction
) -> list[Fraction]:
    """Return d/dt of (x_e, y_e, U_x, U_y[, F_x, F_y]) by equations (2), (3) of the paper, without held commands.

    Args:
        claim: the claim, which holds the law's parameters.
        boat: the true vehicle, with m11 = m22.
        heading: (cos ψ, sin ψ), where ψ is the angle from the path to the heading.
        state: the state itself, not its deviation; U is the velocity over ground and F the thrust, both in the path
            frame.
        slant: √(y_e² + Δ²)/Δ.
    """
    x_e, y_e, speed = state[0], state[1], (state[2], state[3])
    nu = _back(heading, speed)
    desired = _back(heading, commanded_velocity(claim, x_e, y_e, slant))
    command = commanded_thrust(claim, desired, nu)
    thrust = _back(heading, (state[4], state[5])) if boat.lag else command
    m, r = boat.mass, boat.turn
    coriolis = (-m * nu[1] * r, m * nu[0] * r)
    drag = _drag(boat.linear, boat.square, _back(heading, _minus(speed, boat.current)))
    nu_rate = [(t - c - d) / m for t, c, d in zip(thrust, coriolis, drag, strict=True)]
    # U = R ν: U̇ = R (ν̇ + r S ν), S the quarter turn
    rate = [speed[0] - claim.cruise, speed[1]]
    rate += turned(heading, (nu_rate[0] - r * nu[1], nu_rate[1] + r * nu[0]))
    if boat.lag:
        own = [(c - t) / boat.lag for c, t in zip(command, thrust, strict=True)]
        rate += turned(heading, (own[0] - r * thrust[1], own[1] + r * thrust[0]))
    return rate


def check_identity(claim: CruiseClaim, at: Shell, steady: Trim, covariance: Matrix, level: Fraction, size: int) -> None:
    """Compare the law with the inclusion at sampled points of V ≤ level.

    Raises:
        Rejected: the law differs from the inclusion, or a force w_j exceeds its bound.
    """
    draw, p = random.Random(f"{size}/{level}"), inverse(covariance)
    for _ in range(_SAMPLES):
        boat = _boat(claim, draw)
        flow = _minus((claim.cruise, Fraction(0)), boat.current)
        means = middle(boat.linear), middle(boat.square)
        omega = (
            drift_speed(claim, *means, flow, _norm(flow))
            if claim.current
            else (offset_speed(claim, *means), Fraction(0))
        )
        xi, slant = _place(claim, p, level, draw, -omega[1] * claim.lookahead / (claim.cruise + omega[0]))
        c, s = draw.choice(quarter(12))
        heading = (draw.choice((c, -c)), draw.choice((s, -s)))
        _compare(claim, at, steady, boat, omega=omega, xi=xi, slant=slant, heading=heading)


def _between(draw: random.Random, low: Fraction, high: Fraction) -> Fraction:
    return low + (high - low) * Fraction(draw.randint(0, 16), 16)


def _boat(claim: CruiseClaim, draw: random.Random) -> Vehicle:
    def drag(pair: Pair) -> Pair:
        first, second = (draw.choice(axis_pairs(pair, claim.asymmetry)) for _ in range(2))
        share = Fraction(draw.randint(0, 8), 8)
        a, b = (x + share * (y - x) for x, y in zip(first, second, strict=True))
        return a, b

    turn = _between(draw, -claim.yaw_rate, claim.yaw_rate)
    c, s = draw.choice(quarter(12))
    size = claim.current * Fraction(draw.randint(0, 8), 8)
    current = draw.choice((c, -c)) * size, draw.choice((s, -s)) * size
    return Vehicle(_between(draw, *claim.mass), drag(claim.linear), drag(claim.quadratic),
                   _between(draw, *claim.lag), turn, current)  # fmt: skip


def _norm(vector: Pair) -> Fraction:
    # the error is at most 10^-9, which the margin of the bounds covers
    return root_up(_square(vector))


def _place(
    claim: CruiseClaim, p: Matrix, level: Fraction, draw: random.Random, aside: Fraction
) -> tuple[list[Fraction], Fraction]:
    """Return a sample of the deviation with V ≤ level, and its rational slant √(y_e² + Δ²)/Δ at y_e = aside + y."""
    raw = [Fraction(draw.randint(-1000, 1000), 1000) * 1000 / root_up(p[k][k] * 10**6) for k in range(len(p))]
    if draw.random() < 0.5:
        raw = [entry if k == 1 else entry / 50 for k, entry in enumerate(raw)]
    share = root_down(level / max(quadratic(p, raw), Fraction(1, 10**9))) * Fraction(draw.randint(300, 990), 1000)
    xi = [entry * share for entry in raw]
    z = (xi[1] + aside) / claim.lookahead
    # y/Δ = 2t/(1 − t²) makes √(1 + (y/Δ)²) = (1 + t²)/(1 − t²)
    t = Fraction(int((root_up(1 + z * z) - 1) / z * 10**7), 10**7) if z else Fraction(0)
    xi[1] = claim.lookahead * 2 * t / (1 - t * t) - aside
    if quadratic(p, xi) > level:
        xi = [entry / 2 if k != 1 else entry for k, entry in enumerate(xi)]
        if quadratic(p, xi) > level:
            return [Fraction(0)] * len(xi), Fraction(1)  # the cap is far away there, so the slant has no effect
    return xi, (1 + t * t) / (1 - t * t)


def _compare(
    claim: CruiseClaim,
    at: Shell,
    steady: Trim,
    boat: Vehicle,
    *,
    omega: Pair,
    xi: list[Fraction],
    slant: Fraction,
    heading: Pair,
) -> None:
    v, velocity_gain = claim.cruise, claim.mass_model * claim.k_v
    hat = (claim.linear_model,) * 2, (claim.quadratic_model,) * 2
    steady_speed, steady_desired = (v, Fraction(0)), (v + omega[0], omega[1])
    aside = -omega[1] * claim.lookahead / steady_desired[0]
    x_e, y_e, speed = xi[0] - omega[0] / claim.k1, xi[1] + aside, (v + xi[2], xi[3])

    def along_path(rule: Callable[[Pair], Pair], vector: Pair) -> Pair:
        return turned(heading, rule(_back(heading, vector)))

    def fed_forward(vector: Pair) -> Pair:
        return along_path(lambda n: _drag(*hat, n), vector)

    def dragged(vector: Pair) -> Pair:
        return along_path(lambda n: _drag(boat.linear, boat.square, n), _minus(vector, boat.current))

    trimmed = along_path(lambda n: _plus(_drag(*hat, n), _scaled(velocity_gain, _back(heading, omega))), steady_desired)
    state = [x_e, y_e, *speed, *(_plus(trimmed, (xi[4], xi[5])) if boat.lag else ())]
    rate = true_rate(claim, boat, heading, state, slant)
    desired = commanded_velocity(claim, x_e, y_e, slant)
    if abs(aside) > steady.aside:
        raise Rejected("the current displaces the vehicle beyond the bound at a sampled point")
    s = desired[0]
    catch = (v + omega[0] - s) / xi[0] if xi[0] else claim.k1
    if not (at.steer[0] <= s <= at.steer[1] and at.catch[0] <= catch <= at.catch[1]):
        raise Rejected("the commanded velocity exceeds its bounds at a sampled point")
    loop = vertex(claim, at, len(xi), per_mass=1 / boat.mass, per_lag=1 / boat.lag if boat.lag else Fraction(0),
                  turn=boat.turn if boat.lag else Fraction(0), steer=s, catch=catch, aside=aside)  # fmt: skip
    d_desired, d_speed = _minus(desired, steady_desired), (xi[2], xi[3])
    w1 = _minus(_minus(fed_forward(desired), fed_forward(steady_desired)), _scaled(middle(at.model_drag), d_desired))
    deviation = _plus((_dot(loop.force[0], xi), _dot(loop.force[1], xi)), w1)
    body = commanded_thrust(claim, _back(heading, desired), _back(heading, speed))
    command = turned(heading, body)
    w2 = _minus(_minus(command, trimmed), _scaled((1 + at.thrust_share) / 2, deviation))
    w3 = _minus(_minus(dragged(speed), dragged(steady_speed)), _scaled(middle(at.drag), d_speed))
    needed = dragged(steady_speed)
    held = [(w1, (at.model_drag[1] - at.model_drag[0]) / 2, d_desired), (w2, (1 - at.thrust_share) / 2, deviation),
            (w3, (at.drag[1] - at.drag[0]) / 2, d_speed)]  # fmt: skip
    w = {1: w1, 2: w2, 3: w3}
    one = (Fraction(1), Fraction(0))
    lacking = _minus(trimmed, needed)
    held.append((lacking, steady.total, one))
    if boat.lag:
        # the trim force in {B} changes with the heading, and the delivered thrust lags behind it
        moving = _trim_slope(claim, omega[0], heading)
        held.append((moving, steady.turning, one))
        w |= {5: _scaled(-boat.lag * boat.turn, turned(heading, moving)), 6: lacking}
        trim_rate = _scaled(boat.turn, _plus((-trimmed[1], trimmed[0]), turned(heading, moving)))
        rate = [*rate[:4], *_minus((rate[4], rate[5]), trim_rate)]
    else:
        w[5] = lacking
    if any(_square(vector) > gain * gain * _square(of) for vector, gain, of in held):
        raise Rejected("a force exceeds its bound at a sampled point")
    predicted = [_dot(row, xi) for row in loop.A]
    for j, rows in loop.B.items():
        predicted = [
            value + row[0] * w[j][0] + row[1] * w[j][1] if j in w else value
            for value, row in zip(predicted, rows, strict=True)
        ]
    if predicted != rate:
        raise Rejected("the linear inclusion does not reproduce the nonlinear loop at a sampled point")


def _trim_slope(claim: CruiseClaim, omega: Fraction, heading: Pair) -> Pair:
    """Return the derivative of the trim force in the body frame {B} with respect to the heading [N/rad]."""
    c, s = heading
    speed = claim.cruise + omega
    a = claim.mass_model * claim.k_v * omega + claim.linear_model * speed
    b = 2 * claim.quadratic_model * speed**2
    return -s * (a + b * abs(c)), -c * (a + b * abs(s))


def _minus(a: Pair, b: Pair) -> Pair:
    return a[0] - b[0], a[1] - b[1]


def _plus(a: Pair, b: Pair) -> Pair:
    return a[0] + b[0], a[1] + b[1]


def _scaled(factor: Fraction, a: Pair) -> Pair:
    return factor * a[0], factor * a[1]


def _dot(a: list[Fraction], b: list[Fraction]) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def _square(a: Pair) -> Fraction:
    return a[0] * a[0] + a[1] * a[1]
