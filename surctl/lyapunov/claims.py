"""Claims about the solutions of dynamics, and the inequalities to which each claim reduces.

The inequalities are those that `surctl.certcheck.lyapunov` and `surctl.certcheck.barrier` derive from the claim.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from fractions import Fraction
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.lyapunov.dynamics import Dynamics, Range, exact
from surctl.verification.claim import Claim, Variable
from surctl.verification.formula import Node, number, power, reread, text_of, to_casadi, variable
from surctl.verification.proving import Statement


def every_digit(value: float) -> str:
    """Return a number as text without loss: `0.5`, and `1` for 1.0."""
    short = f"{value:g}"
    return short if float(short) == value else repr(float(value))


@dataclass(frozen=True)
class Power:
    """A positive definite lower bound factor · (r²)^power, with r² = Σ ((x_k − x*_k)/scale_k)².

    Attributes:
        factor: positive number, in the unit of the bounded function.
        power: positive integer.
    """

    factor: float
    power: int

    def to_dict(self) -> dict[str, Any]:
        """Return the bound as plain data for JSON."""
        return {"factor": self.factor, "power": self.power}


@dataclass(frozen=True, eq=False)
class Stability:
    """The claim that V < level is a region of attraction of the equilibrium, in which V decreases.

    Attributes:
        dynamics: the dynamics.
        function: V, an expression of the states.
        level: level of the region.
        rate: with a number, V' ≤ −rate · V, or V⁺ − V ≤ −rate · V in discrete time; None means any strict decrease.
        radii: for an equilibrium that is one only up to rounding, how far the true one may be from it, by name; then V
            decreases where it is outside them, and its decay is that of V about the true one.
    """

    dynamics: Dynamics
    function: Node
    level: float
    rate: float | None = None
    radii: Mapping[str, float] = field(default_factory=dict)

    kind = "lyapunov"

    def __post_init__(self) -> None:
        self.dynamics.require_equilibrium()

    @property
    def statement(self) -> str:
        """The claim in words."""
        pace = "" if self.rate is None else f" at the rate {every_digit(self.rate)}"
        if self.dynamics.shifts:
            start = f"every solution that starts where V < {every_digit(self.level)} stays in the box"
            return f"{start} and converges to {self.goal}; V about that equilibrium decreases{pace}"
        region = f"where the Lyapunov function V < {every_digit(self.level)} in the box"
        return f"{region}, V decreases{pace} and every solution converges to {self.goal}"

    @property
    def goal(self) -> str:
        """To what solutions converge, in words."""
        if not self.radii:
            return "the equilibrium"
        if self.dynamics.shifts:
            return "the equilibrium of its parameters, which are constant, within the stated radii"
        if any(w.lower < w.upper for w in self.dynamics.parameters):
            return "the box of the radii and, with constant parameters, to the equilibrium in this box"
        return "the equilibrium within the stated radii"

    def plain(self) -> dict[str, Any]:
        """Return the claim as plain data, as the certificate states it."""
        return {
            **_plain(self.dynamics, "stability"),
            "function": text_of(self.function),
            "equilibrium": {s.name: stated_number(s.rest) for s in self.dynamics.states},
            "level": float(self.level),
            "rate": None if self.rate is None else float(self.rate),
            **({"radius": dict(self.radii)} if self.radii else {}),
            **({"constant": True} if self.dynamics.shifts else {}),
        }

    def inequalities(self, scales: Sequence[float], positive: Power, decrease: Power | None) -> list[Inequality]:
        """Return the inequalities to prove: V is positive, the region lies in the box, V decreases.

        Args:
            scales: scale (n,) of each state in r².
            positive: lower bound of V.
            decrease: lower bound of −V' or V − V⁺; None if the claim has a rate.
        """
        d = self.dynamics
        inside = [self.function - exact(self.level)]
        at = {s.name: s.rest for s in d.states}
        name, least = f"{d.name}: V is positive", self._power(scales, positive)
        claims = [inequality(name, d.states, least, self.function, inside, at)]
        claims += _stays(d, inside) if d.discrete else _faces(d, self.level, self.function)
        loss = exact(self.rate) * self.function if self.rate is not None else None
        if loss is None:
            assert decrease is not None
            loss = self._power(scales, decrease)
        if self.radii:  # outside the ellipsoid around their box
            near = self._power([self.radii[s.name] for s in d.states], Power(1.0, 1))
            inside, at = [*inside, number(len(d.states)) - near], {}
        return [*claims, _decrease(d, self.function, -loss, inside, at)]

    def _power(self, scales: Sequence[float], bound: Power) -> Node:
        total: Node | None = None
        for s, scale in zip(self.dynamics.states, scales, strict=True):
            term = power((variable(s.name) - number(s.rest)) / exact(scale), 2)
            total = term if total is None else total + term
        assert total is not None
        return exact(bound.factor) * Node("pow", (total,), Fraction(bound.power))


@dataclass(frozen=True, eq=False)
class Bound:
    """The claim that V < level is invariant and V decays to a bound: V' ≤ −rate (V − inner) + Σ gain_j w_j².

    In discrete time, V⁺ − V takes the place of V'.

    Attributes:
        dynamics: the dynamics.
        function: V, an expression of the states.
        level: level of the invariant region.
        rate: decay rate; in discrete time, the share of V − inner that is lost in each step.
        inner: level to which V decays without disturbances.
        gains: gain of each disturbance w_j, by name of the parameter.
    """

    dynamics: Dynamics
    function: Node
    level: float
    rate: float
    inner: float = 0.0
    gains: Mapping[str, float] = field(default_factory=dict)

    kind = "lyapunov"

    @property
    def ultimate(self) -> float:
        """The level below which V ends: inner + max Σ gain_j w_j² / rate."""
        ranges = {w.name: max(abs(w.lower), abs(w.upper)) for w in self.dynamics.parameters}
        return self.inner + sum(gain * ranges[name] ** 2 for name, gain in self.gains.items()) / self.rate

    @property
    def statement(self) -> str:
        """The claim in words."""
        level = every_digit(self.level)
        start = f"starts where V < {level} in the box"
        return f"every solution that {start} stays there, and V decays to {self.ultimate:g}"

    def plain(self) -> dict[str, Any]:
        """Return the claim as plain data, as the certificate states it."""
        return {
            **_plain(self.dynamics, "bound"),
            "function": text_of(self.function),
            "level": float(self.level),
            "rate": float(self.rate),
            "inner": float(self.inner),
            "gains": {name: float(gain) for name, gain in self.gains.items()},
        }

    def inequalities(self) -> list[Inequality]:
        """Return the inequalities to prove: the region lies in the box, V decays."""
        d = self.dynamics
        inside = [self.function - exact(self.level)]
        driving = number(0)
        for name, gain in self.gains.items():
            driving = driving + exact(gain) * power(variable(name), 2)
        right = -(exact(self.rate) * (self.function - exact(self.inner))) + driving
        claims = _stays(d, inside) if d.discrete else _faces(d, self.level, self.function)
        return [*claims, _decrease(d, self.function, right, inside)]


@dataclass(frozen=True, eq=False)
class Safety:
    """The claim that no solution from the initial set reaches the unsafe set, as long as it stays in the box.

    With `stays`, the claim is also that these solutions stay in the box for ever.

    Attributes:
        dynamics: the dynamics.
        function: barrier function B, an expression of the states.
        initial: expressions that are ≤ 0 exactly in the initial set.
        unsafe: expressions that are ≤ 0 exactly in the unsafe set.
        multiplier: expression λ of B' ≤ λ B; None in discrete time, where B(x⁺) ≤ 0 is claimed for B ≤ 0.
        stays: whether the solutions are claimed to stay in the box.
    """

    dynamics: Dynamics
    function: Node
    initial: tuple[Node, ...]
    unsafe: tuple[Node, ...]
    multiplier: Node | None = None
    stays: bool = False

    kind = "barrier"

    @property
    def statement(self) -> str:
        """The claim in words."""
        safe = (
            "no solution that starts in the initial set in the box leaves the box or reaches the unsafe set"
            if self.stays
            else "as long as it stays in the box, no solution that starts in the initial set reaches the unsafe set"
        )
        return safe if self.multiplier is None else f"{safe}, and B' <= ({text_of(self.multiplier)})*B"

    def plain(self) -> dict[str, Any]:
        """Return the claim as plain data, as the certificate states it."""
        return {
            **_plain(self.dynamics, "safety"),
            "function": text_of(self.function),
            "initial": [text_of(g) for g in self.initial],
            "unsafe": [text_of(g) for g in self.unsafe],
            "multiplier": None if self.multiplier is None else text_of(self.multiplier),
            **({"stays": True} if self.stays else {}),
        }

    def inequalities(self, margin: float, inward: Sequence[float] | None = None) -> list[Inequality]:
        """Return the inequalities to prove.

        Args:
            margin: least B > 0 in the unsafe set.
            inward: with `stays` in continuous time, least rate > 0 of a state towards the inside, where B ≤ 0, at its
                lower and its upper bound, for each state.
        """
        d, zero = self.dynamics, number(0)
        change = d.change(self.function)
        claims = [
            inequality(f"{d.name}: B in the initial set", d.states, self.function, zero, self.initial),
            inequality(f"{d.name}: B in the unsafe set", d.states, exact(margin), self.function, self.unsafe),
        ]
        if d.discrete:
            last = inequality(f"{d.name}: B at the successor", d.variables, change, zero, [self.function])
        else:
            if self.multiplier is None:
                raise InputError("is missing", key=f"{d.name}.multiplier", remedy='give e.g. "0" or "-1"')
            last = inequality(f"{d.name}: change of B", d.variables, change, self.multiplier * self.function, [])
        claims.append(last)
        if self.stays and d.discrete:
            claims += _stays(d, [self.function])
        elif self.stays:
            assert inward is not None
            claims += _inward(d, self.function, inward)
        return claims


DynamicClaim = Stability | Bound | Safety
"""A claim about the solutions of dynamics."""


def stated_number(number: Fraction) -> float | str:
    """Return a number as a certificate states it: a double is its shortest decimal; other decimals and p/q are text."""
    value = float(number)
    if Fraction(repr(value)) == number:
        return value
    return format(Decimal(value), "f") if Fraction(value) == number else str(number)


def _plain(dynamics: Dynamics, what: str) -> dict[str, Any]:
    def entry(v: Range) -> dict[str, Any]:
        return {"name": v.name, "unit": v.unit, "lower": float(v.lower), "upper": float(v.upper)}

    return {
        "name": dynamics.name,
        "time": dynamics.time,
        "property": what,
        "about": dict(dynamics.about),
        "states": [entry(s) for s in dynamics.states],
        "parameters": [entry(w) for w in dynamics.parameters],
        "dynamics": {s.name: text_of(rate) for s, rate in zip(dynamics.states, dynamics.rates, strict=True)},
    }


@dataclass(frozen=True, eq=False)
class Inequality:
    """An inequality of a claim about solutions.

    Attributes:
        name: what it is about, for messages.
        exact: the inequality with exact numbers.
        variables: ranges of its variables.
    """

    name: str
    exact: Statement
    variables: tuple[Range, ...]

    @cached_property
    def claim(self) -> Claim:
        """The inequality for the falsifier."""
        e = self.exact
        symbols = {name: ca.SX.sym(name) for name in e.names}
        left, right, *rows = (to_casadi(node, symbols) for node in e.parts)
        return Claim(
            self.name, self.name, "", (), "proved",
            tuple(Variable(v.name, symbols[v.name], v.unit, v.lower, v.upper, v.meaning) for v in self.variables),
            left, right, "1", ca.vertcat(ca.SX(0, 1), *rows), tolerance=0.0, paper=False, exact=e,
        )  # fmt: skip

    def on(self, name: str, end: float) -> Inequality:
        """Return the inequality with a fixed value of one variable."""
        variables = tuple(replace(v, lower=end, upper=end) if v.name == name else v for v in self.variables)
        lower, upper = _ends(variables)
        return replace(self, variables=variables, exact=replace(self.exact, lower=lower, upper=upper))


def inequality(
    name: str,
    variables: Sequence[Range],
    left: Node,
    right: Node,
    constraints: Sequence[Node],
    touching: Mapping[str, Fraction] | None = None,
) -> Inequality:
    """Return left ≤ right where all constraints are ≤ 0, in a box; `touching` is a point at which both are equal."""
    names = tuple(v.name for v in variables)
    left, right, *rows = (reread(node, names) for node in (left, right, *constraints))
    lower, upper = _ends(variables)
    exact = Statement(names, lower, upper, left, right, tuple(rows), touching or {})
    return Inequality(name, exact, tuple(variables))


def _ends(variables: Sequence[Range]) -> NDArray[np.float64]:
    return np.array([(v.lower, v.upper) for v in variables], dtype=float).T


def _faces(dynamics: Dynamics, level: float, function: Node) -> list[Inequality]:
    claims = []
    for s in dynamics.states:
        claim = inequality(f"{dynamics.name}: V on a face in {s.name}", dynamics.states, exact(level), function, [])
        claims += [claim.on(s.name, end) for end in (s.lower, s.upper)]
    return claims


def _inward(dynamics: Dynamics, function: Node, speeds: Sequence[float]) -> list[Inequality]:
    claims = []
    for k, (s, rate) in enumerate(zip(dynamics.states, dynamics.rates, strict=True)):
        for side, end in enumerate((s.lower, s.upper)):
            speed = exact(speeds[2 * k + side])
            left, right = (rate, -speed) if side else (speed, rate)
            name = f"{dynamics.name}: the rate of {s.name} at its bound {end:g}"
            claims.append(inequality(name, dynamics.variables, left, right, [function]).on(s.name, end))
    return claims


def _stays(dynamics: Dynamics, inside: Sequence[Node]) -> list[Inequality]:
    claims = []
    for s, rate in zip(dynamics.states, dynamics.rates, strict=True):
        name = f"{dynamics.name}: the successor of {s.name}"
        claims.append(inequality(name, dynamics.variables, exact(s.lower), rate, inside))
        claims.append(inequality(name, dynamics.variables, rate, exact(s.upper), inside))
    return claims


def _decrease(
    dynamics: Dynamics,
    function: Node,
    right: Node,
    inside: Sequence[Node],
    touching: Mapping[str, Fraction] | None = None,
) -> Inequality:
    change = dynamics.change(function)
    left = change - function if dynamics.discrete else change
    return inequality(f"{dynamics.name}: V decreases", dynamics.variables, left, right, inside, touching)
