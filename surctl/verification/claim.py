"""Claims as data: a claim states that an inequality holds everywhere on a domain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.verification.formula import Statement

VerdictWord = Literal["proved", "refuted", "unknown", "not refuted"]
"""A claim is `proved` with a certificate, `refuted` with a counterexample, or `unknown` if neither was found.
`not refuted` is the verdict of the falsifier alone, which cannot prove a claim."""


@dataclass(frozen=True, eq=False)
class Variable:
    """A variable of a claim, with its lower and upper bound.

    Attributes:
        name: name of the variable in the text of counterexamples.
        symbol: scalar CasADi SX symbol of the variable.
        unit: SI unit; "1" if dimensionless.
        lower: least value of the variable, in `unit`.
        upper: largest value of the variable, in `unit`; not below `lower`.
        meaning: description of the quantity, with its frame.
    """

    name: str
    symbol: ca.SX
    unit: str
    lower: float
    upper: float
    meaning: str


@dataclass(frozen=True, eq=False)
class Motion:
    """The differential equations with which a counterexample of a claim is simulated.

    Attributes:
        rates: time derivative of each variable that changes, by name, in the variable's unit per second; all other
            variables are constant.
        watched: the quantity whose rate the claim bounds (a Lyapunov function or a clearance).
        name: name of `watched`.
        unit: unit of `watched`.
        duration: largest integration time [s].
    """

    rates: Mapping[str, ca.SX]
    watched: ca.SX
    name: str
    unit: str
    duration: float = 0.5


@dataclass(frozen=True, eq=False)
class Claim:
    """The claim that left(x) ≤ right(x) for every point x of a box where all constraints(x) ≤ 0.

    A point where both sides are equal does not refute a claim. To claim that the left side is negative everywhere
    except at the origin e = 0, choose a right side that is negative there, for instance −c‖e‖² with c > 0.

    Attributes:
        name: short name, used on the command line.
        statement: the claim in words.
        equation: numbers of the equations in the paper to which the claim refers.
        errata: ids of the errata that concern the claim.
        expected: the expected verdict; `refuted` for a claim that the paper states wrongly.
        variables: the variables with their bounds.
        left: left side of the inequality, a scalar SX expression of the variables.
        right: right side of the inequality, a scalar SX expression of the variables.
        unit: unit of both sides.
        constraints: column g of SX expressions; the domain of the claim is the part of the box where g ≤ 0.
        witnesses: points that the falsifier tries first, each with a value for every variable.
        motion: the differential equations with which a counterexample is simulated, if the claim bounds a rate.
        paper: whether the claim comes from the paper, either as printed or in corrected form.
        tolerance: relative tolerance for rounding: a point refutes the claim only if left − right exceeds `tolerance`
            times the largest |left| or |right| at the evaluated points.
        exact: the statement, if it was written in the claim grammar. Falsifier, prover and certificate then use it and
            nothing else; `left`, `right` and `constraints` are its CasADi form, from which only search directions come,
            because CasADi rounds constants and cancels terms. None means that the claim was written with CasADi: the
            prover reads the numbers in `left`, `right` and `constraints` as decimals.
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
    exact: Statement | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Raise an InputError, which names the claim, if the claim cannot be checked."""
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
                raise self._mistake("has a rate for a name that is not among its variables", moving)

    @property
    def margin(self) -> ca.SX:
        """The expression left − right in `unit`; it is positive where the claim fails."""
        return self.left - self.right

    @property
    def symbols(self) -> ca.SX:
        """The symbols of the variables as a column (n, 1), in the order of `variables`."""
        return ca.vertcat(*[v.symbol for v in self.variables])

    @property
    def lower(self) -> NDArray[np.float64]:
        """The lower bounds (n,) of the variables."""
        return np.array([v.lower for v in self.variables], dtype=float)

    @property
    def upper(self) -> NDArray[np.float64]:
        """The upper bounds (n,) of the variables."""
        return np.array([v.upper for v in self.variables], dtype=float)

    def point(self, values: Mapping[str, float]) -> NDArray[np.float64]:
        """Return the vector (n,) of values that are given by name; raise InputError if a name is missing or unknown."""
        names = [v.name for v in self.variables]
        for name in values:
            if name not in names:
                raise InputError("no such variable", key=f"{self.name}.{name}", remedy=nearest(name, names))
        for name in names:
            if name not in values:
                raise InputError("has no value", key=f"{self.name}.{name}", remedy="give every variable")
        return np.array([float(values[name]) for name in names])

    def values(self, point: NDArray[np.float64]) -> dict[str, float]:
        """Return the values of a vector (n,) as a mapping from variable names."""
        return {v.name: float(x) for v, x in zip(self.variables, point, strict=True)}

    def on(self, domain: Mapping[str, tuple[float, float]]) -> Claim:
        """Return the claim with new bounds (lower, upper) of the named variables, without witnesses outside them."""
        known = [v.name for v in self.variables]
        for name in domain:
            if name not in known:
                raise InputError("no such variable", key=f"{self.name}.{name}", remedy=nearest(name, known))
        variables = tuple(
            replace(v, lower=domain[v.name][0], upper=domain[v.name][1]) if v.name in domain else v
            for v in self.variables
        )
        witnesses = tuple(w for w in self.witnesses if all(v.lower <= w[v.name] <= v.upper for v in variables))
        exact = self.exact
        if exact is not None:
            ends = np.array([(v.lower, v.upper) for v in variables], dtype=float)
            exact = replace(exact, lower=ends[:, 0], upper=ends[:, 1])
        return replace(self, variables=variables, witnesses=witnesses, exact=exact)

    def _loose_symbols(self) -> list[str]:
        everything = [self.left, self.right, self.constraints]
        if self.motion:
            everything += [self.motion.watched, *self.motion.rates.values()]
        own = {v.symbol.__hash__() for v in self.variables}
        return [str(s) for s in ca.symvar(ca.vertcat(*everything)) if s.__hash__() not in own]

    def _mistake(self, problem: str, value: object) -> InputError:
        return InputError(problem, key=f"claim {self.name}", value=value, remedy="correct the claim")
