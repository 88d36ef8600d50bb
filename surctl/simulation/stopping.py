"""Why a law stood still until its run was ended, in words."""

from __future__ import annotations

import numpy as np

from surctl.errors import InputError
from surctl.simulation.run import Run, depth_changes

__all__ = ["stop_reason"]


def stop_reason(run: Run) -> str:
    """Why a run ended as `stopped` or `dead end`: one sentence without a full stop.

    What the law did not know, or where it gave up and for how long it had not got on.

    Raises:
        InputError: the run ended otherwise.

    Example:
        >>> from dataclasses import replace
        >>> from surctl.control import load_gains
        >>> from surctl.simulation import Obstacle, stop_reason, load_scenario, simulate
        >>> from surctl.vehicle import load_vehicle
        >>> wall = Obstacle(name="wall", shape="box", centre_m=(2.0, 1.0), size_m=(0.2, 2.0))
        >>> mission = replace(load_scenario("pool-behind"), obstacles=(wall,))
        >>> run = simulate(mission, load_vehicle("sur400"), gains=load_gains("default").with_values({"patience": 5.0}))
        >>> print(f"{run.metrics.stopped_because}: {stop_reason(run)}")
        dead end: no way on for 5 s, given up at (1.65, 0.79) m after 28 s; it came 0.9 m along a path of 2.0 m
    """
    law, record, why = run.law, run.record, run.metrics.stopped_because
    if why == "dead end":
        return _dead_end_reason(run)
    if why != "standstill" or law.perception is None:
        raise InputError("did not end at a standstill", key="run", value=why)
    perceived = law.decision_inputs(record.law_state[-1], record.law_input[-1], record.law_parameters)
    silent = np.flatnonzero(run.telemetry("healthy")[-1] < 0.5).tolist()
    if perceived[law.perception.outputs.slice("placed")][0] < 0.5:
        return "the robot does not know where it is" + (f"; {_named(silent)} not believed" if silent else "")
    if len(silent) == law.outputs.port("healthy").size:
        return f"no sonar can be believed ({', '.join(map(str, silent))})"
    if not silent:
        return "places ahead stay unknown, though every sonar is believed"
    return f"places ahead stay unknown; {_named(silent)} not believed"


def _dead_end_reason(run: Run) -> str:
    """Where the law found no way on, and how far along the path that is."""
    law, record = run.law, run.record
    first = int(np.argmax(run.telemetry("trapped").ravel() > 0.5))
    x, y = record.eta[first, :2]
    state = record.law_state[first]
    furthest, stalled = (float(state[law.state.slice(name)][0]) for name in ("furthest", "stalled"))
    length = run.scenario.path.length
    tried = [f"{change.to_m:.2f}" for change in depth_changes(run) if not change.back]
    depths = f"; depths tried besides the path's, z in m: {', '.join(tried)}" if tried else ""
    return (
        f"no way on for {stalled:.0f} s, given up at ({x:.2f}, {y:.2f}) m after "
        f"{record.time[first]:.0f} s; it came {furthest:.1f} m along a path of {length:.1f} m{depths}"
    )


def _named(sensors: list[int]) -> str:
    if len(sensors) == 1:
        return f"sonar {sensors[0]} is"
    return f"sonars {', '.join(map(str, sensors[:-1]))} and {sensors[-1]} are"
