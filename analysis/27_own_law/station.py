"""Example: station keeping with super-twisting (`orbit_law.py`) through the whole chain.

    python analysis/27_own_law/station.py            # 10,000 runs
    python analysis/27_own_law/station.py --quick    # 16 runs

Status 0 if the run arrives, both claims have the stated verdict, and C equals Python, else 1. There are no margins: the
slope of super-twisting, sqrt(|e|) sign(e), is infinite where the error is 0, so the loop has no linear one.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import casadi as ca
import numpy as np
from orbit_law import STATION, super_twisting

from surctl.certcheck import check_document
from surctl.control import build_law, law_ref, law_source, load_gains
from surctl.errors import InputError
from surctl.export import Records, software_in_the_loop
from surctl.lyapunov import Dynamics, Stability, State, decide_motion, find_stability
from surctl.simulation import Case, load_scenario, simulate, simulate_batch
from surctl.system import every_combination
from surctl.tuning import Goal, Request, build_cases, conditions, gain_ranges, tune
from surctl.vehicle import load_vehicle
from surctl.verification import steady_motion
from surctl.verification.formula import from_casadi, parse, variable

HERE, VEHICLE = Path(__file__).parent, load_vehicle("sur540-flooded")
AXES = {"twist": (0.05, 1.0), "twist_i": (0.001, 0.2)}
GOALS = (Goal("arrive soon", "time_s", "s", 20.0), Goal("stay near the path", "deviation_m", "m", 0.1))


def speed_error(*, sampled: bool) -> Dynamics:
    """Return speed error and integral of super-twisting at rest, with root = sqrt(|error|) sign(error).

    In continuous time, the time is scaled by 2 |root|, which changes no path; the drag is that of the vehicle.
    """
    root, z = ca.vertsplit(x := ca.SX.sym("x", 2))
    error, mass = root * ca.fabs(root), VEHICLE["m11"]
    drag = (VEHICLE["Xu"] + VEHICLE["Xuu"] * ca.fabs(error)) * error / mass
    p = {name: ca.SX(gain.default) for name, gain in STATION.items()}
    states = (State("root", -0.4, 0.4, "m^0.5/s^0.5"), State("z", -0.1, 0.1, "m/s^2"))
    rates = [-(p["twist"] * root + z + drag), 2 * p["twist_i"] * root]
    if sampled:
        p |= {"linear_drag": ca.SX(0), "quadratic_drag": ca.SX(0), "mass": ca.SX(1)}
        force, after = super_twisting(ca.SX(0), -error, z, p, 0.05)
        error = error - 0.05 * (force + drag)
        rates = [ca.if_else(error < 0, -1, 1) * ca.sqrt(ca.fabs(error)), after]
    kind = "discrete" if sampled else "continuous"
    return Dynamics(f"twist-{kind}", kind, states, tuple(from_casadi(x, ["root", "z"], rates)))


def main() -> int:
    """Print the example."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="16 points instead of 10,000, and 8 trials")
    quick = parser.parse_args().quick
    law = law_ref("orbit_law.py:station", folder=HERE)
    built, gains = build_law(law), load_gains("default").with_own(law_source(law).gains)
    scenario = load_scenario(str(HERE / "orbit.toml"))
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
    print(f"tuned: {text}, score {tuned.score:.3f}, goals {'met' if tuned.feasible else 'missed'}")

    gains = gains.with_values(tuned.gains)
    run = simulate(scenario, VEHICLE, gains=gains, law=built)
    record = run.record
    print(f"one run: {run.metrics.stopped_because} at {run.metrics.time_s:.1f} s")
    try:
        steady_motion(run)
    except InputError as error:
        print(f"margins: not judged, the run {error.problem}")
    report = software_in_the_loop(built, Records(record.law_state, record.law_input, record.law_parameters))
    print(report.summary())

    claim = find_stability(speed_error(sampled=False), degree=2)
    print(f"claim, speed error in continuous time, without lag and limit: {claim.line()}")
    proved = claim.verdict == "proved" and check_document(dict(claim.decision.document)).accepted
    V = parse("root^2 + 10 * z^2", {name: variable(name) for name in ("root", "z")})
    denied = decide_motion(Stability(speed_error(sampled=True), V, 0.01))
    print(f"claim, {denied.claim.statement} at control instants: {denied.verdict}, {denied.reason}")
    return 0 if run.metrics.reached and report.exact and proved and denied.verdict == "refuted" else 1


if __name__ == "__main__":
    sys.exit(main())
