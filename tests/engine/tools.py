"""Vehicles and steps of MuJoCo for the tests of this folder."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Mapping
from dataclasses import replace

import pytest

from surctl.marine.engine import EngineOptions, MujocoPhysics
from surctl.marine.engine.mjcf import mujoco_library as library
from surctl.marine.simulation import OwnPhysics, load_scenario
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.vehicle.parameters import Parameter

# MuJoCo must not be imported here: surctl first chooses what renders without a screen; under CI it must be installed
if os.environ.get("CI") != "true" and importlib.util.find_spec("mujoco") is None:
    pytest.skip("needs MuJoCo: pip install 'surctl[mujoco]'", allow_module_level=True)

STILL = replace(load_scenario("tank-static"), obstacles=(), site=(400.0, 400.0, 400.0), depth=-150.0)
MIDDLE = (200.0, 200.0, -150.0)


def with_values(vehicle: Vehicle, values: Mapping[str, float]) -> Vehicle:
    """The vehicle with other values, of terms also that it does not have."""
    known = dict(vehicle.parameters)
    for name, value in values.items():
        known[name] = Parameter(float(value), "", None, "test")
    from surctl.marine.vehicle import PARAMETERS, TERMS

    ordered = {name: known[name] for name in (*PARAMETERS, *TERMS) if name in known}
    return replace(vehicle, parameters=ordered)


NO_DRAG = dict.fromkeys(("Xu", "Yv", "Zw", "Nr", "Xuu", "Yvv", "Zww", "Nrr"), 0.0)
NO_TILT_DRAG = dict.fromkeys(("Kp", "Mq", "Kpp", "Mqq"), 0.0)


def physics(vehicle: Vehicle, **options: object) -> MujocoPhysics:
    world = build_world(STILL, vehicle, seed=0)
    array = STILL.sensors.array_on(vehicle["radius"])
    return MujocoPhysics(world, vehicle, array, EngineOptions(**options))  # type: ignore[arg-type]


def own(vehicle: Vehicle) -> OwnPhysics:
    return OwnPhysics(build_world(STILL, vehicle, seed=0), vehicle, STILL.sensors.array_on(vehicle["radius"]))


__all__ = ["MIDDLE", "NO_DRAG", "NO_TILT_DRAG", "STILL", "library", "load_vehicle", "own", "physics", "with_values"]
