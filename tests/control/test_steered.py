"""The steered law: craft without sway force follow paths, avoid obstacles, and their loop has stated margins."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner, Result

from surctl.cli.app import app
from surctl.errors import InputError
from surctl.marine.control import Gains, Law, build_law, check_forces, default_law, law_source, load_gains
from surctl.marine.control.steered import steered_thrust
from surctl.marine.control.steering import Moving, moved, turning_radius
from surctl.marine.simulation import Run, findings, law_numbers
from surctl.marine.simulation.toml_text import toml_text
from surctl.marine.vehicle import load_vehicle
from surctl.marine.vehicle.parameters import write_vehicle
from surctl.marine.verification import cruise_loop, law_loop
from surctl.verification.sampled_margins import SampledLoop
from tests.craft import CRUISE, craft, mission, table


@cache
def law(guidance: str = "los") -> Law:
    return build_law("steered", guidance=guidance)


@cache
def gains() -> Gains:
    return load_gains("default", own=law_source("steered").gains)


def radius_of(name: str) -> float:
    return turning_radius(craft(name), gains().values, CRUISE[name])


def crab(run: Run) -> float:
    """Largest crab angle [deg] over the run, once the craft moves."""
    u, v = run.record.nu[:, 0], run.record.nu[:, 1]
    moving = u > 0.3 * u.max()
    return float(np.degrees(np.abs(np.arctan2(v[moving], u[moving]))).max())


def test_the_prediction_moves_like_the_plant_in_a_turn() -> None:
    vehicle = craft("a9")
    numbers = law_numbers(mission([[0, 0], [10, 0]], "a9", size=(100, 100), time=10), gains(), vehicle)
    p = {name: ca.SX(value) for name, value in law().gains.split(numbers).items()}
    u, r = CRUISE["a9"], CRUISE["a9"] / radius_of("a9")
    parts = ca.SX.sym("place", 2), ca.SX.sym("hull", 2), ca.SX.sym("nu", 3)
    angle = ca.atan2(parts[1][1], parts[1][0]) + 2.0
    course = ca.vertcat(ca.cos(angle), ca.sin(angle))
    after = moved(
        Moving(*parts, ca.SX(0)),
        course,
        ca.SX(u),
        p | {"steerage": ca.SX(1.0)},
        step=ca.SX(0.1),
        gain=ca.SX(2),
        stream=ca.SX.zeros(2),
    )
    step = ca.Function("step", parts, [after.place, after.hull, after.nu])
    now = [np.zeros(2), np.array([1.0, 0.0]), np.array([u, 0.0, r])]
    for _ in range(200):
        now = step.call(now)
    v = float(now[2][1])
    balance = vehicle["m11"] * u * r + vehicle["Yv"] * v + vehicle["Yvv"] * abs(v) * v
    assert abs(balance) < 1e-6 * vehicle["m11"] * u * r
    assert abs(v) / u <= gains()["sideslip"] + 1e-9


def test_thrust_cancels_the_munk_moment_of_the_drift_only() -> None:
    vehicle = craft("remus")
    numbers = law_numbers(mission([[0, 0], [10, 0]], "remus", size=(100, 100), time=10), gains(), vehicle)
    p = {name: ca.SX(value) for name, value in law().gains.split(numbers).items()}
    nu = ca.SX([0.8, 0.1, 0, 0])
    for drift, moment in ((0.0, 0.0), (-0.05, (66.0 - 31.4) * 0.8 * -0.05)):
        tau, _ = steered_thrust(ca.SX([0.8, drift, 0, 0]), nu, ca.SX.zeros(4), p, 0.05)
        assert float(tau[1]) == 0 and float(tau[3]) == pytest.approx(moment)


@pytest.mark.parametrize("name", ["otter", "remus"])
def test_the_sampled_loop_is_stable_at_cruise(name: str) -> None:
    loop = law_loop(law(), craft(name), gains(), cruise=CRUISE[name])
    assert loop.stable and loop.disk > 0.3
    assert [m.name for m in loop.margins] == ["surge", "yaw", "x", "y", "psi", "u", "v", "r"]


def test_a_loop_with_too_little_damping_is_unstable() -> None:
    weak = gains().with_values({"k_r": 0.3, "k_psi": 3.0})
    loop = law_loop(law(), craft("remus"), weak, cruise=CRUISE["remus"])
    assert not loop.stable and loop.slowest_per_s > 0


def test_the_numeric_loop_agrees_with_the_cascade() -> None:
    vehicle, default = load_vehicle("sur400"), load_gains("default")
    loop = law_loop(build_law("paper"), vehicle, default, cruise=0.15)
    cruising = SampledLoop(cruise_loop(vehicle, default.values, cruise=0.15, dt=0.05))
    for ours, theirs in zip(loop.margins, cruising.margins, strict=True):
        assert ours.phase_margin_deg == pytest.approx(theirs.phase_margin_deg, rel=2e-3)
        assert ours.disk_margin == pytest.approx(theirs.disk_margin, rel=5e-3)


def test_the_law_follows_from_the_forces() -> None:
    assert default_law(craft("otter")) == "steered" and default_law(load_vehicle("sur400")) == "guarded"
    check_forces("steered", load_vehicle("sur400"))
    with pytest.raises(InputError, match=r"needs a sway force, but otter has none \(Fv_max = 0\); use law steered"):
        check_forces("guarded", craft("otter"))
    with pytest.raises(InputError, match="has no sway force"):
        cruise_loop(craft("otter"), gains().values, cruise=0.77, dt=0.05)


def test_findings_say_what_the_craft_cannot_do() -> None:
    vehicle, r = craft("otter"), radius_of("otter")
    sharp = [[10.0, 10.0], [10 + 3 * r, 10.0], [10 + 2 * r, 10 + r]]
    current = {"current_m_per_s": [0.0, 0.1]}
    texts = {}
    for kind, scenario in (
        ("corner", mission(sharp, "otter", size=(60, 60), time=200)),
        ("narrow", mission([[3, 3], [30, 3]], "otter", size=(60, 5), time=200)),
        ("station", mission(sharp, "otter", size=(60, 60), time=200, corners="visit", disturbance=current)),
        ("depth", mission(sharp, "otter", size=(60, 60), time=200, depths_m=[-3.0, -0.2])),
    ):
        texts[kind] = "\n".join(f"{f.level} {f.key} {f.text}" for f in findings(scenario, vehicle))
    assert "info vehicle otter has no sway force (Fv_max = 0): law steered" in texts["corner"]
    assert "so the turn must begin" in texts["corner"]
    assert "less than its planned turning circle" in texts["narrow"]
    assert "warning corners" in texts["station"]
    assert "error depths_m otter has no heave force" in texts["depth"]


@pytest.fixture
def files(tmp_path: Path) -> Path:
    (tmp_path / "otter.toml").write_text(write_vehicle(craft("otter")))
    (tmp_path / "way.toml").write_text(
        toml_text(table([[10.0, 10.0], [25.0, 10.0]], "otter", size=(60, 60), time=60) | {"vehicle": "otter.toml"})
    )
    return tmp_path


def run(files: Path, *words: str) -> Result:
    named = [str(files / word) if word.endswith(".toml") else word for word in words]
    return CliRunner().invoke(app, named, catch_exceptions=True)


def test_commands_choose_the_law_and_say_so(files: Path) -> None:
    simulated = run(files, "simulate", "way.toml", "--vehicle", "otter.toml")
    assert simulated.exit_code == 0
    assert simulated.output.startswith("law steered, because otter has no sway force (Fv_max = 0)")
    refused = run(files, "simulate", "way.toml", "--vehicle", "otter.toml", "--law", "guarded")
    assert isinstance(refused.exception, InputError) and "use law steered" in str(refused.exception)
    verified = run(files, "verify", "braking-mass", "--vehicle", "otter.toml", "--scenario", "way.toml")
    assert "n/a  braking-mass" in verified.output and "sampled loop of law steered at 0.77 m/s" in verified.output
    assert "no contact: not judged" in verified.output
