"""Many runs side by side: every width and every text give the bytes of the replay."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.ir import Block, Call, Gather, Loop, Routine, lower, replay
from surctl.ir.batch import PRELUDE
from surctl.ir.c99_wide import emit_wide
from surctl.ir.cache import shared_library
from surctl.ir.folding import split
from surctl.ir.native import loaded
from tests.ir.expressions import EXACT, LIBM_MAKERS, grown, picks, random_functions, whole
from tests.ir.test_lanes import bench, drawn
from tests.ir.test_routine import growth, program
from tests.tools import need_compiler

Array = NDArray[np.float64]
# lanes and flags; without AVX-512 (and AVX) narrower vectors are taken, and several of them for many lanes
TEXTS: list[tuple[int, tuple[str, ...]]] = [
    (4, ("-O0", "-mno-avx")),
    (8, ("-O1",)),
]
Compiled = Callable[..., list[Array]]


def compiled(blocks: dict[str, Block], lanes: int, flags: tuple[str, ...]) -> dict[str, Compiled]:
    """The blocks on `lanes` runs, all from one compilation: arrays (lanes, size) in and out."""
    need_compiler()
    wide = {name: emit_wide(block, symbol=f"f_{name}") for name, block in blocks.items()}
    text = "\n".join([PRELUDE, *(w.text + _exported(name, blocks[name]) for name, w in wide.items())])
    library = loaded(shared_library(text, flags=(f"-DLANES={lanes}", *flags), wide=True))
    return {name: _caller(getattr(library, f"run_{name}"), blocks[name], lanes, w.work) for name, w in wide.items()}


def _exported(name: str, block: Block) -> str:
    kinds = ["const double *"] * len(block.inputs) + ["double *"] * (len(block.outputs) + 1)
    head = ", ".join(f"{kind}a{k}" for k, kind in enumerate(kinds))
    names = ", ".join(f"a{k}" for k in range(len(kinds)))
    return f"void run_{name}({head});\nvoid run_{name}({head}) {{ f_{name}({names}); }}\n"


def _caller(native: Any, block: Block, lanes: int, work: int) -> Compiled:
    def call(*inputs: Array) -> list[Array]:
        columns = [np.ascontiguousarray(x.T).reshape(-1) for x in inputs]
        columns += [np.full(size * lanes, np.nan) for _, size in block.outputs]
        columns.append(np.full(work * lanes + 1, np.nan))  # nothing is read before it is written
        native(*(ctypes.c_void_p(x.ctypes.data) for x in columns))
        return [x.reshape(-1, lanes).T.copy() for x in columns[len(inputs) : -1]]

    return call


def assert_same(name: str, text: tuple[int, tuple[str, ...]], *inputs: Array) -> None:
    got, want = all_compiled(*text)[name](*inputs), replay(blocks()[name], *inputs)
    for a, b in zip(got, want, strict=True):
        number = ~np.isnan(b)
        assert (np.isnan(a) == ~number).all()
        assert a[number].tobytes() == b[number].tobytes()


@cache
def blocks() -> dict[str, Block]:
    """What the tests run."""
    made: dict[str, Block] = {
        "every": lower(whole(EXACT)),
        "library": lower(whole(LIBM_MAKERS)),
        "side": bench(whole(EXACT), len(EXACT), lanes=4, turns=2),
        "growth": growth(),
        "search": search(),
        "piece": Routine("g", (("table", 6), ("at", 1)), (Gather("table", "at", 2, "piece"),), ("piece",)),
        "pairs": lower(pairs()),
    }
    return made | {f"random{k}": block for k, block in enumerate(random_blocks())}


def random_blocks() -> list[Block]:
    """Random bodies in a loop, with runs of their own side by side inside it in every other one."""
    return [bench(f, 3, lanes=1 + k % 2, turns=2) for k, f in enumerate(random_functions(6))]


@cache
def all_compiled(lanes: int, flags: tuple[str, ...]) -> dict[str, Compiled]:
    return compiled(blocks(), lanes, flags)


def pairs() -> ca.Function:
    """Whatever may go astray at zeros, infinities and NaN."""
    x = ca.SX.sym("x", 2)
    a, b = x[0], x[1]
    made = [ca.fmin(a, b), ca.fmax(a, b), a < b, a <= b, ca.eq(a, b), ca.ne(a, b), -a, ca.fabs(a), ca.if_else(a, b, a)]
    made += [ca.logic_and(a, b), ca.logic_or(a, b), ca.logic_not(a), ca.if_else(a < b, a, 0), ca.sqrt(a), ca.floor(b)]
    return ca.Function("pairs", [x], [ca.vertcat(*made)])


def search() -> Routine:
    """Turns of a routine until a flag is up, inside turns of another, with pieces taken by what was found.

    Two parts of the state of the inner turns begin with the same array.
    """
    step = program(
        "step",
        {"x": 1, "up": 1, "v": 2, "w": 2, "limit": 1},
        lambda x, up, v, w, limit: [x + 1 + v[0] ** 2, x > limit, v[::-1], w + v],
    )
    turn = Routine(
        "turn",
        (("x", 1), ("up", 1), ("v", 2), ("w", 2), ("limit", 1), ("table", 8)),
        (Gather("table", "x", 2, "row"), Call(step, ("x", "up", "row", "w", "limit"), ("y", "over", "flipped", "sum"))),
        ("y", "over", "flipped", "sum"),
    )
    inner = Loop(turn, 9, ("x", "up", "v", "v"), ("x2", "up2", "flip2", "v2"), fixed=("limit", "table"), until=1)
    again = program("again", {"x": 1, "k": 1}, lambda x, k: [x - 2 * k, ca.SX(0)])
    outer = Routine(
        "outer",
        (("k", 1), ("x", 1), ("up", 1), ("v", 2), ("limit", 1), ("table", 8)),
        (inner, Call(again, ("x2", "k"), ("x3", "down"))),
        ("x3", "down", "v2", "up2"),
    )
    loop = Loop(outer, 4, ("x", "up", "v"), ("a", "b", "c", "ups"), fixed=("limit", "table"), index=True)
    return Routine("search", outer.inputs[1:], (loop,), ("c", "a", "ups", "b"))


@pytest.mark.parametrize("text", TEXTS)
def test_every_operation(text: tuple[int, tuple[str, ...]]) -> None:
    points = np.round(np.random.default_rng(1).normal(size=(text[0], 4)), 1)
    assert_same("every", text, points)


@pytest.mark.parametrize("text", TEXTS)
def test_random_bodies_and_inner_lanes_inside_the_lanes(text: tuple[int, tuple[str, ...]]) -> None:
    for name in ("side", *(f"random{k}" for k in range(6))):
        routine = blocks()[name]
        assert isinstance(routine, Routine)
        for seed in range(4):
            assert_same(name, text, *drawn(routine, seed, count=text[0]))


@pytest.mark.parametrize("text", TEXTS)
def test_each_lane_turns_as_often_as_it_alone_would(text: tuple[int, tuple[str, ...]]) -> None:
    x = np.array([1.0, 2.0, 1000.0, np.nan, -9.0, 0.0, 49.0, 51.0])[: text[0], None]
    over = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 7.0, np.nan, -0.0])[: text[0], None]
    table = np.tile(np.arange(6.0), (text[0], 1))
    for shift in range(text[0]):
        assert_same("growth", text, x, np.roll(over, shift, axis=0), np.full_like(x, 50.0), table)


@pytest.mark.parametrize("text", TEXTS)
def test_loops_in_loops(text: tuple[int, tuple[str, ...]]) -> None:
    rng, ends = np.random.default_rng(3), set[float]()
    for _ in range(8):
        x, up, v, limit, table = (rng.normal(scale=2, size=(text[0], size)) for _, size in blocks()["search"].inputs)
        assert_same("search", text, x, np.zeros_like(up), v, 12 * limit, table)
        ends |= set(replay(search(), x, np.zeros_like(up), v, 12 * limit, table)[2][:, 0])
    assert ends == {0.0, 1.0} or text[0] == 1  # some found it, some did not


@pytest.mark.parametrize("text", TEXTS)
def test_pieces_of_each_lane(text: tuple[int, tuple[str, ...]]) -> None:
    at = np.array([-np.inf, -1e300, -0.0, 0.9, 1.9, 2.5, 1e300, np.nan])[:, None]
    for rows in np.arange(8).reshape(-1, text[0]):
        assert_same("piece", text, np.arange(48.0).reshape(8, 6)[rows], at[rows])


@pytest.mark.parametrize("text", TEXTS)
def test_signed_zeros_and_what_is_no_number(text: tuple[int, tuple[str, ...]]) -> None:
    special = [0.0, -0.0, 1.0, np.nan, np.inf, -np.inf]
    both = np.array([[p, q] for p in special for q in special] * 2)
    for rows in both.reshape(-1, text[0], 2):
        assert_same("pairs", text, rows)


@pytest.mark.parametrize("text", TEXTS)
def test_functions_of_the_library_lane_by_lane(text: tuple[int, tuple[str, ...]]) -> None:
    points = np.random.default_rng(4).normal(size=(text[0], 4))
    got = all_compiled(*text)["library"](points)[0]
    np.testing.assert_allclose(got, replay(blocks()["library"], points)[0], rtol=1e-12, atol=1e-12)


def test_a_nan_stays_in_its_lane() -> None:
    points = np.random.default_rng(5).normal(size=(8, 4))
    spoiled = points.copy()
    spoiled[3] = np.nan
    run = all_compiled(*TEXTS[-1])["every"]
    good, bad = run(points)[0], run(spoiled)[0]
    rest = np.arange(8) != 3
    assert good[rest].tobytes() == bad[rest].tobytes() and np.isnan(bad[3]).any()


@settings(max_examples=25)
@given(steps=picks, size=st.integers(1, 30))
def test_a_split_program_is_the_same_program(steps: list[tuple[str, int, int, int]], size: int) -> None:
    block = lower(grown(steps, EXACT))
    parts = split(block, size)
    points = np.random.default_rng(6).uniform(-3, 3, (5, 4))
    assert replay(parts, points)[0].tobytes() == replay(block, points)[0].tobytes()
    if isinstance(parts, Routine):
        assert all(step.block.operations <= size for step in parts.steps if isinstance(step, Call))
    else:
        assert block.operations <= size
