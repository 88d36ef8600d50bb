"""Cruise speeds as they are given, and figures over them."""

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import linear_table, over_speeds
from surctl.marine.verification.speeds import check_held, cruise_speeds, speeds_text
from surctl.verification.loops import worst_place

GAINS = load_gains("default").values
SUR = load_vehicle("sur400")


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ([], "names no speed"),
        ([0.1, 0.0], "= 0.0: must be finite and greater than 0"),
        ([0.1, -0.2], "= -0.2: must be finite and greater than 0"),
        ([float("nan")], "= nan: must be finite and greater than 0"),
        ([0.1, float("inf")], "= inf: must be finite and greater than 0"),
        ([0.1, 0.2, 0.1], "= 0.1: has a speed twice"),
    ],
)
def test_speeds_that_are_none_are_told_with_key_value_and_remedy(given, told):
    with pytest.raises(InputError, match=told) as error:
        cruise_speeds(given, key="cruise_m_per_s")
    assert str(error.value).startswith("cruise_m_per_s = ") and error.value.remedy


def test_a_speed_is_held_below_the_cap_and_by_the_thrust():
    check_held((0.05, 0.22), SUR, cap=0.22, key="--cruise")
    with pytest.raises(InputError, match=r"--cruise = 0.23: is above the cap, 0.22 m/s; lower it"):
        check_held((0.05, 0.23), SUR, cap=0.22, key="--cruise")
    with pytest.raises(InputError, match=r"--cruise = 0.9: sur400 needs thrust .*; lower the speed"):
        check_held((0.05, 0.9), SUR, cap=1.0, key="--cruise")


def test_the_worst_place_counts_nan_as_worst_and_rounding_as_nothing():
    nan, inf = np.nan, np.inf
    rows = [[1.0, 2.0, 1.0, inf, nan, -1.0], [1.0 + 1e-15, 3.0, nan, inf, inf, -0.5]]
    assert worst_place(np.array(rows)).tolist() == [0, 1, 1, 0, 0, 1]
    assert worst_place(np.array([0.3, 0.3 * (1 + 1e-5), 0.2])) == 1, "more than rounding"


def test_figures_over_speeds_are_those_at_each_and_the_worst_has_its_speed():
    columns = ("settling_time_s.cross_track", "sensitivity_peak", "disk_margin", "crossover_rad_per_s.cross_track")
    found = over_speeds(SUR, GAINS, cruise=(0.05, 0.15, 0.22), dt=0.05, columns=columns)
    for k, speed in enumerate(found.cruise):
        alone = linear_table(SUR, {}, base=GAINS, cruise=speed, dt=0.05, columns=columns)
        assert all(found.figures[name][k] == pytest.approx(alone[name][0], rel=1e-12) for name in columns)
    # a slow vehicle returns to the path slowly: the cross-track loop's gain is U/lookahead
    settling, slow = found.worst("settling_time_s.cross_track")
    assert slow == 0.05 and settling == found.figures["settling_time_s.cross_track"].max()
    crossover = found.figures["crossover_rad_per_s.cross_track"]
    assert crossover == pytest.approx(crossover[1] * np.array([1 / 3, 1, 0.22 / 0.15]), rel=0.02)
    told = found.to_dict()
    assert told["worst"]["settling_time_s.cross_track"] == {"value": settling, "cruise_m_per_s": 0.05}
    assert [row["cruise_m_per_s"] for row in told["at"]] == [0.05, 0.15, 0.22]


def test_a_speed_without_a_linear_loop_is_the_worst():
    found = over_speeds(SUR, GAINS, cruise=(0.05, 5.0), dt=0.05, columns=("disk_margin",))
    assert np.isnan(found.worst("disk_margin")[0]) and found.worst("disk_margin")[1] == 5.0


def test_speeds_read_as_a_sentence():
    assert [speeds_text(s) for s in ((0.2,), (0.1, 0.2), (0.05, 0.1, 0.2))] == [
        "0.2 m/s", "0.1 and 0.2 m/s", "0.05, 0.1 and 0.2 m/s"
    ]  # fmt: skip
