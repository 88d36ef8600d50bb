"""A control law of one's own: follow the wall y = 0 at a set distance, facing it, by four prioritised tasks.

surctl simulate wall.toml --law wall_law.py:wall
"""

import casadi as ca

from surctl.control import Decision, GainSpec, LawSource, Situation
from surctl.tasks import Task, depth_task, heading_task

GAINS = {
    "k_wall": GainSpec("1/s", "gain of the distance to the wall", default=0.4, range=(0.1, 1.5)),
    "stand_off": GainSpec("m", "distance of the robot's centre from the wall", default=0.8, range=(0.6, 1.2)),
}


def decide(s: Situation) -> Decision:
    """Return the four tasks, highest priority first: distance, progress along the wall, heading, depth."""
    x, y = s.eta[0], s.eta[1]
    wall, end = s.p["walls"][2], s.p["waypoints"][-1, 0]
    keep = Task(name="distance", eta=s.eta, sigma=y, target=wall + s.p["stand_off"], gain=s.p["k_wall"], unit="m")
    speed = ca.fmin(ca.fmax(s.p["k1"] * (end - x), -s.p["cruise"]), s.p["cruise"])
    along = Task(name="along", eta=s.eta, sigma=x, target=x, rate=speed, unit="m")
    facing = heading_task(s.eta, -ca.pi / 2, gain=s.p["k_psi"])
    return Decision([keep, along, facing, depth_task(s.eta, s.p["depth"], gain=s.p["k2"])])


def wall() -> LawSource:
    """Return the law."""
    return LawSource("wall_follower", decide, gains=GAINS)
