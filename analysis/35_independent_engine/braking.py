"""Braking claims in MuJoCo: a vehicle that brakes when the rule of the claim says so must not touch the obstacle.

The claims have a motion in the plane. Here the hull has six degrees of freedom: it pitches when it brakes, and it may
leave its depth. It meets a disc along one of its axes. Mass, drag, lag, braking force, and age and errors of the
measurements are from the claim's ranges; half of the runs are at the worst ends.
"""

from __future__ import annotations

import csv
import sys
from dataclasses import replace
from pathlib import Path
from pathlib import Path as FilePath

import numpy as np
from certified import with_parameters

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.marine.control import Gains
from surctl.marine.engine import EngineOptions, MujocoPhysics
from surctl.marine.simulation import load_scenario
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import load_vehicle, plant_state
from surctl.marine.verification.braking import BrakingClaim, braking_claim_named, prove_braking
from tests.oracles.braking_episodes import Rule, rule_of

CLAIMS = ("braking-rule-20", "braking-rule-ranges", "braking-inertia-20", "braking-inertia-20-movers")
SECONDS, HALF = 14.0, 0.025
FIELDS = ("claim", "run", "clearance_m", "tilt_deg", "fastest_m_per_s")
HEADS = (
    "claim", "obstacle towards the hull [m/s]", "runs", "contacts", "smallest clearance [m]", "within 0.1 m",
    "largest speed [m/s]", "largest tilt [deg]",
)  # fmt: skip
START = 25.0  # [m] x and y of the hull's start


def braked(gains: Gains, runs: int, file: FilePath) -> tuple[str, bool]:
    """Return a text about the runs, and whether none touched its obstacle; the runs are stored one by one in a file."""
    if not file.exists():
        file.write_text(",".join(FIELDS) + "\n")
    known = {(row["claim"], row["run"]): row for row in csv.DictReader(file.read_text().splitlines())}
    claims = [braking_claim_named(name, load_vehicle("sur540-flooded"), gains) for name in CLAIMS]
    assert all(prove_braking(claim).verdict == "proved" for claim in claims)
    rules = {(claim.name, speed): rule_of(claim, obstacle=speed) for claim in claims for speed in claim.obstacles}
    for k in range(runs // len(CLAIMS)):
        for claim in claims:
            if (claim.name, str(k)) in known:
                continue
            speed = claim.obstacles[k % len(claim.obstacles)]
            seed = [36, k, CLAIMS.index(claim.name)]
            clear, tilt, fastest = _episode(claim, rules[claim.name, speed], speed, np.random.default_rng(seed))
            row = dict(zip(FIELDS, (claim.name, str(k), f"{clear:.5f}", f"{tilt:.2f}", f"{fastest:.4f}"), strict=True))
            known[claim.name, str(k)] = row
            with file.open("a", newline="") as out:
                csv.DictWriter(out, FIELDS, lineterminator="\n").writerow(row)
    rows, touched, total = [], 0, 0
    for claim in claims:
        found = [row for (name, _), row in known.items() if name == claim.name]
        least, tilt, fastest = (np.array([float(row[name]) for row in found]) for name in FIELDS[2:])
        hits = int(np.sum(least <= 0))
        touched, total = touched + hits, total + len(found)
        speeds = ", ".join(f"{speed:g}" for speed in claim.obstacles)
        numbers = [f"{least.min():.3f}", f"{np.mean(least < 0.1):.0%}", f"{fastest.max():.2f}", f"{tilt.max():.1f}"]
        rows.append(f"| `{claim.name}` | {speeds} | {len(found)} | {hits} | {' | '.join(numbers)} |")
    text = f"""## Braking
{total} runs of {SECONDS:g} s in MuJoCo with six degrees of freedom towards an obstacle, with full thrust whenever the
claim's rule allows it: {touched} touch it. Mass, drag, lag, braking force, and age and errors of the measurements are
drawn from the claim's ranges, half of the runs at the worst ends.

| {" | ".join(HEADS)} |
|{"---|" * len(HEADS)}
""" + "\n".join(rows)
    return text, touched == 0


def _episode(claim: BrakingClaim, rule: Rule, speed: float, rng: np.random.Generator) -> tuple[float, float, float]:
    b, watch, worst = claim.brakes, claim.watch, rng.random() < 0.5
    low = [b.linear[0], b.quadratic[0]]
    mass, lag = (rng.choice(b.masses), b.lag) if worst else (rng.uniform(*b.masses), b.lag * rng.uniform(0.2, 1.0))
    linear, quadratic = low if worst else (rng.uniform(*b.linear), rng.uniform(*b.quadratic))
    least = b.least if worst else rng.uniform(b.least, max(b.least, b.most))
    values = {"m11": mass, "m22": mass, "m33": mass, "thrust_lag": lag}
    values |= dict.fromkeys(("Xu", "Yv"), linear) | dict.fromkeys(("Xuu", "Yvv"), quadratic)
    values |= dict.fromkeys(("Fu_max", "Fv_max"), 2 * b.most)
    tank = load_scenario("pool-behind")
    scenario = replace(tank, obstacles=tank.obstacles[:1], site=(50.0, 50.0, 20.0), depth=-8.0)
    boat = with_parameters(load_vehicle("sur540-tilting"), values)
    world, array = build_world(scenario, boat, seed=0), scenario.sensors.array_on(boat["radius"])
    physics = MujocoPhysics(world, boat, array, EngineOptions())
    disc = next(body for time in (0.0, 5.0, 10.0) for body in world.bodies(time))

    heading = rng.uniform(-np.pi, np.pi)
    axis, sign = int(rng.integers(2)), rng.choice([-1.0, 1.0])  # of the hull, along which it moves
    along = sign * np.array([np.cos(heading), np.sin(heading)] if axis == 0 else [-np.sin(heading), np.cos(heading)])
    physics.state = plant_state(boat.form).pack({"eta": [START, START, -8.0, heading]})
    place = np.array([START, START]) + along * (
        boat["radius"] + disc.shape.radius + rng.uniform(0.5, 1.0) + 5.0 * speed
    )
    late = round(watch.age / HALF)
    each = max(round(watch.period / HALF), 1)
    past: list[tuple[float, float]] = []
    command, clear, tilt, fastest = np.zeros(4), np.inf, 0.0, 0.0
    for k in range(round(SECONDS / HALF)):
        state = physics.state
        distance, _ = physics.clearance([replace(disc, shape=replace(disc.shape, center=tuple(place)))])
        forward = float(state[4 + axis] * sign)
        past = [*past, (distance, forward)][-late - 1 :]
        clear, fastest = min(clear, distance), max(fastest, forward)
        tilt = max(tilt, float(np.abs(state[12:14]).max()))
        if k % each == 0:
            errors = (1.0, 1.0) if worst else rng.choice([-1.0, 1.0], 2)
            read = past[0][0] + watch.range_error * errors[0]
            own = forward - watch.speed_error * errors[1]
            since = max(v for _, v in past) - watch.speed_error
            stop = bool(rule(np.array([read]), np.array([own]), np.array([since]))[0])
            free = b.most if forward < claim.fastest - 0.01 else 0.0
            command[axis] = sign * (-least if stop else free)
        physics.advance(command, k * HALF)
        place = place - speed * HALF * along
    return clear, float(np.rad2deg(tilt)), fastest
