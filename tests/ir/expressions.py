"""Random functions, and a way to run them in all four lives."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from pathlib import Path

import casadi as ca
import numpy as np
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.ir import Block
from surctl.ir.c99_routine import emit_block
from surctl.ir.cache import compile_program

Vector = NDArray[np.float64]
Make = Callable[[ca.SX, ca.SX, ca.SX], ca.SX]

# every exact operation, kept finite where it matters: no division by what may be 0
EXACT: dict[str, Make] = {
    "add": lambda a, b, c: a + b,
    "sub": lambda a, b, c: a - b,
    "mul": lambda a, b, c: a * b,
    "div": lambda a, b, c: a / (1 + b * b),
    "neg": lambda a, b, c: -a,
    "inv": lambda a, b, c: 1 / (2 + a * a),
    "sq": lambda a, b, c: a**2,
    "twice": lambda a, b, c: 2 * a,
    "sqrt": lambda a, b, c: ca.sqrt(ca.fabs(a)),
    "fabs": lambda a, b, c: ca.fabs(a),
    "floor": lambda a, b, c: ca.floor(a),
    "fmin": lambda a, b, c: ca.fmin(a, b),
    "fmax": lambda a, b, c: ca.fmax(a, b),
    "lt": lambda a, b, c: a < b,
    "le": lambda a, b, c: a <= b,
    "eq": lambda a, b, c: ca.eq(a, ca.floor(b)),
    "ne": lambda a, b, c: ca.ne(a, ca.floor(b)),
    "and": lambda a, b, c: ca.logic_and(a > 0, b < c),
    "or": lambda a, b, c: ca.logic_or(a > 0, b < c),
    "not": lambda a, b, c: ca.logic_not(a < b),
    "if_else_zero": lambda a, b, c: ca.if_else(a < b, c, 0),
    "select": lambda a, b, c: ca.if_else(a < b, b, c),
    "const": lambda a, b, c: a * 0.1 + 3,
}
LIBM_MAKERS: dict[str, Make] = {
    "sin": lambda a, b, c: ca.sin(a),
    "cos": lambda a, b, c: ca.cos(b),
    "atan2": lambda a, b, c: ca.atan2(a, 1 + b * b),
    "acos": lambda a, b, c: ca.acos(a / (1 + ca.fabs(a))),
    "tan": lambda a, b, c: ca.tan(a),
    "exp": lambda a, b, c: ca.exp(a),
    "log": lambda a, b, c: ca.log(1 + b * b),
    "tanh": lambda a, b, c: ca.tanh(c),
}

picks = st.lists(
    st.tuples(st.sampled_from(sorted(EXACT)), st.integers(0, 60), st.integers(0, 60), st.integers(0, 60)),
    min_size=1,
    max_size=40,
)
numbers = st.lists(
    st.one_of(st.floats(-3, 3), st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.5, 2.0])), min_size=4, max_size=4
)


def grown(steps: list[tuple[str, int, int, int]], makers: dict[str, Make]) -> ca.Function:
    """Function of x (4,) whose three outputs are the last three expressions of a random graph."""
    x = ca.SX.sym("x", 4)
    pool = [x[k] for k in range(4)]
    for name, i, j, k in steps:
        made = makers[name](pool[i % len(pool)], pool[j % len(pool)], pool[k % len(pool)])
        # clamped: a tower of squares must not overflow into inf − inf
        pool.append(ca.fmax(ca.fmin(made, 1e6), -1e6))
    return ca.Function("grown", [x], [ca.vertcat(*pool[-3:])])


def random_functions(count: int) -> list[ca.Function]:
    """The same ones at every call."""
    made: list[ca.Function] = []

    @settings(max_examples=count, deadline=None, derandomize=True, phases=[Phase.generate], database=None)
    @given(steps=picks)
    def collect(steps: list[tuple[str, int, int, int]]) -> None:
        made.append(grown(steps, EXACT))

    collect()
    return made


def whole(makers: dict[str, Make]) -> ca.Function:
    """Function of x (4,) that uses every maker once, one output entry each."""
    x = ca.SX.sym("x", 4)
    return ca.Function("whole", [x], [ca.vertcat(*(make(x[0], x[1], x[2] * x[3]) for make in makers.values()))])


def compiled(
    programs: Sequence[Block],
    folder: Path,
    emit: Callable[..., str] = emit_block,
    head: str = "",
    *,
    flags: Sequence[str] = (),
) -> list[Callable[..., list[Vector]]]:
    """The programs as native functions, all from one compilation."""
    text = f"#include <math.h>\n{head}"
    for at, program in enumerate(programs):
        text += emit(program, symbol=f"f{at}") + _exported(program, at)
    source = folder / "programs.c"
    source.write_text(text)
    library = ctypes.CDLL(str(compile_program([source], folder / "programs.so", flags=("-shared", "-fPIC", *flags))))
    return [caller(getattr(library, f"run{at}"), program) for at, program in enumerate(programs)]


def _exported(program: Block, at: int) -> str:
    count = len(program.inputs) + len(program.outputs)
    names = [f"a{k}" for k in range(count)]
    kinds = ["const double *"] * len(program.inputs) + ["double *"] * len(program.outputs)
    arguments = ", ".join(kind + name for kind, name in zip(kinds, names, strict=True))
    return f"void run{at}({arguments});\nvoid run{at}({arguments}) {{ f{at}({', '.join(names)}); }}\n"


def caller(native: ctypes._CFuncPtr, program: Block) -> Callable[..., list[Vector]]:
    def call(*inputs: Vector) -> list[Vector]:
        arrays = [np.ascontiguousarray(x, dtype=np.float64) for x in inputs]
        out = [np.empty(size) for _, size in program.outputs]
        native(*(a.ctypes.data_as(ctypes.c_void_p) for a in (*arrays, *out)))
        return out

    return call
