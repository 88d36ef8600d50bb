import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.verification.stack import SHIPPED_STACKS, shipped_stack
from surctl.priority.diagnosis.findings import build_region
from surctl.tasks import Stack, Task, depth_task, distance_task, heading_task, position_task
from surctl.verification.stack import (
    StackConditions,
    comparison_converges,
    prove_sine,
    prove_strength,
    stack_conditions,
)

ETA = ca.SX.sym("eta", 4)
REGION = ([1.0, 1.0, -1.0, -3.0], [3.0, 2.0, 0.0, 3.0])


def linear(name: str, row: list[float], gain: float = 1.0) -> Task:
    return Task(name=name, eta=ETA, sigma=ca.dot(ca.SX(row), ETA), gain=gain, kinematics="vehicle")


def told(*tasks: Task, region: object = REGION) -> StackConditions:
    # the tests of mistakes give regions of a wrong type
    return stack_conditions(Stack(tasks), region, samples=128)  # type: ignore[arg-type]


def test_orthogonal_tasks_converge_and_track_by_identity() -> None:
    found = told(depth_task(ETA, -0.2), heading_task(ETA, 0.3), position_task(ETA, [1.0, 1.0]))
    assert all((p.kind, p.shown, p.sine) == ("orthogonal", "identity", 1.0) for p in found.pairs)
    assert all((v.outcome, v.shown, v.keeps, v.tracks) == ("converges", "identity", 1.0, True) for v in found.levels)
    assert found.triangular and found.converges


def test_two_distances_are_independent_off_the_line_through_their_points() -> None:
    # by hand: the sine of the angle under which (0, 0) and (4, 0) are seen is 4 y over the product of the distances
    found = told(
        distance_task(ETA, [0.0, 0.0], distance=1, name="a"),
        distance_task(ETA, [4.0, 0.0], distance=1, name="b"),
        depth_task(ETA, -0.2),
    )
    x, y = np.meshgrid(np.linspace(1, 3, 401), np.linspace(1, 2, 401))
    least = np.min(4 * y / np.hypot(x, y) / np.hypot(4 - x, y))
    pair = found.pairs[0]
    assert (pair.kind, pair.shown) == ("independent", "proved")
    assert 0.85 * least < pair.sine <= least
    level = found.levels[1]
    assert (level.outcome, level.shown, level.tracks) == ("converges", "proved", False)
    assert 0.7 * least**2 < level.keeps <= least**2
    assert "at rest" in level.sentence and found.triangular


def test_a_sine_is_proved_up_to_the_least_there_is_and_none_beyond() -> None:
    rows = [linear("a", [1, 0, 0, 0]), linear("b", [1, 1, 0, 0])]  # 45 degrees
    stack, least = Stack(rows), np.sqrt(0.5)
    region = build_region(stack, REGION)
    assert prove_sine(stack, region, [0], 1, sine=0.99 * least, time_limit=5.0) == 0.99 * least
    assert prove_sine(stack, region, [0], 1, sine=1.01 * least, time_limit=0.1) == 0.0
    assert prove_strength(stack, region, 1, time_limit=5.0)
    four = Stack((position_task(ETA, [1.0, 1.0]), linear("c", [1, 1, 0, 0])))
    assert prove_sine(four, build_region(four, REGION), [0], 1, sine=0.01, time_limit=0.2) == 0.0
    near = Stack((distance_task(ETA, [2.0, 1.5], distance=1),))
    assert not prove_strength(near, build_region(near, REGION), 0, time_limit=0.1)


def test_on_that_line_they_are_dependent_and_the_state_is_told() -> None:
    found = told(
        distance_task(ETA, [0.0, 0.0], distance=1, name="a"),
        distance_task(ETA, [4.0, 0.0], distance=1, name="b"),
        region=([1.0, -1.0, -1.0, -3.0], [3.0, 2.0, 0.0, 3.0]),
    )
    (pair,) = found.pairs
    assert (pair.kind, pair.shown, pair.sine) == ("dependent", "witness", 0.0)
    assert abs(pair.where["y"]) < 1e-2 and set(pair.where) == {"x", "y"}
    assert [v.outcome for v in found.levels] == ["converges", "need not converge"]
    assert abs(found.levels[1].where["y"]) < 1e-2 and "algorithmic singularity" in pair.sentence


def test_a_task_that_asks_for_what_is_taken_never_has_it() -> None:
    found = told(position_task(ETA, [1.0, 1.0]), distance_task(ETA, [0.0, 0.0], distance=1))
    assert found.pairs[0].kind == "dependent"
    assert [v.outcome for v in found.levels] == ["converges", "need not converge"] and not found.converges


def test_a_region_that_holds_the_point_of_a_distance_has_no_proof_of_it() -> None:
    found = told(distance_task(ETA, [2.0, 1.5], distance=1))
    (level,) = found.levels
    assert level.outcome == "need not converge" and "its own Jacobian is singular" in level.reason
    assert np.hypot(level.where["x"] - 2.0, level.where["y"] - 1.5) < 1e-2


def test_pairs_that_are_independent_may_be_dependent_together() -> None:
    found = told(linear("a", [1, 0, 0, 0]), linear("b", [1, 1, 0, 0]), linear("c", [0, 1, 0, 0]))
    kinds = {(p.first, p.second): p.kind for p in found.pairs}
    assert kinds == {("a", "b"): "independent", ("a", "c"): "orthogonal", ("b", "c"): "independent"}
    assert found.levels[2].outcome == "need not converge"


def three(gains: tuple[float, float, float]) -> tuple[Task, Task, Task]:
    # by hand: M = [[1, 0, 0], [1, 1/2, 1/4], [0, 1/2, 3/4]]: r disturbs q, and 1/2 · 3/4 > 1/4 · 1/2
    rows = ([1, 0, 0, 0], [1, 1, 0, 0], [0, 1, 1, 0])
    one, two, last = (linear(n, row, g) for n, row, g in zip("pqr", rows, gains, strict=True))
    return one, two, last


def test_a_lower_task_that_disturbs_a_higher_one_is_told_with_its_size() -> None:
    found = told(*three((1.0, 1.0, 1.0)))
    p, q, r = found.levels
    assert p.outcome == "converges" and not p.disturbed_by
    assert q.disturbed_by == pytest.approx({"r": 0.25}) and q.keeps == pytest.approx(0.5)
    assert r.keeps == pytest.approx(0.75)
    assert not found.triangular and found.small_gain
    assert (q.outcome, r.outcome) == ("converges on samples", "converges on samples")


@pytest.mark.parametrize("gains", [(1.0, 1.0, 1.0), (0.1, 0.1, 50.0), (30.0, 0.2, 9.0)])
def test_what_is_said_to_converge_does_for_any_gains(gains: tuple[float, float, float]) -> None:
    assert np.linalg.eigvals(error_matrix(three(gains)) @ np.diag(gains)).real.min() > 0


def error_matrix(tasks: tuple[Task, ...]) -> np.ndarray:
    """M of the nested law for one-row tasks, by flying unit errors through it."""
    J = [np.asarray(ca.DM(ca.jacobian(t.sigma, ETA))) for t in tasks]
    columns = []
    for unit in np.eye(len(J)):
        v = np.zeros(4)
        for j, x in zip(reversed(J), reversed(unit), strict=True):
            v = np.linalg.pinv(j)[:, 0] * x + (np.eye(4) - np.linalg.pinv(j) @ j) @ v
        columns.append([float((j @ v)[0]) for j in J])
    return np.array(columns).T


def test_the_error_matrix_by_hand_is_that_of_the_law() -> None:
    assert error_matrix(three((1.0, 1.0, 1.0))) == pytest.approx(
        np.array([[1, 0, 0], [1, 0.5, 0.25], [0, 0.5, 0.75]]), abs=1e-12
    )


def test_the_comparison_matrix_decides_at_the_equality() -> None:
    own = np.array([1.0, 1.0])
    assert comparison_converges(own, np.array([[0.0, 0.5], [1.9, 0.0]]))
    assert not comparison_converges(own, np.array([[0.0, 0.5], [2.0, 0.0]]))


def test_the_shipped_stacks() -> None:
    ours = shipped_stack("guarded")
    found = stack_conditions(ours.stack, ours.region, parameters=ours.parameters, samples=8)
    assert all(v.outcome == "converges" and v.shown == "identity" and v.tracks for v in found.levels)
    paper = shipped_stack("paper")
    found = stack_conditions(paper.stack, paper.region, parameters=paper.parameters, samples=8)
    outcome = {v.task: v.outcome for v in found.levels}
    assert outcome["velocity"] == "need not converge"  # three or more echoes take the plane
    assert outcome["depth"] == outcome["heading"] == "converges"
    assert not found.triangular
    assert set(SHIPPED_STACKS) == {"guarded", "paper"}
    with pytest.raises(InputError, match=r"stack = .*guarded"):
        shipped_stack("gard")
