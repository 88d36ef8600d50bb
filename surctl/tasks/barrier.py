"""Barriers: limits that keep the robot in the set h(η) ≥ 0."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np

from surctl.errors import InputError
from surctl.tasks.rows import Kind, LimitRow, checked_column, checked_kind, checked_name, checked_positive
from surctl.tasks.task import Expression, Kinematics, is_symbol, kinematics_of

__all__ = ["Alpha", "Barrier", "closing_row"]

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
    robot turns with yaw rate r, and ‖∂h/∂(x, y)‖ ≤ 1, then h ≥ −|r| ‖v‖ dt / (2γ). Use `BrakingBarrier` for a vehicle
    that needs time to slow down.

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
        object.__setattr__(self, "h", checked_column(self.name, "h", self.h, 1))
        object.__setattr__(self, "drift", checked_column(self.name, "drift", self.drift, 1, finite=True))
        closing_row(self.name, self.eta, self.h, self.kinematics)
        if callable(self.alpha):
            _check_class_k(self.name, self.alpha)
        else:
            object.__setattr__(self, "alpha", checked_positive(self.name, "alpha", self.alpha))

    def rows(self) -> tuple[LimitRow, ...]:
        """Return one limit row a·v ≤ upper, named NAME, where a·v is the closing speed −ḣ [unit of h per s]."""
        allowed = self.alpha(self.h) if callable(self.alpha) else ca.SX(self.alpha) * self.h
        a = closing_row(self.name, self.eta, self.h, self.kinematics)
        return (LimitRow(self.name, self.kind, a, ca.SX(-math.inf), allowed + ca.SX(self.drift)),)


def closing_row(name: str, eta: ca.SX, h: ca.SX, kinematics: Kinematics = None) -> ca.SX:
    """Return −(∂h/∂η) S(η), (1, n), which maps the velocity to −ḣ; raise InputError if no velocity changes h."""
    if not is_symbol(eta):
        raise InputError(
            "is not an SX symbol of shape (m, 1)", key=f"limit {name}: eta", remedy='write eta = ca.SX.sym("eta", 4)'
        )
    row = ca.simplify(-(ca.jacobian(h, eta) @ kinematics_of(f"limit {name}", eta, kinematics)))
    if ca.sparsify(row).nnz() == 0:
        raise InputError(
            "does not depend on eta, so no velocity changes it",
            key=f"limit {name}: h",
            value=h,
            remedy="express it by this barrier's own eta symbol; for a bound on velocity use a HalfPlane",
        )
    return ca.densify(row)


def _check_class_k(name: str, alpha: Callable[[ca.SX], ca.SX]) -> None:
    """Raise InputError if α(0) ≠ 0, α(s) s ≤ 0 for an s ≠ 0, or α decreases, at the sample points."""
    s = ca.SX.sym("s")
    image = checked_column(name, "alpha", alpha(s), 1)
    if ca.symvar(image) and not (len(ca.symvar(image)) == 1 and ca.depends_on(image, s)):
        return
    values = np.array(ca.Function("alpha", [s], [image]).map(_SAMPLES.size)(_SAMPLES)).reshape(-1)
    for value, at in zip(values, _SAMPLES, strict=True):
        if not math.isfinite(value) or (abs(value) > 1e-12 if at == 0.0 else value * at <= 0.0):
            raise InputError(
                f"is not of class K: alpha({at:.3g}) = {value:.3g}",
                key=f"limit {name}: alpha",
                remedy="it must be 0 at 0 and have the sign of its argument elsewhere",
            )
    for k in np.flatnonzero(np.diff(values) < 0.0):
        raise InputError(
            f"decreases between {_SAMPLES[k]:.3g} and {_SAMPLES[k + 1]:.3g}",
            key=f"limit {name}: alpha",
            remedy="give a function that never decreases",
        )
