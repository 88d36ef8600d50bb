"""The loop of a turning cruise, written from equations (2) and (3) of the paper, to compare the checker with."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.turning_claim import TurningClaim
from surctl.certcheck.turning_law import followed

Array = NDArray[np.float64]


def commanded(claim: TurningClaim, state: Array, psi: Array) -> Array:
    """Return the thrust (n, 2) [N] that the law commands on each axis of the body; arguments as in `true_rate`."""
    return followed(claim, claim.thrust, state, psi)


def true_rate(
    claim: TurningClaim,
    boat: Mapping[str, Array],
    state: Array,
    psi: Array,
    r: Array,
    other: Array | None = None,
    *,
    flow: Array | None = None,
    error: Array | None = None,
) -> Array:
    """Return d/dt of (x_e, y_e, U_x, U_y) (n, 4) by equations (2), (3) of the paper and the law.

    Args:
        claim: the claim.
        boat: factors (n, 2) of the true `mass`, `linear` and `quadratic` drag; factors (n,) of the terms beside
            equation (3): `term_mass` of inertia, and `term` of all others.
        state: (x_e, y_e, U_x, U_y) (n, 4), with the velocity U in the path frame.
        psi: angle (n,) from the path to the heading.
        r: yaw rate (n,).
        other: heave velocity, heave acceleration, yaw acceleration, and turn rate of the path frame (n, 4); None for 0.
        flow: constant current in the path frame (n, 2); None for 0.
        error: thrust minus its command in the body frame (n, 2) [N]; None for 0.
    """
    w, w_rate, r_rate, bend = np.zeros((4, len(r))) if other is None else other.T
    v, (x_e, y_e, along, across) = float(claim.cruise), state.T
    thrust = commanded(claim, state, psi) + (0 if error is None else error)
    c, s = np.cos(psi), np.sin(psi)
    first, second = (along, across) if flow is None else (along - flow[:, 0], across - flow[:, 1])
    nu = c * first + s * second, -s * first + c * second  # through the water
    pull, mass = [], []
    for i in (0, 1):
        m, a, b = (float(n[i]) for n in (claim.mass, claim.linear, claim.quadratic))
        drag = boat["linear"][:, i] * a * nu[i] + boat["quadratic"][:, i] * b * nu[i] * np.abs(nu[i])
        pull.append(thrust[:, i] - drag)
        mass.append(boat["mass"][:, i] * m)
    terms, heavy, rough = {name: float(value) for name, value in claim.terms.items()}, boat["term_mass"], boat["term"]
    m12, carried, forces = heavy * terms.get("m12", 0.0), [], []
    for i in (0, 1):
        m3, m4 = heavy * terms.get(f"m{i + 1}3", 0.0), heavy * terms.get(f"m{i + 1}4", 0.0)
        carried.append(m3 * w + m4 * r)
        force = rough * terms.get(f"{'XY'[i]}0", 0.0) - m3 * w_rate - m4 * r_rate
        for name, value in terms.items():
            if name[0] == "XY"[i] and name[1] in "uvwr":
                speeds = [{"u": nu[0], "v": nu[1], "w": w, "r": r}[letter] for letter in name[1:]]
                force = force - rough * value * (speeds[0] if len(speeds) == 1 else np.abs(speeds[0]) * speeds[1])
        forces.append(force)
    momentum = mass[0] * nu[0] + m12 * nu[1] + carried[0], mass[1] * nu[1] + m12 * nu[0] + carried[1]
    load = pull[0] + forces[0] + r * momentum[1], pull[1] + forces[1] - r * momentum[0]
    size = mass[0] * mass[1] - m12 * m12
    u_rate, v_rate = (mass[1] * load[0] - m12 * load[1]) / size, (mass[0] * load[1] - m12 * load[0]) / size
    # U = R ν + current: U̇ = R (ν̇ + r S ν), S the quarter turn; the path frame itself turns at `bend`
    first, second = u_rate - r * nu[1], v_rate + r * nu[0]
    turned = c * first - s * second + bend * across, s * first + c * second - bend * along
    return np.stack([along - v + bend * y_e, across - bend * x_e, *turned], axis=1)
