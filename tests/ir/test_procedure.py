"""Procedures: every back end gives the numbers of the replay, and only the language is accepted."""

from __future__ import annotations

import pickle
from typing import Any

import casadi as ca
import numpy as np
import pytest

from surctl.certcheck.document import Rejected
from surctl.certcheck.instructions import evaluate, read_list
from surctl.errors import InputError
from surctl.ir import Call, Loop, Routine, compile_block, memory, replay, to_casadi
from surctl.ir.c99_routine import emit_block
from surctl.ir.procedure import Procedure, back, fabs, sqrt, within
from tests.ir.test_wide import compiled
from tests.tools import need_compiler


class Memory:
    n: int
    x: list[float]
    far: list[float]
    sorted: list[float]
    length: list[float]
    place: list[int]
    moves: int
    largest: float


def insert(s: Memory, i: int) -> float:
    """Move entry i up to its place among the longer ones before it."""
    value = s.x[s.place[i]]
    for j in back(0, i, s.n):
        if fabs(s.x[s.place[j]]) >= fabs(value):
            break
        other = s.place[j]
        s.place[j] = s.place[j + 1]
        s.place[j + 1] = other
        s.moves += 1
    return value


def longest_first(s: Memory) -> None:
    """Sort the entries by their size, scale those behind the first, and return the length of the vector."""
    square = 0.0
    for i in range(s.n):
        s.place[i] = i
        e = insert(s, i)
        square += e * e if not e < 0.0 else e * e * s.far[0]
    s.largest = fabs(s.x[s.place[0]])
    for i in range(s.n):
        s.sorted[i] = s.x[s.place[i]]
    for i in within(1, s.n, s.n):
        s.sorted[i] = s.sorted[i] * s.largest + s.x[i] * square - 0.1 * s.x[i]
    if s.largest != 0.0 and s.moves <= 1000:
        s.length[0] = sqrt(square) / s.largest
    else:
        s.length[0] = -1.0
    s.length[1] = 1.0 * s.moves


def example(n: int = 7) -> Procedure:
    return Procedure.of(
        "longest_first",
        [insert, longest_first],
        inputs=(("x", n), ("far", 1)),
        outputs=(("sorted", n), ("length", 2)),
        sizes={"n": n},
        reals={"largest": 0},
        wholes={"place": n, "moves": 0},
    )


def around(procedure: Procedure) -> Routine:
    """Two calls, in a loop, of which the second takes the result of the first."""
    names = tuple(name for name, _ in procedure.inputs)
    body = Routine("twice", procedure.inputs, (Call(procedure, names, ("next", "size")),), ("next",))
    loop = Loop(body, 2, ("x",), ("last",), fixed=("far",))
    return Routine("both", procedure.inputs, (loop, Call(procedure, ("last", "far"), ("y", "length"))), ("y", "length"))


def points(count: int, n: int = 7) -> list[np.ndarray[Any, Any]]:
    rng = np.random.default_rng(4)
    x = rng.normal(size=(count, n)) * 10.0 ** rng.integers(-3, 3, (count, n))
    x[0], x[1, 2], x[2, 3] = 0.0, np.nan, np.inf
    return [x, rng.normal(size=(count, 1))]


def same(a: list[np.ndarray[Any, Any]], b: list[np.ndarray[Any, Any]]) -> bool:
    return all(np.array_equal(x, y, equal_nan=True) for x, y in zip(a, b, strict=True))


def test_a_procedure_computes_what_it_says() -> None:
    values, length = replay(example(3), [1.0, -4.0, 2.0], [1.0])
    assert length.tolist() == [np.sqrt(21.0) / 4.0, 2.0]
    assert values[0] == -4.0 and values[1] == 2.0 * 4.0 + -4.0 * 21.0 - 0.1 * -4.0
    assert replay(example(3), [0.0, 0.0, 0.0], [1.0])[1][0] == -1.0


def test_compiled_code_and_checker_give_the_bytes_of_the_replay() -> None:
    need_compiler()
    block, inputs = around(example()), points(8)
    want = replay(block, *inputs)
    assert same(compile_block(block)(*inputs), want)
    assert same(compile_block(block, real="float32")(*inputs), replay(block, *inputs, real=np.float32))
    assert same(compiled({"both": block}, 8, ("-O1",))["both"](*inputs), want)
    listed = evaluate(read_list(block.text()), *[x.T for x in inputs])
    assert same([y.T for y in listed], want)


def test_loops_over_entries_run_four_at_once_and_only_those() -> None:
    text = emit_block(example(), symbol="f", vectors=True)
    assert text.count("+ 4 <=") == 1  # not the loops with branches or indices from an array
    assert "FOUR" not in emit_block(example(), symbol="f")


class Table:
    n: int
    k: int
    x: list[float]
    y: list[float]
    T: list[float]


def reflect(s: Table) -> None:
    """Apply I − 2 x xᵀ / 10 to the columns of T, where x are the first n entries; all but one loop go together."""
    for j in range(s.n):
        for row in range(s.k):
            s.T[j * s.k + row] = s.x[j] * s.x[row] - s.x[row]
    for row in within(1, s.k, s.k):
        total = 0.0
        for j in range(s.n):
            total += s.T[j * s.k + row] * s.x[j]
        for j in range(s.n):
            twice = 0.2 * s.x[j]
            s.T[j * s.k + row] -= total * twice
        s.y[row] = total
    s.y[0] = s.T[s.n * s.k - 1]


def chained(s: Table) -> None:
    """Add to entries that other iterations read, and use the last value of a variable: nothing goes together."""
    for j in range(s.n * s.k):
        s.T[j] = 0.5 * j
    for row in range(s.k - 3):
        total = 0.0
        for j in range(3):
            total += s.T[j + row] * s.x[row]
            s.T[j + row] += s.x[row]
        s.y[row] = total
    last = 0.0
    for row in range(s.k):
        last = s.x[row] * 2.0
        s.y[row] = last + s.T[row]
    s.y[0] = last


def table(function: Any, n: int, k: int) -> Procedure:
    ports: dict[str, Any] = {"inputs": (("x", k),), "outputs": (("y", k),)}
    return Procedure.of("table", [function], **ports, sizes={"n": n, "k": k}, reals={"T": n * k}, wholes={})


@pytest.mark.parametrize("k", [5, 8, 15, 24])
def test_loops_with_inner_loops_run_together_where_no_iteration_needs_another(k: int) -> None:
    text, alone = (emit_block(table(f, 4, k), symbol="f", vectors=True) for f in (reflect, chained))
    assert ("+ 8 <=" in text) == (k > 8)  # a group of eight must not reach the next column of T
    assert "_total0" in text and "FOUR(" not in alone.replace("FOUR(entry)", "")
    need_compiler()
    x = np.random.default_rng(k).normal(size=(6, k))
    for block in (table(reflect, 4, k), table(chained, 4, k)):
        assert same(compile_block(block)(x), replay(block, x))
        assert same(compile_block(block, real="float32")(x), replay(block, x, real=np.float32))


def test_a_procedure_is_pickled_and_changes_with_its_text() -> None:
    block = around(example())
    found = pickle.loads(pickle.dumps(block))
    assert found == block and found.digest() == block.digest()
    assert emit_block(found, symbol="f") == emit_block(block, symbol="f")
    ran = example()
    ran.run([[1.0] * size for _, size in ran.inputs])
    assert pickle.loads(pickle.dumps(ran)) == ran
    assert example(6).digest() != example(7).digest()
    assert memory(example()) == 7 + 1 + 7 + 2 + (1 + 7 + 1)
    assert example(8).operations > example(7).operations > 7 * 7


def test_derivatives_are_those_of_the_branch_that_runs() -> None:
    function, x = to_casadi(example()), ca.MX.sym("x", 7)
    sorted_, length = function(x, 0.5)
    slopes = ca.Function("slopes", [x], [ca.jacobian(sorted_, x), ca.jacobian(length[0], x)])
    at = points(4)[0][3]
    for k in range(7):
        step = 1e-6 * (1 + abs(at[k])) * np.eye(7)[k]
        ends = [replay(example(), at + sign * step, [0.5]) for sign in (1, -1)]
        for slope, (high, low) in zip(slopes(at), zip(*ends, strict=True), strict=True):
            column = np.asarray(slope)[:, k]
            want = (high - low)[: column.size] / (2 * step[k])
            np.testing.assert_allclose(column, want, rtol=1e-5, atol=1e-5 * (1 + abs(np.asarray(slope)).max()))


WRONG = {
    "x = s.a[0]": "language",
    "s.x[0] = 1.0": "cannot be assigned",
    "s.k = 0.5": "is whole",
    "s.y[0.5] = 1.0": "language",
    "while s.k < 1:\n        s.k = 2": "language",
    "for i in range(s.k):\n        s.y[0] = 1.0": "constant",
    "for i in within(0, s.k, s.k):\n        s.y[0] = 1.0": "constant",
    "s.y[0] = open('file')": "language",
    "s.y[0] = s.x.__class__": "language",
    "s.y[0] = f(s)": "language",
    "import os": "language",
    "s.y[0] = 1 / 2": "language",
    "s.y[0] = s.x[0] ** 2": "language",
    "_z = 1.0": "cannot be assigned",
    "break": "language",
    "s.y = 1.0": "language",
}


@pytest.mark.parametrize("line", list(WRONG))
def test_what_is_not_of_the_language_is_refused(line: str) -> None:
    source = f"def f(s):\n    {line}"
    with pytest.raises(InputError, match=WRONG[line]):
        Procedure("p", (("x", 1),), (("y", 1),), (("n", 1),), (("k", "whole", 0),), source)


def test_a_loop_runs_no_procedure_and_a_declared_bound_holds() -> None:
    with pytest.raises(InputError, match="a loop runs a program or a routine"):
        Routine("r", (("x", 1),), (Loop(example(1), 2, ("x",), ("y",), fixed=("x",)),), ("y",))
    source = "def f(s):\n    s.k = 3\n    for i in within(0, s.k, 2):\n        s.y[0] = 1.0"
    with pytest.raises(IndexError, match="at most 2"):
        replay(Procedure("p", (), (("y", 1),), (), (("k", "whole", 0),), source))


HOSTILE = [
    "s.k = s.k.real",
    "open('file')",
    "f(s)",
    "_times(1, 2)",
    "s.k = [1]",
    "lambda: 1",
    "for i in s.y:\n        s.k = i",
]


@pytest.mark.parametrize("line", HOSTILE)
def test_the_checker_executes_nothing_else(line: str) -> None:
    text = f"procedure p\nout y 1\nwhole k 0\ndef f(s):\n    {line}\n"
    with pytest.raises(Rejected, match="not an instruction list: a procedure with"):
        read_list(text)


def test_the_checker_refuses_an_argument_named_like_a_function() -> None:
    text = "procedure p\nout y 1\nwhole k 0\ndef f(s, range):\n    for i in range(2):\n        s.k = i\n"
    with pytest.raises(Rejected, match="a procedure with a name range"):
        read_list(text)


def test_the_checker_ends_numbers_that_grow() -> None:
    text = "procedure p\nout y 1\nwhole k 0\ndef f(s):\n    s.k = 3\n    for i in range(99):\n        s.k = s.k * s.k\n"
    with pytest.raises(ValueError, match="too large"):
        evaluate(read_list(text))
