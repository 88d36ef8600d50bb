"""Any law is linearised about a steady motion of its own run; rotation, decay and refusals are checked."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from surctl.cli.app import app
from surctl.errors import InputError
from surctl.marine.control import Law, build_law, law_ref, law_source, load_gains
from surctl.marine.guidance import Path as Route
from surctl.marine.simulation import Disturbance, Run, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import law_loop, steady_motion
from surctl.system import ControllerStep

FILES = Path(__file__).parents[2] / "analysis" / "27_own_law"
WALL = law_ref(f"{FILES / 'wall.py'}:wall")
VEHICLE = load_vehicle("sur540-flooded")
GAINS = load_gains("default").with_own(law_source(WALL).gains)


@cache
def wall_law() -> Law:
    return build_law(WALL)


def along_the_wall(offset: float = 0.0, *, late: bool = False) -> Run:
    # the path's first point, where the robot starts, is `offset` [m] off
    scenario = load_scenario(str(FILES / "wall.toml"))
    corners = scenario.path.waypoints.copy()
    corners[0, 1] += offset
    held = [np.zeros(4)]

    def one_period_late(x: np.ndarray, u: np.ndarray, p: np.ndarray) -> ControllerStep:
        step = wall_law().step(x, u, p)
        held.append(step.tau)
        return step._replace(tau=held.pop(0))

    stepper = one_period_late if late else None
    return simulate(replace(scenario, path=Route(corners)), VEHICLE, gains=GAINS, law=wall_law(), stepper=stepper)


def test_the_distance_decays_as_the_pole_says() -> None:
    there, off = along_the_wall(late=True), along_the_wall(0.01, late=True)
    loop = law_loop(wall_law(), VEHICLE, GAINS, cruise=0.15, at=steady_motion(there))
    error = off.record.eta[:, 1] - there.record.eta[:, 1]
    first, last = round(12 / 0.05), round(16 / 0.05)
    rate = np.log(error[last] / error[first]) / 4.0
    rates = np.log(np.abs(loop.poles)) / 0.05
    assert np.abs(rates / rate - 1).min() < 1e-3
    assert loop.stable and loop.free == ("x",)  # the position along the wall, to the left of the hull


@pytest.mark.parametrize("direction", [2.0])
def test_a_course_in_another_direction_has_the_same_loop(direction: float) -> None:
    law, scenario, vehicle, gains = (
        build_law("paper"),
        load_scenario("pool-behind"),
        load_vehicle("sur400"),
        load_gains("default"),
    )
    ends = 30 + np.array([[0.0, 0.0], [np.cos(direction), np.sin(direction)]]) * 6
    open_water = replace(scenario, path=Route(ends), obstacles=(), site=(60.0, 60.0, 3.0), disturbance=Disturbance())
    point = steady_motion(simulate(open_water, vehicle, gains=gains, law=law))
    loop = law_loop(law, vehicle, gains, cruise=scenario.cruise, at=point)
    straight = law_loop(law, vehicle, gains, cruise=scenario.cruise)
    assert point.speed == pytest.approx(scenario.cruise, rel=0.02)
    assert abs(np.angle(np.exp(1j * (point.heading - direction)))) < 0.01
    assert np.allclose(np.sort(np.abs(loop.poles))[-6:], np.sort(np.abs(straight.poles))[-6:], atol=2e-3)


def test_a_current_is_in_the_loop_and_does_not_make_it_unstable() -> None:
    scenario, flow = load_scenario(str(FILES / "wall.toml")), (-0.03, 0.02)
    drift = replace(scenario, disturbance=Disturbance(current_m_per_s=flow))
    point = steady_motion(simulate(drift, VEHICLE, gains=GAINS, law=wall_law()))
    loop = law_loop(wall_law(), VEHICLE, GAINS, cruise=0.15, at=point)
    assert point.current == flow and loop.stable and loop.free == ("x",)
    through = point.nu[0] - np.cos(point.heading) * flow[0] - np.sin(point.heading) * flow[1]
    drag = (VEHICLE.linear_drag[0] + 2 * VEHICLE.quadratic_drag[0] * abs(through)) / VEHICLE.mass[0]
    surge = loop.linear.names.states.index("u")
    assert loop.linear.plant[0][surge, surge] == pytest.approx(-drag, rel=1e-6)


def test_a_motion_that_is_not_steady_is_refused() -> None:
    run = along_the_wall()
    cut = replace(run.record, **{name: getattr(run.record, name)[:20] for name in ("time", "eta", "nu", "tau")})
    with pytest.raises(InputError, match=r"wall: ended after 0\.95 s; give a scenario with a longer straight part"):
        steady_motion(replace(run, record=cut))
    turning = run.record.nu + np.array([0, 0, 0, 0.1])
    with pytest.raises(InputError, match=r"turns at 0\.1 rad/s where it is steady"):
        steady_motion(replace(run, record=replace(run.record, nu=turning)))
    full = run.record.tau * 0 + np.array([VEHICLE["Fu_max"], 0, 0, 0])
    with pytest.raises(InputError, match="that is controlled: surge thrust is at its limit; give a lower speed"):
        steady_motion(replace(run, record=replace(run.record, tau=full)))
    shaking = run.record.tau.copy()
    shaking[::2, 3] += 0.1 * VEHICLE["Fr_max"]
    with pytest.raises(InputError, match=r"no steady motion: .* yaw thrust varies 5 times too much"):
        steady_motion(replace(run, record=replace(run.record, tau=shaking)))


def test_the_command_line_judges_an_own_law_and_no_claim_of_another() -> None:
    words = ["verify", "--law", f"{FILES / 'wall.py'}:wall", "--scenario", str(FILES / "wall.toml")]
    judged = CliRunner().invoke(app, [*words, "v1-corrected", "--uncertainty", "0.1"], standalone_mode=False)
    assert judged.return_value == 1, judged.output
    assert "about the steady motion at" in judged.output and "loop surge: gain factor below" in judged.output
    assert "no contact: not judged" in judged.output
    assert "v1-corrected           not applicable to law wall.py:wall" in judged.output
    region = CliRunner().invoke(app, [*words, "region-cruise-20"], standalone_mode=False)
    assert "not applicable to law wall.py:wall" in region.output and region.return_value == 1


def test_a_mistake_in_a_law_is_an_error_and_no_missing_margin(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "from surctl.marine.control import LawSource\ndef made():\n    return LawSource('mine', lambda s: 4)\n"
    )
    words = ["verify", "--scenario", str(FILES / "wall.toml"), "--law", f"{tmp_path / 'mine.py'}:made"]
    with pytest.raises(InputError, match=r"mine\.py:made: mine\.decide: returned int, not Decision"):
        CliRunner().invoke(app, words, catch_exceptions=False, standalone_mode=False)


def test_a_law_whose_run_ends_with_a_fault_fails(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "import casadi as ca\nfrom surctl.marine.control import Decision, LawSource\n"
        "from surctl.tasks import velocity_task\n"
        "def decide(s):\n    return Decision([velocity_task(s.eta, ca.vertcat(0.1 * ca.sqrt(0.6 - s.eta[0]), 0))])\n"
        "def made():\n    return LawSource('mine', decide)\n"
    )
    words = ["verify", "--scenario", str(FILES / "wall.toml"), "--law", f"{tmp_path / 'mine.py'}:made"]
    judged = CliRunner().invoke(app, words, standalone_mode=False)
    assert judged.return_value == 1
    why = "the run of wall ended with a fault: command tau[0] is not finite at "
    assert f"margins: not judged, because {why}" in judged.output
    assert f"NOT accepted: margins: not judged, because {why}" in judged.output
