"""How a run of an unstable linear loop goes on: a bounded motion, such as a crab, or a departure from the path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from surctl.errors import InputError
from surctl.marine.control import Gains, Law
from surctl.marine.guidance import Path
from surctl.marine.simulation import mission_size, simulate, straight_mission
from surctl.marine.vehicle import Vehicle

__all__ = ["motion_text"]

# end of the first leg in hull lengths: a start on a straight path would hide that a loop is unstable
_BEND = (2.0, 0.5)


def motion_text(plant: Vehicle, model: Vehicle, gains: Gains, *, law: Law, cruise: float) -> str:
    """Return how one run of a vehicle goes on after a bend of the path, in words; empty if there is no such run.

    Args:
        plant: the vehicle that moves.
        model: the vehicle of the law's model.
        gains: gains of the law.
        law: a law for exact obstacle positions.
        cruise: cruise speed [m/s].
    """
    size = mission_size(model, gains, cruise=cruise)
    mission = straight_mission(model, cruise=cruise, size=size)
    first, last = mission.path.waypoints
    bend = first + 2 * size * np.array(_BEND)
    mission = replace(mission, path=Path(np.array([first, bend, last + np.array([0.0, bend[1] - first[1]])])))
    try:
        run = simulate(mission, plant, gains=gains, law=law, model=model)
    except InputError:
        return ""
    angle = np.degrees(np.arctan2(_BEND[1], _BEND[0]))
    head = f"its run after a bend of {angle:.0f} deg, in still water,"
    late = run.record.eta[len(run.record.eta) // 2 :]
    away, m = float(np.abs(late[:, 1] - bend[1]).max()), run.metrics
    if not m.reached:
        return f"{head} does not arrive ({m.stopped_because} at {m.time_s:.0f} s), up to {away:.3g} m from the path"
    crab = f"crabs by {m.crab_angle_deg:.0f} deg (at most {m.max_crab_angle_deg:.0f})"
    return f"{head} stays bounded: it arrives, {crab}, and its second half is within {away:.2g} m of the path"
