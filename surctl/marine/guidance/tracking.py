"""Tracking law, equations (8)–(12) of the paper with E7 and E9 corrected; guidance `ilos` and `alos` in a current.

The law commands the course χ_d = γ_d − atan(y_e/Δ_h), in place of the heading (E7), and the horizontal speed U_h = (U_d
− k1 x_e) √(y_e² + Δ_h²)/Δ_h, at least 0 (E9). Here γ_d is the direction of the path, x_e the along-track error, y_e the
cross-track error, Δ_h the look-ahead distance, U_d the speed of the target point, and k1 a gain. So the velocity
command has the component U_d − k1 x_e along the path and the component −(U_d − k1 x_e) y_e/Δ_h across the path, and the
code needs no trigonometric function.

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

from surctl.errors import check_known

Guidance = Literal["los", "ilos", "alos"]
GUIDANCE: tuple[Guidance, ...] = get_args(Guidance)

_STEEPEST = 1.0  # largest slope of the course that a law may learn: 45°
_LEAST_GAIN = 1e-9  # m/s


def check_guidance(name: str) -> None:
    """Raise InputError, which suggests a similar known name, if the given name is not in `GUIDANCE`."""
    check_known(name, GUIDANCE, key="guidance")


def crosstrack_shift(method: Guidance, memory: ca.SX, *, lookahead: ca.SX, sigma: ca.SX) -> ca.SX:
    """Return the shift [m] added to the cross-track error: σ y_int for `ilos`, Δ b for `alos`, 0 for `los`.

    `memory` is y_int [s] for `ilos` and b [1] for `alos`; `lookahead` is Δ_h [m] and `sigma` the gain σ [m/s].
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
        method, memory, lookahead, sigma: as for `crosstrack_shift`.
        y_e: cross-track error [m].
        along: commanded speed U_∥ along the path [m/s].
        gamma: adaptation gain γ of `alos` [1/m²].
        held: 1 to leave the state unchanged, because the path error has another cause than a steady disturbance.
    """
    shifted = y_e + crosstrack_shift(method, memory, lookahead=lookahead, sigma=sigma)
    rate = {
        "los": 0 * memory,
        "ilos": lookahead * y_e / (lookahead * lookahead + shifted * shifted),
        "alos": gamma * along * y_e,
    }[method]
    most = _STEEPEST if method == "alos" else _STEEPEST * lookahead / ca.fmax(sigma, _LEAST_GAIN)
    return ca.fmin(ca.fmax(memory + ca.if_else(held, 0, dt * rate), -most), most)


def path_error(position: ca.SX, target: ca.SX, tangent: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the along-track error x_e and the cross-track error y_e [m]; y_e is positive left of the path.

    Equation (8) of the paper defines these errors.

    All vector arguments are (2, 1) in {E}.
    """
    offset = position - target
    x_e = ca.dot(offset, tangent)
    y_e = tangent[0] * offset[1] - tangent[1] * offset[0]
    return x_e, y_e


def along_command(
    x_e: ca.SX, y_e: ca.SX, *, speed: ca.SX, k1: ca.SX, lookahead: ca.SX, maximum: ca.SX | None, repaired: bool = True
) -> ca.SX:
    """Return the component U_h Δ_h/√(y_e² + Δ_h²) of the commanded horizontal speed U_h along the path [m/s].

    Args:
        x_e, y_e: along-track and cross-track error [m].
        speed: speed U_d of the target point along the path [m/s].
        k1, lookahead: along-track gain [1/s] and look-ahead distance Δ_h [m].
        maximum: largest horizontal speed U_h [m/s]; None: no limit, as in the paper.
        repaired: whether to limit U_h to at least 0; in the law as printed, a negative U_h reverses the sign of the y_e
            term (erratum E9).
    """
    along = speed - k1 * x_e
    if repaired:
        along = ca.fmax(along, 0)
    if maximum is not None:
        slant = ca.sqrt(y_e * y_e + lookahead * lookahead) / lookahead
        along = ca.fmin(along, maximum / slant)
        if not repaired:
            along = ca.fmax(along, -maximum / slant)
    return along


def tracking_velocity(along: ca.SX, y_e: ca.SX, tangent: ca.SX, lookahead: ca.SX) -> ca.SX:
    """Return the commanded horizontal velocity (2, 1) in {E} [m/s] for a given along-track command."""
    across = -along * y_e / lookahead
    return ca.vertcat(along * tangent[0] - across * tangent[1], along * tangent[1] + across * tangent[0])


def tracking_rate(error: ca.SX, along: ca.SX, *, speed: ca.SX, lookahead: ca.SX, k2: ca.SX, turn: ca.SX) -> ca.SX:
    """Return the time derivatives of x_e, y_e, z_e [m/s] if the robot follows its commanded velocity exactly.

    They are those of equation (9) of the paper, for the errors `error` (3, 1) [m], the commanded speed `along` [m/s],
    the speed U_d of the target point, the look-ahead distance Δ_h [m] and the depth gain k2 [1/s]. The turn rate γ̇_d
    of the path direction [rad/s] cancels in the derivative of the Lyapunov function V1.
    """
    x_e, y_e, z_e = error[0], error[1], error[2]
    return ca.vertcat(along - speed + y_e * turn, -along * y_e / lookahead - x_e * turn, -k2 * z_e)


def progress_rate(x_e: ca.SX, *, speed: ca.SX, wait: ca.SX) -> ca.SX:
    """Return the speed of the target point along the path [m/s].

    It is U_d, and decreases to 0 while the robot's distance behind the target grows from `wait`/2 to `wait` [m]: else a
    robot on a detour would fall far behind, and would then cut corners at full speed to catch up.
    """
    return speed * ca.fmin(ca.fmax(2 * (1 + x_e / wait), 0), 1)
