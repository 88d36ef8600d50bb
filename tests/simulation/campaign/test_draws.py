"""What a campaign draws, and that the batch flies what the reference loop is given."""

from dataclasses import replace

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.simulation import METRICS, Case, load_scenario, simulate_batch
from surctl.marine.simulation.campaign.worlds import MonteCarlo, draw_plant
from surctl.marine.simulation.scenario import Uncertainty, scenario_from_table, scenario_table
from surctl.marine.vehicle import load_vehicle

VEHICLE, GAINS = load_vehicle("sur540-flooded"), load_gains("default")


def plan(name, *, first=0, seconds=None, uncertainty=None, **more):
    scenario = load_scenario(name)
    scenario = replace(scenario, uncertainty=uncertainty or Uncertainty())
    scenario = scenario if seconds is None else replace(scenario, time_limit=seconds)
    return MonteCarlo(Case(scenario, load_vehicle(scenario.vehicle), GAINS, **more), first)


def test_a_plant_is_drawn_evenly_within_the_stated_ranges():
    drawn = [draw_plant(VEHICLE, seed=seed) for seed in range(400)]
    ranges = {name: p.range for name, p in VEHICLE.parameters.items() if p.range is not None}
    assert set(drawn[0]) == set(ranges)
    for name, (low, high) in ranges.items():
        values = np.array([one[name] for one in drawn])
        assert low <= values.min() < low + 0.02 * (high - low) and high - 0.02 * (high - low) < values.max() <= high
        assert np.mean(values) == pytest.approx((low + high) / 2, abs=0.05 * (high - low))


@pytest.mark.parametrize("name", ["tank-moving", "pool-static"])
def test_sizes_and_speeds_fill_their_ranges_and_no_more(name):
    drawn = plan(name, uncertainty=Uncertainty(obstacle_size=0.2, obstacle_speed=0.4))
    values, obstacles = drawn.values(0, 300), {o.name: o for o in drawn.case.scenario.obstacles}
    assert set(values) == set(drawn.names)
    for o in obstacles.values():
        size = values[f"obstacle.{o.name}.size_x"] / o.size_m[0] if o.size_m else values[f"obstacle.{o.name}.radius"]
        nominal = 1.0 if o.size_m else o.radius_m or drawn.case.vehicle["radius"]
        assert 0.8 <= np.min(size / nominal) < 0.81 and 1.19 < np.max(size / nominal) <= 1.2
        if o.speed_m_per_s:
            speed = values[f"obstacle.{o.name}.speed"] / o.speed_m_per_s
            assert 0.6 <= speed.min() < 0.62 and 1.38 < speed.max() <= 1.4
            assert abs(np.corrcoef(size, speed)[0, 1]) < 0.2


def test_a_run_does_not_depend_on_where_it_is_cut():
    whole, part = plan("tank-moving").values(0, 30), plan("tank-moving", first=11).values(2, 5)
    assert all(np.array_equal(whole[name][13:18], part[name]) for name in whole)
    assert plan("tank-moving", first=11).seeds(2, 5).tolist() == [13, 14, 15, 16, 17]


def test_nothing_is_drawn_of_what_is_certain():
    sure = Uncertainty(vehicle=False, obstacle_size=0.0, obstacle_speed=0.0)
    drawn = plan("tank-moving", uncertainty=sure)
    assert drawn.run(5).draw == {} and drawn.run(5).case.scenario == drawn.case.scenario


@pytest.mark.parametrize(("name", "k", "seconds"), [("tank-moving", 3, 20.0)])
def test_the_batch_flies_what_the_reference_loop_is_given(name, k, seconds):
    """By sonar: `test_worlds`."""
    drawn = plan(name, seconds=seconds, law="closed_form")
    found = simulate_batch(drawn.case, drawn.values(k, 1), seeds=drawn.seeds(k, 1)).table[0]
    wanted = np.array(drawn.run(k).simulate().metrics.row())
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)
    nominal = simulate_batch(drawn.case, seeds=drawn.seeds(k, 1)).table[0]
    which = list(METRICS).index("length_m")
    assert abs(found[which] - nominal[which]) > 1e-4  # a draw matters


def test_obstacles_that_may_cover_the_start_are_refused():
    scenario = load_scenario("tank-static")
    near = scenario.obstacles[0].model_copy(update={"centre_m": (1.0, 2.5), "size_m": (0.4, 0.4)})
    case = Case(replace(scenario, obstacles=(near,)), VEHICLE, GAINS)
    MonteCarlo(case)
    wild = replace(case.scenario, uncertainty=Uncertainty(obstacle_size=0.5))
    with pytest.raises(InputError, match=r"uncertainty.obstacle_size = 0.5: .*inside obstacle 'OS1'; lower it"):
        MonteCarlo(replace(case, scenario=wild))


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"obstacle_size": 1.0}, "uncertainty.obstacle_size = 1.0"),
        ({"obstacle_speed": -0.1}, "uncertainty.obstacle_speed = -0.1"),
        ({"obstacle_sizes": 0.1}, "did you mean 'obstacle_size'"),
        ({"vehicle": "often"}, "uncertainty.vehicle"),
    ],
)
def test_a_wrong_table_is_told(table, words):
    whole = scenario_table(load_scenario("tank-static")) | {"uncertainty": table}
    with pytest.raises(InputError, match=words):
        scenario_from_table(whole, source="x.toml")
