"""Loops: replay, C and CasADi give the same numbers, and nonsense is refused."""

from __future__ import annotations

import sys

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.ir import Block, Call, Gather, Loop, Program, Routine, compile_block, lower, replay, to_casadi
from surctl.ir.c99_routine import emit_block
from tests.ir.expressions import EXACT, grown, picks
from tests.tools import need_compiler

SIDE = 96


def program(name: str, inputs: dict[str, int], make: object) -> Program:
    symbols = [ca.SX.sym(k, n) for k, n in inputs.items()]
    made = make(*symbols)  # type: ignore[operator]
    return lower(ca.Function(name, symbols, [ca.densify(ca.SX(m)) for m in made]))


def grid() -> Routine:
    """A 96 × 96 grid that fades, and is set inside a cone: nested loops over fixed arrays."""
    sizes = {"column": 1, "cell": 1, "row": 1, "cone": 3}
    cell = program(
        "cell",
        sizes,
        lambda j, c, i, cone: [
            ca.fmax(0.9 * c, ca.if_else((i - cone[0]) ** 2 + (j - cone[1]) ** 2 < cone[2] ** 2, 1, 0))
        ],
    )
    row = Routine(
        "row",
        (("at", 1), ("cells", SIDE), ("cone", 3)),
        (Loop(cell, SIDE, (), ("faded",), sliced=("cells",), fixed=("at", "cone"), index=True),),
        ("faded",),
    )
    loop = Loop(row, SIDE, (), ("after",), sliced=("map",), fixed=("cone",), index=True)
    return Routine("grid", (("map", SIDE * SIDE), ("cone", 3)), (loop,), ("after",))


def growth() -> Routine:
    """x ← 1.5 x + 1 until it is above a limit, at most 40 times; then piece x of the input."""
    turn = program(
        "turn", {"x": 1, "over": 1, "limit": 1}, lambda x, over, limit: [1.5 * x + 1, ca.if_else(x > limit, 1, 0)]
    )
    steps = (
        Loop(turn, 40, ("x", "over"), ("x_last", "over_last"), fixed=("limit",), until=1),
        Gather("table", "x_last", 2, "piece"),
    )
    inputs = (("x", 1), ("over", 1), ("limit", 1), ("table", 6))
    return Routine("growth", inputs, steps, ("x_last", "over_last", "piece"))


def same(one: object, other: object) -> bool:
    a, b = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    return a.tobytes() == b.tobytes()


def test_the_grid_is_what_numpy_says_in_all_three_lives() -> None:
    need_compiler()
    rng = np.random.default_rng(1)
    values, cone = rng.random(SIDE * SIDE), np.array([40.0, 50.0, 9.0])
    i, j = np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij")
    hit = (i - cone[0]) ** 2 + (j - cone[1]) ** 2 < cone[2] ** 2
    want = np.maximum(0.9 * values, hit.reshape(-1).astype(float))
    assert same(replay(grid(), values, cone)[0], want)
    assert same(compile_block(grid())(values, cone)[0], want)
    assert same(np.asarray(to_casadi(grid())(values, cone)).reshape(-1), want)


def test_a_loop_that_ends_early_and_a_batch_of_them() -> None:
    need_compiler()
    x = np.array([[1.0], [2.0], [1000.0], [np.nan], [-9.0], [0.0]])
    over = np.array([[0.0], [0.0], [0.0], [0.0], [0.0], [7.0]])
    inputs = (x, over, np.full((6, 1), 50.0), np.arange(6.0))
    batch, native = replay(growth(), *inputs), compile_block(growth())(*inputs)
    assert all(same(a, b) for a, b in zip(batch, native, strict=True))
    assert batch[0][2, 0] == 1501.0 and batch[1][2, 0] == 1.0
    assert batch[0][5, 0] == 0.0 and batch[1][5, 0] == 7.0  # the flag was up: no turn at all
    assert batch[1][4, 0] == 0.0  # the bound ended it
    np.testing.assert_array_equal(batch[2], [[4, 5], [4, 5], [4, 5], [0, 1], [0, 1], [0, 1]])
    machine = to_casadi(growth())
    for k in (0, 1, 2, 4, 5):
        one = machine(x[k], over[k], 50.0, np.arange(6.0))
        assert all(same(np.asarray(a).reshape(-1), b[k]) for a, b in zip(one, batch, strict=True))
        alone = replay(growth(), x[k], over[k], [50.0], np.arange(6.0))
        assert all(same(a, b[k]) for a, b in zip(alone, batch, strict=True))


@settings(max_examples=8, deadline=None, derandomize=True)
@given(steps=picks, turns=st.integers(1, 6), seed=st.integers(0, 2**32 - 1))
def test_random_bodies_in_a_loop_agree(steps: list[tuple[str, int, int, int]], turns: int, seed: int) -> None:
    need_compiler()
    inner = grown(steps, EXACT)
    x, extra = ca.SX.sym("x", 4), ca.SX.sym("extra", 2)
    y = inner(x)
    body = lower(ca.Function("body", [x, extra], [ca.vertcat(y, x[0] + extra[0]), y[0] - extra[1]]))
    loop = Loop(body, turns, ("x",), ("x_last", "trace"), sliced=("table",))
    routine = Routine("nest", (("x", 4), ("table", 2 * turns)), (loop,), ("x_last", "trace"))
    rng = np.random.default_rng(seed)
    start, table = rng.uniform(-2, 2, (5, 4)), rng.uniform(-2, 2, (5, 2 * turns))
    batch, native = replay(routine, start, table), compile_block(routine)(start, table)
    assert all(same(a, b) for a, b in zip(batch, native, strict=True))
    machine = to_casadi(routine)(start[0], table[0])
    for a, b in zip(machine, batch, strict=True):
        np.testing.assert_array_equal(np.asarray(a).reshape(-1), b[0])  # == : the sign of a zero may differ


def test_gather_takes_the_nearest_piece_that_there_is() -> None:
    need_compiler()
    routine = Routine("g", (("table", 6), ("at", 1)), (Gather("table", "at", 2, "piece"),), ("piece",))
    at = np.array([-np.inf, -1e300, -1, -0.0, 0, 0.9, 1, 1.9, 2, 2.5, 3, 1e300, np.inf, np.nan])[:, None]
    want = np.array([0, 0, 0, 0, 0, 0, 1, 1, 2, 2, 2, 2, 2, 0])
    table = np.arange(6.0)
    assert same(replay(routine, table, at)[0][:, 0], 2.0 * want)
    assert same(compile_block(routine)(table, at)[0][:, 0], 2.0 * want)
    for k, index in enumerate(at[:-1, 0]):
        assert float(to_casadi(routine)(table, index)[0]) == 2.0 * want[k]


def test_derivatives_go_through_the_loop() -> None:
    x = ca.MX.sym("x")
    limit, table = ca.DM(50.0), ca.DM(np.arange(6.0))
    slope = ca.Function("slope", [x], [ca.jacobian(to_casadi(growth())(x, 0, limit, table)[0], x)])
    turns = 0
    value = 1.0
    while value <= 50.0:
        value, turns = 1.5 * value + 1, turns + 1
    assert float(slope(1.0)) == pytest.approx(1.5 ** (turns + 1), rel=1e-12)


def test_an_input_may_be_a_result_beside_others() -> None:
    need_compiler()
    swap = program("swap", {"a": 2}, lambda a: [ca.vertcat(a[1], a[0])])
    routine = Routine("twice", (("a", 2), ("b", 2)), (Call(swap, ("a",), ("c",)),), ("b", "c"))
    native = compile_block(routine)
    space = native.workspace()
    space.inputs[0][:], space.inputs[1][:] = [1, 2], [3, 4]
    space.run()
    np.testing.assert_array_equal(np.concatenate(space.outputs), [3, 4, 2, 1])


def test_text_and_digest_see_the_inside_of_a_loop() -> None:
    def made(factor: float, count: int) -> Routine:
        body = program("body", {"x": 1}, lambda x: [factor * x])
        return Routine("r", (("x", 1),), (Loop(body, count, ("x",), ("y",)),), ("y",))

    assert made(2.5, 3).digest() == made(2.5, 3).digest()
    assert len({made(2.5, 3).digest(), made(2.5, 4).digest(), made(3.5, 3).digest()}) == 3
    assert "loop body" in made(2.5, 3).text() and "program body" in made(2.5, 3).text()
    assert made(2.5, 3).operations == 3
    assert emit_block(made(2.5, 3), symbol="f") == emit_block(made(2.5, 3), symbol="f")


def test_blocks_of_one_text_become_one_function() -> None:
    def body() -> Program:
        return program("body", {"x": 1}, lambda x: [2.5 * x])

    steps = (Call(body(), ("x",), ("y",)), Call(body(), ("y",), ("z",)))
    text = emit_block(Routine("r", (("x", 1),), steps, ("z",)), symbol="f")
    assert text.count("static void f_body(") == 1


@pytest.mark.parametrize(
    ("steps", "why"),
    [
        (lambda b: (Call(b, ("none",), ("y",)),), "not written before"),
        (lambda b: (Call(b, ("x",), ("x",)),), "exists already"),
        (lambda b: (Call(b, ("wide",), ("y",)),), "takes"),
        (lambda b: (Call(b, ("x",), ("y", "z")),), "names 2 results"),
        (lambda b: (Loop(b, 0, ("x",), ("y",)),), "at least one iteration"),
        (lambda b: (Loop(b, 2, (), ("y",), sliced=("wide",)),), "equal pieces"),
        (lambda b: (Loop(b, 2, ("x",), ("y",), until=1),), "flag"),
        (lambda b: (Loop(b, 3, ("wide",), ("y",)),), "takes"),
        (lambda b: (Gather("wide", "x", 2, "y"),), "pieces"),
        (lambda b: (Gather("wide", "wide", 3, "y"),), "pieces"),
    ],
)
def test_nonsense_is_refused(steps: object, why: str) -> None:
    body = program("body", {"x": 1}, lambda x: [2 * x])
    with pytest.raises(InputError, match=why):
        Routine("r", (("x", 1), ("wide", 3)), steps(body), ("y",))  # type: ignore[operator]


def test_wrong_inputs_of_a_compiled_block_are_refused() -> None:
    need_compiler()
    native = compile_block(growth())
    with pytest.raises(InputError, match="takes 4 inputs"):
        native(1.0)
    with pytest.raises(InputError, match=r"expected \(…, 6\)"):
        native([1.0], [0.0], [1.0], [1.0])


def test_a_block_that_many_run_is_looked_at_once() -> None:
    """Each level runs the one below twice: there are 17 blocks, and 2¹⁷ ways to them."""
    calls = 0

    def count(*_: object) -> None:
        nonlocal calls
        calls += 1

    block: Block = program("waves", {"x": 1}, lambda x: [sum(ca.sin(k * x) for k in range(1, 201))])
    own, before = block.operations, sys.getprofile()
    sys.setprofile(count)
    try:
        for level in range(16):
            steps = (Call(block, ("x",), ("once",)), Call(block, ("once",), ("twice",)))
            block = Routine(f"level{level}", (("x", 1),), steps, ("twice",))
            block.digest()
        found = block.operations, block.libm, block.outputs
    finally:
        sys.setprofile(before)
    assert found == (own << 16, {"sin"}, (("twice", 1),))
    assert calls < 30_000


def test_the_sizes_that_a_routine_tells_are_no_handle_on_it() -> None:
    routine = growth()
    routine.sizes().clear()
    assert routine.outputs == (("x_last", 1), ("over_last", 1), ("piece", 2))
