"""The compiled ticks against the law in NumPy, against references that share no code, and against bad numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import linprog

from surctl.errors import InputError, SolverError, ToolMissing
from surctl.ir import Block, compile_block, replay, to_casadi
from surctl.ir.native import SlowerEngine
from surctl.priority import Level, Mode, PriorityProblem, Row, Settings, build_problem, solve
from surctl.priority.compiled import sweep
from surctl.priority.compiled.step import OUTPUTS, PriorityStep, priority_step
from surctl.priority.optimality import is_optimal
from surctl.priority.shapes import LevelShape, StackShape
from surctl.priority.solver.elimination import LOOPED
from tests.oracles.priority_references import daqp_hierarchy, printed_law, svd_cascade
from tests.oracles.shape_draws import draw_of_shape
from tests.tools import need_compiler

Array = NDArray[np.float64]

N, M = 4, 24
VALUES = (LevelShape(2), LevelShape(1))
SETS = (LevelShape(1, True), LevelShape(2), LevelShape(1, True))
MODES: tuple[Mode, ...] = ("nsb", "filter", "projected", "lexicographic")
SETTINGS = [Settings(mode) for mode in MODES] + [
    Settings("nsb", damping=0.1),
    Settings("projected", damping=0.1),
]
STATUS = {"met": "optimal", "limited": "limited", "relaxed": "relaxed", "clamped": "clamped"}
E = np.eye(N)
seeds = st.integers(0, 2**32 - 1)
modes = pytest.mark.parametrize("mode", MODES)

_made: dict[tuple[object, ...], PriorityStep] = {}


def tick_for(shapes: tuple[LevelShape, ...], chosen: Settings) -> PriorityStep:
    need_compiler()
    key = (shapes, chosen)
    if key not in _made:
        _made[key] = PriorityStep(chosen.mode, n=N, levels=shapes, rows=M, damping=chosen.damping)
    return _made[key]


def box(half: float) -> list[Row]:
    return [Row(f"box.{axis}", "actuator", E[i], -half, half) for i, axis in enumerate("uvwr")]


def size(v: Array) -> float:
    return 1.0 + float(np.abs(v).max())


@pytest.mark.parametrize(
    ("shapes", "chosen"),
    [(VALUES, chosen) for chosen in SETTINGS[:4]],  # with sets and damping: study 40
    ids=lambda one: f"{one.mode}-{one.damping}" if isinstance(one, Settings) else f"{len(one)} levels",
)
def test_solve_runs_the_step_and_agrees_with_the_reference(shapes: tuple[LevelShape, ...], chosen: Settings) -> None:
    tick, rng, seen = tick_for(shapes, chosen), np.random.default_rng(11), set()
    arguments = {"mode": chosen.mode, "damping": chosen.damping}
    for _ in range(16):
        problem = draw_of_shape(rng, shapes)
        idle = [Row(f"idle{i}", "barrier", np.zeros(N), -1.0, 1.0) for i in range(M - len(problem.rows))]
        problem = build_problem(problem.levels, [*problem.rows, *idle])
        tick.load(problem)
        tick.solve()
        got, want = solve(problem, **arguments), solve(problem, **arguments, backend="daqp")
        assert got.v.tobytes() == tick.v.tobytes() and got.iterations == tick.count[0]
        assert STATUS[tick.stage] == got.status == want.status
        # the least opening leaves a set without inside, where digits are lost in both
        bar = 1e-12 if chosen.mode == "nsb" else 1e-6 if want.status == "relaxed" else 2e-8
        assert np.abs(tick.v - want.v).max() <= bar * size(want.v)
        assert got.is_optimal(problem, tol=1e-6)
        assert set(got.relaxed) == set(want.relaxed) and set(got.causes) == set(want.causes)
        if got.status in ("optimal", "limited"):  # at a least opening, multipliers are not unique
            assert dict(got.binding) == pytest.approx(dict(want.binding), abs=1e-5)
            assert {name for name, _ in tick.binding()} >= {name for rows in got.causes.values() for name in rows}
        seen.add(tick.stage)
    expected = {"nsb": {"met"}, "filter": {"met", "relaxed"}}.get(chosen.mode, {"met", "limited", "relaxed"})
    assert seen == expected - ({"limited"} if chosen.damping else set())


def test_without_a_compiler_solve_gives_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    need_compiler()
    wall = Row("wall", "barrier", np.array([1.0, 0.0]), -np.inf, 0.1)
    problem = build_problem([Level("goal", np.eye(2), np.array([0.3, 0.4]))], [wall])
    want = solve(problem, mode="filter")

    def missing(*_: object, **__: object) -> None:
        raise ToolMissing("no C compiler found")

    monkeypatch.setattr("surctl.priority.compiled.step.compile_block", missing)
    monkeypatch.setattr("surctl.priority.solving._steps", {})
    with pytest.warns(SlowerEngine, match="no C compiler found"):
        got = solve(problem, mode="filter")
    assert got.v.tobytes() == want.v.tobytes() and got.explain() == want.explain()


def test_the_judge_refuses_a_moved_answer() -> None:
    rng = np.random.default_rng(3)
    for chosen in SETTINGS[1:4]:
        tick, refused = tick_for(VALUES, chosen), 0
        for _ in range(20):
            problem = draw_of_shape(rng, VALUES)
            tick.load(problem)
            tick.solve()
            v = tick.v + 1e-4 * rng.normal(size=N)
            refused += not is_optimal(v, problem, settings=chosen, target=tick.target, tol=1e-6)
        assert refused >= 19


@given(seeds)
@settings(max_examples=25)
def test_without_rows_the_modes_are_nsb_and_strict_priority(seed: int) -> None:
    problem = draw_of_shape(np.random.default_rng(seed), VALUES, limits=False)
    for mode in MODES:
        tick = tick_for(VALUES, Settings(mode))
        tick.load(problem)
        tick.solve()
        want = svd_cascade(problem.levels) if mode == "lexicographic" else printed_law(problem.levels)
        assert np.abs(tick.v - want).max() <= (1e-9 if mode == "lexicographic" else 1e-11) * size(want)
        assert tick.stage == "met" and tick.binding() == ()


@given(seeds)
@settings(max_examples=20)
def test_independent_rows_give_nsb_to_the_last_digits(seed: int) -> None:
    problem = draw_of_shape(np.random.default_rng(seed), VALUES, limits=False, conditioned=True)
    tick = tick_for(VALUES, Settings("nsb"))
    tick.load(problem)
    tick.solve()
    want = printed_law(problem.levels)
    assert np.abs(tick.v - want).max() <= 1e-13 * size(want)


def unit_rows(problem: PriorityProblem) -> PriorityProblem:
    """DAQP scales rows to length 1: residuals compare where they have it already."""
    made = []
    for level in problem.levels:
        length = np.linalg.norm(level.J, axis=1)
        made.append(Level(level.name, level.J / np.where(length > 0, length, 1.0)[:, None], level.lower, level.high))
    return build_problem(made, problem.rows)


@pytest.mark.parametrize("shapes", [VALUES], ids=["values"])  # with sets: study 40
def test_no_level_is_served_worse_than_by_daqp_s_hierarchy(shapes: tuple[LevelShape, ...]) -> None:
    tick, rng, compared = tick_for(shapes, Settings("lexicographic")), np.random.default_rng(5), 0
    for _ in range(60):
        problem = unit_rows(draw_of_shape(rng, shapes))
        tick.load(problem)
        tick.solve()
        if tick.stage not in ("met", "limited"):
            continue
        try:
            other = daqp_hierarchy(problem)
        except SolverError:
            continue
        rows = problem.limits
        assert rows.violation(tick.v).max() <= 1e-9
        if rows.violation(other).max() > 1e-9:
            continue
        gaps = np.array([level.residual(tick.v) - level.residual(other) for level in problem.levels])
        different = np.flatnonzero(np.abs(gaps) > 1e-8)
        compared += different.size == 0
        if different.size:  # DAQP stops a hair off the best of a higher level, which frees a lower one: who is right?
            strict = Settings("lexicographic")
            assert is_optimal(tick.v, problem, settings=strict, target=np.zeros(N), tol=1e-9)
            assert not is_optimal(other, problem, settings=strict, target=np.zeros(N), tol=1e-9)
    assert compared > 10


def test_the_opening_is_the_least() -> None:
    rng, compared = np.random.default_rng(2), 0
    for chosen in (Settings("filter"), Settings("projected"), Settings("lexicographic")):
        tick = tick_for(VALUES, chosen)
        for _ in range(25):
            problem = draw_of_shape(rng, VALUES)
            tick.load(problem)
            tick.solve()
            if tick.stage == "relaxed":
                rows = problem.limits
                opens = -rows.soft.astype(float)
                sides = [(rows.A, rows.upper), (-rows.A, -rows.lower)]
                G = np.vstack([np.column_stack([A, opens])[np.isfinite(b)] for A, b in sides])
                h = np.concatenate([b[np.isfinite(b)] for _, b in sides])
                bounds = [(None, None)] * N + [(0, None)]
                least = linprog(np.append(np.zeros(N), 1.0), G, h, bounds=bounds, method="highs")
                assert abs(tick.opening[0] - least.x[-1]) <= 1e-6
                compared += 1
    assert compared > 12


@pytest.mark.parametrize(("angle", "length"), [(0.0, 1.0), (1e-12, 1.0), (1e-3, 1.0), (0.5, 1.0), (0.5, 1e-12)])
def test_a_first_task_whose_rows_are_nearly_or_wholly_dependent_is_met_as_in_numpy(angle: float, length: float) -> None:
    rows = [[1.0, 0.0, 0.0, 0.0], [length * np.cos(angle), length * np.sin(angle), 0.0, 0.0]]
    asked = np.array([0.3, length * 0.1])
    problem = build_problem([Level("first", rows, asked), Level("second", E[2:3], [0.2])], box(0.5))
    tick = tick_for(VALUES, Settings("projected"))
    tick.load(problem)
    tick.solve()
    want = solve(problem, backend="daqp")
    assert STATUS[tick.stage] == want.status
    assert np.abs(tick.v - want.v).max() <= 2e-8 * size(want.v)


def test_the_rows_that_hold_the_first_task_back_balance_its_pull() -> None:
    tick, rng, checked = tick_for(VALUES, Settings("projected")), np.random.default_rng(8), 0
    for _ in range(80):
        problem = draw_of_shape(rng, VALUES, conditioned=True)
        tick.load(problem)
        tick.solve()
        if tick.stage != "limited":
            continue
        J, x = problem.levels[0].J, problem.levels[0].lower
        normal = {row.name: row.a for row in problem.rows}
        pull, first = J.T @ (x - J @ tick.v), {}
        for name, multiplier in tick.binding():
            first[name] = multiplier * normal[name]
            if np.abs(sum(first.values()) - pull).max() <= 1e-7:
                checked += 1
                break
        else:
            raise AssertionError((tick.binding(), pull))
    assert checked > 10


def test_a_limited_task_names_its_row() -> None:
    first = Level("surge", E[[0, 3]], np.array([1.0, 0.0]))
    problem = build_problem([first, Level("depth", E[2:3], np.array([0.1]))], box(0.22))
    for mode in ("projected", "lexicographic"):
        tick = tick_for(VALUES, Settings(mode))
        tick.load(problem)
        tick.solve()
        np.testing.assert_allclose(tick.v, [0.22, 0, 0.1, 0], atol=1e-12)
        assert tick.stage == "limited"
        assert tick.binding() == (("box.u", pytest.approx(0.78)),)


def test_a_set_that_binds_has_its_own_name() -> None:
    depth = Level("depth", np.array([[1.0, 0.0]]), np.array([0.2]), np.array([0.4]))
    surge = Level("surge", np.array([[0.0, 1.0]]), np.array([0.1]))
    limits = [Row(f"box.{i}", "actuator", row, -1.0, 1.0) for i, row in enumerate(np.eye(2))]
    tick = PriorityStep.of(build_problem([depth, surge], limits), "lexicographic")
    tick.solve()
    np.testing.assert_allclose(tick.v, [0.2, 0.1], atol=1e-12)
    assert tick.binding() == (("depth", pytest.approx(-0.2)),)


def test_a_row_along_a_set_that_is_kept_still_has_its_name() -> None:
    roomy = Level("roomy", E[2:3], np.array([-1.0]), np.array([1.0]))
    depth = Level("depth", E[[2, 0]], np.array([0.5, 0.0]))
    heading = Level("heading", E[3:], np.array([-0.1]), np.array([0.1]))
    tick = tick_for(SETS, Settings("projected"))
    tick.load(build_problem([roomy, depth, heading], box(0.22)))
    tick.solve()
    np.testing.assert_allclose(tick.v, [0, 0, 0.22, 0], atol=1e-12)
    assert tick.stage == "met" and tick.binding() == (("box.w", pytest.approx(0.28)),)


def test_multipliers_are_those_of_what_is_minimised() -> None:
    first = Level("surge", E[[0, 3]], np.array([1.0, 0.0]))
    problem = build_problem([first, Level("depth", E[2:3], np.array([0.1]))], box(0.22))
    u, row = np.array([[1.0, 0.0]]), Row("box.u", "actuator", np.array([1.0, 0.0]), -0.22, 0.22)
    small = build_problem([Level("surge", u, np.array([1.0]))], [row])
    tick = PriorityStep("projected", n=2, levels=(LevelShape(1),), rows=1, damping=0.1)
    tick.load(small)
    tick.solve()
    assert tick.binding() == (("box.u", pytest.approx(0.78 - 0.1**2 * 0.22)),)
    np.testing.assert_allclose(tick.v, solve(small, damping=0.1, backend="daqp").v, atol=1e-12)
    # an opened row holds the task back, too; with the box at the same place, multipliers are not unique
    back = Row("back", "barrier", 2 * E[0], -np.inf, -0.6)
    tick = tick_for(VALUES, Settings("projected"))
    side = Row("side", "barrier", E[0], -np.inf, -0.25)  # missed as well, but not up to its opened bound
    tick.load(build_problem(problem.levels, [side, *box(0.2), back]))
    tick.solve()
    np.testing.assert_allclose(tick.v, [-0.2, 0, 0.1, 0], atol=1e-10)
    assert tick.stage == "relaxed" and tick.opening[0] == pytest.approx(0.1)
    assert "back" in dict(tick.binding())
    assert "side" not in dict(tick.binding())


def test_levels_with_nearly_dependent_rows_are_served_to_the_last_digits() -> None:
    """Singular values 1 and 3e-3, near the weight of the proximal steps."""
    tick, rng, seen = tick_for(VALUES, Settings("lexicographic")), np.random.default_rng(12), 0
    for _ in range(30):
        basis = np.linalg.qr(rng.normal(size=(N, N)))[0]
        turn = np.linalg.qr(rng.normal(size=(2, 2)))[0]
        J = turn @ np.diag([1.0, 3e-3]) @ basis[:2]
        second = draw_of_shape(rng, VALUES).levels[1]
        # a wall stands in the way of the first direction, and leaves the other
        wall = Row("wall", "barrier", basis[0], -np.inf, 0.1)
        flat = Level("flat", J, turn @ [2.0, 3e-3 * rng.uniform(-0.1, 0.1)])
        problem = build_problem([flat, second], [*box(1.0), wall])
        tick.load(problem)
        tick.solve()
        seen += tick.stage == "limited"
        np.testing.assert_allclose(basis[:2] @ tick.v, [0.1, (turn.T @ flat.lower)[1] / 3e-3], atol=1e-9)
        strict = Settings("lexicographic")
        assert is_optimal(tick.v, problem, settings=strict, target=np.zeros(N), tol=1e-10)
    assert seen > 15


@pytest.mark.parametrize("mode", ["projected"])  # others: study 40
def test_a_set_based_level_makes_no_jump(mode: Mode) -> None:
    """Along a smooth path into the set, through it and out, steps of v stay in proportion to steps of the path."""
    tick, rng = tick_for(SETS, Settings(mode)), np.random.default_rng(4)
    problem = draw_of_shape(rng, SETS, conditioned=True)
    problem = build_problem(problem.levels, box(0.6))
    tick.load(problem)
    last, largest, kept = None, 0.0, set()
    for middle in np.linspace(-3, 3, 1001):
        tick.lower[0], tick.upper[0] = middle - 0.3, middle + 0.3
        tick.solve()
        value = float(tick.J[0] @ tick.v)
        kept.add(int(value > tick.upper[0] - 1e-9) - int(value < tick.lower[0] + 1e-9))
        if last is not None:
            largest = max(largest, float(np.abs(tick.v - last).max()) / 0.006)
        last = tick.v.copy()
    assert kept >= {-1, 0, 1}
    assert largest <= 5.0


@modes
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-320])
def test_no_number_anywhere_makes_it_anything_but_finite(mode: Mode, bad: float) -> None:
    shapes = SETS if mode == "projected" else VALUES
    tick = tick_for(shapes, Settings(mode))
    problem = draw_of_shape(np.random.default_rng(1), shapes)
    inputs = {"J": tick.J, "lower": tick.lower, "upper": tick.upper, "rows": tick.rows, "box": tick.box}
    for name, array in inputs.items():
        for k in range(array.size):
            tick.load(problem)
            array.reshape(-1)[k] = bad
            tick.solve()
            for output in OUTPUTS:
                assert np.isfinite(getattr(tick, output)).all(), (name, k, output)
            if mode != "nsb" and name != "box":
                assert (tick.box[0] <= tick.v).all() and (tick.v <= tick.box[1]).all()
            if np.isnan(bad) and name in ("J", "lower", "upper"):
                assert tick.stage == "clamped"
                assert (tick.v == 0.0).all()  # 0 lies in the box


@modes
def test_a_value_with_two_bounds_is_no_value(mode: Mode) -> None:
    tick = tick_for(VALUES, Settings(mode))
    tick.load(draw_of_shape(np.random.default_rng(0), VALUES))
    tick.upper[1] += 1e-3
    tick.solve()
    assert tick.stage == "clamped" and (tick.v == 0.0).all()


@modes
def test_hard_rows_that_contradict_each_other_leave_the_box(mode: Mode) -> None:
    if mode == "nsb":
        return
    against = Row("against", "actuator", E[0] + E[1], 1.0, np.inf)
    tick = tick_for(VALUES, Settings(mode))
    tick.load(build_problem(draw_of_shape(np.random.default_rng(0), VALUES).levels, [*box(0.2), against]))
    tick.solve()
    assert tick.stage == "clamped" and np.abs(tick.v).max() <= 0.2 and tick.binding() == ()


@pytest.mark.parametrize("mode", ["nsb"])  # the others: solver/test_fallback, control/test_law, study 40
def test_compiled_and_replayed_are_the_same_bytes(mode: Mode) -> None:
    need_compiler()
    routine, rng, made = priority_step(mode, n=N, levels=SETS, rows=7), np.random.default_rng(9), []
    loaded = PriorityStep("nsb", n=N, levels=SETS, rows=7)
    for _ in range(10):
        problem = draw_of_shape(rng, SETS, limits=False)
        rows = [Row(f"wall{i}", "barrier", rng.normal(size=N), -np.inf, 0.3 * rng.normal()) for i in range(3)]
        loaded.load(build_problem(problem.levels, [*box(0.3), *rows]))
        inputs = (loaded.J, loaded.lower, loaded.upper, loaded.rows, loaded.box)
        made.append([array.reshape(-1).copy() for array in inputs])
    arrays = [np.array(column) for column in zip(*made, strict=True)]
    outputs = dict(zip(OUTPUTS, compile_block(routine)(*arrays), strict=True))
    for (name, a), b in zip(outputs.items(), replay(routine, *arrays), strict=True):
        assert a.tobytes() == np.asarray(b).tobytes(), name
    assert mode in ("nsb", "filter") or set(outputs["status"][:, 0]) >= {1.0, 2.0, 3.0}


@pytest.mark.parametrize("mode", ["nsb", "filter"])  # the others are made of the same kinds of steps
def test_casadi_runs_the_same_routine(mode: Mode) -> None:
    shapes, rng = (LevelShape(1), LevelShape(1, True)), np.random.default_rng(6)
    routine = priority_step(mode, n=2, levels=shapes, rows=3)
    machine = to_casadi(routine)
    for _ in range(2):
        rows = np.zeros((3, 5))
        rows[:2, :2], rows[:2, 2], rows[:2, 3] = np.eye(2), -0.5, 0.5
        rows[2] = [*rng.normal(size=2), -np.inf, rng.normal(), 1.0]
        lower = rng.normal(size=2)
        upper = lower + np.array([0.0, 0.2])
        inputs = [rng.normal(size=4), lower, upper, rows.reshape(-1), np.array([-0.5, -0.5, 0.5, 0.5])]
        for a, b in zip(machine.call(inputs), replay(routine, *inputs), strict=True):
            np.testing.assert_array_equal(np.array(a).reshape(-1), b)


def test_without_a_compiler_the_replay_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = draw_of_shape(np.random.default_rng(0), VALUES)
    want = tick_for(VALUES, Settings("nsb"))
    want.load(problem)
    want.solve()
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.warns(SlowerEngine, match="no-such-compiler"):
        tick = PriorityStep("nsb", n=N, levels=VALUES, rows=M)
    tick.load(problem)
    tick.solve()
    assert want.compiled and not tick.compiled
    for name in OUTPUTS:
        assert getattr(tick, name).tobytes() == getattr(want, name).tobytes()


@pytest.mark.parametrize("damping", [0.0, 0.05])
def test_loops_and_expressions_give_equal_projections(damping: float, monkeypatch: pytest.MonkeyPatch) -> None:
    shape, rng = StackShape(LOOPED, (*VALUES, LevelShape(1, True), LevelShape(LOOPED))), np.random.default_rng(3)

    def blocks() -> list[Block]:
        return [*(sweep.sweep(shape, damping=damping, highest=k) for k in (0, 1)), sweep.gate(shape)]

    loops = blocks()
    monkeypatch.setattr(sweep, "LOOPED", LOOPED + 1)
    unrolled = blocks()
    for _ in range(20):
        w, J, lower = (rng.normal(size=k) for k in (LOOPED, (shape.rows, LOOPED), shape.rows))
        J[1], J[6], J[rng.integers(0, shape.rows)] = 2.0 * J[0], J[5] + 1e-13, 0.0
        upper = lower + np.array([level.is_set for level in shape.levels for _ in range(level.rows)])
        bad = lower.copy()
        bad[rng.integers(0, shape.rows)] = rng.choice([np.nan, 1e301, 1e3])
        for below, sound in ((lower, True), (bad, False)):
            inputs = (J.ravel(), below, upper)
            got = replay(loops[2], *inputs)
            assert got[0] == sound and all(map(np.array_equal, got, replay(unrolled[2], *inputs)))
        for loop, one in zip(loops[:2], unrolled[:2], strict=True):
            a, b = replay(loop, w, J.ravel(), lower, upper)[0], replay(one, w, J.ravel(), lower, upper)[0]
            assert np.abs(a - b).max() <= 1e-11 * size(a)


@pytest.mark.parametrize("options", [{}, {"damping": 0.1}, {"fallback": "bounded"}])
@pytest.mark.parametrize("shapes", [(LevelShape(1),), (LevelShape(2),), (LevelShape(1, True),), (LevelShape(1),) * 2])
def test_one_velocity_under_mode_projected(shapes: tuple[LevelShape, ...], options: dict[str, Any]) -> None:
    for bound, v in ((0.8, 0.5), (0.3, 0.3)):
        step = PriorityStep("projected", n=1, levels=shapes, rows=1, **options)
        step.J[:], step.lower[:], step.upper[:] = 2.0, 1.0, 1.0 + shapes[0].is_set
        step.rows[0], step.box[:] = [1.0, -bound, bound, 0.0], [[-1.0], [1.0]]
        step.solve()
        if options != {"fallback": "bounded"}:
            assert step.v[0] == pytest.approx(v, abs=0.01)
        assert abs(step.v[0]) <= bound + 1e-12


def test_one_velocity_and_more_rows_than_velocities() -> None:
    for mode in ("lexicographic",):
        tall = Level("tall", np.array([[1.0], [2.0], [2.0]]), np.array([0.1, 0.2, 0.2]))
        tick = PriorityStep.of(build_problem([tall], [Row("fast", "barrier", np.array([1.0]), -np.inf, 0.5)]), mode)
        tick.solve()
        np.testing.assert_allclose(tick.v, [0.1], atol=1e-12)
        assert tick.stage == "met"


def test_wrong_shapes_are_told_by_name() -> None:
    with pytest.raises(InputError, match=r"level 2.*split it"):
        priority_step("nsb", n=4, levels=(LevelShape(1), LevelShape(2, True)), rows=1)
    with pytest.raises(InputError, match="no such priority mode"):
        priority_step("nsbb", n=4, levels=VALUES, rows=1)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="damping"):
        priority_step("lexicographic", n=4, levels=VALUES, rows=1, damping=0.1)
    for wrong in ({"n": 0}, {"levels": ()}, {"levels": (LevelShape(0),)}, {"rows": 0}):
        with pytest.raises(InputError):
            priority_step("projected", **{"n": 4, "levels": VALUES, "rows": 1, **wrong})


def test_load_refuses_another_shape_by_name() -> None:
    tick = tick_for(VALUES, Settings("nsb"))
    good = draw_of_shape(np.random.default_rng(0), VALUES)
    narrow = build_problem([Level("a", np.eye(2)[:1], np.zeros(1))])
    tall = build_problem([Level("a", E[:1], np.zeros(1)), good.levels[1]])
    slab = build_problem([good.levels[0], Level("b", E[:1], np.zeros(1), np.ones(1))])
    many = build_problem(good.levels, [Row(f"r{i}", "barrier", E[0], -1.0, 1.0) for i in range(M + 1)])
    for problem, word in ((narrow, "velocities"), (build_problem(good.levels[:1]), "levels"), (tall, "task a"),
                          (slab, "task b"), (many, "places")):  # fmt: skip
        with pytest.raises(InputError, match=word):
            tick.load(problem)


def test_an_array_in_place_of_a_view_is_refused() -> None:
    tick = PriorityStep("nsb", n=N, levels=VALUES, rows=1)
    for name in ("J", "lower", "upper", "rows", "box", "v", "status"):
        with pytest.raises(InputError, match=rf"{name}: is a view.*write into it"):
            setattr(tick, name, np.ones_like(getattr(tick, name)))
    tick.J += 1.0
    tick.lower[:] = tick.upper[:] = 2.0
    assert (tick.J == 1.0).all()


def test_before_the_first_tick_there_is_no_rung() -> None:
    with pytest.raises(InputError, match=r"no solution yet; call solve\(\) first"):
        _ = PriorityStep("nsb", n=N, levels=VALUES, rows=1).stage


@modes
def test_a_row_or_a_task_too_long_to_be_squared_is_never_passed_over(mode: Mode) -> None:
    tick = tick_for(VALUES, Settings(mode))
    nothing = build_problem(
        [Level(f"level {shape.rows}", np.zeros((shape.rows, N)), np.zeros(shape.rows)) for shape in VALUES]
    )
    for length in (1e155, 1e200, 1e299):
        tick.load(nothing)
        tick.J[0], tick.lower[0], tick.upper[0] = length * E[0], 0.5 * length, 0.5 * length
        tick.solve()
        assert tick.stage == "clamped" and not tick.v.any(), length
        if mode == "nsb":  # which knows no rows
            continue
        tick.J[0], tick.lower[0], tick.upper[0] = E[0], 0.5, 0.5
        tick.rows[0] = [length, 0, 0, 0, -0.1 * length, 0.1 * length, 0]
        tick.solve()
        assert tick.stage == "clamped" and np.isfinite(tick.v).all(), length


@pytest.mark.parametrize(
    "wrong",
    [{"n": 4.0}, {"rows": 2.5}, {"levels": (1, 2)}, {"levels": (LevelShape(1.5),)}],  # type: ignore[arg-type]
)
def test_sizes_are_whole_numbers(wrong: dict[str, object]) -> None:
    sizes: dict[str, object] = {"n": 4, "levels": VALUES, "rows": 1}
    with pytest.raises(InputError):
        priority_step("projected", **{**sizes, **wrong})  # type: ignore[arg-type]


@pytest.mark.parametrize("upper", [1.0, 2.0])
@pytest.mark.parametrize("damping", [1e-5, 0.3])
def test_any_damping_gives_the_optimum(upper: float, damping: float) -> None:
    first = Level("first", np.array([[1.0, 0.5]]), np.array([1.0]), np.array([upper]))
    limits = [Row(f"box.{i}", "actuator", row, -0.4, 0.4) for i, row in enumerate(np.eye(2))]
    problem = build_problem([first, Level("second", np.eye(2), np.array([0.1, 0.1]))], limits)
    got, want = solve(problem, damping=damping), solve(problem, damping=damping, backend="daqp")
    np.testing.assert_allclose(got.v, want.v, atol=1e-8)
    assert got.is_optimal(problem) and not got.is_optimal(build_problem([first], limits))
