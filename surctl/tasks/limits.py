"""Limits on the commanded velocity: box, acceleration, thrust, barriers, braking; widened if they conflict."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.tasks.task import (
    Expression,
    Kind,
    Kinematics,
    LimitRow,
    as_expression,
    axis_names,
    checked_column,
    checked_kind,
    checked_name,
    checked_order,
    is_symbol,
    kinematics_of,
    set_columns,
)


@dataclass(frozen=True, eq=False)
class VelocityBox:
    """The limit lower ≤ v ≤ upper on each of the n velocities.

    The bounds (n,) are numbers or SX expressions. For n = 4, they are the bounds of the velocities u, v, w [m/s] and r
    [rad/s] in the body frame.

    Raises:
        InputError: the bounds have different numbers of entries, a number is NaN, or lower > upper on an axis. The
            message names the axis.
    """

    lower: Expression
    upper: Expression
    name: str = "velocity"
    kind: Kind = "actuator"

    def __post_init__(self) -> None:
        """Check the limit's name and kind, the shapes of the bounds, and lower ≤ upper."""
        checked_kind(checked_name(self.name), self.kind)
        n = set_columns(self, "limit", "lower")
        set_columns(self, "limit", "upper", sizes=(n,))
        for i, axis in enumerate(axis_names(n)):
            checked_order(f"{self.name}.{axis}", ca.SX(self.lower)[i], ca.SX(self.upper)[i])

    def rows(self) -> tuple[LimitRow, ...]:
        """Return one limit row per velocity: NAME.u, NAME.v, NAME.w, NAME.r for n = 4, otherwise NAME.0, NAME.1, …"""
        n = int(ca.SX(self.lower).numel())
        eye = ca.SX.eye(n)
        return tuple(
            LimitRow(
                f"{self.name}.{axis}", self.kind, ca.densify(eye[i, :]), ca.SX(self.lower)[i], ca.SX(self.upper)[i]
            )
            for i, axis in enumerate(axis_names(n))
        )


@dataclass(frozen=True, eq=False)
class HalfPlane:
    """The limit normal · v ≤ bound on the velocity v; normal (n,) and bound are numbers or SX.

    For example, a control barrier ḣ + α(h) ≥ 0 with ḣ = ∇h·v is the half-plane −∇h·v ≤ α(h).

    Raises:
        InputError: a shape is wrong or a number is NaN; the message names the limit.
    """

    name: str
    normal: Expression
    bound: Expression
    kind: Kind = "barrier"

    def __post_init__(self) -> None:
        """Check the limit's name and kind, and the shapes of normal and bound."""
        checked_kind(checked_name(self.name), self.kind)
        set_columns(self, "limit", "normal")
        set_columns(self, "limit", "bound", sizes=(1,))
        checked_order(self.name, ca.SX(-math.inf), ca.SX(self.bound))

    def rows(self) -> tuple[LimitRow, ...]:
        """Return the limit as one constraint row without a lower bound."""
        return (LimitRow(self.name, self.kind, ca.SX(self.normal).T, ca.SX(-math.inf), ca.SX(self.bound)),)


# Barriers: limits that keep the robot in the set h(η) ≥ 0


Alpha: TypeAlias = Expression | Callable[[ca.SX], ca.SX]
"""A gain [1/s], or a function of h that gives the rate at which h may fall [unit of h per second]."""

_SAMPLES = np.concatenate([-np.logspace(1, -6, 57), [0.0], np.logspace(-6, 1, 57)])


@dataclass(frozen=True, eq=False)
class Barrier:
    """The control barrier ḣ + α(h) ≥ 0 for a vehicle that reaches its commanded velocity v at once (Ames et al. 2019).

    The function h(η) of the pose η is positive in the allowed set and negative outside. With the rotation matrix J(ψ)
    from the body frame to the earth frame, the barrier is the limit −(∂h/∂η) J(ψ) v ≤ α(h) + ∂h/∂t on v. A robot in the
    set h ≥ 0 stays there; a robot outside moves towards the set.

    Assume that v is constant during each control period dt, that α(h) = γh with γ dt ≤ 1, and that h is convex, like
    the distance from a flat wall or a convex obstacle. If the heading is constant, h ≥ 0 then holds exactly. If the
    robot turns with yaw rate r, and ‖∂h/∂(x, y)‖ ≤ 1, then h ≥ −|r| ‖v‖ dt / (2γ). For a vehicle that needs
    time to slow down, take `allowed_closing_speed` as alpha.

    Attributes:
        name: name of the barrier and of its constraint row, such as "wall.left" (identifiers joined by dots).
        eta, kinematics: configuration (m, 1), and S(η) of η̇ = S(η) v, as in `Task`.
        h: SX scalar expression of eta. If h contains other symbols, the derivative of h treats them as constant.
        alpha: a number γ > 0 [1/s] for α(h) = γh, or a function α of an SX scalar (Python function or ca.Function). The
            class checks at sample points in [−10, 10] that α(0) = 0, that α(s) has the sign of s, and that α never
            decreases (class K, but constant parts are allowed). An α that contains other symbols is not checked.
        drift: ∂h/∂t [unit of h per second], for an obstacle or wall that moves.
        kind: kind of limit; see `Kind`.

    Raises:
        InputError: a name or shape is wrong; ∂h/∂η J(ψ) is structurally zero, so no velocity changes h; or α violates a
            condition on `alpha`. The message names the barrier.
    """

    name: str
    eta: ca.SX
    _: KW_ONLY
    h: ca.SX
    alpha: Alpha = 1.0
    drift: Expression = 0.0
    kind: Kind = "barrier"
    kinematics: Kinematics = None

    def __post_init__(self) -> None:
        """Check the barrier's attributes and convert numbers to expressions."""
        checked_kind(checked_name(self.name), self.kind)
        set_columns(self, "limit", "h", "drift", sizes=(1,), finite=True)
        _closing_row(self.name, self.eta, self.h, self.kinematics)
        if callable(self.alpha):
            _check_class_k(self.name, self.alpha)
        else:
            set_columns(self, "limit", "alpha", sizes=(1,), sign="positive")

    def rows(self) -> tuple[LimitRow, ...]:
        """Return one limit row a·v ≤ upper, named NAME, where a·v is the closing speed −ḣ [unit of h per s]."""
        allowed = self.alpha(self.h) if callable(self.alpha) else ca.SX(self.alpha) * self.h
        a = _closing_row(self.name, self.eta, self.h, self.kinematics)
        return (LimitRow(self.name, self.kind, a, ca.SX(-math.inf), allowed + ca.SX(self.drift)),)


def _closing_row(name: str, eta: ca.SX, h: ca.SX, kinematics: Kinematics = None) -> ca.SX:
    """Return −(∂h/∂η) S(η), (1, n), which maps the velocity to −ḣ; raise InputError if no velocity changes h."""
    if not is_symbol(eta):
        raise InputError(
            "is not an SX symbol of shape (m, 1)", key=f"limit {name}: eta", remedy='write eta = ca.SX.sym("eta", 4)'
        )
    row = ca.simplify(-(ca.jacobian(h, eta) @ kinematics_of(f"limit {name}", eta, kinematics)))
    if ca.sparsify(row).nnz() == 0:
        problem = "does not depend on eta, so no velocity changes it"
        remedy = "express it by this barrier's own eta symbol; for a bound on velocity use a HalfPlane"
        raise InputError(problem, key=f"limit {name}: h", value=h, remedy=remedy)
    return ca.densify(row)


def _check_class_k(name: str, alpha: Callable[[ca.SX], ca.SX]) -> None:
    """Raise InputError if α(0) ≠ 0, α(s) s ≤ 0 for an s ≠ 0, or α decreases, at the sample points."""
    s = ca.SX.sym("s")
    image = checked_column(f"limit {name}: alpha", alpha(s), 1)
    if ca.symvar(image) and not (len(ca.symvar(image)) == 1 and ca.depends_on(image, s)):
        return
    values = np.array(ca.Function("alpha", [s], [image]).map(_SAMPLES.size)(_SAMPLES)).reshape(-1)
    for value, at in zip(values, _SAMPLES, strict=True):
        if not math.isfinite(value) or (abs(value) > 1e-12 if at == 0.0 else value * at <= 0.0):
            problem = f"is not of class K: alpha({at:.3g}) = {value:.3g}"
            remedy = "it must be 0 at 0 and have the sign of its argument elsewhere"
            raise InputError(problem, key=f"limit {name}: alpha", remedy=remedy)
    for k in np.flatnonzero(np.diff(values) < 0.0):
        problem = f"decreases between {_SAMPLES[k]:.3g} and {_SAMPLES[k + 1]:.3g}"
        raise InputError(problem, key=f"limit {name}: alpha", remedy="give a function that never decreases")


def allowed_closing_speed(distance: ca.SX, *, deceleration: ca.SX | float, reaction: ca.SX | float) -> ca.SX:
    """Return the largest closing speed [m/s] from which the robot can still stop within a distance d [m].

    At a closing speed s, the braking distance is s²/(2a) + s T. For d ≥ 0, the function returns the s whose braking
    distance is d: −a T + √((a T)² + 2 a d). For d < 0, the robot is inside the stand-off distance, and the function
    returns the negative speed d/T, so the robot must retreat.

    As `alpha` of a `Barrier`, the function keeps d = h ≥ 0 exactly under five assumptions: the vehicle changes its
    closing speed s to the commanded closing speed at a rate of at least a; h is affine in the position; the heading is
    constant; T ≥ 3 dt with the control period dt; and the initial closing speed, if positive, satisfies
    s²/(2a) + s (T − 2 dt) ≤ h. The last inequality then holds at every step. A convex obstacle in place of an affine h
    is safe too, because motion along its surface increases the distance.

    Args:
        distance: d, clearance minus stand-off distance [m], of any sign.
        deceleration: a > 0 [m/s²], with the thrust available for braking and the largest mass.
        reaction: reaction time T > 0 [s], the sum of thrust lag, control period and delay of the velocity loop.

    Example:
        >>> from functools import partial
        >>> import casadi as ca
        >>> from surctl.tasks import Barrier, allowed_closing_speed
        >>> stopping = partial(allowed_closing_speed, deceleration=0.05, reaction=0.8)
        >>> round(float(stopping(ca.SX(0.5))), 3)  # m/s, half a metre off
        0.187
        >>> eta = ca.SX.sym("eta", 4)
        >>> Barrier("wall", eta, h=2.0 - eta[0], alpha=stopping, kinematics="vehicle").rows()[0].name
        'wall'
    """
    # Proof that s²/(2a) + s (T − 2 dt) ≤ h holds at every step, where c ≥ 0 is the returned speed. If c ≥ s, it covers
    # at most c dt of h = cT + c²/(2a); this leaves c (T − dt) + c²/(2a) for a speed ≤ c. If c < s and the step ends
    # at a speed above c, braking at the rate a leaves a reserve of a dt (T − 2 dt). If c < s and the step ends at
    # c, let e = s − c. The inequality gives c ≥ e (T − 2 dt)/(2 dt) ≥ e/2, and the vehicle covers at most
    # c dt + e dt/2 ≤ 2 c dt, which is available.
    at = deceleration * reaction
    inside = ca.sqrt(at * at + 2 * deceleration * ca.fmax(distance, 0)) - at
    return ca.if_else(distance >= 0, inside, distance / reaction)


# Limits of acceleration and thrust


@dataclass(frozen=True, eq=False)
class AccelerationLimit:
    """The limit |v − ν| ≤ a·dt between commanded velocity v and present velocity ν, on each of n axes.

    Attributes:
        nu: present velocity ν (n,); for n = 4 [m/s, m/s, m/s, rad/s].
        limit: largest acceleration a (n,), at least 0; for n = 4 [m/s², m/s², m/s², rad/s²].
        dt: time in which the vehicle is to reach v, greater than 0 [s].

    Raises:
        InputError: `nu` and `limit` differ in length, a number is negative or not finite, or dt is not greater
            than 0.
    """

    nu: Expression
    limit: Expression
    _: KW_ONLY
    dt: Expression
    name: str = "acceleration"
    kind: Kind = "actuator"

    def __post_init__(self) -> None:
        """Check the limit's name and kind, and the shapes of the values."""
        checked_kind(checked_name(self.name), self.kind)
        n = set_columns(self, "limit", "nu", finite=True)
        set_columns(self, "limit", "limit", sizes=(n,), sign="not negative")
        set_columns(self, "limit", "dt", sizes=(1,), sign="positive")

    def box(self) -> VelocityBox:
        """Return the acceleration limit as a box of velocities with bounds (n,)."""
        nu, change = ca.SX(self.nu), ca.SX(self.limit) * ca.SX(self.dt)
        return VelocityBox(nu - change, nu + change, self.name, self.kind)

    def rows(self) -> tuple[LimitRow, ...]:
        """Return one limit row per velocity, named as by `VelocityBox.rows`."""
        return self.box().rows()


_FORCES = ("Fu", "Fv", "Fw", "Fr")


@dataclass(frozen=True, eq=False)
class ThrustLimit:
    """The limit lower ≤ M (v − ν)/dt + load ≤ upper on the thrust that changes the velocity from ν to v within dt.

    The thrust follows from the dynamic model, equation (3) of the paper. The load is evaluated at ν, so a vehicle with
    its thrust at a bound reaches the velocity v with an error of O(dt²). The thrust is the force that acts in the
    water; if this force lags behind its command, give bounds on its average over the time dt.

    Attributes:
        nu: present velocity ν (n,); for a vehicle (n = 4) over ground in the body frame {B} [m/s, rad/s].
        mass: mass matrix M, its diagonal (n,) or symmetric positive definite (n, n) [kg, kg m²].
        load: (n,) thrust that holds ν: Coriolis force C(ν)ν plus drag D(ν)ν minus other forces [N, N m].
        lower, upper: (n,) bounds of the thrust [N, N m].
        dt: time in which the vehicle is to reach v [s].

    Raises:
        InputError: a shape is wrong, a number is not finite, a mass is not positive, lower > upper, or dt is not
            greater than 0. The message names the field or the limit row.
    """

    nu: Expression
    mass: Expression
    _: KW_ONLY
    load: Expression
    lower: Expression
    upper: Expression
    dt: Expression
    name: str = "thrust"
    kind: Kind = "actuator"

    def __post_init__(self) -> None:
        """Check the limit's name and kind, the shapes of the values, and lower ≤ upper."""
        checked_kind(checked_name(self.name), self.kind)
        n = set_columns(self, "limit", "nu", finite=True)
        set_columns(self, "limit", "load", sizes=(n,), finite=True)
        set_columns(self, "limit", "lower", "upper", sizes=(n,))
        object.__setattr__(self, "mass", _mass_matrix(self.name, self.mass, n))
        set_columns(self, "limit", "dt", sizes=(1,), sign="positive")
        for i, force in enumerate(axis_names(n, _FORCES)):
            checked_order(f"{self.name}.{force}", ca.SX(self.lower)[i], ca.SX(self.upper)[i])

    def needed(self, v: ca.SX) -> ca.SX:
        """Return the thrust (n,) [N, N m] that changes the velocity from ν to v (n,) [m/s, rad/s] within dt."""
        return ca.SX(self.mass) @ (v - ca.SX(self.nu)) / ca.SX(self.dt) + ca.SX(self.load)

    def rows(self) -> tuple[LimitRow, ...]:
        """Return one limit row per force [N, N m]: NAME.Fu, NAME.Fv, NAME.Fw, NAME.Fr for n = 4, else NAME.0, …"""
        slope = ca.densify(ca.SX(self.mass) / ca.SX(self.dt))
        offset = ca.SX(self.load) - slope @ ca.SX(self.nu)
        lower, upper = ca.SX(self.lower) - offset, ca.SX(self.upper) - offset
        return tuple(
            LimitRow(f"{self.name}.{force}", self.kind, slope[i, :], lower[i], upper[i])
            for i, force in enumerate(axis_names(lower.numel(), _FORCES))
        )


def _mass_matrix(name: str, mass: Expression, n: int) -> ca.SX:
    # sparse if only the diagonal is given
    try:
        matrix = as_expression(mass)
    except ValueError:
        raise InputError(
            "is not numeric", key=f"limit {name}: mass", value=mass, remedy=f"give {n} numbers, or a ({n}, {n}) matrix"
        ) from None
    if matrix.shape != (n, n) or n == 1:
        return ca.diag(checked_column(f"limit {name}: mass", matrix, n, sign="positive"))
    if matrix.is_constant() and not _positive_definite(np.array(ca.DM(matrix))):
        raise InputError("is not symmetric positive definite", key=f"limit {name}: mass", value=matrix)
    return matrix


def _positive_definite(matrix: NDArray[np.float64]) -> bool:
    symmetric = np.isfinite(matrix).all() and np.array_equal(matrix, matrix.T)
    return bool(symmetric and np.linalg.eigvalsh(matrix)[0] > 0.0)
