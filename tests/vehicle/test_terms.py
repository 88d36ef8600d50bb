"""The optional terms of the dynamics: coupled inertia, cross drag, constant forces, less thrust astern than ahead."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from surctl.errors import InputError, NotApplicable
from surctl.marine.control import PARAMETERS, load_gains
from surctl.marine.simulation import law_numbers, load_scenario
from surctl.marine.simulation.physics import advance
from surctl.marine.simulation.safety import safety_claim
from surctl.marine.vehicle import (
    PLANT_DISTURBANCE,
    PLANT_STATE,
    SPECS,
    TERMS,
    Parameter,
    PlantForm,
    Vehicle,
    build_plant,
    linearise,
    load_vehicle,
    plant_layout,
    plant_parameters,
    trim_thrust,
    write_vehicle,
)
from surctl.marine.verification import cruise_loop
from surctl.marine.verification.braking_claims import braking_keeps

Array = NDArray[np.float64]
STILL = PLANT_DISTURBANCE.pack()
COUPLED = {"m24": 1.0, "m13": -1.5, "m14": 0.4, "Yr": 2.0, "Nv": -1.0, "Nuv": 3.0, "Yrv": 4.0, "Y0": 0.2, "Z0": -0.3}
COUPLED |= {"Yuv": 1.5, "Nur": 0.3}


def boat(values: Mapping[str, float], base: str = "bluerov2-wu") -> Vehicle:
    plain = load_vehicle(base)
    added = {name: Parameter(values[name], TERMS[name].unit, None, "test") for name in TERMS if name in values}
    return replace(plain, parameters={**plain.parameters, **added})


def kirchhoff(inertia: Array, load: Callable[[Array], Array]) -> Callable[[float, Array], Array]:
    """Equations of motion from the momentum in the world frame, without C(ν): (x, y, ψ, P_x, P_y, P_z, L)."""
    inverse = np.linalg.inv(inertia)

    def rate(_t: float, s: Array) -> Array:
        c, n = np.cos(s[2]), np.sin(s[2])
        turn = np.array([[c, -n], [n, c]])
        body = inverse @ np.array([*(turn.T @ s[3:5]), s[5], s[6]])
        force = load(body)
        over_ground = turn @ body[:2]
        pushed = turn @ force[:2]
        # the moment about the moving hull changes by v × P as the hull moves
        turned = force[3] - (over_ground[0] * s[4] - over_ground[1] * s[3])
        return np.array([*over_ground, body[3], *pushed, force[2], turned])

    return rate


def test_units_follow_from_the_names() -> None:
    units = {"m12": "kg", "m24": "kg m", "Yr": "N s", "Nv": "N s", "Xv": "N s/m", "Nuv": "N s^2/m", "Yrr": "N s^2"}
    units |= {"Nur": "N s^2", "Yuv": "N s^2/m^2", "Xrv": "N s^2/m", "N0": "N m", "Y0": "N", "Fu_reverse": "N"}
    for name, unit in units.items():
        assert SPECS[name].unit == unit
    assert "Yx" not in SPECS
    assert not set(TERMS) & set(load_vehicle("sur400").parameters)


@settings(derandomize=True, deadline=None, max_examples=20)
@given(st.tuples(*[st.floats(-0.9, 0.9)] * 4), st.integers(0, 2**32 - 1))
def test_coupled_bodies_move_as_the_momentum_in_the_world_frame_demands(nu: tuple[float, ...], seed: int) -> None:
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(4, 4))
    inertia = half @ half.T + np.diag([8.0, 9.0, 10.0, 2.0])
    values = {f"m{i + 1}{i + 1}": inertia[i, i] for i in range(4)}
    couplings = {f"m{i + 1}{j + 1}": inertia[i, j] for i in range(4) for j in range(i + 1, 4)}
    drag = {name: float(rng.uniform(-0.2, 0.2)) for name in ("Yr", "Nv", "Nuv", "Yrv", "Xvr", "Zu", "Y0", "N0", "X0")}
    vehicle = boat(couplings | drag).with_values(values)
    x = PLANT_STATE.pack({"eta": [0.3, -0.2, 0, 0.7], "nu": nu})
    rate = np.asarray(build_plant(vehicle.form).ode(x, np.zeros(4), STILL, plant_parameters(vehicle))).reshape(-1)
    u, v, _w, r = nu
    by = {"u": u, "v": v, "w": nu[2], "r": r}
    force = -(vehicle.linear_drag + vehicle.quadratic_drag * np.abs(nu)) * nu
    for name, value in drag.items():
        axis = "XYZN".index(name[0])
        speed = -1.0 if name[1] == "0" else by[name[1]] if len(name) == 2 else abs(by[name[1]]) * by[name[2]]
        force[axis] -= value * speed
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s], [s, c]])
    p = inertia @ np.array(nu)
    there = kirchhoff(inertia, lambda _: force)(0.0, np.array([0, 0, 0.7, *(turn @ p[:2]), p[2], p[3]]))
    # d(Mν)/dt in the turning frame
    ahead = turn.T @ there[3:5] - r * np.array([-p[1], p[0]])
    expected = np.linalg.solve(inertia, np.array([*ahead, there[5], there[6]]))
    np.testing.assert_allclose(rate[4:8], expected, rtol=1e-10, atol=1e-10)


def test_a_coupled_flight_equals_an_independent_integration() -> None:
    vehicle = boat({**COUPLED, "Y0": 0.0, "Z0": 0.0}).with_values({"thrust_lag": 0.0})
    tau = np.array([6.0, 1.0, 0.5, 0.3])
    x, step, p = PLANT_STATE.pack({"eta": [0, 0, 0, 0.4]}), advance(vehicle.form), plant_parameters(vehicle)
    for _ in range(400):
        x = np.asarray(step(x, tau, STILL, p)).reshape(-1)

    def load(nu: Array) -> Array:
        u, v, _, r = nu
        cross = np.array([0, 2.0 * r + (4.0 * abs(r) + 1.5 * abs(u)) * v, 0, -1.0 * v + abs(u) * (3.0 * v + 0.3 * r)])
        drag = (vehicle.linear_drag + vehicle.quadratic_drag * np.abs(nu)) * nu + cross
        return np.asarray(tau - drag)

    rate = kirchhoff(vehicle.inertia, load)
    run = solve_ivp(rate, (0, 10), [0, 0, 0.4, 0, 0, 0, 0], method="DOP853", rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(x[[0, 1, 3]], run.y[:3, -1], rtol=1e-8, atol=1e-8)


def test_zero_drag_conserves_energy_and_both_momenta() -> None:
    names = ("Xu", "Yv", "Zw", "Nr", "Xuu", "Yvv", "Zww", "Nrr")
    vehicle = boat({"m24": 1.0, "m13": -1.5, "m14": 0.4, "m12": 1.0}).with_values(dict.fromkeys(names, 0.0))
    x = PLANT_STATE.pack({"eta": [1, 2, 0, 0.7], "nu": [0.3, 0.08, 0.04, 0.2]})
    step, p = advance(vehicle.form), plant_parameters(vehicle)

    def invariants(x: Array) -> Array:
        momentum = vehicle.inertia @ x[4:8]
        c, s = np.cos(x[3]), np.sin(x[3])
        px, py = c * momentum[0] - s * momentum[1], s * momentum[0] + c * momentum[1]
        return np.array([x[4:8] @ momentum / 2, px, py, momentum[2], momentum[3] + x[0] * py - x[1] * px])

    start, headings = invariants(x), [x[3]]
    for _ in range(800):
        x = np.asarray(step(x, np.zeros(4), STILL, p)).reshape(-1)
        headings.append(x[3])
    np.testing.assert_allclose(invariants(x), start, rtol=1e-8, atol=1e-8)
    assert np.ptp(headings) > 0.5


def test_without_terms_the_plant_is_that_of_the_paper() -> None:
    vehicle = load_vehicle("bluerov2-wu")
    assert vehicle.form == PlantForm()
    assert build_plant() is build_plant(vehicle.form)
    zero = boat(dict.fromkeys(COUPLED, 0.0))
    x = PLANT_STATE.pack({"eta": [1, 2, 3, 0.4], "nu": [0.3, -0.2, 0.1, 0.5], "tau": [1, 2, 3, 0.4]})
    there, here = (
        np.asarray(build_plant(v.form).ode(x, np.ones(4), STILL, plant_parameters(v))).reshape(-1)
        for v in (vehicle, zero)
    )
    np.testing.assert_allclose(here, there, rtol=1e-13, atol=1e-14)


def test_thrust_astern_is_limited_separately() -> None:
    vehicle = boat({"Fu_reverse": 10.0}).with_values({"thrust_lag": 0.0})
    assert vehicle.thrust_limit.tolist() == [10.0, 40.0, 40.0, 10.0]
    assert vehicle.thrust_range.tolist() == [[-10.0, -40.0, -40.0, -10.0], [40.0, 40.0, 40.0, 10.0]]
    for command, mass in ((np.array([99.0, 0, 0, 0]), 40.0), (np.array([-99.0, 0, 0, 0]), -10.0)):
        rate = build_plant(vehicle.form).ode(PLANT_STATE.pack(), command, STILL, plant_parameters(vehicle))
        assert float(rate[4]) == mass / vehicle["m11"]
    linearise(vehicle, np.array([0.9, 0, 0, 0]))  # 18.3 N ahead
    with pytest.raises(InputError, match=r"lies between \[-10\.0, .*\] and \[40\.0"):
        linearise(vehicle, np.array([-0.9, 0, 0, 0]))


def test_jacobians_of_a_coupled_plant_are_its_slopes() -> None:
    vehicle = boat(COUPLED)
    nu = np.array([0.4, 0.0, 0.0, 0.0])
    plant = linearise(vehicle, nu)
    tau, p = trim_thrust(vehicle, nu), plant_parameters(vehicle)
    assert tau[1] == pytest.approx(-0.2)
    assert tau[2] == pytest.approx(0.3)
    x = PLANT_STATE.pack({"nu": nu, "tau": tau})
    ode = build_plant(vehicle.form).ode
    assert np.abs(np.asarray(ode(x, tau, STILL, p)).reshape(-1)[4:]).max() < 1e-12
    # the drag |v| v has no slope at v = 0 that differences could miss
    for k in range(12):
        step = np.zeros(12)
        step[k] = 1e-6
        slope = (np.asarray(ode(x + step, tau, STILL, p)) - np.asarray(ode(x - step, tau, STILL, p))).reshape(-1) / 2e-6
        np.testing.assert_allclose(np.asarray(plant.A)[:, k], slope, rtol=1e-5, atol=2e-5)


def test_laws_know_the_drag_at_their_cruise_speed() -> None:
    vehicle, plain = boat({"Yuv": 2.0, "Nur": 0.5, "Nuv": 1.0}), load_vehicle("bluerov2-wu")
    assert vehicle.drag_at(0.4).tolist() == [plain["Xu"], plain["Yv"] + 0.8, plain["Zw"], plain["Nr"] + 0.2]
    assert plain.drag_at(0.4).tolist() == plain.linear_drag.tolist()
    same = plain.with_values({"Yv": plain["Yv"] + 0.8, "Nr": plain["Nr"] + 0.2})
    gains = load_gains("default").values
    there = cruise_loop(same, gains, cruise=0.4, dt=0.05)
    np.testing.assert_allclose(cruise_loop(vehicle, gains, cruise=0.4, dt=0.05).law[1], there.law[1], rtol=1e-12)
    scenario = replace(load_scenario("tank-static"), cruise=0.4)
    numbers = [
        law_numbers(scenario, load_gains("default"), v)[PARAMETERS.slice("linear_drag")] for v in (vehicle, same)
    ]
    np.testing.assert_allclose(*numbers, rtol=1e-12)


def test_files_with_terms_are_read_and_written(tmp_path: Path) -> None:
    file = tmp_path / "boat.toml"
    vehicle = boat({**COUPLED, "Fu_reverse": 20.0})
    file.write_text(write_vehicle(vehicle))
    again = load_vehicle(str(file))
    assert dict(again.parameters) == dict(vehicle.parameters)
    assert again.digest() == vehicle.digest() != load_vehicle("bluerov2-wu").digest()
    assert plant_layout(again.form).size == 17 + len(COUPLED) + 1


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('m24 = "1 kg"', r"inertia\.m24 = 'kg': wrong unit; give it in kg m"),
        ('m24 = "2.7 kg m"', r"inertia\.m24 = 2\.7: makes the inertia matrix indefinite; .* = 2\.603 kg m"),
        ('m42 = "1 kg m"', r"inertia\.m42: unknown key; did you mean 'm44'"),
        ('m24 = { value = 1, unit = "kg m", range = [2, -1] }', r"inertia\.m24\.range .* is not a range"),
    ],
)
def test_wrong_terms_are_one_line(tmp_path: Path, line: str, message: str) -> None:
    text = write_vehicle(load_vehicle("bluerov2-wu"))
    file = tmp_path / "boat.toml"
    file.write_text(text.replace("[inertia]", f'[inertia]\nprovenance = "test"\n{line}'))
    with pytest.raises(InputError, match=message):
        load_vehicle(str(file))


def test_claims_about_equation_3_do_not_apply_to_coupled_vehicles() -> None:
    vehicle, gains = boat({"m24": 0.1}, "sur400"), load_gains("default")
    for claim in (
        lambda: braking_keeps(vehicle, 0.2),
        lambda: safety_claim(load_scenario("pool-behind"), vehicle, gains),
    ):
        with pytest.raises(NotApplicable, match=r"it has m24, and the claim assumes equation \(3\)"):
            claim()
