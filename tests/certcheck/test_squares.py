import copy
import json
import math
import time
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.certcheck import PATIENCE, check_document, patience
from surctl.certcheck.definite import is_semidefinite
from surctl.certcheck.document import Rejected
from surctl.certcheck.enclosure import span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.identity import Exact
from surctl.certcheck.series import same_sign
from surctl.certcheck.squares import _less, _monomial, _product
from tests.certcheck.altering import sealed
from tests.verification.by_squares import certificate
from tests.verification.made_claims import claim_from

MUTATIONS = 24
BOX = {"x": (-1.0, 1.5), "y": (-0.5, 1.0)}


@pytest.fixture(scope="module")
def originals() -> list[dict[str, Any]]:
    """Proofs with constraints, bounds, facts about functions, denominators, relations and two cases."""
    made = [
        claim_from("disk", BOX, "x + y", "1.5", ("x^2 + y^2 - 1",)),
        claim_from("box", BOX, "x*y*(x - y)", "3.5"),
        claim_from("swing", {"a": (-1.0, 1.0), "w": (-2.0, 2.0)}, "-w^2 - a*sin(a) + 0.5*a*w/(1 + w^2)", "0"),
        claim_from("turn", {"a": (0.5, 1.0)}, "sin(a)*cos(a) - 0.1*a", "0.46"),
        claim_from("root", {"x": (0.0, 2.0)}, "sqrt(1 + x^2)", "1 + x"),
        claim_from("fold", BOX, "abs(x) + y^2", "2.6"),
        claim_from("touch", BOX, "x*y", "x^2 + y^2"),
    ]
    return [certificate(claim) for claim in made]


def test_the_originals_are_accepted_in_little_time_and_use_everything(originals) -> None:
    kinds, relations = set(), 0
    for document in originals:
        began = time.thread_time()
        found = check_document(document, time_limit=2.0)
        assert found.accepted, (document["claim"]["name"], found.reason)
        assert time.thread_time() - began < 1.0
        for case in document["cases"]:
            kinds |= {name[0] for block in case["squares"]["blocks"] for name in block["factors"]}
            relations += len(case["squares"]["relations"])
    assert kinds == set("clhf")
    assert relations


def leaves(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [p for k, v in items for p in leaves(v, (*path, k))] or [path]


def mutated(document: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """A copy with one leaf of the claim or the proof altered, an entry dropped or doubled, or a bolder claim."""
    other = copy.deepcopy(document)
    if rng.random() < 0.3:
        more = f" + {float(10.0 ** rng.uniform(-6, 0)):.8f}"
        for case in other["cases"]:
            case["numerator"] = f"({case['numerator']}{more}" + "".join(f"*({d})" for d in case["denominators"]) + ")"
        other["claim"]["left"] += more
        return other
    apart = ("name", "statement", "unit")
    paths = [p for p in leaves(other) if p[0] in ("claim", "cases") and p[-1] not in apart and len(p) > 2]
    claims = [p for p in leaves(other) if p[0] == "claim" and p[-1] in ("left", "right", "slack", "lower", "upper")]
    chosen = claims if rng.random() < 0.5 else paths
    path = chosen[rng.integers(len(chosen))]
    holder: Any = other
    for key in path[:-1]:
        holder = holder[key]
    value, kind = holder[path[-1]], rng.integers(4)
    if isinstance(value, list):
        holder[path[-1]] = [0]
    elif isinstance(holder, list) and kind == 0 and isinstance(path[-1], int):
        holder.insert(path[-1], copy.deepcopy(value)) if rng.random() < 0.5 else holder.pop(path[-1])
    elif isinstance(value, float):
        holder[path[-1]] = float((value + 1e-6, value - 0.1, -value - 1e-9, value * 1.5 + 1e-3)[kind])
    elif isinstance(value, int):
        holder[path[-1]] = (value + 1, value - 1, -value, value * 3 + 7)[kind]
    elif isinstance(value, str):
        at, letters = int(rng.integers(len(value) + 1)), "0123456789clhf+-*/.^xyat()"
        new = letters[rng.integers(len(letters))]
        holder[path[-1]] = (value[:at] + new + value[at + kind % 2 :], value[:at] + value[at + 1 :])[kind // 2]
    return other


def excess(claim: dict[str, Any], rng: np.random.Generator) -> float:
    """The largest left − right − slack at many points of the domain."""
    names = [v["name"] for v in claim["variables"]]
    spots = rng.uniform(
        [v["lower"] for v in claim["variables"]], [v["upper"] for v in claim["variables"]], size=(3000, len(names))
    )
    scope: dict[str, Any] = {n: spots[:, k] for k, n in enumerate(names)}
    scope |= {"sin": np.sin, "cos": np.cos, "sqrt": np.sqrt, "abs": np.abs, "pi": math.pi}
    with np.errstate(all="ignore"):
        left, right, *guards = (
            np.broadcast_to(eval(text.replace("^", "**"), {"__builtins__": {}}, scope), 3000)
            for text in (claim["left"], claim["right"], *claim["constraints"])
        )
    inside = np.all([g <= 0 for g in guards], axis=0) if guards else np.ones(3000, dtype=bool)
    return float(np.max(np.where(inside, left - right, -np.inf), initial=-np.inf)) - claim["slack"]


def test_no_mutation_proves_a_false_claim(originals) -> None:
    rng = np.random.default_rng(8)
    false = rejected = 0
    for k in range(MUTATIONS):
        other = mutated(originals[k % len(originals)], rng)
        found = check_document(sealed(other), time_limit=PATIENCE)
        rejected += not found.accepted
        if found.accepted:
            assert excess(other["claim"], rng) <= 1e-9, (k, other["claim"])
        else:
            assert "\n" not in found.reason
            try:
                false += excess(other["claim"], rng) > 1e-9
            except (SyntaxError, NameError, TypeError, ValueError, ZeroDivisionError, OverflowError):
                continue
    assert rejected > MUTATIONS / 3
    assert false > MUTATIONS / 20  # false claims were among them


def altered(document: dict[str, Any], change) -> Any:
    other = copy.deepcopy(document)
    change(other["cases"][0]["squares"])
    return check_document(sealed(other), time_limit=PATIENCE)


def _block(**keys):
    return lambda s: s["blocks"][0].update(keys)


def _repeat(s) -> None:
    s["blocks"][0]["monomials"][1] = s["blocks"][0]["monomials"][0]


HOSTILE = {
    "huge denominator": _block(over=10**4000),
    "denominator 0": _block(over=0),
    "negative denominator": _block(over=-8),
    "not a number": _block(over=True),
    "huge entries": lambda s: s["blocks"][0].update(gram=[10**4000] * len(s["blocks"][0]["gram"])),
    "floats": lambda s: s["blocks"][0].update(gram=[0.5] * len(s["blocks"][0]["gram"])),
    "too few entries": lambda s: s["blocks"][0]["gram"].pop(),
    "too many entries": lambda s: s["blocks"][0]["gram"].append(1),
    "indefinite": lambda s: [b["gram"].__setitem__(0, -1) for b in s["blocks"] if b["factors"]],
    "monomial twice": _repeat,
    "exponent 10^9": lambda s: s["blocks"][0]["monomials"].__setitem__(0, [10**9, 0]),
    "negative exponent": lambda s: s["blocks"][0]["monomials"].__setitem__(0, [-1, 0]),
    "exponents of other variables": lambda s: s["blocks"][0]["monomials"].__setitem__(0, [0, 0, 1]),
    "10^5 monomials": _block(monomials=[[k, 0] for k in range(100_000)]),
    "no constraint of that number": lambda s: s["blocks"][1].update(factors=["c7"]),
    "no factor of that kind": lambda s: s["blocks"][1].update(factors=["x0"]),
    "another script's digit": lambda s: s["blocks"][1].update(factors=["c٠"]),
    "many factors": lambda s: s["blocks"][1].update(factors=["h0"] * 40),
    "no factors": lambda s: s["blocks"][1].update(factors=[]),
    "symbol of no real number": lambda s: s["symbols"].append("sqrt(-1 - x^2)"),
    "symbol twice": lambda s: s["symbols"].__setitem__(1, s["symbols"][0]),
    "sum of variables": lambda s: s["symbols"].__setitem__(1, "x + y"),
    "unknown variable": lambda s: s["symbols"].append("z"),
    "no symbols": lambda s: s.update(symbols=[]),
    "relation about a variable": lambda s: s["relations"].append(
        {"symbol": 0, "monomials": [[0, 0]], "factors": [[1, 1]]}
    ),
    "no blocks": lambda s: s.update(blocks=[]),
    "not a list": lambda s: s.update(blocks={"0": 1}),
    "unknown key": lambda s: s.update(tree="n"),
    "block is text": lambda s: s.update(blocks=["x"]),
    "10^4 blocks": lambda s: s.update(blocks=s["blocks"] * 5000),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_proof_is_rejected_in_one_line(originals, name: str) -> None:
    began = time.thread_time()
    found = altered(originals[0], HOSTILE[name])
    assert not found.accepted
    assert found.reason and "\n" not in found.reason and len(found.reason) < 450
    assert time.thread_time() - began < PATIENCE


def test_a_negative_multiple_of_a_bound_proves_nothing() -> None:
    """-(1 - x^2) = -1 (x + 1)(1 - x): the matrix of a block with factors counts as well."""
    document = certificate(claim_from("below", {"x": (-1.0, 1.0)}, "x^2 - 1", "0"))
    squares = {"symbols": ["x"], "facts": [], "relations": []}
    block = {"factors": ["l0", "h0"], "monomials": [[0]], "over": 1}
    for left, entry, accepted in (("x^2 - 1", 1, True), ("1 - x^2", -1, False)):
        case = document["cases"][0] | {"numerator": left, "squares": squares | {"blocks": [block | {"gram": [entry]}]}}
        forged = document | {"claim": document["claim"] | {"left": left}, "cases": [case]}
        assert check_document(sealed(forged)).accepted == accepted


def test_a_monomial_that_occurs_twice_is_named(originals) -> None:
    assert altered(originals[0], _repeat).reason == "a monomial occurs twice"


def test_many_different_denominators_do_not_fill_the_memory(originals) -> None:
    size = 60
    entries = [[1, 2**5000 + 2 * k + 1] for k in range(size * (size + 1) // 2)]
    block = {"factors": ["c0"], "monomials": [[k, 0] for k in range(size)], "over": 1, "gram": entries}
    found = altered(originals[0], lambda s: s["blocks"].extend([block]))
    assert "too many digits" in found.reason


FALSE_FACTS = [
    {"of": "x", "factors": ["sin(t) - t"]},
    {"of": "x", "factors": ["t - sin(t)"]},
    {"of": "x", "factors": ["sin(t) - 0.9*t", "t - sin(t)"]},
    {"of": "x", "factors": ["1 - t^2/2 - cos(t)"]},
    {"of": "x", "factors": ["t", "-t"]},
    {"of": "x", "factors": ["t"]},
    {"of": "x", "factors": ["1/t", "t"]},
    {"of": "x", "factors": ["x"]},
    {"of": "t", "factors": ["t + 9"]},
    {"of": "x", "factors": ["atan2(t, 1) + 3"]},
    {"of": "x", "factors": ["abs(t)"]},
    {"of": "x", "factors": []},
    {"of": "x", "factors": ["1", "1", "1"]},
    {"of": "1/x", "factors": ["t^2"]},
    {"of": 3, "factors": ["t^2"]},
    "t^2",
]


@pytest.mark.parametrize("fact", FALSE_FACTS, ids=str)
def test_a_false_fact_is_rejected(originals, fact: Any) -> None:
    """Used with the matrix 0, so that the fact alone decides."""
    block = {"factors": ["f0"], "monomials": [[0, 0]], "over": 1, "gram": [0]}
    good = {"of": "x", "factors": ["sin(t) - 0.6*t", "t - sin(t)"]}

    def change(given):
        return lambda s: (s["symbols"].append("sin(x)"), [m.append(0) for b in s["blocks"] for m in b["monomials"]],
                          s.update(facts=[given]), s["blocks"].append(block | {"monomials": [[0, 0, 0]]}))  # fmt: skip

    assert altered(originals[0], change(good)).accepted
    found = altered(originals[0], change(fact))
    assert not found.accepted and "\n" not in found.reason


def test_a_root_of_negative_numbers_is_no_symbol() -> None:
    """-1 - x^2 = r^2 for r = sqrt(-1 - x^2), which is not real: 1 + x^2 <= 0 would follow."""
    document = certificate(claim_from("below", {"x": (-1.0, 1.0)}, "-1 - x^2", "0"))
    case = document["cases"][0] | {"numerator": "1 + x^2"}
    case["squares"] = {
        "symbols": ["x", "sqrt(-1 - x^2)"],
        "facts": [],
        "blocks": [{"factors": [], "monomials": [[0, 1]], "over": 1, "gram": [1]}],
        "relations": [{"symbol": 1, "monomials": [[0, 0]], "factors": [[-1, 1]]}],
    }
    forged = document | {"claim": document["claim"] | {"left": "1 + x^2"}, "cases": [case]}
    assert "not defined" in check_document(sealed(forged)).reason


def test_the_bound_of_a_variable_is_the_double_and_its_decimal() -> None:
    """0.1 <= x: the double lies above the decimal 0.1, which belongs to the box."""
    document = certificate(claim_from("end", {"x": (0.1, 1.0)}, "0.09 - x", "0"))
    document["claim"]["left"] = document["cases"][0]["numerator"] = "0.1 + 5e-18 - x"
    case = document["cases"][0]["squares"]
    case["symbols"], case["facts"], case["relations"] = ["x"], [], []
    case["blocks"] = [{"factors": ["l0"], "monomials": [[0]], "over": 1, "gram": [1]},
                      {"factors": [], "monomials": [[0]], "over": 1, "gram": [0]}]  # fmt: skip
    assert not check_document(sealed(document)).accepted
    document["claim"]["left"] = document["cases"][0]["numerator"] = "0.1 - x"
    assert check_document(sealed(document)).accepted


TERMS = st.dictionaries(
    st.tuples(*[st.integers(0, 60)] * 3), st.fractions(-5, 5, max_denominator=9).filter(bool), max_size=6
)


@given(TERMS, TERMS)
@settings(max_examples=20, deadline=None)
def test_packed_polynomials_multiply_like_their_values(a, b) -> None:
    point = [Fraction(1, 2), Fraction(-2, 3), Fraction(3)]

    def value(p: dict[int, Fraction]) -> Fraction:
        return sum(
            (c * math.prod(x ** (m >> 12 * k & 4095) for k, x in enumerate(point)) for m, c in p.items()), Fraction(0)
        )

    p, q = ({_monomial(list(m), 3): c for m, c in terms.items()} for terms in (a, b))
    assert value(_product(p, q)) == value(p) * value(q)
    assert value(_less(p, q)) == value(p) - value(q)


@given(st.integers(1, 9), st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=30, deadline=None)
def test_matrices_are_semidefinite_as_their_fractions_say(size: int, seed: int, singular: bool) -> None:
    rng = np.random.default_rng(seed)
    rows = rng.integers(-9, 10, size=(size, max(size - singular, 1))).tolist()
    gram = [[sum(x * y for x, y in zip(a, b, strict=True)) for b in rows] for a in rows]
    assert is_semidefinite(gram)
    gram[-1][-1] -= 1 + int(rng.integers(3))
    assert is_semidefinite(gram) == _eliminated(gram)


def _eliminated(matrix: list[list[int]]) -> bool:
    m = [[Fraction(x) for x in row] for row in matrix]
    for k in range(len(m)):
        if m[k][k] < 0 or (m[k][k] == 0 and any(m[k][k:])):
            return False
        for i in range(k + 1, len(m)):
            if m[k][k]:
                factor = m[i][k] / m[k][k]
                m[i] = [a - factor * b for a, b in zip(m[i], m[k], strict=True)]
    return True


NAMES = {"sin": math.sin, "cos": math.cos, "sqrt": math.sqrt, "atan": math.atan, "acos": math.acos}


@given(st.sampled_from(sorted(NAMES)), st.lists(st.floats(-2, 2), min_size=3, max_size=3), st.floats(-0.9, 0.8),
       st.floats(0.01, 0.15))  # fmt: skip
@settings(max_examples=20, deadline=None)
def test_a_sign_that_is_shown_is_the_sign_at_points(op: str, c: list[float], low: float, width: float) -> None:
    table = ExpressionTable(["t"])
    text = f"{op}(t) - (({c[0]!r}) + ({c[1]!r})*t + ({c[2]!r})*t^2/(t + 3))"
    if same_sign(table, [table.read(text)], span(low, low + width)):
        for t in np.linspace(low, low + width, 50).tolist():
            assert NAMES[op](t) - (c[0] + c[1] * t + c[2] * t**2 / (t + 3)) >= -1e-12


def test_a_certificate_is_small(originals) -> None:
    assert all(len(json.dumps(document)) < 20_000 for document in originals)


def test_long_terms_count_as_several(monkeypatch: pytest.MonkeyPatch) -> None:
    # products of 1, 2, ..., 100 functions: each is one term, but with up to 100 factors
    monkeypatch.setattr(patience, "MEMORY", 250_000)
    with patience.patient(9.0):
        table = ExpressionTable(["x"])
        root = table.read("*".join(f"exp({k}*x)" for k in range(100)))
        with pytest.raises(Rejected, match="memory"):
            Exact(table).of(root)
