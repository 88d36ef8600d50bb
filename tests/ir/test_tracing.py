"""Traced loops: the numbers of the same text unrolled, whatever the bodies use, and no work that is not needed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import (
    Block,
    Loop,
    Program,
    Recording,
    Routine,
    compile_block,
    each,
    fold,
    lower,
    only_if,
    picked,
    repeat,
    replay,
    tabulated,
    to_casadi,
)
from surctl.ir.routine import nested
from tests.tools import need_compiler

SIZES = {"table": 15, "vector": 2, "scalar": 1}


def inputs() -> dict[str, ca.SX]:
    return {name: ca.SX.sym(name, size) for name, size in SIZES.items()}


def both(build: Callable[..., Sequence[ca.SX]]) -> tuple[Block, Program]:
    """The function with loops, and unrolled; `build` takes table (5, 3), vector (2, 1) and scalar."""
    made = []
    for recording in (Recording(), None):
        given = inputs()
        arguments = (ca.reshape(given["table"], 3, 5).T, given["vector"], given["scalar"])
        if recording is None:
            outputs = build(*arguments)
            made.append(lower(ca.Function("plain", list(given.values()), [ca.densify(ca.vec(o)) for o in outputs])))
        else:
            with recording:
                outputs = build(*arguments)
            made.append(recording.block("traced", given, {f"out{k}": ca.vec(o) for k, o in enumerate(outputs)}))
    return made[0], made[1]


def drawn(rng: np.random.Generator, count: int = 20) -> list[np.ndarray]:
    return [rng.normal(size=(count, size)) for size in SIZES.values()]


def loops(block: Block) -> list[Loop]:
    return [
        s for inner in nested(block).values() if isinstance(inner, Routine) for s in inner.steps if isinstance(s, Loop)
    ]


class Maker:
    """Random functions of nested loops, whose bodies use whatever stands outside."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def value(self, pool: list[ca.SX]) -> ca.SX:
        a, b, c = (pool[self.rng.integers(len(pool))] for _ in range(3))
        kind = self.rng.integers(7)
        if kind == 0:
            return a * b + c
        if kind == 1:
            return ca.fmin(a, b)
        if kind == 2:
            return ca.if_else(a < b, c, a)
        if kind == 3:
            return ca.fabs(a) - 0.5
        if kind == 4:
            return ca.floor(4 * a)
        if kind == 5:
            return a - b
        return ca.SX(float(self.rng.integers(-2, 3)))

    def table(self, pool: list[ca.SX], tables: list[ca.SX]) -> ca.SX:
        if self.rng.random() < 0.6:
            return tables[self.rng.integers(len(tables))]
        if self.rng.random() < 0.3:
            return ca.SX(np.round(self.rng.normal(size=(3, 2)), 1))
        return tabulated([[self.value(pool), self.value(pool)] for _ in range(self.rng.integers(1, 4))])

    def grown(self, pool: list[ca.SX], tables: list[ca.SX], depth: int) -> tuple[list[ca.SX], list[ca.SX]]:
        """More values, and more tables."""
        pool, tables = list(pool), list(tables)
        for _ in range(self.rng.integers(2, 5)):
            pool += [self.value(pool) for _ in range(self.rng.integers(1, 4))]
            if depth:
                self.loop(pool, tables, depth)
        return pool, tables

    def loop(self, pool: list[ca.SX], tables: list[ca.SX], depth: int) -> None:
        """One more loop; its body is the same whenever it is called."""
        seed, kind = int(self.rng.integers(1 << 30)), self.rng.integers(4)
        start = [self.value(pool) for _ in range(self.rng.integers(1, 3))]
        before, around = list(pool), list(tables)

        def inside(count: int, *more: ca.SX) -> list[ca.SX]:
            maker = Maker(seed)
            grown, _ = maker.grown([*before, *more], around, depth - 1)
            return [grown[-1 - maker.rng.integers(min(6, len(grown)))] for _ in range(count)]

        def body(*given: ca.SX) -> list[ca.SX]:
            *state, row = given
            return inside(len(state), *state, *ca.vertsplit(row))

        name = f"loop{seed}"
        if kind == 0:
            pool += only_if(name, self.value(pool) < self.value(pool), lambda: inside(len(start)), start)
        elif kind == 1:
            pool += fold(name, body, start, self.table(pool, tables))
        elif kind == 2:
            pool += ca.vertsplit(picked(name, self.table(pool, tables), 2 * self.value(pool)))
        else:
            rows = self.table(pool, tables)
            tables += each(name, lambda row: [ca.vertcat(*inside(2, *ca.vertsplit(row)))], rows)

    def build(self, table: ca.SX, vector: ca.SX, scalar: ca.SX) -> list[ca.SX]:
        pool, tables = self.grown([*ca.vertsplit(vector), scalar], [table], 2)
        return [*pool[-4:], tables[-1], tables[0]]


def test_random_nested_loops_give_the_numbers_of_the_unrolled_text() -> None:
    rolled = 0
    for seed in range(5):
        block, plain = both(lambda *given, seed=seed: Maker(seed).build(*given))
        given = drawn(np.random.default_rng(seed))
        for a, b in zip(replay(block, *given), replay(plain, *given), strict=True):
            # where the text is unrolled CasADi sees that (a + b) - a is b, so the last bits may differ
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9, err_msg=f"seed {seed}")
        rolled += bool(loops(block))
    assert rolled > 2


def test_in_c_and_in_casadi_too() -> None:
    need_compiler()
    for seed in (4, 9):
        block, _ = both(lambda *given, seed=seed: Maker(seed).build(*given))
        given = drawn(np.random.default_rng(seed), 5)
        want = replay(block, *given)
        for a, b in zip(compile_block(block)(*given), want, strict=True):
            np.testing.assert_array_equal(a, b)
        function = to_casadi(block)
        for k in range(5):
            for a, b in zip(function(*(part[k] for part in given)), want, strict=True):
                np.testing.assert_allclose(np.asarray(a).ravel(), b[k], rtol=1e-12, atol=1e-300)


def nearest(table: ca.SX, vector: ca.SX, scalar: ca.SX) -> list[ca.SX]:
    speed = ca.sqrt(ca.sumsqr(vector))  # the same in every turn
    return [fold("nearest", lambda least, row: ca.fmin(least, ca.sumsqr(row) * speed), ca.SX(100), table)]


def test_what_a_loop_does_not_change_is_computed_before_it() -> None:
    block, _ = both(nearest)
    (loop,) = loops(block)
    assert isinstance(loop.block, Program)
    assert not {"sqrt"} & {i.op for i in loop.block.instructions}
    assert loop.count == 5 and loop.sliced == ("table",)  # a table that stands in an input is not copied


def test_what_only_a_condition_needs_is_computed_where_it_holds() -> None:
    def build(table: ca.SX, vector: ca.SX, scalar: ca.SX) -> list[ca.SX]:
        far = ca.cos(vector[0])  # needed by the branch alone
        total = fold("total", lambda total, row: total + row[0], ca.SX(0), table)  # likewise
        shared = ca.sin(vector[1])
        (value,) = only_if("branch", scalar > 0, lambda: [far * total + shared], [shared])
        return [value]

    block, plain = both(build)
    branch = next(loop for loop in loops(block) if loop.until is not None)
    inside = [i.op for p in nested(branch.block).values() if isinstance(p, Program) for i in p.instructions]
    assert "cos" in inside and "sin" not in inside
    assert any(isinstance(s, Loop) for s in getattr(branch.block, "steps", ()))
    given = drawn(np.random.default_rng(0))
    np.testing.assert_array_equal(replay(block, *given)[0], replay(plain, *given)[0])


def test_a_condition_in_a_loop_does_not_take_what_the_loop_needs_once_out_of_its_place() -> None:
    def exact(table: ca.SX, vector: ca.SX, scalar: ca.SX) -> list[ca.SX]:
        def body(state: ca.SX, row: ca.SX) -> ca.SX:
            return only_if("taken", row[0] > state, lambda: [row[0] + scalar * scalar * row[1]], [state])[0]

        return [fold("largest", body, ca.SX(-1), table)]

    block, plain = both(exact)
    given = drawn(np.random.default_rng(1))
    np.testing.assert_array_equal(replay(block, *given)[0], replay(plain, *given)[0])


def test_bodies_of_one_text_are_one_block() -> None:
    def build(table: ca.SX, vector: ca.SX, scalar: ca.SX) -> list[ca.SX]:
        def longest(weight: ca.SX) -> ca.SX:
            return fold("longest", lambda most, row: ca.fmax(most, ca.dot(row, row) * weight), ca.SX(0), table)

        return [longest(vector[0]), longest(longest(vector[1]) + scalar)]

    block, _ = both(build)
    bodies = [loop.block for loop in loops(block)]
    assert len(bodies) == 3 and all(body is bodies[0] for body in bodies)


def test_a_loop_that_nothing_needs_is_left_out() -> None:
    def build(table: ca.SX, vector: ca.SX, scalar: ca.SX) -> list[ca.SX]:
        nearest(table, vector, scalar)
        return [scalar + 1]

    assert isinstance(both(build)[0], Program)


def test_a_flag_ends_a_loop() -> None:
    def build(table: ca.SX, vector: ca.SX, scalar: ca.SX) -> list[ca.SX]:
        def body(done: ca.SX, total: ca.SX, row: ca.SX) -> tuple[list[ca.SX], list[ca.SX]]:
            return [total + row[0] > 1, total + row[0]], []

        (_, total), _ = repeat("until", body, [ca.SX(0), scalar], [table], until=0)
        return [total]

    block, plain = both(build)
    given = drawn(np.random.default_rng(2), 200)
    np.testing.assert_array_equal(replay(block, *given)[0], replay(plain, *given)[0])


def test_mistakes_are_named() -> None:
    row = ca.SX.sym("row", 2, 2)
    with pytest.raises(InputError, match=r"sums: runs over tables of \[2, 3\] rows"):
        fold("sums", lambda s, a, b: s, ca.SX(0), ca.SX(2, 1), ca.SX(3, 1))
    with pytest.raises(InputError, match=r"sums: changes the sizes of its state from \[1\] to \[2\]"):
        fold("sums", lambda s, a: ca.vertcat(s, s), ca.SX(0), row)
    with pytest.raises(InputError, match="first: reads a row of an empty table"):
        picked("first", ca.SX(0, 2), ca.SX(0))
    with pytest.raises(InputError, match="the flag must be one number"):
        repeat("ends", lambda s, a: ([s], []), [ca.SX([0, 0])], [row], until=0)
    with Recording() as recording:
        total = fold("sums", lambda s, a: s + a[0], ca.SX(0), row)
    with pytest.raises(InputError, match="sums_of: uses symbols that are not its arguments: row_0"):
        recording.block("sums_of", {}, {"total": total})


def test_a_mistake_in_a_body_closes_the_recording() -> None:
    with pytest.raises(ZeroDivisionError), Recording():
        fold("wrong", lambda s, a: s / 0 if 1 // 0 else s, ca.SX(0), ca.SX(2, 1))
    assert float(fold("sum", lambda s, a: s + a, ca.SX(0), ca.SX([1, 2]))) == 3.0  # unrolled again
