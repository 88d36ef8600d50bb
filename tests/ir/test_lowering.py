from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings

from surctl.errors import InputError, UnsupportedOperation
from surctl.ir import Instruction, Program, lower, replay, without_libm
from surctl.ir.c99 import rearranged
from surctl.ir.tracing import _Builder
from tests.ir.expressions import EXACT, LIBM_MAKERS, grown, numbers, picks, whole


def ops(program: Program) -> list[str]:
    return [i.op for i in program.instructions]


def test_the_whole_table_is_reached() -> None:
    used = set(ops(lower(whole(EXACT)))) | set(ops(lower(whole(LIBM_MAKERS))))
    assert used >= set(EXACT) | set(LIBM_MAKERS) | {"select", "input"}


def test_if_else_is_one_select_and_keeps_the_sign_of_zero() -> None:
    x = ca.SX.sym("x", 3)
    for condition, taken in ((x[0] > 0, 2.0), (ca.logic_not(x[0] > 0), 3.0)):
        program = lower(ca.Function("f", [x], [ca.if_else(condition, x[1], x[2])]))
        assert replay(program, [1.0, 2.0, 3.0])[0][0] == taken
        assert ops(program).count("select") == 1
        assert "if_else_zero" not in ops(program) and "add" not in ops(program)
    program = lower(ca.Function("f", [x], [ca.if_else(x[0] > 0, x[1], x[2])]))
    (y,) = replay(program, [1.0, -0.0, 3.0])
    assert np.signbit(y[0])


def test_a_select_does_not_let_the_other_branch_leak() -> None:
    x = ca.SX.sym("x", 2)
    program = lower(ca.Function("f", [x], [ca.if_else(x[0] > 0, 1 / x[0], x[1])]))
    np.testing.assert_array_equal(replay(program, [0.0, 7.0])[0], [7.0])


def test_equal_expressions_are_computed_once_but_the_two_zeros_are_two() -> None:
    x = ca.SX.sym("x", 2)
    program = lower(ca.Function("f", [x], [ca.vertcat(x[0] * x[1], x[1] * x[0], x[0] * x[1] + 1)]))
    assert ops(program).count("mul") == 1
    builder = _Builder("b")
    assert builder.constant(0.0) != builder.constant(-0.0)
    assert builder.constant(0.0) == builder.constant(0.0)


def test_what_no_output_needs_is_dropped() -> None:
    x = ca.SX.sym("x", 2)
    unused = ca.sqrt(x[1])
    program = lower(ca.Function("f", [x], [ca.vertcat(x[0] + 1, unused * 0)]))
    assert "sqrt" not in ops(program)
    assert {i.args[1] for i in program.instructions if i.op == "input"} == {0}


def test_structural_zeros_and_matrices_come_out_column_by_column() -> None:
    x = ca.SX.sym("x", 2)
    function = ca.Function("f", [x], [ca.diag(x), ca.SX(2, 1)])
    matrix, zeros = replay(lower(function), [3.0, 4.0])
    np.testing.assert_array_equal(matrix, [3, 0, 0, 4])
    np.testing.assert_array_equal(zeros, [0, 0])


def test_mx_functions_are_expanded() -> None:
    z = ca.MX.sym("z", 3)
    (y,) = replay(lower(ca.Function("F", [z], [ca.dot(z, z) * z])), [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(y, [14, 28, 42])


@pytest.mark.parametrize(
    "function",
    [
        ca.sign, ca.ceil, ca.sinh, ca.cosh, ca.asinh, ca.expm1, ca.atan, lambda a: ca.asin(a / 4), ca.tan, ca.tanh,
        lambda a: ca.atanh(a / 4), lambda a: ca.acosh(5 + a), lambda a: ca.log1p(a + 4), lambda a: ca.hypot(a, 2),
        lambda a: (a + 4) ** 2.5, lambda a: (a + 4) ** -3, lambda a: (a + 4) ** a, lambda a: a**150 / 1e70,
        lambda a: (a / 4) ** 2000 + a,
    ],
)  # fmt: skip
def test_functions_that_the_list_lacks_are_written_by_others(function: Callable[[ca.SX], ca.SX]) -> None:
    x = ca.SX.sym("x")
    wanted = ca.Function("f", [x], [function(x)])
    points = np.array([-3.1, -2.0, -0.3, 0.2, 1.0, 2.9])
    have = replay(lower(wanted), points[:, None])[0][:, 0]
    np.testing.assert_allclose(have, np.array(wanted(points)).ravel(), rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("name", ["sinh", "tanh", "asinh", "atanh", "expm1", "log1p", "atan", "asin", "tan"])
def test_small_values_keep_their_digits(name: str) -> None:
    x = ca.SX.sym("x")
    program = lower(ca.Function("f", [x], [getattr(ca, name)(x)]))
    for at in (1e-300, 1e-20, -1e-9, 3e-5, -0.01, 0.3):
        [[have]] = replay(without_libm(program), [at])
        assert have == pytest.approx(float(getattr(mpmath, name)(at)), rel=2e-15)


def test_ends_of_the_inverse_functions() -> None:
    x = ca.SX.sym("x")

    def at(function: Callable[..., ca.SX], value: float, *more: float) -> float:
        return float(replay(without_libm(lower(ca.Function("f", [x], [function(x, *more)]))), [value])[0][0])

    assert at(ca.asinh, 1e300) == pytest.approx(691.4686750787736) == -at(ca.asinh, -1e300)
    assert at(ca.acosh, 1e300) == pytest.approx(691.4686750787736) and at(ca.acosh, 1.0) == 0.0
    assert np.isnan([at(ca.acosh, value) for value in (0.5, -1e9, -1e300)]).all()
    assert at(ca.hypot, 3e200, 4e200) == pytest.approx(5e200) and at(ca.hypot, 0.0, 1e-200) == 1e-200
    assert at(ca.log1p, -1.0) == -np.inf and np.isnan(at(ca.log1p, -2.0)) and at(ca.expm1, -800.0) == -1.0


@pytest.mark.parametrize(
    ("function", "says"),
    [
        (ca.erf, "'erf'.*approximate"),
        (lambda a: ca.fmod(a, 0.7), "'fmod'.*floor"),
        (lambda a: ca.remainder(a, 0.7), "'remainder'.*floor"),
        (lambda a: ca.copysign(2, a), "'copysign'.*if_else"),
    ],
)
def test_refused_operations_are_named(function: Callable[[ca.SX], ca.SX], says: str) -> None:
    x = ca.SX.sym("x")
    with pytest.raises(UnsupportedOperation, match=says):
        lower(ca.Function("f", [x], [function(x)]))


def test_inputs_must_be_dense_columns_and_constants_numbers() -> None:
    x = ca.SX.sym("x", 2)
    with pytest.raises(InputError, match="not a dense column"):
        lower(ca.Function("f", [x.T], [x]))
    with pytest.raises(UnsupportedOperation, match="NaN constant"):
        lower(ca.Function("f", [x], [x + float("nan")]))


def test_a_program_refuses_what_cannot_run() -> None:
    def program(*instructions: Instruction, refs: tuple[int, ...] = (0,)) -> Program:
        return Program("p", (("x", 1),), (("y", len(refs)),), instructions, (refs,))

    first = Instruction("input", (0, 0))
    for bad, why in (
        (Instruction("add", (0,)), "takes 2 operands"),
        (Instruction("add", (0, 1)), "before its use"),
        (Instruction("pow", (0, 0)), "unknown operation"),
        (Instruction("input", (0, 1)), "no such input"),
        (Instruction("const"), "needs a value"),
    ):
        with pytest.raises(InputError, match=why):
            program(first, bad)
    with pytest.raises(InputError, match="outside the instruction list"):
        program(first, refs=(1,))


def test_text_and_digest_tell_programs_apart() -> None:
    x = ca.SX.sym("x", 2)

    def digest(gain: float) -> str:
        return lower(ca.Function("f", [x], [gain * x])).digest()

    assert digest(0.1) == digest(0.1)
    assert digest(0.1) != digest(np.nextafter(0.1, 1))


@settings(max_examples=24, deadline=None, derandomize=True)
@given(steps=picks, values=numbers)
def test_replay_is_the_casadi_machine_bit_for_bit(steps: list[tuple[str, int, int, int]], values: list[float]) -> None:
    function = grown(steps, EXACT)
    (have,) = replay(lower(function), values)
    # == : the two zeros count as equal, `if_else` of the machine turns −0 into +0
    np.testing.assert_array_equal(have, np.asarray(function(values)).reshape(-1))


def test_a_rearrangement_is_the_program_that_lowering_gives() -> None:
    a, b = ca.SX.sym("a", 4), ca.SX.sym("b", 2)
    outputs = [ca.vertcat(b, a[1:]), a[2:3], a[:0]]
    function = ca.Function("pieces", [a, b], outputs, ["a", "b"], ["x", "y", "z"])
    pieces = {"x": [("b", 0, 2), ("a", 1, 4)], "y": [("a", 2, 3)], "z": [("a", 0, 0)]}
    assert rearranged("pieces", {"a": 4, "b": 2}, pieces) == lower(function)
    with pytest.raises(InputError, match="no such input entry"):
        rearranged("pieces", {"a": 4}, {"x": [("a", 2, 5)]})
