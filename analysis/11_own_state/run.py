"""Study 11: how well the robot estimates its position and speed from late fixes, and the effect on the loop.

    python analysis/11_own_state/run.py [--quick]

Prints Markdown. The exit status is 0 if every statement holds, and 1 otherwise.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from loop import DT, ESTIMATORS, Estimator, Flight, Leg, Mission, Water, fly
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.files import Strict, load_model
from surctl.marine.sensing import Delivery, OwnState
from surctl.marine.vehicle import Vehicle, load_vehicle

CONFIG = Path(__file__).with_name("config.toml")
SETTLING = 3.0  # [s] at the beginning that are not evaluated
AFTER = 0.5  # [s] that count as after a gap


class LegFile(Strict):
    """One leg."""

    seconds: float
    velocity: tuple[float, float]


class Bars(Strict):
    """The limits of the statements."""

    position_moving_m: float
    velocity_believed: float
    velocity_any: float
    as_if_now: float
    differences: float
    honest: float
    fixed_gain: float
    refused: float


class Size(Strict):
    """How much is simulated."""

    runs: int
    mass_kg: tuple[float, ...]
    drag: tuple[float, ...]
    softer: tuple[float, ...]


class Config(Strict):
    """The contents of config.toml."""

    vehicle: str
    seed: int
    spin_rad_per_s: float
    k_v: float
    wave_n: float
    wave_period_s: float
    current_m_per_s: float
    gaps_s: tuple[tuple[float, float], ...]
    other_belief_kg: float
    legs: tuple[LegFile, ...]
    bars: Bars
    full: Size
    quick: Size


@dataclass(frozen=True)
class Figures:
    """Root mean squares over steps and runs, of horizontal vectors.

    Attributes:
        still, moving: error of the position [m] where the reference stands, and where it moves.
        velocity_still, velocity_moving: of the velocity [m/s].
        after_gap: of the position within half a second after fixes come again [m]; NaN without gaps.
        off_track: true velocity against the reference's [m/s], moving.
        thrust: command, reference at rest [N].
        honest: the larger of position and velocity error, each in the filter's standard deviations.
        refused: share of the steps at which the last fix was rejected.
    """

    still: float
    moving: float
    velocity_still: float
    velocity_moving: float
    after_gap: float
    off_track: float
    thrust: float
    honest: float
    refused: float


def main(arguments: list[str]) -> int:
    """Run the study, print the results, and return the exit status."""
    parser = argparse.ArgumentParser(prog="run.py", description="The own-state filter in the closed loop.")
    parser.add_argument("--quick", action="store_true", help="one run of each case, and fewer hulls")
    options = parser.parse_args(arguments)
    try:
        config = load_model(CONFIG, Config)
        return study(config, config.quick if options.quick else config.full)
    except InputError as error:
        print(error, file=sys.stderr)
        return error.exit_status


def study(config: Config, size: Size) -> int:
    """Simulate and print; return 0 if every statement holds."""
    believed = load_vehicle(config.vehicle)
    mass, drag = float(believed.mass[0]), float(believed.quadratic_drag[0])
    told = {
        (name, gaps): measure(config, size, mass, drag, estimator=name, gaps=gaps)
        for name in ESTIMATORS
        for gaps in (False, True)
    }
    print(f"## Estimates for the controller ({mass:g} kg, drag {drag:g}, as believed)\n")
    print_figures((f"{name}{', gaps' if gaps else ''}", f) for (name, gaps), f in told.items())
    hulls = {
        (m, d, gaps): measure(config, size, m, d, gaps=gaps)
        for m in size.mass_kg
        for d in size.drag
        for gaps in (False, True)
    }
    print("\n## The filter in other hulls than it believes in\n")
    print_figures((f"{m:g} kg, drag {d:g}{', gaps' if gaps else ''}", f) for (m, d, gaps), f in hulls.items())
    light, softer = (
        min(size.mass_kg),
        [
            (
                k_v,
                name,
                measure(config.model_copy(update={"k_v": k_v}), size, min(size.mass_kg), drag, estimator=name),
            )
            for k_v in size.softer
            for name in ("truth", "filter", "constant noise")
        ],
    )
    settled = measure(config, size, light, drag, estimator="fixed gain", gaps=True)
    print(f"\n## {light:g} kg that are taken for {mass:g} kg\n")
    print_figures(
        [
            *((f"{name}, k_v {k_v:g}", f) for k_v, name, f in softer),
            (f"fixed gain, gaps, k_v {config.k_v:g}", settled),
        ]
    )
    print(f"\n## Taken for {config.other_belief_kg:g} kg\n")
    print_figures((f"{m:g} kg", measure(config, size, m, drag, belief=config.other_belief_kg)) for m in size.mass_kg)
    print()
    fixed = min(
        told["fixed gain", True].after_gap / told["filter", True].after_gap,
        settled.after_gap / hulls[light, drag, True].after_gap,
    )
    return 0 if print_statements(config.bars, told, hulls, fixed) else 1


def measure(
    config: Config,
    size: Size,
    mass: float,
    drag: float,
    *,
    estimator: Estimator = "filter",
    gaps: bool = False,
    belief: float | None = None,
) -> Figures:
    """Simulate a hull with an estimator; filter and controller assume the mass of the file, or `belief` [kg]."""
    shipped = load_vehicle(config.vehicle)
    vehicle = of_mass(shipped, mass).with_values({"Xuu": drag, "Yvv": drag})
    believed = shipped if belief is None else of_mass(shipped, belief)
    mission = Mission([Leg(leg.seconds, leg.velocity) for leg in config.legs], config.spin_rad_per_s)
    flight = fly(
        vehicle,
        believed,
        mission,
        runs=size.runs,
        seed=config.seed,
        water=Water(config.wave_n, config.wave_period_s, config.current_m_per_s),
        sensors=OwnState(fixes=Delivery(gaps=config.gaps_s if gaps else ())),
        estimator=estimator,
        k_v=config.k_v,
    )
    return figures(flight, mission, config.gaps_s if gaps else ())


def of_mass(vehicle: Vehicle, mass: float) -> Vehicle:
    """Return the vehicle with this mass along each axis [kg]."""
    return vehicle.with_values({"m11": mass, "m22": mass, "m33": mass})


def figures(flight: Flight, mission: Mission, gaps: Iterable[tuple[float, float]]) -> Figures:
    """Return the reported figures of a run."""
    _, reference = mission.path()
    time, wanted = np.arange(len(reference)) * DT, np.hypot(reference[:, 0], reference[:, 1])
    counts = time >= SETTLING
    still, moving = counts & (wanted == 0), counts & (wanted > 0)
    place = flight.eta_hat[:, :2] - flight.eta[:, :2]
    velocity = in_world(flight.nu_hat, flight.eta_hat) - in_world(flight.nu, flight.eta)
    off_track = in_world(flight.nu, flight.eta) - reference[:, :2, None]
    late = Delivery().latency
    after = np.zeros_like(counts)
    for _, end in gaps:
        after |= (time >= end + late - 1e-9) & (time < end + late + AFTER - 1e-9)
    deviations = [
        rms(e / sd, counts) / np.sqrt(2) for e, sd in ((place, flight.position_sd), (velocity, flight.velocity_sd))
    ]
    return Figures(
        rms(place, still),
        rms(place, moving),
        rms(velocity, still),
        rms(velocity, moving),
        rms(place, after) if after.any() else float("nan"),
        rms(off_track, moving),
        rms(flight.tau[:, :2], still),
        max(deviations),
        float(np.mean(flight.refused[counts] > 0)),
    )


def in_world(nu: NDArray[np.float64], eta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the horizontal velocity (steps, 2, runs) in {E} [m/s]."""
    c, s = np.cos(eta[:, 3]), np.sin(eta[:, 3])
    return np.stack([c * nu[:, 0] - s * nu[:, 1], s * nu[:, 0] + c * nu[:, 1]], axis=1)


def rms(vectors: NDArray[np.float64], where: NDArray[np.bool_]) -> float:
    """Return the root mean square length of (steps, 2, runs) over the chosen steps and all runs."""
    return float(np.sqrt(np.mean(np.sum(vectors[where] ** 2, axis=1))))


def print_figures(rows: Iterable[tuple[str, Figures]]) -> None:
    """Print one row per case, in centimetres."""
    print(
        "| | position, still [cm] | moving | after a gap | velocity, still [cm/s] | moving | off the reference |"
        " thrust at rest [N] | in own deviations | refused [%] |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name, f in rows:
        places = (f.still, f.moving, f.after_gap, f.velocity_still, f.velocity_moving, f.off_track)
        told = " | ".join("" if np.isnan(v) else f"{100 * v:.2f}" for v in places)
        print(f"| {name} | {told} | {f.thrust:.2f} | {f.honest:.2f} | {100 * f.refused:.3f} |")


def print_statements(
    bars: Bars,
    told: Mapping[tuple[Estimator, bool], Figures],
    hulls: Mapping[tuple[float, float, bool], Figures],
    fixed: float,
) -> bool:
    """Print one row per statement; return whether all hold."""
    plain = [f for (_, _, gaps), f in hulls.items() if not gaps]
    own, gapped = told["filter", False], told["filter", True]
    worst_place, worst_speed = max(f.moving for f in plain), max(speed(f) for f in plain)
    believed, honest = max(speed(own), speed(gapped)), max(f.honest for f in hulls.values())
    now, difference = told["as if now", False].moving / own.moving, speed(told["differences", False]) / speed(own)
    refused = max(f.refused for f in hulls.values())
    said = [
        ("moving, every hull: position", worst_place, "m", worst_place <= bars.position_moving_m),
        ("believed hull, gaps or not: velocity", believed, "m/s", believed <= bars.velocity_believed),
        ("every hull: velocity", worst_speed, "m/s", worst_speed <= bars.velocity_any),
        ("errors in the filter's own deviations, every hull, gaps or not", honest, "", honest <= bars.honest),
        ("a late fix taken for the present: position error, moving, times", now, "", now >= bars.as_if_now),
        ("differences of fixes: velocity error, times", difference, "", difference >= bars.differences),
        ("ratio of the position error after a gap with the steady-state gain", fixed, "", fixed >= bars.fixed_gain),
        ("share of the steps with a correct fix rejected", refused, "", refused <= bars.refused),
    ]
    print("| statement | figure | |\n|---|---|---|")
    for text, figure, unit, holds in said:
        print(f"| {text} | {figure:.3g} {unit} | {'holds' if holds else '**does not hold**'} |")
    return all(holds for *_, holds in said)


def speed(f: Figures) -> float:
    """Return the larger velocity error [m/s]."""
    return max(f.velocity_still, f.velocity_moving)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
