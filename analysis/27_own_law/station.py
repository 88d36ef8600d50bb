"""Example: station keeping with super-twisting (`orbit_law.py`) through the whole chain.

    python analysis/27_own_law/station.py            # 10,000 runs
    python analysis/27_own_law/station.py --quick    # 100 runs

Status 0 if the run arrives, the loop is stable, both claims have the stated verdict, and C equals Python, else 1.
"""

from __future__ import annotations

import sys

import casadi as ca
from chain import SECONDS, VEHICLE, chain, dynamics, proved
from orbit_law import STATION, super_twisting

from surctl.lyapunov import Dynamics, Stability, State, decide_motion
from surctl.tuning import Goal
from surctl.verification.formula import parse, variable

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
    if not sampled:
        rates = [-(p["twist"] * root + z + drag), 2 * p["twist_i"] * root]
        return dynamics("super-twisting", states, x, rates)
    p |= {"linear_drag": ca.SX(0), "quadratic_drag": ca.SX(0), "mass": ca.SX(1)}
    force, after = super_twisting(ca.SX(0), -error, z, p, 0.05)
    error = error - 0.05 * (force + drag)
    return dynamics("sampled", states, x, [ca.if_else(error < 0, -1, 1) * ca.sqrt(ca.fabs(error)), after], "discrete")


def main() -> int:
    """Print the example."""
    axes = {"twist": (0.05, 1.0), "twist_i": (0.001, 0.2)}
    fine = chain("orbit_law.py:station", "orbit.toml", axes, GOALS, __doc__)
    claimed = proved(speed_error(sampled=False), "speed error in continuous time, without thrust lag and limit")
    sampled, names = speed_error(sampled=True), {name: variable(name) for name in ("root", "z")}
    denied = decide_motion(Stability(sampled, parse("root^2 + 10 * z^2", names), 0.01), time_limit=SECONDS)
    print(f"claim, root^2 + 10 z^2 < 0.01 decreases at each sample: {denied.verdict}, {denied.reason}")
    return 0 if fine and claimed and denied.verdict == "refuted" else 1


if __name__ == "__main__":
    sys.exit(main())
