"""Explain in words why a run ended at a standstill, in a dead end, or with a number that is not finite."""

from __future__ import annotations

import numpy as np

from surctl.errors import InputError
from surctl.simulation.run import Run, depth_changes
from surctl.system.controller import lost_entry

__all__ = ["stop_reason"]


def stop_reason(run: Run) -> str:
    """Return why a run ended as `standstill`, `dead end` or `fault`, in one sentence without a full stop.

    The sentence names the information that the law lacked, or the position where it gave up and the time without
    progress, or the number that is not finite.

    Raises:
        InputError: the run ended for another reason.

    Example:
        >>> from dataclasses import replace
        >>> from surctl.control import load_gains
        >>> from surctl.simulation import Obstacle, stop_reason, load_scenario, simulate
        >>> from surctl.vehicle import load_vehicle
        >>> wall = Obstacle(name="wall", shape="box", centre_m=(2.0, 1.0), size_m=(0.2, 2.0))
        >>> mission = replace(load_scenario("pool-behind"), obstacles=(wall,))
        >>> run = simulate(mission, load_vehicle("sur400"), gains=load_gains("default").with_values({"patience": 5.0}))
        >>> print(f"{run.metrics.stopped_because}: {stop_reason(run)}")
        dead end: no progress for 5 s, search ended at (1.65, 0.79) m after 28 s; reached 0.9 m of the 2.0 m path
    """
    law, record, why = run.law, run.record, run.metrics.stopped_because
    if why == "dead end":
        return _dead_end_reason(run)
    if why == "fault":
        name = (
            lost_entry(law, record.law_state[-1], record.law_input[-1], record.parameters_at(-1))
            or "a number of the step"
        )
        return f"{name} is not finite at {record.time[-1]:.2f} s"
    if why != "standstill" or law.perception is None:
        raise InputError("ended neither at a standstill, in a dead end nor by a fault", key="run", value=why)
    perceived = law.decision_inputs(record.law_state[-1], record.law_input[-1], record.parameters_at(-1))
    silent = np.flatnonzero(run.telemetry("healthy")[-1] < 0.5).tolist()
    if perceived[law.perception.outputs.slice("placed")][0] < 0.5:
        return "the robot does not know its position" + (f"; {_named(silent)} judged faulty" if silent else "")
    if len(silent) == law.outputs.port("healthy").size:
        return f"all sonars are judged faulty ({', '.join(map(str, silent))})"
    if not silent:
        return "the water ahead stays unknown, although every sonar is judged healthy"
    return f"the water ahead stays unknown; {_named(silent)} judged faulty"


def _dead_end_reason(run: Run) -> str:
    law, record = run.law, run.record
    first = int(np.argmax(run.telemetry("trapped").ravel() > 0.5))
    x, y = record.eta[first, :2]
    state = record.law_state[first]
    furthest, stalled = (float(state[law.state.slice(name)][0]) for name in ("furthest", "stalled"))
    if run.scenario.path.fed:  # the law measures along its window
        follower = run.scenario.follower()
        follower.track(record.eta[: first + 1, :2])
        furthest = float(run.scenario.path.lengths[: follower.leg].sum()) + follower.along
    length = run.scenario.path.length
    tried = [f"{change.to_m:.2f}" for change in depth_changes(run) if not change.back]
    depths = f"; depths tried besides the path's, z in m: {', '.join(tried)}" if tried else ""
    return (
        f"no progress for {stalled:.0f} s, search ended at ({x:.2f}, {y:.2f}) m after "
        f"{record.time[first]:.0f} s; reached {furthest:.1f} m of the {length:.1f} m path{depths}"
    )


def _named(sensors: list[int]) -> str:
    if len(sensors) == 1:
        return f"sonar {sensors[0]} is"
    return f"sonars {', '.join(map(str, sensors[:-1]))} and {sensors[-1]} are"
