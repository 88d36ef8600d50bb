from __future__ import annotations

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import cruise_loop, sweep_locus

GAINS = {"k1": 0.3, "k2": 0.3, "k_psi": 0.6, "k_r": 1.5, "k_v": 1.5, "lookahead": 1.2}
VEHICLE = load_vehicle("sur540-flooded")
ABOUT = {"cruise": 0.15, "dt": 0.05}


@pytest.mark.parametrize("knob", ["k_psi", "vehicle.m44", "scenario.cruise"])
def test_every_row_holds_the_poles_of_its_value(knob: str) -> None:
    values = {"k_psi": [0.3, 0.6, 0.9], "vehicle.m44": [0.8, 1.0, 1.2], "scenario.cruise": [0.1, 0.15, 0.2]}[knob]
    loops = sweep_locus(VEHICLE, GAINS, knob, values, **ABOUT)
    for value, loop in zip(values, loops, strict=True):
        gains = {**GAINS, knob: value} if knob in GAINS else GAINS
        vehicle = VEHICLE.with_values({"m44": value}) if knob == "vehicle.m44" else VEHICLE
        cruise = value if knob == "scenario.cruise" else ABOUT["cruise"]
        expected = cruise_loop(vehicle, gains, cruise=cruise, dt=ABOUT["dt"]).rates
        np.testing.assert_allclose(np.sort_complex(loop.rates), np.sort_complex(expected), atol=1e-6)


def test_instability_is_seen() -> None:
    stable = [loop.stable for loop in sweep_locus(VEHICLE, GAINS, "k_psi", np.linspace(0.2, 6.0, 30), **ABOUT)]
    assert stable[0] and not stable[-1]


def test_it_is_drawn_about_a_point() -> None:
    about = {"k_r": 0.8, "plant.m22": 120.0, "scenario.cruise": 0.2, "seed": 3.0, "k_v": 9.0}
    found = sweep_locus(VEHICLE, GAINS, "k_v", [1.0, 2.0], **ABOUT, about=about)
    plant = VEHICLE.with_values({"m22": 120.0})
    for value, loop in zip([1.0, 2.0], found, strict=True):
        gains = {**GAINS, "k_r": 0.8, "k_v": value}
        expected = sweep_locus(plant, gains, "k_v", [value, 9.0], cruise=0.2, dt=0.05, model=VEHICLE)[0].rates
        np.testing.assert_allclose(np.sort_complex(loop.rates), np.sort_complex(expected), atol=1e-9)


def test_the_number_of_poles_may_change() -> None:
    first, second = sweep_locus(VEHICLE, GAINS, "k_i", [0.0, 0.1], **ABOUT)
    assert len(first.rates) < len(second.rates)


@pytest.mark.parametrize(
    ("knob", "values", "told"),
    [
        ("margin", [1.0, 2.0], "moves no pole"),
        ("scenario.cruise", [0.1, 0.9], "thrust"),
    ],
)
def test_what_has_no_locus_is_refused(knob: str, values: list[float], told: str) -> None:
    with pytest.raises(InputError, match=told):
        sweep_locus(VEHICLE, GAINS, knob, values, **ABOUT)
