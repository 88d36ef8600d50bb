"""Study 47: does a simulated motion leave the certified tube of a mission?

    python analysis/47_mission_tube/run.py [--quick] [--motions N] [--seed N]

Prints Markdown. The exit status is 1 if a motion leaves its tube, or a mission is not proved, and 2 for a bad option.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.certcheck.mission import funnel_of, read_claim
from surctl.certcheck.turning_claim import TurningClaim, axis_pairs
from surctl.marine.control import load_gains
from surctl.marine.simulation import load_scenario
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.mission import USUAL, mission_claim, prove_mission
from surctl.marine.verification.region import region_statement
from tests.certcheck.turning_truth import commanded, true_rate

Array = NDArray[np.float64]

PERIOD, LAG = 0.05, 0.3  # s; of motions beyond the claim
CAP = 0.22  # m/s
BENT = ((0.0, 0.0), (14.0, 0.0), (28.0, 5.0), (43.0, 3.0))


@dataclass(frozen=True)
class Case:
    """A mission: its path, vehicle, cruise speed [m/s], region claim of a leg, and how it begins."""

    name: str
    vehicle: str
    cruise: float
    region: str
    at_rest: bool
    path: tuple[tuple[float, float], ...] | None = None


CASES = (
    Case("tank-speed-015", "sur540-flooded", 0.15, USUAL, False),
    Case("tank-speed-015", "sur540-flooded", 0.1, USUAL, True),
    Case("tank-slalom", "sur540-flooded", 0.022, USUAL, True),
    Case("tank-speed-015", "sur540-flooded", 0.15, "region-cruise-20-lag", False),
    Case("tank-speed-015", "sur540-flooded", 0.15, "region-turning-20-current", False),
    Case("three legs", "bluerov2-vonbenzon", 0.15, "region-turning", True, BENT),
)


def proved(case: Case) -> dict[str, Any]:
    """Return the certificate of a mission.

    Raises:
        SystemExit: it is not proved.
    """
    scenario = load_scenario("tank-speed-015" if case.path else case.name)
    if case.path is not None:
        scenario = replace(scenario, path=replace(scenario.path, waypoints=np.array(case.path)))
    statement, vehicle = region_statement(case.region), load_vehicle(case.vehicle)
    claim = mission_claim(
        scenario, vehicle, load_gains("default"), statement, cruise=case.cruise, cap=CAP, at_rest=case.at_rest
    )
    proof = prove_mission(claim, attempts=statement.attempts)
    if proof.verdict != "proved":
        print(f"{case.name} at {case.cruise:g} m/s: {proof.sentence}")
        sys.exit(1)
    return proof.document


def drawn(loop: TurningClaim, count: int, rng: np.random.Generator) -> dict[str, Array]:
    """Return factors of the true parameters; half of them are at the ends of the ranges."""

    def pairs(ends: Any, asymmetry: Any) -> Array:
        corners = np.array([[float(x) for x in pair] for pair in axis_pairs(ends, asymmetry)])
        weights = rng.dirichlet(np.ones(len(corners)), size=count)
        weights[: count // 2] = np.eye(len(corners))[rng.integers(len(corners), size=count // 2)]
        return np.asarray(weights @ corners)

    boat = {"mass": pairs(loop.mass_factor, loop.mass_asymmetry)}
    boat |= {name: pairs(loop.drag_factor, loop.drag_asymmetry) for name in ("linear", "quadratic")}
    return boat | {name: np.ones(count) for name in ("term_mass", "term")}


@dataclass
class Motion:
    """Simulated robots: true parameters, current in the frame of the leg, state, and thrust in the body frame."""

    boat: dict[str, Array]
    flow: Array
    state: Array
    psi: Array
    thrust: Array


def border(whole: dict[str, Any], count: int, rng: np.random.Generator) -> Motion:
    """Return robots with V at the level of the first leg, half of them as far from the target as V allows."""
    mission, proof = read_claim(whole["claim"]), whole["proof"]["loop"]
    loop, boat = mission.loop, drawn(mission.loop, count, rng)
    p = np.array([[float(x) for x in row] for row in funnel_of(loop, proof).p])
    z = rng.normal(size=(count, len(p)))
    z[: count // 2, 2:] = 0
    z[: count // 2] = z[: count // 2] @ np.linalg.inv(p)
    z *= np.sqrt(whole["proof"]["levels"][0] / np.einsum("ni,ij,nj->n", z, p, z))[:, None]
    factors = np.stack([boat["linear"].mean(axis=1), boat["quadratic"].mean(axis=1)], axis=1) - 1
    angle = rng.uniform(0, 2 * np.pi, count)
    flow = float(loop.current) * np.stack([np.cos(angle), np.sin(angle)], 1)
    gains = np.hstack([np.ones((count, 1)), factors]) @ np.array(proof.get("flow", np.zeros((3, 2)))) * flow
    v, psi = float(loop.cruise), rng.uniform(0, 2 * np.pi, count)
    moved = factors @ proof["trim"] - gains[:, 0]
    beside = float(loop.lookahead) * gains[:, 1] / (v + moved)
    steady = np.stack([-moved / float(loop.k1), beside, np.full(count, v), np.zeros(count)], 1)
    state, c, s = steady + z[:, :4], np.cos(psi), np.sin(psi)
    thrust = commanded(loop, state, psi)
    if loop.lag[1]:
        late = np.stack([c * z[:, 4] + s * z[:, 5], -s * z[:, 4] + c * z[:, 5]], 1)
        thrust = commanded(loop, steady, psi) + late * np.array([float(m) for m in loop.mass])
    return Motion(boat, flow, state, psi, thrust)


def step(loop: TurningClaim, one: Motion, r: Array, command: Array | None, lag: float) -> None:
    """Move the robots by one period at the yaw rate r; `command` None is the present command at every instant."""

    def slope(x: Array, part: float) -> Array:
        angle = one.psi + part * r
        error = None if command is None else thrust(part) - commanded(loop, x, angle)
        return true_rate(loop, one.boat, x, angle, r, flow=one.flow, error=error)

    def thrust(time: float) -> Array:
        assert command is not None
        return command + (one.thrust - command) * np.exp(-time / lag) if lag else command

    x, half = one.state, PERIOD / 2
    a = slope(x, 0.0)
    b = slope(x + half * a, half)
    c = slope(x + half * b, half)
    one.state = np.asarray(x + PERIOD / 6 * (a + 2 * b + 2 * c + slope(x + PERIOD * c, PERIOD)))
    one.psi = one.psi + PERIOD * r
    if command is not None:
        one.thrust = thrust(PERIOD)


def flown(
    whole: dict[str, Any], count: int, rng: np.random.Generator, *, held: bool, lag: float
) -> tuple[int, float, float]:
    """Return how many motions leave the tube, and the largest shares of the tube and of the goal's distance.

    With `held`, commands are computed from single-precision states once in a period; with `lag` [s], the thrust lags.
    """
    mission = read_claim(whole["claim"])
    loop, one = mission.loop, border(whole, count, rng)
    v, rate, kind = float(loop.cruise), float(loop.yaw_rate), rng.integers(3, size=count)
    pace, phase = rng.uniform(0.2, 3.0, count), rng.uniform(0, 2 * np.pi, count)
    points = np.array([[float(x) for x in point] for point in mission.path])
    legs = np.diff(points, axis=0)
    ends, angles = np.cumsum(np.linalg.norm(legs, axis=1)), np.arctan2(legs[:, 1], legs[:, 0])
    leg, shares, steps = 0, np.zeros(count), int(np.ceil(ends[-1] / v / PERIOD))
    for k in range(steps):
        time = k * PERIOD
        while leg < len(ends) - 1 and v * time >= ends[leg]:
            turn = angles[leg + 1] - angles[leg]
            back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]).T
            late = v * time - ends[leg]  # the target is on the next leg, not on the prolonged one
            place, speed = (one.state[:, :2] + [late, 0]) @ back - [late, 0], one.state[:, 2:] @ back
            one.state, one.flow, one.psi, leg = np.hstack([place, speed]), one.flow @ back, one.psi - turn, leg + 1
        swing = np.sin(pace * time + phase)
        r = rate * np.where(kind == 0, 0, np.where(kind == 1, np.sign(swing), swing))
        command = None
        if held:
            command = commanded(loop, one.state.astype(np.float32), one.psi.astype(np.float32)).astype(float)
        step(loop, one, r, command, lag)
        shares = np.maximum(shares, np.hypot(one.state[:, 0], one.state[:, 1]) / float(mission.tube[leg]))
    goal = np.hypot(one.state[:, 0], one.state[:, 1]) / float(mission.goal)
    return int(np.sum((shares > 1) | (goal > 1))), float(shares.max()), float(goal.max())


def main() -> int:
    """Run the study and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few motions of the first mission")
    parser.add_argument("--motions", type=int, default=10_000, metavar="N", help="motions of all missions together")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    options = parser.parse_args()
    if options.motions < 3 or options.seed < 0:
        parser.error("--motions must be at least 3, and --seed at least 0")
    cases = CASES[:1] if options.quick else CASES
    count = 60 if options.quick else options.motions // len(cases) + 1
    print((Path(__file__).parent / "about.md").read_text() if not options.quick else "", end="")
    print("| mission | vehicle | region claim | begins | stated: start, tube, end | commands | motions | leave | "
          "tube used | end used |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|---|")
    left = 0
    for case in cases:
        whole = proved(case)
        start, motion = whole["claim"]["start"], whole["claim"]["motion"]
        stated = f"{start['within_m'][1]:.3g} m, {max(motion['tube_m']):.3g} m, {motion['goal_m']:.3g} m"
        loop = read_claim(whole["claim"]).loop
        period, lag = float(loop.period), float(loop.lag[1])
        ways = [("as stated", period > 0, lag)]
        if not period:
            ways += [("held, single precision", True, 0.0), (f"held, lag {LAG:g} s", True, LAG)]
        for words, held, late in ways[:2] if options.quick else ways:
            many = count if words == "as stated" else max(count // 10, 20)
            rng = np.random.default_rng(options.seed)
            out, tube, goal = flown(whole, many, rng, held=held, lag=late)
            left += out if late == lag else 0
            begins = "at rest" if case.at_rest else "at cruise"
            print(f"| {case.name} at {case.cruise:g} m/s | {case.vehicle} | {case.region} | {begins} | {stated} | "
                  f"{words} | {many} | {out} | {tube:.1%} | {goal:.1%} |", flush=True)  # fmt: skip
    return int(left > 0)


if __name__ == "__main__":
    sys.exit(main())
