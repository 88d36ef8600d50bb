"""The speed up to which all corners keep a disk margin, and the corner that is worst."""

from dataclasses import replace

import pytest

from surctl.assessment import assess
from surctl.marine.assessment import Mission
from surctl.marine.cli.linear_part import linear_part, speed_lines
from surctl.marine.control import load_gains
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.verification.linear import cap_above

WU = load_vehicle("bluerov2-wu")


def ranged() -> Vehicle:
    """A hull with unequal masses, each with a range."""
    known = {"m11": (15.0, 19.0), "m22": (21.5, 27.0)}
    parameters = {n: replace(p, range=known[n]) if n in known else p for n, p in WU.parameters.items()}
    return replace(WU, parameters=parameters)


def at_speed(cruise: float, cap: float) -> Mission:
    return Mission(ranged(), load_gains("default"), cruise, cap, "guarded")


def test_an_unstable_corner_is_named_with_loop_and_remedy_and_a_cap_above_the_speeds_is_flagged() -> None:
    mission = Mission(ranged(), load_gains("default"), cruise=0.2, cap=0.22)
    assessment = assess(mission, parts=["loop"])
    assert assessment.passed is False and "UNSTABLE at the corner m11 = 15 kg, m22 = 27 kg" in assessment.banner
    part = linear_part(assessment, mission)
    assert part.stable is False and assessment.figures["nominal_disk_margin"].value > 0
    text = "\n".join(part.lines)
    assert "loop yaw; UNSTABLE at 0.2 m/s" in text and "stable with k_psi" in text
    assert part.data["linear"]["worst"]["corner"] == "m11 = 15 kg, m22 = 27 kg"
    lines, numbers = speed_lines(at_speed(0.1, 0.22), short=False)
    assert numbers["with_margin"] < numbers["stable"] < numbers["nominal_stable"] == pytest.approx(0.202, abs=1e-3)
    assert lines[1] == "  warning: the cap, 0.22 m/s, exceeds 0.202 m/s, the bearable speed; lower it"
    fast = speed_lines(at_speed(0.21, 0.22), short=False)[0]
    assert fast[1].endswith("lower it and the cruise speed")
    # the run of the vehicle, as surctl simulate shows it
    assert "stays bounded: it arrives, crabs by 15 deg" in assessment.banner and "stays bounded" in text


def test_a_run_of_an_unstable_loop_that_does_not_arrive_is_not_called_bounded() -> None:
    hull = load_vehicle("sur400")
    gains = load_gains("default").with_values({"k_v": 0.02, "k1": 1.0, "lookahead": 0.02})
    line = assess(Mission(hull, gains, cruise=0.2, cap=0.22), parts=["loop"]).failures[0]
    assert "UNSTABLE" in line and "does not arrive" in line and "bounded" not in line


def test_a_loop_that_no_speed_makes_stable_is_not_blamed_on_the_cap() -> None:
    assert "so no cap helps" in (cap_above(WU, 0.0, cap=0.2) or "")
    assert len(speed_lines(at_speed(0.1, 0.1), short=False)[0]) == 1
