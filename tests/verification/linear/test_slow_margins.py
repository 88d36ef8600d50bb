"""Margins hold from rest to the cruise speed, or the assessment says at which speeds they are too small."""

from __future__ import annotations

import pytest

from surctl.assessment import assess
from surctl.marine.assessment import Mission
from surctl.marine.tuning import derive_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import linear_table
from surctl.marine.verification.speeds import slow_margins

DT = 0.05


@pytest.mark.parametrize(("name", "cruise", "enough"), [("bluerov2-wu", 0.1, True), ("bluerov2-wu", 0.33, False)])
def test_the_assessment_says_over_which_speeds_the_margins_hold(name: str, cruise: float, enough: bool) -> None:
    vehicle = load_vehicle(name)
    gains = derive_gains(vehicle, cruise=cruise).gains
    slow = slow_margins(vehicle, gains.values, cruise=cruise, dt=DT)
    speeds = [share * cruise for share in (0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0)]
    table = linear_table(
        vehicle, {}, base=gains.values, cruise=speeds, dt=DT, columns=("disk_margin", "delay_margin_s")
    )
    for name in table:
        assert slow.worst(name)[0] == pytest.approx(table[name].min(), rel=5e-3)
    result = assess(Mission(vehicle, gains, cruise, 2 * cruise), parts=["loop"])
    assert result.accepted() and result.passed is (True if enough else None)
    below = [line for line in result.lines if line.text.startswith(f"margins below {cruise:g} m/s")]
    assert bool(slow.short) is bool(below) is not enough
    disk, speed = slow.worst("disk_margin")
    assert result.figures["slow_disk_margin"].value == disk <= result.figures["disk_margin"].value * 1.005
    assert result.figures["slow_disk_margin"].where == f"{speed:.3g} m/s"
