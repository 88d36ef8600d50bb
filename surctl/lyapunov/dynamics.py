"""Dynamics as exact expressions, x' = f(x, w) or x⁺ = f(x, w), with ranges of x and w; whether a state rests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.system.plant import runge_kutta
from surctl.verification.formula import IDENTIFIER, Node, derivative, number, ordered, substitute, to_casadi

Array = NDArray[np.float64]

_REST = 1e-9  # largest residual of an equilibrium, relative to the largest rate of the same state in the box
_SUBSTEPS = 4  # of the integration over a control period
_DRAWS, _ULPS = 61, 8  # sampled points of the box; rounding of a stated equilibrium, in units of its last digit


@dataclass(frozen=True)
class Range:
    """A parameter: it may take any value of its range, and may vary in time.

    Attributes:
        name: name in the expressions.
        lower: least value, in `unit`.
        upper: largest value, in `unit`.
        unit: SI unit.
        meaning: description of the quantity.
        typed: the name in a system, such as "controller.sum", which no expression may contain; empty if it is `name`.
        nominal: value of a parameter in a system; None means the middle of the range.
    """

    name: str
    lower: float
    upper: float
    unit: str = "1"
    meaning: str = ""
    typed: str = field(default="", kw_only=True)
    nominal: float | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class State(Range):
    """A state, with the interval in which the dynamics are considered.

    Attributes:
        equilibrium: value of the state at the equilibrium, in `unit`.
        to_the_bit: whether the equilibrium is exactly the double `equilibrium`, as in the law of a controller, and not
            its shortest decimal.
        exact: the exact value at the equilibrium, if it is no double; `equilibrium` is close to it.
    """

    equilibrium: float = 0.0
    to_the_bit: bool = False
    exact: Fraction | None = None

    @property
    def rest(self) -> Fraction:
        """The exact value of the state at the equilibrium."""
        if self.exact is not None:
            return self.exact
        value = float(self.equilibrium)
        return Fraction(value) if self.to_the_bit else Fraction(repr(value))


@dataclass(frozen=True, eq=False)
class Command:
    """A command that is computed at each sampling instant, and held until the next one.

    Attributes:
        name: name in the rates of the plant.
        value: expression of the states and parameters at the instant.
        rest: value at the equilibrium.
        unit: SI unit.
    """

    name: str
    value: Node
    rest: Fraction
    unit: str = "1"


@dataclass(frozen=True, eq=False)
class Sampling:
    """The sampled form of a loop: a plant in continuous time under a controller that is evaluated once a period.

    Attributes:
        period: control period [s].
        flow: rate of each state of the plant, an expression of states, commands and parameters.
        next: value of each state of the controller after an instant, an expression of the states before it.
        commands: the held commands.
    """

    period: float
    flow: Mapping[str, Node]
    next: Mapping[str, Node]
    commands: tuple[Command, ...]


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Differential equations x' = f(x, w) (continuous time) or a map x⁺ = f(x, w) (discrete time).

    The numbers in `rates` are exact: 0.1 is exactly 1/10, not the nearest binary number.

    Attributes:
        name: short name, used in file names.
        time: "continuous" or "discrete".
        states: the n states; their intervals form the box in which the dynamics are considered.
        rates: time derivative of each state (continuous) or its successor (discrete), as expressions.
        parameters: uncertain parameters and disturbances.
        source: where the dynamics are published.
        about: digests of `plant` and `controller`, `period_s`, and the entries of every vector of the loop, if the
            dynamics are those of a closed loop (`surctl.system.System`); otherwise empty.
        sampling: the sampled form of the loop, if `rates` are its law in continuous time.
        shifts: largest distance of each state and command of the equilibrium from the stated one, which is moved by
            constant parameters, see `surctl.lyapunov.shifts`; empty if the equilibrium does not move.

    Raises:
        InputError: a name is not valid or is used twice, a range is not finite, or a rate uses an unknown name.

    Example:
        >>> from surctl.lyapunov import Dynamics, State
        >>> from surctl.verification.formula import parse, variable
        >>> x = variable("x")
        >>> cubic = Dynamics("cubic", "continuous", (State("x", -2.0, 2.0),), (parse("-x + x^3", {"x": x}),))
        >>> cubic.evaluate([[0.5, 1.0]])
        array([[-0.375,  0.   ]])
    """

    name: str
    time: Literal["continuous", "discrete"]
    states: tuple[State, ...]
    rates: tuple[Node, ...]
    parameters: tuple[Range, ...] = ()
    source: str = ""
    about: Mapping[str, Any] = field(default_factory=dict)
    sampling: Sampling | None = None
    shifts: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [v.name for v in self.variables]
        if not self.states or len(self.rates) != len(self.states):
            raise InputError("needs one rate for each state", key=self.name, remedy="give at least one state")
        for name in names:
            if not IDENTIFIER.fullmatch(name) or names.count(name) > 1:
                raise InputError(
                    "is not a name, or is used twice", key=f"{self.name}.{name}", remedy="choose another name"
                )
        for v in self.variables:
            ends = (v.lower, v.upper)
            if not np.all(np.isfinite(ends)) or v.lower > v.upper or (isinstance(v, State) and v.lower == v.upper):
                raise InputError(
                    "needs finite bounds, the lower one first", key=f"{self.name}.{v.name}", value=list(ends),
                    remedy="give lower and upper",
                )  # fmt: skip
            if not v.unit.isprintable():
                raise InputError(
                    "has a unit that cannot be printed", key=f"{self.name}.{v.name}", value=v.unit,
                    remedy="give an SI unit",
                )  # fmt: skip
        for state, rate in zip(self.states, self.rates, strict=True):
            for node in ordered(rate):
                if node.op == "var" and node.name not in names:
                    raise InputError(
                        f"uses the unknown name {node.name!r}", key=f"{self.name}.{state.name}", remedy="define it"
                    )

    @property
    def variables(self) -> tuple[Range, ...]:
        """The states, then the parameters."""
        return (*self.states, *self.parameters)

    @property
    def discrete(self) -> bool:
        """Whether the dynamics are a map x⁺ = f(x, w)."""
        return self.time == "discrete"

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the states."""
        return tuple(s.name for s in self.states)

    @property
    def equilibrium(self) -> Array:
        """The equilibrium (n,)."""
        return np.array([s.equilibrium for s in self.states])

    def require_equilibrium(self) -> None:
        """Raise InputError unless the equilibrium lies inside the box."""
        for s in self.states:
            if not s.lower < s.equilibrium < s.upper:
                raise InputError(
                    "has its equilibrium outside its bounds", key=f"{self.name}.{s.name}", value=s.equilibrium,
                    remedy="widen the bounds",
                )  # fmt: skip

    def require_rest(self) -> None:
        """Raise InputError unless the equilibrium is one for all parameters, up to rounding, or moves, in the box."""
        self.require_equilibrium()
        if not self.shifts and not self.rests():
            raise InputError(
                "is not an equilibrium: the largest rate there is", key=f"{self.name}.equilibrium",
                value=float(self.residual().max()), remedy="give the equilibrium of the states",
            )  # fmt: skip

    @property
    def box(self) -> Array:
        """The lower and upper bounds (2, n) of the states."""
        return np.array([[s.lower for s in self.states], [s.upper for s in self.states]])

    @property
    def radii(self) -> Array:
        """The largest distances (n,) of the equilibrium of constant parameters from the stated one."""
        return np.array([self.shifts.get(s.name, 0.0) for s in self.states])

    @property
    def freedom(self) -> Array:
        """The least distance (n,) of an equilibrium from the bounds of each state."""
        least: Array = np.minimum(self.box[1] - self.equilibrium, self.equilibrium - self.box[0])
        return least - self.radii

    def inner_level(self, p: Array, level: float) -> float:
        """Return the level of ξ' P ξ about the stated equilibrium in {ξ' P ξ ≤ level} about any other; 0 if none is.

        The result is `level` if the equilibrium does not move; else it is rounded down to six digits.
        """
        extent = float(self.radii @ np.sqrt(np.diag(p))) * (1 + 1e-9)
        apart = np.sqrt(level) - extent
        return level if not self.shifts else float(f"{(1 - 1e-5) * apart**2:.6g}") if apart > extent else 0.0

    @property
    def ranges(self) -> Array:
        """The lower and upper bounds (2, m) of the parameters."""
        return np.array([[w.lower for w in self.parameters], [w.upper for w in self.parameters]]).reshape(2, -1)

    def change(self, function: Node) -> Node:
        """Return the time derivative of a function of the states, or its value at the successor (discrete time).

        Raises:
            UnsupportedOperation: the function has kinks or jumps (continuous time).
        """
        if function not in self._changes:
            self._changes[function] = self._changed(function)
        return self._changes[function]

    @cached_property
    def _changes(self) -> dict[Node, Node]:
        return {}

    def _changed(self, function: Node) -> Node:
        if self.discrete:
            return substitute(function, dict(zip(self.names, self.rates, strict=True)))
        total: Node | None = None
        zero, one = number(0), number(1)
        for name, rate in zip(self.names, self.rates, strict=True):
            slope = derivative(function, name)
            if slope == zero or rate == zero:
                continue
            term = rate if slope == one else slope * rate
            total = term if total is None else total + term
        return zero if total is None else total

    @cached_property
    def symbols(self) -> dict[str, ca.SX]:
        """A CasADi symbol for each variable, by name."""
        return {v.name: ca.SX.sym(v.name) for v in self.variables}

    def compiled(self, *expressions: Node) -> ca.Function:
        """Return a CasADi function of states (n, N) and parameters (m, N) with the values (k, N) of expressions."""
        x = ca.vertcat(*[self.symbols[s.name] for s in self.states])
        w = ca.vertcat(ca.SX(0, 1), *[self.symbols[p.name] for p in self.parameters])
        values = ca.vertcat(*[to_casadi(node, self.symbols) for node in expressions])
        return ca.Function("values", [x, w], [ca.densify(values)])

    @cached_property
    def _function(self) -> ca.Function:
        return self.compiled(*self.rates)

    @cached_property
    def held(self) -> ca.Function:
        """The sampled form over a period, integrated numerically: a map of states (n, N) and parameters (m, N)."""
        form, at = self.sampling, self.symbols
        assert form is not None
        states, parameters = (ca.vertcat(*[at[v.name] for v in part]) for part in (self.states, self.parameters))
        commands = {command.name: ca.SX.sym(command.name) for command in form.commands}
        plant = ca.vertcat(*[at[name] for name in form.flow])
        rates = ca.vertcat(*[to_casadi(rate, at | commands) for rate in form.flow.values()])
        flow = ca.Function("flow", [plant, ca.vertcat(*commands.values()), parameters], [rates])
        held = ca.vertcat(*[to_casadi(command.value, at) for command in form.commands])
        for _ in range(_SUBSTEPS):
            plant = runge_kutta(lambda y, _: flow(y, held, parameters), plant, form.period / _SUBSTEPS)
        after = {name: to_casadi(node, at) for name, node in form.next.items()}
        after |= dict(zip(form.flow, ca.vertsplit(plant), strict=True))
        return ca.Function("held", [states, parameters], [ca.vertcat(*[after[name] for name in self.names])])

    def evaluate(self, x: ArrayLike, w: ArrayLike | None = None) -> Array:
        """Return the rates or successors (n, N) at states x (n, N) for parameters w (m, N), by default their middle."""
        at = np.atleast_2d(np.asarray(x, dtype=float))
        middle = np.repeat(self.ranges.mean(axis=0)[:, None], at.shape[1], axis=1)
        p = middle if w is None else np.asarray(w, dtype=float).reshape(len(self.parameters), at.shape[1])
        return np.asarray(self._function(at, p)).reshape(len(self.states), -1)

    def linear(self, w: ArrayLike | None = None) -> Array:
        """Return the Jacobian (n, n) of the rates or successors at the equilibrium, for parameters w (m,)."""
        x = ca.SX.sym("x", len(self.states))
        p = ca.SX.sym("w", len(self.parameters))
        jacobian = ca.Function("jacobian", [x, p], [ca.jacobian(self._function(x, p), x)])
        at = self.ranges.mean(axis=0) if w is None else np.asarray(w, dtype=float)
        return np.asarray(jacobian(self.equilibrium, at))

    def rests(self) -> bool:
        """Return whether no state moves at the equilibrium, up to rounding and relative to its rates, for any w."""
        residual = self.residual()  # also refuses dynamics that are not defined there
        corners = self.corners()
        w = np.repeat(corners, _DRAWS, axis=1)
        unit = np.tile(np.random.default_rng(0).uniform(-1, 1, (len(self.states), _DRAWS)), corners.shape[1])
        rest = self.equilibrium[:, None]
        moved = self.evaluate(rest * (1 + _ULPS * np.finfo(float).eps * unit), w)
        rounding = np.abs(moved - self.evaluate(np.repeat(rest, w.shape[1], axis=1), w)).max(axis=1)
        return bool(np.all(residual <= np.maximum(_REST * self.size(), rounding)))

    def residual(self) -> Array:
        """Return the largest |f(x*, w)|, or |f(x*, w) − x*| in discrete time, of each state (n,) over the corners of w.

        Raises:
            InputError: the dynamics are not defined there.
        """
        corners = self.corners()
        rest = self.evaluate(np.repeat(self.equilibrium[:, None], corners.shape[1], axis=1), corners)
        if not np.all(np.isfinite(rest)):
            corner = corners[:, np.flatnonzero(~np.isfinite(rest).all(axis=0))[0]]
            pairs = [*zip(self.names, self.equilibrium, strict=True)]
            pairs += [(w.name, value) for w, value in zip(self.parameters, corner, strict=True)]
            raise InputError(
                "is not finite at " + ", ".join(f"{name} = {value:.6g}" for name, value in pairs),
                key=f"{self.name}.dynamics", remedy="exclude this point from the ranges",
            )  # fmt: skip
        return np.asarray(np.abs(rest - (self.equilibrium[:, None] if self.discrete else 0.0)).max(axis=1))

    def size(self) -> Array:
        """Return the largest |f(x, w)|, or |f(x, w) − x| in discrete time, of each state (n,) at sampled points."""
        low, high = self.box[:, :, None]
        unit = np.random.default_rng(0).uniform(size=(len(self.states), _DRAWS))
        x = np.hstack([low, high, (low + high) / 2, low + (high - low) * unit])
        values = self.evaluate(x) - (x if self.discrete else 0.0)
        return np.asarray(np.abs(np.where(np.isfinite(values), values, 0.0)).max(axis=1))

    def corners(self, most: int = 10) -> Array:
        """Return the corners (m, 2^k) of the ranges of the k ≤ `most` parameters that vary, or their middle (m, 1)."""
        lower, upper = self.ranges
        wide = np.flatnonzero(lower < upper)[:most]
        values = np.repeat(self.ranges.mean(axis=0)[:, None], 2 ** len(wide), axis=1)
        for k, at in enumerate(wide):
            high = (np.arange(values.shape[1]) >> k) & 1
            values[at] = np.where(high == 1, upper[at], lower[at])
        return values

    def on(self, bounds: Mapping[str, tuple[float, float]]) -> Dynamics:
        """Return the dynamics with other bounds of the named states."""
        states = tuple(
            replace(s, lower=bounds[s.name][0], upper=bounds[s.name][1]) if s.name in bounds else s for s in self.states
        )
        return replace(self, states=states)


def exact(value: float) -> Node:
    """Return the number of the shortest decimal notation of a double, as an expression."""
    return number(Fraction(repr(float(value))))
