"""Runs side by side: the C text, the replay and CasADi give the same numbers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.ir import Gather, Loop, Program, Real, Routine, compile_block, lower, replay, to_casadi
from tests.ir.expressions import EXACT, LIBM_MAKERS, grown, picks, whole
from tests.tools import need_compiler, widest_vectors

TEXTS = [("-O1",), ("-O3", *widest_vectors())]


def bench(body: ca.Function, entries: int, *, lanes: int, turns: int = 3) -> Routine:
    """c ← body of (number, c, own piece, own row, shared); what it is without c is stacked, and one gathered."""
    c, x, q, s, i = ca.SX.sym("c", entries), *(ca.SX.sym(k, 4) for k in "xqs"), ca.SX.sym("i")
    fresh = body(x) + body(q) * i - body(s)
    after = ca.fmax(ca.fmin(0.5 * c + fresh, 1e6), -1e6)
    block = lower(ca.Function("bench", [i, c, x, q, s], [ca.densify(after), ca.densify(fresh)]))
    inputs = (("c", entries * lanes), ("x", 4 * turns * lanes), ("q", 4 * turns * lanes), ("s", 4), ("at", 1))
    loop = Loop(
        block, turns, ("c",), ("last", "all"), sliced=("x",), spread=("q",), fixed=("s",), index=True, lanes=lanes
    )
    return Routine("side", inputs, (loop, Gather("all", "at", entries, "one", lanes=lanes)), ("last", "all", "one"))


def drawn(routine: Routine, seed: int, count: int = 40) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    made = [np.round(rng.normal(size=(count, size)), 1) for _, size in routine.inputs[:-1]]
    return [*made, rng.integers(-2, 15, (count, 1)).astype(float)]


@pytest.mark.parametrize(("lanes", "real"), [(4, "float64"), (8, "float32")])
def test_every_operation_with_every_flag(lanes: int, real: Real) -> None:
    need_compiler()
    routine = bench(whole(EXACT), len(EXACT), lanes=lanes)
    inputs = drawn(routine, 1)
    want = replay(routine, *inputs, real=np.dtype(real).type)
    for flags in TEXTS:
        got = compile_block(routine, flags=flags, real=real)(*inputs)
        assert [a.tobytes() for a in got] == [b.tobytes() for b in want], flags


def test_functions_of_the_library_lane_by_lane() -> None:
    need_compiler()
    routine = bench(whole(LIBM_MAKERS), len(LIBM_MAKERS), lanes=4)
    inputs = drawn(routine, 2)
    for a, b in zip(compile_block(routine)(*inputs), replay(routine, *inputs), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


@settings(max_examples=6, deadline=None, derandomize=True)
@given(steps=picks, lanes=st.sampled_from([2, 4]), seed=st.integers(0, 2**32 - 1))
def test_random_bodies(steps: list[tuple[str, int, int, int]], lanes: int, seed: int) -> None:
    need_compiler()
    routine = bench(grown(steps, EXACT), 3, lanes=lanes, turns=2)
    inputs = drawn(routine, seed, count=5)
    want = replay(routine, *inputs)
    assert [a.tobytes() for a in compile_block(routine)(*inputs)] == [b.tobytes() for b in want]
    for a, b in zip(to_casadi(routine)(*(x[0] for x in inputs)), want, strict=True):
        np.testing.assert_array_equal(np.asarray(a).reshape(-1), b[0])


def test_one_lane_of_many_is_the_plain_loop() -> None:
    plain, wide = bench(whole(EXACT), len(EXACT), lanes=1, turns=8), bench(whole(EXACT), len(EXACT), lanes=8, turns=1)
    c, x, q, s, at = drawn(plain, 3, count=1)
    by_entry = x.reshape(8, 4).T.reshape(1, -1)
    every = replay(plain, np.zeros_like(c), x, q, s, at)[1].reshape(8, -1)
    side = replay(wide, np.zeros((1, 8 * c.shape[1])), by_entry, q, s, at)[1].reshape(-1, 8).T
    np.testing.assert_array_equal(side, every)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"lanes": 0}, "in several lanes"),
        ({"lanes": 2, "until": 0}, "in several lanes"),
        ({"lanes": 3}, "equal pieces"),
    ],
)
def test_nonsense_is_refused(change: dict[str, int], why: str) -> None:
    x = ca.SX.sym("x")
    block: Program = lower(ca.Function("b", [x], [2 * x]))
    with pytest.raises(InputError, match=why):
        Routine("r", (("x", 4),), (Loop(block, 1, ("x",), ("y",), **change),), ("y",))  # type: ignore[arg-type]


def test_shared_divisors_are_inverted_once() -> None:
    x = ca.SX.sym("x", 3)
    function = ca.Function("f", [x], [ca.vertcat(x[0] / x[2], x[1] / x[2], x[0] / x[1])])
    ops = [i.op for i in lower(function, reciprocals=True).instructions]
    assert ops.count("inv") == 1 and ops.count("div") == 1 and ops.count("mul") == 2
    want = replay(lower(function), [3.0, 5.0, 7.0])[0]
    np.testing.assert_allclose(replay(lower(function, reciprocals=True), [3.0, 5.0, 7.0])[0], want, rtol=1e-15)


@pytest.mark.parametrize("flags", TEXTS)
def test_signed_zeros_and_what_is_no_number(flags: tuple[str, ...]) -> None:
    need_compiler()
    x = ca.SX.sym("x", 2)
    a, b = x[0], x[1]
    made = [ca.fmin(a, b), ca.fmax(a, b), a < b, a <= b, ca.eq(a, b), ca.ne(a, b), -a, ca.fabs(a), ca.if_else(a, b, a)]
    made += [ca.logic_and(a, b), ca.logic_or(a, b), ca.logic_not(a), ca.if_else(a < b, a, 0), ca.sqrt(a)]
    block = lower(ca.Function("pairs", [x], [ca.vertcat(*made)]))
    special = [0.0, -0.0, 1.0, np.nan, np.inf, -np.inf]
    pairs = np.array([[p, q] for p in special for q in special]).reshape(-1)
    routine = Routine("r", (("x", 72),), (Loop(block, 9, (), ("y",), spread=("x",), lanes=4),), ("y",))
    (got,), (want,) = compile_block(routine, flags=flags)(pairs), replay(routine, pairs)
    number = ~np.isnan(want)
    assert (np.isnan(got) == ~number).all()
    assert got[number].tobytes() == want[number].tobytes()
