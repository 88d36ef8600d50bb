"""Integral (`ilos`) and adaptive (`alos`) line-of-sight guidance, which removes the path error of a steady disturbance.

LOS guidance commands the slope −y_e/Δ. If a steady disturbance causes a steady crosswise velocity error d, the
cross-track error y_e under law (10) converges to y_e = Δ d/U. Both laws add a learnt `shift` [m] to y_e, so that the
command still needs no trigonometric function:

`ilos` (Børhaug, Pavlov, Pettersen 2008) uses the shift σ y_int with y_int' = Δ y_e/(Δ² + (y_e + σ y_int)²).
`alos` (Fossen, Pettersen, Galeazzi 2015) uses the shift Δ b with b' = γ U Δ y_e/√(Δ² + (y_e + Δ b)²), where b is the
slope of the drift. With U = U_∥ √(Δ² + (y_e + Δ b)²)/Δ, where U_∥ is the speed along the path, the adaptation law
becomes b' = γ U_∥ y_e. Then the Lyapunov function V = y_e²/2 + (b − b*)²/(2 γ) of the kinematic loop y_e' = −U_∥ (y_e/Δ
+ b − b*) decreases at the rate U_∥ y_e²/Δ.
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
        >>> from surctl.guidance import check_guidance
        >>> check_guidance("alos")
        >>> check_guidance("elos")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: guidance = 'elos': is not known; did you mean 'los'?
    """
    if name not in GUIDANCE:
        raise InputError("is not known", key="guidance", value=name, remedy=nearest(str(name), GUIDANCE))


def crosstrack_shift(method: Guidance, memory: ca.SX, *, lookahead: ca.SX, sigma: ca.SX) -> ca.SX:
    """Return the shift [m] that the law adds to y_e: σ y_int for `ilos`, Δ b for `alos`, 0 for `los`.

    Args:
        method: guidance method, one of `GUIDANCE`.
        memory: state of the method: y_int [s] for `ilos`, b [1] for `alos`.
        lookahead: look-ahead distance Δ_h [m].
        sigma: integral gain σ of `ilos` [m/s].

    Example:
        >>> import casadi as ca
        >>> from surctl.guidance import crosstrack_shift
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
        held: 1 while the path error has another cause than a steady disturbance; the state then does not change.
        dt: control period [s].

    Example:
        >>> import casadi as ca
        >>> from surctl.guidance import crosstrack_next
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
    """Return the next state [s or 1] and the present shift [m], as `crosstrack_next` does, in plain numbers."""
    shift = {"los": 0.0, "ilos": sigma * memory, "alos": lookahead * memory}[method]
    if method == "los":
        return 0.0, shift
    rate = gamma * along * y_e if method == "alos" else lookahead * y_e / (lookahead**2 + (y_e + shift) ** 2)
    most = _STEEPEST if method == "alos" else _STEEPEST * lookahead / max(sigma, _LEAST_GAIN)
    return min(max(memory + (0.0 if held else dt * rate), -most), most), shift
