"""Ticks of many runs: refilled as they end, with the same bytes whatever shares the work."""

from __future__ import annotations

import signal
import threading
import time
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.errors import InputError, ToolMissing
from surctl.ir import Block, Call, Loop, Program, Routine, lower, replay, without_libm
from surctl.ir.batch import compile_batch
from tests.ir.expressions import EXACT, whole
from tests.ir.test_routine import program
from tests.tools import PATIENCE, need, need_compiler

Array = NDArray[np.float64]
SIDE = 48


def flying() -> Program:
    """Every operation a tick; the flag goes up when one number passes a limit of the run's own."""
    size = len(EXACT)
    s, p = ca.SX.sym("s", size + 1), ca.SX.sym("p", 4)
    made = ca.Function("inner", [s, p], [whole(EXACT)(ca.vertcat(s[1:4], p[0]))])(s, p)
    after = ca.fmax(ca.fmin(0.5 * s[1:] + made, 1e6), -1e6) + p[1]
    return lower(ca.Function("flying", [s, p], [ca.vertcat(made[3] > p[3], after)]))


def one_by_one(tick: Block, state: Array, parameters: Array, steps: int) -> tuple[Array, Array]:
    """(final states, ticks of each run) by the replay."""
    count = np.zeros(len(state), dtype=int)
    for _ in range(steps):
        running = state[:, 0] == 0
        state = np.where(running[:, None], replay(tick, state, parameters)[0], state)
        count += running
    return state, count


def cases(runs: int, seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    state, parameters = rng.normal(size=(runs, len(EXACT) + 1)), rng.normal(size=(runs, 4))
    state[:, 0] = rng.random(runs) < 0.1  # some have ended before they begin
    parameters[:, 3] = rng.uniform(-1, 8, runs)
    return state, parameters


@pytest.mark.parametrize(
    ("lanes", "flags"),
    [
        (None, ()),
        (4, ("-O1", "-mno-avx")),
    ],
)
def test_the_bytes_of_the_replay_for_any_width_threads_and_compiler_flags(
    lanes: int | None, flags: tuple[str, ...]
) -> None:
    need_compiler()
    state, parameters = cases(61, 1)
    want, count = one_by_one(flying(), state, parameters, 40)
    assert len(set(count)) > 4 and 0 in count and 1 in count and 40 in count
    batch = compile_batch(flying(), lanes=lanes, flags=flags)
    assert lanes in (None, batch.lanes)
    for threads in (1, 2, 5):
        assert batch.run(state, parameters, steps=40, threads=threads).tobytes() == want.tobytes()
    for runs in (0, 1, 3, 9):
        got = batch.run(state[:runs], parameters[:runs], steps=40, threads=2)
        assert got.tobytes() == want[:runs].tobytes()


def counter() -> Program:
    """The second entry counts the ticks; the flag goes up at the run's own number, or never for a NaN."""
    s, p = ca.SX.sym("s", 3), ca.SX.sym("p", 1)
    return lower(ca.Function("counter", [s, p], [ca.vertcat(s[1] + 1 >= p, s[1] + 1, s[2] * 0.5)]))


@pytest.mark.parametrize("threads", [1, 3])
def test_runs_of_very_different_length(threads: int) -> None:
    need_compiler()
    wanted = np.random.default_rng(2).choice([1, 2, 3, 50, 1000, 30000], size=(300, 1)).astype(float)
    state = np.zeros((300, 3))
    final = compile_batch(counter()).run(state, wanted, steps=20000, threads=threads)
    np.testing.assert_array_equal(final[:, 1], np.minimum(wanted[:, 0], 20000))
    np.testing.assert_array_equal(final[:, 0], wanted[:, 0] <= 20000)


def test_a_flag_that_is_up_means_no_tick_and_what_is_no_number_stays_in_its_run() -> None:
    need_compiler()
    state = np.zeros((40, 3))
    state[:, 2] = 1.0
    state[::4, 0], state[1::4, 2] = np.nan, np.nan
    batch = compile_batch(counter())
    final = batch.run(state, np.full((40, 1), 7.0), steps=100)
    assert final[::4].tobytes() == state[::4].tobytes()
    np.testing.assert_array_equal(final[2::4], np.tile([1.0, 7.0, 0.5**7], (10, 1)))
    assert np.isnan(final[1::4, 2]).all() and (final[1::4, 1] == 7).all()
    assert batch.run(state, np.full((40, 1), 7.0), steps=0).tobytes() == state.tobytes()


def mapping() -> Block:
    """A pose that turns and advances, and a 48 × 48 grid of log-odds (row by row) that its cone marks and carves."""

    def cell(j: ca.SX, c: ca.SX, i: ca.SX, pose: ca.SX) -> list[ca.SX]:
        dx, dy = i - pose[0], j - pose[1]
        ahead, aside = pose[2] * dx + pose[3] * dy, pose[2] * dy - pose[3] * dx
        reach = ca.sqrt(ahead * ahead + aside * aside)
        seen = ca.logic_and(ca.fabs(aside) < 0.3 * ahead, reach < pose[4])
        change = ca.if_else(reach < pose[4] - 2, -0.2, 0.9)
        return [ca.if_else(seen, ca.fmax(ca.fmin(c + change, 4), -4), c)]

    one = program("cell", {"j": 1, "c": 1, "i": 1, "pose": 5}, cell)  # type: ignore[arg-type]
    row = Routine(
        "row",
        (("i", 1), ("cells", SIDE), ("pose", 5)),
        (Loop(one, SIDE, (), ("after",), sliced=("cells",), fixed=("i", "pose"), index=True),),
        ("after",),
    )
    move = program(
        "move",
        {"s": 4 + SIDE * SIDE, "p": 3},
        lambda s, p: [
            ca.vertcat(s[1:3] + 0.5 * ca.vertcat(ca.cos(s[3]), ca.sin(s[3])), ca.cos(s[3]), ca.sin(s[3]), p[0]),
            ca.vertcat(s[1] > p[2], s[1] + 0.5 * ca.cos(s[3]), s[2] + 0.5 * ca.sin(s[3]), s[3] + p[1]),
            s[4:],
        ],
    )
    join = program("join", {"head": 4, "map": SIDE * SIDE}, lambda head, cells: [ca.vertcat(head, cells)])
    steps = (
        Call(move, ("state", "p"), ("pose", "head", "map")),
        Loop(row, SIDE, (), ("marked",), sliced=("map",), fixed=("pose",), index=True),
        Call(join, ("head", "marked"), ("next",)),
    )
    return without_libm(Routine("mapping", (("state", 4 + SIDE * SIDE), ("p", 3)), steps, ("next",)))


def test_a_grid_that_is_rewritten_every_tick() -> None:
    need_compiler()
    tick, rng = mapping(), np.random.default_rng(3)
    state, parameters = np.zeros((11, 4 + SIDE * SIDE)), np.zeros((11, 3))
    state[:, 1:4] = rng.uniform([5, 5, -3], [40, 40, 3], (11, 3))
    parameters[:] = rng.uniform([5, -0.3, 20], [15, 0.3, 47], (11, 3))
    want, count = one_by_one(tick, state, parameters, 2)
    assert len(set(count)) > 1
    assert (want[:, 4:] > 0).sum() > 50 and (want[:, 4:] < 0).sum() > 250
    batch = compile_batch(tick)
    for threads in (1, 2):
        assert batch.run(state, parameters, steps=2, threads=threads).tobytes() == want.tobytes()


def test_a_tick_that_only_hands_on_its_own_state_reads_all_of_it_first() -> None:
    need_compiler()
    s, p = ca.SX.sym("s", 101), ca.SX.sym("p", 1)
    # a ring of 100 that turns by 40: two long pieces, each in the other's place
    tick = lower(ca.Function("ring", [s, p], [ca.vertcat(s[0], s[41:], s[1:41])]))
    state = np.hstack([np.zeros((9, 1)), np.random.default_rng(4).normal(size=(9, 100))])
    want, _ = one_by_one(tick, state, np.zeros((9, 1)), 7)
    for lanes in (8,):
        assert compile_batch(tick, lanes=lanes).run(state, np.zeros((9, 1)), steps=7).tobytes() == want.tobytes()


@pytest.mark.parametrize("threads", [1, 2])
def test_an_interrupt_ends_it_soon(threads: int) -> None:
    need_compiler()
    batch = compile_batch(counter())
    main = threading.main_thread().ident
    assert main is not None
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job has it ignored
    begin = time.perf_counter()
    # a true signal: `_thread.interrupt_main` does not wake a thread that waits for a lock
    timer = threading.Timer(0.1, signal.pthread_kill, (main, signal.SIGINT))
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            batch.run(np.zeros((64, 3)), np.full((64, 1), np.nan), steps=2**62, threads=threads)
        timer.join()
    finally:
        signal.signal(signal.SIGINT, before)
    assert time.perf_counter() - begin < PATIENCE  # it would take years


def test_nonsense_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    x = ca.SX.sym("x", 2)
    with pytest.raises(InputError, match="state out"):
        compile_batch(lower(ca.Function("f", [x], [x])))
    with pytest.raises(InputError, match="1, 2, 4 or 8"):
        compile_batch(counter(), lanes=3)
    need_compiler()
    batch = compile_batch(counter())
    for shapes in (((2, 2), (2, 1)), ((2, 3), (3, 1)), ((3,), (3, 1)), ((2, 3), (2,))):
        with pytest.raises(InputError, match="expected"):
            batch.run(np.zeros(shapes[0]), np.zeros(shapes[1]), steps=1)
    for steps, threads in ((-1, 1), (1, 0)):
        with pytest.raises(InputError, match=r"must be at least [01]"):
            batch.run(np.zeros((2, 3)), np.zeros((2, 1)), steps=steps, threads=threads)
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(ToolMissing):
        compile_batch(counter())


def test_clang_takes_the_same_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", need("clang"))
    monkeypatch.setenv("SURCTL_CACHE", str(tmp_path))
    test_a_flag_that_is_up_means_no_tick_and_what_is_no_number_stays_in_its_run()
