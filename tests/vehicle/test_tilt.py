"""Roll and pitch: six degrees of freedom against an independent integration, closed forms, and the whole chain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.simulation import Case, load_scenario, simulate, simulate_batch
from surctl.marine.simulation.fit import tilt_findings
from surctl.marine.simulation.physics import advance
from surctl.marine.vehicle import (
    PLANT_DISTURBANCE,
    TERMS,
    Parameter,
    Vehicle,
    build_plant,
    linearise,
    load_vehicle,
    plant_parameters,
    plant_state,
    trim_thrust,
)
from surctl.marine.vehicle.dynamics import trim_function
from surctl.marine.vehicle.motion_log import heading_frame
from surctl.marine.verification import linear_table

Array = NDArray[np.float64]
STILL = PLANT_DISTURBANCE.pack()
G = 9.81
TILT = {
    "mpp": 0.30, "mqq": 0.35, "weight": 11.5 * G, "buoyancy": 11.6 * G, "zg": -0.02, "xb": 0.003, "zt": 0.05,
    "Kp": 0.4, "Mq": 0.5, "Kpp": 0.9, "Mqq": 1.1, "muq": 0.20, "mvp": -0.25, "m24": 0.30, "Nv": 0.5, "Kv": 0.3,
    "Muq": 0.2, "mpr": 0.01,
}  # fmt: skip
"""Numbers in the order of magnitude of a BlueROV2."""
ORDER = [0, 1, 2, 4, 5, 3]  # (u, v, w, p, q, r) in the toolkit's order (u, v, w, r, p, q)


def boat(values: dict[str, float]) -> Vehicle:
    plain = load_vehicle("bluerov2-wu")
    added = {name: Parameter(values[name], TERMS[name].unit, None, "test") for name in TERMS if name in values}
    return replace(plain, parameters={**plain.parameters, **added})


def skew(a: Array) -> Array:
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def rotation(roll: float, pitch: float, yaw: float) -> Array:
    def about(axis: int, angle: float) -> Array:
        c, s, m = np.cos(angle), np.sin(angle), np.eye(3)
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        m[i, i] = m[j, j] = c
        m[i, j], m[j, i] = -s, s
        return m

    return about(2, yaw) @ about(1, pitch) @ about(0, roll)


class Fossen:
    """Fossen (2021), equations 6.43 to 6.45 and 4.6, in the frame of the hull with a rotation matrix for attitude."""

    def __init__(self, vehicle: Vehicle, tau: Array) -> None:
        self.v, self.tau = vehicle, tau
        self.m = vehicle.inertia[np.ix_(ORDER, ORDER)]
        self.inverse = np.linalg.inv(self.m)

    def rate(self, _t: float, s: Array) -> Array:
        v, nu, turn = self.v, s[12:], s[3:12].reshape(3, 3)
        m11, m12, m21, m22 = self.m[:3, :3], self.m[:3, 3:], self.m[3:, :3], self.m[3:, 3:]
        c = np.zeros((6, 6))
        c[:3, 3:] = c[3:, :3] = -skew(m11 @ nu[:3] + m12 @ nu[3:])
        c[3:, 3:] = -skew(m21 @ nu[:3] + m22 @ nu[3:])
        linear = np.array([v["Xu"], v["Yv"], v["Zw"], v["Kp"], v["Mq"], v["Nr"]])
        square = np.array([v["Xuu"], v["Yvv"], v["Zww"], v["Kpp"], v["Mqq"], v["Nrr"]])
        drag = linear * nu + square * np.abs(nu) * nu
        drag[5] += v["Nv"] * nu[1]
        drag[3] += v["Kv"] * nu[1]
        drag[4] += v["Muq"] * abs(nu[0]) * nu[4]
        down = turn.T @ np.array([0, 0, -1.0])
        g, b = np.array([0, 0, v["zg"]]), np.array([v["xb"], 0, 0])
        weight = np.concatenate([v["weight"] * down, np.cross(g, v["weight"] * down)])
        floats = np.concatenate([-v["buoyancy"] * down, np.cross(b, -v["buoyancy"] * down)])
        push = np.concatenate([self.tau[:3], np.cross([0, 0, v["zt"]], self.tau[:3])])
        push[5] += self.tau[3]
        rates = self.inverse @ (push + weight + floats - c @ nu - drag)
        return np.concatenate([turn @ nu[:3], (turn @ skew(nu[3:])).ravel(), rates])


def test_six_degrees_of_freedom_equal_an_independent_integration() -> None:
    vehicle = boat(TILT).with_values({"thrust_lag": 0.0})
    tau = np.array([12.0, 3.0, 1.5, 0.6])
    roll, pitch, yaw = 0.3, -0.2, 0.5
    body = np.array([0.2, -0.1, 0.05, 0.1, -0.2, 0.15])
    start = np.concatenate([[1, 2, -3], rotation(roll, pitch, yaw).ravel(), body])
    run = solve_ivp(Fossen(vehicle, tau).rate, (0, 5), start, method="DOP853", rtol=1e-12, atol=1e-12)
    end, turn = run.y[:, -1], run.y[3:12, -1].reshape(3, 3)

    level = rotation(roll, pitch, 0) @ body[:3]
    yaw_rate = (body[4] * np.sin(roll) + body[5] * np.cos(roll)) / np.cos(pitch)
    layout = plant_state(vehicle.form)
    tilt = [roll, pitch, body[3], body[4]]
    x = layout.pack({"eta": [1, 2, -3, yaw], "nu": [*level, yaw_rate], "tilt": tilt})
    step, p = advance(vehicle.form), plant_parameters(vehicle)
    for _ in range(200):
        x = np.asarray(step(x, tau, STILL, p)).reshape(-1)

    heading = np.arctan2(turn[1, 0], turn[0, 0])
    np.testing.assert_allclose(x[:3], end[:3], atol=1e-7)
    np.testing.assert_allclose(np.exp(1j * x[3]), np.exp(1j * heading), atol=1e-7)
    np.testing.assert_allclose(x[4:7], rotation(0, 0, heading).T @ turn @ end[12:15], atol=1e-7)
    np.testing.assert_allclose(x[12:14], [np.arctan2(turn[2, 1], turn[2, 2]), -np.arcsin(turn[2, 0])], atol=1e-7)
    np.testing.assert_allclose(x[14:], end[15:17], atol=1e-7)
    assert abs(x[13]) > 0.02  # the vehicle does pitch


def test_the_velocity_of_the_hull_is_converted_to_the_heading_frame() -> None:
    roll, pitch, body = 0.4, -0.6, np.array([0.3, -0.2, 0.1])
    velocity = heading_frame(body, roll=roll, pitch=pitch)
    np.testing.assert_allclose(velocity, rotation(roll, pitch, 0) @ body, rtol=1e-12)
    many = heading_frame(np.tile(body, (5, 1)), roll=np.full(5, roll), pitch=pitch)
    np.testing.assert_allclose(many, np.tile(velocity, (5, 1)))


def test_energy_is_conserved_without_drag() -> None:
    drags = {name: 0.0 for name in TILT if TERMS[name].table == "drag"}
    plain = dict.fromkeys(("Xu", "Yv", "Zw", "Nr", "Xuu", "Yvv", "Zww", "Nrr"), 0.0)
    vehicle = boat({**TILT, **drags}).with_values(plain)
    layout, p = plant_state(vehicle.form), plant_parameters(vehicle)
    x = layout.pack({"nu": [0.2, 0.1, 0.0, 0.1], "tilt": [0.3, 0.2, 0.1, -0.1]})

    def energy(x: Array) -> float:
        roll, pitch, p_, q = x[12:]
        turn = rotation(roll, pitch, 0)
        r = (x[7] * np.cos(pitch) - q * np.sin(roll)) / np.cos(roll)
        nu = np.array([*(turn.T @ x[4:7]), r, p_, q])
        height = x[2] * np.ones(2) + [turn[2] @ [0, 0, vehicle["zg"]], turn[2] @ [vehicle["xb"], 0, 0]]
        return float(nu @ vehicle.inertia @ nu / 2 + vehicle["weight"] * height[0] - vehicle["buoyancy"] * height[1])

    start, step, pitches = energy(x), advance(vehicle.form), []
    for _ in range(400):
        x = np.asarray(step(x, np.zeros(4), STILL, p)).reshape(-1)
        pitches.append(x[13])
    assert energy(x) == pytest.approx(start, abs=1e-7)
    assert np.ptp(pitches) > 0.1


def test_roll_period_and_tilt_at_rest_have_closed_forms() -> None:
    values = {"mpp": 0.30, "mqq": 0.35, "weight": 110.0, "buoyancy": 110.0, "zg": -0.02, "xg": 0.004}
    vehicle = boat(values)
    tilt = np.asarray(trim_function(vehicle.form)(np.zeros(4), plant_parameters(vehicle))[1]).ravel()
    # the centre of gravity hangs below the centre of buoyancy: the bow sinks
    np.testing.assert_allclose(tilt, [0, np.arctan2(0.004, 0.02), 0, 0], atol=1e-9)
    level = boat({**values, "xg": 0.0})
    plant = linearise(level, np.zeros(4))
    rates = np.linalg.eigvals(np.asarray(plant.A)[12:, 12:])
    # roll and pitch couple to nothing at rest
    np.testing.assert_allclose(
        sorted(abs(rates.imag)), np.sqrt([110 * 0.02 / 0.35] * 2 + [110 * 0.02 / 0.30] * 2), rtol=1e-9
    )


def test_trim_includes_the_attitude_that_thrust_causes() -> None:
    vehicle, nu = boat({**TILT, "buoyancy": 11.5 * G, "xb": 0.0}), np.array([0.5, 0.0, 0.0, 0.0])
    tau, p = trim_thrust(vehicle, nu), plant_parameters(vehicle)
    tilt = np.asarray(trim_function(vehicle.form)(nu, p)[1]).ravel()
    x = plant_state(vehicle.form).pack({"nu": nu, "tau": tau, "tilt": tilt})
    rate = np.asarray(build_plant(vehicle.form).ode(x, tau, STILL, p)).ravel()
    np.testing.assert_allclose(rate, [0.5, *[0] * 15], atol=1e-9)
    assert tilt[1] > 0.02  # thrust above the centre lowers the bow
    table = linear_table(vehicle, {}, base=load_gains("default").values, cruise=0.2, dt=0.05)
    assert np.isfinite(table["disk_margin"]).all()


def test_a_current_moves_the_vehicle_as_it_moves_the_water() -> None:
    vehicle = boat(TILT)
    layout, p, ode = plant_state(vehicle.form), plant_parameters(vehicle), build_plant(vehicle.form).ode
    tilt, tau = [0.2, -0.1, 0.3, 0.1], np.array([3.0, 1, 0, 0.2])
    still = np.asarray(ode(layout.pack({"nu": [0.2, 0.1, 0, 0.3], "tau": tau, "tilt": tilt}), tau, STILL, p)).ravel()
    drifting = layout.pack({"nu": [0.5, -0.1, 0.1, 0.3], "tau": tau, "tilt": tilt})
    flow = PLANT_DISTURBANCE.pack({"current": [0.3, -0.2, 0.1]})
    moved = np.asarray(ode(drifting, tau, flow, p)).ravel()
    # the same forces; in the turning heading frame the current has the rate −r e_z × c
    np.testing.assert_allclose(moved[4:8] - still[4:8], 0.3 * np.array([-0.2, -0.3, 0, 0]), atol=1e-12)
    np.testing.assert_allclose(moved[12:], still[12:], atol=1e-12)


def test_both_loops_fly_a_vehicle_that_rolls_and_pitches() -> None:
    vehicle = boat({**TILT, "buoyancy": 11.5 * G})
    scenario = replace(load_scenario("tank-speed-015"), time_limit=2.0)
    case = Case(scenario, vehicle, load_gains("default"), law="closed_form")
    run = simulate(scenario, vehicle, gains=case.gains, law=case.build(), seed=0)
    table = simulate_batch(case, {}, seeds=[0])
    assert table.column("deviation_m")[0] == pytest.approx(run.metrics.deviation_m, abs=1e-9)


def test_roll_and_pitch_need_inertia_weight_and_buoyancy() -> None:
    with pytest.raises(InputError, match=r"attitude\.buoyancy: is missing in a vehicle with other terms of roll"):
        boat({"mpp": 0.3, "mqq": 0.3, "weight": 100.0}).with_values({"mpp": 0.4})


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"buoyancy": 10.0 * G}, None),
        ({"weight": 170.0}, "bluerov2-wu sinks: 56.2 N act on it vertically, and the heave thrust reaches 40 N"),
        ({"zg": 0.01, "xb": 0.0}, "bluerov2-wu capsizes: its centre of gravity is not below its centre of buoyancy"),
        ({"zt": 0.10}, "full thrust tilts bluerov2-wu by 61 deg in pitch, because it acts 0.1 m from the centre"),
        ({"xg": 0.02}, "at the cruise speed of 0.2 m/s bluerov2-wu is tilted by"),
    ],
)
def test_lint_finds_tilt_and_lacking_buoyancy(values: dict[str, float], text: str | None) -> None:
    vehicle = boat({**TILT, "zt": 0.0, **values})
    texts = [f.text for f in tilt_findings(load_scenario("tank-static"), vehicle)]
    assert (texts == []) if text is None else any(text in line for line in texts)


def test_lint_finds_net_buoyancy_without_roll_and_pitch() -> None:
    plain = load_vehicle("bluerov2-wu")
    light = replace(plain, parameters={**plain.parameters, "Z0": Parameter(41.0, "N", None, "test")})
    (finding,) = tilt_findings(load_scenario("tank-static"), light)
    assert finding.text.startswith("bluerov2-wu rises: 41 N act on it vertically, and the heave thrust reaches 40 N")
    assert not tilt_findings(load_scenario("tank-static"), plain)
