"""Compare times in the paper (transients, detection and passing of moving obstacles) with those of simulated runs."""

from __future__ import annotations

from functools import partial

import numpy as np

from surctl.marine.reproduction.row import Item, Result, agrees, differs
from surctl.marine.reproduction.scenarios import ABOUT, time_verdict
from surctl.marine.reproduction.simulations import Simulations, scenario_names
from surctl.marine.simulation import Run
from surctl.marine.world import Box, Disc

__all__ = ["avoidances", "instant_items", "passed_at"]

_APART = 1.0  # [s] a shorter interruption does not end an avoidance


def instant_items(simulations: Simulations) -> list[Item]:
    """Return a comparison for each time that the paper gives for a scenario of the library."""
    items = []
    for name in scenario_names():
        paper = simulations.scenario(name).paper
        figures = [
            ("transients", f"near {', '.join(f'{t:g}' for t in paper.transients_s)} s", bool(paper.transients_s))
        ]
        figures += [("detected", f"at about {paper.detected_s} s", paper.detected_s is not None)]
        figures += [("passed", f"by {paper.passed_s} s", paper.passed_s is not None)]
        items += [
            Item(
                f"{name}-{what}",
                "scenarios",
                f"{_WORDS[what]} in {name}, true positions, seed 0",
                words,
                None,
                partial(_COMPUTED[what], simulations, name),
                f"surctl reproduce {name}-{what}",
            )
            for what, words, printed in figures
            if printed
        ]
    return items


def avoidances(run: Run) -> list[float]:
    """Return the start times [s] of the intervals in which the law avoids an obstacle."""
    time = run.record.time[run.telemetry("avoiding")[:, 0] > 0.5]
    return [float(t) for k, t in enumerate(time) if k == 0 or t - time[k - 1] > _APART]


def passed_at(run: Run) -> float:
    """Return the last time [s] at which a moving obstacle is ahead of the robot; 0 if there is no such time.

    Ahead means farther in the direction from start to target.
    """
    direction = run.scenario.target - run.scenario.start
    last = 0.0
    for time, eta, bodies in zip(run.record.time, run.record.eta, run.record.obstacles, strict=True):
        for body in bodies:
            if body.moving and isinstance(body.shape, Disc | Box):
                ahead = (np.asarray(body.shape.center) - eta[:2]) @ direction
                last = float(time) if ahead > 0 else last
    return last


def _transients(simulations: Simulations, name: str) -> Result:
    ours, paper = avoidances(simulations.run(name)), simulations.scenario(name).paper.transients_s
    text = f"avoidance begins at {', '.join(f'{t:.1f}' for t in ours) or 'no time'} s"
    numbers = {f"begins_{k}_s": t for k, t in enumerate(ours)}
    off = [min((abs(t - t0) / t0 for t in ours), default=np.inf) for t0 in paper]
    if len(ours) == len(paper) and max(off) <= ABOUT:
        return agrees(text, **numbers)
    scenario, radius = simulations.scenario(name), simulations.run(name).vehicle["radius"]
    path = [(float(x), float(y)) for x, y in np.linspace(scenario.start, scenario.target, 200)]
    clearances = [min(obstacle.distance(point) for point in path) - radius for obstacle in scenario.obstacles]
    left = ", ".join(f"{clearance:.2f}" for clearance in clearances)
    why = f"{len(ours)} instead of {len(paper)}: on the straight path, the clearances to the obstacles are {left} m"
    return differs(text, why, **numbers)


def _detected(simulations: Simulations, name: str) -> Result:
    ours, paper = avoidances(simulations.run(name)), simulations.scenario(name).paper.detected_s or np.nan
    if not ours:
        return differs(
            "no avoidance was needed",
            f"the robot's path stays clear of the obstacle, so the paper's {paper:g} s has no counterpart",
        )
    good, off = time_verdict(ours[0], paper, "about")
    text, apart = f"avoidance begins at {ours[0]:.2f} s", _apart(simulations.run(name), ours[0])
    if good:
        return agrees(text, begins_s=ours[0], apart_m=apart)
    why = f"{off}: the law receives the obstacle's true position and begins to avoid at {apart:.2f} m between centres"
    return differs(text, why, begins_s=ours[0], apart_m=apart)


def _passed(simulations: Simulations, name: str) -> Result:
    ours, paper = passed_at(simulations.run(name)), simulations.scenario(name).paper.passed_s or np.nan
    good, off = time_verdict(ours, paper, "about")
    text = f"no moving obstacle is ahead after {ours:.2f} s"
    return agrees(text, passed_s=ours) if good else differs(text, off, passed_s=ours)


def _apart(run: Run, time: float) -> float:
    # [m], between the centres of robot and moving body; inf without a moving body
    k = int(np.argmin(np.abs(run.record.time - time)))
    centres = [b.shape.center for b in run.record.obstacles[k] if b.moving and isinstance(b.shape, Disc | Box)]
    return min((float(np.hypot(*(np.asarray(c) - run.record.eta[k, :2]))) for c in centres), default=float("inf"))


_WORDS = {
    "transients": "start times of avoidance",
    "detected": "start time of avoidance of the moving obstacle",
    "passed": "time after which no moving obstacle is ahead",
}
_COMPUTED = {"transients": _transients, "detected": _detected, "passed": _passed}
