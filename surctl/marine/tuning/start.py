"""Initial gain sets of a search from a linear quadratic regulator (LQR)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.marine.tuning.pool import Request
from surctl.marine.vehicle import Vehicle, linearise, plant_parameters
from surctl.marine.verification import CASCADE_GAINS, build_cascade, linear_table
from surctl.marine.verification.cascade import build_cascades, has_cascade
from surctl.marine.verification.linear import slowest_mode
from surctl.tuning.chunked import Progress
from surctl.verification.linear import LEAST_DISK_MARGIN

__all__ = ["lqr_start", "starting_sets"]

_DEVIATION = (0.3, 0.3, 0.3, 0.3, 0.1, 0.1, 0.1, 0.2)  # largest deviations, of equal weight: m, rad, m/s, rad/s
_MILDER = 2.0  # factor on R as long as the disk margin is too small
_OUTER = np.array([0.5**0.5] * 4 + [1.0] * 4)  # factor on Q applied together with the factor on R
_MOST = 24  # largest number of times that R and Q are changed


def starting_sets(request: Request, *, progress: Progress = lambda _: None) -> list[dict[str, float]]:
    """Return gain sets, within the search space, that a search simulates before it samples gain sets at random.

    For each vehicle of the request, one set is returned if the law has the linear loop that `lqr_start` assumes: the
    gains of `lqr_start`, and the start values of the request for all other gains.
    """
    sets = []
    for case in {c.vehicle.name: c for c in request.cases if has_cascade(c.law, c.guidance)}.values():
        try:
            regulator = lqr_start(case.model or case.vehicle, cruise=case.scenario.cruise, dt=case.build().dt)
        except InputError as error:
            # the remedies of the error are arguments of `lqr_start`; the search needs none, because it has other starts
            progress(f"{case.vehicle.name}: {error.problem}; the search starts without LQR gains")
            continue
        sets.append({s.name: s.clip(regulator.get(s.name, request.base[s.name])) for s in request.space})
    return sets


def lqr_start(
    vehicle: Vehicle, *, cruise: float, dt: float, q: ArrayLike | None = None, r: ArrayLike | None = None
) -> dict[str, float]:
    """Return the `CASCADE_GAINS` nearest to an LQR of the vehicle with the least disk margin.

    The regulator (python-control's `lqr`) neglects thrust lag and delay and feeds back every state to every thrust, but
    the cascade has only six gains. The six gains are fitted by least squares in their logarithms. The fit compares the
    thrust that the regulator commands with the thrust that the cascade commands, both as shares of the thrust limits,
    for state deviations of the size that the weights q allow. Feedback paths that the cascade does not have (for
    example from sway to surge) are not part of the fit. The weights are then changed until the cascade with lag and
    delay has this disk margin: in each change, r is doubled, and the weights of position and heading are divided by √2,
    because slower inner loops require slower outer loops. k_i is not among the gains, because guidance already
    integrates position.

    Args:
        vehicle: the vehicle, used both as plant and as the controller's model.
        cruise: cruise speed U [m/s].
        dt: control period [s].
        q: (8,) weights > 0 of deviations in x, y, z [1/m²], ψ [1/rad²], u, v, w [s²/m²], r [s²/rad²]; default by
            Bryson's rule: 1 / (largest deviation)².
        r: (4,) weights > 0 of the thrust [1/N², 1/(N m)²]; default 1 / (thrust limit)².

    Raises:
        InputError: weights have the wrong shape or sign, the vehicle cannot hold the cruise speed, or no fitted gains
            have the disk margin.

    Example:
        >>> from surctl.marine.tuning import lqr_start
        >>> from surctl.marine.vehicle import load_vehicle
        >>> gains = lqr_start(load_vehicle("sur400"), cruise=0.15, dt=0.05)
        >>> {name: round(value, 2) for name, value in gains.items()}
        {'k1': 0.24, 'k2': 0.28, 'k_psi': 0.6, 'k_r': 4.51, 'k_v': 1.18, 'lookahead': 0.56}
    """
    if not vehicle["Fv_max"] > 0:
        problem = f"{vehicle.name} has no sway force, and these gains are those of laws that move in any direction"
        raise InputError(problem, key="Fv_max", value=0.0, remedy="start from a gain file")
    import control  # takes seconds to import

    state_weights, thrust = _weights("q", q, 1 / np.square(_DEVIATION)), _weights("r", r, 1 / vehicle.thrust_limit**2)
    plant = linearise(vehicle, np.array([cruise, 0.0, 0.0, 0.0]))
    A = np.asarray(plant.A)[:8, :8]
    B = np.vstack([np.zeros((4, 4)), np.linalg.inv(vehicle.inertia)[:4, :4]])
    best: tuple[float, dict[str, float]] = 0.0, {}
    for doubling in range(_MOST):
        state = state_weights * _OUTER**doubling
        try:
            K, _, _ = control.lqr(A, B, np.diag(state), np.diag(thrust * _MILDER**doubling))
        except ValueError:  # the Riccati equation is too ill-conditioned; milder weights make it worse
            break
        gains = _fit(vehicle, np.asarray(K), state_weights, cruise=cruise, dt=dt)
        table = linear_table(vehicle, {}, base=gains, cruise=cruise, dt=dt, columns=["disk_margin"])
        margin = float(table["disk_margin"][0])
        if margin >= LEAST_DISK_MARGIN:
            return gains
        if margin > best[0] or not best[1]:
            best = margin, gains
    if not best[1]:
        problem = "the Riccati equation of the regulator has no numerical solution"
        raise InputError(problem, key="q", remedy="give weights of more similar size, or start from a gain file")
    raise _no_start(vehicle, best[1], cruise=cruise, dt=dt)


def _no_start(vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float) -> InputError:
    """Return an InputError with the reason why no fitted gains have the required disk margin.

    The error names the cruise speed or the control period if one of them alone is the reason.
    """
    missing = f"no fitted cascade has a disk margin of {LEAST_DISK_MARGIN:g}"
    mode = slowest_mode(vehicle, gains, cruise=cruise, dt=dt)
    if not mode.stable:
        why = "" if mode.cause is None else f", because of the {mode.cause}"
        problem = f"{missing}: all are unstable{why}"
        return InputError(problem, key="cruise", value=cruise, remedy=f"it is stable {mode.remedy}")
    quick = linear_table(vehicle, {}, base=gains, cruise=cruise, dt=dt / 4, columns=["disk_margin"])
    if quick["disk_margin"][0] >= LEAST_DISK_MARGIN:
        return InputError(f"{missing} at the control period of {dt:g} s", key="dt", value=dt, remedy="shorten it")
    return InputError(missing, key="cruise", value=cruise, remedy="lower the cruise speed, or start from a gain file")


def _fit(
    vehicle: Vehicle, K: NDArray[np.float64], q: NDArray[np.float64], *, cruise: float, dt: float
) -> dict[str, float]:
    """Return the cascade gains whose feedback matrix is as near as possible to the LQR feedback matrix K (4, 8).

    Both matrices are scaled by the thrust limits and the largest deviations.
    """
    from scipy.optimize import least_squares

    scale = 1 / np.sqrt(q)[None] / vehicle.thrust_limit[:, None]
    flat, form = plant_parameters(vehicle)[None], vehicle.form
    # entries of K that depend on some gain; the cascade cannot change the other entries
    reachable = build_cascade(vehicle, dict.fromkeys(CASCADE_GAINS, 1.0), cruise=cruise, dt=dt).K != 0

    def missed(logs: NDArray[np.float64]) -> NDArray[np.float64]:
        gains: Mapping[str, NDArray[np.float64]] = {
            n: np.exp(v)[None] for n, v in zip(CASCADE_GAINS, logs, strict=True)
        }
        gain_matrix = build_cascades(
            flat, gains, cruise=np.array([cruise]), dt=dt, model=flat, form=form, model_form=form
        ).K[0]
        return np.asarray(((gain_matrix - K) * scale)[reachable], dtype=float)

    fitted = least_squares(missed, np.zeros(len(CASCADE_GAINS)), bounds=(np.log(1e-3), np.log(1e2)))
    return {name: float(np.exp(v)) for name, v in zip(CASCADE_GAINS, fitted.x, strict=True)}


def _weights(key: str, values: ArrayLike | None, default: NDArray[np.float64]) -> NDArray[np.float64]:
    weights = default if values is None else np.asarray(values, dtype=float)
    if weights.shape != default.shape or not np.all(np.isfinite(weights) & (weights > 0)):
        raise InputError(f"needs {default.size} numbers greater than 0", key=key, remedy="correct the weights")
    return weights
