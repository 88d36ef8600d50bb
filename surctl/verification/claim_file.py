"""Files of kind `claim`: read a claim from its keys, and write any claim of the library as such a file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Literal

import casadi as ca
import numpy as np
from pydantic import Field, StrictFloat, StrictStr

from surctl.errors import InputError, mistakes_in
from surctl.files import Strict, load_model, quoted, require_doubles
from surctl.verification.claim import Claim, Motion, Variable
from surctl.verification.formula import (
    Node,
    Statement,
    from_casadi,
    is_name,
    number,
    parse,
    parse_relation,
    reread,
    text_of,
    to_casadi,
    variable,
)
from surctl.verification.proving import statement_of


class VariableTable(Strict):
    """A variable of a file: its bounds, unit and meaning."""

    lower: StrictFloat
    upper: StrictFloat
    unit: StrictStr = "1"
    meaning: StrictStr = ""


class _MotionTable(Strict):
    watched: StrictStr
    name: StrictStr
    unit: StrictStr
    duration: StrictFloat = 0.5
    rates: dict[str, StrictStr]


class _ClaimTable(Strict):
    kind: Literal["claim"]
    name: StrictStr = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,59}$")
    statement: StrictStr = ""
    equation: StrictStr = ""
    errata: tuple[StrictStr, ...] = ()
    expected: Literal["proved", "refuted", "not refuted"] = "proved"
    unit: StrictStr = "1"
    left: StrictStr
    right: StrictStr = "0"
    constraints: tuple[StrictStr, ...] = ()
    tolerance: StrictFloat = Field(default=0.0, ge=0.0, le=1e-3)
    constants: dict[str, StrictFloat] = Field(default_factory=dict)
    variables: dict[str, VariableTable]
    witnesses: tuple[dict[str, StrictFloat], ...] = ()
    motion: _MotionTable | None = None


def load_claim(path: Path) -> Claim:
    """Load a claim from a TOML file.

    ::

        kind = "claim"
        name = "sway"
        left = "y_e*u*sin(atan2(-y_e, ahead))"
        right = "0"                               # default; left <= right is claimed
        unit = "m^2/s"
        constraints = ["y_e^2 <= 4*ahead^2"]      # the domain of the claim; each constraint has one <= or >=
        expected = "proved"                       # default; or "refuted"; or "not refuted": no counterexample
        [constants]
        ahead = 0.5
        [variables]
        y_e = { lower = -2, upper = 2, unit = "m", meaning = "cross-track error" }
        u = { lower = 0.05, upper = 0.25, unit = "m/s" }

    Expressions have numbers, names, `pi`, + - * / ^, parentheses, and the functions abs, acos, asin, atan, atan2, cos,
    cosh, exp, log (natural), max, min, select, sin, sinh, sqrt, tan and tanh; select(a, b, x, y) is x if a <= b, and y
    otherwise. An exponent is a constant, such as 2, -1.5, (1/3) or the name of a constant. A power with a fractional
    exponent is defined for positive numbers, and for 0 if the exponent is positive. The texts are the statement, with
    exactly the numbers that are written. A point of the domain at which an expression is not defined (a logarithm of 0,
    a pole of tan, 0/x at 0) refutes the claim: exclude it by bounds or constraints.

    Optional keys: `statement`, `equation`, `errata`, `tolerance` (the share of the larger side by which left may exceed
    right, as a measure of rounding; default 0), `witnesses` (points, each with a value for every variable) and the
    table `[motion]` (`rates` by variable, `watched`, `name`, `unit`, `duration`). The motion holds the differential
    equations with which a counterexample is simulated. Units are printed but not converted: use SI units.

    Raises:
        InputError: the file is not a valid claim; the error names file, key, token and column, and the remedy.

    Example:
        >>> from pathlib import Path
        >>> from surctl.verification import load_claim, decide
        >>> _ = Path("drag.toml").write_text('''
        ... kind = "claim"
        ... name = "drag"
        ... left = "-(2*abs(u) + 8)*u^2"
        ... unit = "W"
        ... [variables]
        ... u = { lower = -0.3, upper = 0.3, unit = "m/s" }
        ... ''')
        >>> claim = load_claim(Path("drag.toml"))
        >>> claim.statement, decide(claim).verdict
        ('-(2*abs(u) + 8)*u^2 <= 0', 'proved')
    """
    table = load_model(path, _ClaimTable)
    require_doubles(path)
    names = _checked_names(table, path)
    known: dict[str, Node] = {name: variable(name) for name in names}
    known |= {name: number(Fraction(repr(value))) for name, value in table.constants.items()}
    symbols = {name: ca.SX.sym(name) for name in names}

    def read(text: str, key: str) -> ca.SX:
        return to_casadi(parse(text, known, file=path, key=key), symbols)

    rows = [parse_relation(text, known, file=path, key=f"constraints.{k}") for k, text in enumerate(table.constraints)]
    sides = [parse(table.left, known, file=path, key="left"), parse(table.right, known, file=path, key="right")]
    # what a reader of the certificate obtains from its texts
    parts = [reread(node, tuple(names)) for node in (*sides, *rows)]
    lower, upper = np.array([(v.lower, v.upper) for v in table.variables.values()], dtype=float).T
    exact = Statement(tuple(names), lower, upper, parts[0], parts[1], tuple(parts[2:]))
    left, right, *casadi_rows = (to_casadi(node, symbols) for node in parts)
    statement = table.statement or f"{table.left} <= {table.right}"
    with mistakes_in(path):
        return Claim(
            table.name, statement, table.equation, table.errata, table.expected,
            tuple(
                Variable(name, symbols[name], entry.unit, entry.lower, entry.upper, entry.meaning)
                for name, entry in table.variables.items()
            ),
            left, right, table.unit, ca.vertcat(ca.SX(0, 1), *casadi_rows), tuple(table.witnesses),
            _motion(table, read), table.tolerance, paper=False, exact=exact,
        )  # fmt: skip


def _checked_names(table: _ClaimTable, path: Path) -> list[str]:
    if not table.variables:
        raise InputError("is empty", file=path, key="variables", remedy="give at least one variable with bounds")
    for kind, group in (("variables", table.variables), ("constants", table.constants)):
        for name in group:
            if not is_name(name):
                remedy = "use letters, digits and _, begin with a letter, and do not use a name of the grammar"
                raise InputError("is not a name for an expression", file=path, key=f"{kind}.{name}", remedy=remedy)
    both = sorted(set(table.variables) & set(table.constants))
    if both:
        raise InputError("is also a variable", file=path, key=f"constants.{both[0]}", remedy="rename one of them")
    for name, entry in table.variables.items():
        if entry.lower > entry.upper:
            raise InputError(
                "has its lower bound above the upper one",
                file=path, key=f"variables.{name}", value=[entry.lower, entry.upper], remedy="exchange them",
            )  # fmt: skip
    return list(table.variables)


def _motion(table: _ClaimTable, read: Callable[[str, str], ca.SX]) -> Motion | None:
    if table.motion is None:
        return None
    m = table.motion
    rates = {name: read(text, f"motion.rates.{name}") for name, text in m.rates.items()}
    return Motion(rates, read(m.watched, "motion.watched"), m.name, m.unit, m.duration)


def write_claim(claim: Claim) -> str:
    r"""Return the claim as the text of a TOML claim file, from which `load_claim` restores the claim.

    Raises:
        UnsupportedOperation: the claim uses an operation that the claim grammar does not have.
        InputError: a name in the claim is not a valid name of the claim grammar.

    Example:
        >>> from surctl.marine.verification import claims
        >>> from surctl.verification.claim_file import write_claim
        >>> [claim] = claims(names=["m-norm-corrected"])
        >>> print(*write_claim(claim).splitlines()[1:5], sep="\n")
        name = "m-norm-corrected"
        statement = "V̇1 ≤ −λ_min(M)‖e‖² ≤ 0 where U_h ≥ 0"
        equation = "(12)"
        errata = ["E8", "E9"]
    """
    for v in claim.variables:
        if not is_name(v.name):
            raise InputError("is not a name for an expression", key=f"{claim.name}.{v.name}", remedy="rename it")
    stated = statement_of(claim)
    lines = [
        'kind = "claim"',
        f"name = {quoted(claim.name)}",
        f"statement = {quoted(claim.statement)}",
        f"equation = {quoted(claim.equation)}",
        f"errata = [{', '.join(quoted(e) for e in claim.errata)}]",
        f"expected = {quoted(claim.expected)}",
        f"unit = {quoted(claim.unit)}",
        f"left = {quoted(text_of(stated.left))}",
        f"right = {quoted(text_of(stated.right))}",
        f"constraints = [{', '.join(quoted(text_of(g) + ' <= 0') for g in stated.constraints)}]",
        f"tolerance = {claim.tolerance!r}",
        f"witnesses = [{', '.join(_inline({k: repr(float(x)) for k, x in w.items()}) for w in claim.witnesses)}]",
        "",
        "[variables]",
        *(_variable_line(v) for v in claim.variables),
    ]
    if claim.motion is not None:
        lines += ["", *_motion_lines(claim, claim.motion)]
    return "\n".join(lines) + "\n"


def _variable_line(v: Variable) -> str:
    entries = {"lower": repr(float(v.lower)), "upper": repr(float(v.upper)), "unit": quoted(v.unit)}
    return f"{v.name} = {_inline(entries | {'meaning': quoted(v.meaning)})}"


def _motion_lines(claim: Claim, motion: Motion) -> Iterable[str]:
    names = [v.name for v in claim.variables]
    watched, *rates = (text_of(n) for n in from_casadi(claim.symbols, names, [motion.watched, *motion.rates.values()]))
    yield "[motion]"
    yield f"watched = {quoted(watched)}"
    yield f"name = {quoted(motion.name)}"
    yield f"unit = {quoted(motion.unit)}"
    yield f"duration = {float(motion.duration)!r}"
    yield f"rates = {_inline(dict(zip(motion.rates, map(quoted, rates), strict=True)))}"


def _inline(entries: Mapping[str, str]) -> str:
    return "{ " + ", ".join(f"{k} = {v}" for k, v in entries.items()) + " }"
