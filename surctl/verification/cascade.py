"""The cascaded controller, linearised about cruise: guidance outside, velocity loops inside, one loop delay.

In the deviations from a straight cruise along x (path and heading along x) the controller is
ν_c = (−k1 x, −(U/Δ_h) y − U ψ, −k2 z, −k_psi ψ), F = m̂ (k (ν_c − ν) + ξ) + D'(ν_0) ν_c, ξ̇ = k_i (ν_c − ν),
with k = (k_v, k_v, k_v, k_r). −U ψ is the wish turned into {B}: guidance commands a velocity in {E}. D' is
the slope of the drag that is fed forward at the wanted speed; neither Coriolis forces nor drag are cancelled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from surctl.errors import InputError, nearest
from surctl.vehicle import Vehicle, linearise

__all__ = ["CASCADE_GAINS", "Cascade", "build_cascade"]

CASCADE_GAINS = ("k1", "k2", "k_psi", "k_r", "k_v", "lookahead")
_OUTPUTS = ("x", "y", "z", "psi", "u", "v", "w", "r")
_PADE_ORDER = 3


@dataclass(frozen=True, eq=False)
class Cascade:
    """Delayed plant and controller: ẋ = A x + B f, y = C x, f = −K y.

    With integral action ξ (4,) joins the states and the end of y, and its rate the end of f.

    Attributes:
        A: (n, n) plant with thrust lag, then the delay states, then ξ.
        B: (n, 4 or 8) from commanded thrust [N, N m], then ξ̇.
        C: (8 or 12, n) to (x, y, z, ψ, u, v, w, r), then ξ.
        K: (4 or 8, 8 or 12) controller.
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    K: NDArray[np.float64]

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Closed-loop poles (n,) [rad/s], the slowest first."""
        found = np.linalg.eigvals(self.A - self.B @ self.K @ self.C).astype(complex)
        return found[np.argsort(-found.real, kind="stable")]

    @property
    def stable(self) -> bool:
        """Whether every closed-loop pole lies in the open left half-plane."""
        return bool(self.poles[0].real < -1e-9)

    def at_thrust(self, axis: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Loop (A, b, c) broken at one thrust command, all others closed."""
        rest = self.K.copy()
        rest[axis] = 0
        closed = self.A - self.B @ rest @ self.C
        return closed, self.B[:, [axis]], self.K[[axis]] @ self.C

    def at_output(self, index: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Loop (A, b, c) broken at one measured output, all others closed."""
        rest = self.K.copy()
        rest[:, index] = 0
        closed = self.A - self.B @ rest @ self.C
        return closed, self.B @ self.K[:, [index]], self.C[[index]]


def build_cascade(
    vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float, model: Vehicle | None = None
) -> Cascade:
    """Linearise the plant at cruise speed and close the cascade around it.

    Args:
        vehicle: the plant.
        gains: `CASCADE_GAINS` by name, and k_i [1/s²] if there is integral action; others are passed over.
        cruise: U [m/s], > 0.
        dt: control period [s], > 0; the loop delay is 1.5 dt: one to compute, half of one for the hold.
        model: what the controller believes the vehicle to be; default the vehicle itself.

    Raises:
        InputError: a gain is missing or not positive, or the vehicle cannot cruise at that speed.
    """
    model = model or vehicle
    k = _gains({**gains, "cruise": cruise, "dt": dt})
    plant = linearise(vehicle, np.array([cruise, 0.0, 0.0, 0.0]))
    # outputs in a fixed order, by name; states of the plant are its outputs
    pick = np.array([plant.output_labels.index(name) for name in _OUTPUTS])
    A, B, C = np.asarray(plant.A), np.asarray(plant.B), np.asarray(plant.C)[pick]
    A, B, C = _delayed(A, B, C, 1.5 * dt)
    proportional = Cascade(A, B, C, _controller(model, k))
    k_i = float(gains.get("k_i", 0.0))
    if not (np.isfinite(k_i) and k_i >= 0):
        raise InputError("must be at least 0", key="k_i", value=k_i, remedy="correct it")
    return _with_integral(proportional, model, k, k_i) if k_i > 0 else proportional


def _guidance(k: Mapping[str, float]) -> NDArray[np.float64]:
    """(4, 4): ν_c = −this · (x, y, z, ψ)."""
    outer = np.diag([k["k1"], k["cruise"] / k["lookahead"], k["k2"], k["k_psi"]])
    outer[1, 3] = k["cruise"]
    return outer


def _controller(vehicle: Vehicle, k: Mapping[str, float]) -> NDArray[np.float64]:
    """K (4, 8) from deviations (x, y, z, ψ, u, v, w, r) to −F."""
    inner = vehicle.mass * np.array([k["k_v"], k["k_v"], k["k_v"], k["k_r"]])
    speed = np.array([k["cruise"], 0.0, 0.0, 0.0])
    slope = vehicle.linear_drag + 2 * vehicle.quadratic_drag * speed  # D'(ν_0)
    return np.hstack([(inner + slope)[:, None] * _guidance(k), np.diag(inner)])


def _with_integral(cascade: Cascade, vehicle: Vehicle, k: Mapping[str, float], k_i: float) -> Cascade:
    """The cascade with ξ̇ = k_i (ν_c − ν) and m̂ ξ added to the thrust."""
    eye = np.eye(4)
    drive = k_i * np.hstack([_guidance(k), eye])
    return Cascade(
        block_diag(cascade.A, np.zeros((4, 4))),
        block_diag(cascade.B, eye),
        block_diag(cascade.C, eye),
        np.block([[cascade.K, -np.diag(vehicle.mass)], [drive, np.zeros((4, 4))]]),
    )


def _delayed(
    A: NDArray[np.float64], B: NDArray[np.float64], C: NDArray[np.float64], delay: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The plant behind a Padé delay [s] on each of its inputs."""
    import control  # seconds to import: only when asked for

    lag = control.ss(control.tf(*control.pade(delay, _PADE_ORDER)))
    eye = np.eye(B.shape[1])
    a, b, c, d = (np.kron(eye, np.asarray(m)) for m in (lag.A, lag.B, lag.C, lag.D))
    top = np.hstack([A, B @ c])
    bottom = np.hstack([np.zeros((a.shape[0], A.shape[0])), a])
    return np.vstack([top, bottom]), np.vstack([B @ d, b]), np.hstack([C, np.zeros((C.shape[0], a.shape[0]))])


def _gains(given: Mapping[str, float]) -> dict[str, float]:
    found = {}
    for name in (*CASCADE_GAINS, "cruise", "dt"):
        if name not in given:
            raise InputError("gain is missing", key=name, remedy=nearest(name, given))
        value = float(given[name])
        if not (np.isfinite(value) and value > 0):
            raise InputError("must be greater than 0", key=name, value=value, remedy="correct it")
        found[name] = value
    return found
