"""The statement of a claim file is its text: nothing is rounded, cancelled, or left undefined in silence."""

from __future__ import annotations

import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import casadi as ca
import pytest
from flint import arb
from hypothesis import given
from hypothesis import strategies as st
from mpmath import mp, mpf

from surctl.certcheck import check_document
from surctl.errors import InputError
from surctl.verification import Verdict, decide, evaluate, load_claim, replay
from surctl.verification.doubtful import UNDEFINED, Pointwise
from surctl.verification.formula import from_casadi, number, parse, text_of, variable
from surctl.verification.formula.parser import decimal_text

X = {"x": variable("x")}


def verdict(
    folder: Path, left: str, right: str, box: tuple[float, float], *constraints: str, more: str = "", limit: float = 2.0
) -> Verdict:
    path = folder / "claim.toml"
    path.write_text(
        f'kind = "claim"\nname = "c"\nleft = "{left}"\nright = "{right}"\nconstraints = {list(constraints)}\n{more}\n'
        f"[variables]\nx = {{ lower = {box[0]}, upper = {box[1]} }}\n",
        encoding="utf-8",
    )
    return decide(load_claim(path), samples=512, starts=4, time_limit=limit)


HUGE = ("1e200*1e200", "1e308/1e-5")
AROUND = ("{}*x", "{}*x - {}*x", "sin({}*x)", "sqrt({}*x)", "atan2({}, x)", "max(x, {})", "x/{}", "select({}, x, 1, 0)")


@pytest.mark.parametrize("form", AROUND)
@pytest.mark.parametrize("huge", HUGE)
def test_a_number_beyond_all_doubles_is_exact_or_named(huge: str, form: str, tmp_path: Path) -> None:
    """No verdict is wrong, and what cannot be decided ends in one line."""
    left = form.replace("{}", huge)
    for right, true in (("1e308*1e308*1e308", True), ("-1e308*1e308*1e308", False), (huge, True)):
        try:
            found = verdict(tmp_path, left, right, (0.5, 1), limit=0.1).verdict
        except InputError as error:
            assert "scale the claim" in str(error)
            continue
        assert found in (("proved", "unknown") if true else ("refuted", "unknown"))


def test_a_box_of_the_largest_doubles_is_divided(tmp_path: Path) -> None:
    for right, expected in (("3e-308*x + 3e-308*x - 3.9", "proved"), ("3e-308*x + 3e-308*x - 5", "refuted")):
        assert verdict(tmp_path, "2", right, (1e308, 1.7e308)).verdict == expected


@pytest.mark.parametrize("text", ["1e309", "2e308", "x*1e310", "１", "٣*x", "x + ２", "xα"])
def test_numbers_are_ascii_and_no_larger_than_a_double(text: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"out of range|not part of the grammar|not expected here|unknown"):
        verdict(tmp_path, text, "5", (0, 1))


@pytest.mark.parametrize(
    ("left", "right", "box", "at"),
    [
        ("x*select(0.1 + 0.2, 0.3, 1, 0)", "0.5", (0, 1), 1.0),
        ("x", "1e16 - 1 - 1e16 + 1", (0, 1), 1.0),
        ("x + 1e20 - x - 1e20 + 1e-30", "0", (0, 1), None),
        ("0", "sin(pi) - 1e-17", (0, 1), None),
        ("x", "1 - 1e-12", (0, 1), 1.0),
        ("x*1.0000000000000000001", "1", (0, 1), 1.0),
    ],
)
def test_no_constant_is_rounded(
    left: str, right: str, box: tuple[float, float], at: float | None, tmp_path: Path
) -> None:
    found = verdict(tmp_path, left, right, box)
    assert found.verdict == "refuted" and found.counterexample is not None
    assert found.counterexample.margin > 0 and at in (None, found.counterexample.values["x"])


@pytest.mark.parametrize(
    ("left", "right", "box", "operation", "at"),
    [
        ("sqrt(x)^2", "x", (-1, 1), "sqrt(x)", None),
        ("log(x) - log(x)", "0", (0, 1), "log(x)", 0.0),
        ("x/x", "1", (-1, 1), "x/x", 0.0),
        ("0", "abs(x) + 0/x", (-1, 2), "0/x", 0.0),
        ("0/(x - 0.3)", "0", (-1, 1), "0/(x - 0.3)", 0.3),
        ("0*acos(x)", "0", (-1, 1.0000001), "acos(x)", 1.0000001),
        ("min(0, 1/(1/x))", "0", (-1, 3), "1/x", 0.0),
        ("0*tan(x)", "0", (-3, 3), "tan(x)", None),
        ("0/(x^2 - 2)", "0", (0, 3), "0/(x^2 - 2)", None),
    ],
)
def test_a_point_without_a_value_refutes(
    left: str, right: str, box: tuple[float, float], operation: str, at: float | None, tmp_path: Path
) -> None:
    found = verdict(tmp_path, left, right, box)
    assert found.verdict == "refuted" and found.counterexample is not None
    beside = ", at a pole less than one double away," if at is None and operation != "sqrt(x)" else ""
    assert found.counterexample.sentence == f"{operation}{beside} is not defined there"
    x = found.counterexample.values["x"]
    assert at in (None, x) and box[0] <= x <= box[1]
    assert found.to_dict()["counterexample"]["margin"] is None
    if beside:
        assert abs(abs(x) - {"tan(x)": mp.pi / 2, "0/(x^2 - 2)": mp.sqrt(2)}[operation]) < 1e-15


@pytest.mark.parametrize(
    ("left", "right", "box", "constraints"),
    [
        ("sin(pi) + 0*x", "0", (0, 1), ()),
        ("x*select(0.1 + 0.2, 0.3, 1, 0)", "x", (0, 1), ()),
        ("log(x) - log(x)", "0", (0.5, 1), ()),
        ("sqrt(x)^2", "x", (0, 1), ()),
        ("log(x) - log(x)", "0", (-1, 1), ("x >= 0.25",)),
        ("0*tan(x)", "0", (-1.5, 1.5), ()),
    ],
)
def test_what_is_true_is_proved_as_it_stands(
    left: str, right: str, box: tuple[float, float], constraints: tuple[str, ...], tmp_path: Path
) -> None:
    found = verdict(tmp_path, left, right, box, *constraints)
    assert found.verdict == "proved" and found.certificate is not None
    stated = found.certificate["claim"]
    assert (stated["left"], stated["right"], stated["slack"]) == (left, right, 0.0)


def test_a_branch_that_is_not_taken_must_be_defined_too(tmp_path: Path) -> None:
    assert verdict(tmp_path, "select(x, 0, 0, 0*log(x))", "0", (-1, 1)).verdict == "unknown"


@pytest.mark.parametrize(("least", "words"), [(0.5, "either"), (2e-3, "proved with tolerance = 0.001"), (0.0, "")])
def test_an_undecided_claim_names_a_tolerance_with_which_it_is_proved(
    least: float, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # sides of size 5: the largest slack of the tolerances is 5e-3
    module = sys.modules["surctl.verification.decide"]
    check, prove = module.check_document, module.prove

    allowed: list[float] = []

    def noted(claim: Any, *, slack: float, **options: Any) -> Any:
        allowed.append(slack)
        return prove(claim, slack=slack, **options)

    def refusing(document: dict[str, Any]) -> Any:
        checked = check(document)
        return checked if allowed[-1] >= least else replace(checked, accepted=False, reason="why")

    monkeypatch.setattr(module, "check_document", refusing)
    monkeypatch.setattr(module, "prove", noted)
    found = verdict(tmp_path, "x^2 - 5", "4", (-2, 2))
    assert (found.verdict == "proved") is (least == 0.0)
    assert words in found.open_ends and (not words or found.open_ends.startswith("the checker rejects the proof: why"))


def test_a_claim_about_nothing_is_called_vacuous(tmp_path: Path) -> None:
    found = verdict(tmp_path, "2", "0", (-3, -2), "x + 1 >= 0")
    assert (found.verdict, found.vacuous) == ("proved", "no point of the box satisfies the constraints")
    assert check_document(found.certificate or {}).vacuous == found.vacuous
    assert not verdict(tmp_path, "-2", "0", (-3, 2), "x + 1 >= 0").vacuous


def test_a_claim_about_a_set_of_which_no_point_is_known_is_called_doubtful(tmp_path: Path) -> None:
    path = tmp_path / "claim.toml"  # two discs that nearly touch
    path.write_text(
        'kind = "claim"\nname = "c"\nleft = "2"\nconstraints = ["x^2 + y^2 <= 1", "(x - 2)^2 + y^2 <= 0.9999999"]\n'
        "[variables]\nx = { lower = -3, upper = 3 }\ny = { lower = -3, upper = 3 }\n"
    )
    result = decide(load_claim(path), samples=512, starts=4, time_limit=20.0)
    assert result.verdict == "proved" and result.vacuous.startswith("perhaps, as no point of the box is known")


def test_a_counterexample_without_a_value_is_restored_and_replayed(tmp_path: Path) -> None:
    found = verdict(tmp_path, "x/x", "1", (-1, 1))
    assert found.counterexample is not None
    assert type(found.counterexample).from_dict(found.counterexample.to_dict()).undefined == "x/x"
    assert replay(found.claim, found.counterexample).confirmed
    assert evaluate(found.claim, {"x": 2.0})[1] is False


@pytest.mark.parametrize("text", ["0.1000000000000000055", "9007199254740993", "-1e-5000"])
def test_a_number_that_a_double_does_not_hold_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"constants\.k.*has digits that a double does not hold"):
        verdict(tmp_path, "k*x", "1", (0, 1), more=f"[constants]\nk = {text}\n")


@given(st.fractions(), st.floats(allow_nan=False, allow_infinity=False))
def test_the_text_of_a_number_is_exact(value: Fraction, double: float) -> None:
    assert Fraction(decimal_text(value)) == value
    assert Fraction(decimal_text(Fraction(double))) == Fraction(double)


def test_a_law_has_its_doubles_to_the_bit() -> None:
    x = ca.SX.sym("x")
    rate = 0.1 * x + ca.pi / 2 + 0.1 * 0.3
    (node,) = from_casadi(x, ["x"], [rate], to_the_bit=True)
    at = Pointwise({"x": Fraction(1)})
    doubles = Fraction(0.1) + Fraction(float(mp.pi) / 2) + Fraction(0.1 * 0.3)
    assert at.sign(node - number(doubles)) == 0
    assert "0.1000000000000000055511151231257827021181583404541015625" in text_of(node)


GROWING = st.recursive(
    st.sampled_from(["x", "0.1", "0.3", "2", "1e17", "pi"]),
    lambda part: st.one_of(
        st.builds("({} + {})".format, part, part), st.builds("({} - {})".format, part, part),
        st.builds("({}*{})".format, part, part), st.builds("({}/{})".format, part, part),
        st.builds("{}({})".format, st.sampled_from(["sqrt", "log", "sin", "abs", "atan"]), part),
    ),
    max_leaves=6,
)  # fmt: skip


@given(GROWING, st.integers(-8, 8))
def test_a_value_at_a_point_is_that_of_mpmath(text: str, at: int) -> None:
    value = Pointwise({"x": Fraction(at, 4)}).value(parse(text, X))
    functions = {"sqrt": mp.sqrt, "log": mp.log, "sin": mp.sin, "abs": abs, "atan": mp.atan, "pi": mp.pi}
    with mp.workdps(120):
        names = {name: f for name, f in functions.items() if name != "pi"} | {"pi": +mp.pi, "x": mpf(at) / 4}
        decimals = text.replace("0.1", "(mpf(1)/10)").replace("0.3", "(mpf(3)/10)").replace("1e17", "mpf(10)**17")
        try:
            own = eval(decimals, {"__builtins__": {}}, names | {"mpf": mpf})
        except (ZeroDivisionError, TypeError):
            assert not isinstance(value, arb)
            return
        if value is UNDEFINED:
            # mpmath goes on with complex numbers, infinities, and rounded zeros
            assert not isinstance(own, mpf) or not mp.isfinite(own) or any(op in text for op in ("/", "log", "sqrt"))
        elif isinstance(value, arb) and isinstance(own, mpf | int):
            low, high = (mp.ldexp(*map(int, end.man_exp())) for end in (value.lower(), value.upper()))
            size = mpf(10) ** -60 * (1 + abs(mpf(own)))
            assert low - size <= own <= high + size
    assert value is None or value is UNDEFINED or value.is_finite()
