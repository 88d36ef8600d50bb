"""Files of kind `lyapunov` and `barrier`: their keys, read as dynamics and a claim about their solutions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, StrictFloat, StrictStr

from surctl.errors import InputError, mistakes_in
from surctl.files import Strict, read_toml, require_doubles, validate
from surctl.lyapunov.claims import DynamicClaim, Safety, Stability
from surctl.lyapunov.dynamics import Dynamics, Range, State
from surctl.verification.claim_file import VariableTable
from surctl.verification.formula import Node, is_name, number, ordered, parse, parse_relation, variable

KINDS = ("lyapunov", "barrier")
"""The values of `kind` in files about dynamics."""


class _StateTable(VariableTable):
    rate: StrictStr | None = None
    next: StrictStr | None = None
    equilibrium: StrictFloat | None = None


class _ProblemTable(Strict):
    kind: Literal["lyapunov", "barrier"]
    name: StrictStr = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,59}$")
    source: StrictStr = ""
    time: Literal["continuous", "discrete"] = "continuous"
    function: StrictStr | None = None
    level: StrictFloat | None = None
    rate: StrictFloat | None = None
    expected: Literal["proved", "refuted"] = "proved"
    constants: dict[str, StrictFloat] = Field(default_factory=dict)
    definitions: dict[str, StrictStr] = Field(default_factory=dict)
    states: dict[str, _StateTable]
    parameters: dict[str, VariableTable] = Field(default_factory=dict)
    barrier: StrictStr | None = None
    initial: tuple[StrictStr, ...] = ()
    unsafe: tuple[StrictStr, ...] = ()
    multiplier: StrictStr | None = None


@dataclass(frozen=True, eq=False)
class Problem:
    """Dynamics and what is claimed about their solutions.

    Attributes:
        dynamics: the dynamics.
        kind: `lyapunov` (a region of attraction) or `barrier` (a set that is never reached).
        function: V or B; None if it is searched.
        level: level of the region V < level; None if it is searched.
        rate: claimed decay rate of V; None means any strict decrease.
        initial: expressions that are ≤ 0 in the initial set of a barrier claim.
        unsafe: expressions that are ≤ 0 in the unsafe set of a barrier claim.
        multiplier: expression λ of B' ≤ λ B; None if it is searched, and in discrete time.
        expected: the expected verdict.
        sought: whether nobody stated the equilibrium: if 0 is none, the only one in the box is searched.
    """

    dynamics: Dynamics
    kind: Literal["lyapunov", "barrier"]
    function: Node | None = None
    level: float | None = None
    rate: float | None = None
    initial: tuple[Node, ...] = ()
    unsafe: tuple[Node, ...] = ()
    multiplier: Node | None = None
    expected: Literal["proved", "refuted"] = "proved"
    sought: bool = False

    @property
    def claim(self) -> DynamicClaim | None:
        """The claim, or None if a part of it is searched."""
        if self.function is None:
            return None
        if self.kind == "lyapunov":
            return None if self.level is None else Stability(self.dynamics, self.function, self.level, self.rate)
        if self.multiplier is None and not self.dynamics.discrete:
            return None
        return Safety(self.dynamics, self.function, self.initial, self.unsafe, self.multiplier)


def is_problem(path: Path) -> bool:
    """Return whether a TOML file is about dynamics, i.e. of kind `lyapunov` or `barrier`.

    Raises:
        InputError: the file cannot be read.

    Example:
        >>> from pathlib import Path
        >>> from surctl.lyapunov import is_problem
        >>> _ = Path("claim.toml").write_text('kind = "claim"')
        >>> is_problem(Path("claim.toml"))
        False
    """
    return read_toml(path).get("kind") in KINDS


def load_problem(path: Path, *, changes: Mapping[str, Any] | None = None) -> Problem:
    """Load dynamics, and a claim about their solutions, from a TOML file.

    ::

        kind = "lyapunov"                     # or "barrier"
        name = "van-der-pol"
        source = "Khalil, Nonlinear Systems"  # optional
        time = "continuous"                   # default; or "discrete"
        function = "1.5*x^2 - x*y + y^2"      # V; without it, V is searched
        level = 2.0                           # the region V < level; without it, the level is searched
        rate = 0.05                           # V' <= -rate*V, or V+ - V <= -rate*V; without it, any strict decrease
        [constants]
        mu = 1.0
        [definitions]                         # optional: named expressions
        damping = "mu*(1 - x^2)"
        [states]                              # the bounds form the box in which the dynamics are considered
        x = { rate = "-y", lower = -3, upper = 3, unit = "1" }
        y = { rate = "x - damping*y", lower = -3, upper = 3, unit = "1", equilibrium = 0 }
        [parameters]                          # optional: any value of the range, also varying in time
        load = { lower = -0.1, upper = 0.1, unit = "N" }

    In discrete time, a state has `next`, its successor, in the place of `rate`. A file of kind "barrier" has `barrier`
    (the expression B), `initial` and `unsafe` (lists of inequalities with <= or >=, which hold together) and, in
    continuous time, `multiplier` (the expression λ of B' <= λ B). Numbers have exactly the value of their notation.
    Units are printed but not converted: use SI units. What the file states is never exchanged for something else. If no
    state has `equilibrium`, the states rest at 0, or else at the only equilibrium in the box, which is searched and
    printed; in a file with `equilibrium`, it is 0 for the states without it.

    Args:
        path: the file.
        changes: values that take the place of entries of the file, by key; None removes an entry.

    Raises:
        InputError: the file is not valid; the error names file, key, token and column, and the remedy.

    Example:
        >>> from pathlib import Path
        >>> from surctl.lyapunov import decide_motion, load_problem
        >>> _ = Path("cubic.toml").write_text('''
        ... kind = "lyapunov"
        ... name = "cubic"
        ... function = "x^2"
        ... level = 0.9
        ... [states]
        ... x = { rate = "-x + x^3", lower = -2, upper = 2 }
        ... ''')
        >>> decide_motion(load_problem(Path("cubic.toml")).claim).verdict
        'proved'
    """
    entries = {**read_toml(path), **(changes or {})}
    entries = {key: value for key, value in entries.items() if value is not None}
    table = validate(entries, _ProblemTable, file=path)
    require_doubles(path)
    with mistakes_in(path):
        return _problem(table, path)


def _problem(table: _ProblemTable, path: Path) -> Problem:
    known = _known(table, path)
    discrete = table.time == "discrete"
    states, rates = [], []
    for name, entry in table.states.items():
        key, other = ("next", "rate") if discrete else ("rate", "next")
        text, wrong = (entry.next, entry.rate) if discrete else (entry.rate, entry.next)
        if text is None or wrong is not None:
            raise InputError(
                f"needs {key}, and not {other}, in {table.time} time", file=path, key=f"states.{name}",
                remedy=f"write {key} = ...",
            )  # fmt: skip
        rates.append(parse(text, known, file=path, key=f"states.{name}.{key}"))
        states.append(State(name, entry.lower, entry.upper, entry.unit, entry.meaning, entry.equilibrium or 0.0))
    parameters = tuple(Range(n, e.lower, e.upper, e.unit, e.meaning) for n, e in table.parameters.items())
    dynamics = Dynamics(table.name, table.time, tuple(states), tuple(rates), parameters, table.source)
    if table.kind == "barrier":
        return _barrier(table, dynamics, known, path)
    sought = all(entry.equilibrium is None for entry in table.states.values())
    if not sought:
        dynamics.require_equilibrium()
    for key in ("barrier", "initial", "unsafe", "multiplier"):
        if getattr(table, key):
            raise InputError("belongs to kind barrier", file=path, key=key, remedy="drop it, or change the kind")
    for key in ("level", "rate"):
        value = getattr(table, key)
        if value is not None and not value > 0:
            raise InputError("is not positive", file=path, key=key, value=value, remedy="give a positive number")
    if table.rate is not None and discrete and table.rate > 1:
        raise InputError("exceeds 1, the whole of V", file=path, key="rate", value=table.rate, remedy="lower it")
    if table.level is not None and table.function is None:
        raise InputError("is given without function", file=path, key="level", remedy="give both, or drop the level")
    function = None if table.function is None else parse(table.function, known, file=path, key="function")
    _of_states(function, dynamics, path, "function")
    return Problem(dynamics, "lyapunov", function, table.level, table.rate, expected=table.expected, sought=sought)


def _barrier(table: _ProblemTable, dynamics: Dynamics, known: Mapping[str, Node], path: Path) -> Problem:
    for key in ("function", "level", "rate"):
        if getattr(table, key) is not None:
            raise InputError("belongs to kind lyapunov", file=path, key=key, remedy="drop it, or change the kind")
    if not (table.initial and table.unsafe):
        key = "unsafe" if table.initial else "initial"
        raise InputError("is missing", file=path, key=key, remedy='give inequalities, e.g. ["x^2 + y^2 <= 1"]')
    if dynamics.discrete and table.multiplier is not None:
        raise InputError("has no meaning in discrete time", file=path, key="multiplier", remedy="drop it")
    sets: dict[str, tuple[Node, ...]] = {}
    for key in ("initial", "unsafe"):
        texts = enumerate(getattr(table, key))
        sets[key] = tuple(parse_relation(text, known, file=path, key=f"{key}.{k}") for k, text in texts)
        for node in sets[key]:
            _of_states(node, dynamics, path, key)
    function = None if table.barrier is None else parse(table.barrier, known, file=path, key="barrier")
    _of_states(function, dynamics, path, "barrier")
    multiplier = None if table.multiplier is None else parse(table.multiplier, known, file=path, key="multiplier")
    return Problem(
        dynamics, "barrier", function, None, None, sets["initial"], sets["unsafe"], multiplier, table.expected
    )


def _known(table: _ProblemTable, path: Path) -> dict[str, Node]:
    """Return every name that an expression may use, with its expression."""
    if not table.states:
        raise InputError("is empty", file=path, key="states", remedy="give at least one state with bounds")
    known: dict[str, Node] = {}
    for group in ("states", "parameters", "constants", "definitions"):
        for name, entry in getattr(table, group).items():
            key = f"{group}.{name}"
            if not is_name(name):
                remedy = "use letters, digits and _, begin with a letter, and do not use a name of the grammar"
                raise InputError("is not a name for an expression", file=path, key=key, remedy=remedy)
            if name in known:
                raise InputError("is defined twice", file=path, key=key, remedy="rename one of them")
            match group:
                case "constants":
                    known[name] = number(Fraction(repr(entry)))
                case "definitions":
                    known[name] = parse(entry, known, file=path, key=key)
                case _:
                    known[name] = variable(name)
    return known


def _of_states(node: Node | None, dynamics: Dynamics, path: Path, key: str) -> None:
    for part in ordered(node) if node is not None else ():
        if part.op == "var" and part.name not in dynamics.names:
            raise InputError(
                f"uses the parameter {part.name}", file=path, key=key, remedy="write it with the states alone"
            )
