"""The commands of the application, and its branches of the common commands: options and work for robot and mission."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from surctl.cli.application import Application
from surctl.marine.cli.export import export
from surctl.marine.cli.fly import fly
from surctl.marine.cli.gains import gains
from surctl.marine.cli.lint import lint
from surctl.marine.cli.mission import scenario
from surctl.marine.cli.reproduce import reproduce
from surctl.marine.cli.simulate import simulate
from surctl.marine.cli.study import study
from surctl.marine.cli.sweep import sweep
from surctl.marine.cli.tune import tune
from surctl.marine.cli.vehicle import vehicle
from surctl.marine.cli.verify import verify

__all__ = ["APPLICATION"]


def _libraries() -> Mapping[str, Path]:
    from surctl.marine import control, simulation, study, vehicle

    return {
        "vehicles": vehicle.LIBRARY,
        "gains": control.LIBRARY,
        "scenarios": simulation.LIBRARY,
        "studies": study.LIBRARY,
    }


def _listed() -> Mapping[str, Sequence[str]]:
    from surctl.marine.verification import claims
    from surctl.marine.verification.braking import BRAKING_CLAIMS
    from surctl.marine.verification.region import REGION_CLAIMS

    return {"claims": [c.name for c in claims()], "regions": list(REGION_CLAIMS), "braking": list(BRAKING_CLAIMS)}


def _laws() -> Collection[str]:
    from surctl.marine.control.registry import LAWS

    return {*LAWS, *(source.name for source in LAWS.values())}


APPLICATION = Application(
    takes=lambda words: True,
    commands={
        vehicle: "Write a vehicle file from dimensions, a log or a model.",
        gains: "Write the gains that follow from a vehicle.",
        scenario: "Write a scenario file from a mission of another program.",
        fly: "Steer an ArduSub vehicle along a scenario's path.",
        reproduce: "Compute the results of the robot's paper again.",
    },
    branches={str(one.name): one for one in (study, simulate, verify, sweep, tune, export, lint)},
    libraries=_libraries,
    listed=_listed,
    reserved=_laws,
)
"""What `surctl.marine` adds to the command line."""
