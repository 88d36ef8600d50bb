import copy
import json
import time
from typing import Any

import numpy as np
import pytest

from surctl.certcheck import check_document, seal
from surctl.errors import InputError
from surctl.marine.verification import claims
from surctl.verification import falsify, prove
from surctl.verification.formula import parse, to_casadi, variable
from tests.verification.made_claims import claim_from

MUTATIONS = 24


def proved(claim: Any) -> dict[str, Any]:
    proof = prove(claim, time_limit=30.0, slack=1e-12)
    assert proof.certificate is not None, proof.remaining
    return proof.certificate


@pytest.fixture(scope="module")
def originals() -> list[dict[str, Any]]:
    """Proofs by every rule: interval values, monotone faces, tangents, constraints, multipliers, cases."""
    box = {"x": (-1.0, 1.0), "y": (-1.0, 2.0)}
    made = [
        claim_from("touch", box, "x*y", "x^2 + y^2"),
        claim_from("hill", box, "0.3 - (x - 0.21)^2 - 2*(y - 0.4)^2", "0.3 + 1e-9"),
        claim_from("waves", box, "sin(2*x + 0.1) + cos(y)", "2.00001"),
        claim_from("strip", box, "x + y", "0.7", ("x + y - 0.7",)),
        claim_from("disk", box, "x + y", "1.01*sqrt(2)", ("x^2 + y^2 - 1",)),
        claim_from("bent", box, "abs(x) + y - 0.1*y*sin(y)", "3.00001 - 0.2*sin(2)"),
        claim_from("angle", box, "abs(x) + atan2(y, x + 3)", "1.01 + atan2(2, 2)"),
    ]
    names = ["course-corrected", "v2-static"]
    return [proved(c) for c in (*made, *claims(names=names))]


def resealed(document: dict[str, Any]) -> dict[str, Any]:
    evidence = {k: v for k, v in document.items() if k not in ("format", "version", "kind", "claim", "sha256")}
    return seal("interval", document["claim"], evidence)


def test_the_originals_are_accepted_and_use_every_rule(originals) -> None:
    for document in originals:
        found = check_document(document)
        assert found.accepted, (document["claim"]["name"], found.reason)
    rules = {letter for d in originals for case in d["cases"] for letter in case["tree"] if letter.islower()}
    assert {"i", "n", "m", "c"} <= rules


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all leaves."""
    if isinstance(value, dict):
        return [p for k, v in value.items() for p in places(v, (*path, k))]
    if isinstance(value, list) and value:
        return [p for k, v in enumerate(value) for p in places(v, (*path, k))]
    return [path]


def mutated(document: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """A copy with one leaf altered: a number moved, a character changed, dropped, doubled; an entry dropped."""
    other = copy.deepcopy(document)
    mathematics = [
        p for p in places(other) if p[0] in ("claim", "cases") and p[-1] not in ("name", "statement", "unit")
    ]
    path = mathematics[rng.integers(len(mathematics))]
    holder: Any = other
    for key in path[:-1]:
        holder = holder[key]
    value = holder[path[-1]]
    kind = rng.integers(4)
    if isinstance(value, int | float) and not isinstance(value, bool):
        moves = (value + 1e-6, value - 0.1, -value - 1e-9, value * 1.5 + 1e-3)
        holder[path[-1]] = float(moves[kind])
    elif isinstance(value, str):
        at = int(rng.integers(len(value) + 1))
        letters = "0123456789nmcij+-*/.^xy()"
        new = letters[rng.integers(len(letters))]
        ways = (value[:at] + new + value[at + 1 :], value[:at] + value[at + 1 :], value[:at] + new + value[at:])
        holder[path[-1]] = ways[kind % 3]
    elif isinstance(holder, list):
        holder.pop()
    else:
        holder[path[-1]] = [0.0]
    return other


def holds(document: dict[str, Any]) -> bool:
    """Whether the claim as the document now says it survives the falsifier; its slack counts for the right side."""
    claim = document["claim"]
    box = {v["name"]: (v["lower"], v["upper"]) for v in claim["variables"]}
    right = f"{claim['right']} + {float(claim['slack'])!r} + 1e-10"
    made = claim_from("again", box, claim["left"], right, tuple(claim["constraints"]))
    try:
        return falsify(made, samples=512, starts=6).verdict == "not refuted"
    except InputError as error:
        return "empty" in str(error)  # nothing is claimed of an empty domain


def test_every_altered_certificate_is_rejected_by_its_hash_and_with_a_mended_hash_unless_it_is_true(originals) -> None:
    rng = np.random.default_rng(0)
    accepted = 0
    for k in range(MUTATIONS):
        original = originals[k % len(originals)]
        altered = mutated(original, rng)
        while altered == original:
            altered = mutated(original, rng)
        assert not check_document(altered).accepted
        found = check_document(resealed(altered))
        if found.accepted:
            accepted += 1
            assert holds(altered), json.dumps(altered, ensure_ascii=False)
    # what is accepted says less than the original (a smaller box, a larger bound) or says it in other words
    assert accepted < MUTATIONS / 3


def altered(document: dict[str, Any], **changes: Any) -> str:
    """The checker's reason after changes to the claim or the first case."""
    other = copy.deepcopy(document)
    for key, value in changes.items():
        target = other["claim"] if key in other["claim"] else other["cases"][0]
        assert key in target
        target[key] = value
    found = check_document(resealed(other))
    assert not found.accepted
    return found.reason


def test_leaves_that_do_not_cover_are_rejected(originals) -> None:
    (disk,) = (d for d in originals if d["claim"]["name"] == "disk")
    tree = disk["cases"][0]["tree"]
    assert len(tree) > 10
    assert "cover" in altered(disk, tree=tree[:-1])
    assert "goes on" in altered(disk, tree=tree + "n")
    assert "does not decide" in altered(disk, tree="n")
    assert "cover" in altered(disk, tree="")
    assert "does not exist" in altered(disk, tree="7nn")
    assert "not a rule" in altered(disk, tree="x")


def test_a_missing_case_is_rejected(originals) -> None:
    (bent,) = (d for d in originals if d["claim"]["name"] == "bent")
    for cases in (bent["cases"][:1], bent["cases"][:1] * 2, []):
        assert not check_document(resealed({**bent, "cases": cases})).accepted


def test_false_mathematics_is_rejected(originals) -> None:
    by_name = {d["claim"]["name"]: d for d in originals}
    assert "make up" in altered(by_name["v2-static"], right="-(u*e2^2/sqrt(0.25 + (e2 + delta)^2)) - 0.001")
    assert "make up" in altered(by_name["strip"], multipliers=["2"])
    assert "negative" in altered(by_name["strip"], multipliers=["-1"])
    assert "positive" in altered(by_name["v2-static"], denominators=["-1"])
    margin = "0.3 - (x - 0.21)^2 - 2*(y - 0.4)^2 - 0.299999999"
    assert "does not decide" in altered(by_name["hill"], right="0.299999999", numerator=margin)
    points = [[p[0] + 3.0, *p[1:]] for p in by_name["hill"]["cases"][0]["points"]]
    assert points and "does not lie in its box" in altered(by_name["hill"], points=points)


@pytest.mark.parametrize(
    ("left", "right"),
    [
        # names of angles that look alike: 3/(2 v) and 1.5 v, 11/(2 v) and 5.5 v
        ("cos(3/(2*v))", "cos(1.5*v)"),
        ("cos(11/(2*v))", "cos(5.5*v)"),
        ("sin(0.5*v)", "sin(v)"),
        ("sqrt(v^2)", "v"),
        ("acos(cos(v))", "v"),
        ("atan2(v, 1)", "atan2(2*v, 1)"),
        ("sqrt(4*v + 4)", "4*sqrt(v + 1)"),
    ],
)
def test_what_only_looks_equal_is_not_an_identity(left, right) -> None:
    claim = {
        "name": "x", "statement": "", "unit": "1", "left": left, "right": right, "constraints": [], "slack": 0.0,
        "variables": [{"name": "v", "unit": "1", "lower": -0.9, "upper": -0.5}],
    }  # fmt: skip
    case = {"choice": "", "numerator": "0", "denominators": [], "multipliers": [], "tree": "n", "points": []}
    found = check_document(seal("interval", claim, {"cases": [case]}))
    assert not found.accepted and "make up" in found.reason


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("sin(v + pi/2)", "cos(v)"),
        ("cos(acos(v/2) - atan2(1, v))", "(v^2/2 + sqrt(1 - v^2/4))/sqrt(1 + v^2)"),
        ("sin(3*v)", "3*sin(v) - 4*sin(v)^3"),
        ("sqrt(4*v^2 + 8)/2", "sqrt(v^2 + 2)"),
        ("1/(1 - 1/(v + 3))", "(v + 3)/(v + 2)"),
    ],
)
def test_identities_of_paper_and_pencil_are_accepted(left, right) -> None:
    claim = {
        "name": "x", "statement": "", "unit": "1", "left": left, "right": right, "constraints": [], "slack": 0.0,
        "variables": [{"name": "v", "unit": "1", "lower": -0.9, "upper": 0.5}],
    }  # fmt: skip
    case = {"choice": "", "numerator": "0", "denominators": [], "multipliers": [], "tree": "n", "points": []}
    found = check_document(seal("interval", claim, {"cases": [case]}))
    assert found.accepted, found.reason


def forged(
    left: str, right: str, box: list[tuple[float, float]], *, constraints: tuple[str, ...] = (), **case: Any
) -> str:
    """The checker's reason for a certificate made up by hand, in x and y; empty if it is accepted."""
    variables = [
        {"name": n, "unit": "1", "lower": low, "upper": high} for n, (low, high) in zip("xy", box, strict=False)
    ]
    claim = {
        "name": "x", "statement": "", "unit": "1", "left": left, "right": right, "constraints": list(constraints),
        "slack": 0.0, "variables": variables,
    }  # fmt: skip
    rest = {"choice": "", "denominators": [], "multipliers": ["0"] * len(constraints), "points": []}
    whole = {"numerator": f"({left}) - ({right})", **rest, **case}
    found = check_document(seal("interval", claim, {"cases": [whole]}))
    assert found.accepted != bool(found.reason)
    return found.reason


def test_every_rule_refuses_what_it_does_not_show() -> None:
    one = [(-1.0, 1.0)]
    # convex: the tangent at the bottom says nothing of the ends
    assert "'c'" in forged("x^2", "0.5", one, tree="c", points=[[0.0]])
    assert forged("-x^2", "0", one, tree="c", points=[[0.0]]) == ""
    # touching elsewhere than at the top
    assert "'c'" in forged("0.2 - x^2", "0.25", one, tree="c", points=[[0.9]])
    # a kink is not concave, and an angle that jumps has no slope
    assert "'c'" in forged("abs(x)", "0.5", one, tree="c", points=[[0.0]])
    assert "'m'" in forged("atan2(y, x)", "1.6", [(-2.0, -1.0), (-1.0, 1.0)], tree="m")
    assert "'m'" in forged("select(x, 0, 1, -1)", "0.5", one, tree="m")
    assert "'i'" in forged("x", "0", one, constraints=("x - 0.5",), tree="i")
    assert "'j'" in forged("x", "0", one, constraints=("x - 0.5",), tree="j")
    # a variable of monotone influence is at its worse end, whichever that is
    assert "'m'" in forged("x", "0.5", one, tree="m") and "'m'" in forged("-x", "0.5", one, tree="m")
    # where the constraint holds, x y is above 0 for a y below 0
    product: dict[str, Any] = {"constraints": ("x",), "multipliers": ["y"], "numerator": "0", "tree": "n"}
    assert "negative" in forged("x*y", "0", [*one, *one], **product)
    assert forged("x*y", "0", [*one, (0.0, 1.0)], **product) == ""
    assert forged("x", "0.5", one, constraints=("x - 0.5",), tree="0n0ni") != ""
    assert forged("x", "0.5", one, constraints=("x - 0.49",), tree="0n0ni") == ""


def test_a_rewriting_does_not_widen_the_domain_of_what_is_claimed() -> None:
    assert "not defined" in forged("-sqrt(x)*sqrt(x)", "1", [(-1.0, 1.0)], numerator="-x - 1", tree="n")
    assert "not defined" in forged("x/x", "1", [(-1.0, 1.0)], numerator="0", tree="n")
    assert "not defined" in forged("cos(acos(x))", "2", [(-1.5, 1.0)], numerator="x - 2", tree="n")
    assert forged("cos(acos(x))", "2", [(-1.0, 1.0)], numerator="x - 2", tree="n") == ""
    # sqrt(x/y) is sqrt(x y)/|y|, and y is negative
    box = [(-2.0, -1.0), (-2.0, -1.0)]
    assert "unknown sign" in forged("sqrt(x/y)", "sqrt(x*y)/y", box, numerator="0", tree="n")


def test_case_by_case_a_choice_holds_only_under_its_condition() -> None:
    first = {"denominators": [], "multipliers": ["0"], "points": [], "tree": "n"}
    claim = {
        "name": "x", "statement": "", "unit": "1", "left": "max(x, -x)", "right": "0.5", "constraints": [],
        "slack": 0.0, "variables": [{"name": "x", "unit": "1", "lower": -1.0, "upper": 0.25}],
    }  # fmt: skip
    cases = [
        {"choice": "0", "numerator": "x - 0.5", **first},
        {"choice": "1", "numerator": "-x - 0.5", **first},
    ]
    assert "does not decide" in check_document(seal("interval", claim, {"cases": cases})).reason
    claim["variables"][0]["lower"] = -0.5
    assert check_document(seal("interval", claim, {"cases": cases})).accepted
    # its condition read the wrong way round would exclude what is to be shown
    cases[1]["tree"] = "i"
    assert not check_document(seal("interval", claim, {"cases": cases})).accepted


MALFORMED = [
    {"cases": 3}, {"cases": [3]}, {"cases": [{}]}, {"extra": 1}, {"claim": {}}, {"claim": {"variables": []}},
]  # fmt: skip


@pytest.mark.parametrize("change", MALFORMED)
def test_what_is_malformed_is_rejected_and_not_an_error(change, originals) -> None:
    found = check_document(resealed({**originals[0], **change}))
    assert not found.accepted and found.reason


@pytest.mark.parametrize(
    "text", ["", "x +", "(x", "x))", "f(x)", "z", "x y", "x**2", "x^y", "x^2^2", "1e99999", "min(x)", "ä", "(" * 400]
)
def test_what_is_not_of_the_grammar_is_rejected(text, originals) -> None:
    assert altered(originals[0], left=text)


def test_the_two_readers_read_the_same() -> None:
    import casadi as ca
    from mpmath import libmp

    from surctl.certcheck.enclosure import enclose, exact
    from surctl.certcheck.expressions import ExpressionTable

    for text in ("-x^2", "2 - -x", "x/2/y*3", "-(x + y)^-2*2^2", "x - y - 1", "select(x, y, 1, 2) - 3e-1*-x", "--x*.5"):
        sheet, symbols = ExpressionTable(("x", "y")), {n: ca.SX.sym(n) for n in "xy"}
        other = ca.Function("f", [*symbols.values()], [to_casadi(parse(text, {n: variable(n) for n in "xy"}), symbols)])
        (value_,) = enclose(sheet, [sheet.read(text)], [exact(0.7), exact(-1.3)])
        assert libmp.to_float(value_[0]) == pytest.approx(float(other(0.7, -1.3)), rel=1e-14)


def test_a_box_at_the_end_of_the_doubles_has_its_middle_inside() -> None:
    high = [(1e308, 1.7e308)]
    holding = {"constraints": ("select(x, 1.75e308, -1, 1)",)}
    assert "'j'" in forged("1", "0", high, tree="j", **holding)
    assert "'m'" in forged("select(x, 1.75e308, 1, -1)", "0", high, tree="m")
    assert forged("select(x, 1.75e308, -1, 1)", "0", high, tree="0m0mm") == ""
    assert forged("x", "2e308", [(-1.7976931348623157e308, 1.7976931348623157e308)], tree="0n0nn") == ""
    assert forged("x", "0.1", [(5e-324, 1e-323)], tree="0n0nn") == ""


def test_a_bound_that_is_wrong_in_the_22nd_place_is_rejected() -> None:
    left = "acos(-0.15756893157958984375)"  # 1.72902467203182286253...
    assert "'n'" in forged(left, "1.7290246720318228624125", [(0.0, 1.0)], tree="n")
    assert forged(left, "1.7290246720318236", [(0.0, 1.0)], tree="n") == ""


def test_an_end_is_the_decimal_that_is_printed_whether_it_has_a_width_or_not() -> None:
    # the double 0.1 is 5.6e-18 above the decimal, 0.3 is 1.1e-17 below it
    for high in (0.1, 0.10000000000000002, 1.0):
        assert forged("1e-18", "x - 0.1", [(0.1, high)], tree="n", numerator="1e-18 - (x - 0.1)") != ""
        assert forged("-1e-16", "x - 0.1", [(0.1, high)], tree="m") == "" or high == 0.1
    assert forged("-1e-16", "x - 0.1", [(0.1, 0.1)], tree="n", numerator="-1e-16 - (0.1 - 0.1)") == ""
    assert forged("x", "0.299999999999999995", [(0.0, 0.3)], tree="m") != ""
    assert forged("x", "0.3000000000000001", [(0.0, 0.3)], tree="m") == ""
    # and of a tangent, where a variable stands at its end beside a free one
    tangent = {"tree": "c", "points": [[0.0, 0.3]]}
    assert forged("y - x^2", "0.299999999999999995", [(-1.0, 1.0), (0.0, 0.3)], **tangent) != ""
    assert forged("y - x^2", "0.3000000000000001", [(-1.0, 1.0), (0.0, 0.3)], **tangent) == ""


@pytest.mark.parametrize("name", ["pi", "sin", "select", "х", "x٣", "x²", "x\r", "1x", "_x", "", 3])
def test_a_name_is_plain_and_no_other_thing_s(name: object) -> None:
    variable_ = {"name": name, "unit": "1", "lower": 0.0, "upper": 1.0}
    claim = {
        "name": "x", "statement": "", "unit": "1", "left": "1", "right": "2", "constraints": [], "slack": 0.0,
        "variables": [variable_],
    }  # fmt: skip
    case = {"choice": "", "numerator": "1 - 2", "denominators": [], "multipliers": [], "tree": "n", "points": []}
    assert "name" in check_document(seal("interval", claim, {"cases": [case]})).reason
    variable_["name"] = "x_1"
    assert check_document(seal("interval", claim, {"cases": [case]})).accepted
    for unit in ("1\r  variables: x in [-9, 9]", "m\u202e", "\x7f"):
        variable_["unit"] = unit
        assert "printed" in check_document(seal("interval", claim, {"cases": [case]})).reason


def test_a_digit_of_another_script_is_no_digit() -> None:
    assert "cannot be read" in forged("x", "٣", [(-1.0, 1.0)], tree="n")


def test_a_whole_number_that_no_double_holds_is_refused() -> None:
    assert "too large" in forged("x", "9007199254740992", [(0, 2**53 + 1)], tree="n")


@pytest.mark.parametrize(
    ("left", "tree"),
    [
        ("(((x + 1/3)^64)^64)^64", "n"),
        ("cos((((((x + 1/3)^64)^64)^64)^64)^64) + x*0", "n"),
        ("+".join(f"sqrt(x + {k})*sqrt(x + {k + 9})" for k in range(1, 200)), "n"),
        ("x", "0" * 50_000),
        ("x", "0n" * 50_000),
        ("(" * 20_000 + "x" + ")" * 20_000, "n"),
    ],
)
def test_what_is_large_is_answered_at_once(left: str, tree: str) -> None:
    began = time.process_time()
    assert forged(left, "0.1", [(-1.0, 1.0)], tree=tree, numerator=f"({left}) - 0.1000")
    assert time.process_time() - began < 3


def test_a_check_ends_when_its_time_is_up() -> None:
    claim = {
        "name": "x", "statement": "", "unit": "1", "left": "sin(x)", "right": "2", "constraints": [], "slack": 0.0,
        "variables": [{"name": "x", "unit": "1", "lower": -1.0, "upper": 1.0}],
    }  # fmt: skip
    case = {"choice": "", "numerator": "sin(x) - 2", "denominators": [], "multipliers": [], "points": []}
    document = seal("interval", claim, {"cases": [case | {"tree": "0n" * 2000 + "n"}]})
    assert "0.001 s of processor time" in check_document(document, time_limit=0.001).reason
    assert check_document(document).accepted


def test_what_slack_means_is_said(originals) -> None:
    document = copy.deepcopy(originals[0])
    exact = check_document(document)
    assert exact.slack == 0 and exact.proves == "left <= right on the whole domain, exactly"
    document["claim"].update(slack=1e-9, unit="W")
    roomy = check_document(resealed(document))
    assert roomy.to_dict()["slack"] == 1e-9 and "proved to within 1e-09 W" in roomy.to_dict()["proves"]
    assert "no proof of asymptotic stability" in roomy.proves
    assert check_document({**document, "cases": []}).proves == ""
