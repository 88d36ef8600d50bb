"""Scenario files: what was read, and every mistake a file can hold."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.simulation import LIBRARY, Obstacle, Scenario, findings, load_scenario
from surctl.marine.simulation.scenario import scenario_table
from surctl.marine.simulation.toml_text import toml_text
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import load_vehicle

GOLDEN = tomllib.loads((Path(__file__).parents[1] / "golden" / "scenarios.toml").read_text(encoding="utf-8"))
NAMES = tuple(sorted(GOLDEN))
TEXT = (LIBRARY / "pool-static.toml").read_text(encoding="utf-8")
PATH = "path_m = [[0.25, 0.25], [2.75, 1.0]]"
FIRST = "centre_m = [0.6, 0.35]\nradius_m = 0.05"


def _load(folder: Path, text: str) -> Scenario:
    path = folder / "own.toml"
    path.write_text(text, encoding="utf-8")
    return load_scenario(str(path))


def _edited(old: str, new: str) -> str:
    assert old in TEXT
    return TEXT.replace(old, new, 1)


# --- those that come with the toolkit -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_built_in_scenarios_load_and_name_a_vehicle_that_fits(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario.provenance
    for seed in range(10):
        build_world(scenario, load_vehicle(scenario.vehicle), seed=seed)


def test_every_scenario_of_the_paper_is_there_and_no_other() -> None:
    assert {path.stem for path in LIBRARY.glob("*.toml")} == set(NAMES)
    assert len(NAMES) == 14


@pytest.mark.parametrize("name", NAMES)
def test_the_numbers_of_the_paper(name: str) -> None:
    scenario, wanted = load_scenario(name), GOLDEN[name]
    assert scenario.vehicle == wanted["vehicle"]
    assert list(scenario.site) == wanted["site"]
    np.testing.assert_array_equal(scenario.path.waypoints, wanted["path"])
    assert [scenario.cruise, scenario.cap] == wanted["speeds"]
    assert (scenario.depth, scenario.arrival_radius) == (-0.15, 0.10)
    here: dict[str, list[Obstacle]] = {shape: [] for shape in ("box", "cylinder", "moving")}
    for obstacle in scenario.obstacles:
        here[obstacle.shape].append(obstacle)
    assert [list(o.centre_m) for o in here["box"]] == wanted.get("boxes", [])
    assert all(o.size_m == (0.3, 1.6) and o.drift_m == 0 for o in here["box"])
    assert [list(o.centre_m) for o in here["cylinder"]] == wanted.get("cylinders", [])
    assert all((o.radius_m, o.drift_m) == (0.05, 0.05) for o in here["cylinder"])
    ways = [[*o.centre_m, *(o.to_m or ()), o.speed_m_per_s] for o in here["moving"]]
    assert ways == wanted.get("movers", [])
    assert all(o.removed and o.radius_m is None for o in here["moving"])  # of the robot's own size


@pytest.mark.parametrize("name", NAMES)
def test_what_the_paper_reports(name: str) -> None:
    figure, wanted = load_scenario(name).paper, dict(GOLDEN[name]["paper"])
    given = figure.model_dump(exclude={"result"}, exclude_none=True)
    kinds = {"time_kind": "about", "time_of": "run"} | {
        k: v for k, v in wanted.items() if k in ("time_kind", "time_of")
    }
    assert {"time_kind": given.pop("time_kind"), "time_of": given.pop("time_of")} == kinds
    simulated = name.startswith("tank")  # about 4 cm in simulation, less than 8 cm in the pool, stated of them all
    assert given.pop("position_error_kind") == ("about" if simulated else "less than")
    assert given.pop("position_error_of") == "series"
    given["transients_s"] = list(given["transients_s"])
    assert given == {"transients_s": []} | {k: v for k, v in wanted.items() if k not in kinds}


@pytest.mark.parametrize("name", NAMES)
def test_the_pool_has_waves_drift_and_inexact_thrust_and_the_tank_is_calm(name: str) -> None:
    scenario = load_scenario(name)
    d = scenario.disturbance
    numbers = (d.wave_force_n, d.drift_force_n, d.thrust_error, d.thrust_bias)
    assert numbers == ((0.3, 0.1, 0.05, 0.01) if name.startswith("pool") else (0, 0, 0, 0))
    assert scenario.seeded == name.startswith("pool")
    # what pushes is small beside what the thrusters give
    assert sum(numbers[:2]) < 0.1 * load_vehicle(scenario.vehicle)["Fu_max"]


def test_walls_enclose_the_site() -> None:
    scenario = load_scenario("pool-static")
    distances = sorted(wall.nearest([1.0, 0.5])[0] for wall in scenario.walls)
    assert distances == pytest.approx([0.5, 1.0, 1.5, 2.0])


# --- mistakes -----------------------------------------------------------------------------------------------------

MISTAKES = {
    "one point": (_edited(PATH, "path_m = [[0.25, 0.25]]"), "path_m", "at least 2 points"),
    "equal points": (_edited(PATH, "path_m = [[0.25, 0.25], [0.25, 0.25]]"), "path_m", "two equal points"),
    "three coordinates": (_edited(PATH, "path_m = [[0.25, 0.25, 0.0], [1.0, 1.0, 0.0]]"), "path_m.0", "3"),
    "nan in the path": (_edited(PATH, "path_m = [[0.25, 0.25], [2.75, nan]]"), "path_m.1.1", "nan"),
    "target outside": (_edited(PATH, "path_m = [[0.25, 0.25], [3.75, 1.0]]"), "path_m = [3.75", "outside the site"),
    "obstacle outside": (
        _edited("centre_m = [0.6, 0.35]", "centre_m = [-0.6, 0.35]"),
        "obstacles.Obstacle1.centre_m",
        "outside the site",
    ),
    "above the water": (_edited("depth_m = -0.15", "depth_m = 0.15"), "depth_m", "is not in the water; z points up"),
    "at the surface": (_edited("depth_m = -0.15", "depth_m = 0.0"), "depth_m", "is not in the water"),
    "in the floor": (_edited("depth_m = -0.15", "depth_m = -1.5"), "depth_m", "is not in the water"),
    "cruise above cap": (
        _edited("cruise_m_per_s = 0.15", "cruise_m_per_s = 0.25"),
        "cruise_m_per_s",
        "above cap_m_per_s = 0.22",
    ),
    "no cruise": (_edited("cruise_m_per_s = 0.15", "cruise_m_per_s = 0"), "cruise_m_per_s", "greater than 0"),
    "two of one name": (_edited("Obstacle2", "Obstacle1"), "obstacles.name", "is the name of two obstacles"),
    "no radius": (_edited(FIRST, "centre_m = [0.6, 0.35]"), "obstacles.0", "a cylinder needs radius_m"),
    "negative radius": (_edited(FIRST, FIRST.replace("0.05", "-0.05")), "obstacles.0.radius_m", "greater than 0"),
    "box without size": (_edited('shape = "cylinder"', 'shape = "box"'), "obstacles.0", "a box needs size_m"),
    "mover without goal": (_edited('shape = "cylinder"', 'shape = "moving"'), "obstacles.0", "to_m and speed_m_per_s"),
    "unknown shape": (_edited('shape = "cylinder"', 'shape = "cone"'), "obstacles.0.shape", "'cylinder'"),
    "typo in obstacle": (_edited("radius_m", "raduis_m"), "obstacles.0.raduis_m", "did you mean 'radius_m'?"),
    "typo at the top": (_edited("cruise_m_per_s", "cruise_mps"), "cruise_mps", "did you mean 'cruise_m_per_s'?"),
    "typo below": (_edited("wave_force_n", "wave_force"), "disturbance.wave_force", "did you mean 'wave_force_n'?"),
    "no site": (_edited("length_m = 3.0\n", ""), "site.length_m", "is missing"),
    "negative drift": (_edited("drift_m = 0.05", "drift_m = -0.05"), "obstacles.0.drift_m", "0"),
    "target in a cylinder": (
        _edited("centre_m = [2.0, 1.0]", "centre_m = [2.72, 0.98]"),
        "path_m = [2.75, 1.0]",
        "the target lies inside obstacle 'Obstacle4'",
    ),
    "overlap": (
        _edited("centre_m = [1.2, 0.7]", "centre_m = [0.65, 0.41]"),
        "obstacles.Obstacle2.centre_m = [0.65, 0.41]",
        "overlaps obstacle 'Obstacle1' by",
    ),
    "ends the wrong way round": (
        _edited(FIRST, FIRST + "\nbottom_m = -0.2\ntop_m = -0.3"),
        "obstacles.0",
        "bottom_m is not below top_m; write z of both ends",
    ),
    "depths without the path's": (
        _edited("depth_m = -0.15", "depth_m = -0.15\ndepths_m = [-0.9, -0.3]"),
        "depths_m = [-0.9, -0.3]",
        "must be a depth below and a depth above the path's depth of -0.15",
    ),
    "depths out of the water": (
        _edited("depth_m = -0.15", "depth_m = -0.15\ndepths_m = [-0.9, 0.1]"),
        "depths_m",
        "write [lowest, highest] between -1 and 0",
    ),
    "obstacle of negative speed": (
        _edited('shape = "cylinder"', 'shape = "moving"\nto_m = [1.0, 1.0]\nspeed_m_per_s = -0.1'),
        "obstacles.0.speed_m_per_s",
        "greater than 0",
    ),
    "thrust off by all of it": (
        _edited("thrust_error = 0.05", "thrust_error = 1.0"),
        "disturbance.thrust_error",
        "less than 1",
    ),
    "a kind of no time": (_edited("time_s = 20.0\n", ""), "paper", "time_kind describes time_s"),
    "time of no kind": (_edited('time_kind = "about"', 'time_kind = "at most"'), "paper.time_kind", "'less than'"),
    "no time": (_edited("time_limit_s = 90.0", "time_limit_s = 0.0"), "time_limit_s", "greater than 0"),
    "another kind": (_edited('kind = "scenario"', 'kind = "vehicle"'), "kind", "'scenario'"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_a_file_is_one_line_with_file_key_and_remedy(tmp_path: Path, mistake: str) -> None:
    text, key, fragment = MISTAKES[mistake]
    with pytest.raises(InputError) as caught:
        _load(tmp_path, text)
    shown = str(caught.value)
    assert shown.startswith(f"{tmp_path / 'own.toml'}: {key}")
    assert fragment in shown
    assert caught.value.remedy
    assert "\n" not in shown


@pytest.mark.parametrize("content", [b"", b"\x7fELF\x00\xff"], ids=["empty", "binary"])
def test_a_file_that_is_no_scenario(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "own.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"own\.toml: is "):
        load_scenario(str(path))
    with pytest.raises(InputError, match="cannot be read"):
        load_scenario(str(tmp_path))
    with pytest.raises(InputError, match="did you mean 'pool-static'"):
        load_scenario("pool-statik")


def test_an_obstacle_with_a_quote_in_its_name_stays_one_line(tmp_path: Path) -> None:
    text = _edited('name = "Obstacle1"', r'name = "a\"b\nc"').replace("centre_m = [0.6, 0.35]", "centre_m = [9, 9]")
    with pytest.raises(InputError) as caught:
        _load(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_a_start_inside_an_obstacle_depends_on_the_vehicle(tmp_path: Path) -> None:
    """sur400 fits 0.06 m away from the first cylinder; the larger hull does not."""
    text = _edited(FIRST + "\ndrift_m = 0.05", FIRST.replace("[0.6, 0.35]", "[0.56, 0.25]"))
    scenario = _load(tmp_path, text)
    build_world(scenario, load_vehicle("sur400"), seed=0)
    with pytest.raises(InputError) as caught:
        build_world(scenario, load_vehicle("sur540-flooded"), seed=0)
    shown = str(caught.value)
    assert shown.startswith(f"{tmp_path / 'own.toml'}: path_m = [0.25, 0.25]: the 0.27 m hull of sur540-flooded starts")
    assert "inside obstacle 'Obstacle1'" in shown
    assert "smaller vehicle" in shown
    assert "\n" not in shown


def test_findings_before_flight() -> None:
    pool = load_scenario("pool-static")
    large = findings(pool, load_vehicle("sur540-flooded"))
    assert [f.level for f in large] == sorted([f.level for f in large])  # errors first
    assert any(f.level == "error" and "0.020 m inside a wall at the start" in f.text for f in large)  # E15
    small = findings(pool, load_vehicle("sur400"))
    assert not [f for f in small if f.level == "error"]
    assert any("above the water surface" in f.text for f in small)  # E16


def test_what_ends_above_or_below_shares_no_water(tmp_path: Path) -> None:
    """One obstacle over the other, and one under the target: nothing overlaps where the heights do not."""
    over = _edited("centre_m = [1.2, 0.7]", "centre_m = [0.65, 0.41]\nbottom_m = -0.4")
    under = over.replace(FIRST, FIRST + "\ntop_m = -0.4")
    assert under != over
    first, second, *_ = _load(tmp_path, under).obstacles
    assert first.heights.top == second.heights.bottom == -0.4 and first.distance(second.centre_m) < second.radius_m
    with pytest.raises(InputError, match="overlaps obstacle"):
        _load(tmp_path, over)
    below = _edited("centre_m = [2.0, 1.0]", "centre_m = [2.72, 0.98]\ntop_m = -0.5")
    assert _load(tmp_path, below).obstacles[3].heights.crosses(-0.5, 1e-9)


def test_a_scenario_of_one_s_own_needs_nothing_of_the_paper(tmp_path: Path) -> None:
    own, table, _ = TEXT.partition("[paper]")
    assert table
    scenario = _load(tmp_path, own)
    assert scenario.paper.result == ""
    again = toml_text(scenario_table(scenario))
    assert _load(tmp_path, again).paper == scenario.paper
