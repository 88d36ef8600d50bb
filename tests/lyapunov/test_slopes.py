"""Regions that the slope rule proves: limited, uncertain and sampled loops; the search's matrices and vertices."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from surctl.certcheck import check_document
from surctl.certcheck.enclosure import span
from surctl.certcheck.region_exact import inverse
from surctl.certcheck.slope_rows import Rows
from surctl.errors import UnsupportedOperation
from surctl.lyapunov import Bound, Dynamics, Range, Stability, State, decide_motion, find_stability, load_problem, solve
from surctl.lyapunov.equilibrium import linearisation
from surctl.lyapunov.slope_search import Embedding, Family, _Shapes, slope_candidate
from surctl.verification.formula import parse, text_of, variable

LIMITED = """
kind = "lyapunov"
name = "limited"
[definitions]
u = "max(-1, min(1, -x - 1.5*v))"
[states]
x = { rate = "v", lower = -6, upper = 6, unit = "m" }
v = { rate = "m*u", lower = -4, upper = 4, unit = "m/s" }
[parameters]
m = { lower = 0.8, upper = 1.25 }
"""


def dynamics(
    states: dict[str, float], rates: list[str], ranges: dict[str, tuple[float, float]], *, discrete: bool = False
) -> Dynamics:
    known = {name: variable(name) for name in (*states, *ranges)}
    parameters = tuple(Range(name, *ends) for name, ends in ranges.items())
    axes = tuple(State(name, -end, end) for name, end in states.items())
    time = "discrete" if discrete else "continuous"
    return Dynamics("loop", time, axes, tuple(parse(rate, known) for rate in rates), parameters)


CRAFT = dynamics(
    {"x": 2.0, "a": 1.0, "v": 1.0},
    ["v*cos(a)", "-max(-0.5, min(0.5, 2*a + 0.3*x*v))", "p*(max(-1, min(1, -3*x - 2*v)) - v*abs(v)) - q*v"],
    {"p": (0.5, 1.5), "q": (0.5, 1.0)},
)


def test_a_small_region_in_a_large_box_is_a_start_of_the_search() -> None:
    small = dynamics({"x": 1.0}, ["-x + 6000*x^3"], {})  # stable within 0.0129
    candidate = slope_candidate(small, linearisation(small), None, seconds=1.0)
    assert candidate is not None and candidate.volume > 0.005


def test_a_limited_uncertain_loop_is_proved_where_the_limit_acts(tmp_path: Path) -> None:
    file = tmp_path / "limited.toml"
    file.write_text(LIMITED)
    solution = solve(load_problem(file), first=True)
    assert solution.verdict == "proved"
    claim = solution.decision.claim  # type: ignore[union-attr]
    assert isinstance(claim, Stability)
    assert claim.dynamics.box[1][0] > 3.0  # at x = 1, the command is at its limit
    assert (
        "  proved by secant slopes: a matrix inequality at every vertex of the ranges of the slopes" in solution.lines()
    )
    assert solution.to_dict()["rule"].startswith("secant slopes")
    assert check_document(solution.document).accepted


def test_a_sampled_limited_loop_is_proved() -> None:
    # x'' = u, sampled with a hold every 0.2 s
    limited = "max(-1, min(1, -x - 1.5*v))"
    d = dynamics(
        {"x": 5.0, "v": 3.0}, [f"x + 0.2*v + 0.02*m*{limited}", f"v + 0.2*m*{limited}"], {"m": (0.9, 1.1)},
        discrete=True,
    )  # fmt: skip
    result = find_stability(d, first=True)
    assert result.verdict == "proved"
    assert result.label == "quadratic by the slope rule"
    assert result.claim is not None
    assert result.claim.dynamics.box[1][0] > 1.5
    assert result.decision is not None
    assert result.decision.rule.startswith("secant slopes")


def test_a_stated_function_and_a_bound_are_proved() -> None:
    d = dynamics({"x": 2.0}, ["-max(-1, min(1, 2*x)) + w"], {"w": (-0.1, 0.1)})
    v = parse("x^2", {"x": variable("x")})
    bound = decide_motion(Bound(d, v, 2.25, 0.5, 0.0, {"w": 4.0}))
    assert (bound.verdict, bound.rule[:6]) == ("proved", "secant")
    assert decide_motion(Bound(d, v, 2.25, 1.0, 0.0, {"w": 0.1})).verdict != "proved"
    still = dynamics({"x": 2.0}, ["-max(-1, min(1, 2*x))"], {})
    for level, rate, verdict in ((2.25, 1.3, "proved"), (2.25, 1.4, "refuted"), (3.9, None, "proved")):
        assert decide_motion(Stability(still, v, level, rate)).verdict == verdict


def test_other_rules_name_themselves() -> None:
    cubic = dynamics({"x": 2.0}, ["-x + x^3"], {})
    decision = decide_motion(Stability(cubic, parse("x^2", {"x": variable("x")}), 0.9))
    assert decision.rule in ("sums of squares", "interval boxes", "interval boxes and sums of squares")
    assert decide_motion(Stability(cubic, parse("x^2", {"x": variable("x")}), 1.1)).rule == ""


def test_near_the_equilibrium_the_matrices_are_the_linearisations() -> None:
    linear = linearisation(CRAFT)
    family = Family(Embedding(CRAFT, 1e-14 * np.diag([1.0, 1 / 2, 1 / 3])[None]))
    every = np.array(list(product([False, True], repeat=len(family.low))))
    matrices = family.vertices(every)
    for a in linear.matrices:
        assert np.abs(matrices - a).max(axis=(1, 2)).min() < 1e-6


def test_the_sampled_ranges_of_slopes_are_those_that_the_checker_encloses() -> None:
    p = [[Fraction(3), Fraction(0), Fraction(1)], [Fraction(0), Fraction(2), Fraction(0)],
         [Fraction(1), Fraction(0), Fraction(1)]]  # fmt: skip
    cover = inverse(p)
    exact = Rows(
        [v.name for v in CRAFT.variables], [span(v.lower, v.upper) for v in CRAFT.variables],
        [text_of(rate) for rate in CRAFT.rates], [cover], [Fraction(0)] * 3, Fraction(1),
    )  # fmt: skip
    sampled = Embedding(CRAFT, np.array([cover], dtype=float))
    ends, own = (np.array(rows.slopes, dtype=float) for rows in (exact, sampled))
    width = np.diff(ends, axis=1)
    assert np.all(np.abs(own - ends) <= 0.02 * width)
    assert [[set(entry.poly) for entry in row] for row in sampled.rows] == [
        [set(entry.poly) for entry in row] for row in exact.rows
    ]


@pytest.mark.parametrize("discrete", [False, True])
def test_the_worst_vertex_is_found(discrete: bool) -> None:
    rates = [text_of(rate) for rate in CRAFT.rates]
    if discrete:
        rates = [f"{s.name} + 0.1*({rate})" for s, rate in zip(CRAFT.states, rates, strict=True)]
    ranges = {w.name: (w.lower, w.upper) for w in CRAFT.parameters}
    d = dynamics({s.name: s.upper for s in CRAFT.states}, rates, ranges, discrete=discrete)
    shapes = _Shapes(d, 0.01)
    p = np.array([[3.0, 0.2, 1.0], [0.2, 2.0, 0.1], [1.0, 0.1, 1.0]])
    family = Family(Embedding(d, np.linalg.inv(p)[None] * 0.5))
    every = np.array(list(product([False, True], repeat=len(family.low))))
    root = np.linalg.inv(np.linalg.cholesky(p))
    least = np.linalg.eigvalsh(root @ shapes.losses(family.vertices(every), p) @ root.T)[:, 0].min()
    found, vertices = shapes.worst(family, p)
    assert found[0] == pytest.approx(least, rel=1e-9)
    own = np.linalg.eigvalsh(root @ shapes.losses(family.vertices(vertices[:1]), p) @ root.T)[0, 0]
    assert own == pytest.approx(least, rel=1e-9)


def test_a_candidate_is_larger_than_the_function_of_the_linearisation() -> None:
    first = slope_candidate(CRAFT, linearisation(CRAFT), None, seconds=0.0)
    last = slope_candidate(CRAFT, linearisation(CRAFT), None, seconds=3.0)
    assert first is not None
    assert last is not None
    assert last.volume > 1.5 * first.volume


def test_rates_that_the_rule_does_not_cover_leave_it_out() -> None:
    d = dynamics({"x": 1.0, "y": 1.0}, ["-x + abs(x)*0.1", "-y + atan2(x*y, y - 0.5)*0"], {})
    with pytest.raises(UnsupportedOperation):
        Embedding(d, np.eye(2)[None])
    assert slope_candidate(d, linearisation(d), None, seconds=1.0) is None
