"""The C text: the same bytes as the instruction list, short and in nothing but C99."""

from __future__ import annotations

import itertools
from functools import partial
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from surctl.ir import Call, Instruction, Loop, Program, Routine, lower, replay
from surctl.ir.c99_program import emit_program, preamble
from surctl.ir.c99_routine import emit_block
from surctl.ir.program import LIBM, OPERATIONS
from tests.ir.expressions import EXACT, compiled, random_functions, whole
from tests.ir.test_lanes import bench, drawn
from tests.tools import need_compiler

SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 5e-324, 1.7e308, np.inf, -np.inf, np.nan]


@pytest.mark.parametrize("apart", [False, True])
def test_random_programs_bit_for_bit(tmp_path: Path, apart: bool) -> None:
    need_compiler()
    programs = [lower(f) for f in random_functions(24)]
    points = np.vstack([np.random.default_rng(7).uniform(-3, 3, (30, 4)), np.eye(4), np.zeros((1, 4)), -np.eye(4)])
    natives = compiled(programs, tmp_path, partial(emit_program, apart=apart), preamble(programs))
    for program, native in zip(programs, natives, strict=True):
        for point, want in zip(points, replay(program, points)[0], strict=True):
            assert native(point)[0].tobytes() == np.ascontiguousarray(want).tobytes()


def test_every_operation_inside_every_other_treats_special_numbers_alike(tmp_path: Path, share: int = 6) -> None:
    """A sixth of them (all: study 40): each pair of exact operations, the inner one in each place of the outer one."""
    need_compiler()
    exact = [op for op in OPERATIONS.values() if op.name not in LIBM]
    pairs = [(o, i, at) for o in exact for i in exact for at in range(o.arity)]
    programs = [_nested(*pair) for pair in pairs[::share]]
    points = np.array(list(itertools.product(SPECIAL, repeat=3)))[:: 11 * 4 + 1]
    natives = compiled(programs, tmp_path, emit_program, preamble(programs))
    for program, native in zip(programs, natives, strict=True):
        want = replay(program, points)[0][:, 0]
        have = np.array([native(point)[0][0] for point in points])
        np.testing.assert_array_equal(have, want, err_msg=program.text())
        number = ~np.isnan(want)  # a NaN's sign means nothing
        np.testing.assert_array_equal(np.signbit(have[number]), np.signbit(want[number]), err_msg=program.text())


def _nested(outer: object, inner: object, at: int) -> Program:
    loads = tuple(Instruction("input", (0, k)) for k in range(3))
    args = [1, 2, 0][: outer.arity]  # type: ignore[attr-defined]
    args[at] = 3
    code = (
        *loads,
        Instruction(inner.name, (0, 1, 2)[: inner.arity]),  # type: ignore[attr-defined]
        Instruction(outer.name, tuple(args)),  # type: ignore[attr-defined]
    )
    return Program("f", (("x", 3),), (("y", 1),), code, ((4,),))


def test_signs_stay_apart() -> None:
    code = (Instruction("const", (), -2.5), Instruction("neg", (0,)), Instruction("sub", (1, 0)))
    text = emit_program(Program("f", (), (("y", 1),), code, ((2,),)), symbol="f", apart=True)
    assert "out0[0] = -(-2.5) - -2.5;" in text


def test_loops_with_lanes_carried_state_and_copies(tmp_path: Path) -> None:
    need_compiler()
    for lanes in (1, 2, 8):
        routine = bench(whole(EXACT), len(EXACT), lanes=lanes)
        (tmp_path / str(lanes)).mkdir()
        (native,) = compiled([routine], tmp_path / str(lanes))
        inputs = drawn(routine, 4, count=10)
        for k, want in enumerate(zip(*replay(routine, *inputs), strict=True)):
            have = native(*(given[k] for given in inputs))
            assert [a.tobytes() for a in have] == [np.ascontiguousarray(b).tobytes() for b in want]


def test_an_exchange_in_a_loop_is_no_copy_over_itself(tmp_path: Path) -> None:
    """One array is input and output there; the same exchange in a call may be copied piece by piece."""
    need_compiler()
    a, b = ca.SX.sym("a", 40), ca.SX.sym("b", 40)
    swap = lower(ca.Function("swap", [a, b], [b, a]))
    steps = (
        Loop(swap, 3, ("x", "y"), ("p", "q")),
        Call(swap, ("p", "q"), ("r", "s")),
    )
    routine = Routine("r", (("x", 40), ("y", 40)), steps, ("p", "q", "r", "s"))
    x, y = np.arange(40.0), -np.arange(40.0)
    (native,) = compiled([routine], tmp_path)
    for have, want in zip(native(x, y), (y, x, x, y), strict=True):
        np.testing.assert_array_equal(have, want)
    alone = Routine("r", (("x", 40), ("y", 40)), steps[:1], ("p", "q"))
    assert "for (int k" not in emit_block(alone, symbol="f").split("static void f(")[0]


def test_long_pieces_are_copied_in_a_loop() -> None:
    x = ca.SX.sym("x", 2000)
    parts = lower(ca.Function("parts", [x], [x[5:1990], 2 * x[:5]]))
    steps = (Call(parts, ("x",), ("y", "z")),)
    routine = Routine("r", (("x", 2000),), steps, ("y", "z"))
    text = emit_block(routine, symbol="f")
    assert "for (int k = 0; k < 1985; ++k) { out0[k] = in0[5 + k]; }" in text
    assert text.count("in0[") < 10


def test_what_stands_beside_a_long_piece_is_stored_too(tmp_path: Path) -> None:
    need_compiler()
    x = ca.SX.sym("x", 100)
    parts = lower(ca.Function("parts", [x], [ca.vertcat(3 * x[0], x[5:90], 2 * x[:5], x[40:80], x[0])]))
    routine = Routine("r", (("x", 100),), (Call(parts, ("x",), ("y",)),), ("y",))
    (native,) = compiled([routine], tmp_path)
    given = np.arange(1.0, 101.0)
    want = np.concatenate([3 * given[:1], given[5:90], 2 * given[:5], given[40:80], given[:1]])
    np.testing.assert_array_equal(native(given)[0], want)
    assert emit_block(routine, symbol="f").count("for (int k") >= 2


def test_what_it_looks_like() -> None:
    x = ca.SX.sym("x", 4)
    y = ca.if_else(ca.logic_and(x[0] < x[1], x[2] > 0), x[0] * x[1] + 0.5, ca.fmax(x[2], x[3]))
    text = emit_program(lower(ca.Function("f", [x], [y])), symbol="f", apart=True)
    choice = "((in0[0] < in0[1]) && (0.0 < in0[2])) ? in0[0] * in0[1] + 0.5 : max_of(in0[2], in0[3])"
    assert f"{{\n    out0[0] = {choice};\n}}" in text


def test_it_is_plain_c99_and_in_float_there_is_no_double() -> None:
    routine = bench(whole(EXACT), len(EXACT), lanes=2)
    assert "__attribute__" not in emit_block(routine, symbol="f")
    text = emit_block(routine, symbol="f", real="float32")
    assert "double" not in text and "sqrtf(" in text and "0.5f" in text
