"""Barriers: the robot stays where h(η) ≥ 0."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np

from surctl.errors import InputError
from surctl.tasks.rows import Kind, LimitRow, checked_column, checked_kind, checked_name, checked_positive
from surctl.tasks.task import Expression
from surctl.vehicle.kinematics import jacobian as kinematics

__all__ = ["Alpha", "Barrier", "closing_row"]

Alpha: TypeAlias = Expression | Callable[[ca.SX], ca.SX]
"""A gain [1/s], or a function of h that gives the rate at which h may fall [unit of h per second]."""

_SAMPLES = np.concatenate([-np.logspace(1, -6, 57), [0.0], np.logspace(-6, 1, 57)])


@dataclass(frozen=True, eq=False)
class Barrier:
    """ḣ + α(h) ≥ 0 for a velocity that is reached at once: −(∂h/∂η) J(ψ) v ≤ α(h) + ∂h/∂t (Ames et al. 2019).

    {h ≥ 0} is kept, and approached from outside. With v held over steps dt and α(h) = γh, γ dt ≤ 1, that is exact
    for a convex h (the distance from a flat wall or a convex obstacle) at a constant heading; a yaw rate r turns v
    during the step and leaves h ≥ −|r| ‖v‖ dt / (2γ) for ‖∂h/∂(x, y)‖ ≤ 1. For a vehicle that needs time to slow
    down, take `BrakingBarrier`.

    Attributes:
        name: identifiers joined by dots; that of the row.
        eta: SX symbol (4, 1), pose (x, y, z [m] in {E}, ψ [rad]).
        h: SX scalar over eta and whatever else; those other symbols are held fixed when it is differentiated.
        alpha: γ > 0 [1/s], or a function SX → SX, also a ca.Function. It is checked by samples in [−10, 10]:
            α(0) = 0, the sign of its argument elsewhere, nowhere falling (class K, but it may level off). One with
            other symbols inside is taken on trust.
        drift: ∂h/∂t [unit of h per second], for a constraint that moves of its own.
        kind: see `Kind`.

    Raises:
        InputError: bad name or shapes; ∂h/∂η J(ψ) is structurally zero, so that no velocity moves h; α is not
            such a function. Each names the barrier.
    """

    name: str
    eta: ca.SX
    _: KW_ONLY
    h: ca.SX
    alpha: Alpha = 1.0
    drift: Expression = 0.0
    kind: Kind = "barrier"

    def __post_init__(self) -> None:
        """Check, and turn numbers into expressions."""
        checked_kind(checked_name(self.name), self.kind)
        object.__setattr__(self, "h", checked_column(self.name, "h", self.h, 1))
        object.__setattr__(self, "drift", checked_column(self.name, "drift", self.drift, 1, finite=True))
        closing_row(self.name, self.eta, self.h)
        if callable(self.alpha):
            _check_class_k(self.name, self.alpha)
        else:
            object.__setattr__(self, "alpha", checked_positive(self.name, "alpha", self.alpha))

    def rows(self) -> tuple[LimitRow, ...]:
        """One row, NAME, without a lower bound; a·v is the closing speed −ḣ [unit of h per second]."""
        allowed = self.alpha(self.h) if callable(self.alpha) else ca.SX(self.alpha) * self.h
        a = closing_row(self.name, self.eta, self.h)
        return (LimitRow(self.name, self.kind, a, ca.SX(-math.inf), allowed + ca.SX(self.drift)),)


def closing_row(name: str, eta: ca.SX, h: ca.SX) -> ca.SX:
    """−(∂h/∂η) J(ψ), (1, 4): −ḣ per velocity in {B}; InputError, naming the barrier, when it vanishes everywhere."""
    if not isinstance(eta, ca.SX) or eta.shape != (4, 1) or not eta.is_valid_input():
        raise InputError(
            "is not an SX symbol of shape (4, 1)", key=f"limit {name}: eta", remedy='write eta = ca.SX.sym("eta", 4)'
        )
    row = ca.simplify(-(ca.jacobian(h, eta) @ kinematics(eta[3])))
    if ca.sparsify(row).nnz() == 0:
        raise InputError(
            "does not change with eta, so no velocity keeps it",
            key=f"limit {name}: h",
            value=h,
            remedy="express it through this barrier's own eta symbol; for a bound on velocity use a HalfPlane",
        )
    return ca.densify(row)


def _check_class_k(name: str, alpha: Callable[[ca.SX], ca.SX]) -> None:
    """InputError unless α(0) = 0, α(s) s > 0 and α never falls, at the samples."""
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
            f"falls between {_SAMPLES[k]:.3g} and {_SAMPLES[k + 1]:.3g}",
            key=f"limit {name}: alpha",
            remedy="take one that never falls",
        )
