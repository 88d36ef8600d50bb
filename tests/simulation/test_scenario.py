"""Scenario files: what was read, and every mistake a file can hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.simulation import LIBRARY, Scenario, build_world, findings, load_scenario
from surctl.vehicle import load_vehicle

NAMES = ("pool-behind", "pool-static", "tank-speed-015", "tank-static")
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


# --- the four that come with the toolkit --------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_built_in_scenarios_load_and_name_a_vehicle_that_fits(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario.provenance
    for seed in range(10):
        build_world(scenario, load_vehicle(scenario.vehicle), seed=seed)


def test_the_numbers_of_the_paper() -> None:
    tank, pool, behind, speed = (
        load_scenario(n) for n in ("tank-static", "pool-static", "pool-behind", "tank-speed-015")
    )
    assert [o.centre_m for o in tank.obstacles] == [(2.5, 1.2), (4.0, 3.8), (6.0, 1.2), (8.0, 2.5)]
    assert {o.size_m for o in tank.obstacles} == {(0.3, 1.6)}
    assert [o.centre_m for o in pool.obstacles] == [(0.6, 0.35), (1.2, 0.7), (1.2, 1.5), (2.0, 1.0)]
    assert {(o.radius_m, o.drift_m) for o in pool.obstacles} == {(0.05, 0.05)}
    np.testing.assert_array_equal(pool.path.waypoints, [[0.25, 0.25], [2.75, 1.0]])
    np.testing.assert_array_equal(behind.path.waypoints, [[1.0, 0.8], [2.75, 1.75]])
    np.testing.assert_array_equal(speed.path.waypoints, [[0.5, 2.5], [9.5, 2.5]])
    (chaser,) = behind.obstacles
    assert (chaser.centre_m, chaser.to_m, chaser.speed_m_per_s, chaser.removed) == (
        (0.25, 0.25),
        (2.75, 1.75),
        0.2,
        True,
    )
    (head_on,) = speed.obstacles
    assert (head_on.centre_m, head_on.to_m, head_on.speed_m_per_s) == ((9.5, 2.5), (0.5, 2.5), 0.15)
    assert [s.site for s in (tank, pool)] == [(10, 5, 5), (3, 2, 1)]
    assert {s.depth for s in (tank, pool, behind, speed)} == {-0.15}
    assert {s.reach for s in (tank, pool, behind, speed)} == {0.10}
    assert [(s.cruise, s.cap) for s in (tank, pool, behind, speed)] == [
        (0.2, 0.22),
        (0.15, 0.22),
        (0.15, 0.22),
        (0.22, 0.22),
    ]
    assert [s.vehicle for s in (tank, pool, behind, speed)] == ["sur540-flooded", "sur400", "sur400", "sur540-flooded"]
    assert (pool.paper.time_s, speed.paper.time_s) == (20.0, 44.5)


def test_walls_enclose_the_site() -> None:
    scenario = load_scenario("pool-static")
    distances = sorted(wall.nearest([1.0, 0.5])[0] for wall in scenario.walls)
    assert distances == pytest.approx([0.5, 1.0, 1.5, 2.0])


# --- mistakes -----------------------------------------------------------------------------------------------------

MISTAKES = {
    "one point": (_edited(PATH, "path_m = [[0.25, 0.25]]"), "path_m", "2 to 8 points"),
    "nine points": (_edited(PATH, f"path_m = {[[0.1 + 0.1 * k, 0.5] for k in range(9)]}"), "path_m", "2 to 8 points"),
    "equal points": (_edited(PATH, "path_m = [[0.25, 0.25], [0.25, 0.25]]"), "path_m", "two equal points"),
    "three coordinates": (_edited(PATH, "path_m = [[0.25, 0.25, 0.0], [1.0, 1.0, 0.0]]"), "path_m.0", "3"),
    "nan in the path": (_edited(PATH, "path_m = [[0.25, 0.25], [2.75, nan]]"), "path_m.1.1", "nan"),
    "target outside": (_edited(PATH, "path_m = [[0.25, 0.25], [3.75, 1.0]]"), "path_m = [3.75", "outside the site"),
    "obstacle outside": (
        _edited("centre_m = [0.6, 0.35]", "centre_m = [-0.6, 0.35]"),
        "obstacles.Obstacle1.centre_m",
        "outside the site",
    ),
    "above the water": (_edited("depth_m = -0.15", "depth_m = 0.15"), "depth_m", "is not in the water; z is up"),
    "at the surface": (_edited("depth_m = -0.15", "depth_m = 0.0"), "depth_m", "is not in the water"),
    "in the floor": (_edited("depth_m = -0.15", "depth_m = -1.5"), "depth_m", "is not in the water"),
    "cruise above cap": (
        _edited("cruise_m_per_s = 0.15", "cruise_m_per_s = 0.25"),
        "cruise_m_per_s",
        "above cap_m_per_s = 0.22",
    ),
    "no cruise": (_edited("cruise_m_per_s = 0.15", "cruise_m_per_s = 0"), "cruise_m_per_s", "greater than 0"),
    "two of one name": (_edited("Obstacle2", "Obstacle1"), "obstacles.name", "two obstacles have one name"),
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
    assert any("out of the water" in f.text for f in small)  # E16
