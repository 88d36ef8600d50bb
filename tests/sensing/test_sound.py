"""The speed of sound against a formula of other authors and against published values."""

from __future__ import annotations

import math

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.sensing.sonar.array import speed_of_sound

# Bilaniuk and Wong 1993 (erratum 1996), "Speed of sound in pure water as a function of temperature", 148 points
BILANIUK = (1.40238744e3, 5.03836171, -5.81172916e-2, 3.34638117e-4, -1.48259672e-6, 3.16585020e-9)


def test_water_agrees_with_bilaniuk_and_wong():
    for temperature in np.linspace(0, 95, 200):
        other = np.polynomial.polynomial.polyval(temperature, BILANIUK)
        assert speed_of_sound(temperature) == pytest.approx(other, abs=0.03)


@pytest.mark.parametrize("temperature", [-0.1, 95.1, math.nan])
def test_mistakes_are_named(temperature):
    with pytest.raises(InputError) as caught:
        speed_of_sound(temperature)
    assert caught.value.key == "temperature"
