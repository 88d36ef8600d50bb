"""Why a law with senses stood still until its run was ended, in words."""

from __future__ import annotations

import numpy as np

from surctl.errors import InputError
from surctl.simulation.run import Run

__all__ = ["halt_reason"]


def halt_reason(run: Run) -> str:
    """What the law did not know at the end of a run that ended as `halted`: one sentence without a full stop.

    Raises:
        InputError: the run ended otherwise.
    """
    law, record, why = run.law, run.record, run.metrics.stopped_because
    if why != "halted" or law.senses is None:
        raise InputError("is no run that halted", key="run", value=why)
    told = law.told(record.law_state[-1], record.law_input[-1], record.law_parameters)
    silent = np.flatnonzero(run.telemetry("healthy")[-1] < 0.5).tolist()
    if told[law.senses.told.slice("placed")][0] < 0.5:
        return "the robot does not know where it is" + (f"; {_named(silent)} not believed" if silent else "")
    if len(silent) == law.outputs.port("healthy").size:
        return f"no sonar can be believed ({', '.join(map(str, silent))})"
    if not silent:
        return "places ahead stay unknown, though every sonar is believed"
    return f"places ahead stay unknown; {_named(silent)} not believed"


def _named(sensors: list[int]) -> str:
    if len(sensors) == 1:
        return f"sonar {sensors[0]} is"
    return f"sonars {', '.join(map(str, sensors[:-1]))} and {sensors[-1]} are"
