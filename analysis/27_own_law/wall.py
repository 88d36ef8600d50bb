"""Example: the wall follower of `wall_law.py` through the whole chain in Python; `run.py` has it by commands alone.

    python analysis/27_own_law/wall.py            # 10,000 runs
    python analysis/27_own_law/wall.py --quick    # 100 runs

Status 0 if the run arrives, the loop is stable, its claim is proved, and C equals Python, else 1.
"""

from __future__ import annotations

import sys

import casadi as ca
from chain import GAINS, VEHICLE, chain, dynamics, proved
from wall_law import GAINS as OWN

from surctl.control.velocity import velocity_control
from surctl.lyapunov import Dynamics, State
from surctl.tuning import Goal

FAR = 1e9  # N, limit of the thrust in the claim: none
GOALS = (Goal("arrive soon", "time_s", "s", 40.0), Goal("stay near the path", "deviation_m", "m", 0.1))


def distance() -> Dynamics:
    """Return the error of the distance to the wall and the speed towards it, below the limit of the thrust."""
    gap, speed = ca.vertsplit(x := ca.SX.sym("x", 2))
    none = ca.SX.zeros(3)
    model = {name: ca.SX(getattr(VEHICLE, name).tolist()) for name in ("mass", "linear_drag", "quadratic_drag")}
    reference, nu = ca.vertcat(-OWN["k_wall"].default * gap, none), ca.vertcat(speed, none)
    gains = {name: GAINS[name] for name in ("k_v", "k_r", "k_i")}
    tau, *_ = velocity_control(
        reference, nu, ca.SX.zeros(4), {**model, "thrust_limit": ca.SX.zeros(4) + FAR}, dt=0.05, **gains
    )
    drag = (VEHICLE["Xu"] + VEHICLE["Xuu"] * ca.fabs(speed)) * speed
    states = (State("gap", -0.4, 0.4, "m"), State("speed", -0.2, 0.2, "m/s"))
    return dynamics("wall-distance", states, x, [speed, (tau[0] - drag) / VEHICLE["m11"]])


def main() -> int:
    """Print the example."""
    fine = chain("wall_law.py:wall", "wall.toml", {"k_wall": (0.2, 0.8), "stand_off": (0.7, 1.0)}, GOALS, __doc__)
    claimed = proved(distance(), "distance to the wall, without thrust lag, while no thrust is at its limit")
    return 0 if fine and claimed else 1


if __name__ == "__main__":
    sys.exit(main())
