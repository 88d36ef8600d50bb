"""Radii of an equilibrium: near misses of each condition are rejected, and what is accepted has the equilibrium."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from fractions import Fraction
from typing import Any

import pytest

from surctl.certcheck import Rejected, check_document, seal
from surctl.certcheck.radii import least_rate, norm, read_radii, widened
from surctl.certcheck.slopes import Decrease, check_decrease
from surctl.lyapunov.dynamics import Command, Dynamics, Range, Sampling, State
from surctl.lyapunov.sampled import sampled_region
from surctl.verification.formula import parse, variable

Document = dict[str, Any]
ONE = [[Fraction(1)]]


def refusal(
    rate: str,
    radius: float,
    *,
    level: float = 0.25,
    decay: float = 0.0,
    p: tuple[float, float] = (1.0, 1.0),
    discrete: bool = False,
    feedbacks: tuple[float, ...] = (),
) -> str:
    """Return why V = x² about 0 is not shown to decrease about each equilibrium within the radius; empty if it is."""
    radii = [Fraction(radius)] if radius else []
    needed = Decrease(ONE, [Fraction(0)], Fraction(level), Fraction(decay), {}, radii=radii)
    rows = [[Fraction(g)] for g in feedbacks]
    try:
        check_decrease(["x", "p"], [(-2.0, 2.0), p], [rate], needed, discrete=discrete, feedbacks=rows)
    except Rejected as reason:
        return str(reason)
    return ""


@pytest.mark.parametrize("size", [1e-15, 1e-3])
@pytest.mark.parametrize(
    ("rate", "radius", "decay", "good"),
    [
        ("c - x", 1.01, 0.0, True),  # V about c decays at any rate below 2, which leaves V about 0 above c²
        ("c - x", 0.99, 0.0, False),  # c is not within the radius
        ("c - x", 0.0, 0.0, False),
        ("c - x", 1.01, 1.99, True),
        ("c - x", 1.01, 2.01, False),
        ("-c - x", 0.99, 0.0, False),
        ("x - c", 1.01, 0.0, False),  # unstable
        ("c^2 - x^2", 3.0, 0.0, False),  # two equilibria
        ("c + x^2", 3.0, 0.0, False),  # none
        ("c - x^3", 3.0, 0.0, False),  # not as fast as any rate, close to the equilibrium
        ("c*p - x", 1.06, 0.0, True),  # for each p, another equilibrium
        ("c*p - x", 1.04, 0.0, False),
    ],
)
def test_the_equilibrium_lies_within_the_radius(
    size: float, rate: str, radius: float, decay: float, good: bool
) -> None:
    text = rate.replace("c", repr(size))
    assert (not refusal(text, radius * size, decay=decay, p=(0.95, 1.05))) is good


@pytest.mark.parametrize(("radius", "good"), [(2.7, True), (2.6, False), (1.9, False)])
def test_the_fixed_point_of_a_step_lies_within_the_radius(radius: float, good: bool) -> None:
    # x⁺ = x/2 + c has the fixed point 2 c; V⁺ < (1 − 2 c/radius) V is shown below 3/4
    assert (not refusal("0.5*x + 0.001", radius * 1e-3, discrete=True)) is good


def test_an_equilibrium_outside_the_region_is_none_of_it() -> None:
    assert "inside the region" in refusal("1 - x", 1.1, level=0.25)
    assert "inside the region" in refusal("0.3 - x", 0.5, level=0.25)
    assert refusal("0.3 - x", 0.49, level=0.25) == ""


@pytest.mark.parametrize(("radius", "good"), [(0.01, True), (0.15, False)])
def test_the_slopes_are_those_about_every_point_within_the_radii(radius: float, good: bool) -> None:
    # V about 0 decreases, but two solutions between 0.1 and 0.2 move away from each other
    text = "-x + 1.5*max(0, x - 0.1) - 1.5*max(0, x - 0.2)"
    assert (not refusal(text, radius)) is good


@pytest.mark.parametrize(("factor", "good"), [(0.8, True), (0.9, False)])
def test_a_product_has_the_values_of_every_point_within_the_radii(factor: float, good: bool) -> None:
    # x' = 1e-9 - x + k x y: about (x*, y*), the rate of x has the slopes k y* in x and k x in y
    p = [[Fraction(1), Fraction(0)], [Fraction(0), Fraction(1)]]
    level, zero = Fraction(1), Fraction(0)
    needed = Decrease(p, [zero, zero], level, zero, {}, radii=[Fraction(2, 5), Fraction(2, 5)])
    rates, refused = [f"1e-9 - x + {factor}*x*y", "-y"], False
    try:
        check_decrease(["x", "y"], [(-2.0, 2.0)] * 2, rates, needed, discrete=False)
    except Rejected:
        refused = True
    assert refused is not good


@pytest.mark.parametrize(("feedback", "good"), [(-0.69, True), (-0.72, False)])
def test_the_feedback_of_a_limit_stays_within_it_from_every_point_within_the_radii(feedback: float, good: bool) -> None:
    # the limit is 1, the operand at a point within the radius at most 0.3, and the region reaches 0.9 from the centre
    text = "max(-1, min(1, -3*x)) - 2*x"
    assert (not refusal(text, 0.1, level=0.81, feedbacks=(feedback,))) is good


def test_bounds_are_upper_bounds() -> None:
    p = [[Fraction(2), Fraction(1)], [Fraction(1), Fraction(3)]]
    assert norm(p, [Fraction(1), Fraction(2)]) ** 2 >= 2 + 4 + 12
    assert widened(p, Fraction(30), [Fraction(1), Fraction(2)]) >= (30**0.5 + 18**0.5) ** 2
    assert widened(p, Fraction(3), []) == 3
    covers = [[[Fraction(4)]], [[Fraction(1), Fraction(0)], [Fraction(0), Fraction(25)]]]
    # the ellipsoids reach 2 and 5 times 2 drift/rate
    assert least_rate(Fraction(1), covers, [Fraction(1), Fraction(1)]) == pytest.approx(10)
    assert least_rate(Fraction(1), covers, [Fraction(1), Fraction(100)]) == pytest.approx(4)


@pytest.mark.parametrize(
    "stated",
    [{"x": 1.0}, {"x": 1.0, "y": 0.0}, {"x": 1.0, "y": -1.0}, {"x": 1.0, "y": "1"}, {"x": 1.0, "y": True}, 1.0,
     {"x": 1.0, "y": 1.0, "z": 1.0}, {"x": 1.0, "y": float("inf")}],
)  # fmt: skip
def test_radii_are_positive_numbers_of_all_states(stated: object) -> None:
    with pytest.raises(Rejected):
        read_radii({"radius": stated}, ["x", "y"])
    assert read_radii({}, ["x", "y"]) == []


def test_only_the_slope_rule_has_radii() -> None:
    claim = {
        "name": "one", "time": "continuous", "property": "stability", "about": {}, "parameters": [],
        "states": [{"name": "x", "unit": "1", "lower": -1.0, "upper": 1.0}], "dynamics": {"x": "0.001 - x"},
        "function": "x^2", "level": 0.5, "rate": None, "equilibrium": {"x": 0.0}, "radius": {"x": 0.0011},
    }  # fmt: skip
    checked = check_document(seal("lyapunov", claim, {"slopes": {}}))
    assert checked.accepted
    assert checked.proves.endswith("to the equilibrium at x = 0 ± 0.0011, which is asymptotically stable")
    fast = check_document(seal("lyapunov", claim | {"rate": 0.1}, {"slopes": {}}))
    assert fast.proves.endswith("at x = 0 ± 0.0011: V about the equilibrium decays at least as exp(-0.1 t)")
    moving = claim | {
        "parameters": [{"name": "p", "unit": "1", "lower": 0.0, "upper": 0.001}],
        "dynamics": {"x": "p - x"},
    }
    proves = check_document(seal("lyapunov", moving, {"slopes": {}})).proves
    assert "converges to the box x = 0 ± 0.0011 and, with constant parameters, to the equilibrium in this box" in proves
    boxes = {"change": "2*x*(0.001 - x)", "scales": [1.0], "positive": {"factor": 1.0, "power": 1}, "decrease": None}
    for wrong in ({"radius": {"x": 0.0009}}, {"property": "bound"}):
        assert not check_document(seal("lyapunov", claim | wrong, {"slopes": {}})).accepted
    assert "exactly the keys" in check_document(seal("lyapunov", claim, {**boxes, "proofs": []})).reason


@pytest.fixture(scope="module")
def sampled() -> Document:
    """Return the certificate of x' = p u + load, u = −0.8 x limited to ±0.6 and held for 1 s, without load."""
    names = {name: variable(name) for name in ("x", "u", "p")}
    value = parse("max(-0.6, min(0.6, -0.8*x))", names)
    sampling = Sampling(1.0, {"x": parse("p*u", names)}, {}, (Command("u", value, Fraction(0)),))
    state, zero = State("x", -1.5, 1.5), parse("0", names)
    loop = Dynamics("loop", "continuous", (state,), (zero,), (Range("p", 0.9, 1.1),), sampling=sampling)
    region = sampled_region(loop, 0.3, time_limit=30.0)
    assert region is not None and "radius" not in region.document["claim"]
    return dict(region.document)


def loaded(load: str) -> Callable[[Document], object]:
    return lambda document: document["claim"]["dynamics"].update(x=f"p*u + {load}")


def shifted(offset: str) -> Callable[[Document], object]:
    return lambda document: document["claim"]["commands"][0].update(value=f"max(-0.6, min(0.6, -0.8*x)) + {offset}")


@pytest.mark.parametrize(
    ("change", "x", "u", "good"),
    [
        (loaded("0.0001"), 2e-3, 2e-3, True),
        (loaded("0.0001"), 1e-4, 2e-3, False),  # it rests at 0.000125/p
        (loaded("0.0001"), 2e-3, 9e-5, False),  # with u = −0.0001/p
        (shifted("0.0001"), 2e-3, 2e-3, True),  # it rests at 0.000125
        (shifted("0.0001"), 1e-4, 2e-3, False),
        (loaded("0.0001"), None, None, False),
        (shifted("0.0001"), None, None, False),
    ],
)
def test_the_equilibrium_of_a_sampled_loop_lies_within_the_radii(
    sampled: Document, change: Callable[[Document], object], x: float | None, u: float | None, good: bool
) -> None:
    document = deepcopy(sampled)
    change(document)
    document["claim"]["level"] *= 0.9  # room for the radii
    if x is not None:
        document["claim"]["radius"] = {"x": x, "u": u}
    evidence = {key: document[key] for key in ("knots", "feedbacks")}
    assert check_document(seal("lyapunov", document["claim"], evidence)).accepted is good


@pytest.mark.parametrize(("radius", "good"), [(0.02, True), (0.03, False)])
def test_the_feedback_of_a_sampled_limit_has_room_for_the_radii(sampled: Document, radius: float, good: bool) -> None:
    claim = sampled["claim"] | {"radius": {"x": radius, "u": radius}, "rate": None}
    claim["level"] *= 0.9
    checked = check_document(seal("lyapunov", claim, {key: sampled[key] for key in ("knots", "feedbacks")}))
    assert checked.accepted is good
    assert good or "the feedback of a limit does not stay" in checked.reason
