"""The slope rule: true decreases are accepted, and whatever is accepted holds at samples of the region."""

from __future__ import annotations

import random
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise, product
from math import prod
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

from surctl.certcheck import Rejected, check_document, patience, seal
from surctl.certcheck.region_exact import inverse
from surctl.certcheck.slope_rows import Number
from surctl.certcheck.slopes import (
    Decrease,
    _joined,
    _vertices,
    check_decrease,
    is_definite,
    quadratic_form,
    require_in_box,
)
from surctl.verification.formula import parse, values_of, variable

TERMS = (
    "{a}*sin({z})", "{a}*{z}*abs({z})", "max(-{b}, min({b}, {z}))", "{a}*tanh({z})", "{a}*{z}^3", "{a}*{z}*{y}",
    "{a}*{z}*cos({y})", "{a}*{z}/(1 + {y}^2)", "{a}*{z}*p", "{a}*{z}*p^2", "min({z}, {b}*p + {y})", "{a}*{z}*exp({y})",
    "{a}*(sqrt(1 + {z}^2) - 1)", "{a}*{z}/p", "{a}*atan({z})", "max({z}, -{b}/p)", "{a}*({z} + {y})^2",
    "{a}*p*{y}*sin({z})", "{a}*log(1.5 + tanh({z})) - {a}*log(1.5)", "{a}*abs({z} - {b}) - {a}*{b}",
    "{a}*sin(p)*{z}", "{a}*atan2({z}, 2 + cos({y}))",
)  # fmt: skip
P_RANGE, W_RANGE = (0.8, 1.25), (-0.3, 0.3)


def exact(x: float) -> Fraction:
    return Fraction(repr(float(x)))


def matrix(p: NDArray[np.float64]) -> list[list[Fraction]]:
    return [[exact(x) for x in row] for row in p]


def decrease(p: NDArray[np.float64], level: float, rate: float, **further: object) -> Decrease:
    settings = {"centre": [Fraction(0)] * len(p), "gains": {}, "constant": Fraction(0)} | further
    return Decrease(p=matrix(p), level=exact(level), rate=exact(rate), **settings)


def accepted(
    names: str,
    rates: list[str],
    box: list[tuple[float, float]],
    needed: Decrease,
    *,
    discrete: bool = False,
) -> bool:
    try:
        check_decrease(names.split(), box, rates, needed, discrete=discrete)
    except Rejected:
        return False
    return True


def drawn(seed: int) -> tuple[list[str], NDArray[np.float64], bool, bool]:
    """Return rates of a random stable system, P of its linear part, and whether it is discrete and disturbed."""
    random = np.random.default_rng(seed)
    n, discrete = int(random.integers(1, 4)), bool(random.random() < 0.25)
    names = [f"x{k}" for k in range(n)]
    a = random.normal(size=(n, n))
    if discrete:
        a *= random.uniform(0.3, 0.9) / np.abs(np.linalg.eigvals(a)).max()
    else:
        a -= (np.linalg.eigvals(a).real.max() + random.uniform(0.3, 1.5)) * np.eye(n)
    rates = []
    for row in a:
        text = " + ".join(f"({x:.3g})*{name}" for x, name in zip(row, names, strict=True))
        for _ in range(int(random.integers(0, 3))):
            mixed = f"({random.normal():.2g}*{random.choice(names)} + {random.normal():.2g}*{random.choice(names)})"
            z = mixed if random.random() < 0.5 else random.choice(names)
            term = str(random.choice(TERMS))
            text += " + " + term.format(
                a=f"({0.5 * random.normal():.2g})", b=f"{random.uniform(0.2, 2):.2g}", z=z, y=random.choice(names)
            )
        rates.append(text + (f" + {0.2 * random.normal():.2g}*w" if random.random() < 0.2 else ""))
    one = np.eye(n)
    p = solve_discrete_lyapunov(a.T, one) if discrete else solve_continuous_lyapunov(a.T, -one)
    rounded = np.array([[float(f"{x:.5g}") for x in row] for row in (p + p.T) / 2])
    return rates, rounded, discrete, any("*w" in rate for rate in rates)


def excess(
    rates: list[str], p: NDArray[np.float64], level: float, rate: float, gain: float, *, discrete: bool, seed: int
) -> float:
    """Return the largest sampled (change of V) − right side on {V ≤ level}, relative to the change."""
    random, n, count = np.random.default_rng(seed), len(p), 5_000
    x = random.normal(size=(n, count))
    x *= np.sqrt(level / np.einsum("in,ij,jn->n", x, p, x)) * np.where(
        random.random(count) < 0.5, 1, random.random(count)
    )
    x = x[:, np.all(np.abs(x) <= 3, axis=0)]
    ends = random.choice(P_RANGE, x.shape[1])
    varying = np.where(random.random(x.shape[1]) < 0.4, random.uniform(*P_RANGE, x.shape[1]), ends)
    w = random.uniform(*W_RANGE, x.shape[1])
    at = {f"x{k}": row for k, row in enumerate(x)} | {"p": varying, "w": w}
    f = values_of([parse(text, {name: variable(name) for name in at}) for text in rates], at)
    v = np.einsum("in,ij,jn->n", x, p, x)
    change = np.einsum("in,ij,jn->n", f, p, f) - v if discrete else 2 * np.einsum("in,ij,jn->n", x, p, f)
    return float(((change + rate * v - gain * w**2) / (1 + np.abs(change))).max())


def test_what_is_accepted_holds_at_samples() -> None:
    shown = 0
    for seed in range(6):
        rates, p, discrete, disturbed = drawn(seed)
        names = " ".join([*(f"x{k}" for k in range(len(p))), "p", "w"])
        box = [(-3.0, 3.0)] * len(p) + [P_RANGE, W_RANGE]
        top = min(9 / x for x in np.diag(np.linalg.inv(p)))
        for share in (0.3, 0.01):
            gains = {"w": Fraction(2)} if disturbed else {}
            level = float(f"{share * top:.4g}")
            if accepted(names, rates, box, decrease(p, level, 0.05, gains=gains), discrete=discrete):
                shown += 1
                assert excess(rates, p, level, 0.05, 2.0, discrete=discrete, seed=seed) <= 1e-9, (seed, rates, level)
                break
    assert shown >= 3  # the rule is of use


P2 = np.array([[1.5, 0.5], [0.5, 1.0]])  # of x'' = −x − x'
WIDE = [(-10.0, 10.0), (-10.0, 10.0)]


def test_a_linear_system_is_proved_up_to_its_rate() -> None:
    # V' = −x² − v² for P2, so the largest rate is 1/λ_max(P2)
    largest = 1 / float(np.linalg.eigvalsh(P2)[1])
    rates = ["v", "-x - v"]
    assert accepted("x v", rates, WIDE, decrease(P2, 1.0, 0.999 * largest))
    assert not accepted("x v", rates, WIDE, decrease(P2, 1.0, 1.001 * largest))


@pytest.mark.parametrize(
    ("limit", "good"),
    [(2.0, True), (0.9, True), (0.1, False)],
)
def test_a_saturated_command_is_proved_while_the_limit_is_hardly_active(limit: float, good: bool) -> None:
    assert accepted("x v", ["v", f"max(-{limit}, min({limit}, -x - v))"], WIDE, decrease(P2, 1.0, 0.01)) is good


@pytest.mark.parametrize(("reach", "good"), [(1.0, True), (3.0, False)])
def test_the_region_of_a_cubic_ends_where_the_rate_changes_its_sign(reach: float, good: bool) -> None:
    # x' = −x + x³/4 decreases for |x| < 2
    one = np.array([[1.0]])
    assert accepted("x", ["-x + 0.25*x^3"], [(-9.0, 9.0)], decrease(one, reach**2, 0.01)) is good


def test_the_range_of_the_box_limits_the_region() -> None:
    one = np.array([[1.0]])
    assert accepted("x", ["-x + 0.25*x^3"], [(-1.0, 1.0)], decrease(one, 9.0, 0.01))  # of {V <= 9} within the box


@pytest.mark.parametrize(("upper", "good"), [(0.9, True), (1.1, False)])
def test_a_parameter_takes_every_value_of_its_range(upper: float, good: bool) -> None:
    one = np.array([[1.0]])
    assert accepted("x p", ["-x + p*x"], [(-1.0, 1.0), (-1.0, upper)], decrease(one, 0.5, 0.01)) is good


@pytest.mark.parametrize(("rate", "good"), [("-x + p*x*p", True), ("-x + 2*p*x*p", False), ("-x*(1 - p*p*p)", True)])
def test_a_parameter_that_occurs_twice_is_still_covered(rate: str, good: bool) -> None:
    one = np.array([[1.0]])
    assert accepted("x p", [rate], [(-1.0, 1.0), (-0.9, 0.9)], decrease(one, 0.5, 0.01)) is good


def test_an_equilibrium_that_moves_with_a_parameter_is_refused() -> None:
    one = np.array([[1.0]])
    with pytest.raises(Rejected, match="do not rest at the equilibrium"):
        check_decrease(["x", "p"], [(-1, 1), (0.1, 0.2)], ["p - x"], decrease(one, 0.5, 0.1), discrete=False)
    assert accepted("x p", ["(1 + p) - x - (p + 1)"], [(-1.0, 1.0), (0.1, 0.2)], decrease(one, 0.5, 0.1))


def test_every_state_must_rest_at_the_equilibrium() -> None:
    needed = decrease(np.eye(2), 0.5, 0.1)
    assert not accepted("x y p", ["p - x", "-y"], [(-1.0, 1.0), (-1.0, 1.0), (0.1, 0.2)], needed)


@pytest.mark.parametrize("digits", [-200, 200])
@pytest.mark.parametrize(("level", "good"), [(1, True), (5, False)])
def test_units_do_not_change_the_verdict(digits: int, level: int, good: bool) -> None:
    one = f"1e{digits}"
    rates = ["v", f"{one}*max(-1, min(1, (-x - v)/{one}))"]
    box, needed = [(-3.0 * float(one), 3.0 * float(one))] * 2, decrease(P2, level, 0.0)
    for unit in (Fraction(1), Fraction(10) ** -400, Fraction(10) ** 400):
        p = [[unit * x for x in row] for row in needed.p]
        scaled = replace(needed, p=p, level=unit * level * Fraction(one) ** 2)
        assert accepted("x v", rates, box, scaled) is good


@pytest.mark.parametrize(
    ("factor", "power", "good"),
    [("1e40", (800.0, 801.0), True), ("1e150", (800.0, 801.0), False),
     ("1.3e23", (744.1, 744.1001), True), ("1.87e23", (744.1, 744.1001), False), ("-1e-300", (1.0, 1000.0), True)],
)  # fmt: skip
def test_a_slope_that_no_double_represents_is_not_rounded(factor: str, power: tuple[float, float], good: bool) -> None:
    # exp(-744.1) lies between two doubles that differ by a factor of 2
    box = [(-1.0, 1.0), power, (1e300, 1.0001e300)]
    assert accepted("x p q", [f"-x + {factor}*q*exp(-p)*x"], box, decrease(np.eye(1), 0.5, 0.0)) is good


@pytest.mark.parametrize("outer", [0, 2, 5])
def test_the_values_at_all_vertices_are_those_of_the_polynomials(outer: int) -> None:
    rng = np.random.default_rng(outer)
    terms = [tuple(np.flatnonzero(rng.random(5) < 0.4).tolist()) for _ in range(12)]
    table = {term: rng.normal(size=(3, 1)) for term in terms}
    slopes = [(k, *sorted(rng.normal(size=2).tolist())) for k in range(5)]
    own = np.hstack(list(_vertices(table, slopes, outer)))
    every = [
        sum(numbers[:, 0] * np.prod([at[k] for k in term]) for term, numbers in table.items())
        for at in product(*(ends[1:] for ends in slopes))
    ]
    assert own.shape == (3, 2**5)
    assert np.allclose(np.sort(own, axis=1), np.sort(np.transpose(every), axis=1))


def test_joined_slopes_take_the_values_of_the_slopes_they_replace() -> None:
    rng = random.Random(4)
    for _ in range(20):
        x, y, z, u = (Fraction(rng.randint(-2, 2)) for _ in range(4))
        # slopes 0 and 1 occur in x a + y b + z a b only; slope 2 multiplies it, slope 3 stands alone
        shape = {term: size for term, size in (((0,), x), ((1,), y), ((0, 1), z)) if size}
        polys = [
            {tuple(sorted([*term, 2])): 3 * size for term, size in shape.items()} | {(3,): Fraction(1)},
            {term: -size for term, size in shape.items()} | {(): u},
            {(2,): Fraction(1), (3,): Fraction(2)},
        ]
        ranges = {k: tuple(sorted((Fraction(rng.randint(-4, 4)), Fraction(rng.randint(-4, 4))))) for k in range(4)}
        own = _joined(polys, known := dict(ranges))

        def hull(all_of: list[dict[tuple[int, ...], Fraction]], ends: dict[int, tuple[Fraction, Fraction]]) -> object:
            used = sorted({k for poly in all_of for term in poly for k in term})
            return {
                tuple(sum(size * prod(at[k] for k in term) for term, size in poly.items()) for poly in all_of)
                for values in product(*(ends[k] for k in used)) for at in [dict(zip(used, values, strict=True))]
            }  # fmt: skip

        before, after = hull(polys, ranges), hull(own, known)
        assert after <= before
        # each coordinate has the same extreme values, so nothing is left out
        assert [(min(c), max(c)) for c in zip(*after, strict=True)] == [
            (min(c), max(c)) for c in zip(*before, strict=True)
        ]
        if sum(size != 0 for size in (x, y, z)) > 1 or z:
            assert len({k for poly in own for term in poly for k in term}) < 4


def test_a_factorisation_with_nan_proves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    needed = decrease(np.eye(1), 0.5, 0.1)
    assert accepted("x", ["-x"], [(-1.0, 1.0)], needed)
    for value in (np.nan, np.inf, 0.0, -1.0):
        monkeypatch.setattr("surctl.certcheck.slopes._vertices", lambda *_, value=value: iter([np.full((1, 4), value)]))
        assert not accepted("x", ["-x"], [(-1.0, 1.0)], needed)


def test_the_matrices_count_against_the_memory_of_a_check(monkeypatch: pytest.MonkeyPatch) -> None:
    names = [f"x{k}" for k in range(20)]
    needed, box, rates = decrease(np.eye(20), 0.5, 0.1), [(-1.0, 1.0)] * 20, [f"0.5*{x}" for x in names]
    with patience.patient(60):
        check_decrease(names, box, rates, needed, discrete=True)
    monkeypatch.setattr(patience, "MEMORY", 80_000)
    with patience.patient(60), pytest.raises(Rejected, match="memory"):
        check_decrease(names, box, rates, needed, discrete=True)


@pytest.mark.parametrize(("constant", "good"), [(0.0225, True), (0.0025, False)])
def test_a_constant_disturbance_counts_against_the_constant(constant: float, good: bool) -> None:
    # 2 x (p − x) <= −x² + p²
    needed = decrease(np.array([[1.0]]), 0.5, 1.0, constant=Fraction(constant))
    assert accepted("x p", ["p - x"], [(-1.0, 1.0), (-0.1, 0.1)], needed) is good


@pytest.mark.parametrize(("gain", "good"), [(1.001, True), (0.999, False)])
def test_the_gain_of_a_disturbance(gain: float, good: bool) -> None:
    # 2 x (w − x) <= −x² + w², which is an equality at x = w
    needed = decrease(np.array([[1.0]]), 0.5, 1.0, gains={"w": Fraction(gain)})
    assert accepted("x w", ["w - x"], [(-1.0, 1.0), (0.5, 0.9)], needed) is good


@pytest.mark.parametrize(("factor", "good"), [(0.8, True), (-0.8, True), (0.96, False), (-1.2, False)])
def test_discrete_time(factor: float, good: bool) -> None:
    # V+ = factor² V <= (1 − 0.1) V
    one = np.array([[1.0]])
    assert accepted("x", [f"({factor})*x"], [(-1.0, 1.0)], decrease(one, 0.5, 0.1), discrete=True) is good


@pytest.mark.parametrize(
    "rate", ["-x + log(x)", "-x + sqrt(x) - sqrt(x)", "-x + x/x - 1", "-2*x + select(x, 0, x, -x)"]
)
def test_expressions_that_are_not_defined_or_jump_are_refused(rate: str) -> None:
    assert not accepted("x", [rate], [(-1.0, 1.0)], decrease(np.array([[1.0]]), 0.5, 0.1))


def test_the_quadratic_form_is_read_exactly() -> None:
    assert quadratic_form(["x", "y"], "0.1*x^2 + 0.3*(x - y)^2", [Fraction(0)] * 2) == [
        [Fraction(4, 10), Fraction(-3, 10)], [Fraction(-3, 10), Fraction(3, 10)],
    ]  # fmt: skip
    assert quadratic_form(["x"], "2*(x - 0.5)^2", [Fraction(1, 2)]) == [[Fraction(2)]]


@pytest.mark.parametrize(
    ("function", "message"),
    [("x^2 + y^4", "quadratic"), ("x^2 + y^2 + 0.1", "about"), ("x^2 + y^2 + x", "about"), ("x^2 - y^2", "positive"),
     ("x^2", "positive"), ("(x^2 + y^2)/(1 + x^2)", "quadratic"), ("x^2 + y^2 + abs(x)", "about"),
     ("x^2 + y^2 + 0*log(x)", "undefined"), ("sqrt(x)^4 + y^2", "undefined")],
)  # fmt: skip
def test_other_functions_are_refused(function: str, message: str) -> None:
    with pytest.raises(Rejected, match=message):
        quadratic_form(["x", "y"], function, [Fraction(0)] * 2)


def test_at_most_20_states_are_read() -> None:
    for count in (20, 21):
        names = [f"x{k}" for k in range(count)]
        text = " + ".join(f"{name}^2" for name in names)
        if count == 20:
            assert quadratic_form(names, text, [Fraction(0)] * count)[19][19] == 1
        else:
            with pytest.raises(Rejected, match="more than 20 states"):
                quadratic_form(names, text, [Fraction(0)] * count)


@pytest.mark.parametrize(
    ("level", "box", "message"),
    [
        (1, [(-0.5, 1.5), (-2, 2)], ""), (1, [(-0.49, 1.5), (-2, 2)], "border"), (1, [(-0.5, 1.49), (-2, 2)], "border"),
        (1, [(-2, 2), (-0.9, 2)], "border"), (1, [(-2, 2), (-2, 0.9)], "border"), (0, [(-2, 2), (-2, 2)], "positive"),
        (-1, [(-2, 2), (-2, 2)], "positive"), (1, [(0.6, 3), (-2, 2)], "border"), (1, [(3, 6), (-2, 2)], "border"),
    ],
)  # fmt: skip
def test_the_region_lies_in_the_box(level: int, box: list[tuple[float, float]], message: str) -> None:
    p, centre = [[Fraction(1), Fraction(0)], [Fraction(0), Fraction(1)]], [Fraction(1, 2), Fraction(0)]
    if not message:
        require_in_box(inverse(p), centre, Fraction(level), box)
        return
    with pytest.raises(Rejected, match=message):
        require_in_box(inverse(p), centre, Fraction(level), box)


def test_a_function_that_does_not_change_is_no_decrease() -> None:
    one = np.array([[1.0]])
    for discrete, rest, less in ((False, "0*x", "-1e-9*x"), (True, "x", "(1 - 1e-9)*x")):
        assert not accepted("x", [rest], [(-1.0, 1.0)], decrease(one, 0.5, 0.0), discrete=discrete)
        assert accepted("x", [less], [(-1.0, 1.0)], decrease(one, 0.5, 0.0), discrete=discrete)


def test_a_negative_constant_is_refused() -> None:
    with pytest.raises(Rejected, match="negative"):
        check_decrease(
            ["x"], [(-1, 1)], ["-9*x"], decrease(np.eye(1), 0.5, 0.1, constant=Fraction(-1, 100)), discrete=False
        )


@pytest.mark.parametrize(("count", "good"), [(20, True), (21, False)])
def test_at_most_20_slopes_are_tested(count: int, good: bool) -> None:
    names = ["x", *(f"p{k}" for k in range(count))]
    rate = f"-x*({count + 1} + " + " + ".join(f"{a}*{b}" for a, b in pairwise(names[1:])) + ")"
    box = [(-1.0, 1.0)] * (count + 1)
    if good:
        check_decrease(names, box, [rate], decrease(np.eye(1), 0.5, 0.1), discrete=False)
        tight = rate.replace(f"({count + 1} ", f"({count - 1}.05 ")
        assert not accepted(" ".join(names), [tight], box, decrease(np.eye(1), 0.5, 0.11))
        return
    with pytest.raises(Rejected, match="21 slopes, more than 20"):
        check_decrease(names, box, [rate], decrease(np.eye(1), 0.5, 0.1), discrete=False)


@pytest.mark.parametrize(("digits", "good"), [(14, True), (20, False)])
def test_the_error_of_a_number_counts(digits: int, good: bool) -> None:
    # x' = −x/3, so that V decays at the rate 2/3; slopes are intervals of doubles
    needed = replace(decrease(np.eye(1), 0.5, 0.5), rate=Fraction(2, 3) - Fraction(1, 10**digits))
    box = [(-1.0, 1.0)]
    assert accepted("x", ["-x + (sin(1/3)/sin(1/3))*x*2/3"], box, needed) is good


def document(**changes: object) -> dict[str, object]:
    """Return a sealed certificate of a limited double integrator."""

    def entry(name: str, end: float) -> dict[str, object]:
        return {"name": name, "unit": "1", "lower": -end, "upper": end}

    claim: dict[str, object] = {
        "name": "limited", "time": "continuous", "property": "stability", "about": {},
        "states": [entry("x", 3.0), entry("v", 3.0)], "parameters": [],
        "dynamics": {"x": "v", "v": "max(-1, min(1, -x - v))"}, "function": "1.5*x^2 + x*v + v^2",
        "equilibrium": {"x": 0.0, "v": 0.0}, "level": 1.0, "rate": None,
    }  # fmt: skip
    more = {key: value for key, value in changes.items() if key in ("slopes", "proofs")}
    claim |= {key: value for key, value in changes.items() if key not in more}
    return seal("lyapunov", claim, {"slopes": {}} | more)


def test_a_certificate_by_the_slope_rule_is_accepted() -> None:
    checked = check_document(document())
    assert checked.accepted, checked.reason
    assert "converges to the equilibrium" in checked.proves
    assert check_document(document(rate=0.01)).accepted


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"level": 9.0}, "border of the box"),
        ({"level": 5.0}, "does not show the decrease"),
        ({"rate": 0.9}, "does not show the decrease"),
        ({"rate": -0.1}, "rate is not positive"),
        ({"dynamics": {"x": "v", "v": "max(-1, min(1, x - v))"}}, "does not show the decrease"),
        ({"dynamics": {"x": "v", "v": "select(x, 9, -x - v, x)"}}, "contain select"),
        ({"function": "1.5*x^2 + 4*x*v + v^2"}, "not positive definite"),
        ({"equilibrium": {"x": 0.1, "v": 0.0}}, "about the equilibrium"),
        ({"equilibrium": {"x": 0.0}}, "every state"),
        ({"slopes": {"cells": {}}}, "slopes"),
        ({"slopes": []}, "malformed"),
        ({"slopes": {"feedbacks": [[0.1, 0.1]] * 2}}, "2 feedbacks for 1 limits"),
        ({"slopes": {"feedbacks": [[-0.1]]}}, "feedback of a limit"),
        ({"slopes": {"feedbacks": [["x", 0.1]]}}, "number"),
        ({"proofs": []}, "the certificate"),
        ({"property": "nothing"}, "not known"),
        ({"inner": 0.0}, "claim"),
    ],
)
def test_a_changed_certificate_is_rejected(changes: dict[str, object], message: str) -> None:
    checked = check_document(document(**changes))
    assert not checked.accepted
    assert message in checked.reason


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, ""), ({"gains": {"w": 0.5}}, "does not show"), ({"inner": 0.9}, "exceeds the level"),
        ({"inner": -0.1}, "negative"), ({"gains": {"x": 1.0}}, "gain"), ({"rate": None}, "number"),
        ({"gains": {}}, "do not rest"), ({"gains": {}, "inner": 0.3}, ""), ({"gains": {}, "inner": 0.05}, "not show"),
    ],
)  # fmt: skip
def test_a_bound_by_the_slope_rule(changes: dict[str, object], message: str) -> None:
    # 2 x (w − x) <= −x² + w²
    claim: dict[str, object] = {
        "name": "disturbed", "time": "continuous", "property": "bound", "about": {},
        "states": [{"name": "x", "unit": "1", "lower": -1.0, "upper": 1.0}],
        "parameters": [{"name": "w", "unit": "1", "lower": -0.5, "upper": 0.5}],
        "dynamics": {"x": "w - x"}, "function": "x^2", "level": 0.9, "rate": 0.99, "inner": 0.0, "gains": {"w": 1.01},
    }  # fmt: skip
    checked = check_document(seal("lyapunov", claim | changes, {"slopes": {}}))
    assert checked.accepted is not bool(message), checked.reason
    assert message in checked.reason


FORM = np.array([[0.129, 0.1775], [0.1775, 0.366]])
GAIN = np.array([-0.3356, -0.5543])


def held(
    feedback: NDArray[np.float64], level: float, limited: str = "max(-1, min(1, -x - v))", **changes: object
) -> bool:
    """Return whether an unstable plant with a limited command is proved with a feedback."""
    ends = [{"name": name, "unit": "1", "lower": -9.0, "upper": 9.0} for name in "xv"]
    own = {"states": ends, "function": "0.129*x^2 + 0.355*x*v + 0.366*v^2", "level": level}
    rates = {"dynamics": {"x": "v", "v": f"0.3*x + {limited}"}}
    return check_document(document(slopes={"feedbacks": [feedback.tolist()]}, **own, **rates, **changes)).accepted


def test_a_feedback_proves_a_region_where_the_limit_acts() -> None:
    most = float(1 / (GAIN @ np.linalg.inv(FORM) @ GAIN))
    assert held(GAIN, 0.999 * most)
    assert not held(GAIN, 1.001 * most)
    assert not held(-GAIN, 0.9)
    assert not held(0 * GAIN, 0.1)
    assert not held(GAIN, 0.97, rate=0.1)


@pytest.mark.parametrize(("least", "good"), [(0.99, True), (0.8, False)])
def test_the_limit_of_a_feedback_may_be_a_parameter(least: float, good: bool) -> None:
    parameters = [{"name": "m", "unit": "1", "lower": least, "upper": 1.2}]
    for text in ("max(-m, min(m, -x - v))", "min(m, max(-x - v, 0 - m))"):
        assert held(GAIN, 0.95, text, parameters=parameters) is good


def test_whatever_a_feedback_proves_holds_at_samples() -> None:
    rng, proved = np.random.default_rng(8), 0
    for _ in range(30):
        feedback, level, limit = GAIN * rng.normal(1, 0.15, size=2), rng.uniform(0.4, 1.4), rng.uniform(0.8, 1.3)
        text = f"max(-{limit!r}, min({limit!r}, -{rng.uniform(0.8, 1.5)!r}*x - {rng.uniform(0.8, 1.5)!r}*v))"
        if held(feedback, float(level), text):
            proved += 1
            x = rng.normal(size=(2, 4000))
            x *= np.sqrt(level * rng.random(4000) / np.einsum("in,ij,jn->n", x, FORM, x))
            [u] = values_of([parse(text, {name: variable(name) for name in "xv"})], dict(zip("xv", x, strict=True)))
            assert np.all(np.einsum("in,in->n", FORM @ x, np.array([x[1], 0.3 * x[0] + u])) < 0)
    assert 2 < proved < 28


@pytest.mark.parametrize(("least", "shown"), [(1e-13, True), (1e-14, False)])
def test_what_is_below_the_bound_of_rounding_is_not_shown(least: float, shown: bool) -> None:
    rows = SimpleNamespace(slopes=[(Fraction(0), Fraction(1))], size=lambda _: Fraction(1))
    entry = Number({(): exact(least), (0,): Fraction(1)})
    assert is_definite(rows, np.array([[entry]])) is shown  # type: ignore[arg-type]
