"""The published models of the library's vehicles, as their sources write them.

Axes are those of the sources: x ahead, y right, z down, with velocities (u, v, w, r). M, C_RB, C_A and D stand here as
the sources print them, apart from the library files and from the plant. Numbers that a source gives as a formula are
computed and rounded to six digits, as in the files.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FLIP = np.diag([1.0, -1.0, -1.0, -1.0])  # between the sources' axes and x ahead, y left, z up


@dataclass(frozen=True)
class Published:
    """M (4, 4), the load C(ν)ν + D(ν)ν − constant force (4,), and a steady turn under constant thrust.

    Attributes:
        inertia: M.
        load: function of ν.
        thrust: thrust of the turn, which the vehicle can give.
        start: velocity at the start of the turn.
        seconds: time until the turn is steady.
        surge: linear and quadratic drag ahead.
    """

    inertia: Array
    load: Callable[[Array], Array]
    thrust: tuple[float, ...]
    start: tuple[float, ...]
    seconds: float
    surge: tuple[float, float]


def six(value: float) -> float:
    """Round to six digits."""
    return float(f"{value:.6g}")


def rigid(m: float, x_g: float, i_z: float) -> tuple[Array, Callable[[Array], Array]]:
    """M_RB and C_RB(ν) of Fossen, equations 3.48 and 6.100 for the plane, with heave."""
    inertia = np.diag([m, m, m, i_z])
    inertia[1, 3] = inertia[3, 1] = m * x_g

    def coriolis(nu: Array) -> Array:
        u, v, _, r = nu
        c = np.zeros((4, 4))
        c[0, 3], c[1, 3] = -m * (x_g * r + v), m * u
        c[3, 0], c[3, 1] = m * (x_g * r + v), -m * u
        return c

    return inertia, coriolis


def added_coriolis(added: Array, nu: Array) -> Array:
    """C_A(ν) of Fossen, equation 6.43, without roll and pitch."""
    a = added @ nu
    c = np.zeros((4, 4))
    c[0, 3], c[1, 3], c[3, 0], c[3, 1] = -a[1], a[0], a[1], -a[0]
    return c


def fossen(
    body: tuple[float, float, float], added: Array, damping: Callable[[Array], Array], constant: Array | None = None
) -> tuple[Array, Callable[[Array], Array]]:
    """M and the load from (m, x_G, I_z), M_A, D(ν) and a constant force."""
    m_rb, c_rb = rigid(*body)
    pull = np.zeros(4) if constant is None else constant

    def load(nu: Array) -> Array:
        return np.asarray((c_rb(nu) + added_coriolis(added, nu) + damping(nu)) @ nu - pull)

    return m_rb + added, load


def otter() -> Published:
    """MSS, otter.m, payload 0."""
    m, x_g, length, beam, rho, g = 55.0, 0.2, 2.0, 0.25, 1025.0, 9.81
    i_z, volume = m * (0.25 * length) ** 2, m / rho
    added = np.diag([2.7 * rho * volume ** (5 / 3) / length**2, 1.5 * m, m, 1.7 * i_z])
    added[0, 0] = six(m + added[0, 0]) - m
    x_u, y_v, n_r = six(24.4 * g / (6 * 0.5144)), m + added[1, 1], i_z + m * x_g**2 + added[3, 3]
    z_w = six(2 * 0.3 * np.sqrt(rho * g * 2 * 0.75 * length * beam / (2 * m)) * 2 * m)
    draught = volume / (2 * 0.4 * beam * length)
    c_d = np.interp(beam / (2 * draught), [0.833589, 0.988002], [0.87959, 0.828415])  # Hoerner.m
    at = np.linspace(-length / 2, length / 2, 100_001)

    def cross_flow(v: float, r: float) -> tuple[float, float]:
        flow = 0.5 * rho * draught * c_d * np.abs(v + at * r) * (v + at * r)
        return float(np.trapezoid(flow, at)), float(np.trapezoid(at * flow, at))

    y_vv, n_rr = six(cross_flow(1, 0)[0]), six(10 * n_r + cross_flow(0, 1)[1])

    def damping(nu: Array) -> Array:
        return np.diag([x_u, y_v + y_vv * abs(nu[1]), z_w, n_r + n_rr * abs(nu[3])])

    inertia, load = fossen((m, x_g, i_z + m * x_g**2), added, damping)
    return Published(inertia, load, (60.0, 0, 0, 12.0), (0.7, -0.05, 0, 0.12), 30.0, (x_u, 0.0))


def remus100() -> Published:
    """Prestero 2001: equations of motion with combined coefficients, whose cross terms include added mass."""
    m, i_z = 30.48, 3.45
    inertia = np.array([[m + 0.93, 0, 0, 0], [0, m + 35.5, 0, -1.93], [0, 0, m + 35.5, 0], [0, -1.93, 0, i_z + 4.88]])

    def load(nu: Array) -> Array:
        u, v, w, r = nu
        x = -1.62 * u * abs(u) + (35.5 + m) * v * r - 1.93 * r**2
        y = -1310 * v * abs(v) + 0.632 * r * abs(r) - 28.6 * u * v + (5.22 - m) * u * r
        n = -3.18 * v * abs(v) - 94 * r * abs(r) - 24.0 * u * v - 2.0 * u * r
        return -np.array([x, y, -131 * w * abs(w), n])

    return Published(inertia, load, (4.0, 0, 0, 0.8), (1.4, -0.045, 0, 0.14), 90.0, (0.0, 1.62))


def lauv() -> Published:
    """lauv_gazebo: damping matrices, and the lift of body and fins."""
    linear = -np.array([[-2.4, 0, 0, 0], [0, -23, 0, 11.5], [0, 0, -23, 0], [0, -3.1, 0, -9.7]])
    quadratic = -np.array([[-2.4, 0, 0, 0], [0, -80, 0, 0.3], [0, 0, -80, 0], [0, -1.5, 0, -9.1]])
    radius, length, x_fin, x_body = 0.075, 1.08, -0.4, -(0.65 * 1.08 - 0.4)
    fin, body = 2 * 0.5 * 1028 * 0.0064 * 3.0, 0.5 * 1028 * np.pi * radius**2 * 1.24
    i_zz = six(18 / 12 * (3 * radius**2 + length**2) + 1.3) - 1.3
    lift = np.zeros((4, 4))
    lift[1, 1], lift[1, 3] = six(fin + body), six(fin * x_fin)
    lift[3, 1], lift[3, 3] = six(fin * x_fin + body * x_body), six(fin * x_fin**2)

    def damping(nu: Array) -> Array:
        return np.asarray(linear + quadratic @ np.diag(np.abs(nu)) + lift * nu[0])

    inertia, load = fossen((18.0, 0.0, i_zz), np.diag([1.0, 16.0, 16.0, 1.3]), damping)
    return Published(inertia, load, (6.0, 0, 0, 0.8), (1.1, -0.02, 0, 0.06), 50.0, (2.4, 2.4))


def eca_a9() -> Published:
    """eca_a9: damping proportional to the forward speed, D(ν) = −u D_u (HydrodynamicModel.cc)."""
    forward = np.array([[-8.0, 0, 0, 0], [0, -162, 0, 150], [0, 0, -108, 0], [0, -34, 0, -32]])
    inertia, load = fossen((69.7, 0.0, 35.0), np.diag([4.0, 95.0, 75.0, 32.0]), lambda nu: -nu[0] * forward)
    return Published(inertia, load, (12.0, 0, 0, 4.0), (1.2, 0.02, 0, 0.04), 60.0, (0.0, 8.0))


def rexrov() -> Published:
    """uuv_simulator, rexrov.gazebo.xacro, rows and columns 1, 2, 3 and 6 of the added mass."""
    added = np.array(
        [
            [779.79, -6.8773, -103.32, -7.8033],
            [-6.8773, 1222, 51.29, 62.726],
            [-103.32, 51.29, 3659.9, 10.774],
            [-7.8033, 62.726, 10.774, 224.32],
        ]
    )
    linear = np.diag([74.82, 69.48, 728.4, 105.0])
    quadratic = np.array([748.22, 992.53, 1821.01, 523.27])
    buoyancy = np.array([0, 0, -six((1.83826 * 1028 - 1862.87) * 9.81), 0])
    inertia, load = fossen((1862.87, 0.0, 691.23), added, lambda nu: linear + np.diag(quadratic * np.abs(nu)), buoyancy)
    return Published(inertia, load, (500.0, 0, 100.0, 150.0), (0.11, -0.346, -0.16, 0.461), 90.0, (74.82, 748.22))


def girona500() -> Published:
    """cola2_sim, dynamics.yaml and dynamics.py, whose damping matrix is −D."""
    linear, quadratic = np.array([0, -65.0, 0, -130.0]), np.array([-148.0, -148.0, -148.0, -180.0])
    inertia, load = fossen(
        (98.0, 0.0, 8.0),
        np.diag([49.0, 49.0, 49.0, 0.0]),
        lambda nu: -np.diag(linear + quadratic * np.abs(nu)),
        np.array([0, 0, -(100 - 98) * 9.81, 0]),
    )
    return Published(inertia, load, (60.0, 20.0, 50.0, 10.0), (0.6, 0.14, 0.4, 0.07), 20.0, (0.0, 148.0))


def cybership2() -> Published:
    """Skjetne et al. 2004; the surge drag is the fit of linear and quadratic drag on 0 to 0.4 m/s."""
    speed = np.linspace(0, 0.4, 40_001)
    basis, force = np.stack([speed, speed**2], 1), 0.72253 * speed + 1.32742 * speed**2 + 5.86643 * speed**3
    x_u, x_uu = np.linalg.lstsq(basis, force, rcond=None)[0]
    np.testing.assert_allclose(basis @ [x_u, x_uu], force, atol=0.03 * force[-1])
    x_u, x_uu = (round(float(x), 4) for x in (x_u, x_uu))

    def damping(nu: Array) -> Array:
        u, v, _, r = np.abs(nu)
        d = np.zeros((4, 4))
        d[0, 0] = x_u + x_uu * u
        d[1, 1], d[1, 3] = 0.88965 + 36.47287 * v + 0.805 * r, 7.25 + 0.845 * v + 3.45 * r
        d[3, 1], d[3, 3] = -0.0313 - 3.95645 * v - 0.13 * r, 1.9 - 0.08 * v + 0.75 * r
        return d

    inertia, load = fossen((23.8, 0.046, 1.76), np.diag([2.0, 10.0, 23.8, 1.0]), damping)
    return Published(inertia, load, (0.5, 0, 0, 0.03), (0.19, -0.12, 0, 0.06), 120.0, (x_u, x_uu))


PUBLISHED: dict[str, Callable[[], Published]] = {
    "otter": otter,
    "remus100": remus100,
    "lauv": lauv,
    "eca-a9": eca_a9,
    "rexrov": rexrov,
    "girona500": girona500,
    "cybership2": cybership2,
}
