"""The law's routine for another type of numbers: a search that ends in floats, and the same decisions."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import replay
from surctl.marine.control import DEGRADED, Law, build_law, load_gains
from surctl.marine.control.build import in_real
from surctl.marine.export.origin import origin_of
from surctl.marine.simulation import law_numbers, load_scenario
from surctl.marine.vehicle import load_vehicle


@cache
def tried() -> tuple[Law, list[np.ndarray]]:
    """The law that keeps limits, and steps with a contact beside it."""
    mission, law, count = load_scenario("pool-static"), build_law(mode="projected", contacts=1), 12
    rng = np.random.default_rng(7)
    p = law_numbers(mission, load_gains("default"), load_vehicle(mission.vehicle))
    contacts = np.tile([0.0, 0.0, 0.2, 0.0, 0.0, 1.0], (count, 1))
    contacts[:, :2] = rng.uniform(0, 3, (count, 2))
    U = np.hstack([rng.uniform(0.5, 2.5, (count, 2)), rng.uniform(-0.5, 0.5, (count, 6)), contacts])
    return law, [np.repeat(law.initial_state()[None], count, axis=0), U, np.repeat(p[None], count, axis=0)]


def test_a_law_that_has_no_other_tolerances_comes_back_as_it_is() -> None:
    law = build_law(mode="projected", contacts=1)
    assert in_real(law, "float64") is law
    other = replace(law, mode="nsb")
    assert in_real(other, "float32") is other
    strict = build_law(mode="lexicographic", contacts=1)
    assert in_real(strict, "float32").block.digest() != strict.block.digest()


def test_a_bounded_ladder_is_the_same_law_until_rows_or_task_have_to_give_way() -> None:
    law, given = tried()
    bounded = build_law(mode="projected", contacts=1, fallback="bounded")
    want, have = replay(law.block, *given), replay(bounded.block, *given)
    opened, eased = (out[2][:, 0] % (2 * DEGRADED) >= DEGRADED for out in (want, have))
    assert eased[opened].all() and 0 < opened.sum() <= eased.sum() < len(eased)
    for a, b in zip(want, have, strict=True):
        assert a[~eased].tobytes() == b[~eased].tobytes()
    floats = replay(in_real(bounded, "float32").block, *given, real=np.float32)
    np.testing.assert_array_equal(floats[2], have[2])
    assert np.abs(floats[3] - have[3])[:, law.telemetry_slice("nu_reference")].max() < 1e-3
    with pytest.raises(InputError, match=r"not explained.*exact"):
        bounded.explained(*(vector[0] for vector in given))
    assert origin_of(bounded, load_vehicle("sur400")).ground_truth is bounded
