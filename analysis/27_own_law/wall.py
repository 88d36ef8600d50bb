"""Example: follow the wall y = 0 at a set distance, facing it, by four prioritised tasks, through the whole chain.

    python analysis/27_own_law/wall.py            # 10,000 runs; with --quick 16
    surctl simulate wall.toml --law wall.py:wall

Status 0 if the run arrives, the loop is stable, its claim is proved, and C equals Python, else 1.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import casadi as ca
import numpy as np

from surctl.certcheck import check_document
from surctl.export import Records, software_in_the_loop
from surctl.lyapunov import Dynamics, State, find_stability
from surctl.marine.control import Decision, GainSpec, LawSource, Situation, build_law, law_ref, load_gains
from surctl.marine.control.closing import velocity_control
from surctl.marine.simulation import Case, load_scenario, simulate, simulate_batch
from surctl.marine.tuning import Goal, Request, build_cases, conditions, gain_ranges
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import law_loop, steady_motion
from surctl.system import every_combination
from surctl.tasks import Task, depth_task, heading_task
from surctl.tuning import tune
from surctl.verification.formula import from_casadi

HERE, VEHICLE = Path(__file__).parent, load_vehicle("sur540-flooded")
FAR = 1e9  # N, limit of the thrust in the claim: none
GAINS = {
    "k_wall": GainSpec("1/s", "gain of the distance to the wall", default=0.4, range=(0.1, 1.5)),
    "stand_off": GainSpec("m", "distance of the robot's centre from the wall", default=0.8, range=(0.6, 1.2)),
}
AXES = {"k_wall": (0.2, 0.8), "stand_off": (0.7, 1.0)}
GOALS = (Goal("arrive soon", "time_s", "s", 40.0), Goal("stay near the path", "deviation_m", "m", 0.1))


def decide(s: Situation) -> Decision:
    """Return the four tasks, highest priority first: distance, progress along the wall, heading, depth."""
    x, y = s.eta[0], s.eta[1]
    wall, end = s.p["walls"][2], s.p["waypoints"][-1, 0]
    keep = Task(
        name="distance",
        eta=s.eta,
        sigma=y,
        target=wall + s.p["stand_off"],
        gain=s.p["k_wall"],
        unit="m",
        kinematics="vehicle",
    )
    speed = ca.fmin(ca.fmax(s.p["k1"] * (end - x), -s.p["cruise"]), s.p["cruise"])
    along = Task(name="along", eta=s.eta, sigma=x, target=x, rate=speed, unit="m", kinematics="vehicle")
    facing = heading_task(s.eta, -ca.pi / 2, gain=s.p["k_psi"])
    return Decision([keep, along, facing, depth_task(s.eta, s.p["depth"], gain=s.p["k2"])])


def wall() -> LawSource:
    """Return the law."""
    return LawSource("wall_follower", decide, gains=GAINS)


def distance() -> Dynamics:
    """Return the error of the distance to the wall and the speed towards it, below the limit of the thrust."""
    gap, speed = ca.vertsplit(x := ca.SX.sym("x", 2))
    none, default = ca.SX.zeros(3), load_gains("default")
    model = {name: ca.SX(getattr(VEHICLE, name).tolist()) for name in ("mass", "linear_drag", "quadratic_drag")}
    reference, nu = ca.vertcat(-GAINS["k_wall"].default * gap, none), ca.vertcat(speed, none)
    gains = {name: default[name] for name in ("k_v", "k_r", "k_i")}
    limit = {"thrust_limit": ca.SX.zeros(4) + FAR}
    tau, *_ = velocity_control(reference, nu, ca.SX.zeros(4), {**model, **limit}, dt=0.05, **gains)
    drag = (VEHICLE["Xu"] + VEHICLE["Xuu"] * ca.fabs(speed)) * speed
    states = (State("gap", -0.4, 0.4, "m"), State("speed", -0.2, 0.2, "m/s"))
    rates = from_casadi(x, ["gap", "speed"], [speed, (tau[0] - drag) / VEHICLE["m11"]])
    return Dynamics("wall-distance", "continuous", states, tuple(rates))


def main() -> int:
    """Print the example."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="16 points instead of 10,000, and 8 trials")
    quick = parser.parse_args().quick
    law = law_ref("wall.py:wall", folder=HERE)
    built, gains = build_law(law), load_gains("default").with_own(GAINS)
    scenario = load_scenario(str(HERE / "wall.toml"))
    side = 4 if quick else 100
    points = every_combination(*({name: np.linspace(*ends, side)} for name, ends in AXES.items()))
    case = Case(scenario, VEHICLE, gains, law)
    simulate_batch(case, {name: values[:1] for name, values in points.items()})  # compiled before the clock runs
    began = time.process_time()
    runs = simulate_batch(case, points)
    spent, reached = time.process_time() - began, runs.column("reached") > 0
    print(f"sweep: {reached.size:,} runs in {spent:.2f} s of processor time, {reached.sum():,} reached the goal")

    tried = conditions(build_cases([scenario], [VEHICLE], gains=gains, law=law), seeds=[0])
    request = Request(GOALS, tried, gains, gain_ranges(gains, AXES))
    tuned = tune(request, trials=8 if quick else 128, rounds=1, runs=0).result
    text = ", ".join(f"{name} = {value:.3g}" for name, value in tuned.gains.items())
    print(f"tuned: {text}, score {tuned.score:.3f}, goals {'met' if tuned.score <= 1 else 'missed'}")

    gains = gains.with_values(tuned.gains)
    run = simulate(scenario, VEHICLE, gains=gains, law=built)
    record = run.record
    print(f"one run: {run.metrics.stopped_because} at {run.metrics.time_s:.1f} s")
    loop = law_loop(run.law, VEHICLE, gains, cruise=scenario.cruise, at=steady_motion(run))
    print(loop.head, *(margin.line() for margin in loop.margins), sep="\n")
    report = software_in_the_loop(built, Records(record.law_state, record.law_input, record.law_parameters))
    print(report.summary())

    claim = find_stability(distance(), degree=2)
    print(f"claim, without thrust lag, while no thrust is at its limit: {claim.verdict}: {claim.volume:.0%} of the box")
    proved = claim.verdict == "proved" and check_document(dict(claim.decision.document)).accepted
    return 0 if run.metrics.reached and loop.stable and report.exact and proved else 1


if __name__ == "__main__":
    sys.exit(main())
