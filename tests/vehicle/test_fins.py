"""Rudders and other fins: their force grows with the squared speed, in vehicle, allocation, law and both loops."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.allocation import allocate
from surctl.marine.control import build_law, law_source, load_gains
from surctl.marine.control.steering import turning_radius
from surctl.marine.simulation import METRICS, Case, Scenario, law_numbers, simulate, simulate_batch
from surctl.marine.simulation.fit import held_share, thruster_findings
from surctl.marine.simulation.physics import advance
from surctl.marine.simulation.scenario import Disturbance
from surctl.marine.simulation.thruster_faults import Thrusters, thruster_use
from surctl.marine.tuning.request import default_tuned
from surctl.marine.vehicle import LIBRARY, PLANT_DISTURBANCE, PLANT_STATE, load_vehicle, plant_parameters
from surctl.marine.vehicle.thruster_file import axis_limits
from tests.craft import mission
from tests.tools import need_compiler

REMUS = load_vehicle("remus100")
GAINS = load_gains("default", own=law_source("steered").gains)
TURN = [[30.0, 30.0], [42.0, 30.0], [42.0, 60.0]]


def turning(seconds: float) -> Scenario:
    """Two legs in a current ahead, so that the water passes the rudder faster than the ground."""
    scenario = mission(TURN, "remus", size=(120.0, 120.0), time=seconds)
    return replace(scenario, disturbance=Disturbance(current_m_per_s=(-0.2, 0.0)))


def test_the_yaw_moment_is_lift_arm_deflection_and_squared_speed() -> None:
    assert REMUS.actuators is not None
    for speed in (0.0, 0.4, 1.0, 2.0):
        moment = 0.638 * 9.64 * np.radians(13.6) * speed**2
        assert axis_limits(REMUS.actuators, speed) == pytest.approx([10.1, 0, 0, moment], abs=1e-9)
        result = allocate(REMUS.actuators, [3.0, 0.0, 0.0, 1e-3 + 2 * moment], speed=speed)
        assert result.achieved == pytest.approx([3.0, -moment / 0.638, 0.0, moment], abs=1e-9)
        assert result.commands[1] == pytest.approx(-1.0 if speed else 0.0)
    slow = REMUS.at_speed(0.5)
    assert slow.at_speed(1.0)["Fr_max"] == pytest.approx(REMUS["Fr_max"])
    assert slow["Fr_max"] == pytest.approx(0.25 * REMUS["Fr_max"]) and slow.fin_share(0.5) == 1.0
    assert held_share(slow) == pytest.approx(1.0) and thruster_findings(slow) == []


def test_fins_of_an_x_tail_turn_without_heave_and_count_in_yaw_only() -> None:
    craft = load_vehicle("eca-a9")
    assert craft.actuators is not None
    assert craft.thrust_limit == pytest.approx([52.9, 0.0, 0.0, 11.324], abs=1e-3)
    assert allocate(craft.actuators, [0.0, 0.0, 0.0, 5.0]).achieved[2] == pytest.approx(0.0, abs=1e-12)


def test_the_otter_turns_by_its_propellers_at_any_speed() -> None:
    otter = load_vehicle("otter")
    assert otter.fin_share(1.0) == 0.0 and otter.at_speed(0.1) is otter
    assert [one.level for one in thruster_findings(otter)] == ["info"]
    # published: Yr = 7.25, Nv = -0.03, above 2 sqrt(Yv Nr); with these as the diagonal it is below
    ship = load_vehicle("cybership2")
    assert "drag.Yr" in {one.key for one in thruster_findings(ship)}
    assert "drag.Yr" not in {one.key for one in thruster_findings(ship.with_values({"Yv": 7.25, "Nr": 7.25}))}


def test_a_steady_yaw_rate_exists_where_all_damping_grows_with_the_speed() -> None:
    craft = load_vehicle("eca-a9").at_speed(0.79)
    rate = craft.steady_yaw(0.85, 0.79)
    assert rate * 32.0 * 0.79 == pytest.approx(0.85 * craft["Fr_max"])


def test_the_radius_of_a_rudder_craft_hardly_depends_on_its_speed() -> None:
    radii = [turning_radius(REMUS, {"sideslip": 0.2}, speed) for speed in (0.3, 0.6, 1.2)]
    assert np.ptp(radii) < 1e-9 * radii[0]


def test_the_planned_yaw_rate_of_a_craft_that_drifts_inwards_is_one_that_its_fins_sustain() -> None:
    craft = load_vehicle("eca-a9")
    assert craft.centripetal(0.79) < 0 < craft.munk(0.79)
    moment = 0.85 * craft.at_speed(0.79)["Fr_max"]
    x, still, p = PLANT_STATE.pack({"nu": [0.79, 0, 0, 0]}), PLANT_DISTURBANCE.pack(), plant_parameters(craft)
    move = advance(craft.form).fold(1200)
    x = move(x, [8.0 * 0.79**2, -moment / 0.708, 0.0, moment], still, p).full().ravel()
    sustained = float(x[7])
    planned = 0.79 / turning_radius(craft, {"sideslip": 0.2}, 0.79)
    assert 0.4 * sustained < planned < sustained


def test_both_loops_agree_and_the_water_sets_the_force() -> None:
    need_compiler()
    scenario = turning(12.0)
    run = simulate(scenario, REMUS, gains=GAINS)
    found = simulate_batch(Case(scenario, REMUS, GAINS), engine="c").table[0]
    for name, a, b in zip(METRICS, found, run.metrics.row(), strict=True):
        assert a == b or abs(a - b) <= 1e-9 or (np.isnan(a) and np.isnan(b)), name
    forces, commands = run.telemetry("thruster_force")[:, 1], run.telemetry("thruster_command")[:, 1]
    speed = run.record.nu[:, 0]
    assert forces == pytest.approx(commands * 9.64 * np.radians(13.6) * speed**2, abs=1e-9)
    assert np.abs(commands).max() > 0.5
    use = thruster_use(run)
    assert use is not None and use.missed < 0.5 and use.lack[1] == 0.0  # the side force is not commanded
    still = simulate(replace(scenario, disturbance=Disturbance()), REMUS, gains=GAINS)
    assert still.record.nu[-1, 3] != run.record.nu[-1, 3]


def test_the_plant_has_the_force_of_the_deflection_at_the_speed_through_the_water() -> None:
    law = build_law("steered", actuators=REMUS.actuators)
    thrusters, telemetry = Thrusters.of(REMUS, law), np.zeros(law.outputs.size - 4)
    telemetry[law.telemetry_slice("thruster_force")] = 3.0, 1.0
    telemetry[law.telemetry_slice("thruster_command")] = 0.3, 0.5
    half = 0.5 * 9.64 * np.radians(13.6)
    for speed, force in ((1.2, half * 1.44), (0.0, 0.0), (-1.0, 0.0)):
        tau = np.array([3.0, 1.0, 0.0, -0.638])
        achieved, components = thrusters.achieved(tau, 0.0, telemetry=telemetry, speed=speed)
        assert achieved == pytest.approx([3.0, force, 0.0, -0.638 * force], abs=1e-12)
        assert components == pytest.approx([3.0, force], abs=1e-12)
        without, none = thrusters.achieved(np.zeros(4), 0.0, telemetry=None, speed=speed)  # as after a lost link
        assert not without.any() and not none.size


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("limit_deg = 13.6", "limit_deg = 60", "fin.limit_deg"),
        ('lift = "9.64 N s^2/m^2"', 'lift = "-9.64 N s^2/m^2"', "fin.lift"),
        ('lift = "9.64 N s^2/m^2"', 'lift = "9.64 N"', "fin.lift"),
        ("push = [0.0, 1.0, 0.0]", "push = [1.0, 0.0, 0.0]", "push"),
        ("fin = {", 'forward = "3 N"\nfin = {', "forward"),
    ],
)
def test_a_mistake_in_a_fin_is_one_line_with_its_key(old: str, new: str, key: str, tmp_path: Path) -> None:
    text = (LIBRARY / "remus100.toml").read_text(encoding="utf-8")
    assert old in text
    head, tail = text.split('name = "rudder"')
    path = tmp_path / "mine.toml"
    path.write_text(head + 'name = "rudder"' + tail.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_vehicle(str(path))
    assert caught.value.key == f"thruster.1.{key}" and caught.value.remedy


def test_numbers_that_follow_from_the_vehicle_are_no_gains() -> None:
    assert "munk" in GAINS.own and "munk" not in GAINS.values and "munk" not in GAINS.specs
    assert "sideslip" in default_tuned(GAINS) and not {"munk", "fin_share", "steerage"} & set(default_tuned(GAINS))
    law = build_law("steered")
    p = law.gains.split(law_numbers(replace(turning(1.0), cruise=0.5), GAINS, REMUS))
    assert p["munk"][0] == pytest.approx(65.98 - 31.41 - 10.57) and p["fin_share"][0] == 1.0
    assert p["thrust_limit"][3] == pytest.approx(0.25 * REMUS["Fr_max"])
