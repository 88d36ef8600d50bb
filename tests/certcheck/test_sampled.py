"""Regions of sampled loops: each inequality of the rule decides, near misses are rejected, simulation agrees."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from mpmath import libmp

from surctl.certcheck import Rejected, check_document, seal
from surctl.certcheck.enclosure import span
from surctl.certcheck.motion import Motion
from surctl.certcheck.sampled import _piece
from surctl.certcheck.slope_rows import Rows
from surctl.lyapunov import Dynamics, Range, State
from surctl.lyapunov.dynamics import Command, Sampling
from surctl.lyapunov.sampled import sampled_region
from surctl.verification.formula import parse, values_of, variable

Document = dict[str, Any]
Change = Callable[[Document], object]


def loop(
    plant: dict[str, str], after: dict[str, str], commands: dict[str, str], *, bounds: dict[str, float], period: float
) -> Dynamics:
    """Return a sampled loop with a parameter p in [0.9, 1.1]; the rates in continuous time are not used."""
    known = {name: variable(name) for name in (*bounds, *commands, "p")}
    held = tuple(Command(name, parse(text, known), Fraction(0)) for name, text in commands.items())
    flow, steps = ({name: parse(text, known) for name, text in part.items()} for part in (plant, after))
    states = tuple(State(name, -end, end) for name, end in bounds.items())
    rates = tuple(parse("0", known) for _ in bounds)
    sampling = Sampling(period, flow, steps, held)
    return Dynamics("loop", "continuous", states, rates, (Range("p", 0.9, 1.1),), sampling=sampling)


@pytest.fixture(scope="module")
def integrator() -> Document:
    """Return the certificate of x' = p u, with u = −0.8 x limited to ±0.6 and held for 1 s: x⁺ = (1 − 0.8 p) x."""
    return proved({"x": "p*u"}, {}, {"u": "max(-0.6, min(0.6, -0.8*x))"}, bounds={"x": 1.5}, period=1.0, rate=0.3)


@pytest.fixture(scope="module")
def oscillator() -> Document:
    """Return the certificate of a pendulum with an integrator that stops at the limits, sampled every 0.2 s."""
    raw = "(-4*a - 3*w - z)"
    command = f"max(-1.5, min(1.5, {raw}))"
    after = {"z": f"z + 0.2*(0.8*a + 0.5*({raw} - {command}))"}
    plant = {"a": "w", "w": "p*sin(a) + u"}
    return proved(plant, after, {"u": command}, bounds={"a": 1.2, "w": 2.0, "z": 2.5}, period=0.2)


def proved(*parts: dict[str, str], bounds: dict[str, float], period: float, rate: float | None = None) -> Document:
    region = sampled_region(loop(*parts, bounds=bounds, period=period), rate, time_limit=30.0)
    assert region is not None
    return dict(region.document)


def verdict(document: Document, *changes: Change) -> str:
    """Return why a changed certificate, with its new hash, is rejected; empty if it is accepted."""
    changed = deepcopy(document)
    for change in changes:
        change(changed)
    evidence = {key: changed[key] for key in changed.keys() & {"knots", "feedbacks", "more"}}
    return check_document(seal("lyapunov", changed["claim"], evidence)).reason


def test_limits_that_act_in_the_region_are_proved(integrator: Document, oscillator: Document) -> None:
    assert verdict(integrator) == ""
    [state] = integrator["claim"]["states"]
    assert state["upper"] > 0.6 / 0.8 * 1.2
    assert verdict(oscillator) == ""


def scaled(factor: float, *places: int) -> Change:
    def change(document: Document) -> None:
        for k in places:
            document["knots"][k] = [[factor * x for x in row] for row in document["knots"][k]]

    return change


def claimed(**entries: Any) -> Change:
    return lambda document: document["claim"].update(entries)


def uncertain(low: float, high: float) -> Change:
    return lambda document: document["claim"]["parameters"][0].update(lower=low, upper=high)


def at_instant(text: str) -> Change:
    return lambda document: document["claim"]["commands"][0].update(value=text)


def test_the_rate_at_which_v_falls_is_that_of_the_slowest_vertex(integrator: Document) -> None:
    # with u = −0.6/reach x at the border of the region, x⁺ = (1 − 0.9 · 0.6/reach) x is the slowest one
    document = integrator
    reach = float(np.sqrt(document["claim"]["level"] / float(document["claim"]["function"].split("*")[0])))
    most = 1 - (1 - 0.9 * 0.6 / reach) ** 2
    assert verdict(document, claimed(rate=1.05 * most)) != ""
    assert document["claim"]["rate"] < most


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([at_instant("max(-0.6, min(0.6, -0.1*x))")], "at a sampling instant"),
        ([at_instant("max(-0.6, min(0.6, -3*x))")], "at a sampling instant"),
        ([at_instant("max(-0.6, min(0.6, -0.8*x)) + 0.001")], "does not rest"),
        ([at_instant("max(-0.3, min(0.6, -0.8*x))")], "feedback of a limit"),
        ([at_instant("max(-0.6, min(0.3, -0.8*x))")], "feedback of a limit"),
        ([at_instant("-0.8*x")], "feedbacks for 0 limits"),
        ([at_instant("min(0.6, min(-0.6, -0.8*x)) + 0.6")], "feedbacks for 0 limits"),
        ([at_instant("max(-0.6, min(-0.8*x, x + 0.7))")], "feedbacks for 0 limits"),
        ([at_instant("max(min(0.6, -0.8*x), x - 0.7)")], "feedbacks for 0 limits"),
        ([lambda d: d.update(feedbacks=[[0.0]])], "at a sampling instant"),
        ([lambda d: d.update(feedbacks=[[-9.0]])], "feedback of a limit"),
        ([lambda d: d.update(feedbacks=[[-0.4, 0.1]])], "feedback of a limit"),
        ([uncertain(0.2, 1.1)], "between the sampling instants"),
        ([uncertain(0.9, 2.6)], "between the sampling instants"),
        ([claimed(period_s=2.0)], "between the sampling instants"),
        ([claimed(period_s=-1.0)], "period is not positive"),
        ([claimed(dynamics={"x": "0.5*p*u"})], "between the sampling instants"),
        ([claimed(dynamics={"x": "p*u + 0.001*p"})], "does not rest"),
        ([claimed(dynamics={"x": "select(x, 9, p*u, x)"})], "contain select"),
        ([claimed(dynamics={}, next={"x": "x"})], "between the sampling instants"),
        ([claimed(next={"x": "x"})], "either a rate or a next value"),
        ([scaled(1.02, -1)], "at the end of a period"),
        ([scaled(0.5, 0)], "at a sampling instant"),
        ([scaled(0.98, 1)], "between the sampling instants"),
        ([lambda d: d["knots"].reverse()], "at"),
        ([lambda d: d["knots"].insert(0, d["knots"][0])], "between the sampling instants"),
        ([lambda d: d.update(knots=d["knots"][:1])], "knots"),
        ([lambda d: d["knots"][1][0].append(0.0)], "knot is not"),
        ([lambda d: d["knots"][1][1].__setitem__(0, 9.0)], "knot is not"),
        ([lambda d: d["claim"]["states"][0].update(upper=0.7)], "border of the box"),
        ([claimed(level=-1.0)], "level is not positive"),
        ([claimed(rate=1.5)], "exceeds 1"),
        ([claimed(rate=-0.1)], "rate is not positive"),
        ([claimed(equilibrium={"x": 0.0})], "every state and command"),
        ([claimed(equilibrium={"x": 0.0, "u": 0.001})], "does not rest"),
        ([claimed(dynamics={"x": "p*u + 0*log(x)"})], "not defined"),
        ([lambda d: d.update(more=[])], "the certificate must have"),
        ([claimed(property="bound")], "stability only"),
        ([claimed(inner=0.0)], "claim must have"),
        ([claimed(name="a\nb")], "printed"),
        ([claimed(about={"plant": "x"})], "about"),
    ],
)  # fmt: skip
def test_a_changed_certificate_is_rejected(integrator: Document, changes: list[Change], message: str) -> None:
    reason = verdict(integrator, *changes)
    assert message in reason, reason
    assert reason


def test_the_extent_between_two_knots_is_the_larger_one() -> None:
    covers = [[[Fraction(a), Fraction(0)], [Fraction(0), Fraction(b)]] for a, b in ((1, 9), (4, 1))]
    rows = Rows(["x", "y"], [span(-99.0, 99.0)] * 2, ["x", "y", "x + y"], covers, [Fraction(0)] * 2, Fraction(1))
    for root, most in zip(rows.roots, (2, 3, np.sqrt(10)), strict=True):
        low, high = map(libmp.to_float, rows.range[root])
        assert -low == pytest.approx(most, rel=1e-5) and high == pytest.approx(most, rel=1e-5)
        assert min(-low, high) >= most


@pytest.mark.parametrize(("growth", "good"), [(3.0, True), (1.0, False)])
def test_both_ends_of_a_piece_decide(growth: float, good: bool) -> None:
    # x' = v, v' = −5 v: the matrix is [[growth − 2, 3], [3, 10]] at first and [[growth, −2], [−2, 10]] at last
    knots = [[[2.0, 1.0], [1.0, 1.0]], [[2.0 + growth, 0.0], [0.0, 1.0]]]
    first, last = ([[Fraction(x) for x in row] for row in knot] for knot in knots)
    motion = Motion(["x", "v"], ["x", "v"], [(-9.0, 9.0)] * 2, ["v", "-5*v"], discrete=False)
    centre, one = [Fraction(0)] * 2, Fraction(1)
    if good:
        _piece(motion, centre, one, (first, last), one)
        return
    with pytest.raises(Rejected, match="between the sampling instants"):
        _piece(motion, centre, one, (first, last), one)


def test_a_region_whose_solutions_leave_the_box_between_the_instants_is_rejected(oscillator: Document) -> None:
    document = oscillator
    knots = np.array(document["knots"])
    inner = np.sqrt(document["claim"]["level"] * knots[1:-1, 1, 1].max())

    def narrow(changed: Document) -> None:
        changed["claim"]["states"][1].update(lower=-0.999 * inner, upper=0.999 * inner)

    assert "border of the box" in verdict(document, narrow)


@pytest.mark.parametrize("name", ["integrator", "oscillator"])
def test_no_simulated_solution_contradicts_the_certificate(name: str, request: pytest.FixtureRequest) -> None:
    document: Document = request.getfixturevalue(name)
    claim, count, steps = document["claim"], 400, 12
    names = [row["name"] for row in claim["states"]]
    known = {name: variable(name) for name in (*names, "u", "p")}
    [command] = [parse(row["value"], known) for row in claim["commands"]]
    flow, after = ({name: parse(text, known) for name, text in claim[key].items()} for key in ("dynamics", "next"))
    v = parse(claim["function"], known)
    random = np.random.default_rng(0)
    x = random.normal(size=(len(names), count))

    def at(node: Any, x: Any, u: Any = 0.0, p: Any = 1.0) -> Any:
        return values_of([node], dict(zip((*names, "u", "p"), (*x, u + 0 * x[0], p + 0 * x[0]), strict=True)))[0]

    x *= np.sqrt(claim["level"] / at(v, x))
    x[:, ::3] *= random.random(len(x[0, ::3]))
    knots, h = np.array(document["knots"]), claim["period_s"] / steps
    for _ in range(8):
        before, u = at(v, x), at(command, x)
        x = np.array([at(after[name], x) if name in after else x[k] for k, name in enumerate(names)])
        last = before
        for step in range(steps + 1):
            place = step / steps * (len(knots) - 1)
            low = min(int(place), len(knots) - 2)
            inverse = np.linalg.inv(knots[low] + (place - low) * (knots[low + 1] - knots[low]))
            both = np.vstack([x, u])
            w = np.einsum("in,ij,jn->n", both, inverse, both)
            assert np.all(w <= last * (1 + 1e-6))
            if step == steps:
                break
            last, p = w, np.where(random.random(count) < 0.5, 0.9, 1.1)

            def moved(x: Any, u: Any = u, p: Any = p) -> Any:
                return np.array([at(flow[name], x, u, p) if name in flow else 0 * x[0] for name in names])

            first = moved(x)
            second = moved(x + h / 2 * first)
            third = moved(x + h / 2 * second)
            x = x + h / 6 * (first + 2 * second + 2 * third + moved(x + h * third))
        assert np.all(at(v, x) < before * (1 - (claim["rate"] or 0.0)))


def test_a_false_loop_has_no_certificate() -> None:
    for gain in (0.8, 2.3):  # with p up to 1.1, x⁺ = (1 − k p) x grows from k = 2/1.1 on
        d = loop({"x": "p*u"}, {}, {"u": f"max(-0.6, min(0.6, -{gain}*x))"}, bounds={"x": 0.5}, period=1.0)
        assert (sampled_region(d, None, time_limit=20.0) is None) is (gain > 1)
    # an unstable plant under a limit: no region beyond x = 0.5 exists
    d = loop({"x": "x + u"}, {}, {"u": "max(-0.5, min(0.5, -2*x))"}, bounds={"x": 3.0}, period=0.1)
    region = sampled_region(d, None, time_limit=20.0)
    assert region is not None
    widest = region.claim.dynamics.box[1, 0]
    assert 0.4 < widest < 0.52


def test_a_rate_that_no_period_can_have_is_not_searched() -> None:
    d = loop({"x": "p*u"}, {}, {"u": "-0.8*x"}, bounds={"x": 1.5}, period=1.0)
    assert sampled_region(d, 1.0, time_limit=5.0) is None
    assert sampled_region(replace(d), 0.5, time_limit=5.0) is not None
