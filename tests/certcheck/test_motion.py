"""Dynamics of a claim and what must be proved about them: each condition is the only one that is not met."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import pytest

from surctl.certcheck import barrier, check_document, lyapunov
from surctl.certcheck.document import Rejected
from surctl.certcheck.inequality import Obligation, check_all
from surctl.certcheck.motion import Motion, read_motion, require_loop, rest_of
from surctl.certcheck.patience import patient
from tests.certcheck.test_lyapunov import LOOP, _case, _changed, _state

SQUARE = ((-1.0, 1.0), (-1.0, 1.0))


def motion(*rates: str, discrete: bool = False, box: Any = SQUARE) -> Motion:
    return Motion(("x", "y"), ("x", "y"), list(box), rates, discrete)


def refuses(says: str, call: Callable[..., Any], *words: Any) -> None:
    with pytest.raises(Rejected, match=says):
        call(*words)


# the change of a function


def test_the_change_is_the_one_that_follows() -> None:
    for discrete, change in ((False, "-2*x*y"), (True, "y^2")):
        made = motion("-y", "x", discrete=discrete)
        assert made.verify_change("x^2", change) == change
        refuses("does not follow from the dynamics", made.verify_change, "x^2", f"{change} - 1e-9")
    both = Motion(("x",), ("x", "k"), list(SQUARE), ["-k*x"], False)
    assert both.verify_change("x", "-k*x")
    refuses("'k' is not one of the claim's variables", both.verify_change, "x + 0*k", "-k*x")


@pytest.mark.parametrize(
    ("rate", "says"),
    [
        ("select(x, 0, 1, -1)", "select, which may jump"),
        ("2*select(x, 0, 1, -1)", "select, which may jump"),
        ("atan2(y, x)", "an atan2 that may jump"),
        ("atan2(y, x + 1)", "an atan2 that may jump"),
        ("atan2(1/x, 1)", "an atan2 that may be undefined"),
        ("1/x", "the dynamics may be undefined in the box"),
    ],
)
def test_rates_that_jump_or_are_not_defined(rate: str, says: str) -> None:
    with patient(1.0):
        refuses(says, motion(rate, "0").verify_change, "y^2", "0")


@pytest.mark.parametrize("rate", ["atan2(y, x + 2)", "atan2(y + 2, x)", "atan2(y - 2, x)", "abs(x)",
                                  "1/(x^2 - x + 0.3)", "1/(y^2 - y + 0.3)"])  # fmt: skip
def test_rates_that_are_defined_and_do_not_jump(rate: str) -> None:
    motion(rate, "0").verify_change("y^2", "0")


# an equilibrium inside the region


def test_the_equilibrium_lies_inside_and_the_function_is_below_the_level_there() -> None:
    made = motion("0", "0")
    made.require_inside("x^2 + y^2", 0.5, {"x": 0.5, "y": "-0.4"})
    for point in ({"x": 1.0, "y": 0.0}, {"x": 0.0, "y": -1.0}, {"x": -1.0, "y": 0.0}, {"x": 0.0, "y": "1"}):
        refuses("does not lie inside the box", made.require_inside, "0*x", 0.5, point)
    refuses("not shown to be below the level", made.require_inside, "x^2 + y^2", 0.5, {"x": 0.5, "y": 0.5})
    refuses("not defined at the equilibrium", made.require_inside, "log(x)", 0.5, {"x": 0.0, "y": 0.5})
    jumps = motion("0", "0", discrete=True)
    refuses("select, which may jump", jumps.require_inside, "select(x, 0, 0, 9)", 0.5, {"x": 0.0, "y": 0.0})


def test_a_successor_lies_in_the_box_if_it_does_so_at_all_four_faces() -> None:
    made = motion("y", "x/2", discrete=True, box=((-1.0, 2.0), (-3.0, 4.0)))
    assert {(o.left, o.right) for o in made.stays(["x"])} == {
        ("(-1.0)", "y"), ("y", "(2.0)"), ("(-3.0)", "x/2"), ("x/2", "(4.0)"),
    }  # fmt: skip


# reading


CLAIM: dict[str, Any] = {
    "name": "n", "time": "continuous", "states": [_state("x", 0.0, 1.0), _state("y", 0.0, 1.0)], "parameters": [],
    "dynamics": {"x": "y", "y": "x"}, "about": {},
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"dynamics": ["x", "y"]}, "do not name every state once"),
        ({"dynamics": {"x": "y"}}, "do not name every state once"),
        ({"dynamics": {"x": "y", "y": "x", "z": "x"}}, "do not name every state once"),
        ({"time": "never"}, "neither continuous nor discrete"),
        ({"states": [_state("x", 0.0, 0.0), _state("y", 0.0, 1.0)]}, "has no width"),
        ({"states": [_state("x", 0.0, 1.0), _state("y", 1.0, 1.0)]}, "has no width"),
        ({"name": "a\nb"}, "can be printed"),
        ({"about": {"plant": "a"}}, "claim.about must have exactly the keys"),
    ],
)
def test_dynamics_that_are_not_complete(change: dict[str, Any], says: str) -> None:
    assert read_motion(CLAIM | {"about": LOOP}).rates == ["y", "x"]
    refuses(says, read_motion, CLAIM | change)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"plant": "a\n"}, "can be printed"),
        ({"controller": 3}, "can be printed"),
        ({"period_s": 0.0}, "the period"),
        ({"period_s": -0.1}, "the period"),
        ({"gains": ["k"]}, "the gains by name"),
        ({"gains": {"k\n": [1.0]}}, "can be printed"),
        ({"gains": {"k": [None]}}, "not a finite number"),
        ({"plant_state": [True]}, "not a finite number"),
        ({"more": 1}, "must have exactly the keys"),
    ],
)
def test_a_loop_that_is_not_complete(change: dict[str, Any], says: str) -> None:
    require_loop(LOOP | {"gains": {"k": [1.0, "k"]}, "disturbance": ["d", 1]})
    refuses(says, require_loop, LOOP | change)


@pytest.mark.parametrize(
    "text",
    ["1e5", "٣", "0x1", "1.", ".5", "+1", "", " 1", "1" * 401, "1\n", "1/0", "1/-3", "1/2/3", "0.5/2", "1/03", "1/٣"],
)
def test_a_text_of_a_coordinate_is_a_decimal_number(text: str) -> None:
    assert rest_of("-1/3") == ("(-1/3)", Fraction(-1, 3))
    assert rest_of("-0.25") == ("(-0.25)", -0.25) and rest_of(0.5)[1] == 0.5 and rest_of("1" * 400)
    refuses("is not a decimal number", rest_of, text)


def test_there_is_one_proof_for_each_inequality() -> None:
    needed = [Obligation(("x",), [(0.0, 1.0)], "-x", "0"), Obligation(("x",), [(0.0, 1.0)], "x - 1", "0")]
    proofs = [[_case("-x - 0", multipliers=())], [_case("x - 1 - 0", multipliers=())]]
    normal = motion("0", "0").normal
    check_all(needed, proofs, normal)
    refuses("has 1 proofs, but 2 inequalities", check_all, needed, proofs[:1], normal)
    refuses("has 3 proofs, but 2 inequalities", check_all, needed, [*proofs, proofs[0]], normal)
    refuses("inequality 2 of 2: the cases do not cover", check_all, needed, [proofs[0], []], normal)
    undefined = Obligation(("x",), [(0.0, 1.0)], "0", "0", ["0"])
    refuses("not defined where it must be: a log", undefined.check, [_case("0", multipliers=("log(x)",))])


# lyapunov


@pytest.mark.parametrize(
    ("name", "path", "to", "says"),
    [
        ("van-der-pol", ("claim", "property"), "beauty", "the property 'beauty' is not known"),
        ("van-der-pol", ("claim", "more"), 1, "claim must have exactly the keys"),
        ("van-der-pol", ("more",), 1, "the certificate must have exactly the keys"),
        ("van-der-pol", ("claim", "level"), -1.0, "below the level at the equilibrium"),
        ("map", ("decrease",), {"factor": 1.0, "power": 1}, "'decrease' must be null"),
        ("map", ("claim", "rate"), 1.5, "exceeds 1 in discrete time"),
        ("map", ("claim", "rate"), 0.0, "the rate is not positive"),
        ("decay", ("claim", "more"), 1, "claim must have exactly the keys"),
        ("decay", ("more",), 1, "the certificate must have exactly the keys"),
        ("decay", ("claim", "stays"), True, "the certificate must have exactly the keys"),
        ("decay", ("claim", "property"), "stability", "claim.property is not 'safety'"),
        ("decay", ("margin",), 0.0, "the margin is not positive"),
        ("decay", ("margin",), -1.0, "the margin is not positive"),
    ],
)
def test_an_entry_that_the_claim_must_not_have(name: str, path: tuple[str, ...], to: Any, says: str) -> None:
    assert says in check_document(_changed(name, *path, to=to)).reason


def test_the_distance_from_the_equilibrium_is_in_all_states() -> None:
    made, zero = motion("0", "0"), {"x": 0.0, "y": 0.0}
    assert lyapunov._distance(made, zero, [1.0, 2.0])
    for scales in ([1.0], [1.0] * 3, [0.0, 1.0], [1.0, 0.0], [-1.0, -1.0]):
        refuses("one positive number for each state", lyapunov._distance, made, zero, scales)
    for point in (["x", "y"], {"x": 0.0}, {**zero, "z": 0.0}):
        refuses("does not name every state once", lyapunov._distance, made, point, [1.0, 1.0])


def test_factors_powers_and_rates() -> None:
    assert lyapunov._power("r", {"factor": 0.5, "power": 8}) == "(0.5)*(r)^8"
    for stated in (["factor", "power"], {"factor": 1.0}, {"factor": 1.0, "power": 1, "more": 1},
                   {"factor": 0.0, "power": 1}, {"factor": -1.0, "power": 1}):  # fmt: skip
        refuses("a bound has no positive factor", lyapunov._power, "r", stated)
    for power in (0, 9, 1.0, True, "1"):
        refuses("a power is not an integer", lyapunov._power, "r", {"factor": 1.0, "power": power})
    continuous, discrete = motion("0", "0"), motion("0", "0", discrete=True)
    assert lyapunov._rate(1.0, discrete) and lyapunov._rate(9.0, continuous)
    for rate, made in ((0.0, continuous), (-1.0, discrete), (1.001, discrete)):
        refuses("the rate is not positive, or exceeds 1", lyapunov._rate, rate, made)


def bound(**changes: Any) -> list[Obligation]:
    """A bound of x' = -x + v + w; V = x² for |v| ≤ 1 and -2 ≤ w ≤ 1."""
    made = Motion(("x",), ("x", "v", "w"), [(-9.0, 9.0), (-1.0, 1.0), (-2.0, 1.0)], ["-x + v + w"], False)
    claim = {"rate": 1.0, "inner": 1.0, "level": 10.0, "gains": {"v": 1.0, "w": 2.0}, "function": "x^2",
             **dict.fromkeys(("name", "time", "property", "states", "parameters", "dynamics", "about"))}  # fmt: skip
    frame = dict.fromkeys(("format", "version", "kind", "sha256", "change", "proofs"))
    own = {key: value for key, value in changes.items() if key in ("evidence",)}
    document = {**frame, "claim": claim | {k: v for k, v in changes.items() if k not in own}, **own}
    return lyapunov._bound(document, made, "x^2", "2*x*(-x + v + w)", ["x^2 - 10"])


def test_the_bound_counts_every_disturbance_at_its_worse_end() -> None:
    *faces, decrease = bound()  # inner 1 + 1·1² + 2·2² = 10
    assert len(faces) == 2 and decrease.right.endswith("0 + (1.0)*v^2 + (2.0)*w^2)")
    for change in ({"level": 9.99}, {"inner": 1.01}, {"rate": 0.99}, {"gains": {"v": 1.01, "w": 2.0}},
                   {"gains": {"v": 1.0, "w": 2.01}}):  # fmt: skip
        with pytest.raises(Rejected, match="the bound exceeds the level"):
            bound(**change)
    for gains in ({"v": -1.0}, {"u": 1.0}, {"x": 0.01}):
        with pytest.raises(Rejected, match="a gain is negative, or does not belong to a parameter"):
            bound(gains=gains)
    for change in ({"more": 1}, {"evidence": 1}):
        with pytest.raises(Rejected, match="must have exactly the keys"):
            bound(**change)


# barrier


def test_every_face_has_a_positive_speed() -> None:
    made = motion("-x", "-y")
    needed = barrier._inward(made, "x - 1", [0.1, 0.2, 0.3, 0.4])
    assert [(o.left, o.right) for o in needed] == [
        ("(0.1)", "-x"), ("-x", "-(0.2)"), ("(0.3)", "-y"), ("-y", "-(0.4)"),
    ]  # fmt: skip
    for at in range(4):
        for wrong in (0.0, -1.0):
            speeds = [1.0] * 4
            speeds[at] = wrong
            refuses("one positive number for each face", barrier._inward, made, "x - 1", speeds)
    for speeds in ([1.0] * 3, [1.0] * 5, []):
        refuses("one positive number for each face", barrier._inward, made, "x - 1", speeds)


def stepping(**changes: Any) -> dict[str, Any]:
    """A claim in discrete time, without its proofs: x⁺ = x/2 stays in [-1, 1]."""
    claim = {"name": "n", "time": "discrete", "property": "safety", "states": [_state("x", -1.0, 1.0)],
             "parameters": [], "dynamics": {"x": "x/2"}, "function": "x - 0.5", "initial": [], "unsafe": [],
             "multiplier": None, "about": {}, "stays": True}  # fmt: skip
    document = {"format": 0, "version": 0, "kind": "", "sha256": "", "change": "x/2 - 0.5", "margin": 0.1,
                "inward": None, "proofs": []}  # fmt: skip
    return {**document, **changes, "claim": {**claim, **changes.get("claim", {})}}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({}, "0 proofs, but 5 inequalities"),
        ({"claim": {"multiplier": "1"}}, "the multiplier must be null"),
        ({"inward": [1.0, 1.0]}, "'inward' must be null"),
        ({"claim": {"stays": 1}}, "claim.stays is not true"),
        ({"claim": {"stays": False}}, "claim.stays is not true"),
        ({"claim": {"time": "continuous", "multiplier": "0) + (1"}, "change": "x/2"}, "cannot be read"),
        ({"claim": {"time": "continuous", "multiplier": "1"}, "change": "x/2", "inward": [1.0, 1.0]}, "but 5 ineq"),
    ],
)
def test_what_a_barrier_needs_in_each_time(changes: dict[str, Any], says: str) -> None:
    refuses(says, barrier.check, stepping(**changes))
