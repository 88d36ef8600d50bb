"""From a stack and limits in symbols to a velocity: the same as by hand, and mistakes told by name."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.priority import Mode, solve
from surctl.priority.compiled.assemble import Assembly, assemble
from surctl.tasks import (
    HalfPlane,
    LimitRow,
    SetTask,
    Stack,
    VelocityBox,
    depth_task,
    heading_task,
    line_of_sight_task,
    position_task,
)
from tests.tools import need_compiler

eta, goal, planes = ca.SX.sym("eta", 4), ca.SX.sym("goal", 2), ca.SX.sym("planes", 15)
INPUTS = {"eta": eta, "goal": goal, "planes": planes}


def walls() -> list[HalfPlane]:
    return [HalfPlane(f"wall{i}", planes[5 * i : 5 * i + 4], planes[5 * i + 4]) for i in range(3)]


@pytest.fixture(scope="module")
def assembly() -> Assembly:
    depth = SetTask(name="depth", eta=eta, sigma=eta[2], lower=-0.4, upper=-0.1, kinematics="vehicle")
    stack = Stack((depth, line_of_sight_task(eta, goal), position_task(eta, goal)))
    limits = [VelocityBox([-0.22] * 4, [0.22, 0.22, 0.1, 0.5]), *walls()]
    return assemble(stack, limits, inputs=INPUTS)


def drawn(rng: np.random.Generator) -> dict[str, np.ndarray]:
    walls = np.hstack([rng.normal(size=(3, 4)), rng.uniform(-0.05, 0.5, (3, 1))])
    return {"eta": rng.normal(size=4), "goal": rng.normal(size=2), "planes": walls.reshape(-1)}


@pytest.mark.parametrize("mode", ["nsb"])  # test_step has the others
def test_eta_in_v_out_is_the_law_at_these_values(assembly: Assembly, mode: Mode) -> None:
    need_compiler()
    tick, rng, rungs = assembly.step(mode), np.random.default_rng(1), set()
    for _ in range(40):
        values = drawn(rng)
        for name, value in values.items():
            tick.inputs[name][:] = value
        tick.solve()
        problem = assembly.problem(values)
        want = solve(problem, mode=mode, backend="daqp")
        bar = 1e-6 if want.status == "relaxed" else 1e-8
        assert np.abs(tick.v - want.v).max() <= bar * (1 + np.abs(want.v).max())
        rungs.add(tick.stage)
        names = {name for name, _ in tick.binding()}
        assert names <= {row.name for row in problem.rows} | {"depth"}
    assert rungs >= ({"met"} if mode == "nsb" else {"met", "limited"})


def test_the_problem_has_the_names_and_numbers_of_stack_and_limits(assembly: Assembly) -> None:
    values = drawn(np.random.default_rng(2))
    problem = assembly.problem(values)
    assert [level.name for level in problem.levels] == ["depth", "line_of_sight", "position"]
    assert [row.name for row in problem.rows] == [f"velocity.{a}" for a in "uvwr"] + ["wall0", "wall1", "wall2"]
    depth = problem.levels[0]
    np.testing.assert_array_equal(depth.J, [[0, 0, 1, 0]])
    np.testing.assert_allclose([depth.lower[0], depth.high[0]], np.array([-0.4, -0.1]) - values["eta"][2], atol=1e-15)
    cos, sin = np.cos(values["eta"][3]), np.sin(values["eta"][3])
    np.testing.assert_allclose(problem.levels[2].J, [[cos, -sin, 0, 0], [sin, cos, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(problem.levels[2].x, values["goal"] - values["eta"][:2], atol=1e-15)
    wall = problem.rows[5]
    np.testing.assert_array_equal([*wall.a, wall.upper], values["planes"][5:10])
    assert wall.kind == "barrier" and wall.lower == -np.inf


def test_the_box_is_that_of_the_problem() -> None:
    scaled = HalfPlane("slow", ca.vertcat(0, -2.0, 0, 0), 0.1, kind="actuator")  # v >= -0.05
    below = HalfPlane("against", ca.vertcat(1.0, 0, 0, 0), -0.4, kind="actuator")  # u <= -0.4, but first u >= -0.2
    by_symbol = HalfPlane("symbol", ca.vertcat(0, 0, 0, planes[3]), planes[4], kind="actuator")
    limits = [VelocityBox([-0.2] * 4, [0.3] * 4), scaled, below, by_symbol]
    made = assemble(Stack((depth_task(eta, -0.2),)), limits, inputs=INPUTS)
    for slope, low, high in ((2.0, -0.2, 0.05), (-2.0, -0.05, 0.3), (0.0, -0.2, 0.3)):
        values = {"eta": np.zeros(4), "goal": np.zeros(2), "planes": np.full(15, 0.1)}
        values["planes"][3] = slope
        tick = made.step("nsb")
        for name, value in values.items():
            tick.inputs[name][:] = value
        tick.solve()
        np.testing.assert_allclose(tick.box, [[-0.2, -0.05, -0.2, low], [-0.2, 0.3, 0.3, high]], atol=1e-15)


def test_two_ticks_do_not_share_their_arrays(assembly: Assembly) -> None:
    one, other = assembly.step("nsb"), assembly.step("nsb")
    one.inputs["goal"][:] = 1.0
    one.solve()
    other.solve()
    assert not np.array_equal(one.v, other.v)


def test_no_limit_is_no_row() -> None:
    made = assemble(Stack((depth_task(eta, -0.2),)), inputs={"eta": eta})
    tick = made.step("filter")
    tick.solve()
    np.testing.assert_allclose(tick.v, [0, 0, -0.2, 0], atol=1e-15)
    assert made.problem({"eta": np.zeros(4)}).rows == ()


def test_a_number_that_is_none_is_clamped_and_told_by_name(assembly: Assembly) -> None:
    tick, values = assembly.step("filter"), drawn(np.random.default_rng(3))
    values["goal"][1] = np.nan
    for name, value in values.items():
        tick.inputs[name][:] = value
    tick.solve()
    assert tick.stage == "clamped" and (tick.v == 0.0).all()
    with pytest.raises(InputError, match=r"task line_of_sight.*row 0 is not finite"):
        assembly.problem(values)
    values = drawn(np.random.default_rng(3))
    values["planes"][6] = np.inf
    with pytest.raises(InputError, match=r"limit wall1.*is not finite"):
        assembly.problem(values)
    tall = assemble(Stack((position_task(eta, goal),)), inputs=INPUTS)
    values["goal"][1] = np.nan
    with pytest.raises(InputError, match=r"task position.*row 1 is not finite"):
        tall.problem(values)


def test_a_symbol_without_an_input_is_told_by_name() -> None:
    stack = Stack((heading_task(eta, 0.1), position_task(eta, goal)))
    with pytest.raises(InputError, match=r"task position.*goal_0, goal_1"):
        assemble(stack, inputs={"eta": eta})
    with pytest.raises(InputError, match=r"limit wall0.*planes"):
        assemble(stack, walls(), inputs={"eta": eta, "goal": goal})


def test_inputs_and_values_are_checked(assembly: Assembly) -> None:
    stack = Stack((depth_task(eta, -0.2),))
    with pytest.raises(InputError, match=r"inputs\.twice"):
        assemble(stack, inputs={"eta": eta, "twice": eta[1]})
    for wrong in (eta + 1, ca.SX.sym("flat", 1, 2), 3.0, ca.SX(0, 1)):
        with pytest.raises(InputError, match=r"inputs\.eta"):
            assemble(stack, inputs={"eta": wrong})
    with pytest.raises(InputError, match="names two limits"):
        assemble(stack, [walls()[0], walls()[0]], inputs=INPUTS)
    good = drawn(np.random.default_rng(0))
    for values, word in (
        ({**good, "gaol": 1.0}, "did you mean 'goal'"),
        ({"eta": good["eta"]}, "goal is missing|goal: is missing"),
        ({**good, "eta": np.zeros(3)}, "has 3 entries"),
        ({**good, "eta": "north"}, "not an array"),
    ):
        with pytest.raises(InputError, match=word):
            assembly.problem(values)


def test_a_set_of_two_rows_is_to_be_split() -> None:
    place = SetTask(name="place", eta=eta, sigma=eta[:2], lower=-1.0, upper=1.0, kinematics="vehicle")
    with pytest.raises(InputError, match=r"task place.*split\(\)"):
        assemble(Stack((place,)), inputs=INPUTS).step()
    tick = assemble(Stack(place.split()), inputs=INPUTS).step("nsb")
    tick.inputs["eta"][:] = [2.0, 0.0, 0.0, 0.0]
    tick.solve()
    np.testing.assert_allclose(tick.v, [-1.0, 0, 0, 0], atol=1e-12)


def test_inputs_are_written_into_and_nothing_is_loaded(assembly: Assembly) -> None:
    tick, values = assembly.step("nsb"), drawn(np.random.default_rng(0))
    with pytest.raises(TypeError):
        tick.inputs["eta"] = values["eta"]  # type: ignore[index]
    with pytest.raises(InputError, match="cannot load a problem"):
        tick.load(assembly.problem(values))


@dataclass(frozen=True)
class Own:
    """A limit by somebody else."""

    row: LimitRow

    def rows(self) -> tuple[LimitRow, ...]:
        return (self.row,)


def test_rows_of_others_are_checked_and_may_be_numbers() -> None:
    stack = Stack((depth_task(eta, 0.0),))
    a, one = ca.SX([[1, 0, 0, 0]]), ca.SX(1)
    for row, says in (
        (LimitRow("own", "hard", a, -one, one), "unknown kind"),  # type: ignore[arg-type]
        (LimitRow("own", "actuator", a, ca.SX([-1, -1]), one), "own: lower: has 2 entries, expected 1"),
        (LimitRow("own", "actuator", ca.SX.zeros(1, 3), -one, one), "own: a: has 3 entries, expected 4"),
    ):
        with pytest.raises(InputError, match=says):
            assemble(stack, [Own(row)], inputs={"eta": eta})
    plain = Own(LimitRow("own", "actuator", np.array([[0, 0, 1.0, 0]]), -0.1, 0.1))  # type: ignore[arg-type]
    tick = assemble(stack, [plain], inputs={"eta": eta}).step("filter")
    tick.inputs["eta"][:] = [0, 0, -3, 0]
    tick.solve()
    np.testing.assert_allclose(tick.v, [0, 0, 0.1, 0], atol=1e-12)
