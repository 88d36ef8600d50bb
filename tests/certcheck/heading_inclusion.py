"""A second implementation of the heading-steered loop, compared with the linear forms in ξ that the proof uses.

ξ is the deviation of the state from the steady motion, and the proof uses the linear form A ξ of its derivative. At
sampled positions, headings and vehicles the derivative of the second implementation must equal A ξ up to rounding; here
A is formed without thrust limits and with the true secant slopes of the drag.
"""

from __future__ import annotations

import math
import random

import numpy as np

from surctl.certcheck.document import Rejected
from surctl.certcheck.heading_cells import rows
from surctl.certcheck.heading_claim import HeadingClaim

__all__ = ["Boat", "check_identity", "commanded_thrust", "true_rate"]

_SAMPLES = 8

Boat = dict[str, float]
"""Parameters of one true vehicle, with the keys of `HeadingClaim.ranges`."""


def commanded_thrust(law: dict[str, float], state: list[float]) -> tuple[float, float, float]:
    """Return the thrust [N, N, N m] of equations (11), (12) of the paper and of the velocity loops, without limits."""
    x_e, y_e, psi, u, v, r = state
    q = math.hypot(y_e, law["lookahead"])
    desired = (law["cruise"] - law["k1"] * x_e) * q / law["lookahead"]
    fed = law["linear_drag"] * law["cruise"] + law["quadratic_drag"] * law["cruise"] ** 2
    turn = r + law["k_psi"] * (psi + math.atan(y_e / law["lookahead"]))
    return (
        law["mass_kg"] * law["k"] * (desired - u) + fed,
        -law["mass_kg"] * law["k"] * v,
        -law["yaw_inertia_kg_m2"] * law["k_r"] * turn,
    )


def true_rate(law: dict[str, float], boat: Boat, state: list[float], thrust: tuple[float, ...]) -> list[float]:
    """Return d/dt of (x_e, y_e, ψ, u, v, r) under the given thrust, by equations (2) and (3) of the paper."""
    _, _, psi, u, v, r = state
    m = boat["mass_kg"]
    c, s = math.cos(psi), math.sin(psi)

    def drag(axis: str, n: float) -> float:
        return boat[f"{axis}_linear"] * n + boat[f"{axis}_quadratic"] * n * abs(n)

    return [
        c * u - s * v - law["cruise"],
        s * u + c * v,
        r,
        (thrust[0] + m * v * r - drag("surge", u)) / m,
        (thrust[1] - m * u * r - drag("sway", v)) / m,
        (thrust[2] - drag("yaw", r)) / boat["yaw_inertia_kg_m2"],
    ]


def check_identity(claim: HeadingClaim, draw: random.Random) -> None:
    """Compare the state derivative of vehicle and law with A ξ at sampled points.

    Raises:
        Rejected: the state derivative of vehicle and law differs from A ξ.
    """
    law = {key: float(value) for key, value in claim.law.items()}
    v, velocity_gain = law["cruise"], float(claim.velocity_gain)
    for _ in range(_SAMPLES):
        boat = {key: draw.uniform(*map(float, pair)) for key, pair in claim.ranges.items()}
        trim = boat["surge_linear"] * v + boat["surge_quadratic"] * v * v
        command = v + (trim - law["linear_drag"] * v - law["quadratic_drag"] * v * v) / velocity_gain
        state = [draw.uniform(-1, 1) for _ in range(3)] + [draw.uniform(-0.3, 0.3) for _ in range(3)]
        psi, r = state[2], state[5]
        c, s = math.cos(psi), math.sin(psi)
        rate = true_rate(law, boat, state, commanded_thrust(law, state))
        turned = [c * rate[3] - s * rate[4], s * rate[3] + c * rate[4]]
        speed = [c * state[3] - s * state[4], s * state[3] + c * state[4]]
        expected = [rate[0], rate[1], rate[2], turned[0] - r * speed[1], turned[1] + r * speed[0], rate[5]]
        xi = np.array([state[0] - (v - command) / law["k1"], state[1], psi, speed[0] - v, speed[1], r])
        none = np.zeros(2)
        at = rows(law, (command, command), np.array([psi]), np.array([state[1]]), none)
        fast, side = float(at.surge.mid[0] @ xi), float(at.sway.mid[0] @ xi)
        if abs(fast - (state[3] - v)) > 1e-9 or abs(side - state[4]) > 1e-9:
            raise Rejected("the velocity rows differ from the vehicle's velocity at a sampled point")
        u, w = state[3], state[4]
        lost = boat["surge_linear"] * fast + boat["surge_quadratic"] * (u * abs(u) - v * v)
        ahead = velocity_gain * (float(at.place[0].mid[0] @ xi) - fast) - lost
        abeam = -velocity_gain * side - boat["sway_linear"] * w - boat["sway_quadratic"] * w * abs(w)
        moved = (at.ahead.mid[0] * ahead + at.abeam.mid[0] * abeam) / boat["mass_kg"]
        spin = float(at.yaw.mid[0] @ xi) - boat["yaw_linear"] * r - boat["yaw_quadratic"] * r * abs(r)
        own = [*xi[3:], moved[3], moved[4], spin / boat["yaw_inertia_kg_m2"]]
        if max(abs(a - b) for a, b in zip(expected, own, strict=True)) > 1e-9:
            raise Rejected("the linear inclusion does not reproduce the nonlinear loop at a sampled point")
