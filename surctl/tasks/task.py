"""Task of equations (13)–(15): a quantity σ, its desired value, a gain; kinematics; shapes and names of limits."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeAlias, get_args

import casadi as ca

from surctl.errors import InputError, check_known


def wrap(angle: ca.SX) -> ca.SX:
    """Return each angle [rad] wrapped to (−π, π], without trigonometric functions; −π becomes π, and π stays π.

    After a wrap with the floor function, a rounding error can leave the angle just outside the interval (an angle just
    above 3π becomes just above π). So two corrections by one turn follow.

    Example:
        >>> import casadi as ca
        >>> from surctl.tasks import wrap
        >>> wrap(ca.SX(4.0))
        SX(-2.28319)
    """
    turn = 2.0 * math.pi
    once = angle + turn * ca.floor((math.pi - angle) / turn)
    return once - turn * (once > math.pi) + turn * (once <= -math.pi)


def planar_rotation(psi: ca.SX) -> ca.SX:
    """Return the 2×2 matrix R(ψ) that rotates horizontal vectors from {B} to {E}; ψ [rad] is counter-clockwise from x.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.vehicle import planar_rotation
        >>> ca.DM(planar_rotation(ca.SX(ca.pi / 2)) @ ca.DM([0.2, 0.0])).full().round(3).ravel().tolist()
        [0.0, 0.2]
    """
    c, s = ca.cos(psi), ca.sin(psi)
    return ca.vertcat(ca.horzcat(c, -s), ca.horzcat(s, c))


def jacobian(psi: ca.SX) -> ca.SX:
    """Return the matrix J(ψ) of equation (2), 4×4, that maps ν = (u, v, w, r) in {B} [m/s, rad/s] to η̇ in {E}.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.vehicle import jacobian
        >>> ca.DM(jacobian(ca.SX(ca.pi / 2)) @ ca.DM([0.2, 0.0, 0.0, 0.1])).full().round(3).ravel().tolist()
        [0.0, 0.2, 0.0, 0.1]
    """
    return ca.diagcat(planar_rotation(psi), ca.SX.eye(2))


Expression: TypeAlias = ca.SX | float | Sequence[float]
"""A CasADi expression, a number, or a list of numbers."""

Kinematics: TypeAlias = Expression | Literal["vehicle"] | None
"""The matrix S(η) (m, n) of η̇ = S(η) v, or "vehicle" for the pose of a vehicle. None: the identity, for m ≠ 4 only."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TaskBase:
    """A quantity σ of the configuration η, with what `Task` and `SetTask` have in common; see there.

    Raises:
        InputError: the name is not an identifier, σ and another attribute differ in length, a number is not finite, a
            gain is not positive, σ does not depend on η, or the unit is not a string. The message names the task.
    """

    name: str
    eta: ca.SX
    sigma: ca.SX
    rate: Expression = 0.0
    gain: Expression = 1.0
    angular: bool = False
    unit: str = ""
    kinematics: Kinematics = None

    def __post_init__(self) -> None:
        """Check the attributes and convert every number to a column with one entry for each entry of σ."""
        checked_name(self.name, "task")
        if not is_symbol(self.eta):
            raise self.wrong("eta", "is not an SX symbol of shape (m, 1)", 'write eta = ca.SX.sym("eta", 4)')
        object.__setattr__(self, "kinematics", self.mapping)
        set_columns(self, "task", "sigma")
        if not ca.depends_on(self.sigma, self.eta):
            raise self.wrong("sigma", "does not depend on eta", "express it by this task's own eta symbol")
        self.set_columns("rate")
        self.set_columns("gain", sign="positive")
        if not isinstance(self.unit, str):
            raise self.wrong("unit", "is not a text", 'write unit = "m"', self.unit)

    def set_columns(self, *fields: str, finite: bool = True, sign: Sign = "any") -> None:
        """Convert fields to columns with one entry for each entry of σ; a single number is used for all entries."""
        set_columns(self, "task", *fields, sizes=(1, self.size), finite=finite, sign=sign)
        for field in fields:
            column = getattr(self, field)
            object.__setattr__(self, field, ca.repmat(column, self.size // column.numel(), 1))

    def wrong(self, field: str, problem: str, remedy: str, value: object = None) -> InputError:
        """Return the error about a field of this task."""
        return InputError(problem, key=f"task {self.name}: {field}", value=value, remedy=remedy)

    @property
    def size(self) -> int:
        """Return k, the number of entries of σ."""
        return int(self.sigma.shape[0])

    @property
    def mapping(self) -> ca.SX:
        """Return S(η) (m, n) of η̇ = S(η) v."""
        return kinematics_of(f"task {self.name}", self.eta, self.kinematics)

    @property
    def rate_unit(self) -> str:
        """Return the unit of σ̇, such as "m/s"; "" if the unit of σ is unknown."""
        return f"{self.unit}/s" if self.unit else ""

    def row_names(self, what: str) -> tuple[str, ...]:
        """Return the names of the rows of J: NAME.WHAT for one row, otherwise NAME.WHAT0, NAME.WHAT1, …"""
        return (f"{self.name}.{what}",) if self.size == 1 else tuple(f"{self.name}.{what}{i}" for i in range(self.size))

    def jacobian(self) -> ca.SX:
        """Return the Jacobian J, (k, n), with σ̇ = J v (13); v is (u, v, w, r) in {B} for a pose."""
        return ca.densify(ca.jacobian(self.sigma, self.eta) @ self.mapping)


@dataclass(frozen=True, kw_only=True, eq=False)
class Task(TaskBase):
    """A quantity σ of the configuration η that converges to a desired value.

    Attributes:
        name: identifier of the task in every message and solution.
        eta: SX symbol (m, 1), configuration, for example the joint angles of an arm, or the pose of a vehicle: x, y, z
            [m] in the earth frame {E} (ENU), and heading ψ [rad], counter-clockwise.
        sigma: SX (k, 1), the expression of σ(η). If σ contains other symbols (an echo point, a waypoint), the Jacobian
            treats them as constant; describe the motion of a target by `rate`.
        target: desired value σ_d, (k, 1) or one number for all entries; default 0.
        rate: desired rate σ̇_d, (k, 1) or one number [unit of σ per second]; default 0.
        gain: convergence gain of each entry of σ, (k,) or one number [1/s], greater than 0; default 1.
        angular: σ is an angle [rad]; its error is wrapped to (−π, π].
        unit: unit of σ in messages, such as "m" or "rad"; "" if unknown.
        kinematics: SX (m, n), the matrix S(η) of η̇ = S(η) v for the n velocities v that the limits and the solution are
            about; "vehicle" for those of equations (1)–(2) if η is the pose of a vehicle. The default is the identity.
            For m = 4 there is no default, because η may be a pose or the angles of four joints.

    Raises:
        InputError: see `TaskBase`; the target counts as the other numbers.
    """

    target: Expression = 0.0

    def __post_init__(self) -> None:
        """Check the attributes and convert every number to a column with one entry for each entry of σ."""
        super().__post_init__()
        self.set_columns("target")

    def error(self) -> ca.SX:
        """Return the error σ̃ = σ_d − σ, (k, 1); for an angle, wrapped to (−π, π]."""
        difference = self.target - self.sigma
        return wrap(difference) if self.angular else difference

    def reference(self) -> ca.SX:
        """Return the reference rate σ̇_d + K (σ_d − σ), (k, 1) [unit of σ per second], equation (14) of the paper."""
        return ca.densify(self.rate + self.gain * self.error())


def is_symbol(eta: object) -> bool:
    """Return whether `eta` is a column of SX symbols."""
    return isinstance(eta, ca.SX) and eta.shape[1] == 1 and eta.shape[0] >= 1 and eta.is_valid_input()


def is_pose(eta: ca.SX, mapping: ca.SX) -> bool:
    """Return whether η is the pose (x, y, z, ψ) of a vehicle: four entries with the kinematics of equations (1)–(2)."""
    return bool(eta.shape[0] == 4 and ca.is_equal(ca.densify(mapping), ca.densify(jacobian(eta[3])), 9))


def kinematics_of(key: str, eta: ca.SX, matrix: Kinematics) -> ca.SX:
    """Return S(η) (m, n) of η̇ = S(η) v for the attribute `jacobian` of a task or barrier.

    Raise InputError with `key` if the matrix does not have m rows, or if m = 4 and there is no matrix.
    """
    m = int(eta.shape[0])
    pose = 'kinematics="vehicle" if eta is x, y, z and heading of a vehicle'
    if matrix is None and m == 4:
        remedy = f"give {pose}, or ca.SX.eye(4) if v is the derivative of eta"
        raise InputError("is missing, and eta has four entries", key=f"{key}: kinematics", remedy=remedy)
    if isinstance(matrix, str):
        if matrix != "vehicle" or m != 4:
            raise InputError("is not known", key=f"{key}: kinematics", value=matrix, remedy=f"give {pose}, or a matrix")
        return jacobian(eta[3])
    if matrix is None:
        return ca.SX.eye(m)
    try:
        S = as_expression(matrix)
    except ValueError:
        S = None
    if S is None or S.shape[0] != m or S.shape[1] < 1:
        raise InputError(
            "is not a matrix with a row per entry of eta", key=f"{key}: kinematics", remedy=f"give ({m}, n)"
        )
    return S


def as_expression(value: Any) -> ca.SX:
    """Return numbers or an expression as SX of the same shape; raise ValueError for any other type."""
    try:
        return ca.SX(value)
    except (NotImplementedError, RuntimeError, TypeError) as error:  # CasADi cannot convert the value
        raise ValueError("not numbers") from error


def as_column(value: Expression) -> ca.SX:
    """Return the value as a dense SX column; a row is transposed.

    Raise ValueError for a matrix and for a value that is neither numbers nor an expression.
    """
    column = ca.densify(as_expression(value))
    if column.shape[0] == 1:
        column = column.T
    if column.shape[1] != 1:
        raise ValueError("not a vector")
    return column


Sign: TypeAlias = Literal["any", "not negative", "positive"]


def checked_column(key: str, value: Expression, *sizes: int, finite: bool = False, sign: Sign = "any") -> ca.SX:
    """Return the value as a dense SX column whose length is in `sizes`, by default at least 1; a row is transposed.

    Raises:
        InputError: the shape is wrong, or a number is NaN, infinite although `finite` or a `sign` is required, or of
            another sign; the message names `key`.
    """
    try:
        column = as_column(value)
    except ValueError:
        column = ca.SX(0, 1)
    if column.numel() not in (sizes or (max(column.numel(), 1),)):
        expected = " or ".join(map(str, sorted(set(sizes)))) or "n"
        raise InputError("has the wrong shape", key=key, value=value, remedy=f"give {expected} entries")
    for number in [float(column[i]) for i in range(column.numel()) if column[i].is_constant()]:
        if math.isnan(number) or (math.isinf(number) and (finite or sign != "any")):
            remedy = "give finite numbers" if finite or sign != "any" else "give numbers, or inf for none"
            raise InputError("is not a number", key=key, value=value, remedy=remedy)
        if (number < 0.0 and sign != "any") or (number == 0.0 and sign == "positive"):
            least = "at least 0" if sign == "not negative" else "greater than 0"
            raise InputError(f"must be {least}", key=key, value=number)
    return column


def set_columns(
    owner: Any, what: str, *fields: str, sizes: tuple[int, ...] = (), finite: bool = False, sign: Sign = "any"
) -> int:
    """Convert fields of a frozen task or limit (`what`) to columns, and return their length; see `checked_column`."""
    n = 0
    for field in fields:
        key = f"{what} {owner.name}: {field}"
        column = checked_column(key, getattr(owner, field), *sizes, finite=finite, sign=sign)
        object.__setattr__(owner, field, column)
        n = int(column.numel())
    return n


# Limit rows, which are named linear constraints lower ≤ a·v ≤ upper and the common form of all velocity limits


Kind: TypeAlias = Literal["actuator", "barrier", "set"]
"""The kind of a limit decides whether it may be violated.

Actuator limits are always satisfied. Barrier limits are violated only if they contradict actuator limits, and then as
little as possible. Limits of set-based tasks are violated before barrier limits.
"""

AXES = ("u", "v", "w", "r")
"""Names of the velocities of a vehicle that moves in surge, sway, heave and yaw."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_0-9]+)*")


@dataclass(frozen=True, eq=False)
class LimitRow:
    """One linear constraint lower ≤ a·v ≤ upper on the velocity v.

    For a vehicle, v is (u, v, w, r) in the body frame {B} [m/s, rad/s].

    Attributes:
        name: name such as "velocity.u", which appears in the text that explains a solution.
        kind: kind of limit; see `Kind`.
        a: SX (1, n), the coefficients of the velocities.
        lower, upper: SX scalars; −inf or inf if there is no bound.
    """

    name: str
    kind: Kind
    a: ca.SX
    lower: ca.SX
    upper: ca.SX


class Limit(Protocol):
    """Protocol of a velocity limit: an object whose method `rows` returns linear constraints."""

    def rows(self) -> tuple[LimitRow, ...]:
        """Return the linear constraints of this limit, always in the same order."""
        ...


def checked_name(name: object, what: str = "limit") -> str:
    """Return the name unchanged; InputError if it is no identifier, or for a limit identifiers joined by dots."""
    joined = ", joined by dots" if what == "limit" else ", starting with a letter"
    if not isinstance(name, str) or not _NAME.fullmatch(name) or (what == "task" and "." in name):
        remedy = f"use letters, digits and _{joined}"
        raise InputError(f"is not a {what} name", key=f"{what}.name", value=name, remedy=remedy)
    return name


def checked_kind(name: str, kind: str) -> None:
    """Raise InputError if the kind of a limit is unknown; the message suggests a known kind with a similar name."""
    check_known(kind, get_args(Kind), "unknown kind of limit", key=f"limit {name}")


def axis_names(n: int, names: tuple[str, ...] = AXES) -> tuple[str, ...]:
    """Return the names of n axes: the given names if there are n of them, otherwise 0, 1, …"""
    return names if n == len(names) else tuple(map(str, range(n)))


def checked_order(name: str, lower: ca.SX, upper: ca.SX) -> None:
    """Raise InputError if two numeric bounds have lower > upper; symbolic bounds are checked at run time."""
    if not (lower.is_constant() and upper.is_constant()):
        return
    low, high = float(lower), float(upper)
    if low > high or low == math.inf or high == -math.inf:
        remedy = "give lower <= upper, or inf for none"
        raise InputError("allows no velocity", key=f"limit {name}", value=[low, high], remedy=remedy)
