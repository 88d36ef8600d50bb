"""A mission with true positions as a `System`: vehicle, surroundings, disturbances and law as its parts."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.marine.control import Gains, Law, check_forces, law_options
from surctl.marine.guidance import FOLLOWING, MAX_WAYPOINTS, follow
from surctl.marine.simulation.batch.case import Case, vehicle_law
from surctl.marine.simulation.batch.engines import Packed, structure_of
from surctl.marine.simulation.batch.loop import clearances, free_column, loop_of, obstacle_points, pushed, with_walls
from surctl.marine.simulation.batch.structure import Structure
from surctl.marine.simulation.metrics import ABSENT, path_square
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.sensors import FIRING
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import PLANT_DISTURBANCE, Vehicle, vehicle_plant
from surctl.marine.vehicle.linearise import DELIVERED, valued
from surctl.system import Cost, Parts, Sampled, System
from surctl.system.sampled import CLOCK

_STEPS = 6  # of integration in a control period
_COMMAND = Layout((Port("tau", (4,), "N, N m", "thrust command in {B}"),))
_POSE = Layout((Port("eta", (4,), "m, rad", "x, y, z and heading in {E}"),))


def mission_system(
    scenario: Scenario,
    vehicle: Vehicle,
    *,
    gains: Gains,
    law: Law | None = None,
    seed: int = 0,
    model: Vehicle | None = None,
) -> System:
    """Return the closed loop that `simulate` runs with true positions, for everything that works on a `System`.

    The numbers of the mission, of the vehicle and of the gains are the defaults of the loop's parameters. It runs until
    the target is reached, the hull touches something, or the time limit is over; it continues in a dead end. Steps of
    integration have equal lengths, so the motion agrees with that of `simulate` to rounding and to 1e-9 of its error.

    Args:
        scenario, vehicle, gains, seed, model: same meaning as for `simulate`.
        law: a law without sonar inputs; default: the law for the vehicle's forces.

    Raises:
        InputError: the law uses sonars; the hull starts inside an obstacle; the path is fed to the law (`Path.fed`); or
            the thrusters deliver another force than the law commands, because it has no allocation or they are fins.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.simulation import load_scenario, mission_system
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.system import run_system
        >>> mission, boat, law = load_scenario("pool-behind"), load_vehicle("sur400"), build_law("closed_form")
        >>> loop = mission_system(mission, boat, gains=load_gains("default"), law=law)
        >>> run = run_system(loop, 5.0, {"k_v": 1.5})
        >>> run["eta"][-1, :2].round(2).tolist(), round(run["min_clearance_m"], 2)
        ([1.6, 1.12], 0.22)
    """
    law = law or vehicle_law(vehicle, scenario=scenario)
    check_forces(law.ref, vehicle)
    _check(scenario, vehicle, law)
    build_world(scenario, vehicle, seed=seed)  # refuses a start inside an obstacle
    case = Case(scenario, vehicle, gains, law.ref, model=model, **law_options(law))
    structure = replace(structure_of(case, {}), actuators=None)
    loop = loop_of(structure, law, single=True)
    numbers = loop.parameters.unpack(Packed(case, loop, {}, np.array([seed])).parameters[0])

    def part(*names: str) -> Layout:
        return valued(Layout(tuple(loop.parameters.port(name) for name in names if name in loop.parameters)), numbers)

    bodies = tuple(f"body{k}" for k in range(len(structure.bodies)))
    surroundings = part("world_hull", "walls", *bodies, "there", "heights", "depths")
    return System(
        vehicle_plant(vehicle, scenario.start_pose),
        replace(law, gains=valued(law.gains, numbers), inputs=valued(law.inputs, numbers)),
        substeps=_STEPS,
        sensors=(
            _surroundings(structure, law, surroundings),
            _progress(part("waypoints", "legs", "visited", "arrival_radius")),
        ),
        actuators=(
            Sampled(
                "thrusters", _COMMAND, DELIVERED, lambda x, u, p, w: u["tau"] * p["thrust_gain"] + p["thrust_bias"],
                parameters=part("thrust_gain", "thrust_bias"),
            ),
            Sampled(
                "water", CLOCK, PLANT_DISTURBANCE, lambda x, u, p, w: pushed(p, u["time"]),
                parameters=part("current", "wave", "drift"), period=FIRING,
            ),
        ),
        costs={
            "min_clearance_m": Cost(lambda s: s.y["least"], "final", "m", "smallest distance to obstacle or wall"),
            "deviation_m": Cost(lambda s: s.y["off_path"], "rms", "m", "rms horizontal distance to the path"),
            "max_deviation_m": Cost(lambda s: s.y["off_path"], "max", "m", "largest horizontal distance to the path"),
            "effort_n": Cost(lambda s: ca.norm_2(s.f["tau"][:2]), "mean", "N", "mean horizontal thrust command"),
        },
        stops={"collision": lambda s: s.y["clear_water"] <= 0, "reached": lambda s: s.y["arrived"] > 0.5},
        duration=scenario.time_limit,
    )  # fmt: skip


def _check(scenario: Scenario, vehicle: Vehicle, law: Law) -> None:
    if scenario.path.fed:
        raise InputError(
            f"has more than {MAX_WAYPOINTS} points, or speeds or depths for its legs, which this system does not have",
            file=scenario.source or None, key="path_m",
            remedy=f"give at most {MAX_WAYPOINTS} points, or use simulate",
        )  # fmt: skip
    if "samples" in law.inputs:
        problem = "uses sonars, but this system provides only the true positions of the obstacles"
        raise InputError(problem, key="law", value=law.name, remedy="build the law with sonar=False")
    if vehicle.actuators is not None and (law.actuators is None or vehicle.actuators.fins):
        problem = "has thrusters whose force is not that of the law's command"
        remedy = "give the law allocation; a craft with fins has none: use simulate"
        raise InputError(problem, key="vehicle", value=vehicle.name, remedy=remedy)


def _surroundings(structure: Structure, law: Law, parameters: Layout) -> Sampled:
    """Return the sensor of obstacles and walls: what the law receives of them, and distances of the hull."""
    shown = tuple(law.inputs.port(name) for name in ("contacts", "column") if name in law.inputs)
    distances = (
        Port("clear_water", (1,), "m", "distance to the nearest obstacle or wall", ABSENT),
        Port("least", (1,), "m", "smallest such distance so far", ABSENT),
    )

    def step(x: Parts, u: Parts, p: Parts, w: Parts) -> dict[str, ca.SX]:
        bodies, eta = structure.bodies_at(p, u["time"]), u["eta"]
        distances = clearances(bodies, p, eta[:3])
        clear, distance = with_walls(x["clear"], distances)
        after = {"clear": clear, "clear_water": distance, "least": ca.fmin(x["least"], ca.mmin(distances))}
        if "contacts" in law.inputs:
            near = [body.beside(eta[2], p["world_hull"]) for body in bodies]
            after["contacts"] = obstacle_points(near, eta, law.inputs.port("contacts").shape[0])
        if "column" in law.inputs:
            after["column"] = free_column(bodies, p, eta) if structure.depths else ca.SX.zeros(2)
        return after

    inputs, state = Layout((*_POSE, *CLOCK)), Layout((Port("clear", (1,), "1", "1 after the hull was clear of walls"),))
    return Sampled("surroundings", inputs, Layout((*shown, *distances)), step, state, parameters, period=FIRING)


def _progress(parameters: Layout) -> Sampled:
    """Return the monitor of the robot's progress along its path."""
    outputs = Layout((
        Port("off_path", (1,), "m", "horizontal distance to the path"),
        Port("arrived", (1,), "1", "1 within the arrival radius of the target, on the last leg"),
    ))  # fmt: skip

    def step(x: Parts, u: Parts, p: Parts, w: Parts) -> dict[str, ca.SX]:
        place, points = u["eta"][:2], p["waypoints"]
        following = follow(x, points, p["legs"], place, visit=p["visited"])
        left = ca.norm_2(place - points[MAX_WAYPOINTS - 1, :].T)
        last = following["leg"] > p["legs"] - 1.5
        off = ca.sqrt(path_square(points, following["leg"], place))
        return {**following, "off_path": off, "arrived": ca.logic_and(last, left <= p["arrival_radius"])}

    return Sampled("progress", _POSE, outputs, step, Layout(FOLLOWING), parameters)
