"""Counterexamples (points where a claim fails) and their replay, by a second evaluation and by a simulation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, SolverError
from surctl.ir import on_vectors
from surctl.ir.symbolic import on_columns
from surctl.verification.claim import Claim, Motion
from surctl.verification.formula import Statement, values_of

# Functions that the falsifier evaluates: margin, constraints and exact gradients of a claim on the unit box


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
        with np.errstate(invalid="ignore"):
            margin = left - right
        if self.claim.exact is not None:  # `surctl.verification.doubtful` searches for points without a value
            inside &= np.isfinite(margin)
        return margin, np.maximum(abs(left), abs(right)), inside

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


Origin = Literal["search", "witness"]


@dataclass(frozen=True)
class Counterexample:
    """A point of a claim's domain, with the margin left − right at this point.

    Attributes:
        values: value of each variable, in its unit.
        margin: left − right at the point; the claim fails if it is positive, or NaN: the claim has no value there.
        unit: unit of the margin.
        origin: `search` if the falsifier found the point, `witness` if the claim supplied it.
        undefined: the operation of the claim without a value at the point, as text; empty if it has one.
    """

    values: Mapping[str, float]
    margin: float
    unit: str
    origin: Origin = "search"
    undefined: str = ""

    @property
    def sentence(self) -> str:
        """What fails at the point, such as "bound exceeded by 0.2 m" or "1/x is not defined there"."""
        if self.undefined:
            return f"{self.undefined} is not defined there"
        return f"bound exceeded by {self.margin:.3g} {self.unit}"

    def to_dict(self) -> dict[str, Any]:
        """The counterexample as plain data for JSON."""
        return {
            "values": dict(self.values), "margin": None if self.undefined else self.margin, "unit": self.unit,
            "origin": self.origin, **({"undefined": self.undefined} if self.undefined else {}),
        }  # fmt: skip

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Counterexample:
        """Restore a counterexample from the result of `to_dict`; InputError if a field is missing or not a number."""
        try:
            values = {str(k): float(v) for k, v in table["values"].items()}
            origin: Origin = "witness" if table.get("origin") == "witness" else "search"
            undefined = str(table.get("undefined", ""))
            margin = math.nan if undefined else float(table["margin"])
            return cls(values, margin, str(table["unit"]), origin, undefined)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            remedy = "give values, margin and unit"
            raise InputError("is not a counterexample", key="counterexample", value=str(error), remedy=remedy) from None


@dataclass(frozen=True, eq=False)
class Replay:
    """The result of a replay: a second evaluation of a counterexample, and a simulation that starts from it.

    Attributes:
        margin: left − right at the point, evaluated again.
        inside: whether the point lies in the claim's domain.
        name: name of the watched quantity; empty if the claim has no motion.
        unit: unit of the watched quantity.
        time: (k,) times [s]; empty if the claim has no motion.
        watched: (k,) the watched quantity along the motion.
        excess: (k,) the integral of the margin over time: the amount by which the watched quantity exceeds its claimed
            bound.
    """

    margin: float
    inside: bool
    name: str
    unit: str
    time: NDArray[np.float64]
    watched: NDArray[np.float64]
    excess: NDArray[np.float64]

    @property
    def confirmed(self) -> bool:
        """Whether the replay confirms the counterexample.

        A counterexample is confirmed if its point lies in the domain, the margin at the point is positive or has no
        value, and, if the claim has a motion, the watched quantity exceeds its claimed bound in the simulation.
        """
        fails = self.margin > 0 or math.isnan(self.margin)
        return self.inside and fails and (self.excess.size == 0 or bool(self.excess[-1] > 0))

    def to_dict(self) -> dict[str, Any]:
        """The replay as plain data for JSON and plots."""
        series = {key: getattr(self, key).tolist() for key in ("time", "watched", "excess")}
        return {
            "margin": self.margin, "inside": self.inside, "confirmed": self.confirmed,
            "name": self.name, "unit": self.unit, **series,
        }  # fmt: skip


def evaluate(claim: Claim, values: Mapping[str, float]) -> tuple[float, bool]:
    """Return the margin at a point given by variable names, and whether the point lies in the claim's domain.

    Raises:
        InputError: the value of a variable is missing, or a name is not a variable of the claim.

    Example:
        >>> from surctl.marine.verification import claims
        >>> from surctl.verification import evaluate
        >>> [claim] = claims(names=["v1-printed"])
        >>> margin, inside = evaluate(claim, {"x_e": 2.0, "y_e": -2.0, "z_e": 0.0, "turn": 0.4})
        >>> round(margin, 3), claim.unit, inside  # V1 grows there: the claim fails
        (4.8, 'm^2/s', True)
    """
    oracle, point = build_oracle(claim), claim.point(values)[:, None]
    return float(oracle.evaluate(point)[0][0]), bool(oracle.inside(point)[0])


def replay(claim: Claim, counterexample: Counterexample, *, points: int = 101) -> Replay:
    """Evaluate a counterexample again; if the claim bounds a rate, also simulate the claim's motion from this point.

    The simulation ends when the margin is no longer positive, or after the duration that the claim's motion states.

    Args:
        claim: the claim, with the gains for which it was refuted.
        counterexample: the point; only its values are used.
        points: number of samples of the time series.

    Raises:
        InputError: the names in the counterexample are not those of the claim's variables.
        SolverError: the integration failed.

    Example:
        >>> from surctl.marine.verification import claims
        >>> from surctl.verification import falsify, replay
        >>> [claim] = claims(names=["v1-printed"])
        >>> run = replay(claim, falsify(claim, samples=256, starts=2).counterexample)
        >>> print(f"{run.name} [{run.unit}]: {run.watched[0]:.1f} to {run.watched[-1]:.1f}")
        V1 [m^2]: 4.0 to 8.9
    """
    margin, inside = evaluate(claim, counterexample.values)
    if claim.motion is None or math.isnan(margin):
        nothing = np.zeros(0)
        return Replay(margin, inside, "", "", nothing, nothing, nothing)
    time, watched, excess = _replay(claim, claim.motion, claim.point(counterexample.values), points)
    return Replay(margin, inside, claim.motion.name, claim.motion.unit, time, watched, excess)


def _replay(
    claim: Claim, motion: Motion, start: NDArray[np.float64], points: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return times, the watched quantity and the integral of the margin, until the margin is no longer positive."""
    from scipy.integrate import solve_ivp

    x = claim.symbols
    moving = [motion.rates.get(v.name, ca.SX(0)) for v in claim.variables]
    rate = ca.Function("rate", [x], [ca.densify(ca.vertcat(*moving, claim.margin))])
    watch = ca.Function("watch", [x], [motion.watched])

    def derivative(_: float, state: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(rate(state[:-1])).reshape(-1)

    def violated(t: float, state: NDArray[np.float64]) -> float:
        return float(derivative(t, state)[-1])

    violated.terminal, violated.direction = True, -1  # type: ignore[attr-defined]
    run = solve_ivp(
        derivative, (0.0, motion.duration), np.append(start, 0.0), method="DOP853", events=violated,
        dense_output=True, rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    if run.status < 0 or not np.all(np.isfinite(run.y)):
        raise SolverError(f"claim {claim.name}: the replay stopped after {run.t[-1]:.3g} s: {run.message}")
    time = np.linspace(0, run.t[-1], points)
    path = run.sol(time)
    return time, np.asarray(watch(path[:-1])).reshape(-1), path[-1]
