"""Metrics by hand."""

from __future__ import annotations

import numpy as np
import pytest

from surctl.marine.simulation.metrics import avoidance_intervals, path_error


def test_an_avoidance_interval_ends_when_the_robot_is_back_in_the_tube() -> None:
    commanded = np.array([0, 1, 1, 0, 0, 0, 0, 1, 0])
    distance = np.array([0.5, 0.0, 0.3, 0.4, 0.11, 0.10, 0.2, 0.0, 0.05])
    expected = [False, True, True, True, True, False, False, True, False]
    np.testing.assert_array_equal(avoidance_intervals(commanded, distance), expected)


def test_far_from_the_path_without_avoidance_counts() -> None:
    np.testing.assert_array_equal(avoidance_intervals(np.zeros(4), np.full(4, 9.0)), np.zeros(4, dtype=bool))


def test_the_tube_can_be_chosen() -> None:
    commanded, distance = np.array([1, 0, 0]), np.array([0.3, 0.2, 0.04])
    np.testing.assert_array_equal(avoidance_intervals(commanded, distance, tube=0.05), [True, True, False])
    np.testing.assert_array_equal(avoidance_intervals(commanded, distance, tube=0.25), [True, False, False])


def test_path_error_is_the_rms_over_what_is_kept() -> None:
    horizontal, vertical = np.array([3.0, 9.0, 0.0]), np.array([4.0, 9.0, 1.0])
    found = path_error(horizontal, vertical, np.array([False, True, False]))
    assert found == pytest.approx(np.sqrt((25 + 1) / 2))


def test_path_error_of_nothing_is_nan() -> None:
    assert np.isnan(path_error(np.ones(2), np.ones(2), np.array([True, True])))
