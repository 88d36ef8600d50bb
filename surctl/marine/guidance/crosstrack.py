"""Integral (`ilos`) and adaptive (`alos`) line-of-sight guidance, against the path error from a steady disturbance.

Line-of-sight guidance commands a velocity with the slope −y_e/Δ against the path, where y_e is the cross-track error
and Δ is the look-ahead distance. If a steady disturbance causes a steady crosswise velocity error d at the speed U,
then y_e under equation (10) of the paper converges to Δ d/U instead of 0. Both methods remove this error: they add a
shift [m], which they adapt to y_e over time, to y_e. A prime denotes a time derivative.

`ilos` (Børhaug, Pavlov, Pettersen 2008) uses the shift σ y_int with the gain σ and the integral y_int of y_int' = Δ
y_e/(Δ² + (y_e + σ y_int)²).

`alos` (Fossen, Pettersen, Galeazzi 2015) uses the shift Δ b, where b estimates the slope b* of the drift against the
path. The adaptation law is b' = γ U Δ y_e/√(Δ² + (y_e + Δ b)²) with the gain γ. With the speed U_∥ along the path, U =
U_∥ √(Δ² + (y_e + Δ b)²)/Δ, so the adaptation law becomes b' = γ U_∥ y_e. Then the Lyapunov function V = y_e²/2 + (b −
b*)²/(2 γ) of the kinematic loop y_e' = −U_∥ (y_e/Δ + b − b*) decreases at the rate U_∥ y_e²/Δ.
"""

from __future__ import annotations

from typing import Literal, get_args

import casadi as ca

from surctl.errors import InputError, nearest

__all__ = ["GUIDANCE", "Guidance", "check_guidance", "crosstrack_next", "crosstrack_shift", "numeric_crosstrack_next"]

Guidance = Literal["los", "ilos", "alos"]
GUIDANCE: tuple[Guidance, ...] = get_args(Guidance)

_STEEPEST = 1.0  # largest slope of the course that a law may learn: 45°
_LEAST_GAIN = 1e-9  # m/s


def check_guidance(name: str) -> None:
    """Raise InputError, which suggests a similar known name, if the given name is not in `GUIDANCE`.

    Example:
        >>> from surctl.marine.guidance import check_guidance
        >>> check_guidance("alos")
        >>> check_guidance("elos")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: guidance = 'elos': is not known; did you mean 'los'?
    """
    if name not in GUIDANCE:
        raise InputError("is not known", key="guidance", value=name, remedy=nearest(str(name), GUIDANCE))


def crosstrack_shift(method: Guidance, memory: ca.SX, *, lookahead: ca.SX, sigma: ca.SX) -> ca.SX:
    """Return the shift [m] added to the cross-track error: σ y_int for `ilos`, Δ b for `alos`, 0 for `los`.

    Args:
        method: guidance method, one of `GUIDANCE`.
        memory: state of the method: y_int [s] for `ilos`, b [1] for `alos`.
        lookahead: look-ahead distance Δ_h [m].
        sigma: integral gain σ of `ilos` [m/s].

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.guidance import crosstrack_shift
        >>> float(crosstrack_shift("ilos", ca.SX(2.0), lookahead=ca.SX(0.8), sigma=ca.SX(0.05)))  # m added to y_e
        0.1
    """
    return {"los": 0 * memory, "ilos": sigma * memory, "alos": lookahead * memory}[method]


def crosstrack_next(
    method: Guidance,
    memory: ca.SX,
    y_e: ca.SX,
    *,
    along: ca.SX,
    lookahead: ca.SX,
    sigma: ca.SX,
    gamma: ca.SX,
    held: ca.SX,
    dt: float,
) -> ca.SX:
    """Return the method's state (y_int or b) after one control period, limited to a slope of 45° (anti-windup).

    Args:
        method: guidance method, one of `GUIDANCE`.
        memory: state of the method: y_int [s] for `ilos`, b [1] for `alos`.
        y_e: cross-track error [m].
        along: commanded speed U_∥ along the path [m/s].
        lookahead: look-ahead distance Δ_h > 0 [m].
        sigma: integral gain σ of `ilos` [m/s].
        gamma: adaptation gain γ of `alos` [1/m²].
        held: 1 to leave the state unchanged, because the path error has another cause than a steady disturbance.
        dt: control period [s].

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.guidance import crosstrack_next
        >>> known = dict(along=0.15, lookahead=0.8, sigma=0.05, gamma=0.4, held=0)
        >>> known = {name: ca.SX(value) for name, value in known.items()}
        >>> memory = ca.SX(0)
        >>> for _ in range(100):  # 5 s beside the path
        ...     memory = crosstrack_next("ilos", memory, ca.SX(0.1), dt=0.05, **known)
        >>> round(float(memory), 3)
        0.612
    """
    shifted = y_e + crosstrack_shift(method, memory, lookahead=lookahead, sigma=sigma)
    rate = {
        "los": 0 * memory,
        "ilos": lookahead * y_e / (lookahead * lookahead + shifted * shifted),
        "alos": gamma * along * y_e,
    }[method]
    most = _STEEPEST if method == "alos" else _STEEPEST * lookahead / ca.fmax(sigma, _LEAST_GAIN)
    return ca.fmin(ca.fmax(memory + ca.if_else(held, 0, dt * rate), -most), most)


def numeric_crosstrack_next(
    method: Guidance,
    memory: float,
    y_e: float,
    *,
    along: float,
    lookahead: float,
    sigma: float,
    gamma: float,
    held: bool,
    dt: float,
) -> tuple[float, float]:
    """Return the method's next state, y_int [s] or b [1], and the present shift [m], in plain numbers."""
    shift = {"los": 0.0, "ilos": sigma * memory, "alos": lookahead * memory}[method]
    if method == "los":
        return 0.0, shift
    rate = gamma * along * y_e if method == "alos" else lookahead * y_e / (lookahead**2 + (y_e + shift) ** 2)
    most = _STEEPEST if method == "alos" else _STEEPEST * lookahead / max(sigma, _LEAST_GAIN)
    return min(max(memory + (0.0 if held else dt * rate), -most), most), shift
