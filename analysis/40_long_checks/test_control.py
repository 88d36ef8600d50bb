"""Control: commands leave the margins of a user's own law out, and a steered craft in front of what moves."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surctl.ir import replay
from surctl.marine.control import DEGRADED, build_law, law_ref, law_source, load_gains, steered
from surctl.marine.control.build import in_real
from surctl.marine.sensing import Equipment, SonarArray
from surctl.marine.simulation import Case, load_scenario, simulate, simulate_batch
from surctl.marine.vehicle import load_vehicle
from surctl.marine.world import Disc
from surctl.own_code import own_file
from surctl.priority.solver.fallback import LIMITED, MET, RELAXED, UNCONFIRMED
from tests.control import (
    test_allocated,
    test_law,
    test_layers,
    test_own_laws,
    test_scan,
    test_steered,
    test_steered_arrival,
    test_stored,
)
from tests.control.robot import DT, Robot
from tests.control.test_allocated import _numbers
from tests.control.test_own_laws import STUDY, surctl
from tests.control.test_own_laws import law as law
from tests.control.test_own_laws import mission as mission
from tests.control.test_perception import FREE, OFF_CENTRE, around, marks
from tests.control.test_routines import tried
from tests.control.test_scan import stops_within
from tests.control.test_steered import crab, gains, radius_of, run
from tests.control.test_steered import files as files
from tests.control.test_steered_courses import EXACT, numbers, rebuilt
from tests.control.test_stopping import GAINS, VEHICLE
from tests.craft import CRUISE, craft, factor, scaled
from tests.craft import mission as written
from tests.tools import need_compiler


def test_a_default_thrust_flies_alike_in_both_loops(law: str, mission: Path) -> None:
    test_own_laws.test_both_loops_fly_an_own_law_alike(law, mission, "wall", "projected")


def test_a_sweep_prints_no_margin_of_another_law(law: str, mission: Path, tmp_path: Path) -> None:
    ran = surctl("sweep", "stand_off=0.8,0.9", "--scenario", mission, "--law", own_file(law), "--out", tmp_path / "s")
    assert "disk_margin=nan" in ran.output
    assert "surctl verify" not in ran.output


def test_tuning_judges_no_margin_of_another_law(law: str, mission: Path, tmp_path: Path) -> None:
    study = tmp_path / "study.toml"
    study.write_text(
        'kind = "study"\nname = "mine"\nvehicle = "sur540-flooded"\nlaw = "my_law.py:wall"\n[[runs]]\n'
        'scenario = "water.toml"\n'
    )
    tuned = surctl("tune", study, "--trust", "--trials", 2, "--rounds", 1, "--monte-carlo", 1, "--out", tmp_path / "t")
    assert "checked at the end on the best gain sets (at most 4), not in the search: delay margin, disk margin" in (
        tuned.output
    )
    assert "goal disk margin is not judged: the assessment has no disk_margin" in tuned.output
    goals = [line.split()[0] for line in tuned.output.splitlines() if " hard " in line]
    assert goals
    assert "disk" not in goals
    commands = [line for line in tuned.output.splitlines() if line.lstrip().startswith("surctl ")]
    assert len(commands) == 2
    assert all(f"--law {own_file(law)}" in command for command in commands)


@pytest.mark.parametrize(("start", "end"), [((36, 20), (10, 20))])  # head on
def test_moving_obstacles_are_evaded(start: tuple[float, float], end: tuple[float, float]) -> None:
    r, vehicle = radius_of("otter"), craft("otter")
    mover = {
        "name": "M",
        "shape": "moving",
        "centre_m": [r * x for x in start],
        "to_m": [r * x for x in end],
        "speed_m_per_s": 0.3,
        "radius_m": vehicle["radius"],
    }
    scenario = written(
        [[20 * r, 20 * r], [36 * r, 20 * r]], "otter", size=(60 * r, 40 * r), time=60 * r, obstacles=[mover]
    )
    batch = simulate_batch(Case(scenario, vehicle, gains()))
    assert batch.column("reached")[0] == 1 and batch.column("min_clearance_m")[0] > 0.05


def test_with_the_tolerances_of_doubles_a_search_in_floats_confirms_few_velocities() -> None:
    law, given = tried()
    J, wanted, rows, box = (part.astype(np.float32) for part in replay(law.stages.pre, *given)[:4])
    ticks = [
        next(step.block for step in made.block.steps if step.block.name == "projected_step")
        for made in (law, in_real(law, "float32"))
    ]
    coarse, fine = (replay(tick, J, wanted, wanted, rows, box, real=np.float32) for tick in ticks)
    exact = replay(ticks[0], *(part.astype(float) for part in (J, wanted, wanted, rows, box)))
    assert np.array_equal(fine[4], exact[4]) and set(np.ravel(exact[4])) == {MET, LIMITED, RELAXED}
    assert (coarse[4] == UNCONFIRMED).mean() > 0.5


def test_an_unfinished_search_goes_on_in_the_next_step(monkeypatch: pytest.MonkeyPatch) -> None:
    p, chosen = numbers(brake=0.1), []
    # a row of discs across the path, so that only a course far aside is clear
    across = np.zeros((8, 6))
    across[:5, :2] = [[24.0, 30.0 + 3.0 * k] for k in range(-2, 3)]
    across[:5, 2], across[:5, 5] = 1.5, 1.0
    for budget in (EXACT, 2 * steered.STEPS):
        monkeypatch.setattr(steered, "BUDGET", budget)
        law = rebuilt()
        x = law.initial_state()
        x[law.state.slice("progress")] = 15.0
        u = law.inputs.pack({"eta": [12.0, 30.0, 0.0, 0.0], "nu": [0.7, 0.0, 0.0, 0.0], "contacts": across})
        begun = x.copy()
        for _ in range(20):
            step = law.step(x, u, p)
            x = begun.copy()  # the craft stays where it is; only the search goes on
            for name in ("offset", "share", "skipped"):
                x[law.state.slice(name)] = step.x_next[law.state.slice(name)]
            chosen.append([float(x[law.state.slice(name)][0]) for name in ("offset", "share", "skipped")])
    exact, partial = chosen[:20], chosen[20:]
    assert exact[0][0] != 0 and exact[0] == exact[-1] and exact[0][2] == 0
    assert partial[0][2] > 0  # the first search did not end
    assert exact[0][:2] in [one[:2] for one in partial] and partial[-1][:2] == exact[0][:2]


def test_the_map_is_not_forgotten_before_another_depth_is_reached() -> None:
    test_layers.test_the_map_is_forgotten_once_another_depth_is_reached(1.0, False)


def test_corners_are_visited_without_crabbing() -> None:
    test_two_legs_are_followed_without_crabbing("otter", "visit")


def test_a_sweep_without_a_feasible_point_sets_an_earlier_gain_file_aside(mission: Path, tmp_path: Path) -> None:
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "gains.toml").write_text("of before")
    ran = surctl("sweep", "k_v=0.01,0.02", "--scenario", mission, "--law", "closed_form", "--out", tmp_path / "s")
    assert "the gain file of an earlier sweep is now" in ran.output
    assert not (tmp_path / "s" / "gains.toml").exists()
    assert (tmp_path / "s" / "gains-before.toml").read_text() == "of before"


def test_export_agrees_with_python_at_more_thrust_than_it_has_astern(files: Path) -> None:
    need_compiler()
    file = files / "otter.toml"
    weaker = '[thrust]\nFu_reverse = { value = 45.0, unit = "N", provenance = "chosen" }\n'
    file.write_text(file.read_text().replace("[thrust]\n", weaker, 1))
    assert craft("otter")["Xu"] * CRUISE["otter"] > 45.0  # the drag at the cruise speed
    words = (
        "--vehicle",
        "otter.toml",
        "--scenario",
        "way.toml",
        "--sensing",
        "truth",
        "--out",
        str(files / "firmware"),
    )
    exported = run(files, "export", *words)
    assert exported.exit_code == 0, exported.output
    assert "thrust 0.0e+00, state 0.0e+00, telemetry 0.0e+00" in exported.output and "reached" in exported.output
    assert "| `ahead_limit` | 133.0 | N | largest surge thrust ahead | 0 to 133 |" in (
        (files / "firmware" / "README.md").read_text()
    )


def test_the_tank_scaled_to_the_craft_without_collision() -> None:
    k = factor(craft("otter"), radius_of("otter"))
    case = Case(scaled("tank-moving", k, "otter"), craft("otter"), gains())
    assert case.law == "steered"
    batch = simulate_batch(case)
    assert batch.column("reached")[0] == 1 and batch.column("min_clearance_m")[0] > 0.5
    assert 0 < batch.column("peak_thrust_share")[0] <= 1  # not NaN on the axes without thrust


def test_a_law_with_sonars_and_depths_is_read_as_it_was_written() -> None:
    options = {"sonar": True, "depths": True, "equipment": Equipment(own=None)}
    test_stored.test_what_is_read_is_what_was_written(options)


def test_the_law_in_c_in_mode_filter() -> None:
    test_law.test_the_law_in_c_is_the_replay_and_decides_as_the_solver_in_numpy("filter")


def test_a_wall_that_is_silent_from_the_side_is_no_fault_of_the_sonar():
    """Smooth walls answer near their normal; a sonar that looks along one reads farther than the wall."""
    robot = Robot(Equipment(), at=(4.0, 2.6, -0.15, 0.2), walls=(0.0, 10.0, 0.0, 5.0), spin=0.45)
    robot.array = replace(robot.array, incidence_limit=math.radians(22.5))
    robot.steps(3.0)
    for _ in range(round(4.0 / DT)):
        told = robot.step()
        assert told["sonars"][:, 2].all() and not robot.state("sonar_distrust").any()
    assert not len(marks(told))
    free, x, y = around(robot)
    assert (free[np.ix_(np.abs(y - 2.6) < 1.2, np.abs(x - 4.0) < 1.2)] < FREE).mean() > 0.95


def test_the_worst_plant_hits_nothing_that_stands_and_keeps_more_room() -> None:
    scenario = load_scenario("tank-static")
    plant = {"plant.m11": 125.0, "plant.m22": 125.0, "plant.Fu_max": 4.25, "plant.Fv_max": 4.25}
    values = {name: np.array([value]) for name, value in plant.items()}
    least = {}
    for barrier in ("simple", "inertia"):
        flown = simulate_batch(Case(scenario, VEHICLE, GAINS, barrier=barrier), values, seeds=np.array([0]))
        assert flown.column("reached")[0] == 1
        least[barrier] = flown.column("min_clearance_m")[0]
    assert 0 < least["simple"] < least["inertia"]


def test_movers_are_braked_for_instead_of_evaded() -> None:
    scenario, least = load_scenario("tank-speed-010"), {}
    for movers in ("predict", "barrier"):
        flown = simulate_batch(Case(scenario, VEHICLE, GAINS, movers=movers), seeds=np.array([0]))
        assert flown.column("reached")[0] == 1
        least[movers] = flown.column("min_clearance_m")[0]
    assert least["barrier"] > 1.2 * least["predict"]


@pytest.mark.parametrize(("name", "corners"), [("remus", "pass")])
def test_two_legs_are_followed_without_crabbing(name: str, corners: str) -> None:
    r = radius_of(name)
    path = [[5 * r, 5 * r], [8 * r, 5 * r], [8 * r, 8 * r]]
    run = simulate(
        written(path, name, size=(20 * r, 20 * r), time=100 * r, corners=corners),
        craft(name),
        gains=gains(),
        law=test_steered.law(),
    )
    assert run.metrics.reached and crab(run) < 15
    assert run.metrics.max_deviation_m < 0.5 * r
    # a craft that began its turn at the corner would miss it by nothing and overshoot the second leg
    beyond = float((run.record.eta[:, 0] - 8 * r).max())
    assert corners == "visit" or beyond < 0.15 * r
    missed = r * (np.sqrt(2) - 1)
    assert run.metrics.missed_corner_m < (1.2 * missed if corners == "pass" else 1.0)


@pytest.mark.parametrize(("name", "guidance"), [("remus", "los")])
def test_a_current_from_aside_leaves_no_error(name: str, guidance: str) -> None:
    # a law that took the current for drift through the water would lose the yaw moment of the torpedo to it
    r = radius_of(name)
    path, disturbance = [[20 * r, 20 * r], [27 * r, 20 * r]], {"current_m_per_s": [0.0, 0.2]}
    scenario = written(path, name, size=(60 * r, 40 * r), time=40 * r, disturbance=disturbance)
    run = simulate(scenario, craft(name), gains=gains(), law=test_steered.law(guidance))
    away = np.abs(run.record.eta[:, 1] - 20 * r)
    assert run.metrics.reached and away.max() < 1.0 and away[-20:].max() < 0.1


def test_the_choice_is_that_of_a_search_through_all_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    law, ordered = rebuilt(), steered._ordered
    assert law.block.operations < 40_000
    # no candidate ends the search but the last, and there are steps for all of them

    def unending(side: int) -> Iterator[tuple[float, ...]]:
        return ((*row[:5], -1.0 if row[5] < 1e3 else row[5]) for row in ordered(side))

    monkeypatch.setattr(steered, "_ordered", unending)
    monkeypatch.setattr(steered, "BUDGET", EXACT)
    whole, p = rebuilt(), numbers()
    assert law.block.digest() != whole.block.digest()
    rng, turned = np.random.default_rng(3), 0
    for _ in range(16):
        x = law.initial_state()
        x[law.state.slice("progress")] = 15.0
        x[law.state.slice("side")] = rng.choice([-1.0, 0.0, 1.0])
        contacts = np.zeros((8, 6))
        count = int(rng.integers(0, 4))
        contacts[:count, :2] = np.array([20.0, 30.0]) + rng.normal(scale=[8.0, 4.0], size=(count, 2))
        contacts[:count, 2:] = np.column_stack(
            [rng.uniform(0, 2, count), rng.normal(0, 0.2, (count, 2)), np.ones(count)]
        )
        eta = [12.0, 30.0 + rng.normal(), 0.0, rng.normal(scale=0.5)]
        u = law.inputs.pack({"eta": eta, "nu": [0.7, 0.0, 0.0, rng.normal(scale=0.05)], "contacts": contacts})
        one, other = law.step(x, u, p), whole.step(x, u, p)
        assert one.tau == pytest.approx(other.tau, abs=1e-9) and one.status == other.status
        assert one.x_next == pytest.approx(other.x_next, abs=1e-9)
        turned += bool(one.telemetry[law.telemetry_slice("avoiding")][0])
    assert turned > 3


def test_in_floats_it_decides_as_in_doubles() -> None:
    law, given = tried()
    want, have = replay(law.block, *given), replay(in_real(law, "float32").block, *given, real=np.float32)
    np.testing.assert_array_equal(have[2], want[2])
    at = law.telemetry_slice("nu_reference")
    off = np.abs(have[3][:, at] - want[3][:, at]).max(axis=1)
    opened = want[2][:, 0] % (2 * DEGRADED) >= DEGRADED
    # an opening has a margin, in which the task may give way: by it divided by the sine between the rows
    assert 0 < opened.sum() < len(opened) and off[~opened].max() < 2e-6 and off.max() < 1e-3


def test_in_its_first_second_it_goes_no_faster_than_stops_before_the_unknown():
    need_compiler()
    made = test_scan.law(mode="nsb")
    robot = Robot(Equipment(own=None), at=(0.6, 2.0, -0.15, 0.0), spin=0.27, shapes=[Disc((2.0, 2.1), 0.2)])
    x, speeds = made.initial_state(), []
    for tick in range(12):
        u = made.inputs.pack(robot.inputs())
        told = made.perception.outputs.unpack(robot.run(x[-made.perception.state.size :], u, robot.p)[1])
        step = made.step(x, u, robot.p)
        x = step.x_next
        wanted = made.outputs.unpack(np.concatenate([step.tau, step.telemetry]))["nu_reference"]
        c, s = math.cos(robot.eta[3]), math.sin(robot.eta[3])
        velocity = np.array([c * wanted[0] - s * wanted[1], s * wanted[0] + c * wanted[1]])
        for *normal, clearance in told["unknown"]:
            assert velocity @ normal <= stops_within(clearance) + 1e-6
        speeds.append(np.hypot(*velocity))
        robot.tick, robot.eta[3] = tick + 1, robot.eta[3] + robot.spin * DT
    assert speeds[0] < 0.01 and max(speeds) < 0.1


def test_sonars_that_stand_beside_the_hull_are_believed():
    """Their walls are expected where they are mounted, and in what the hull leaves of their beams."""
    array = SonarArray(mounts=((0.0, -0.3), (-0.3, 0.0), (0.0, 0.3), (0.3, 0.0)))
    assert all(cones[0][0] != 0.0 for cones in array.cones)
    robot = Robot(Equipment(array=array, own=None), at=OFF_CENTRE, spin=0.45)
    for k in range(320):
        told = robot.step()
        assert k < 4 or told["sonars"][:, 2].all()
    assert not len(marks(told))
    values, x, y = around(robot)
    assert np.mean(values[((x > 0.2) & (x < 2.5)) & ((y > 0.3) & (y < 2.9))[:, None]] < FREE) > 0.9


def test_super_twisting_reaches_its_station_and_an_orbit_its_circle() -> None:
    scenario, vehicle = load_scenario(str(STUDY / "orbit.toml")), load_vehicle("sur540-flooded")
    law, gains = build_law(law_ref("station.py:station", folder=STUDY)), load_gains("default")
    gains = gains.with_own(law_source(law.ref).gains)
    assert simulate(scenario, vehicle, gains=gains, law=law).metrics.reached
    run = simulate(scenario, vehicle, gains=gains.with_values({"radius": 1.0}), law=law)
    offset = run.record.eta[-401:, :2] - scenario.path.waypoints[-1]
    assert np.abs(np.hypot(*offset.T) - 1.0).max() < 0.06
    turned = run.record.law_state[:, law.state.slice("turned")].ravel()
    angle = np.unwrap(np.arctan2(*offset.T[::-1]))
    assert turned[-1] - turned[-401] == pytest.approx(angle[-1] - angle[0], rel=0.1)


def test_the_filter_of_the_own_state_uses_the_achieved_thrust() -> None:
    law = build_law(sonar=True, actuators=test_allocated.VEHICLE.actuators)
    working = np.zeros(8)
    fix = {"fix": [1.0, 2.5, -0.5], "fix_fresh": 1.0}
    given = law.initial_state(), law.inputs.pack({**fix, "working": working}), _numbers()
    tau, x_next, _, telemetry = replay(law.block, *given)
    assert (tau == 0.0).all()
    assert (x_next[law.state.slice("last_thrust")] == 0.0).all()
    assert np.abs(telemetry[law.telemetry_slice("tau_desired")]).max() > 0.0


def test_a_goal_is_reached_by_a_craft_that_drifts_in_its_turns() -> None:
    """It circled the goal: its drift changed the course straight ahead."""
    test_steered_arrival.test_a_goal_beside_the_craft_is_reached("lauv", 0.0, 84.0, 350.0)
