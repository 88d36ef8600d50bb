"""A single run agrees with the independent loop in NumPy; the analysis of every scenario compares the others."""

from __future__ import annotations

import pytest

from tests.oracles.missions import KINDS, difference, mission

AGREE = 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_is_that_of_the_independent_loop(kind: str) -> None:
    scenario, vehicle, options = mission("pool-static", kind, seconds=4.0)
    assert difference(scenario, vehicle, seed=3, **options) <= AGREE
