from collections.abc import Callable
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from mpmath import mp, mpf

from surctl.certcheck import arrays as iv
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.jets import Tape
from surctl.certcheck.rules import Rules
from surctl.verification.formula import number, parse, variable
from surctl.verification.proving import functions as fn
from surctl.verification.proving.search import apply_rules
from surctl.verification.proving.tape import build_tape
from tests.verification.expressions import worth

COUNT = 4000


def drawn(seed: int, scale: float = 8.0) -> tuple[np.ndarray, np.ndarray]:
    """Intervals of all widths, some of them points, some with an end at 0."""
    rng = np.random.default_rng(seed)
    low = rng.uniform(-scale, scale, COUNT)
    low[:200] = 0.0
    width = 10.0 ** rng.uniform(-6, 1, COUNT) * (rng.uniform(size=COUNT) > 0.1)
    return low, low + width


def inside(a: tuple[np.ndarray, np.ndarray], seed: int) -> np.ndarray:
    """(40, COUNT): points of each interval, its ends among them."""
    share = np.random.default_rng(seed).uniform(size=(40, COUNT))
    share[0], share[1] = 0.0, 1.0
    return np.clip(a[0] + share * (a[1] - a[0]), *a)


def holds(ends: tuple[np.ndarray, np.ndarray], values: np.ndarray) -> None:
    # NumPy's own values are off by some units in the last place
    room = 1e-15 * np.abs(values)
    assert np.all((ends[0] - room <= values) & (values <= ends[1] + room))


@pytest.mark.parametrize("scale", [1.0, 8.0, 1000.0])
def test_sine_and_cosine_keep_their_crests_and_troughs(scale: float) -> None:
    a = drawn(1, scale)
    sine, cosine = fn.sine(a), fn.cosine(a)
    x = inside(a, 2)
    holds(sine, np.sin(x))
    holds(cosine, np.cos(x))
    narrow = a[1] - a[0] < 1e-3
    assert np.all((sine[1] - sine[0])[narrow] < 2e-3), "an interval without a crest does not reach it"


def test_the_angle_of_a_box_keeps_all_directions() -> None:
    y, x = drawn(3, 2.0), drawn(4, 2.0)
    holds(fn.atan2(y, x), np.arctan2(inside(y, 5), inside(x, 6)))
    ahead = (x[0] > 0) & (x[1] - x[0] < 1e-3) & (y[1] - y[0] < 1e-3) & (x[0] > 0.1)
    low, high = fn.atan2(y, x)
    assert ahead.any() and np.all((high - low)[ahead] < 0.1)


@pytest.mark.parametrize(("y", "cut"), [((-0.5, 0.0), True), ((-0.5, 0.5), True), ((0.1, 0.5), False)])
def test_below_the_negative_axis_the_angle_begins_at_minus_a_half_turn(y: tuple[float, float], cut: bool) -> None:
    low, high = fn.atan2((np.array([y[0]]), np.array([y[1]])), (np.array([-2.0]), np.array([-1.0])))
    inside_low = np.arctan2(min(-1e-12, y[1]) if cut else y[0], -2.0)
    assert low[0] <= inside_low and high[0] >= np.arctan2(y[1], -2.0)
    assert (low[0] < 0) == cut


@pytest.mark.parametrize("exponent", [0, 1, 2, 3, 4, 5])
def test_powers(exponent: int) -> None:
    a = drawn(7, 2.0)
    holds(iv.to_power(a, exponent), inside(a, 8) ** exponent)
    if exponent % 2 == 0:
        assert np.all(iv.to_power(a, exponent)[0] >= 0)


@pytest.mark.parametrize("name", ["add", "subtract", "multiply", "divide", "hull_min", "hull_max"])
def test_two_intervals(name: str) -> None:
    a, b = drawn(9), drawn(10)
    with np.errstate(all="ignore"):
        ends = getattr(iv, name)(a, b)
        x, y = inside(a, 11), inside(b, 12)
        plain = {
            "add": x + y, "subtract": x - y, "multiply": x * y, "divide": x / y,
            "hull_min": np.minimum(x, y), "hull_max": np.maximum(x, y),
        }[name]  # fmt: skip
    holds(ends, np.where(np.isnan(plain), 0.0, plain))


def mixed(seed: int, count: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Intervals of both signs, many of them points, from subnormal numbers to such whose products are infinite."""
    rng = np.random.default_rng(seed)
    size = np.where(rng.uniform(size=count) < 0.8, rng.uniform(-3, 3, count), rng.uniform(-320, 300, count))
    one = rng.choice((-1.0, 1.0), count) * rng.uniform(1, 10, count) * 10.0**size
    other = np.where(rng.uniform(size=count) < 0.5, one, one * rng.uniform(-1, 2, count))
    one[:10] = 0.0
    return np.minimum(one, other), np.maximum(one, other)


def contains(ends: tuple[np.ndarray, np.ndarray], wanted: list[tuple[Fraction, Fraction]]) -> None:
    """Each interval holds all that is wanted, to the last bit, and reaches no further than is rounded."""
    for low, high, (least, most) in zip(*ends, wanted, strict=True):
        assert low == -np.inf or Fraction(float(low)) <= least
        assert high == np.inf or Fraction(float(high)) >= most
        room = Fraction(max(abs(least), abs(most)), 2**49) + Fraction(5e-322)
        if max(abs(least), abs(most)) < Fraction(1e300):
            assert Fraction(float(low)) >= least - room and Fraction(float(high)) <= most + room


EXACT: dict[str, Callable[[Fraction, Fraction], Fraction]] = {
    "add": lambda x, y: x + y, "subtract": lambda x, y: x - y, "multiply": lambda x, y: x * y,
    "divide": lambda x, y: x / y, "hull_min": min, "hull_max": max,
}  # fmt: skip


@pytest.mark.parametrize("name", EXACT)
def test_two_intervals_hold_every_exact_result(name: str) -> None:
    a, b = mixed(17), mixed(18)
    kept = (b[0] > 0) | (b[1] < 0) if name == "divide" else np.full(a[0].shape, True)
    a, b = (a[0][kept], a[1][kept]), (b[0][kept], b[1][kept])
    operate = getattr(iv, name)
    with np.errstate(all="ignore"):
        ends = operate(a, b)
        # alone, without others that underflow, an interval may take another way through the code
        alone = [operate((a[0][k], a[1][k]), (b[0][k], b[1][k])) for k in np.arange(len(a[0]))[:, None]]
    np.testing.assert_array_equal(np.hstack(alone), ends)
    corners = [
        [EXACT[name](Fraction(x), Fraction(y)) for x, y in product(one, other)]
        for one, other in zip(np.transpose(a).tolist(), np.transpose(b).tolist(), strict=True)
    ]
    contains(ends, [(min(found), max(found)) for found in corners])


@pytest.mark.parametrize("exponent", [2, 3, 4, 5])
def test_a_power_holds_every_exact_result(exponent: int) -> None:
    a = mixed(19)
    with np.errstate(all="ignore"):
        ends = iv.to_power(a, exponent)
    wanted = []
    for low, high in np.transpose(a).tolist():
        found = [Fraction(low) ** exponent, Fraction(high) ** exponent]
        wanted.append((Fraction(0) if exponent % 2 == 0 and low <= 0 <= high else min(found), max(found)))
    contains(ends, wanted)


def test_a_root_holds_the_exact_one() -> None:
    a = mixed(20)
    for low, high, least, most in zip(*iv.squared_root(a), *a, strict=True):
        assert low >= 0.0 and Fraction(float(low)) ** 2 <= max(Fraction(float(least)), 0)
        assert Fraction(float(high)) ** 2 >= max(Fraction(float(most)), 0)
        assert low == np.sqrt(max(least, 0.0)) == 0.0 or low >= np.sqrt(least) * (1 - 1e-15)
        assert high <= np.sqrt(max(most, 0.0)) * (1 + 1e-15)


def quick(op: str, a: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    return fn.quick_functions(op, Fraction(0), [a])[0]


def test_what_a_library_computes_holds_the_value_of_sixty_digits() -> None:
    rng = np.random.default_rng(21)
    x, y = rng.uniform(-9, 9, 300), rng.uniform(-9, 9, 300) * 10.0 ** rng.uniform(-8, 0, 300)
    share = rng.uniform(-1, 1, 300)
    sine, cosine = fn.sine(iv.point(x)), fn.cosine(iv.point(x))
    told = (
        (sine, mp.sin, (x,)), (cosine, mp.cos, (x,)), (quick("acos", iv.point(share)), mp.acos, (share,)),
        (fn.atan2(iv.point(y), iv.point(x)), mp.atan2, (y, x)), (quick("asin", iv.point(share)), mp.asin, (share,)),
        (quick("tanh", iv.point(y)), mp.tanh, (y,)), (quick("exp", iv.point(share)), mp.exp, (share,)),
        (quick("sinh", iv.point(share)), mp.sinh, (share,)), (quick("cosh", iv.point(share)), mp.cosh, (share,)),
        (fn.tan(iv.point(share)), mp.tan, (share,)), (quick("log", iv.point(abs(y))), mp.log, (abs(y),)),
        *((fn.powr(iv.point(abs(x)), e), lambda b, e=e: mp.mpf(b) ** (mpf(e.numerator) / e.denominator), (abs(x),))
          for e in (Fraction(1, 2), Fraction(3, 2), Fraction(-1, 10), Fraction(2, 3))),
    )  # fmt: skip
    with mp.workdps(60):
        for (low, high), function, given in told:
            for a, b, *at in zip(low.tolist(), high.tolist(), *(g.tolist() for g in given), strict=True):
                assert mpf(a) <= function(*map(mpf, at)) <= mpf(b) and b - a < 1e-13


def test_sums_that_are_exact_are_not_widened_and_others_are() -> None:
    low, high = iv.add(iv.point(np.array([0.5, 0.1, 1e300])), iv.point(np.array([0.25, 0.2, 1.0])))
    assert low[0] == high[0] == 0.75
    assert low[1] < high[1] == 0.1 + 0.2, "0.1 + 0.2 was rounded up, so only the lower end moves"
    assert low[2] == 1e300 < high[2]


def test_nothing_times_the_whole_line_is_nothing() -> None:
    with np.errstate(all="ignore"):
        low, high = iv.multiply(iv.point(np.zeros(1)), (np.array([-np.inf]), np.array([np.inf])))
    assert low[0] == high[0] == 0.0


TEXTS = (
    "x^3", "x^-2", "1/x", "sqrt(x)", "sin(x)", "cos(x)", "acos(x/3)", "atan(x)", "atan2(x, y)", "atan2(y, x)*y",
    "x*y", "x*x", "(x + y)^2/x", "abs(-x)*y", "max(x, -y)*x", "min(x, 9)*sin(y)", "select(x, 9, x*y, y)",
    "exp(x - y)", "log(x + y)", "tan(x)*y", "asin(x - y/2)", "sinh(x)",
    "cosh(x*y)", "tanh(2*x)", "x^0.5", "x^(3/2)*y", "(x + y)^-1.5", "y^(1/3)",
)  # fmt: skip


@pytest.mark.parametrize("text", TEXTS)
def test_first_and_second_derivatives_at_a_point_are_those_of_sixty_digits(text: str) -> None:
    at = {"x": 0.75, "y": 0.4375}
    root = parse(text, {n: variable(n) for n in at})
    sheet = ExpressionTable(tuple(at))
    place = sheet.read(text)
    point = np.array([[v] for v in at.values()])
    (exactly,) = Tape(sheet, (place,)).run((point, point), order=2).jets
    jet = build_tape(tuple(at), [root]).run((point, point), order=2).jets[0]
    with mp.workdps(60):
        h = mpf(10) ** -15

        def value(*steps):
            return worth(root, {n: mpf(at[n]) + k * h for n, k in zip("xy", steps, strict=True)})

        centre = value(0, 0)
        ahead, behind = (value(1, 0), value(0, 1)), (value(-1, 0), value(0, -1))
        for i in (0, 1):
            first = (ahead[i] - behind[i]) / (2 * h)
            second = (ahead[i] - 2 * centre + behind[i]) / h**2
            for found in (jet, exactly):
                near((found.slope[0][i, 0], found.slope[1][i, 0]), first)
                near((found.bend[0][i, i, 0], found.bend[1][i, i, 0]), second)
        mixed = (value(1, 1) - value(1, -1) - value(-1, 1) + value(-1, -1)) / (4 * h**2)
        for found in (jet, exactly):
            near((found.bend[0][0, 1, 0], found.bend[1][0, 1, 0]), mixed)


def near(ends, value) -> None:
    """The value lies in a narrow interval."""
    if ends is None:
        ends = (0.0, 0.0)
    low, high = (mp.make_mpf(e) if isinstance(e, tuple) else mpf(float(e)) for e in ends)
    assert low - mpf(10) ** -12 <= value <= high + mpf(10) ** -12
    assert high - low < 1e-10


def test_slopes_over_a_box_hold_those_at_its_points() -> None:
    rng = np.random.default_rng(13)
    known = {n: variable(n) for n in "xy"}
    for text in TEXTS:
        sheet = ExpressionTable(("x", "y"))
        place = sheet.read(text)
        tape = build_tape(("x", "y"), [parse(text, known)])
        low = rng.uniform(0.3, 0.6, (2, 30))
        high = low + rng.uniform(0, 0.4, (2, 30))
        wide = tape.run((low, high), order=2).jets[0]
        at = low + (high - low) * rng.uniform(size=low.shape)
        narrow = tape.run((at, at), order=2).jets[0]
        for outer, inner in ((wide.slope, narrow.slope), (wide.bend, narrow.bend)):
            room = 1e-12 * (1 + np.abs(inner[0]))
            assert np.all(outer[0] - room <= inner[1]) and np.all(inner[0] <= outer[1] + room), text
        # the checker's ranges are those of the prover, but for rounding: what one proves, the other accepts
        checked = Tape(sheet, (place,)).run((low, high), order=2).jets[0]
        for mine, theirs in zip((checked.slope, checked.bend), (wide.slope, wide.bend), strict=True):
            np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-11, err_msg=text)


def test_a_decimal_lies_between_the_doubles_beside_it() -> None:
    texts = ("0.1", "0.3", "1/3", "0.5", "12345678901234567.1", "1.00000000000000011")
    read = build_tape(("x",), [parse(text, {}) for text in texts]).run((np.zeros((1, 1)), np.zeros((1, 1))))
    for text, jet in zip(texts, read.jets, strict=True):
        low, high = (float(end[0]) for end in jet.value)
        above, below = text.split("/") if "/" in text else (text, "1")
        exactly = Fraction(above) / Fraction(below)
        assert Fraction(low) <= exactly <= Fraction(high)
        assert high <= np.nextafter(low, np.inf) or "/" in text


@pytest.mark.parametrize(
    ("margin", "constraint", "rule"),
    [
        *(("x - 2", "-1", "n"), ("x - 0.5", "-1", ""), ("x - 0.5", "0.25 + x", "i"), ("x - 0.5", "x - 0.25", "")),
        *(
            ("x - x*x/4 - 0.76", "-1", "m"),
            ("x - x*x/4 - 0.74", "-1", ""),
            ("1", "x - x*x + 0.3", "j"),
            ("1", "x - x*x", ""),
        ),
    ],
)
def test_a_rule_settles_only_what_it_shows(margin: str, constraint: str, rule: str) -> None:
    """margin ≤ 0 where constraint ≤ 0, on [0, 1]: by its values, by its slopes, or because nothing is asked there."""
    known = {"x": variable("x")}
    bound, constraints = (build_tape(("x",), [parse(text, known)]) for text in (margin, constraint))
    box = np.zeros((1, 1)), np.ones((1, 1))
    found = apply_rules(Rules(bound, constraints, 0.0), box, np.ones(1, dtype=bool)).rule[0]
    assert found == rule


def test_a_divisor_nearer_to_0_than_every_double_has_no_quotient_in_doubles() -> None:
    for sign in (1, -1):
        tape = build_tape(("x",), [variable("x") / number(Fraction(sign, 10**400))])
        assert tape.run((np.zeros((1, 1)), np.ones((1, 1)))).jets[0].value[1][0] == np.inf
