import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import mp, mpf

from surctl.certcheck import check_document, inequality, seal
from surctl.certcheck.arrays import decimals
from surctl.certcheck.derivative import along
from surctl.certcheck.document import Rejected
from surctl.certcheck.enclosure import Undefined, enclose, exact
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.jets import Tape
from surctl.certcheck.rules import Rules
from surctl.verification.formula import Node, parse, text_of, variable
from tests.verification.expressions import NAMES, NoValue, TooClose, expressions, worth

LARGEST = 1.7976931348623157e308
NEAR = [k * math.pi / 2 for k in (-637, -5, -2, -1, 1, 2, 3, 4, 100, 636)]
HARD = sorted(
    {
        0.0, 5e-324, -5e-324, 2.3e-308, 1e-200, 1e-8, 0.1, 1.0, -1.0, 1.5, 1e3, -1e3, 1e5, 1e16, 1e155, 1e300, LARGEST,
        *(math.nextafter(x, side) for x in (1.0, -1.0, 1e3, *NEAR) for side in (-math.inf, math.inf)), *NEAR,
    }
)  # fmt: skip
TEXTS = (
    "x + y", "x - y", "x*y", "x/y", "x*x", "x^2", "x^3", "x^4", "x^7", "x^-1", "x^-2", "-x", "0.1*x", "pi*x", "sqrt(x)",
    "sin(x)", "cos(x)", "sin(x*y)", "tan(x)", "exp(x)", "log(x)", "atan(x)", "acos(x)", "asin(x)", "sinh(x)", "cosh(x)",
    "tanh(x)", "x^0.5", "x^-1.5", "x^0",
)  # fmt: skip


def read(text: str) -> tuple[ExpressionTable, int, Node]:
    table = ExpressionTable(NAMES)
    return table, table.read(text), parse(text, {n: variable(n) for n in NAMES})


def value_of(root: Node, point: dict[str, mpf]) -> mpf | None:
    try:
        return worth(root, point)
    except (NoValue, TooClose, OverflowError, ValueError):
        return None


def meets(slopes: Any, table: ExpressionTable, root: int, point: list[float], box: int) -> None:
    """Slopes of box number `box` hold those of the derivatives' own expressions at a point, known to 60 bits."""
    for k in range(len(point)):
        rates = [table.put("num", value=int(j == k)) for j in range(len(point))]
        try:
            (theirs,) = enclose(table, [along(table, root, rates)], [exact(x) for x in point])
        except (Undefined, Rejected):  # atan2 has no derivative in the checker
            continue
        first, last = (mp.make_mpf(end) for end in theirs)
        low, high = (mpf(float(end[k, box])) for end in slopes)
        assert not low > last and not high < first


@pytest.mark.parametrize("text", TEXTS)
def test_a_range_holds_the_value_of_sixty_digits_at_the_hardest_arguments(text: str) -> None:
    table, at, root = read(text)
    points = list(itertools.product(HARD, HARD[::3] if "y" in text else (1.0,)))
    others = [(-math.inf, math.inf), (math.nan, 1.0), (LARGEST, math.inf)]
    low = np.array([[x, y, 0.0] for x, y in points] + [[x, 1.0, 0.0] for x, _ in others]).T
    high = np.array([[x, y, 0.0] for x, y in points] + [[x, 1.0, 0.0] for _, x in others]).T
    tape = Tape(table, (at,))
    (jet,), (fine,) = tape.run((low, high), order=1)
    shown, slopes = [np.where(fine, end, np.nan) for end in jet.value], jet.slope
    # the same numbers as ends of intervals
    (other_jet,), (fine,) = tape.run((np.minimum(low, low[:, ::-1]), np.maximum(low, low[:, ::-1])))
    wide = [np.where(fine, end, np.nan) for end in other_jet.value]
    looked = 0
    for k, (x, y) in enumerate(points):
        value = value_of(root, {"x": mpf(x), "y": mpf(y)})
        ends = [float(np.broadcast_to(end, low.shape[1:])[k]) for end in shown]
        if value is None:
            assert math.isnan(ends[0]) or math.isinf(ends[0]) or text in ("tan(x)", "exp(x)"), (x, y, ends)
            continue
        for one, other in (ends, [float(np.broadcast_to(end, low.shape[1:])[k]) for end in wide]):
            assert math.isnan(one) or mpf(one) <= value, (x, y, one)
            assert math.isnan(other) or mpf(other) >= value, (x, y, other)
        if 1e-3 < abs(x) < 900 and 1e-3 < abs(y) < 900 > abs(x * y) and 1e-3 < abs(value) < 1e300:
            looked += 1
            assert ends[1] - ends[0] <= 1e-11 * float(abs(value)), (x, y, ends)
            meets(slopes, table, at, [x, y, 0.0], k)
    assert looked >= 3


boxes = st.lists(
    st.tuples(st.floats(-3, 3), st.sampled_from([0.0, 1e-12, 0.01, 0.3, 2.0])), min_size=3, max_size=3
).map(lambda rows: [(low, low + width) for low, width in rows])


@settings(max_examples=30, deadline=None, derandomize=True)
@given(expressions(branching=False), boxes, st.integers(0, 2**31))
def test_ranges_and_slopes_hold_those_at_points_inside(root: Node, box: list[tuple[float, float]], seed: int) -> None:
    table, at, _ = read("0")
    at = table.read(text_of(root))
    low, high = np.array(box).T[:, :, None]
    (jet,), (fine,) = Tape(table, (at,)).run((low, high), order=1)
    rng = np.random.default_rng(seed)
    for inside in np.clip(low[:, 0] + (high - low)[:, 0] * rng.uniform(size=(5, 3)), low[:, 0], high[:, 0]):
        held = value_of(root, dict(zip(NAMES, map(mpf, inside), strict=True)))
        if held is None or not fine[0]:
            continue
        assert mpf(float(jet.value[0][0])) <= held <= mpf(float(jet.value[1][0]))
        meets(jet.slope, table, at, inside.tolist(), 0)


def claim(right: str, tree: str, left: str = "sin(x) + x - x^3/4", constraints: list[str] | None = None) -> Any:
    constraints = constraints or []
    body = {
        "name": "c", "statement": "", "unit": "1", "left": left, "right": right, "constraints": constraints,
        "slack": 0.0, "variables": [{"name": "x", "unit": "1", "lower": 0.5, "upper": 2.5}],
    }  # fmt: skip
    case = {
        "choice": "", "numerator": f"{left} - ({right})", "denominators": [], "multipliers": ["0"] * len(constraints),
        "tree": tree, "points": [],
    }  # fmt: skip
    return seal("interval", body, {"cases": [case]})


def halved(times: int, rule: str) -> str:
    return rule if not times else "0" + 2 * halved(times - 1, rule)


@pytest.mark.parametrize("rule", "nm")
def test_of_many_boxes_one_false_box_is_noticed(rule: str) -> None:
    """The largest value of sin x + x − x³/4 on [0.5, 2.5] is 1.888305…, at one of 512 boxes."""
    top = mp.findroot(lambda x: mp.cos(x) + 1 - 3 * x**2 / 4, 1.3)
    most = mp.sin(top) + top - top**3 / 4
    assert check_document(claim(mp.nstr(most + 0.01, 15), halved(9, rule))).accepted
    assert check_document(claim(mp.nstr(most - mpf(10) ** -9, 15), halved(9, rule))).reason.startswith("rule")


@pytest.mark.parametrize("rule", "ij")
def test_a_box_counts_as_outside_only_where_a_constraint_is_positive(rule: str) -> None:
    """No x of [0.5, 2.5] has sin x + x ≤ 0.97, as sin 0.5 + 0.5 = 0.9794…; some has sin x + x ≤ 0.98."""
    assert check_document(claim("0", halved(9, rule), "1", ["1e-9*x", "sin(x) + x - 0.97"])).reason == ""
    assert check_document(claim("0", halved(9, rule), "1", ["-1", "sin(x) + x - 0.97"])).reason == ""
    assert check_document(claim("0", halved(9, rule), "1", ["-1", "sin(x) + x - 0.98"])).reason.startswith("rule")


def rules_of(text: str, constraint: str = "-1") -> Rules:
    table = ExpressionTable(["x"])
    return Rules(*(Tape(table, (table.read(each),)) for each in (text, constraint)), 0.0, decimals)


def test_a_bound_between_a_double_and_its_decimal_is_not_proved() -> None:
    """The double 0.3 is less than the decimal by 1.1e-17, and the other number is a double."""
    box = np.full((1, 32), 0.1), np.full((1, 32), 0.3)
    for bound, wanted in (("7.6293945312e-07", False), ("7.63e-07", True)):
        shown = rules_of(f"x - 0.299999237060546875 - {bound}").natural(box)
        assert shown.tolist() == [wanted] * 32


def test_a_number_whose_decimal_is_a_double_stands_for_itself_alone() -> None:
    ends = np.array([[0.5, 0.1, 0.3, 1e300]])
    low, high = decimals(ends, ends)
    assert low[0, 0] == high[0, 0] == 0.5
    assert low[0, 1] < high[0, 1] == 0.1, "the decimal 0.1 is less than the double"
    assert low[0, 2] == 0.3 < high[0, 2], "the decimal 0.3 is more than the double"


def is_defined(text: str, low: float, high: float) -> bool:
    """Whether an expression of the next test is defined on a whole interval."""
    if "tan" in text:
        return not any(low <= pole <= high for pole in (-math.pi / 4, math.pi / 4))
    if "sqrt" in text or "log" in text:
        return low > 0 or (low == 0 and "sqrt" in text)
    return not low <= 0 <= high


def test_what_is_not_defined_on_a_whole_box_proves_nothing() -> None:
    boxes_ = [(-1.0 + k / 16, -0.9 + k / 16) for k in range(32)]
    low, high = np.array(boxes_).T[:, None]
    for text in ("0/x - 1", "sqrt(x) - 9", "0*log(x)^2 - 1", "1/x^3*0 - 1", "x/x - 2", "tan(2*x)*0 - 1"):
        rules = rules_of(text, f"-({text})")
        defined = np.array([is_defined(text, *ends) for ends in boxes_])
        box = low, high
        shown = (rules.natural(box), rules.outside(box), rules.by_slopes(box)[0], rules.outside_by_slopes(box)[0])
        assert not np.any(np.logical_or.reduce(shown) & ~defined), text
        assert shown[0].any(), text


def test_without_gradual_underflow_nothing_is_proved(monkeypatch) -> None:
    assert check_document(claim("9", "n")).accepted
    monkeypatch.setattr(inequality, "has_gradual_underflow", lambda: False)
    assert "denormal numbers" in check_document(claim("9", "n")).reason
