import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.marine.tuning import Goal, conditions, evaluate, load_goals
from surctl.marine.tuning.evaluation import corners
from surctl.marine.vehicle import load_vehicle
from surctl.tuning import Condition
from tests.tuning.synthetic import CLEAR, GAINS, MARGIN, NEAR, THRIFT, case, install

POLE = Goal("settle", "slowest_pole_per_s", "1/s", -0.1)

figures = st.floats(allow_nan=True, allow_infinity=True)


@pytest.mark.parametrize("goal", [CLEAR, NEAR, POLE], ids=lambda g: g.name)
@given(one=figures, other=figures)
def test_normalised_is_met_at_one_and_monotone(goal, one, other):
    with np.errstate(over="ignore"):
        a, b = goal.normalised(np.array([one, other]))
    met = one <= goal.limit if goal.sense == "at most" else one >= goal.limit
    if np.isnan(one):
        assert a == np.inf
    elif abs(one - goal.limit) > 1e-12:
        assert (a <= 1) == met
    if not np.isnan([one, other]).any():
        worse = one > other if goal.sense == "at most" else one < other
        assert a >= b if worse else a <= b or one == other


def test_normalised_by_hand():
    assert NEAR.normalised(np.array([0.15, 0.3, 0.6, 0.0, np.inf])).tolist() == [0.5, 1.0, 2.0, 0.0, np.inf]
    assert CLEAR.normalised(np.array([0.1, 0.05, 0.025, 0.0, -1.0])).tolist() == [0.5, 1.0, 2.0, np.inf, np.inf]
    assert POLE.normalised(np.array([-0.2, -0.1, -0.05, 0.0, 0.3])).tolist() == [0.5, 1.0, 2.0, np.inf, np.inf]


WRONG = {
    "unknown metric": ('metric = "deviation"\nat_most = { value = 1.0, unit = "m" }', "deviation_m"),
    "wrong unit": ('metric = "deviation_m"\nat_most = { value = 1.0, unit = "s" }', "give it in m"),
    "no unit": ('metric = "deviation_m"\nat_most = { value = 1.0 }', "unit"),
    "a bare number": ('metric = "deviation_m"\nat_most = 1.0', "value with its unit|dictionary|at_most"),
    "no bound": ('metric = "deviation_m"', "needs one bound"),
    "two bounds": (
        'metric = "deviation_m"\nat_most = { value = 1.0, unit = "m" }\nat_least = { value = 1.0, unit = "m" }',
        "needs one bound",
    ),
    "the wrong side": ('metric = "min_clearance_m"\nat_most = { value = 1.0, unit = "m" }', "write at_least"),
    "zero": ('metric = "deviation_m"\nat_most = { value = 0.0, unit = "m" }', "greater than 0"),
    "a negative limit": ('metric = "min_clearance_m"\nat_least = { value = -0.1, unit = "m" }', "greater than 0"),
    "an unstable pole": ('metric = "slowest_pole_per_s"\nat_most = { value = 0.1, unit = "1/s" }', "less than 0"),
    "not finite": ('metric = "deviation_m"\nat_most = { value = nan, unit = "m" }', "finite"),
    "unknown kind": ('metric = "deviation_m"\nkind = "firm"\nat_most = { value = 1.0, unit = "m" }', "kind"),
    "unknown key": ('metric = "deviation_m"\natmost = { value = 1.0, unit = "m" }', "at_most"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_goal_is_told_with_its_file_and_key(tmp_path, what):
    body, told = WRONG[what]
    path = tmp_path / "mine.toml"
    path.write_text(f'kind = "goals"\nname = "mine"\n[[goals]]\nname = "a"\n{body}\n')
    with pytest.raises(InputError, match=told) as error:
        load_goals(str(path))
    assert "mine.toml" in str(error.value) and "goals" in str(error.value) and error.value.remedy


def test_two_goals_of_one_name_and_an_empty_file_are_mistakes(tmp_path):
    one = '[[goals]]\nname = "a"\nmetric = "deviation_m"\nat_most = { value = 1.0, unit = "m" }\n'
    path = tmp_path / "mine.toml"
    path.write_text(f'kind = "goals"\nname = "mine"\n{one}{one}')
    with pytest.raises(InputError, match="is the name of two goals"):
        load_goals(str(path))
    path.write_text('kind = "goals"\nname = "mine"\ngoals = []\n')
    with pytest.raises(InputError, match="goals"):
        load_goals(str(path))


def test_the_library_reads():
    goals = load_goals()
    assert {g.kind for g in goals} == {"hard", "soft"}
    assert all(g.unit for g in goals)


def test_corners_hold_all_ends_of_the_ranges_at_once():
    vehicle = load_vehicle("sur540-flooded")
    found = corners(vehicle)
    assert found[0] == {} and len(found) == 9
    assert {c["plant.m11"] for c in found[1:]} == {50, 125}
    assert {(c["plant.m11"], c["plant.Xuu"], c["plant.Fu_max"]) for c in found[1:]} == {
        (m, x, f) for m in (50, 125) for x in (45, 115) for f in (4.25, 5.75)
    }
    assert all("plant.thrust_lag" not in c and "plant.radius" not in c for c in found)


def test_a_case_that_no_seed_changes_is_flown_once():
    flown = conditions([case("tank-static"), case()], seeds=(3, 4), with_corners=False)
    assert [(c.case.scenario.name, c.seed) for c in flown] == [
        ("tank-static", 3), ("pool-static", 3), ("pool-static", 4)
    ]  # fmt: skip


def test_many_sets_at_once_are_what_each_is_alone(monkeypatch):
    loop = install(monkeypatch)
    flown = conditions([case(), case("pool-behind")], seeds=(0, 1))
    sets = {"k_v": np.array([1.0, 2.0, 3.0]), "k1": np.array([0.2, 0.1, 0.5])}
    goals = (CLEAR, NEAR, THRIFT, MARGIN)
    whole = evaluate(goals, flown, sets)
    assert loop.calls == 2  # one batch a case
    for k in range(3):
        alone = evaluate(goals, flown, {name: values[k : k + 1] for name, values in sets.items()})
        for name in ("normalised", "figure", "excess"):
            assert np.array_equal(getattr(whole, name)[k], getattr(alone, name)[0], equal_nan=True)
    assert np.isinf(whole.normalised[1, :3]).all(), "a run that did not arrive meets nothing"
    assert np.isfinite(whole.normalised[1, 3]), "but the linear loop is what it is"
    assert not whole.feasible[1]


def test_worst_and_mean_are_taken_over_the_goals_own_runs(monkeypatch):
    install(monkeypatch)
    runs = (Condition(case(), 0), Condition(case(), 1), Condition(case(), 2, {}, ("keep clear",)))
    both = (CLEAR, NEAR, Goal("mean", "deviation_m", "m", 0.3, over="mean"))
    found = evaluate(both, runs, {"k1": np.array([0.3])})
    luck = 0.004 * np.sin([0.0, 1.0, 2.0])
    clear = 0.09 - 0.05 * 0.3 + 0.01 * np.log(1.5) + luck
    assert found.figure[0, 0] == pytest.approx(clear.min())
    away = 0.1 + 0.05 / 0.3 + 0.05 * abs(np.log(0.75)) + luck[:2]
    assert found.figure[0, 1] == pytest.approx(away.max())
    assert found.figure[0, 2] == pytest.approx(away.mean())


def test_a_goal_about_a_case_that_is_not_flown_is_a_mistake(monkeypatch):
    install(monkeypatch)
    goal = Goal("x", "deviation_m", "m", 1.0, cases=("pool-statik",))
    with pytest.raises(InputError, match="pool-static"):
        evaluate((goal,), (Condition(case()),), {"k1": np.array([GAINS["k1"]])})
