"""Claims that hold with equality at an equilibrium, on a line, or in a corner: decided exactly."""

from __future__ import annotations

import time
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from surctl.certcheck import check_document
from surctl.certcheck.rules import Rules
from surctl.lyapunov import Dynamics, Stability, State, decide_motion
from surctl.lyapunov.candidates import candidates, invariant, sign_symmetries
from surctl.lyapunov.claims import Power
from surctl.lyapunov.decide import prove_motion
from surctl.lyapunov.equilibrium import linearisation
from surctl.lyapunov.falsified import least_level
from surctl.lyapunov.template import polynomials
from surctl.verification.formula import Node, parse, text_of, variable
from surctl.verification.proving.forms import cases_of, forms_of, statement_of
from surctl.verification.proving.search import BoxTask, search
from surctl.verification.proving.tape import build_tape
from surctl.verification.proving.touching import range_at, touches, vanishes


def _named(texts: dict[str, str], *more: str) -> list[Node]:
    names = {name: variable(name) for name in texts}
    return [parse(text, names) for text in (*texts.values(), *more)]


def _claim(
    rates: dict[str, str],
    function: str,
    level: float,
    *,
    at: tuple[float, ...],
    half: float = 1.5,
    rate: float | None = None,
) -> Stability:
    *nodes, v = _named(rates, function)
    states = tuple(State(name, x - half, x + half, equilibrium=x) for name, x in zip(rates, at, strict=True))
    return Stability(Dynamics("made", "continuous", states, tuple(nodes)), v, level, rate)


@pytest.mark.parametrize(
    ("rates", "function", "at"),
    [
        ({"x": "y", "y": "-0.5*y - (sin(x + pi/3) - sin(pi/3))"}, "x^2 + x*y + 2*y^2", (0.0, 0.0)),
        ({"c": "1 - c - 0.5*exp(25 - 50/t)", "t": "2 - t"}, "(c - 0.5)^2 + 200*(t - 2)^2", (0.5, 2.0)),
    ],
)
def test_a_form_is_exactly_zero_at_an_equilibrium(rates: dict[str, str], function: str, at: tuple[float, ...]) -> None:
    claim = _claim(rates, function, 0.1, at=at)
    statement = statement_of(claim.inequalities([1.0, 1.0], Power(1e-3, 1), Power(1e-3, 1))[-1])
    root = statement.lower[:, None], statement.upper[:, None]
    [case] = cases_of(statement.parts)
    forms = [
        [
            touches(form.numerator, statement.touching, statement.names, root)
            for form in forms_of(one, statement.names, root)
        ]
        for one in (case, replace(case, touching=statement.touching))
    ]
    assert not any(forms[0]) and forms[1][0]
    form = forms_of(replace(case, touching=statement.touching), statement.names, root)[0]
    tapes = [build_tape(statement.names, part) for part in ([form.numerator, *form.denominators], case.constraints)]
    written, box = build_tape(statement.names, statement.parts), (statement.lower, statement.upper)
    assert search(BoxTask(Rules(*tapes, 0.0), written, box), deadline=time.process_time() + 20.0).closed


@pytest.mark.parametrize(
    ("rates", "function", "level", "at"),
    [
        ({"x": "y", "y": "-sin(x) - y"}, "1 - cos(x) + 0.5*y^2", 0.5, (0.0, 0.0)),  # only semidefinite
        ({"x": "2*x - x*y", "y": "-2*y + x*y"}, "x + y - 4 - 2*log(x/2) - 2*log(y/2)", 0.1, (2.0, 2.0)),  # conserved
    ],
)
def test_a_function_that_does_not_change_on_a_line_is_refuted(
    rates: dict[str, str], function: str, level: float, at: tuple[float, ...]
) -> None:
    claim = _claim(rates, function, level, at=at)
    decision = decide_motion(claim, time_limit=10.0)
    assert decision.verdict == "refuted"
    change = claim.dynamics.change(claim.function)
    point = decision.counterexample
    bounds = range_at(change, point)
    assert bounds is not None and max(map(abs, bounds)) < 1e-9
    assert any(value != x for value, x in zip(point.values(), at, strict=True))
    assert not vanishes(change) or "log" in function


def test_flat_directions_give_the_power_of_the_bounds() -> None:
    # V is of order 4 in y, and its decrease of order 6: samples of the box do not show it
    claim = _claim({"x": "-x + y^3", "y": "-x - y^3"}, "2*x^2 + y^4", 1.0, at=(0.0, 0.0))
    decision = prove_motion(claim, time_limit=10.0)
    assert decision.verdict == "proved", decision.reason
    assert [decision.document[key]["power"] for key in ("positive", "decrease")] == [2, 3]


def test_a_decrease_that_is_a_multiple_of_a_constraint_is_proved() -> None:
    # V' + 0.2 V = -2 V (0.9 - V): 0 on the whole boundary of the region
    v = "(x^2 + 0.5*x*y + y^2 + 0.5*y*z + z^2)"
    rates = {name: f"-{name} + {v}*{name}" for name in "xyz"}
    decision = prove_motion(_claim(rates, v, 0.9, at=(0.0, 0.0, 0.0), rate=0.2), time_limit=10.0)
    assert decision.verdict == "proved", decision.reason


def test_neutral_directions_and_sign_symmetries_restrict_the_search() -> None:
    x, y, z = _named({"x": "y*z - x^3", "y": "-y - y*x^2", "z": "-z + x*y"})
    d = Dynamics("made", "continuous", tuple(State(name, -1.0, 1.0) for name in "xyz"), (x, y, z))
    signs = sign_symmetries(d)
    assert sorted(map(tuple, signs)) == [(-1.0, -1.0, 1.0), (-1.0, 1.0, -1.0), (1.0, -1.0, -1.0)]
    template = invariant(polynomials(d, 2, np.ones(3)), np.ones(3), signs)
    assert [text_of(node) for node in template.basis] == ["x^2", "y^2", "z^2"]
    skewed = Dynamics("made", "continuous", d.states, (x, y + parse("x^2", {"x": variable("x")}), z))
    first = next(iter(candidates(skewed, linearisation(skewed), degree=2, seconds=0.5)))
    assert "x*y" not in text_of(first.function) and least_level(skewed, first.function).level > 0


def test_the_touching_values_are_exact() -> None:
    claim = _claim({"x": "-x + 0.6"}, "(x - 0.6)^2", 0.1, at=(0.6,))
    statement = statement_of(claim.inequalities([1.0], Power(1e-3, 1), Power(1e-3, 1))[-1])
    assert statement.touching == {"x": Fraction(3, 5)}
    assert check_document(prove_motion(claim, time_limit=5.0).document).accepted


@pytest.mark.parametrize(("rate", "cause"), [("-x - y", "flat"), ("-x + 0.1*y", "decrease")])
def test_why_no_level_is_possible_is_named(rate: str, cause: str) -> None:
    claim = _claim({"x": "y", "y": rate}, "x^2 + y^2", 1.0, at=(0.0, 0.0))
    assert least_level(claim.dynamics, claim.function).cause == cause
