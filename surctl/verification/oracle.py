"""Functions that the falsifier evaluates: margin, constraints and exact gradients of a claim on the unit box."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import on_columns, on_vectors
from surctl.verification.claim import Claim
from surctl.verification.formula import Statement, values_of

__all__ = ["Oracle", "build_oracle"]

_STEP = 1e-6  # step of the finite differences, as a share of the box; used where the exact gradient is not finite
_FEASIBLE = 1e-9  # tolerance of bounds and constraints in their own unit; in floating point 0.15 / 3 < 0.05


@dataclass(frozen=True, eq=False)
class Oracle:
    """The compiled functions of a claim.

    A point is a column of coordinates in the unit box; `place` converts the coordinates to the variables' units.

    Attributes:
        claim: the claim.
        sides: function of N points x (n, N); returns left (1, N), right (1, N), and constraints (m, N).
        slopes: function of one point x (n,); returns the gradient of the margin (n,), and the Jacobian of the
            constraints (m, n), column by column.
    """

    claim: Claim
    sides: Callable[[NDArray[np.float64]], list[NDArray[np.float64]]]
    slopes: Callable[..., list[NDArray[np.float64]]]

    def place(self, unit: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert points (n,) or (n, N) of the unit box to the claim's box, in the variables' units."""
        lower, width = self.claim.lower, self.claim.upper - self.claim.lower
        clipped = np.clip(unit, 0, 1)
        return lower + width * clipped if unit.ndim == 1 else lower[:, None] + width[:, None] * clipped

    def evaluate(self, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Evaluate points x (n, N) given in the variables' units.

        Returns:
            Three arrays (N,): the margin; the larger of |left| and |right|; whether the point lies in the domain.
        """
        left, right, g = self.sides(x)
        left, right = left[0], right[0]
        inside = self._inside(x, g)
        if self.claim.exact is not None:  # `surctl.verification.doubtful` searches for points without a value
            inside &= np.isfinite(left - right)
        return left - right, np.maximum(abs(left), abs(right)), inside

    def inside(self, x: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether points x (n, N) lie in the domain, up to rounding (N,)."""
        return self._inside(x, self.sides(x)[2])

    def _inside(self, x: NDArray[np.float64], g: NDArray[np.float64]) -> NDArray[np.bool_]:
        beyond = np.maximum(self.claim.lower[:, None] - x, x - self.claim.upper[:, None])
        in_box = np.all(beyond <= _FEASIBLE, axis=0)
        within: NDArray[np.bool_] = in_box & np.all(g <= _FEASIBLE, axis=0)
        return within

    def margin(self, unit: NDArray[np.float64]) -> float:
        """Return the margin at a point (n,) of the unit box; −inf if not finite, so that searches avoid the point."""
        left, right, _ = self.sides(self.place(unit)[:, None])
        value = float(left[0, 0]) - float(right[0, 0])
        return value if np.isfinite(value) else -np.inf

    def gradient(self, unit: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the exact gradient ∂margin/∂unit (n,).

        Where the exact gradient is not finite (at an arccos of ±1), finite differences replace the exact gradient.
        """
        with np.errstate(over="ignore"):
            exact = self.slopes(self.place(unit))[0] * (self.claim.upper - self.claim.lower)
        return exact if np.all(np.isfinite(exact)) else self._differences(unit)

    def slack(self, unit: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the slack −g (m,) of the constraints; in the domain every slack is ≥ 0."""
        return -self.sides(self.place(unit)[:, None])[2][:, 0]

    def slack_jacobian(self, unit: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the Jacobian ∂slack/∂unit (m, n) of the slacks with respect to the point in the unit box."""
        return -self.jacobian(self.place(unit)) * (self.claim.upper - self.claim.lower)

    def jacobian(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the Jacobian ∂g/∂x (m, n) of the constraints at a point x (n,), in the variables' units."""
        return self.slopes(x)[1].reshape(-1, x.size, order="F")

    def _differences(self, unit: NDArray[np.float64]) -> NDArray[np.float64]:
        slope = np.zeros(unit.size)
        for i in range(unit.size):
            ahead, behind = unit.copy(), unit.copy()
            ahead[i], behind[i] = min(unit[i] + _STEP, 1), max(unit[i] - _STEP, 0)
            with np.errstate(over="ignore", invalid="ignore"):
                slope[i] = np.float64(self.margin(ahead) - self.margin(behind)) / (ahead[i] - behind[i])
        return np.where(np.isfinite(slope), slope, 0.0)


def build_oracle(claim: Claim) -> Oracle:
    """Compile both sides of a claim and their derivatives."""
    x = claim.symbols
    slopes = [ca.gradient(claim.margin, x), ca.jacobian(claim.constraints, x)]
    # densified, because a constant 0 is structurally empty in CasADi
    sides = [ca.densify(ca.SX(claim.left)), ca.densify(ca.SX(claim.right)), ca.densify(claim.constraints)]
    return Oracle(
        claim,
        on_columns(ca.Function("sides", [x], sides)) if claim.exact is None else partial(_sides, claim.exact),
        on_vectors(ca.Function("slopes", [x], [ca.densify(s) for s in slopes])),
    )


def _sides(exact: Statement, x: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    rows = values_of(exact.parts, dict(zip(exact.names, x, strict=True)))
    return [rows[:1], rows[1:2], rows[2:]]
