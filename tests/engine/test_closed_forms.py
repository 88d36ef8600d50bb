"""MuJoCo with the force of the water against closed forms, to 1e-4."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from surctl.marine.engine import EngineOptions, MujocoPhysics
from surctl.marine.simulation import Physics
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import Vehicle, plant_state, steady_speed
from surctl.marine.vehicle.geometry import missing_buoyancy
from surctl.marine.vehicle.thrusters import Actuators, Swivel, Thruster
from tests.engine.tools import MIDDLE, NO_DRAG, NO_TILT_DRAG, STILL, load_vehicle, own, physics, with_values

TILTING = load_vehicle("sur540-tilting")
FREE = with_values(TILTING, NO_DRAG | NO_TILT_DRAG)  # no drag
LOOSE = with_values(FREE, {"zg": 0.0, "zt": 0.0})  # nor a righting moment
COUPLED = {  # positive definite, anisotropic, with couplings of all kinds
    **{"m11": 60.0, "m22": 95.0, "m33": 120.0, "m44": 3.0, "mpp": 1.5, "mqq": 2.5},
    **{"m24": 4.0, "m12": 3.0, "m34": -1.0, "muq": -2.5, "mvp": 2.0, "mpq": 0.2},
}
STATE = plant_state(TILTING.form)


def begun(system: Physics, form: object = None, **parts: object) -> Physics:
    layout = plant_state(FREE.form if form is None else form)  # type: ignore[arg-type]
    system.state = layout.pack({"eta": [*MIDDLE, 0.4], **parts})
    return system


def moved(system: Physics, seconds: float, thrust: tuple[float, ...] = (0, 0, 0, 0)) -> NDArray[np.float64]:
    for k in range(round(seconds / 0.025)):
        system.advance(np.array(thrust, dtype=float), k * 0.025)
    return system.state


def momenta(
    system: MujocoPhysics, inertia: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Linear and angular momentum in the world, about its origin, and kinetic energy."""
    rotation = system.data.xmat[system.model.body("hull").id].reshape(3, 3)
    velocity, spin = rotation.T @ system.data.qvel[:3], system.data.qvel[3:]
    nu = np.array([*velocity, spin[2], spin[0], spin[1]])
    momentum = inertia @ nu
    linear, angular = rotation @ momentum[:3], rotation @ momentum[[4, 5, 3]]
    return linear, angular + np.cross(system.data.qpos[:3], linear), float(nu @ momentum / 2)


def period_of(system: Physics, entry: int, rest: float, *, about: float) -> float:
    """Mean period of an entry of the state about its rest, by ten half periods; crossings by cubic interpolation."""
    steps = range(round(5.4 * about / 0.025))
    values = np.array([float(system.advance(np.zeros(4), k * 0.025)[entry]) - rest for k in steps])
    times = CubicSpline(np.arange(len(values)) * 0.025, values).roots(extrapolate=False)
    return float(2 * np.diff(times).mean())


def test_without_drag_momentum_and_energy_stay_for_any_inertia_matrix() -> None:
    vehicle = with_values(LOOSE, COUPLED)
    assert np.linalg.eigvalsh(vehicle.inertia)[0] > 0
    system = physics(vehicle)
    begun(system, vehicle.form, nu=[0.3, -0.2, 0.1, 0.4], tilt=[0.2, -0.1, 0.5, -0.3])
    before = momenta(system, vehicle.inertia)
    moved(system, 5.0)
    after = momenta(system, vehicle.inertia)
    for then, now in zip(before, after, strict=True):
        assert now == pytest.approx(then, rel=1e-4, abs=1e-4 * float(np.max(np.abs(then))))
    assert abs(system.state[12]) + abs(system.state[13]) > 0.3  # it has tumbled


DRAG = ("Xu Xuu", "Yv Yvv", "Zw Zww")


@pytest.mark.parametrize(("dof", "axis"), [(6, 0), (4, 1), (6, 2)])  # the others: study 40
def test_terminal_speed(dof: int, axis: int) -> None:
    vehicle = with_values(TILTING, {"zt": 0.0})
    linear, quadratic = (vehicle[name] for name in DRAG[axis].split())
    thrust = [0.0] * 4
    thrust[axis] = 4.0
    system = begun(physics(vehicle, dof=dof), vehicle.form if dof == 6 else load_vehicle("sur400").form)
    moved(system, 60.0, tuple(thrust))
    assert system.state[4 + axis] == pytest.approx(steady_speed(4.0, linear, quadratic), rel=1e-4)


def test_added_mass_is_felt_on_each_axis() -> None:
    """After t from rest with force F: v = F (t − T + T exp(−t/T)) / m, with the lag T."""
    vehicle = with_values(LOOSE, {name: COUPLED[name] for name in ("m11", "m22", "m33", "m44", "mpp", "mqq")})
    lag, t = vehicle["thrust_lag"], 1.0
    reached = t - lag + lag * np.exp(-t / lag)
    for axis, name in enumerate(("m11", "m22", "m33", "m44")):
        thrust = [0.0] * 4
        thrust[axis] = 0.4
        system = begun(physics(vehicle), vehicle.form)
        system.state = plant_state(vehicle.form).pack({"eta": [*MIDDLE, 0.0]})
        state = moved(system, t, tuple(thrust))
        assert state[4 + axis] == pytest.approx(0.4 * reached / vehicle[name], rel=1e-4), name


def test_coupled_added_mass_is_felt_across_axes() -> None:
    """The first acceleration from rest is M⁻¹ τ."""
    vehicle = with_values(LOOSE, COUPLED | {"thrust_lag": 0.0})
    system = begun(physics(vehicle), vehicle.form)
    system.state = plant_state(vehicle.form).pack({"eta": [*MIDDLE, 0.0]})
    state = moved(system, 0.025, (4.0, 0.0, 0.0, 0.3))
    rate = np.linalg.solve(vehicle.inertia, [4.0, 0.0, 0.0, 0.3, 0.0, 0.0])
    found = np.array([*state[4:8], *state[14:16]]) / 0.025
    assert found == pytest.approx(rate, rel=1e-3, abs=1e-4 * np.abs(rate).max())


def lifted(**options: float) -> Vehicle:
    """A boat of any inertia with two thrusters that push up, a fixed one at the bow and a swivelling one aside."""
    up, curve = (0.0, 0.0, 1.0), ((0.0, 0.0), (1.0, 2.0))
    bow = Thruster("bow", (0.2, 0.0, 0.1), up, forward=2.0, reverse=2.0, curve=curve)
    joint = Swivel((1.0, 0.0, 0.0), (-pi / 2, pi / 2))
    aside = Thruster("aside", (0.0, -0.15, 0.0), up, forward=2.0, reverse=0.0, curve=curve, swivel=joint)
    return replace(with_values(LOOSE, options), actuators=Actuators((bow, aside)))


@pytest.mark.parametrize("lag", [0.0, 0.3])
@pytest.mark.parametrize("inertia", [{}, COUPLED], ids=["own", "coupled"])
def test_each_thruster_turns_the_hull_about_its_own_place(lag: float, inertia: dict[str, float]) -> None:
    """After a short time from rest, M ν = τ (t − T + T exp(−t/T)) with the moments r × F of each thruster, lag T."""
    vehicle, t = lifted(thrust_lag=lag, **inertia), 0.05
    actuators = vehicle.actuators
    assert actuators is not None
    components = np.array([-0.2, 0.1, 0.15])  # N: bow; aside, along and across
    force = actuators.matrix @ components
    extra = np.array([0.0, 0.0, 0.05, 0.0])  # an error of the thrust, which no thruster explains
    system = physics(vehicle)
    system.state = plant_state(vehicle.form).pack({"eta": [*MIDDLE, 0.0]})
    for k in range(2):
        state = system.advance(force + extra, k * 0.025, components)
    across = np.cross((0.0, -0.15, 0.0), (0.0, -0.15, 0.1)) + np.cross((0.2, 0.0, 0.1), (0.0, 0.0, -0.2))
    load = np.array([0.0, -0.15, -0.1 + 0.05, across[2], across[0], across[1]])
    acted = t if lag == 0 else t - lag + lag * np.exp(-t / lag)
    rates = np.linalg.solve(vehicle.inertia, load) * acted
    found = np.array([*state[4:8], *state[14:16]])
    assert found == pytest.approx(rates, abs=1e-4 * np.abs(rates).max())
    assert state[8:12] == pytest.approx((force + extra) * (1 if lag == 0 else 1 - np.exp(-t / lag)), rel=1e-6)
    assert abs(across[0]) > 0.01 and abs(across[1]) > 0.01  # it rolls and pitches


def test_neutral_buoyancy_rests() -> None:
    system = begun(physics(TILTING), TILTING.form)
    assert moved(system, 20.0)[:8] == pytest.approx([*MIDDLE, 0.4, 0, 0, 0, 0], abs=1e-9)


@pytest.mark.parametrize("axis", [0, 1])
def test_period_of_roll_and_pitch(axis: int) -> None:
    """T = 2π √(I / (W |z_g|)) at small angles, from the zero crossings of ten half periods."""
    tilt = [0.0] * 4
    tilt[axis] = 1e-3
    system = begun(physics(FREE), FREE.form, tilt=tilt)
    period = 2 * pi * sqrt(FREE["mpp"] / (FREE["weight"] * -FREE["zg"]))
    assert period_of(system, 12 + axis, 0.0, about=period) == pytest.approx(period, rel=1e-4)


def test_emerged_sphere_floats_by_archimedes() -> None:
    """Heave period of a ballasted sphere at its waterline: T = 2π √(m / (ρ g A)) at small amplitudes."""
    vehicle = with_values(LOOSE, {})
    scenario = replace(STILL, depth=-0.15)
    array = scenario.sensors.array_on(vehicle["radius"])
    system = MujocoPhysics(build_world(scenario, vehicle, seed=0), vehicle, array, EngineOptions(surface=1.0))
    system.state = STATE.pack({"eta": [200, 200, -0.1499, 0]})
    area = pi * (vehicle["radius"] ** 2 - 0.15**2)
    period = 2 * pi * sqrt(vehicle["m33"] / (1000 * 9.81 * area))
    assert period_of(system, 2, -0.15, about=period) == pytest.approx(period, rel=1e-4)
    assert missing_buoyancy(0.27, -0.15) == pytest.approx(102.1, abs=0.05)


def boxed(height: float, **values: float) -> MujocoPhysics:
    """A box of 0.8 m × 0.5 m × 0.4 m that is as heavy as the water that it displaces where it floats at z = height."""
    scenario = replace(STILL, depth=height)
    vehicle = with_values(LOOSE, {"xb": 0.0, "yb": 0.0, "zb": 0.0, **values})
    array, options = scenario.sensors.array_on(vehicle["radius"]), EngineOptions(surface=1.0, box=(0.8, 0.5, 0.4))
    return MujocoPhysics(build_world(scenario, vehicle, seed=0), vehicle, array, options)


def test_emerged_box_floats_by_archimedes() -> None:
    """Heave period at the water line: T = 2π √(m / (ρ g L B)), as long as the sides stay in the water."""
    system = boxed(-0.15)
    system.state = STATE.pack({"eta": [200, 200, -0.12, 0.3]})
    period = 2 * pi * sqrt(LOOSE["m33"] / (1000 * 9.81 * 0.8 * 0.5))
    assert period_of(system, 2, -0.15, about=period) == pytest.approx(period, rel=1e-4)


@pytest.mark.parametrize(("axis", "length", "width"), [(0, 0.8, 0.5), (1, 0.5, 0.8)])
def test_emerged_box_rolls_by_its_metacentre(axis: int, length: float, width: float) -> None:
    """T = 2π √(I / K) with K = ρ g (L B³ / 12 − e V / 2) + W |z_g| for the part that is out of the water.

    The emerged volume V = L B e with e = 0.05 m has its centre at 0.2 − e/2 = 0.175 m above the origin, and lifts less.
    """
    system = boxed(-0.15, zg=-0.05)
    tilt = [0.0] * 4
    tilt[axis] = 1e-3
    system.state = STATE.pack({"eta": [200, 200, -0.15, 0.3], "tilt": tilt})
    emerged = 0.05
    water = 1000 * 9.81 * (length * width**3 / 12 - length * width * emerged * (0.2 - emerged / 2))
    stiffness = water + LOOSE["weight"] * 0.05
    period = 2 * pi * sqrt(LOOSE["mpp"] / stiffness)
    assert period_of(system, 12 + axis, 0.0, about=period) == pytest.approx(period, rel=1e-4)


def test_coupled_vehicle_moves_as_in_the_own_plant() -> None:
    """Two derivations of the same equations: MuJoCo's frames and quaternion, and the plant's Euler angles."""
    vehicle = with_values(TILTING, COUPLED | {"Yr": 3.0, "Kvp": 1.0, "Z0": -2.0, "xb": 0.001})
    start = {"nu": [0.2, -0.1, 0.05, 0.3], "tilt": [0.1, -0.05, 0.2, -0.1], "tau": [1.0, 0.5, -0.5, 0.1]}
    ends = [
        moved(begun(system, vehicle.form, **start), 5.0, (4.0, -3.0, 1.0, 0.3))
        for system in (own(vehicle), physics(vehicle))
    ]
    assert ends[1] == pytest.approx(ends[0], rel=1e-4, abs=1e-5)


def test_a_steered_craft_turns_as_in_the_own_plant_with_the_side_force_of_its_rudder() -> None:
    craft = load_vehicle("remus100")
    there, here = (begun(made(craft), craft.form, nu=(1.2, 0, 0, 0)) for made in (physics, own))
    steered = (8.0, -4.0, 0.0, 3.0)  # the rudder pushes the stern to starboard
    for system in (there, here):
        moved(system, 3.0, steered)
    assert np.abs(there.state - here.state).max() < 1e-6
    assert abs(float(here.state[5])) > 0.03  # it drifts


def test_a_far_wall_is_measured() -> None:
    far = begun(physics(FREE)).clearance([])[1]
    assert far == pytest.approx(begun(own(FREE)).clearance([])[1], abs=1e-9) and far > 199


def test_the_state_can_be_set_and_read_back() -> None:
    value = STATE.pack(
        {"eta": [*MIDDLE, 9.0], "nu": [0.1, 0.2, 0.3, 0.4], "tau": [1, 2, 3, 0.1], "tilt": [0.3, -0.2, 0.1, 0]}
    )
    system = physics(TILTING)
    system.state = value
    assert system._read() == pytest.approx(value, abs=1e-12)
