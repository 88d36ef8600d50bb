"""Example: station keeping, or an orbit, with a super-twisting velocity controller, through the whole chain.

    python analysis/27_own_law/station.py            # 10,000 runs; with --quick 16
    surctl simulate orbit.toml --law station.py:station

Super-twisting: Levant 1993, Int. J. Control 58(6), eq. (6): u = k1 |e|^(1/2) sign(e) + z, z' = k2 sign(e). There are no
margins: its slope is infinite at e = 0. Status 0 if it arrives, the claim is proved, and C equals Python, else 1.
"""

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

import casadi as ca
import numpy as np

from surctl.certcheck import check_document
from surctl.errors import InputError
from surctl.export import Records, software_in_the_loop
from surctl.ir import Port
from surctl.lyapunov import Dynamics, State, find_stability
from surctl.marine.control import Decision, GainSpec, LawSource, Situation, build_law, law_ref, load_gains
from surctl.marine.simulation import Case, load_scenario, simulate, simulate_batch
from surctl.marine.tuning import Goal, Request, build_cases, conditions, gain_ranges
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import steady_motion
from surctl.system import every_combination
from surctl.tasks import depth_task, velocity_task
from surctl.tuning import tune
from surctl.verification.formula import from_casadi

HERE, VEHICLE = Path(__file__).parent, load_vehicle("sur540-flooded")
OWN = {
    "twist": GainSpec("m^0.5/s^1.5", "gain k1 of super-twisting", default=0.3, range=(0.05, 1.0)),
    "twist_i": GainSpec("m/s^2", "gain k2 of super-twisting", default=0.02, range=(0.0, 0.2), zero_allowed=True),
    "radius": GainSpec("m", "of the orbit; 0: stay at its centre", default=0.0, range=(0.0, 2.0), zero_allowed=True),
    "k_orbit": GainSpec("1/m", "gain of the distance to the orbit", default=2.0, range=(0.5, 6.0)),
}
TURNED = Port("turned", (1,), "rad", "angle about the centre so far")
AXES = {"twist": (0.05, 1.0), "twist_i": (0.001, 0.2)}
GOALS = (Goal("arrive soon", "time_s", "s", 25.0), Goal("stay near the path", "deviation_m", "m", 0.1))


def around(s: Situation) -> Decision:
    """Orbit the end of the path counter-clockwise, or stay there if the radius is 0; the state counts the angle."""
    offset = s.eta[:2] - s.p["waypoints"][-1, :].T
    distance = ca.sqrt(ca.sumsqr(offset) + 1e-9)
    tangent = s.p["radius"] / ca.fmax(distance, s.p["radius"]) * ca.vertcat(-offset[1], offset[0]) / distance
    slope = s.p["k_orbit"] * (distance - s.p["radius"])
    velocity = s.p["cruise"] * (tangent - slope * offset / distance) / ca.sqrt(1 + slope * slope)
    turned = s.x["turned"] + s.dt * ca.dot(velocity, tangent) / distance
    tasks = [velocity_task(s.eta, velocity), depth_task(s.eta, s.p["depth"], gain=s.p["k2"])]
    return Decision(tasks, velocity=velocity, state={"turned": turned})


def super_twisting(reference: ca.SX, nu: ca.SX, state: ca.SX, p: Mapping[str, ca.SX], dt: float) -> tuple[ca.SX, ca.SX]:
    """Return thrust (4, 1) before limits, and the next state z (4, 1): drag at the reference plus super-twisting."""
    error = reference - nu
    sign = ca.if_else(error > 0, 1, ca.if_else(error < 0, -1, 0))
    drag = p["linear_drag"] * reference + p["quadratic_drag"] * reference * ca.fabs(reference)
    thrust = drag + p["mass"] * (p["twist"] * ca.sqrt(ca.fabs(error)) * sign + state)
    return thrust, state + dt * p["twist_i"] * sign


def station() -> LawSource:
    """Return the law, with a state and a velocity controller of its own."""
    return LawSource("station", around, gains=OWN, state=(TURNED,), thrust=super_twisting)


def speed_error() -> Dynamics:
    """Return root = sqrt(|speed error|) sign(speed error) and z, with the time scaled by 2 |root|."""
    root, z = ca.vertsplit(x := ca.SX.sym("x", 2))
    drag = (VEHICLE["Xu"] + VEHICLE["Xuu"] * root * root) * root * ca.fabs(root) / VEHICLE["m11"]
    rates = [-(OWN["twist"].default * root + z + drag), 2 * OWN["twist_i"].default * root]
    states = (State("root", -0.4, 0.4, "m^0.5/s^0.5"), State("z", -0.1, 0.1, "m/s^2"))
    return Dynamics("twist", "continuous", states, tuple(from_casadi(x, ["root", "z"], rates)))


def main() -> int:
    """Print the example."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="16 points instead of 10,000, and 8 trials")
    quick = parser.parse_args().quick
    law, gains = law_ref("station.py:station", folder=HERE), load_gains("default").with_own(OWN)
    built, scenario = build_law(law), load_scenario(str(HERE / "orbit.toml"))
    points = every_combination(*({name: np.linspace(*ends, 4 if quick else 100)} for name, ends in AXES.items()))
    reached = simulate_batch(Case(scenario, VEHICLE, gains, law), points).column("reached") > 0
    print(f"sweep: {reached.size:,} runs, {reached.sum():,} reached the goal")

    tried = conditions(build_cases([scenario], [VEHICLE], gains=gains, law=law), seeds=[0])
    request = Request(GOALS, tried, gains, gain_ranges(gains, AXES))
    tuned = tune(request, trials=8 if quick else 128, rounds=1, runs=0).result
    text = ", ".join(f"{name} = {value:.3g}" for name, value in tuned.gains.items())
    print(f"tuned: {text}, score {tuned.score:.3f}, goals {'met' if tuned.score <= 1 else 'missed'}")

    exact = True
    for radius in (1.0, 0.0):
        run = simulate(scenario, VEHICLE, gains=gains.with_values({**tuned.gains, "radius": radius}), law=built)
        r = run.record
        report = software_in_the_loop(built, Records(r.law_state, r.law_input, r.law_parameters))
        print(f"radius {radius:g} m: {run.metrics.stopped_because} at {run.metrics.time_s:.1f} s;", report.summary())
        exact = exact and report.exact
    try:
        steady_motion(run)
    except InputError as error:
        print(f"margins: not judged, the run {error.problem}")

    claim = find_stability(speed_error(), degree=2)
    print(
        f"claim, speed error in continuous time, without lag and limit: {claim.verdict}: {claim.volume:.0%} of the box"
    )
    proved = claim.verdict == "proved" and check_document(dict(claim.decision.document)).accepted
    return 0 if run.metrics.reached and exact and proved else 1


if __name__ == "__main__":
    sys.exit(main())
