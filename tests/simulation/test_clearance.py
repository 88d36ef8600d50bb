"""What a hull has no room, thrust or time for, found before it is flown."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from surctl.marine.control import load_gains
from surctl.marine.guidance import Path
from surctl.marine.simulation import LIBRARY, Disturbance, Obstacle, Scenario, findings, load_scenario
from surctl.marine.simulation.clearance import layers, tightest_gap
from surctl.marine.vehicle import load_vehicle

TANK, POOL = load_scenario("tank-static"), load_scenario("pool-static")
HULL = load_vehicle("sur540-flooded")


def _found(scenario: Scenario, vehicle: str = "sur540-flooded") -> dict[tuple[str, str], str]:
    every = findings(scenario, load_vehicle(vehicle))
    return {(f.level, f.key): f.text for f in every if f.key != "depth_m"}


def _box(name: str, x: float, low: float, high: float, *, drift: float = 0.0) -> Obstacle:
    size = (0.3, high - low)
    return Obstacle(name=name, shape="box", centre_m=(x, (low + high) / 2), size_m=size, drift_m=drift)


def _with(*obstacles: Obstacle, **changes: Any) -> Scenario:
    return replace(TANK, obstacles=obstacles, **changes)


def _gate(width: float, *, drift: float = 0.0) -> Scenario:
    """A wall across the tank at x = 5 with a gate from y = 1."""
    return _with(_box("south", 5.0, 0.0, 1.0), _box("north", 5.0, 1.0 + width, 5.0, drift=drift))


@pytest.mark.parametrize("name", sorted(path.stem for path in LIBRARY.glob("*.toml"))[::3])
def test_the_paper_can_be_flown_by_the_vehicles_that_are_named(name: str) -> None:
    scenario = load_scenario(name)
    every = findings(scenario, load_vehicle(scenario.vehicle))
    assert not [f for f in every if f.level == "error"]
    assert [f.key for f in every if "no buoyancy" in f.text] == ["depth_m"]
    (surface,) = [f.text for f in every if "no buoyancy" in f.text]
    missing, rest = ("14.1", "-0.171") if name.startswith("pool") else ("102", "-0.245")
    assert f"{missing} N" in surface and f"to z = {rest} m" in surface


def test_the_pool_has_no_room_for_the_paper_s_own_hull() -> None:
    """E15: 0.364 − 0.05 − 0.27 = 0.044 m off the first cylinder, which drifts by 0.05 m."""
    found = [f.text for f in findings(POOL, HULL) if f.level == "error"]
    assert len(found) == 4 and not any("E15" in text for text in found), "other vehicles have other papers"
    assert "0.020 m inside a wall at the start" in found[0] and "0.020 m inside a wall at the target" in found[1]
    assert "0.044 m from obstacle 'Obstacle1', which drifts by up to 0.05 m" in found[2]
    assert "the wall x = 0 and 'Obstacle1'" in found[3] and "0.550 m wide, 0.500 m at the worst drift" in found[3]
    small = _found(POOL, "sur400")
    assert list(small) == [("warning", "obstacles")]  # 0.40 m pass, but not with 0.08 m to either side
    assert "needs 0.400 m, or 0.560 m with an error of 0.08 m" in small["warning", "obstacles"]


@pytest.mark.parametrize(
    ("width", "level"), [(0.625, None), (0.615, "warning"), (0.545, "warning"), (0.535, "error"), (0.1, "error")]
)
def test_a_gate_is_measured_exactly(width: float, level: str | None) -> None:
    """The hull takes 0.54 m and the stated error 0.04 m to either side."""
    found = _found(_gate(width))
    assert list(found) == ([] if level is None else [(level, "obstacles")])
    if level is not None:
        text = found[level, "obstacles"]
        assert "'south'" in text and "'north'" in text and f"{width:.3f} m wide" in text and "0.620 m" in text
        assert ("no passage is wide enough" in text) == (level == "error")


def test_a_drift_takes_from_the_gate() -> None:
    assert _found(_gate(0.70, drift=0.07)) == {}
    assert list(_found(_gate(0.70, drift=0.09))) == [("warning", "obstacles")]
    text = _found(_gate(0.70, drift=0.17))["error", "obstacles"]
    assert text.startswith("no passage is guaranteed") and "0.530 m at the worst drift" in text


def test_a_closed_way_is_an_error() -> None:
    text = _found(_with(_box("dam", 5.0, 0.0, 5.0)))["error", "obstacles"]
    assert "no passage is wide enough" in text and "0.000 m wide" in text and "'dam'" in text


def test_of_two_gates_the_wider_is_the_way() -> None:
    bars = (_box("a", 5.0, 0.0, 1.0), _box("b", 5.0, 1.58, 3.5), _box("c", 5.0, 4.1, 5.0))
    gap = tightest_gap(_with(*bars), 0.5)
    assert gap is not None
    assert set(gap.between) == {"'b'", "'c'"}
    assert gap.width == pytest.approx(0.6, abs=1e-12)
    assert np.linalg.norm(np.array(gap.place) - [5.0, 3.8]) < 0.2
    assert tightest_gap(_with(*bars), 0.2) is None


def test_a_narrow_channel_is_a_gap_between_walls() -> None:
    path = Path(np.array([[0.5, 0.3], [9.5, 0.3]]))
    found = _found(_with(site=(10.0, 0.6, 5.0), path=path))
    assert "the wall y = 0" in found["warning", "site"] and "the wall y = 0.6" in found["warning", "site"]


def test_drifting_obstacles_that_may_meet_are_told() -> None:
    posts = (_box("a", 4.0, 1.0, 1.4), _box("b", 4.35, 1.0, 1.4, drift=0.06))
    assert "0.050 m apart" in _found(_with(*posts))["warning", "obstacles.b.drift_m"]
    assert _found(_with(posts[0], _box("b", 4.37, 1.0, 1.4, drift=0.06))) == {}


@pytest.mark.parametrize(("launch", "level"), [(0.0, None), (0.13, None), (0.14, "error")])
def test_water_that_is_not_as_free_at_the_launch_as_is_said(launch: float, level: str | None) -> None:
    """The box is 0.45 m from the start less 0.27 m of hull, and drifts by 0.05 m: 0.13 m are left."""
    text = _found(_with(_box("near", 1.1, 2.0, 3.0, drift=0.05), launch=max(launch - 1e-9, 0.0))).get(
        ("error", "launch_m")
    )
    assert (text is not None) == (level == "error")
    assert text is None or "'near' may come within 0.130 m" in text


@pytest.mark.parametrize("name", sorted(path.stem for path in LIBRARY.glob("*.toml"))[::3])
def test_every_mission_says_of_the_launch_what_is_so_up_to_half_a_metre(name: str) -> None:
    """One rule for all: 0.5 m, and less, to a centimetre, only where something stands nearer."""
    scenario = load_scenario(name)
    vehicle = load_vehicle(scenario.vehicle)

    def errors(launch: float) -> int:
        return sum(f.key == "launch_m" for f in findings(replace(scenario, launch=launch), vehicle))

    assert errors(scenario.launch) == 0
    assert scenario.launch == 0.5 or (scenario.launch < 0.5 and errors(scenario.launch + 0.01) > 0)


def test_something_that_moves_starts_in_water_said_to_be_free() -> None:
    coming = Obstacle(name="OM", shape="moving", centre_m=(1.5, 2.5), to_m=(1.5, 4.0), speed_m_per_s=0.1)
    assert "within 0.460 m" in _found(_with(coming, launch=0.5))["error", "launch_m"]
    assert ("error", "launch_m") not in _found(_with(coming, launch=0.4))


def test_a_target_too_close_to_what_stands_still() -> None:
    text = _found(_with(_box("post", 9.1, 2.3, 2.7)))["error", "obstacles.post"]  # its face is 0.25 m away
    assert "the target lies 0.020 m too close" in text


def _mover(**changes: Any) -> Obstacle:
    given = {"centre_m": (5.0, 4.0), "to_m": (9.5, 2.5), "speed_m_per_s": 0.1, **changes}
    return Obstacle(name="OM", shape="moving", **given)


def test_a_moving_obstacle_that_ends_on_the_target() -> None:
    text = _found(_with(_mover()))["warning", "obstacles.OM.to_m"]
    assert "removed at 47.4 s" in text and "at 45.0 s" in text
    text = _found(_with(_mover(removed=False)))["error", "obstacles.OM.to_m"]
    assert "stays 0.540 m too close" in text
    assert _found(_with(_mover(to_m=(9.5, 3.05), removed=False))) == {}


def test_an_obstacle_faster_than_the_cap_is_told() -> None:
    assert (
        "0.23 m/s is faster"
        in _found(_with(_mover(to_m=(1.0, 4.0), speed_m_per_s=0.23)))["warning", "obstacles.OM.speed_m_per_s"]
    )
    only = _found(_with(_mover(to_m=(1.0, 4.0), speed_m_per_s=0.22)))
    assert list(only) == [("info", "obstacles.OM.speed_m_per_s")]  # what braking does not keep off is evaded
    assert _found(_with(_mover(to_m=(1.0, 4.0), speed_m_per_s=0.15))) == {}


def test_a_current_above_the_cap() -> None:
    stream = Disturbance(current_m_per_s=(0.0, 0.22))
    assert "the current of 0.22 m/s" in _found(_with(disturbance=stream))["error", "disturbance.current_m_per_s"]
    assert _found(_with(disturbance=Disturbance(current_m_per_s=(0.0, 0.21)))) == {}


def test_a_cruise_that_the_thrust_cannot_hold() -> None:
    """2 s + 60 s² = 5 N at s = 0.2725 m/s: 0.2 m/s against 0.0725 m/s."""
    assert _found(_with(disturbance=Disturbance(current_m_per_s=(-0.072, 0.0)))) == {}
    text = _found(_with(disturbance=Disturbance(current_m_per_s=(-0.074, 0.0))))["error", "cruise_m_per_s"]
    assert "0.274 m/s through the water" in text and "5.05 N" in text and "deliver 5.00 N" in text
    weak = Disturbance(current_m_per_s=(-0.072, 0.0), thrust_error=0.05)
    assert "deliver 4.75 N" in _found(_with(disturbance=weak))["error", "cruise_m_per_s"]
    assert _found(_with(disturbance=Disturbance(current_m_per_s=(0.074, 0.0)))) == {}


def test_a_run_shorter_than_its_path() -> None:
    assert _found(_with(time_limit=45.0)) == {}
    text = _found(_with(time_limit=44.0))["error", "time_limit_s"]
    assert "9.00 m" in text and "45.0 s" in text and "44 s" in text


# --- heights ----------------------------------------------------------------------------------------------------------


def _sill(top: float | None = -1.8, bottom: float | None = None, **changes: Any) -> Scenario:
    wall = _box("sill", 5.0, 0.0, 5.0).model_copy(update={"top_m": top, "bottom_m": bottom})
    return _with(wall, **{"depth": -2.0, "depths": (-3.5, -0.4), **changes})


def test_a_sill_leaves_another_depth_alone_and_the_first_that_is_free_is_told() -> None:
    ((level, key), text), *rest = _found(_sill()).items()
    assert (level, key) == ("warning", "depths_m") and not rest
    assert "only at another depth, first at z = -1.41 m" in text and "no passage" in text
    assert "z = -0.82 m" in _found(_sill(top=-1.2))["warning", "depths_m"]
    assert "z = -2.59 m" in _found(_sill(top=None, bottom=-2.2))["warning", "depths_m"]


def test_a_gate_too_narrow_is_an_error_at_one_depth_and_a_warning_where_it_ends() -> None:
    gate = tuple(o.model_copy(update={"top_m": -1.8}) for o in _gate(0.4).obstacles)
    assert ("error", "obstacles") in _found(_with(*gate, depth=-2.0))
    assert ("warning", "depths_m") in _found(_with(*gate, depth=-2.0, depths=(-3.0, -0.4)))


@pytest.mark.parametrize(("top", "depths"), [(None, (-3.5, -0.4)), (-0.9, (-3.5, -0.4)), (-1.8, (-3.5, -1.2))])
def test_where_no_depth_is_free_it_is_an_error(top: float | None, depths: tuple[float, float]) -> None:
    text = _found(_sill(top=top, depths=depths))["error", "depths_m"]
    assert "neither at the path's depth nor at another" in text
    assert ("-1.41, -0.82, -2.59, -3.18" if depths[1] == -0.4 else "-2.59, -3.18") in text


def test_what_the_hull_passes_over_or_under_is_no_obstacle() -> None:
    assert ("error", "obstacles") in _found(_sill(depths=None))
    assert ("error", "obstacles") in _found(_sill(top=-2.0 - HULL["radius"] - 0.019, depths=None))
    assert not _found(_sill(top=-2.0 - HULL["radius"] - 0.06, depths=None))
    under_start = Obstacle(name="block", shape="box", centre_m=(0.5, 2.5), size_m=(0.3, 0.3), top_m=-2.4)
    assert not _found(_with(under_start, depth=-2.0))
    beside = under_start.model_copy(update={"centre_m": (1.2, 2.5), "top_m": -1.0})
    assert ("error", "launch_m") in _found(_with(beside, depth=-2.0))


def test_the_layers_are_those_that_the_mission_has_room_for() -> None:
    gains = load_gains("default")
    assert layers(_sill(), HULL, gains) == pytest.approx([-1.41, -0.82, -2.59, -3.18])
    assert layers(_sill(depths=(-2.95, -1.2)), HULL, gains) == pytest.approx([-2.59])
    assert layers(_sill(depths=(-2.5, -1.5)), HULL, gains) == [] == layers(_sill(depths=None), HULL, gains)


@pytest.mark.parametrize(("off", "told"), [(0.01, "only 0.010 m from a wall"), (-0.01, "0.010 m inside"), (0.03, None)])
def test_a_start_beside_a_wall_takes_room_for_an_error_of_the_place(off: float, told: str | None) -> None:
    path = Path(np.array([[HULL["radius"] + off, 2.0], [5.0, 2.0]]))
    found = _found(_with(path=path))
    assert list(found) == ([] if told is None else [("error", "path_m")])
    assert told is None or f"{told}" in found["error", "path_m"]
