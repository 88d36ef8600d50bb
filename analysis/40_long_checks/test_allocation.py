"""Allocation: more failures of thrusters against an exhaustive search."""

from __future__ import annotations

import pytest

from tests.allocation import test_allocation


@pytest.mark.parametrize("vehicle", ["bluerov2-thrusters", "skewed"])
def test_forces_equal_those_of_an_exhaustive_search(vehicle: str) -> None:
    for failed in ((0,), (5,), (0, 1, 2, 3)):
        test_allocation.test_forces_equal_those_of_an_exhaustive_search(vehicle, failed)
