"""Instruction lists: every operation inside every other one."""

from __future__ import annotations

import re
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from surctl.errors import ToolMissing
from surctl.ir import Call, Loop, Real, Routine, compile_block, lower, memory, replay
from surctl.ir.native import _source
from tests.ir import test_program_text
from tests.ir.test_places import mixed, moved
from tests.stack import stack_bytes
from tests.tools import need_compiler


def test_every_operation_inside_every_other_treats_special_numbers_alike(tmp_path: Path) -> None:
    test_program_text.test_every_operation_inside_every_other_treats_special_numbers_alike(tmp_path, 1)


SUM = moved("sum", [300, 300], lambda a, b: [a + b])


@pytest.mark.parametrize("real", ["float32"])  # in double the arrays are twice as long
def test_the_compiler_keeps_the_arrays_that_memory_counts_and_little_more(real: Real) -> None:
    """At most 256 bytes beside the arrays: addresses that are saved, and numbers on their way, in three functions."""
    need_compiler()
    inner = Routine(
        "inner",
        (("x", 300),),
        (Call(mixed("m", 300, 500), ("x",), ("w",)), Call(mixed("n", 500, 300), ("w",), ("y",))),
        ("y",),
    )
    steps = (Call(inner, ("x",), ("p",)), Loop(inner, 4, ("p",), ("q",)), Call(SUM, ("p", "q"), ("y",)))
    outer = Routine("outer", (("x", 300),), steps, ("y",))
    number = 4 * (1 + (real == "float64"))
    own, between = number * (memory(outer) - 300 - 300), number * 500
    try:
        told = stack_bytes(outer, real=real)
    except ToolMissing as missing:
        pytest.skip(str(missing))
    # of what only goes from one call to the next the compiler may make registers
    assert own > 3000 and own - between <= told <= own + 256


def test_six_thousand_operations_lower() -> None:
    x = ca.SX.sym("x", 4)
    pool = [x[k] for k in range(4)]
    for k in range(6000):
        pool.append(pool[-1] * 0.5 + pool[-4] if k % 2 else ca.fmin(pool[-2], pool[-3]) - k)
    function = ca.Function("large", [x], [ca.vertcat(*pool[-8:])])
    assert lower(function).operations > 6000


def test_what_runs_on_this_machine_holds_no_function_that_a_compiler_needs_long_for() -> None:
    need_compiler()
    x = ca.SX.sym("x", 8)
    y = x
    for k in range(150):
        y = y * x[::-1] + ca.sqrt(ca.fabs(y + k))
    long = lower(ca.Function("long", [x], [y]))
    assert long.operations > 3_000
    bodies = re.findall(r"\n{\n.*?\n}\n", _source(long, "float64"), flags=re.DOTALL)
    assert max(body.count("\n") for body in bodies) < 2000
    given = np.random.default_rng(0).normal(size=(5, 8))
    assert compile_block(long)(given)[0].tobytes() == np.asarray(replay(long, given)[0]).tobytes()
