"""A product and a sum in one operation: where it may be, what it is to the last bit, and the same bytes everywhere."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.ir import Block, Call, Program, Routine, lower, replay, to_casadi
from surctl.ir.folding import fused
from tests.ir.expressions import random_functions
from tests.ir.test_wide import TEXTS, compiled

number = st.floats(allow_nan=False, allow_infinity=False)


def program_of(expression: Callable[[ca.SX], ca.SX]) -> Program:
    x = ca.SX.sym("x", 4)
    return lower(ca.Function("f", [x], [expression(x)]))


def names(program: Block) -> list[str]:
    assert isinstance(program, Program)
    return [i.op for i in program.instructions if i.op not in ("input", "const")]


@pytest.mark.parametrize(
    ("expression", "wanted"),
    [
        (lambda x: x[0] * x[1] + x[2], ["fma"]),
        (lambda x: x[0] * x[1] - x[2], ["neg", "fma"]),
        (lambda x: x[2] - x[0] * x[1], ["neg", "fma"]),
        (lambda x: x[0] ** 2 + x[1] * x[2], ["sq", "fma"]),
        (lambda x: x[0] ** 2 - x[2], ["neg", "fma"]),
        (lambda x: ca.vertcat(x[0] * x[1] + x[2], x[0] * x[1] - x[3]), ["fma", "neg", "fma"]),
        # what else needs the product keeps it
        (lambda x: ca.vertcat(x[0] * x[1] + x[2], x[0] * x[1]), ["mul", "add"]),
        (lambda x: ca.sqrt(x[0] * x[1]) + x[0] * x[1], ["mul", "sqrt", "add"]),
    ],
)
def test_products_that_only_sums_use_are_fused(expression: Callable[[ca.SX], ca.SX], wanted: list[str]) -> None:
    plain = program_of(expression)
    found = fused(plain)
    assert sorted(names(found)) == sorted(wanted)
    x = np.array([[1.5, -2.0, 0.25, 3.0]])  # exact, however it is rounded
    np.testing.assert_array_equal(replay(found, x)[0], replay(plain, x)[0])
    np.testing.assert_array_equal(np.asarray(to_casadi(found)(x[0])).reshape(1, -1), replay(plain, x)[0])


@settings(max_examples=25)
@given(number, number, number)
def test_it_is_rounded_once(a: float, b: float, c: float) -> None:
    (found,) = replay(fused(program_of(lambda x: x[0] * x[1] + x[2])), [a, b, c, 0.0])[0]
    exact = Fraction(a) * Fraction(b) + Fraction(c)
    if not np.isfinite(found):
        assert abs(exact) > Fraction(float(np.finfo(float).max))
        return
    with np.errstate(over="ignore"):
        beside = (np.nextafter(found, -np.inf), np.nextafter(found, np.inf))
    for other in beside:  # no double is nearer
        assert not np.isfinite(other) or abs(Fraction(float(found)) - exact) <= abs(Fraction(float(other)) - exact)


@settings(max_examples=25)
@given(*[st.floats(width=32, allow_nan=False, allow_infinity=False, min_value=-(2.0**50), max_value=2.0**50)] * 3)
def test_in_float_too(a: float, b: float, c: float) -> None:
    (found,) = replay(fused(program_of(lambda x: x[0] * x[1] + x[2])), [a, b, c, 0.0], real=np.float32)[0]
    exact = Fraction(a) * Fraction(b) + Fraction(c)
    for end in (-np.inf, np.inf):
        other = np.nextafter(found, np.float32(end))
        assert abs(Fraction(float(found)) - exact) <= abs(Fraction(float(other)) - exact)


def test_a_tie_of_floats_is_not_rounded_twice() -> None:
    # exactly 1 + 2⁻²³ + 2⁻²⁴ (1 - 2⁻⁴⁶): just below the tie of two floats, and the double nearest is the tie
    x = [2.0**-12 * (1.0 + 2.0**-23), 2.0**-12 * (1.0 - 2.0**-23), 1.0 + 2.0**-23, 0.0]
    program = fused(program_of(lambda x: x[0] * x[1] + x[2]))
    assert np.float32(x[0] * x[1] + x[2]) == np.float32(1.0 + 2.0**-22)
    assert replay(program, x, real=np.float32)[0][0] == np.float32(1.0 + 2.0**-23)
    for above in ([2.0**-24, 1.0 + 2.0**-20, 1.0, 0.0], [2.0**-40, 2.0**-40, 1.0 + 2.0**-23, 0.0]):
        assert replay(program, above, real=np.float32)[0][0] == np.float32(1.0 + 2.0**-23)


@pytest.mark.parametrize(("lanes", "flags"), TEXTS)
def test_every_width_gives_the_bytes_of_the_replay(lanes: int, flags: tuple[str, ...]) -> None:
    blocks = {f"p{k}": fused(lower(function)) for k, function in enumerate(random_functions(12))}
    assert sum("fma" in names(block) for block in blocks.values()) > 1
    points = np.random.default_rng(5).uniform(-3, 3, (lanes, 4))
    for name, run in compiled(blocks, lanes, flags).items():
        assert run(points)[0].tobytes() == replay(blocks[name], points)[0].tobytes(), name


def test_programs_inside_a_routine_are_fused_once_each() -> None:
    inner = program_of(lambda x: x[0] * x[1] + x[2])
    outer = Routine("r", (("x", 4),), (Call(inner, ("x",), ("a",)), Call(inner, ("x",), ("b",))), ("a", "b"))
    found = fused(outer)
    assert isinstance(found, Routine)
    first, second = (step.block for step in found.steps if isinstance(step, Call))
    assert first is second and names(first) == ["fma"]
