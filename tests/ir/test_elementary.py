"""Elementary functions without a mathematical library: how exact, and what happens where they have no value."""

from __future__ import annotations

import math
from decimal import Decimal, localcontext
from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.ir import Loop, Program, Routine, compile_block, lower, replay, without_libm
from surctl.ir.c99 import Real
from surctl.ir.program import LIBM
from tests.ir.expressions import LIBM_MAKERS
from tests.tools import need_compiler


@cache
def alone(name: str, real: Real = "float64") -> Program:
    x = ca.SX.sym("x", 2)
    made = getattr(ca, name)(x[0], x[1]) if name == "atan2" else getattr(ca, name)(x[0])
    block = without_libm(lower(ca.Function(name, [x], [made])), real)
    assert isinstance(block, Program) and not block.libm
    return block


def value(name: str, a: float, b: float = 0.0, *, real: type = np.float64) -> float:
    return float(replay(alone(name), [a, b], real=real)[0][0])


@cache
def pi() -> Decimal:
    """Machin: π/4 = 4 atan(1/5) − atan(1/239), 80 digits."""
    with localcontext(prec=80):
        return 4 * (4 * arctan(Decimal(1) / 5) - arctan(Decimal(1) / 239))


def arctan(t: Decimal) -> Decimal:
    """Taylor's series after the angle is halved until it is small."""
    halvings = 0
    while abs(t) > Decimal("0.05"):
        t, halvings = t / (1 + (1 + t * t).sqrt()), halvings + 1
    total, term, k = Decimal(0), t, 1
    while abs(term) > Decimal("1e-60"):
        total, term, k = total + term / k, -term * t * t, k + 2
    return total * 2**halvings


def exact(name: str, a: float, b: float = 0.0) -> Decimal:
    with localcontext(prec=80):
        x, y = Decimal(b), Decimal(a)
        if name == "acos":
            x, y = y, ((1 - y) * (1 + y)).sqrt()
        if name in ("acos", "atan2"):
            turn = pi() if x < 0 else Decimal(0)
            angle = arctan(y / x) if x else pi() / 2 * (1 if y > 0 else -1)
            return angle + (turn if y >= 0 else -turn)
        reduced = y % (2 * pi())
        power = reduced if name == "sin" else Decimal(1)
        total, k = Decimal(0), 1 if name == "sin" else 0
        while abs(power) > Decimal("1e-50"):
            total, power, k = total + power, -power * reduced * reduced / ((k + 1) * (k + 2)), k + 2
        return total


SIZES = st.one_of(st.floats(-4, 4), st.floats(-1e5, 1e5), st.integers(-60000, 60000).map(lambda k: k * math.pi / 2))


@settings(max_examples=25)
@given(a=SIZES)
@pytest.mark.parametrize("name", ["sin", "cos"])
def test_sin_and_cos_against_eighty_digits(name: str, a: float) -> None:
    assert abs(Decimal(value(name, a)) - exact(name, a)) < Decimal("2e-16")


@settings(max_examples=25)
@given(a=SIZES, b=SIZES)
def test_atan2_against_eighty_digits(a: float, b: float) -> None:
    if a or b:
        assert abs(Decimal(value("atan2", a, b)) - exact("atan2", a, b)) < Decimal("5e-16")


@settings(max_examples=25)
@given(a=st.one_of(st.floats(-1, 1), st.sampled_from([1 - 2.0**-53, 2.0**-53 - 1, 0.5, -0.5, 1e-300])))
def test_acos_against_eighty_digits(a: float) -> None:
    assert abs(Decimal(value("acos", a)) - exact("acos", a)) < Decimal("5e-16")


@settings(max_examples=25)
@given(a=st.one_of(st.floats(-708, 709.4), st.floats(-2, 2), st.sampled_from([1e-300, -1e-17, 88.0, math.log(2) / 2])))
def test_exp_against_eighty_digits(a: float) -> None:
    with localcontext(prec=80):
        assert abs(Decimal(value("exp", a)) / Decimal(a).exp() - 1) < Decimal("4e-16")


@settings(max_examples=25)
@given(
    a=st.one_of(
        st.floats(5e-324, 1.79e308), st.floats(0.5, 2), st.sampled_from([1 - 2.0**-53, 1 + 2.0**-52, math.sqrt(2), 0.5])
    )
)
def test_log_against_eighty_digits(a: float) -> None:
    with localcontext(prec=80):
        wanted = Decimal(a).ln()
        assert abs(Decimal(value("log", a)) - wanted) <= Decimal("4e-16") * abs(wanted)


@settings(max_examples=25)
@given(a=st.one_of(st.floats(-30, 30), st.floats(-1e300, 1e300)))
def test_tanh_and_tan_against_eighty_digits(a: float) -> None:
    with localcontext(prec=80):
        e = (2 * Decimal(max(-90.0, min(90.0, a)))).exp()
        assert abs(Decimal(value("tanh", a)) - (e - 1) / (e + 1)) < Decimal("4e-16")
        b = a if abs(a) < 1e5 else math.atan(a)
        wanted = exact("sin", b) / exact("cos", b)
        assert abs(Decimal(value("tan", b)) - wanted) < Decimal("8e-16") * (1 + wanted**2)


def test_small_angles_keep_their_relative_accuracy() -> None:
    for a in (1e-8, -3e-5, 0.01, 0.3):
        for name, args in (("sin", (a,)), ("atan2", (a, 1.0))):
            assert abs(Decimal(value(name, *args)) / exact(name, *args) - 1) < Decimal("3e-16")


def test_many_against_numpy() -> None:
    rng = np.random.default_rng(3)
    x = rng.uniform(-1, 1, (20000, 2)) * 10.0 ** rng.uniform(-3, 5, (20000, 1))
    np.testing.assert_allclose(replay(alone("sin"), x)[0][:, 0], np.sin(x[:, 0]), rtol=0, atol=3e-16)
    np.testing.assert_allclose(replay(alone("cos"), x)[0][:, 0], np.cos(x[:, 0]), rtol=0, atol=3e-16)
    np.testing.assert_allclose(replay(alone("atan2"), x)[0][:, 0], np.arctan2(x[:, 0], x[:, 1]), rtol=4e-16, atol=0)


@pytest.mark.parametrize(
    ("name", "bound"), [("sin", 1.5e-7), ("cos", 1.5e-7), ("atan2", 4e-7), ("acos", 4e-7), ("tanh", 2e-7)]
)
def test_in_float(name: str, bound: float) -> None:
    rng = np.random.default_rng(4)
    x = rng.uniform(-1, 1, (20000, 2)) * (1.0 if name == "acos" else 3000.0)
    x[:2000] /= 1.0 if name == "acos" else 1000.0
    x[2000:] *= 3e-3 if name == "tanh" else 1.0
    x = x.astype(np.float32).astype(float)
    numpy = {"sin": np.sin, "cos": np.cos, "acos": np.arccos, "tanh": np.tanh}
    want = np.arctan2(x[:, 0], x[:, 1]) if name == "atan2" else numpy[name](x[:, 0])
    have = replay(alone(name), x, real=np.float32)[0][:, 0]
    assert np.abs(have.astype(float) - want).max() < bound


def test_exp_and_log_in_float() -> None:
    x = np.random.default_rng(5).uniform(-86.9, 88, (20000, 2)).astype(np.float32)
    with np.errstate(under="ignore"):
        sizes = np.exp(x[:, 0].astype(float)).astype(np.float32)
    exp, log = alone("exp", "float32"), alone("log", "float32")
    have = replay(exp, x, real=np.float32)[0][:, 0] / np.exp(x[:, 0].astype(float))
    assert np.abs(have - 1).max() < 3e-7
    have = replay(log, np.column_stack([sizes, sizes]), real=np.float32)[0][:, 0]
    wanted = np.log(sizes.astype(float))
    assert (np.abs(have - wanted) <= 3e-7 * np.abs(wanted)).all()


def test_quadrants_axes_and_zeros() -> None:
    for a, b in [(1, 1), (1, -1), (-1, 1), (-1, -1), (0, 1), (0, -1), (1, 0), (-1, 0), (3, 4), (-1e-300, -1e300)]:
        assert value("atan2", a, b) == pytest.approx(math.atan2(a, b), rel=3e-16)
    for a, b in [(np.inf, 1), (-np.inf, 1), (1, np.inf), (1, -np.inf), (5e-324, 5e-324), (5e-324, 1.0)]:
        assert value("atan2", a, b) == pytest.approx(math.atan2(a, b), rel=3e-16)
    zeros = [(a, b) for a in (0.0, -0.0) for b in (0.0, -0.0)]
    assert all(value("atan2", a, b) == 0.0 for a, b in zeros)
    assert value("atan2", -0.0, -1.0) == math.pi  # a zero of either sign is +0
    assert math.copysign(1.0, value("sin", -0.0)) == -1.0 and value("sin", 0.0) == 0.0
    assert value("cos", -0.0) == 1.0 and value("acos", 1.0) == 0.0 and value("acos", -1.0) == math.pi


@pytest.mark.parametrize("real", [np.float64, np.float32])
def test_what_has_no_value_is_nan(real: type) -> None:
    for a in (np.nan, np.inf, -np.inf, 2.0**21, -1e30):
        assert math.isnan(value("sin", a, real=real)) and math.isnan(value("cos", a, real=real))
    inf = np.inf
    for a, b in [(np.nan, 1), (1, np.nan), (np.nan, np.nan), (0, np.nan), (np.nan, 0), (inf, inf), (-inf, inf)]:
        assert math.isnan(value("atan2", a, b, real=real))
    for a in (1.0000002, -1.0000002, np.nan, np.inf):
        assert math.isnan(value("acos", a, real=real))


@pytest.mark.parametrize("real", ["float64", "float32"])
def test_ends_of_exp_log_and_tanh(real: Real) -> None:
    dtype = np.float64 if real == "float64" else np.float32

    def at(name: str, a: float) -> float:
        return float(replay(alone(name, real), [a, 0.0], real=dtype)[0][0])

    inf = math.inf
    assert [at("exp", a) for a in (inf, 710.0, -inf, -720.0, 0.0, -0.0)] == [inf, inf, 0.0, 0.0, 1.0, 1.0]
    assert [at("log", a) for a in (inf, 0.0, -0.0, 1.0)] == [inf, -inf, -inf, 0.0]
    assert [at("tanh", a) for a in (inf, -inf, 1e30, -1e30, 0.0)] == [1.0, -1.0, 1.0, -1.0, 0.0]
    least = float(np.finfo(dtype).smallest_subnormal)
    assert at("log", least) == pytest.approx(math.log(least), rel=1e-6)
    assert all(math.isnan(at(name, math.nan)) for name in ("exp", "log", "tanh", "tan"))
    assert math.isnan(at("log", -least)) and math.isnan(at("log", -inf)) and math.isnan(at("tan", inf))


def test_one_reduction_for_the_sine_and_the_cosine_of_one_angle() -> None:
    x = ca.SX.sym("x")
    both = without_libm(lower(ca.Function("both", [x], [ca.vertcat(ca.sin(x), ca.cos(x))])))
    assert both.operations < alone("sin").operations + 8
    assert [i.op for i in both.instructions].count("floor") == 3  # type: ignore[union-attr]


def test_inside_a_routine_and_the_same_bytes_in_c() -> None:
    need_compiler()
    n = len(LIBM_MAKERS)
    x = ca.SX.sym("x", n)
    made = [make(x[k], x[(k + 1) % n], x[(k + 2) % n]) for k, make in enumerate(LIBM_MAKERS.values())]
    body = lower(ca.Function("body", [x], [ca.fmax(ca.fmin(ca.vertcat(*made), 1e3), -1e3)]))
    turn = Loop(body, 4, ("x",), ("y",))
    routine = without_libm(Routine("r", (("x", n),), (turn,), ("y",)))
    assert routine.libm == frozenset() and body.libm == LIBM
    assert without_libm(routine) is routine
    points = np.random.default_rng(5).normal(size=(100, n))
    for flags in ((), ("-O0",), ("-O3",)):
        have = compile_block(routine, flags=flags)(points)[0]
        assert have.tobytes() == replay(routine, points)[0].tobytes()
