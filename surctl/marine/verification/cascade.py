"""The cascaded controller, linearised about cruise: outer guidance loop, inner velocity loops and loop delay.

All quantities are deviations from a straight cruise at speed U; path and heading lie along x. Guidance commands the
velocity ν_c = (−k1 x, −(U/Δ_h) y − U ψ, −k2 z, −k_psi ψ), where Δ_h is the lookahead distance. The velocity loops
command the thrust F = m̂ (k (ν_c − ν) + ξ) + D'(ν_0) ν_c, where ν is the velocity, ν_0 its value in cruise, m̂ the mass
in the controller's model, k = (k_v, k_v, k_v, k_r), and ξ the integral action with ξ̇ = k_i (ν_c − ν). The rotation of
the commanded velocity from the earth-fixed frame {E} into the body frame {B} gives the term −U ψ. D' is the slope of
the drag that the controller feeds forward at the desired speed. The controller compensates neither Coriolis forces nor
the drag at the measured speed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.ir import Layout
from surctl.marine.control import CASCADE, law_source
from surctl.marine.vehicle import PLANT_PARAMETERS, PlantForm, Vehicle, plant_jacobians, plant_parameters
from surctl.marine.vehicle.dynamics import PAPER
from surctl.marine.vehicle.linearise import check_cruise, dynamic_states
from surctl.verification.linear import eigenvalues
from surctl.verification.loops import BrokenLoop, state_blocks

__all__ = [
    "CASCADE_GAINS",
    "LOOP_NAMES",
    "Cascade",
    "broken_loops",
    "build_cascade",
    "build_cascades",
    "check_positive",
    "has_cascade",
]

LOOP_NAMES = ("surge", "sway", "heave", "yaw", "along_track", "cross_track", "depth", "heading")

CASCADE_GAINS = ("k1", "k2", "k_psi", "k_r", "k_v", "lookahead")
_OUTPUTS = 8  # x, y, z, ψ, u, v, w, r: the first states of the plant
_PADE_ORDER = 3


def has_cascade(law: str, guidance: str) -> bool:
    """Return whether this cascade describes a law with a guidance, linearised about straight cruise without obstacles.

    The law `dwa` chooses among discrete velocities and has no linear loop. Guidance with an internal state adds a state
    that the cascade does not contain.
    """
    return guidance == "los" and CASCADE in law_source(law).parts


@dataclass(frozen=True, eq=False)
class Cascade:
    """A linear plant with loop delay, ẋ = A x + B f and y = C x, and its controller f = −K y.

    A leading axis of the arrays holds several cascades. With integral action, the integral state ξ (4,) is appended to
    the state x and to the output y, and its derivative ξ̇ is appended to the input f.

    Attributes:
        A: (…, n, n) state matrix; the states are those of the plant with thrust lag, then the delay states, then ξ.
        B: (…, n, 4 or 8) input matrix; the inputs are the commanded thrust [N, N m], then ξ̇.
        C: (…, 8 or 12, n) output matrix; the outputs are (x, y, z, ψ, u, v, w, r), then ξ.
        K: (…, 4 or 8, 8 or 12) controller gain.
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    K: NDArray[np.float64]

    @property
    def closed(self) -> NDArray[np.float64]:
        """The closed-loop matrix A − B K C, (…, n, n)."""
        closed: NDArray[np.float64] = self.A - self.B @ self.K @ self.C
        return closed

    @property
    def poles(self) -> NDArray[np.complex128]:
        """The closed-loop poles (…, n) [rad/s], the slowest first."""
        closed = self.closed
        poles = np.linalg.eigvals(closed).astype(complex) if closed.ndim == 2 else eigenvalues(closed)
        return np.take_along_axis(poles, np.argsort(-poles.real, axis=-1, kind="stable"), axis=-1)

    @property
    def stable(self) -> bool:
        """Whether every closed-loop pole lies in the open left half-plane."""
        return bool(np.all(self.poles[..., 0].real < -1e-9))

    def at_thrust(self, axis: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """The matrices (A, b, c) of the loop that is opened at one thrust command while all other loops are closed."""
        rest = self.K.copy()
        rest[..., axis, :] = 0
        closed = self.A - self.B @ rest @ self.C
        return closed, self.B[..., [axis]], self.K[..., [axis], :] @ self.C

    def at_output(self, index: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """The matrices (A, b, c) of the loop that is opened at one measured output while all other loops are closed."""
        rest = self.K.copy()
        rest[..., index] = 0
        closed = self.A - self.B @ rest @ self.C
        return closed, self.B @ self.K[..., [index]], self.C[..., [index], :]


def build_cascade(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    *,
    cruise: float,
    dt: float,
    model: Vehicle | None = None,
    delay: float | None = None,
) -> Cascade:
    """Return the cascade of a plant and its controller, linearised at the cruise speed.

    Args:
        vehicle: the plant.
        gains: the gains `CASCADE_GAINS` by name, and k_i [1/s²] for integral action; other gains are ignored.
        cruise: cruise speed U [m/s], > 0.
        dt: control period [s], > 0. The loop delay is 1.5 dt: dt for the computation and dt/2 for the zero-order hold.
        model: the controller's model of the vehicle; default the vehicle itself.
        delay: loop delay [s] in place of 1.5 dt; 0 omits the delay, for callers that model sampling exactly.

    Raises:
        InputError: a gain is missing or not positive, or the vehicle cannot cruise at that speed or has no sway force.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import build_cascade
        >>> cascade = build_cascade(load_vehicle("sur400"), load_gains("default").values, cruise=0.15, dt=0.05)
        >>> cascade.stable, cascade.A.shape, round(float(cascade.poles.real.max()), 2)
        (True, (24, 24), -0.22)
    """
    check_positive({"cruise": np.atleast_1d(cruise)})
    for craft in (vehicle, model or vehicle):
        if not craft["Fv_max"] > 0:
            raise InputError(
                f"the cascade moves in any direction, but {craft.name} has no sway force",
                key="Fv_max",
                value=craft["Fv_max"],
                remedy="use law_loop with the law steered",
            )
    check_cruise(vehicle, cruise)
    many = build_cascades(
        plant_parameters(vehicle)[None],
        {name: np.atleast_1d(float(value)) for name, value in gains.items()},
        cruise=np.atleast_1d(cruise),
        dt=dt,
        model=plant_parameters(model or vehicle)[None],
        delay=delay,
        form=vehicle.form,
        model_form=(model or vehicle).form,
    )
    return Cascade(many.A[0], many.B[0], many.C[0], many.K[0])


def build_cascades(
    plant: NDArray[np.float64],
    gains: Mapping[str, NDArray[np.float64]],
    *,
    cruise: NDArray[np.float64],
    dt: float,
    model: NDArray[np.float64],
    delay: float | None = None,
    form: PlantForm = PAPER,
    model_form: PlantForm = PAPER,
) -> Cascade:
    """Build the cascades of n parameter points at once; see `build_cascade`.

    All n cascades must have the same order: all or none have thrust lag, and all or none have integral action.

    Args:
        plant: (n, …) plant parameters in the order of `plant_parameters`; the caller must check that the thrust of
            each plant suffices for the cruise speed.
        gains: the gains `CASCADE_GAINS` by name, and k_i for integral action, each an array (n,).
        cruise: cruise speed U (n,) [m/s].
        dt: control period [s].
        model: (n, …) parameters of the controller's model, in the order of `plant_parameters`; the controller knows
            no optional terms but the drag that grows with the forward speed.
        delay: loop delay [s], as in `build_cascade`.
        form: the optional terms that all plants have.
        model_form: the optional terms of the model.

    Raises:
        InputError: a gain is missing or not positive, or the cascades have different orders.
    """
    for name in CASCADE_GAINS:
        if name not in gains:
            raise InputError("gain is missing", key=name, remedy=nearest(name, gains))
    k = {**{name: gains[name] for name in CASCADE_GAINS}, "cruise": cruise}
    check_positive({**k, "dt": np.atleast_1d(dt)})
    k_i = gains.get("k_i", np.zeros(len(cruise)))
    if not np.all(np.isfinite(k_i) & (k_i >= 0)):
        raise InputError("must be at least 0", key="k_i", value=float(np.min(k_i)), remedy="correct it")
    lag = plant[:, PLANT_PARAMETERS.slice("thrust_lag")][:, 0]
    for key, value in (("thrust_lag", lag), ("k_i", k_i)):
        if np.any(value > 0) != np.all(value > 0):
            raise InputError(
                "is 0 at some points and positive at others",
                key=key,
                remedy="build them in separate calls: their cascades have different orders",
            )
    nu = np.zeros((len(cruise), 4))
    nu[:, 0] = cruise
    A, B, _ = plant_jacobians(plant, nu, form=form)
    # the first states of the plant are its outputs
    keep = dynamic_states(form, lagged=lag[0] > 0)
    C = np.broadcast_to(np.eye(_OUTPUTS, len(keep)), (len(nu), _OUTPUTS, len(keep)))
    A, B = A[:, keep][:, :, keep], B[:, keep]
    if delay != 0:
        A, B, C = _delayed(A, B, C, 1.5 * dt if delay is None else delay)
    model_values = {name: _columns(model, PLANT_PARAMETERS, name) for name in ("mass", "linear_drag", "quadratic_drag")}
    for axis, name in model_form.ahead():  # as in `Vehicle.drag_at`
        forward = model[:, PLANT_PARAMETERS.size + model_form.terms.index(name)] * cruise
        model_values["linear_drag"] = model_values["linear_drag"] + np.eye(4)[axis] * forward[:, None]
    proportional = Cascade(A, B, C, _controller(model_values, k, nu))
    return _with_integral(proportional, model_values["mass"], k, k_i) if k_i[0] > 0 else proportional


def broken_loops(cascade: Cascade) -> list[BrokenLoop]:
    """Return the eight loops of `LOOP_NAMES` for a batch of cascades."""
    closed = cascade.closed
    blocks = state_blocks(closed)
    poles = [np.linalg.eigvals(closed[:, block[:, None], block]).astype(complex) for block in blocks]
    places = [cascade.at_thrust(k) for k in range(4)] + [cascade.at_output(k) for k in range(4)]
    loops = []
    for A, b, _ in places:
        # the set of states on which this loop acts
        where = next(k for k, block in enumerate(blocks) if np.any(b[:, block] != 0))
        block = blocks[where]
        loops.append(BrokenLoop(poles[where], np.linalg.eigvals(A[:, block[:, None], block]).astype(complex)))
    return loops


def check_positive(values: Mapping[str, NDArray[np.float64]]) -> None:
    """Raise InputError for the first value that is not finite or not greater than 0."""
    for name, entries in values.items():
        wrong = entries[~(np.isfinite(entries) & (entries > 0))]
        if wrong.size:
            raise InputError("must be greater than 0", key=name, value=float(wrong[0]), remedy="correct it")


def _columns(flat: NDArray[np.float64], layout: Layout, name: str) -> NDArray[np.float64]:
    return flat[:, layout.slice(name)]


def _guidance(k: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    # G (n, 4, 4) in ν_c = −G (x, y, z, ψ)
    outer = np.zeros((len(k["cruise"]), 4, 4))
    for axis, slope in enumerate((k["k1"], k["cruise"] / k["lookahead"], k["k2"], k["k_psi"])):
        outer[:, axis, axis] = slope
    outer[:, 1, 3] = k["cruise"]
    return outer


def _controller(
    model: Mapping[str, NDArray[np.float64]], k: Mapping[str, NDArray[np.float64]], nu: NDArray[np.float64]
) -> NDArray[np.float64]:
    # K (n, 4, 8) maps the deviations (x, y, z, ψ, u, v, w, r) to −F
    inner = model["mass"] * np.stack([k["k_v"], k["k_v"], k["k_v"], k["k_r"]], axis=-1)
    slope = model["linear_drag"] + 2 * model["quadratic_drag"] * np.abs(nu)  # D'(ν_0)
    return np.concatenate([(inner + slope)[..., None] * _guidance(k), inner[..., None] * np.eye(4)], axis=-1)


def _with_integral(
    cascade: Cascade,
    mass: NDArray[np.float64],
    k: Mapping[str, NDArray[np.float64]],
    k_i: NDArray[np.float64],
) -> Cascade:
    """Return the cascade with integral action: m̂ ξ is added to the thrust command, with ξ̇ = k_i (ν_c − ν).

    ν_c − ν is the error of the velocity, and m̂ (the argument `mass`) is the mass in the controller's model.
    """
    eye = np.broadcast_to(np.eye(4), (len(k_i), 4, 4))
    drive = k_i[:, None, None] * np.concatenate([_guidance(k), eye], axis=-1)
    return Cascade(
        _diagonal(cascade.A, np.zeros_like(eye)),
        _diagonal(cascade.B, eye),
        _diagonal(cascade.C, eye),
        np.block([[cascade.K, -mass[..., None] * eye], [drive, np.zeros_like(eye)]]),
    )


def _diagonal(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return n block-diagonal matrices; each has one matrix of `first` and one of `second` as its blocks."""
    (n, rows, columns), (_, more, further) = first.shape, second.shape
    joined = np.zeros((n, rows + more, columns + further))
    joined[:, :rows, :columns], joined[:, rows:, columns:] = first, second
    return joined


def _delayed(
    A: NDArray[np.float64], B: NDArray[np.float64], C: NDArray[np.float64], delay: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the plants (A, B, C) with a Padé approximation of the delay [s] at every input."""
    eye = np.eye(B.shape[-1])
    a, b, c, d = (np.kron(eye, m) for m in _pade(delay))
    n, order, lags = len(A), A.shape[-1], len(a)
    joined = np.zeros((n, order + lags, order + lags))
    joined[:, :order, :order], joined[:, :order, order:], joined[:, order:, order:] = A, B @ c, a
    entry = np.concatenate([B @ d, np.broadcast_to(b, (n, *b.shape))], axis=-2)
    return joined, entry, np.concatenate([C, np.zeros((n, C.shape[-2], lags))], axis=-1)


@cache
def _pade(delay: float) -> tuple[NDArray[np.float64], ...]:
    # A, B, C, D in controller canonical form (Golub and Van Loan, algorithm 11.3.1)
    n, down = _PADE_ORDER, [1.0]
    for k in range(1, n + 1):
        down.append(down[-1] * delay * (n - k + 1) / (2 * n - k + 1) / k)
    den = np.array(down[::-1]) / down[-1]
    num = den * (-1.0) ** np.arange(n, -1, -1)
    A = np.eye(n, k=-1)
    A[0] = -den[1:]
    return A, np.eye(n, 1), (num[1:] - num[0] * den[1:])[None], num[:1, None]
