"""Avoidance law (17)–(20): the three forms, the side, and the braking distance."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.marine.guidance import FORMS, AvoidanceForm
from surctl.marine.guidance.avoidance import avoidance_course, clearance_rate, encounter_side
from surctl.tasks import allowed_closing_speed

R, K3, KAPPA = 0.5, 1.0, 0.3
bearings = st.floats(-3.1, 3.1)
sides = st.sampled_from([-1.0, 1.0])
NAMES = ("phi", "clearance", "side", "delta", "speed", "closing", "standoff")


@cache
def _form(form: AvoidanceForm) -> ca.Function:
    """(φ, l_dm, λ2, δ, u, v_o·n, d_s) → (ψ_dm, l̇)."""
    phi, clearance, side, delta, speed, closing, standoff = symbols = [ca.SX.sym(n) for n in NAMES]
    course = avoidance_course(
        form,
        phi,
        clearance,
        radius=ca.SX(R),
        side=side,
        delta=delta,
        k3=ca.SX(K3),
        speed=speed,
        closing=closing,
        kappa=ca.SX(KAPPA),
        standoff=standoff,
    )
    return ca.Function(form, symbols, [course, clearance_rate(course, phi, speed=speed, closing=closing)])


def _rate(form: AvoidanceForm, *args: float) -> float:
    return float(_form(form)(*args)[1])


# --- corrected ----------------------------------------------------------------------------------------------------


@settings(derandomize=True, deadline=None)
@given(bearings, st.floats(-0.3, 3), sides, st.floats(0.05, 0.25), st.floats(-0.2, 0.2), st.floats(0, 0.3))
def test_corrected_makes_the_clearance_decay_at_kappa_where_it_can(
    phi: float, clearance: float, side: float, speed: float, closing: float, standoff: float
) -> None:
    """l̇ = −κ(l − R_OB − d_s) while |v_o·n + κ(l − R_OB − d_s)| ≤ u; else the best there is."""
    demand = closing + KAPPA * (clearance - standoff)
    found = _rate("corrected", phi, clearance, side, 0.0, speed, closing, standoff)
    if abs(demand) <= speed * (1 - 1e-9):
        assert found == pytest.approx(-KAPPA * (clearance - standoff), abs=1e-7)
    elif demand > speed:  # far away: straight at it
        assert found == pytest.approx(closing - speed, abs=1e-7)
    elif demand < -speed:  # run
        assert found == pytest.approx(closing + speed, abs=1e-7)


@settings(derandomize=True, deadline=None)
@given(bearings, sides, st.floats(0.1, 0.25), st.floats(-0.09, 0.09))
def test_corrected_keeps_a_moving_obstacle_at_the_standoff(
    phi: float, side: float, speed: float, closing: float
) -> None:
    assert _rate("corrected", phi, 0.2, side, 0.0, speed, closing, 0.2) == pytest.approx(0, abs=1e-9)


@settings(derandomize=True, deadline=None)
@given(bearings, st.floats(0, 0.3), st.floats(0.12, 0.25))
def test_the_sides_are_mirror_images_about_the_bearing(phi: float, clearance: float, speed: float) -> None:
    for form in ("consistent", "corrected"):
        left, right = (float(_form(form)(phi, clearance, s, 0.0, speed, 0.0, 0.0)[0]) for s in (1, -1))
        assert left - phi == pytest.approx(phi - right, abs=1e-12)
        assert left >= phi  # +1 turns to the left: the obstacle stays on the right


# --- consistent ---------------------------------------------------------------------------------------------------


@settings(derandomize=True, deadline=None)
@given(bearings, st.floats(-0.4, 3), sides, st.floats(0, 0.2), st.floats(0.05, 0.25), st.floats(-0.1, 0.1))
def test_consistent_gives_the_rate_of_v2(
    phi: float, clearance: float, side: float, delta: float, speed: float, closing: float
) -> None:
    """V̇2 = e2 [−u ζ/√(1 + ζ²) + v_o·n], ζ = (e2 + δ)/(k3 R_OB)."""
    zeta = (clearance + delta) / (K3 * R)
    expected = closing - speed * zeta / np.sqrt(1 + zeta**2)
    found = _rate("consistent", phi, clearance, side, delta, speed, closing, 0.0)
    assert found == pytest.approx(expected, abs=1e-12)


def test_consistent_points_at_the_obstacle_far_away_and_along_the_circle_on_it() -> None:
    course = _form("consistent")
    assert float(course(0.4, 1e6, 1, 0.0, 0.2, 0.0, 0.0)[0]) == pytest.approx(0.4, abs=1e-5)
    assert float(course(0.4, 0.0, 1, 0.0, 0.2, 0.0, 0.0)[0]) == pytest.approx(0.4 + np.pi / 2, abs=1e-12)
    assert _rate("consistent", 0.4, -0.1, 1, 0.0, 0.2, 0.0, 0.0) > 0  # inside it goes outward


def test_a_positive_delta_lets_the_robot_in() -> None:
    """E11: u = 0.22, e2 = −0.05, δ = 0.1 gives V̇2 = +0.0011: still inbound inside the circle."""
    v2_rate = -0.05 * _rate("consistent", 0.7, -0.05, 1, 0.1, 0.22, 0.0, 0.0)
    assert v2_rate == pytest.approx(0.0011, abs=5e-5)
    # it settles at R − δ, where the robot moves along the smaller circle
    assert _rate("consistent", 0.7, -0.1, 1, 0.1, 0.22, 0.0, 0.0) == pytest.approx(0, abs=1e-15)


def test_an_approaching_obstacle_gets_in() -> None:
    """E12: the robot settles at e2* = −k3 R c/√(1 − c²), c = u_OB/u, inside; corrected keeps the circle."""
    c = 0.15 / 0.22
    settled = -K3 * R * c / np.sqrt(1 - c**2)
    assert _rate("consistent", 0.7, 0.0, 1, 0.0, 0.22, -0.15, 0.0) < -0.1
    assert _rate("consistent", 0.7, settled, 1, 0.0, 0.22, -0.15, 0.0) == pytest.approx(0, abs=1e-12)
    assert _rate("corrected", 0.7, 0.0, 1, 0.0, 0.22, -0.15, 0.0) == pytest.approx(0, abs=1e-12)


# --- printed ------------------------------------------------------------------------------------------------------


def test_the_printed_angle_flips_the_clearance_rate() -> None:
    """E1: at l = 2 R and a bearing of 55° the clockwise angle turns l̇ = −0.156 m/s into +0.199 m/s."""
    for phi in (np.deg2rad(55), -np.deg2rad(55)):
        arguments = (phi, R, 1.0, 0.0, 0.22, 0.0, 0.0)
        assert _rate("consistent", *arguments) == pytest.approx(-0.156, abs=5e-4)
        assert _rate("printed", *arguments) == pytest.approx(+0.199, abs=5e-4)


def test_printed_and_consistent_agree_dead_ahead_only() -> None:
    arguments = (0.3, 1.0, 0.0, 0.22, 0.0, 0.0)
    assert _rate("printed", 0.0, *arguments) == pytest.approx(_rate("consistent", 0.0, *arguments), abs=1e-12)
    assert abs(_rate("printed", 0.8, *arguments) - _rate("consistent", 0.8, *arguments)) > 0.05


@settings(derandomize=True, deadline=None)
@given(st.floats(0.01, 3.1), st.floats(-0.3, 2))
def test_printed_takes_its_side_from_the_sign_of_the_clockwise_angle(phi: float, clearance: float) -> None:
    turn = np.pi / 2 - np.arctan2(clearance, K3 * R)
    course = _form("printed")
    for side in (1, -1):  # what the encounter says plays no part
        assert float(course(phi, clearance, side, 0, 0.2, 0, 0)[0]) == pytest.approx(-phi - turn, abs=1e-12)
        assert float(course(-phi, clearance, side, 0, 0.2, 0, 0)[0]) == pytest.approx(phi + turn, abs=1e-12)


def test_an_unknown_form_is_refused() -> None:
    assert FORMS == ("printed", "consistent", "corrected")
    with pytest.raises(InputError, match="did you mean 'corrected'"):
        _form.__wrapped__("corected")


# --- side ---------------------------------------------------------------------------------------------------------


@cache
def _side() -> ca.Function:
    v, n = ca.SX.sym("v", 2), ca.SX.sym("n", 2)
    return ca.Function("side", [v, n], [encounter_side(v, n)])


@pytest.mark.parametrize(("angle", "expected"), [(0.5, 1), (-0.5, -1), (0.0, 1), (0.05, 1), (-0.05, 1), (-0.15, -1)])
@pytest.mark.parametrize("bearing", [0.0, 1.0, -2.0, 3.0])
def test_side_is_left_of_the_bearing_and_head_on_left(angle: float, expected: int, bearing: float) -> None:
    """E10, with |cross| < 0.02 m/s counted as head-on."""
    course = bearing + angle
    velocity = 0.2 * np.array([np.cos(course), np.sin(course)])
    assert float(_side()(velocity, [np.cos(bearing), np.sin(bearing)])) == expected


# --- braking distance ---------------------------------------------------------------------------------------------


@cache
def _allowed() -> ca.Function:
    d, a, t = (ca.SX.sym(n) for n in "dat")
    return ca.Function("allowed", [d, a, t], [allowed_closing_speed(d, deceleration=a, reaction=t)])


decelerations, reactions = st.floats(0.01, 2), st.floats(0.05, 2)


@settings(derandomize=True, deadline=None)
@given(st.floats(0, 2), decelerations, reactions)
def test_allowed_speed_inverts_the_braking_distance(s: float, a: float, t: float) -> None:
    assert float(_allowed()(s**2 / (2 * a) + s * t, a, t)) == pytest.approx(s, abs=1e-7)


@settings(derandomize=True, deadline=None)
@given(decelerations, reactions)
def test_allowed_speed_is_continuous_with_its_slope_at_contact(a: float, t: float) -> None:
    h = 1e-9
    at, before, after = (float(_allowed()(d, a, t)) for d in (0.0, -h, h))
    assert at == pytest.approx(0, abs=1e-15)
    assert before == pytest.approx(-h / t, rel=1e-9)
    assert after == pytest.approx(h / t, rel=1e-3)


@settings(derandomize=True, deadline=None)
@given(decelerations, reactions, st.floats(-1, 3), st.floats(0.001, 1))
def test_allowed_speed_grows_with_the_distance(a: float, t: float, d: float, more: float) -> None:
    assert float(_allowed()(d, a, t)) < float(_allowed()(d + more, a, t))


def test_default_vehicle_without_drag_or_lag_needs_046_m_to_stop_from_022() -> None:
    """0.22²·95/(2·5) = 0.46 m: the bound counts on the thrust alone, drag shortens the real way to 0.35 m."""
    assert float(_allowed()(0.22**2 * 95 / 10, 5 / 95, 1e-9)) == pytest.approx(0.22, abs=1e-6)
