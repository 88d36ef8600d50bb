from __future__ import annotations

import ctypes
import itertools
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.ir import Instruction, Program, c_literal, lower, replay
from surctl.ir.c99 import identifier
from surctl.ir.c99_routine import emit_block
from surctl.ir.c99_wide import emit_wide
from surctl.ir.folding import Numbering
from surctl.ir.program import LIBM, OPERATIONS, Operation
from tests.ir.expressions import EXACT, LIBM_MAKERS, compiled, random_functions, whole
from tests.tools import need_compiler


def test_c_equals_replay_bit_for_bit_on_random_programs(tmp_path: Path) -> None:
    need_compiler()
    functions = random_functions(40)
    assert len(functions) == 40
    programs = [lower(f) for f in functions]
    points = np.vstack(
        [np.random.default_rng(7).uniform(-3, 3, (30, 4)), np.eye(4), np.zeros((1, 4)), -np.zeros((1, 4))]
    )
    for function, program, native in zip(functions, programs, compiled(programs, tmp_path), strict=True):
        batch = replay(program, points)[0]
        for point, want in zip(points, batch, strict=True):
            have = native(point)[0]
            assert have.tobytes() == np.ascontiguousarray(want).tobytes()
            np.testing.assert_array_equal(have, np.asarray(function(point)).reshape(-1))


def test_every_exact_operation_treats_special_numbers_alike(tmp_path: Path) -> None:
    need_compiler()
    special = [0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 5e-324, 1.7e308, np.inf, -np.inf, np.nan]
    points = np.array(list(itertools.product(special, repeat=3)))
    programs = [_single(op) for op in OPERATIONS.values() if op.name not in LIBM]
    for program, native in zip(programs, compiled(programs, tmp_path), strict=True):
        want = replay(program, points)[0][:, 0]
        have = np.array([native(point)[0][0] for point in points])
        np.testing.assert_array_equal(have, want, err_msg=program.name)
        number = ~np.isnan(want)  # a NaN's sign means nothing
        np.testing.assert_array_equal(np.signbit(have[number]), np.signbit(want[number]), err_msg=program.name)


def _single(op: Operation) -> Program:
    """The operation on the first entries of x (3,)."""
    operands = tuple(range(op.arity))
    load = tuple(Instruction("input", (0, k)) for k in operands)
    apply = Instruction(op.name, operands)
    return Program(op.name, (("x", 3),), (("y", 1),), (*load, apply), ((op.arity,),))


def test_library_functions_agree_to_1e12(tmp_path: Path) -> None:
    need_compiler()
    function = whole(LIBM_MAKERS)
    program = lower(function)
    (native,) = compiled([program], tmp_path)
    for point in np.random.default_rng(3).uniform(-3, 3, (200, 4)):
        have = native(point)[0]
        np.testing.assert_allclose(have, np.asarray(function(point)).reshape(-1), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(have, replay(program, point)[0], rtol=1e-12, atol=1e-12)


def test_outputs_may_alias_inputs(tmp_path: Path) -> None:
    need_compiler()
    x = ca.SX.sym("x", 2)
    program = lower(ca.Function("swap", [x], [ca.vertcat(x[1], x[0])]))
    compiled([program], tmp_path)
    library = ctypes.CDLL(str(tmp_path / "programs.so"))
    data = np.array([1.0, 2.0])
    pointer = data.ctypes.data_as(ctypes.c_void_p)
    library.run0(pointer, pointer)
    np.testing.assert_array_equal(data, [2.0, 1.0])


def test_idle_inputs_and_empty_outputs_compile(tmp_path: Path) -> None:
    need_compiler()
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y", 1)
    program = lower(ca.Function("f", [x, y], [x + 1, ca.SX(0, 1), ca.SX(1, 1)]))
    (native,) = compiled([program], tmp_path)
    np.testing.assert_array_equal(native(np.array([1.0, 2.0]), np.zeros(1))[0], [2.0, 3.0])


def test_the_text_is_the_same_every_time() -> None:
    texts = {emit_block(lower(whole(EXACT)), symbol="f") for _ in range(3)}
    assert len(texts) == 1
    (text,) = texts
    assert "static void f(const double in0[4], double out0[23])" in text


@settings(max_examples=25, derandomize=True)
@given(value=st.floats(allow_nan=False, allow_infinity=False))
def test_literals_are_exact(value: float) -> None:
    text = c_literal(value)
    back = float.fromhex(text) if "x" in text else float(text)
    assert back.hex() == value.hex()
    assert any(mark in text for mark in ".xe")  # never an int literal


def test_infinities_have_a_literal_and_nan_has_none() -> None:
    assert c_literal(float("inf")) == "(double)INFINITY" and c_literal(-float("inf"), "float32") == "-INFINITY"
    with pytest.raises(InputError, match="no C literal"):
        c_literal(float("nan"))


@pytest.mark.parametrize(
    "name", ["", "1x", "a b", "a-b", "int", "class", "_x", "a__b", "η", "x;", "x\n", "a" * 64, "main"]
)
def test_names_that_c_cannot_use_are_refused(name: str) -> None:
    with pytest.raises(InputError, match=r"identifier|reserved"):
        identifier(name)
    with pytest.raises(InputError):
        emit_block(Program("p", (), (), (), ()), symbol=name)


@pytest.mark.parametrize("name", ["surctl_guarded", "x1", "tau", "A" * 63])
def test_ordinary_names_pass(name: str) -> None:
    assert identifier(name) == name


def test_a_constant_keeps_the_sign_of_its_zero_in_replay_and_c(tmp_path: Path) -> None:
    need_compiler()
    instructions = (Instruction("const", (), -0.0), Instruction("input", (0, 0)), Instruction("div", (1, 0)))
    program = Program("minus_zero", (("x", 1),), (("y", 1),), instructions, ((2,),))
    assert replay(program, [1.0])[0][0] == -np.inf
    numbering, moved = Numbering(), list[int]()
    for instruction in program.instructions:
        moved.append(numbering.copy(instruction, moved))
    assert numbering.rewritten(program, moved).text() == program.text()
    (native,) = compiled([program], tmp_path)
    assert native(np.array([1.0]))[0][0] == -np.inf
    assert "SET(-0.0)" in emit_wide(program, symbol="minus_zero").text  # CasADi itself knows one zero only
