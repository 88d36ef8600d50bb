"""The bounded ladder: the exact one's first rung to the last bit, then an answer of constant cost that is safe."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import Real, compile_block, replay
from surctl.priority import Level, LevelShape, PriorityStep, Row, build_problem, priority_step, safe_step
from surctl.priority.compiled.step import idle_row
from surctl.priority.settings import Fallback
from surctl.priority.solver.elimination import FLOAT32, FLOAT64, Precision
from surctl.priority.solver.fallback import BOUNDED, CAP, CLAMPED, MET
from tests.oracles.distance_trials import FAMILIES, Trials, draw_trials
from tests.tools import need_compiler

Array = NDArray[np.float64]

PRECISION: dict[Real, Precision] = {"float64": FLOAT64, "float32": FLOAT32}
SIZES = ((4, 2, 24),)  # as many task rows as velocities, and one: study 40
ROUNDING = 3e-9  # of 1 + max |v|: what `FLOAT64.kept` allows a hard row, and `priced` a soft one


@cache
def answers(n: int, p: int, m: int) -> tuple[Trials, tuple[Array, ...], tuple[Array, ...]]:
    """Problems, and what either ladder says to them in C."""
    need_compiler()
    trials = moved(draw_trials(1_500 if m == 24 else 600, n=n, p=p, m=m, seed=5))
    ladders: tuple[Fallback, Fallback] = ("exact", "bounded")
    exact, bounded = (tuple(compile_block(safe_step(n, p, m, fallback=k))(*trials.arrays)) for k in ladders)
    return trials, exact, bounded


def moved(trials: Trials) -> Trials:
    """Every second problem moved, so that neither its box nor its hard rows need hold 0."""
    count, n = trials.target.shape
    way = np.random.default_rng(1).normal(size=(count, n)) * 0.4 * (np.arange(count) % 2)[:, None]
    rows, J = trials.rows.reshape(count, -1, n + 3).copy(), trials.J.reshape(count, -1, n)
    rows[..., n : n + 2] += np.einsum("kij,kj->ki", rows[..., :n], way)[..., None]
    x = trials.x + np.einsum("kij,kj->ki", J, way)
    box = trials.box + np.hstack([way, way])
    return Trials(trials.target + way, trials.J, x, rows.reshape(count, -1), box, trials.features)


def missed(trials: Trials, v: Array) -> tuple[Array, Array]:
    """(N,) each: by how much the worst hard and the worst soft row of length 1 is missed."""
    A, lower, upper, soft = trials.unit()
    value = np.einsum("kij,kj->ki", A, v)
    off = np.maximum(np.maximum(value - upper, lower - value), 0.0)
    return np.where(soft, 0.0, off).max(axis=1), np.where(soft, off, 0.0).max(axis=1)


@pytest.mark.parametrize("sizes", SIZES)
def test_what_the_first_rung_finds_in_few_iterations_is_the_exact_answer_to_the_last_bit(
    sizes: tuple[int, int, int],
) -> None:
    trials, exact, bounded = answers(*sizes)
    held = bounded[4][:, 0] == MET
    assert held.any()
    for mine, theirs in zip(bounded, exact, strict=True):
        assert mine[held].tobytes() == theirs[held].tobytes()
    soon = (exact[4][:, 0] == MET) & (exact[5][:, 0] <= CAP)
    if sizes[1] > 1:  # dependent rows of a task of several are not looked into
        soon &= ~trials.features[:, FAMILIES.index("dependent")] & (sizes[1] < sizes[0])
        soon &= np.linalg.cond(trials.J.reshape(len(soon), -1, sizes[0])) < 1e9
    assert held[soon].all()


@pytest.mark.parametrize("sizes", SIZES)
def test_elsewhere_it_is_no_worse_than_the_target_in_the_box_or_standing_still(sizes: tuple[int, int, int]) -> None:
    trials, _, (v, active, multipliers, opening, status, _) = answers(*sizes)
    n = sizes[0]
    low, high = trials.box[:, :n], trials.box[:, n:]
    assert np.isfinite(v).all() and (low <= v).all() and (v <= high).all()
    eased = status[:, 0] == BOUNDED
    assert eased.any() and set(np.unique(status)) <= {MET, CLAMPED, BOUNDED}
    assert not active[eased].any() and not multipliers[eased].any()
    near = np.clip(trials.target, low, high)
    size = ROUNDING * (1 + np.abs(near).max(axis=1))
    hard, soft = missed(trials, v)
    assert (hard[eased] <= size[eased]).all()
    stands = (low <= 0).all(axis=1) & (high >= 0).all(axis=1)
    assert stands.any() and not stands.all()
    for safe, fine in ((near, np.ones_like(stands)), (0.0 * near, stands)):
        safe_hard, safe_soft = missed(trials, safe)
        sound = fine & (safe_hard <= 1e-9)
        assert (eased | (status[:, 0] == MET))[sound].all()
        assert (soft - safe_soft)[eased & sound].max() <= size.max()
    assert (soft <= opening[:, 0] + size)[eased].all()
    clamped = status[:, 0] == CLAMPED
    assert v[clamped].tobytes() == near[clamped].tobytes()


def test_it_is_much_better_than_standing_still_and_near_the_exact_answer() -> None:
    trials, exact, bounded = answers(4, 2, 24)
    chosen = (exact[4][:, 0] != MET) & (bounded[4][:, 0] == BOUNDED)
    chosen[1::2] = False  # those that were moved: still is no way to stand there
    least = exact[3][chosen, 0]
    mine, still = (np.maximum(missed(trials, v)[1][chosen] - least, 0.0).mean() for v in (bounded[0], 0.0 * exact[0]))
    assert mine < 0.35 * still < 0.15


@pytest.mark.parametrize("real", PRECISION)
def test_c_and_replay_give_the_same_bytes(real: Real) -> None:
    need_compiler()
    kind = np.float32 if real == "float32" else np.float64
    routine = safe_step(4, 2, 24, precision=PRECISION[real], fallback="bounded")
    pairs = zip(draw_trials(40, seed=2).arrays, broken(), strict=True)
    with np.errstate(over="ignore"):
        arrays = [np.concatenate(pair).astype(kind) for pair in pairs]
    made = compile_block(routine, real=real)(*arrays)
    for mine, theirs in zip(replay(routine, *arrays, real=kind), made, strict=True):
        assert mine.astype(kind).tobytes() == theirs.astype(kind).tobytes()


def broken() -> tuple[Array, ...]:
    """Problems in which one number is none, infinite or huge."""
    rng, trials = np.random.default_rng(3), draw_trials(100, seed=7)
    arrays = tuple(array.copy() for array in trials.arrays)
    for k in range(100):
        one = arrays[rng.integers(0, 4)]
        one[k, rng.integers(0, one.shape[1])] = rng.choice([np.nan, np.inf, -np.inf, 1e30, -1e300])
    return arrays


def test_no_number_that_is_none_comes_through() -> None:
    need_compiler()
    arrays = broken()
    v, *_, opening, status, _ = compile_block(safe_step(4, 2, 24, fallback="bounded"))(*arrays)
    low, high = arrays[4][:, :4], arrays[4][:, 4:]
    assert np.isfinite(v).all() and np.isfinite(opening).all() and (low <= v).all() and (v <= high).all()
    assert set(np.unique(status)) <= {MET, CLAMPED, BOUNDED}
    lost = np.isnan(np.hstack(arrays)).any(axis=1)
    assert lost.any() and (status[lost, 0] != MET).all()


def test_a_row_that_is_no_number_leaves_the_target_in_the_box() -> None:
    tick = PriorityStep("projected", n=2, levels=(LevelShape(2),), rows=2, fallback="bounded")
    tick.J[:], tick.lower[:], tick.upper[:] = np.eye(2), [0.3, 0.4], [0.3, 0.4]
    tick.rows[1] = [np.nan, 0, -1, 1, 1]
    tick.box[:] = [[-1, -1], [1, 1]]
    tick.solve()
    assert tick.stage == "bounded" and tick.v.tolist() == tick.target.tolist()


def test_the_work_is_bounded_by_the_routine_itself() -> None:
    shapes = (LevelShape(2), LevelShape(1), LevelShape(1))

    def most(rows: int) -> int:
        sizes = {"n": 4, "levels": shapes, "rows": rows, "precision": FLOAT32}
        return priority_step("projected", **sizes, fallback="bounded").operations  # type: ignore[arg-type]

    assert most(24) <= 7_000
    assert most(32) - most(24) == most(24) - most(16)


def test_rows_without_bounds_and_a_row_without_a_way_are_passed() -> None:
    tick = PriorityStep("projected", n=2, levels=(LevelShape(2),), rows=4, fallback="bounded")
    tick.J[:], tick.lower[:], tick.upper[:] = np.eye(2), [0.3, 0.4], [0.3, 0.4]
    tick.rows[:2] = [[1, 0, -np.inf, 0.1, 1], [0, 0, -np.inf, np.inf, 1]]
    tick.rows[2:] = [[0, 0, 0, 0, 0], idle_row(2)]
    tick.box[:] = [[-1, -1], [1, 1]]
    tick.solve()
    assert tick.stage == "bounded" and tick.opening[0] == 0.0 and tick.binding() == ()
    np.testing.assert_allclose(tick.v, [0.1, 0.4], atol=1e-12)
    tick.rows[1] = [-1, 0, -np.inf, -0.3, 1]  # against the first: v_1 at most 0.1, at least 0.3
    tick.solve()
    assert tick.stage == "bounded" and 0.1 <= tick.v[0] <= 0.3 and 0.0 < tick.opening[0] <= 0.2
    tick.box[0] = 0.4  # its rows are not among the others: standing still is outside all the same
    tick.solve()
    assert tick.stage == "bounded" and (tick.v >= 0.4).all()


def test_a_set_based_first_level_and_mode_filter_have_it_too() -> None:
    wall = Row("wall", "barrier", np.array([1.0, 0.0]), -np.inf, 0.1)
    for level, mode in ((Level("a", np.eye(2)[:1], np.array([0.3]), np.array([0.4])), "projected"),
                        (Level("a", np.eye(2), np.array([0.3, 0.4])), "filter")):  # fmt: skip
        tick = PriorityStep.of(build_problem([level], [wall]), mode, fallback="bounded")  # type: ignore[arg-type]
        tick.solve()
        assert tick.stage == ("bounded" if mode == "projected" else "met")
        assert abs(tick.v[0] - 0.1) <= 1e-9


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"mode": "nsb"}, "mode nsb has none.*filter or projected"),
        ({"mode": "lexicographic"}, "mode lexicographic has none"),
        ({"mode": "projected", "damping": 0.1}, "combined with damping"),
        ({"mode": "projected", "fallback": "bound"}, "did you mean 'bounded'"),
    ],
)
def test_where_there_is_no_such_ladder_it_is_told(options: dict[str, object], words: str) -> None:
    sizes = {"n": 2, "levels": (LevelShape(1),), "rows": 1, "fallback": "bounded"}
    with pytest.raises(InputError, match=words):
        priority_step(**{**sizes, **options})  # type: ignore[arg-type]
