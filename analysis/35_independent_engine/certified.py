"""Starts inside a certified region, simulated in MuJoCo: none may leave the region.

The claim `region-cruise-20-lag` covers mass and drag uncertain by ±20 %, commands held for one control period, and
thrust lag. It says nothing of roll and pitch: the runs have six degrees of freedom.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surctl.ir import compile_block
from surctl.marine.control import Gains, build_law
from surctl.marine.engine import EngineOptions, MujocoPhysics
from surctl.marine.guidance import Path
from surctl.marine.simulation import law_numbers, load_scenario
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import Vehicle, load_vehicle, plant_state
from surctl.marine.vehicle.parameters import Parameter
from surctl.marine.verification.region import prove_statement, region_statement

CLAIM = "region-cruise-20-lag"
SECONDS = 30.0


def confronted(gains: Gains, starts: int) -> tuple[str, bool]:
    """Return a text about the runs, and whether none left the region."""
    nominal, tilting = load_vehicle("sur540-flooded"), load_vehicle("sur540-tilting")
    proof = prove_statement(region_statement(CLAIM), nominal, gains)
    claim, (_, bound) = proof.claim, proof.ultimate_bound
    path = Path(np.array([[5.0, 20.0], [45.0, 20.0]]))
    empty = replace(load_scenario("tank-static"), obstacles=(), site=(60.0, 40.0, 20.0), path=path, depth=-8.0)
    scenario = replace(empty, cruise=claim.cruise, cap=claim.cap)
    law = build_law(equipment=scenario.sensors.on(nominal["radius"]))
    native, p = compile_block(law.block), law_numbers(scenario, gains, nominal)
    rng = np.random.default_rng(35)
    largest, last = np.zeros(starts), np.zeros(starts)
    tilt = 0.0
    for k in range(starts):
        offset = proof.offset * (2 * rng.random() - 1) if k % 2 else proof.offset * rng.choice([-1.0, 1.0])
        share = rng.random(3)
        if k % 4 == 0:
            share = np.round(share)  # corners of the parameter box
        mass, linear, quadratic = (
            low + s * (high - low)
            for s, (low, high) in zip(share, (claim.mass, claim.linear, claim.quadratic), strict=True)
        )
        values = {"m11": mass, "m22": mass, "m33": mass, "Xu": linear, "Yv": linear, "Xuu": quadratic, "Yvv": quadratic}
        aside, tilted = _run(scenario, with_parameters(tilting, values), law, native, p, offset)
        largest[k], last[k], tilt = float(aside.max()), float(aside[-1]), max(tilt, tilted)
    left = int(np.sum(largest > proof.extent))
    outside = int(np.sum(last > bound))
    text = f"""## Certified regions
`{CLAIM}`: from {proof.offset:.3f} m beside the path, with the velocity of the target point, V decays
at {claim.rate:g}/s until the robot is within {bound:.3f} m across the path; no point of the region is more than
{proof.extent:.3f} m beside it. {starts} runs of {SECONDS:g} s in MuJoCo with six degrees of freedom, which the claim
does not cover, from starts in this range (half of them at its ends), with mass and drag drawn from the claim's ranges
(a quarter at the corners): {left} left the region, {outside} ended outside the bound. Largest distance from the path
{largest.max():.3f} m, at the end {last.max():.4f} m; largest tilt {np.rad2deg(tilt):.1f}°."""
    return text, left == 0 and outside == 0


def with_parameters(vehicle: Vehicle, values: dict[str, float]) -> Vehicle:
    """Return the vehicle with other values, whatever their ranges."""
    known = dict(vehicle.parameters)
    known |= {name: Parameter(float(value), known[name].unit, None, "study") for name, value in values.items()}
    return replace(vehicle, parameters=known)


def _run(scenario, vehicle, law, native, p, offset) -> tuple[NDArray[np.float64], float]:  # type: ignore[no-untyped-def]
    world = build_world(scenario, vehicle, seed=0)
    physics = MujocoPhysics(world, vehicle, scenario.sensors.array_on(vehicle["radius"]), EngineOptions())
    start = scenario.start_pose + np.array([0.0, offset, 0.0, 0.0])
    physics.state = plant_state(vehicle.form).pack({"eta": start, "nu": [scenario.cruise, 0, 0, 0]})
    x, aside, tilt = law.initial_state(), [], 0.0
    for step in range(round(SECONDS / law.dt)):
        state = physics.state
        aside.append(abs(state[1] - 20.0))
        tilt = max(tilt, float(np.abs(state[12:14]).max()))
        u = law.inputs.pack({"eta": state[:4], "nu": state[4:8]})
        tau, x, *_ = native(x, u, p)
        for half in range(2):
            physics.advance(tau, step * law.dt + half * 0.025)
    return np.array(aside), tilt
