"""Wall following: a law of your own with four tasks

The robot keeps a set distance to a wall and faces it, while it moves along the wall. The law is one function that
returns tasks in order of priority; surctl adds the priority solver, the velocity control and the loop.
"""

from dataclasses import replace

import casadi as ca

from surctl.marine.control import Decision, GainSpec, LawSource, build_law, law_ref, load_gains
from surctl.marine.guidance import Path
from surctl.marine.report import plot_run
from surctl.marine.simulation import load_scenario, simulate
from surctl.marine.testing import check_law
from surctl.marine.vehicle import load_vehicle
from surctl.tasks import Task, depth_task, heading_task

GAINS = {
    "k_wall": GainSpec("1/s", "gain of the distance to the wall", default=0.4, range=(0.1, 1.5)),
    "stand_off": GainSpec("m", "distance of the robot's centre from the wall", default=0.8, range=(0.6, 1.2)),
}


def decide(s):
    """Four tasks, highest priority first: distance, progress along the wall, heading, depth."""
    x, y = s.eta[0], s.eta[1]
    keep = Task(
        name="distance", eta=s.eta, sigma=y, target=s.p["stand_off"], gain=s.p["k_wall"], unit="m", kinematics="vehicle"
    )
    speed = ca.fmin(s.p["cruise"], s.p["k1"] * (s.p["waypoints"][-1, 0] - x))
    along = Task(name="along", eta=s.eta, sigma=x, target=x, rate=speed, unit="m", kinematics="vehicle")
    facing = heading_task(s.eta, -ca.pi / 2, gain=s.p["k_psi"])
    return Decision([keep, along, facing, depth_task(s.eta, s.p["depth"], gain=s.p["k2"])])


def wall():
    """The law; `surctl simulate SCENARIO --law wall_following.py:wall` takes it too."""
    return LawSource("wall_follower", decide, gains=GAINS)


if __name__ == "__main__":
    print("levels:", ", ".join(f"{name} ({size})" for name, size in check_law(wall()).levels))
    tank = load_scenario("tank-static")
    mission = replace(tank, name="wall", obstacles=(), path=Path([[1.0, 1.1], [5.0, 0.8]]), time_limit=60.0)
    gains = load_gains("default").with_own(GAINS)
    run = simulate(mission, load_vehicle("sur540-flooded"), gains=gains, law=build_law(law_ref(f"{__file__}:wall")))
    metrics = run.metrics
    print(f"{metrics.stopped_because} after {metrics.time_s:.2f} s, least clearance {metrics.min_clearance_m:.2f} m")
    plot_run(run).figure.savefig("wall_following.png")
