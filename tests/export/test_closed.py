"""Gains as constants of a law that keeps limits: the same numbers, from less."""

from __future__ import annotations

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import Routine, replay
from surctl.marine.control import build_law, load_gains
from surctl.marine.export import closed_form
from surctl.marine.export.compiled_law import ClosedForm
from surctl.marine.simulation import law_numbers, load_scenario
from surctl.marine.vehicle import load_vehicle


def test_a_law_that_keeps_limits_answers_alike_with_constant_gains() -> None:
    mission, law = load_scenario("pool-static"), build_law(mode="projected", contacts=1)
    p = law_numbers(mission, load_gains("default"), load_vehicle(mission.vehicle))
    shipped = closed_form(law, constants=p)
    assert isinstance(shipped, ClosedForm) and isinstance(shipped.block, Routine)
    assert shipped.gains.size == 0 and dict(shipped.block.inputs)["p"] == 0
    assert shipped.block.operations < law.block.operations
    rng = np.random.default_rng(5)
    X = np.repeat(law.initial_state()[None], 12, axis=0)
    contacts = np.hstack([rng.uniform(0, 3, (12, 2)), np.full((12, 1), 0.2), np.zeros((12, 2)), np.ones((12, 1))])
    U = np.hstack([rng.uniform(0, 3, (12, 2)), rng.uniform(-1, 1, (12, 6)), contacts])
    wanted = replay(law.block, X, U, np.repeat(p[None], 12, axis=0))
    for a, b in zip(replay(shipped.block, X, U, np.zeros((12, 0))), wanted, strict=True):
        assert (a + 0.0).tobytes() == (b + 0.0).tobytes()  # + 0.0: the sign of a zero may differ
    assert np.ptp(wanted[0], axis=0).min() > 0.1  # the thrust is not the same all over
    np.testing.assert_array_equal(shipped.step(X[0], U[0], np.zeros(0)).tau, wanted[0][0])
    with pytest.raises(InputError, match="finite numbers"):
        closed_form(law, constants=p[1:])
