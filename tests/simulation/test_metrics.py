"""Metrics by hand."""

from __future__ import annotations

import numpy as np

from surctl.marine.simulation.metrics import avoidance_intervals


def test_an_avoidance_interval_ends_when_the_robot_is_back_in_the_tube() -> None:
    commanded = np.array([0, 1, 1, 0, 0, 0, 0, 1, 0])
    distance = np.array([0.5, 0.0, 0.3, 0.4, 0.11, 0.10, 0.2, 0.0, 0.05])
    expected = [False, True, True, True, True, False, False, True, False]
    np.testing.assert_array_equal(avoidance_intervals(commanded, distance), expected)


def test_far_from_the_path_without_avoidance_counts() -> None:
    np.testing.assert_array_equal(avoidance_intervals(np.zeros(4), np.full(4, 9.0)), np.zeros(4, dtype=bool))
