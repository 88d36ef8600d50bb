"""A claim: an inequality said to hold everywhere on a domain, as data that can be checked and printed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest

__all__ = ["Claim", "Motion", "Variable", "VerdictWord"]

VerdictWord = Literal["proved", "refuted", "unknown", "not refuted"]
"""`proved` with a certificate, `refuted` with a counterexample, `unknown` with what is left open; `not refuted` is what
the falsifier alone can say."""


@dataclass(frozen=True, eq=False)
class Variable:
    """One unknown of a claim and the interval it ranges over.

    Attributes:
        name: name in counterexamples.
        symbol: the scalar SX symbol.
        unit: SI unit, "1" when dimensionless.
        lower: least value, in `unit`.
        upper: largest value, in `unit`; not below `lower`.
        meaning: what it is and in which frame.
    """

    name: str
    symbol: ca.SX
    unit: str
    lower: float
    upper: float
    meaning: str


@dataclass(frozen=True, eq=False)
class Motion:
    """The kinematic loop behind a claim: what a counterexample is replayed on.

    Attributes:
        rates: time derivative of each variable that moves, in its unit per second; the others are held.
        watched: the quantity whose rate the claim bounds (a Lyapunov function, a clearance).
        name: name of `watched`.
        unit: unit of `watched`.
        duration: how long to integrate at most [s].
    """

    rates: Mapping[str, ca.SX]
    watched: ca.SX
    name: str
    unit: str
    duration: float = 0.5


@dataclass(frozen=True, eq=False)
class Claim:
    """left(x) ≤ right(x) for every x in the box with constraint(x) ≤ 0. Equality is allowed.

    A strict claim ("negative away from the origin") is written with a right side that is negative away from
    the origin, for instance −c‖e‖²: then equality at the origin refutes nothing.

    Attributes:
        name: short name, as the command line takes it.
        statement: the claim in words.
        equation: where it stands: equation numbers of the paper.
        errata: ids of the errata it belongs to.
        expected: the verdict that is expected; a printed claim may be expected to be refuted.
        variables: the unknowns with their box.
        left: scalar SX in the variables.
        right: scalar SX in the variables.
        unit: unit of both sides.
        constraints: SX column g; the domain is the part of the box with g ≤ 0.
        witnesses: points known to matter, each a value for every variable.
        motion: the loop to replay a counterexample on, if the claim bounds a rate.
        paper: whether the paper says it, as printed or corrected.
        tolerance: a point refutes when left − right exceeds this times the largest of |left|, |right| seen.
    """

    name: str
    statement: str
    equation: str
    errata: tuple[str, ...]
    expected: VerdictWord
    variables: tuple[Variable, ...]
    left: ca.SX
    right: ca.SX
    unit: str
    constraints: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    witnesses: tuple[Mapping[str, float], ...] = ()
    motion: Motion | None = None
    tolerance: float = 1e-9
    paper: bool = True

    def __post_init__(self) -> None:
        """Raise InputError for a claim that cannot be checked, naming it."""
        names = [v.name for v in self.variables]
        if len(set(names)) < len(names) or not names:
            raise self._mistake("needs variables with different names", names)
        for v in self.variables:
            if not (np.isfinite(v.lower) and np.isfinite(v.upper) and v.lower <= v.upper):
                raise self._mistake(f"{v.name} needs finite bounds, the lower one first", [v.lower, v.upper])
        loose = self._loose_symbols()
        if loose:
            raise self._mistake("uses symbols that are not among its variables", loose)
        for witness in self.witnesses:
            self.point(witness)
        for moving in self.motion.rates if self.motion else ():
            if moving not in names:
                raise self._mistake("moves what is not among its variables", moving)

    @property
    def margin(self) -> ca.SX:
        """Left minus right, positive where the claim fails; in `unit`."""
        return self.left - self.right

    @property
    def symbols(self) -> ca.SX:
        """(n, 1): the variables' symbols in order."""
        return ca.vertcat(*[v.symbol for v in self.variables])

    @property
    def lower(self) -> NDArray[np.float64]:
        """(n,): lower corner of the box."""
        return np.array([v.lower for v in self.variables], dtype=float)

    @property
    def upper(self) -> NDArray[np.float64]:
        """(n,): upper corner of the box."""
        return np.array([v.upper for v in self.variables], dtype=float)

    def point(self, values: Mapping[str, float]) -> NDArray[np.float64]:
        """(n,) vector from named values; InputError when a name is missing or unknown."""
        names = [v.name for v in self.variables]
        for name in values:
            if name not in names:
                raise InputError("no such variable", key=f"{self.name}.{name}", remedy=nearest(name, names))
        for name in names:
            if name not in values:
                raise InputError("has no value", key=f"{self.name}.{name}", remedy="give every variable")
        return np.array([float(values[name]) for name in names])

    def values(self, point: NDArray[np.float64]) -> dict[str, float]:
        """Named values from an (n,) vector."""
        return {v.name: float(x) for v, x in zip(self.variables, point, strict=True)}

    def on(self, domain: Mapping[str, tuple[float, float]]) -> Claim:
        """The same claim on another box, (lower, upper) by variable; witnesses outside it are dropped."""
        known = [v.name for v in self.variables]
        for name in domain:
            if name not in known:
                raise InputError("no such variable", key=f"{self.name}.{name}", remedy=nearest(name, known))
        variables = tuple(
            replace(v, lower=domain[v.name][0], upper=domain[v.name][1]) if v.name in domain else v
            for v in self.variables
        )
        witnesses = tuple(w for w in self.witnesses if all(v.lower <= w[v.name] <= v.upper for v in variables))
        return replace(self, variables=variables, witnesses=witnesses)

    def _loose_symbols(self) -> list[str]:
        everything = [self.left, self.right, self.constraints]
        if self.motion:
            everything += [self.motion.watched, *self.motion.rates.values()]
        own = {v.symbol.__hash__() for v in self.variables}
        return [str(s) for s in ca.symvar(ca.vertcat(*everything)) if s.__hash__() not in own]

    def _mistake(self, problem: str, value: object) -> InputError:
        return InputError(problem, key=f"claim {self.name}", value=value, remedy="correct the claim")
