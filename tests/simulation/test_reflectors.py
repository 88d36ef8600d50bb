"""Reflectors in a scenario: the keys of its file, the echo models, and the same echoes in every loop."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.files import read_toml
from surctl.marine.cli.sensor_options import sensor_data
from surctl.marine.control import load_gains
from surctl.marine.sensing import REFLECTORS, Reflector
from surctl.marine.simulation import ECHOES, LIBRARY, Case, Scenario, findings, load_scenario, simulate, simulate_batch
from surctl.marine.simulation.scenario import scenario_from_table, scenario_table
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import load_vehicle
from surctl.marine.world import Disc
from tests.oracles.mission_loop import WeakEchoes
from tests.tools import need_compiler

POOL = read_toml(LIBRARY / "pool-static.toml")


def pool(*, sonar: dict | None = None, site: dict | None = None, obstacle: str | None = None, **tables) -> Scenario:
    table = {**POOL, "site": POOL["site"] | (site or {}), "sonar": sonar or {}, **tables}
    if obstacle:
        first, *others = POOL["obstacles"]
        table["obstacles"] = [first | {"reflector": obstacle}, *others]
    return scenario_from_table(table, source="pool.toml")


def test_a_reflector_of_its_own_outranks_the_echo_model() -> None:
    plain = pool()
    assert plain.surfaces is None and pool(sonar={"echoes": "webots"}).surfaces is None
    cloth = {"cloth": {"incidence_limit_deg": 30, "cylinder_range_m": 1.0}}
    mixed = pool(
        sonar={"echoes": "diffuse", "pitch_deg": -10.0},
        site={"walls": {"x1": "specular"}, "surface": "silent"},
        obstacle="cloth",
        reflectors=cloth,
    )
    surfaces = mixed.surfaces
    assert surfaces is not None and surfaces.weak and surfaces.depth == 1.0
    assert surfaces.obstacles == (Reflector(np.pi / 6, 0.0, 1.0), *(REFLECTORS["diffuse"],) * 3)
    assert surfaces.walls == tuple(REFLECTORS[n] for n in ("diffuse", "specular", "diffuse", "diffuse"))
    assert (surfaces.surface, surfaces.floor) == (REFLECTORS["silent"], REFLECTORS["diffuse"])
    assert scenario_from_table(scenario_table(mixed), source="").surfaces == surfaces
    recorded = sensor_data(mixed)
    assert recorded["echoes"] == "diffuse" and recorded["pitch_deg"] == pytest.approx(-10.0)
    assert recorded["reflectors"]["obstacles"] == {"Obstacle1": "cloth"} and sensor_data(plain)["reflectors"] == {}
    assert recorded["reflectors"]["site"] == {"walls": {"x1": "specular"}, "surface": "silent"}
    assert recorded["reflectors"]["reflectors"]["cloth"]["incidence_limit_deg"] == 30.0
    ideal = replace(mixed, sensors=mixed.sensors.hearing("ideal"))
    assert ideal.surfaces is not None and ideal.surfaces.floor == REFLECTORS["silent"]
    assert ideal.surfaces.obstacles == (surfaces.obstacles[0], *(REFLECTORS["ideal"],) * 3)


def test_echo_models_are_known_by_their_names() -> None:
    sensors = load_scenario("pool-static").sensors
    for name in ECHOES:
        assert sensors.hearing(name).echo_model == name
        assert sensors.hearing("diffuse").hearing(name) == sensors.hearing(name)
    array = replace(sensors.equipment.array, incidence_limit=0.5)
    assert replace(sensors, equipment=replace(sensors.equipment, array=array)).echo_model == "within 28.65 deg"


@pytest.mark.parametrize(
    ("changed", "key"),
    [
        ({"obstacle": "spectral"}, "obstacles.Obstacle1.reflector"),
        ({"site": {"floor": "mud"}}, "site.floor"),
        ({"site": {"walls": {"y0": "tiles"}}}, "site.walls.y0"),
        ({"sonar": {"pitch_deg": 40.0}}, "sonar.pitch_deg"),
        ({"sonar": {"echoes": "diffuse", "incidence_limit_deg": 30.0}}, "sonar.echoes"),
    ],
)
def test_mistakes_name_their_key(changed: dict, key: str) -> None:
    with pytest.raises(InputError) as error:
        pool(**changed)
    assert error.value.key == key and error.value.file == "pool.toml"


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"site": {"walls": {"x2": "webots"}}}, "site.walls.x2: unknown key; did you mean"),
        ({"site": {"walls": 3}}, "site.walls = 3: must be a text or a table; write"),
        ({"site": {"walls": ["webots"]}}, "site.walls = ['webots']: must be a text or a table; write"),
        ({"site": {"walls": "mirror"}}, "site.walls = 'mirror': is not a known reflector; known: diffuse, ideal,"),
        ({"obstacle": "mirror"}, ", webots, or define [reflectors.mirror]"),
        ({"site": {"floor": "a b"}}, ', webots, or define [reflectors."a b"]'),
        ({"reflectors": {"webots": {}}}, "reflectors.webots: is the name of a built-in reflector; choose another name"),
    ],
)
def test_mistakes_and_remedies_are_written_as_in_a_file(changed: dict, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        pool(**changed)


def test_a_reflector_without_a_name_has_no_table() -> None:
    with pytest.raises(InputError, match=r"site.surface = '': is not a known reflector; known: [a-z, -]+, webots$"):
        pool(site={"surface": ""})


def test_lint_says_what_is_unhearable() -> None:
    boat = load_vehicle("sur400")
    level = {"echoes": "diffuse", "pitch_deg": 0.0, "floor_m": 0.0}
    texts = {f.key: f.text for f in findings(pool(sonar=level), boat)}
    assert "echoes of the water surface" in texts["site.surface"] and "hears it at 0.25 m" in texts["site.surface"]
    assert "below -17.5" in texts["site.surface"]
    assert "echoes of the floor" in texts["site.floor"] and "hears it at 1.40 m" in texts["site.floor"]
    tilted = {f.key for f in findings(pool(sonar={"echoes": "diffuse"}), boat)}
    assert not {"site.surface", "site.floor"} & tilted
    smooth = [f for f in findings(pool(sonar={"echoes": "specular"}), boat) if f.key == "sonar.echoes"]
    assert [f.level for f in smooth] == ["warning", "info"]
    assert "within 5° of their normal" in smooth[0].text and "Obstacle1 2.5 m" in smooth[1].text
    one = [f.text for f in findings(pool(obstacle="specular"), boat) if f.key == "reflector"]
    assert "Obstacle1 2.5 m" in one[-1] and "Obstacle2" not in one[-1]


def test_an_obstacle_keeps_its_random_numbers_without_the_others() -> None:
    scenario = pool(obstacle="cloth", reflectors={"cloth": {"cylinder_range_m": 1.0}})
    alone = replace(scenario, obstacles=scenario.obstacles[:1])
    last = replace(scenario, obstacles=(scenario.obstacles[2], scenario.obstacles[0]))
    found, state = [], np.array([1.6, 0.35, -0.15, np.pi])
    for seen in (alone, last):
        world = build_world(seen, load_vehicle("sur400"), seed=0)
        echoes = WeakEchoes(world, seen.sensors.array_on(world.hull), seed=3)
        bodies = [body for body in world.bodies(0.0) if body.name == "Obstacle1"]
        still = [replace(bodies[0], shape=Disc((0.6, 0.35), 0.05))]  # where the drift is drawn by place in the list
        found.append([echoes.nearest(0, state, still, instant=k) for k in range(40)])
    assert found[0] == found[1] and len(set(found[0])) == 2


def test_weak_echoes_are_those_of_the_seed_in_every_physics() -> None:
    # the loop adds them to what a physics measures, so they are the same bytes for any plant at the same place
    scenario = pool(obstacle="cloth", reflectors={"cloth": {"cylinder_range_m": 1.0}})
    world = build_world(scenario, load_vehicle("sur400"), seed=0)
    array = scenario.sensors.array_on(world.hull)
    bodies, state = world.bodies(0.0), np.array([1.6, 0.35, -0.15, np.pi])
    one, again, other = (WeakEchoes(world, array, seed=seed) for seed in (3, 3, 4))

    def heard(echoes: WeakEchoes, instants: range) -> dict[tuple[int, int], float]:
        return {(k, s): echoes.nearest(s, state, bodies, instant=k) for k in instants for s in range(array.size)}

    found = heard(one, range(60))
    assert found == heard(again, range(59, -1, -1)) and found != heard(other, range(60))
    assert 10 < sum(map(np.isfinite, found.values())) < 50


def test_both_loops_hear_reflectors_alike_for_any_threads_and_order() -> None:
    need_compiler()
    cloth = {"cloth": {"cylinder_range_m": 0.15}}  # some firings detect it
    scenario = replace(pool(obstacle="cloth", reflectors=cloth), time_limit=2.0)
    case = Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"), sensing="sonar", law="paper")
    run = simulate(scenario, case.vehicle, gains=case.gains, law=case.build(), sensing="sonar", seed=5)
    seeds = np.array([5, 6])
    table = simulate_batch(case, seeds=seeds).table
    np.testing.assert_allclose(table[0], run.metrics.row(), rtol=0, atol=1e-9)
    assert not np.allclose(table[0], table[1], atol=1e-6, equal_nan=True)
    turned = simulate_batch(case, seeds=seeds[::-1], threads=2).table[::-1]
    assert turned.tobytes() == table.tobytes()
