"""Goals and sweeps about the linear loop at several cruise speeds: the worst decides, and is named."""

from dataclasses import replace

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import load_gains, write_gains
from surctl.marine.simulation import load_scenario
from surctl.marine.tuning import Goal, build_cases, evaluate, figures, load_goals, tuned_gains
from surctl.marine.tuning.evaluation import check_goals
from surctl.marine.tuning.goals import goals_at
from surctl.marine.tuning.sweep import MissionSweep, check_request
from surctl.marine.verification import LINEAR_METRICS, linear_table
from surctl.tuning import Condition, grid, parse_axis, summary, tune
from surctl.tuning.gain_search import _functions
from surctl.tuning.montecarlo import monte_carlo
from surctl.tuning.outcome import goal_rows, tuning_dict
from surctl.tuning.pool import joined_pools
from tests.tuning.synthetic import CLEAR, GAINS, THRIFT, Loop, case, install, request

SPEEDS = (0.05, 0.15, 0.22)
SETTLE = Goal("settle", "settling_time_s.cross_track", "s", 40.0, cruise=(0.22, 0.05, 0.15))
DELAY = Goal("delay", "delay_margin_s", "s", 0.2, "at least", "hard", cruise=(0.1, 0.2))


@pytest.fixture
def flights_cost_nothing(monkeypatch):
    monkeypatch.setattr("surctl.marine.tuning.evaluation.simulate_batch", Loop())


@pytest.fixture
def everything_costs_nothing(monkeypatch):
    install(monkeypatch)

    def linear(vehicle, values, *, base, cruise, **_):
        k_v = np.asarray(values.get("k_v", base["k_v"]), dtype=float)
        return {"delay_margin_s": 0.6 / k_v * (1.2 - np.asarray(cruise))}

    monkeypatch.setattr("surctl.marine.tuning.evaluation.linear_table", linear)


def test_the_worst_speed_decides_in_every_condition(flights_cost_nothing):
    tank = case("pool-static")
    flown = (Condition(tank), Condition(tank, plant={"plant.m11": 1.3 * tank.vehicle["m11"]}))
    sets = {"k_v": np.array([1.0, 2.0])}
    shape = Goal("shape", "crossover_rad_per_s.cross_track", "rad/s", 0.05, "at least", cruise=SPEEDS)
    own = replace(SETTLE, name="own", cruise=())
    mean = replace(SETTLE, name="mean", over="mean")
    goals = (SETTLE, shape, own, mean, replace(SETTLE, name="nominal", plants="nominal"))
    found = evaluate(goals, flown, sets)
    dt, columns = tank.build().dt, (SETTLE.metric, shape.metric)

    def table(cruise, **plant):
        return linear_table(
            tank.vehicle, sets | plant, base=GAINS.values, cruise=cruise, dt=dt, columns=columns, model=tank.vehicle
        )

    at = np.array([[table(u, **c.plant)[SETTLE.metric] for c in flown] for u in SPEEDS])  # speeds, conditions, sets
    assert found.figure[:, 0] == pytest.approx(at.max(axis=(0, 1)), rel=1e-12)
    assert found.place[:, 0].tolist() == [0.05, 0.05], "a slow vehicle returns to the path slowly"
    assert found.figure[:, 3] == pytest.approx(at.max(axis=0).mean(axis=0), rel=1e-12)
    assert found.figure[:, 4] == pytest.approx(at[:, 0].max(axis=0), rel=1e-12)
    least = np.array([[table(u, **c.plant)[shape.metric] for c in flown] for u in SPEEDS])
    assert found.figure[:, 1] == pytest.approx(least.min(axis=(0, 1)), rel=1e-12) and (found.place[:, 1] == 0.05).all()
    # a goal that names no speed is what it was
    there = np.array([table(tank.scenario.cruise, **c.plant)[SETTLE.metric] for c in flown])
    assert found.figure[:, 2] == pytest.approx(there.max(axis=0), rel=1e-12) and np.isnan(found.place[:, 2]).all()


def test_fresh_runs_and_the_descent_see_every_speed(everything_costs_nothing):
    asked = request(goals=(DELAY, THRIFT))
    # 0.6/3.1 · (1.2 − U) s is enough at 0.1 m/s, and not at 0.2 m/s
    found = monte_carlo(figures, (DELAY,), asked.conditions, {"k_v": 3.1, "k1": 0.5})
    assert found.refuted == ("delay",) and found.counterexamples[0].figure == pytest.approx(0.6 / 3.1)
    pool, table = asked.simulate({"k_v": np.array([1.0, 2.0]), "k1": np.array([0.5, 0.5])})
    _, hard = _functions(asked, pool, table, pool.evaluation.normalised[0])
    runs = len(asked.conditions)
    assert hard.shape == (2, len(DELAY.cruise) * runs), "each speed is linearised for itself"
    assert hard[1].max() == pytest.approx((0.2 - 0.6 / 2.0 * 1.0) / 0.2)


def test_the_speed_stays_with_its_set(everything_costs_nothing):
    asked = request(goals=(DELAY, THRIFT))
    pool = asked.judge({"k_v": np.array([1.0, 2.0, 3.0]), "k1": np.array([0.5, 0.5, 0.5])})
    back = asked.pool(pool.table)
    for one in (pool, back, joined_pools([pool.subset([0]), pool.subset([1, 2])])):
        assert one.evaluation.place[:, 0].tolist() == [0.2, 0.2, 0.2] and np.isnan(one.evaluation.place[:, 1]).all()
    assert replace(asked, goals=(replace(DELAY, cruise=(0.1,)), THRIFT)).digest != asked.digest


def test_a_tuning_names_its_speeds_and_the_worst_one(everything_costs_nothing):
    tuning = tune(request(goals=(CLEAR, DELAY, THRIFT)), trials=32, rounds=1, runs=0)
    rows = {row["name"]: row for row in goal_rows(tuning)}
    assert rows["delay"]["cruise_m_per_s"] == [0.1, 0.2] and rows["delay"]["worst_cruise_m_per_s"] == 0.2
    assert rows["keep clear"]["cruise_m_per_s"] == [] and np.isnan(rows["keep clear"]["worst_cruise_m_per_s"])
    lines = {line.split("  ")[0]: line for line in summary(tuning)}
    assert lines["delay"].endswith("worst at 0.2 m/s") and "m/s" not in lines["keep clear"]
    assert "delay_margin_s at least 0.2 s (hard) at 0.1 and 0.2 m/s" in tuned_gains(tuning).provenance
    assert tuning.accepted and tuning.unmet == () and tuning_dict(tuning)["unmet"] == []
    assert "NOT MET" not in tuned_gains(tuning).provenance


def test_gains_that_miss_a_hard_goal_say_so(everything_costs_nothing, tmp_path):
    hopeless = replace(DELAY, limit=5.0)
    tuning = tune(request(goals=(CLEAR, hopeless, THRIFT)), trials=32, rounds=1, runs=0)
    assert tuning.unmet == ("delay",) and not tuning.accepted and tuning_dict(tuning)["unmet"] == ["delay"]
    found = tuned_gains(tuning)
    assert "HARD GOALS NOT MET: delay;" in found.provenance and "HARD GOALS NOT MET: delay;" in summary(tuning)[-1]
    text = write_gains(found, warning="HARD GOALS NOT MET (a\n b\x7f)")
    assert text.splitlines()[0] == r"# HARD GOALS NOT MET (a\n b\u007f)"
    (tmp_path / "g.toml").write_text(text)
    assert load_gains(str(tmp_path / "g.toml")).values == found.values


WRONG = {
    "none": ("[]", r"goals\.robust\.cruise_m_per_s = \[\]: names no speed"),
    "negative": ("[0.1, -0.1]", r"goals\.robust\.cruise_m_per_s = -0\.1: must be finite and greater than 0"),
    "no number": ("[nan]", r"cruise_m_per_s.* = nan: .*finite"),
    "twice": ("[0.1, 0.1]", r"goals\.robust\.cruise_m_per_s = 0\.1: has a speed twice"),
    "one number": ("0.1", r"cruise_m_per_s = 0\.1: must be a list"),
    "a length": ('["3 m"]', r"cruise_m_per_s = '3 m': wrong unit; give it in m/s"),
}


def _file(path, speeds, metric="disk_margin"):
    path.write_text(
        f'kind = "goals"\nname = "mine"\n[[goals]]\nname = "robust"\nmetric = "{metric}"\n'
        f'at_least = "0.1"\ncruise_m_per_s = {speeds}\n'
    )
    return str(path)


@pytest.mark.parametrize("what", WRONG)
def test_wrong_speeds_of_a_goal_are_told_with_file_and_key(tmp_path, what):
    speeds, told = WRONG[what]
    with pytest.raises(InputError, match=f"mine.toml: .*{told}") as error:
        load_goals(_file(tmp_path / "mine.toml", speeds))
    assert error.value.remedy


def test_speeds_of_a_goals_file_have_units_and_are_of_the_linear_loop(tmp_path):
    [goal] = load_goals(_file(tmp_path / "mine.toml", '[0.2, "5 cm/s"]'))
    assert goal.cruise == (0.05, 0.2) and goal.to_dict()["cruise_m_per_s"] == [0.05, 0.2]
    with pytest.raises(InputError, match=r"cruise_m_per_s: is for goals about the linear loop; leave it out"):
        load_goals(_file(tmp_path / "mine.toml", "[0.2]", metric="reached"))
    own, other, flight = goals_at((DELAY, replace(DELAY, cruise=()), CLEAR), SPEEDS)
    assert (own.cruise, other.cruise, flight.cruise) == ((0.1, 0.2), SPEEDS, ())
    assert goals_at((DELAY, CLEAR), ()) == (DELAY, CLEAR)


@pytest.mark.parametrize(("speed", "told"), [(0.5, "above the cap, 0.22 m/s"), (0.215, None)])
def test_a_goal_above_the_cap_of_what_is_flown_is_a_mistake(speed, told):
    goals, flown = (replace(DELAY, cruise=(0.1, speed)),), request().conditions
    if told is None:
        check_goals(goals, flown)
        return
    for judge in (check_goals, lambda g, f: evaluate(g, f, {"k_v": np.array([1.0])})):
        with pytest.raises(InputError, match=rf"goals\.delay\.cruise_m_per_s = 0.5: is {told}"):
            judge(goals, flown)
    with pytest.raises(InputError, match=told):
        tune(request(goals=goals), trials=1, rounds=1, runs=0)


def test_a_sweep_takes_the_worst_of_its_speeds_and_names_it():
    cases = build_cases([load_scenario("pool-behind")], gains=GAINS)
    points, names = np.array([[1.0, 0.4], [1.5, 0.8]]), ("k_v", "lookahead")
    several, values = MissionSweep(cases, cruise=SPEEDS), dict(zip(names, points.T, strict=True))
    table = dict(zip(several.linear_columns, several.evaluate(0, 0, values).T, strict=True))
    at = {
        u: linear_table(cases[0].vehicle, values, base=GAINS.values, cruise=u, dt=cases[0].build().dt) for u in SPEEDS
    }
    for name, spec in LINEAR_METRICS.items():
        worst = np.max if spec.better == "low" else np.min
        assert table[name] == pytest.approx(worst([at[u][name] for u in SPEEDS], axis=0), rel=1e-12), name
    margins = np.array([at[u]["disk_margin"] for u in SPEEDS])
    assert margins[:, 0].max() - margins[:, 0].min() > 0.01, "the first point depends on the speed"
    assert table["disk_margin_at_m_per_s"][0] == SPEEDS[int(margins[:, 0].argmin())]
    one = MissionSweep(cases, cruise=(cases[0].scenario.cruise,)).evaluate(0, 0, values)
    assert one[:, :-1].tolist() == MissionSweep(cases).evaluate(0, 0, values).tolist()


def test_speeds_of_a_sweep_are_checked_before_it_flies():
    cases = build_cases([load_scenario("pool-behind")], gains=GAINS)
    knobs = grid([parse_axis("k_v=1,2")])
    check_request(cases, knobs, (0,), SPEEDS)
    for speeds, told in (((0.1, 0.3), "--cruise = 0.3: is above the cap"), ((-1.0,), "--cruise = -1.0: must be")):
        with pytest.raises(InputError, match=told):
            check_request(cases, knobs, (0,), speeds)
    with pytest.raises(InputError, match="is an axis already"):
        check_request(cases, grid([parse_axis("scenario.cruise=0.1,0.2")]), (0,), SPEEDS)
