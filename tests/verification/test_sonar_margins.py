"""Margins by sonar: those by true positions if fixes are exact and in time, smaller ones with the filter that flies."""

from __future__ import annotations

import pytest

from surctl.errors import InputError
from surctl.marine.control import build_law, load_gains
from surctl.marine.sensing import Delivery, OwnState
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import law_loop
from surctl.marine.verification.sonar_margins import SonarMargins, sonar_loop

VEHICLE, GAINS = load_vehicle("sur540-flooded"), load_gains("default")


def test_with_exact_fixes_in_time_they_are_those_by_true_positions() -> None:
    """`law_loop` differentiates the law without a filter, and computes its margins otherwise."""
    law, truth = build_law(sonar=True), law_loop(build_law(), VEHICLE, GAINS, cruise=0.15)
    exact = OwnState(position_sd=1e-6, yaw_sd=1e-6, rate_sd=1e-6, fixes=Delivery(period=0.05, latency=0.0, loss=0.0))
    near, real = (sonar_loop(law, VEHICLE, GAINS, cruise=0.15, own=own) for own in (exact, OwnState()))
    for axis in range(3):
        margins = truth.margins[axis]
        assert near.disk((axis,), angles=5) == pytest.approx(margins.disk_margin, rel=0.03)
        assert near.delay((axis,)) == pytest.approx(margins.delay_margin_s, abs=0.05)
        assert real.disk((axis,), angles=5) < 0.7 * margins.disk_margin
    pulled = GAINS.with_values({"k_i": 0.3})
    integral = sonar_loop(law, VEHICLE, pulled, cruise=0.15, own=OwnState())
    assert integral.disk((0,), angles=5) < 0.95 * real.disk((0,), angles=5)
    assert near.stable() and near.radius(1.0, 60, (0,)) > 1 > near.radius(1.0, 0, (0,))


def test_a_hull_that_a_cruise_turns_is_not_judged_and_an_unstable_loop_is_said() -> None:
    with pytest.raises(InputError, match="holds no heading"):
        sonar_loop(build_law(sonar=True), load_vehicle("bluerov2-heavy"), GAINS, cruise=0.15, own=OwnState())
    assert SonarMargins("small", False, (), (), 3.0).line() == "  small signals: UNSTABLE"
    said = SonarMargins("large", True, (0.6, 0.7, 1.0), (0.3, 1.0, 2.0), 2.0)
    assert said.line().endswith("surge 0.60 and 0.30 s, sway 0.70 and 1.00 s, heave 1.00 and at least 2.00 s")
    assert said.to_dict()["loops"]["sway"] == {"disk_margin": 0.7, "delay_s": 1.0}
