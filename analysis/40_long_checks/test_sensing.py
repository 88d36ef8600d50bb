"""Sensing: the map with other beams and charts than the suite's, and the hull's shadow on other beams."""

from __future__ import annotations

import importlib
import math

import numpy as np
import pytest

from surctl.ir import Program, replay
from surctl.ir.routine import nested
from surctl.marine.sensing import FaultChances, LocalMap, SonarArray
from tests.sensing import (
    test_array,
    test_echo,
    test_estimate,
    test_faults,
    test_local_map,
    test_own_state,
)
from tests.sensing.mapped import EDGE, EMPTY, HULL, OPEN, firing
from tests.sensing.test_local_map import DT
from tests.sensing.test_simulated_table2 import printed, simulated

BEAMS = pytest.mark.parametrize("beam", [15.0, 75.0, 120.0])


@BEAMS
def test_a_world_that_stands_still(beam: float) -> None:
    test_local_map.test_what_one_reading_clears_lies_wholly_in_its_cone(beam)
    test_local_map.test_a_surface_that_was_heard_is_never_known_to_be_free(beam)


def test_marks_of_a_wide_beam() -> None:
    """Not that false marks are few: from 90° on, beams overlap, and a mark heard from two directions stays."""
    for check in (
        test_local_map.test_once_swept_a_mark_stands_before_every_surface,
        test_local_map.test_the_nearest_of_all_is_told_but_not_that_of_every_direction,
        test_local_map.test_false_marks_vanish_around_one_thing_alone,
    ):
        check(120.0)


@pytest.mark.parametrize("name", ["the law's", "blocks of one cell"])
def test_the_routine_and_the_numbers_agree(name: str) -> None:
    walls = test_local_map.SITE if name == "the law's" else test_local_map.OPEN
    test_local_map.test_the_routine_and_the_numbers_agree(name, walls)


def test_bits_of_other_charts_and_numbers() -> None:
    test_local_map.test_the_routine_has_the_bits_of_whole_arrays("one block", np.float64, (-0.4, 30.0, -30.0, -1.5))
    test_local_map.test_the_routine_has_the_bits_of_whole_arrays("the law's", np.float64, test_local_map.SITE)
    test_local_map.test_a_block_that_is_only_grazed_is_not_left_alone(np.float32)


@pytest.mark.parametrize("beam", test_echo.BEAMS)
@pytest.mark.parametrize("limit", [None, test_echo.WEBOTS], ids=["all", "facing"])
def test_the_hulls_shadow(beam: float, limit: float | None) -> None:
    test_echo.test_the_hulls_shadow_against_ray_casting(beam, limit)
    test_echo.test_scenes_against_ray_casting(beam, limit)


@pytest.mark.parametrize("beam", test_echo.BEAMS)
@pytest.mark.parametrize("limit", [None, test_echo.WEBOTS, 1.2])
@pytest.mark.parametrize("mounted", [False, True])
def test_symbols_and_numbers(beam: float, limit: float | None, mounted: bool) -> None:
    test_echo.test_symbols_and_numbers_give_the_same_range(beam, limit, mounted)


@pytest.mark.parametrize("told", test_faults.FAULTS)
@pytest.mark.parametrize("chances", test_faults.CHANCES, ids=["none", "some", "always"])
def test_faults_in_symbols_and_numbers(told: str, chances: FaultChances) -> None:
    array = SonarArray(order=(0, 2, 1, 3), calibrated_for=1400.0)
    test_faults.test_symbols_and_numbers_give_the_same_arrivals(told, chances, array)


@pytest.mark.parametrize("sensor", range(4))
@pytest.mark.parametrize("degrees", [7.5, 37.5, 60.0])
def test_expected_range_is_the_worlds(sensor: int, degrees: float) -> None:
    test_estimate.test_expected_range_is_the_worlds(sensor, degrees)


@pytest.mark.parametrize(("limit", "beam", "mount"), [(30, 75, None), (5, 120, None), (22.5, 60, (0.2, -0.3))])
def test_corners_of_other_faces_and_beams(limit: float, beam: float, mount: tuple[float, float] | None) -> None:
    test_array.test_a_corner_is_first_heard_where_rays_first_find_a_face_that_answers(limit, beam, mount)


def test_errors_of_the_settled_filter() -> None:
    test_own_state.test_errors_are_as_large_as_the_filter_says(161, (0, 0))


def test_an_average_of_a_firing_would_spread_half_as_much() -> None:
    averaged = simulated("average", 300)
    inside = np.mean([t.error_sd.low <= printed().error_sd.value <= t.error_sd.high for t in averaged])
    assert inside < 0.06
    table = printed()
    assert np.mean([t.error_sd.value >= table.error_sd.low for t in averaged]) < 0.02


replaying = importlib.import_module("surctl.ir.replay")  # the package has a function of that name


def test_a_readingcosts_what_it_touches(monkeypatch):
    """Two firings ahead, and none: the blocks beside them are left alone."""
    counted = []
    run = replaying._run_program

    def counting(program, arrays, real):
        batch = np.broadcast_shapes(*(a.shape[:-1] for a in arrays))
        counted.append(program.operations * math.prod(batch))
        return run(program, arrays, real)

    monkeypatch.setattr(replaying, "_run_program", counting)
    chart, costs = LocalMap(dt=DT), []
    ahead = firing((HULL, 0.0), 0.0, 1.0, half=math.radians(37.5))
    for readings in ([*EMPTY, *EMPTY], [*ahead, *EMPTY], [*ahead, *ahead]):
        counted.clear()
        replay(chart.routine(), np.zeros(chart.side**2), np.full(2, -24.0), [0.0, 0.0, HULL, EDGE], OPEN, readings)
        costs.append(sum(counted))
    assert costs[0] < costs[1] < costs[2] < 170_000 < chart.routine().operations / 3
    programs = {b.digest(): b.operations for b in nested(chart.routine()).values() if isinstance(b, Program)}
    assert sum(programs.values()) < 800
