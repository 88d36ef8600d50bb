"""The barrier of a vehicle that needs time and way to stop."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass

import casadi as ca

from surctl.guidance.avoidance import allowed_closing_speed
from surctl.tasks.barrier import closing_row
from surctl.tasks.rows import Kind, LimitRow, checked_column, checked_kind, checked_name, checked_positive
from surctl.tasks.task import Expression

__all__ = ["BrakingBarrier"]


@dataclass(frozen=True, eq=False)
class BrakingBarrier:
    """−ḣ ≤ v_max(h): approach no faster than at the speed from which the vehicle still stops at h = 0.

    v_max(h) = −aT + √((aT)² + 2ah) for h ≥ 0: the inverse of the way sT + s²/(2a) of reaction and braking. Below 0
    it goes on with its slope 1/T, down to −retreat: an intrusion asks for a retreat, never faster than that. v_max
    is continuous, and Lipschitz with constant 1/T; at h = 0 the slope is too.

    Kept exactly, in steps dt, by a vehicle that brings its closing speed s to the commanded one at a rate of at
    least a, if h is affine in the position, the heading constant, T ≥ 3 dt and at the start
    s²/(2a) + s (T − 2 dt) ≤ h for s > 0. That relation then holds at every step, with c = v_max(h) ≥ 0:
    c ≥ s: the way is at most c dt of h = cT + c²/(2a), which leaves c (T − dt) + c²/(2a) for a speed of at most c.
    c < s, not met in the step: braking at a leaves a dt (T − 2 dt) over. c < s, met: with e = s − c the relation
    gives c ≥ e (T − 2 dt)/(2 dt) ≥ e/2, and the way is at most c dt + e dt/2 ≤ 2 c dt of what is left over.
    Around a convex obstacle, motion along its surface only opens the distance. To T add the lag of thrust and
    velocity loop.

    Attributes:
        name: identifiers joined by dots; that of the row.
        eta: SX symbol (4, 1), pose (x, y, z [m] in {E}, ψ [rad]).
        h: SX scalar over eta and whatever else [m].
        deceleration: a > 0 [m/s²], along ∂h/∂η.
        reaction: T > 0 [s].
        retreat: largest speed asked for when h < 0, at least 0 [m/s]; None for aT.
        drift: ∂h/∂t [m/s], for an obstacle that moves; h then counts for as long as that motion goes on.
        kind: see `Kind`.

    Raises:
        InputError: bad name or shapes; numbers that are not positive; ∂h/∂η J(ψ) is structurally zero. Each names
            the barrier.
    """

    name: str
    eta: ca.SX
    _: KW_ONLY
    h: ca.SX
    deceleration: Expression
    reaction: Expression
    retreat: Expression | None = None
    drift: Expression = 0.0
    kind: Kind = "barrier"

    def __post_init__(self) -> None:
        """Check, and turn numbers into expressions."""
        checked_kind(checked_name(self.name), self.kind)
        object.__setattr__(self, "h", checked_column(self.name, "h", self.h, 1))
        object.__setattr__(self, "drift", checked_column(self.name, "drift", self.drift, 1, finite=True))
        closing_row(self.name, self.eta, self.h)
        for field in ("deceleration", "reaction"):
            object.__setattr__(self, field, checked_positive(self.name, field, getattr(self, field)))
        if self.retreat is not None:
            object.__setattr__(self, "retreat", checked_positive(self.name, "retreat", self.retreat, zero=True))

    def allowed(self) -> ca.SX:
        """v_max(h), the largest closing speed [m/s]; negative when h < 0."""
        a, reaction = ca.SX(self.deceleration), ca.SX(self.reaction)
        retreat = a * reaction if self.retreat is None else ca.SX(self.retreat)
        return ca.fmax(allowed_closing_speed(self.h, deceleration=a, reaction=reaction), -retreat)

    def rows(self) -> tuple[LimitRow, ...]:
        """One row, NAME, without a lower bound; a·v is the closing speed −ḣ [m/s]."""
        a = closing_row(self.name, self.eta, self.h)
        return (LimitRow(self.name, self.kind, a, ca.SX(-math.inf), self.allowed() + ca.SX(self.drift)),)
