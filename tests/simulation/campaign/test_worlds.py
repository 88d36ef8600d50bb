"""Random worlds: seeded, feasible, half of them moving, and all flown by one compiled loop."""

from dataclasses import replace
from functools import cache
from itertools import combinations
from math import hypot

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.simulation import Case, findings
from surctl.marine.simulation.batch.engines import structure_of
from surctl.marine.simulation.campaign.worlds import RandomWorlds, random_world, world_template
from surctl.marine.simulation.scenario import scenario_table
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import load_vehicle

VEHICLE, GAINS = load_vehicle("sur540-flooded"), load_gains("default")


@cache
def drawn(seed):
    return random_world(VEHICLE, seed=seed)


@cache
def many():
    return [drawn(seed) for seed in range(16)]


def worlds(sensing="truth", *, law="guarded", seconds=None, plant=False, first=0):
    template = world_template(VEHICLE)
    if seconds is not None:
        template = replace(template, time_limit=seconds)
    case = Case(template, VEHICLE, GAINS, law, sensing=sensing)
    return RandomWorlds(case, first, plant)


def test_a_seed_is_a_world():
    assert scenario_table(random_world(VEHICLE, seed=7)) == scenario_table(many()[7])
    assert len({str(scenario_table(world)["obstacles"]) for world in many()}) == len(many())
    assert scenario_table(worlds(first=5).world(2)) == scenario_table(many()[7])


def test_one_to_eight_obstacles_half_of_them_moving():
    counts = [len(world.obstacles) for world in many()]
    assert set(counts) == set(range(1, 9))
    for world in many():
        movers = sum(not o.still for o in world.obstacles)
        assert abs(2 * movers - len(world.obstacles)) <= 1
    template = {o.name for o in world_template(VEHICLE).obstacles}
    assert {o.name for world in many() for o in world.obstacles} == template and len(template) == 8


@pytest.mark.parametrize("seed", range(8))
def test_each_can_be_flown(seed):
    world = drawn(seed)
    assert not [f for f in findings(world, VEHICLE) if f.level == "error"]
    still = [o for o in world.obstacles if o.still]
    for o in world.obstacles:
        if o.still:
            continue
        away = VEHICLE["radius"] + o.radius_m + 1.0
        assert 0 < o.speed_m_per_s <= 0.15
        assert hypot(*(world.start - o.centre_m)) >= away and hypot(*(world.target - o.to_m)) >= away
        for x, y in np.linspace(o.centre_m, o.to_m, 37).tolist():
            assert all(other.distance((x, y)) > o.radius_m - 1e-2 for other in still)


def test_a_hull_fits_between_two_that_move():
    apart = []
    for world in many():
        for a, b in combinations([o for o in world.obstacles if not o.still], 2):
            bodies = [build_world(replace(world, obstacles=(o,)), VEHICLE, seed=0) for o in (a, b)]
            for time in np.arange(0.0, world.time_limit, 4.0):
                one, two = (made.bodies(time) for made in bodies)
                if one and two:
                    apart.append(
                        hypot(*np.subtract(one[0].shape.center, two[0].shape.center)) - a.radius_m - b.radius_m
                    )
    assert 2 * VEHICLE["radius"] + 0.1 - 1e-9 <= min(apart) < 1.0


def test_waves_are_refused():
    case = worlds().case
    wavy = case.scenario.disturbance.model_copy(update={"wave_force_n": 0.5})
    with pytest.raises(InputError, match="no waves"):
        RandomWorlds(replace(case, scenario=replace(case.scenario, disturbance=wavy)))


def test_all_worlds_share_one_structure():
    given = worlds("sonar")
    one = structure_of(given.case, given.values(0, 1))
    assert one == structure_of(given.case, given.values(3, 9)) and one.optional and len(one.bodies) == 8
