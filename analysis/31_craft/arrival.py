"""Study 31, second part: does a craft without sway force arrive at a goal beside it or behind it?

    python analysis/31_craft/arrival.py            # three minutes on two cores
    python analysis/31_craft/arrival.py --quick    # one craft, few short legs

Each craft begins at random places within three turning radii of its goal, with random headings, at its cruise speed
(`starts`); or its path has a last leg of 0.1 to 2 turning radii in a random direction (`short legs`). A steady current
flows across. The boats of the study's own are drawn at random: hulls of 1 to 8 m with two propellers, or with one and a
rudder. A run ends within half the hull radius of its goal, or after 60 turning radii at the cruise speed and 2 minutes.

Prints Markdown; the exit status is 1 if a run does not arrive.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.marine.control import Gains, default_law, law_source
from surctl.marine.control.steering import turning_radius
from surctl.marine.guidance import Path
from surctl.marine.simulation import Case, Scenario, law_numbers
from surctl.marine.simulation.batch.engines import Packed, compiled_loop, structure_of
from surctl.marine.simulation.batch.loop import build_loop
from surctl.marine.simulation.metrics import STOPS
from surctl.marine.simulation.scaling import mission_size, straight_mission
from surctl.marine.simulation.scenario import Disturbance
from surctl.marine.tuning import default_cruise, gains_for
from surctl.marine.vehicle import Vehicle, load_vehicle, plant_state
from surctl.marine.vehicle.parameters import PARAMETERS, vehicle_from_table

CRAFT = ("otter", "remus100", "lauv", "eca-a9")
BOATS = 9
CURRENTS = (0.0, 0.3, 0.6)  # of the cruise speed
STARTS, NEAR, FIRST_LEG = 200, 3.0, 8.0  # number; turning radii around the goal, and of the leg before the last

Array = NDArray[np.float64]


def boat(k: int) -> Vehicle:
    """Return a random boat; every third one has a rudder."""
    rng = np.random.default_rng(k)
    length = np.exp(rng.uniform(np.log(0.8), np.log(8.0)))
    mass, top = 12 * length**3 * rng.uniform(0.5, 2), rng.uniform(0.5, 1.2) * np.sqrt(length)
    force = mass * top**2 / length * rng.uniform(0.5, 1.5)
    sway, yaw = mass * rng.uniform(1.2, 2.2), mass * length**2 * rng.uniform(0.06, 0.15)
    numbers = {
        "radius": 0.55 * length, "m11": 1.1 * mass, "m22": sway, "m33": 2 * mass, "m44": yaw,
        "Xu": 0.3 * force / top, "Yv": rng.uniform(0.3, 1) * sway * top / length, "Zw": mass,
        "Nr": rng.uniform(0.3, 1) * yaw * top / length, "Xuu": 0.7 * force / top**2,
        "Yvv": rng.uniform(0, 2) * sway / length, "Zww": 0.0, "Nrr": rng.uniform(0, 3) * yaw,
        "Fu_max": force, "Fv_max": 0.0, "Fw_max": 0.0, "Fr_max": force * length * rng.uniform(0.05, 0.3),
        "thrust_lag": rng.uniform(0.05, 0.6),
    }  # fmt: skip
    table: dict[str, Any] = {"kind": "vehicle", "name": f"boat {k}"}
    stern, moment = [-0.45 * length, 0.0, 0.0], numbers["Fr_max"]
    finned = k % 3 == 2
    for name, value in numbers.items():
        if finned and name.endswith("_max"):
            continue
        spec = PARAMETERS[name]
        table.setdefault(spec.table, {"provenance": "random"})[name] = {"value": float(value), "unit": spec.unit}
    if finned:
        # the rudder gives the moment at 0.7 of the top speed
        lift = moment / (0.45 * length) / np.radians(25.0) / (0.5 * top**2)
        propeller = {
            "name": "propeller",
            "push": [1.0, 0.0, 0.0],
            "forward": f"{force} N",
            "reverse": f"{0.6 * force} N",
        }
        fin = {"name": "rudder", "push": [0.0, 1.0, 0.0], "fin": {"lift": f"{lift} N s^2/m^2", "limit_deg": 25.0}}
        table["allocation"] = {"order": ["yaw", "force", "effort"]}
        table["thruster"] = [{"at_m": stern, "provenance": "random"} | one for one in (propeller, fin)]
    return vehicle_from_table(table, source=f"boat{k}.toml")


def prepared(vehicle: Vehicle) -> tuple[Gains, float, float]:
    """Return the default gains, the cruise speed they bear [m/s], and the turning radius there [m]."""
    own, speed = law_source(default_law(vehicle)).gains, default_cruise(vehicle)
    gains, derivation = gains_for(None, vehicle, cruise=speed, own=own)
    if derivation is not None and not derivation.reached and derivation.bearable > 0:
        speed = derivation.bearable
        gains, _ = gains_for(None, vehicle, cruise=speed, own=own)
    return gains, speed, turning_radius(vehicle, gains.values, speed)


def mission(vehicle: Vehicle, gains: Gains, speed: float, radius: float, current: float) -> tuple[Scenario, Array]:
    """Return a mission of two legs in open water, and its corner; the last leg is a placeholder."""
    side = 60 * radius
    corner = np.array([side / 2, side / 2])
    path = Path(np.array([corner - [FIRST_LEG * radius, 0], corner, corner + radius]))
    template = straight_mission(vehicle, cruise=speed, size=mission_size(vehicle, gains, cruise=speed))
    return replace(
        template,
        path=path,
        site=(side, side, 20.0),
        depth=-4.0,
        arrival_radius=0.5 * vehicle["radius"],
        time_limit=60 * radius / speed + 120,
        disturbance=Disturbance(current_m_per_s=(0.0, current)),
    ), corner


def arrived(vehicle: Vehicle, *, share: float, count: int, short: bool) -> float:
    """Return the share of runs that arrive; `share`: current over cruise speed; `short`: short last legs or starts."""
    gains, speed, radius = prepared(vehicle)
    scenario, corner = mission(vehicle, gains, speed, radius, share * speed)
    rng = np.random.default_rng(5)
    if not short:
        scenario = replace(scenario, path=Path(scenario.path.waypoints[:2]))
    case = Case(scenario, vehicle, gains)
    loop = build_loop(structure_of(case, {}))
    packed = Packed(case, loop, {}, np.arange(count))
    state, numbers = packed.state.copy(), packed.parameters.copy()
    if short:
        reach, angle = radius * rng.uniform(0.1, 2.0, count), rng.uniform(-np.pi, np.pi, count)
        ahead = np.column_stack([np.cos(angle), np.sin(angle)])
        for k in range(count):
            ends = np.vstack([scenario.path.waypoints[:2], corner + reach[k] * ahead[k]])
            numbers[k, : loop.law.gains.size] = law_numbers(replace(scenario, path=Path(ends)), case.gains, vehicle)
        numbers[:, loop.parameters.slice("leg")] = ahead
    else:
        plant, layout = loop.state.slice("plant").start, plant_state(vehicle.form)
        place = plant + layout.slice("eta").start
        angle, reach = rng.uniform(-np.pi, np.pi, count), NEAR * radius * np.sqrt(rng.uniform(0, 1, count))
        state[:, place], state[:, place + 1] = corner[0] + reach * np.cos(angle), corner[1] + reach * np.sin(angle)
        state[:, place + 3] = rng.uniform(-np.pi, np.pi, count)
        state[:, plant + layout.slice("nu").start] = speed
        # the target point has arrived, as after a detour
        state[:, loop.state.slice("law").start + loop.law.state.slice("progress").start] = FIRST_LEG * radius
    final = compiled_loop(loop.structure).run(state, numbers, steps=packed.steps, threads=2)
    return float(np.mean(final[:, loop.state.slice("stop").start] == STOPS.index("reached")))


def main() -> int:
    """Print the table; return 1 if a run does not arrive."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one craft, few short legs in the fastest current")
    given = parser.parse_args()
    craft = [load_vehicle(name) for name in CRAFT] + [boat(k) for k in range(BOATS)]
    craft, count = (craft[:1], 10) if given.quick else (craft, STARTS)
    kinds = [(short, share) for short in (False, True) for share in CURRENTS]
    kinds = kinds[-1:] if given.quick else kinds
    heads = [f"{'short legs' if short else 'starts'}, current {share:g} of cruise" for short, share in kinds]
    print(f"| craft | turning radius [m] | rudder | {' | '.join(heads)} |\n|{'---|' * (3 + len(kinds))}")
    least = 1.0
    for vehicle in craft:
        _, speed, radius = prepared(vehicle)
        shares = [arrived(vehicle, share=share, count=count, short=short) for short, share in kinds]
        least = min(least, *shares)
        cells = " | ".join(f"{one:.1%}" for one in shares)
        print(f"| {vehicle.name} | {radius:.2g} | {vehicle.fin_share(speed):.0%} | {cells} |", flush=True)
    print(f"\nLeast share of {count} runs that arrived: {least:.1%}.")
    return 0 if least == 1.0 else 1


if __name__ == "__main__":
    sys.exit(main())
