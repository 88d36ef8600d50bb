"""Tracking law (8)–(12): error frame, command, and the sign of V̇1."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.marine.guidance.tracking import along_command, path_error, progress_rate, tracking_rate, tracking_velocity

Array = NDArray[np.float64]
U_D, K1, K2 = 0.15, 0.3, 0.3
errors = st.floats(-2, 2)
turns = st.floats(-1, 1)


@cache
def _law(repaired: bool, capped: bool) -> ca.Function:
    e, k1, lookahead, turn, cap = ca.SX.sym("e", 3), *(ca.SX.sym(n) for n in ("k1", "lookahead", "turn", "cap"))
    along = along_command(
        e[0],
        e[1],
        speed=ca.SX(U_D),
        k1=k1,
        lookahead=lookahead,
        maximum=cap if capped else None,
        repaired=repaired,
    )
    rate = tracking_rate(e, along, speed=ca.SX(U_D), lookahead=lookahead, k2=ca.SX(K2), turn=turn)
    return ca.Function("law", [e, k1, lookahead, turn, cap], [along, ca.dot(e, rate)])


def _v1_rate(e: tuple[float, float, float], *, k: float, lookahead: float, turn: float, repaired: bool) -> float:
    return float(_law(repaired, False)(list(e), k, lookahead, turn, 0)[1])


@settings(derandomize=True, deadline=None)
@given(errors, errors, errors, st.floats(0.2, 2), turns)
def test_v1_rate_is_the_formula_where_nothing_clips(
    x_e: float, y_e: float, z_e: float, lookahead: float, turn: float
) -> None:
    """V̇1 = −k1 x_e² − (U_h/√(y_e² + Δ²)) y_e² − k2 z_e², U_h as (12) implies; γ̇_d cancels."""
    U = (U_D - K1 * x_e) * np.hypot(y_e, lookahead) / lookahead
    formula = -K1 * x_e**2 - U / np.hypot(y_e, lookahead) * y_e**2 - K2 * z_e**2
    found = _v1_rate((x_e, y_e, z_e), k=K1, lookahead=lookahead, turn=turn, repaired=False)
    assert found == pytest.approx(formula, abs=1e-12)
    if K1 * x_e < U_D:  # the repair clips nothing there
        repaired = _v1_rate((x_e, y_e, z_e), k=K1, lookahead=lookahead, turn=turn, repaired=True)
        assert repaired == pytest.approx(formula, abs=1e-12)


@settings(derandomize=True, deadline=None)
@given(errors, errors, errors, st.floats(0.2, 2), turns)
def test_the_repaired_law_never_raises_v1(x_e: float, y_e: float, z_e: float, lookahead: float, turn: float) -> None:
    assert _v1_rate((x_e, y_e, z_e), k=K1, lookahead=lookahead, turn=turn, repaired=True) <= 1e-15


def test_the_printed_law_has_its_counterexample() -> None:
    """E9: k1 = k2 = Δ = 0.5, v_d = 0.15 at (0.6, 1, 0) gives V̇1 = +0.12."""
    found = _v1_rate((0.6, 1.0, 0.0), k=0.5, lookahead=0.5, turn=0.0, repaired=False)
    assert found == pytest.approx(0.12, abs=1e-12)


def test_with_a_speed_limit_v1_rises_far_behind_on_the_side() -> None:
    """U_max = 0.25, k1 = k2 = Δ = 0.5: the first violation lies at x_e = −5.00, y_e = 1.414... and not before."""
    law = _law(True, True)
    assert float(law([-5.05, 2**0.5, 0.0], 0.5, 0.5, 0.0, 0.25)[1]) > 0
    assert float(law([-4.95, 2**0.5, 0.0], 0.5, 0.5, 0.0, 0.25)[1]) < 0
    for x_e in np.linspace(-2, 2, 41):
        for y_e in np.linspace(-2, 2, 41):
            assert float(law([x_e, y_e, 0.0], 0.5, 0.5, 0.0, 0.25)[1]) <= 1e-15


@settings(derandomize=True, deadline=None)
@given(errors, errors, st.floats(0.2, 2), st.floats(0.05, 0.5))
def test_the_commanded_speed_stays_within_the_cap(x_e: float, y_e: float, lookahead: float, cap: float) -> None:
    for repaired in (True, False):
        along = float(_law(repaired, True)([x_e, y_e, 0.0], K1, lookahead, 0.0, cap)[0])
        assert abs(along) * np.hypot(y_e, lookahead) / lookahead <= cap * (1 + 1e-12)
        assert not repaired or along >= 0


@cache
def _frame() -> ca.Function:
    position, target, tangent, along, lookahead = (
        *(ca.SX.sym(n, 2) for n in ("p", "t", "tangent")),
        ca.SX.sym("along"),
        ca.SX.sym("lookahead"),
    )
    x_e, y_e = path_error(position, target, tangent)
    velocity = tracking_velocity(along, y_e, tangent, lookahead)
    return ca.Function("frame", [position, target, tangent, along, lookahead], [x_e, y_e, velocity])


@settings(derandomize=True, deadline=None)
@given(errors, errors, st.floats(-np.pi, np.pi), st.floats(0.01, 0.3), st.floats(0.2, 2))
def test_command_is_the_los_law_of_course_and_speed(
    x: float, y: float, gamma: float, along: float, lookahead: float
) -> None:
    """χ_d = γ_d − atan(y_e/Δ) and |v| = along √(y_e² + Δ²)/Δ."""
    tangent = [np.cos(gamma), np.sin(gamma)]
    x_e, y_e, velocity = (np.asarray(m).reshape(-1) for m in _frame()([x, y], [0.3, -0.2], tangent, along, lookahead))
    offset = np.array([x - 0.3, y + 0.2])
    assert x_e[0] == pytest.approx(np.cos(gamma) * offset[0] + np.sin(gamma) * offset[1], abs=1e-12)
    assert y_e[0] == pytest.approx(-np.sin(gamma) * offset[0] + np.cos(gamma) * offset[1], abs=1e-12)
    course = gamma - np.arctan(y_e[0] / lookahead)
    speed = along * np.hypot(y_e[0], lookahead) / lookahead
    np.testing.assert_allclose(velocity, speed * np.array([np.cos(course), np.sin(course)]), atol=1e-12)


def test_left_of_the_path_is_positive() -> None:
    y_e = _frame()([0.0, 1.0], [0.0, 0.0], [1.0, 0.0], 0.1, 1.0)[1]
    assert float(y_e) == 1.0


@pytest.mark.parametrize(
    ("x_e", "expected"), [(0.5, 1.0), (0.0, 1.0), (-0.4, 1.0), (-0.6, 0.5), (-0.8, 0.0), (-5.0, 0.0)]
)
def test_the_target_waits_for_a_robot_that_falls_behind(x_e: float, expected: float) -> None:
    x = ca.SX.sym("x")
    rate = ca.Function("rate", [x], [progress_rate(x, speed=ca.SX(0.2), wait=ca.SX(0.8))])
    assert float(rate(x_e)) == pytest.approx(0.2 * expected, abs=1e-12)
