"""Angles that stay near one: turned by a short series, and how far that is off."""

from __future__ import annotations

import math
from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.ir import Program, lower, replay
from surctl.ir.elementary import nearby_angles
from surctl.marine.simulation.physics import advance


def stages() -> Program:
    """Sine and cosine of an angle, of it and a step, of it and two steps, and of another angle."""
    p, x = ca.SX.sym("p", 2), ca.SX.sym("x", 3)
    angles = [x[1], x[1] + p[0], x[1] + p[0] + p[1], x[2]]
    return lower(ca.Function("f", [p, x], [ca.vertcat(*(f(a) for a in angles for f in (ca.sin, ca.cos)))]))


def sines(program: Program) -> int:
    return sum(i.op in ("sin", "cos") for i in program.instructions)


def test_two_functions_are_left_of_an_angle_and_its_neighbours() -> None:
    turned = nearby_angles(stages(), source=1, entry=1)
    assert (sines(stages()), sines(turned)) == (8, 4)
    assert nearby_angles(stages(), source=1, entry=2).instructions == stages().instructions
    assert (sines(lower(advance())), sines(nearby_angles(lower(advance()), source=0, entry=3))) == (24, 2)


@settings(max_examples=25)
@given(st.floats(-20, 20), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_it_is_as_exact_as_the_sine_for_small_steps(angle: float, one: float, two: float) -> None:
    found = replay(nearby_angles(stages(), 1, 1), [one, two], [0.0, angle, 0.3])[0]
    for k, exact in enumerate(
        (Fraction(angle), Fraction(angle) + Fraction(one), sum(map(Fraction, (angle, one, two))))
    ):
        near = float(exact)
        rest = float(exact - Fraction(near))  # what the sum of doubles loses; a turn does not
        wanted = [math.sin(near) + rest * math.cos(near), math.cos(near) - rest * math.sin(near)]
        np.testing.assert_allclose(found[2 * k : 2 * k + 2], wanted, atol=7e-16, rtol=0)


@pytest.mark.parametrize("step", [0.5, 1.0])
def test_a_large_step_is_off_by_the_first_term_left_out(step: float) -> None:
    worst = 0.0
    for angle in np.linspace(-3, 3, 25):
        wanted, found = (
            replay(p, [step, 0.0], [0.0, angle, 0.3])[0] for p in (stages(), nearby_angles(stages(), 1, 1))
        )
        worst = max(worst, float(np.abs(found - wanted).max()))
    bound = step**11 / math.factorial(11) + step**12 / math.factorial(12)
    assert 0.5 * bound < worst <= 1.01 * bound


def test_what_is_no_number_stays_none() -> None:
    found = replay(nearby_angles(stages(), 1, 1), [0.1, np.nan], [0.0, 0.3, 0.3])[0]
    assert np.isnan(found).tolist() == [False] * 4 + [True] * 2 + [False] * 2
