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

from surctl.certcheck.mission import funnel_of, read_claim
from surctl.certcheck.region_claim import axis_pairs
from surctl.certcheck.turning_claim import TurningClaim
from surctl.certcheck.turning_law import commanded, true_rate
from surctl.marine.control import load_gains
from surctl.marine.simulation import load_scenario
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.mission import USUAL, mission_claim, prove_mission
from surctl.marine.verification.region import region_statement

Array = NDArray[np.float64]

PERIOD, LAG = 0.05, 0.3  # s
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
    Case("tank-speed-015", "sur540-flooded", 0.03, USUAL, True),
    Case("three legs", "bluerov2-vonbenzon", 0.15, "region-turning", True, BENT),
)


def proved(case: Case) -> dict[str, Any]:
    """Return the certificate of a mission.

    Raises:
        SystemExit: it is not proved.
    """
    scenario = load_scenario("tank-speed-015")
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


def border(whole: dict[str, Any], boat: dict[str, Array], rng: np.random.Generator) -> Array:
    """Return states (n, 4) with V at the level of the first leg, half of them as far from the target as V allows."""
    mission, count = read_claim(whole["claim"]), len(boat["mass"])
    funnel = funnel_of(mission.loop, whole["proof"]["loop"])
    p = np.array([[float(x) for x in row] for row in funnel.p])
    z = rng.normal(size=(count, 4))
    z[: count // 2] = np.hstack([z[: count // 2, :2], np.zeros((count // 2, 2))]) @ np.linalg.inv(p)
    z *= np.sqrt(whole["proof"]["levels"][0] / np.einsum("ni,ij,nj->n", z, p, z))[:, None]
    factors = np.stack([boat["linear"].mean(axis=1), boat["quadratic"].mean(axis=1)], axis=1) - 1
    z[:, 0] -= factors @ whole["proof"]["loop"]["trim"] / float(mission.loop.k1)
    z[:, 2] += float(mission.loop.cruise)
    return z


def step(loop: TurningClaim, boat: dict[str, Array], state: Array, psi: Array, r: Array, thrust: Array | None) -> Array:
    """Return the state after one period at the yaw rate r; `thrust` None is the present command at every instant."""

    def slope(x: Array, part: float) -> Array:
        angle = psi + part * r
        error = None if thrust is None else thrust - commanded(loop, x, angle)
        return true_rate(loop, boat, x, angle, r, error=error)

    half = PERIOD / 2
    a = slope(state, 0.0)
    b = slope(state + half * a, half)
    c = slope(state + half * b, half)
    return np.asarray(state + PERIOD / 6 * (a + 2 * b + 2 * c + slope(state + PERIOD * c, PERIOD)))


def flown(
    whole: dict[str, Any], count: int, rng: np.random.Generator, *, held: bool, lag: float
) -> tuple[int, float, float]:
    """Return how many motions leave the tube, and the largest shares of the tube and of the goal's distance.

    With `held`, commands are computed from single-precision states once in a period; with `lag` [s], the thrust lags.
    """
    mission = read_claim(whole["claim"])
    loop = mission.loop
    boat, v, rate = drawn(loop, count, rng), float(loop.cruise), float(loop.yaw_rate)
    state = border(whole, boat, rng)
    psi, kind = rng.uniform(0, 2 * np.pi, count), rng.integers(3, size=count)
    pace, phase = rng.uniform(0.2, 3.0, count), rng.uniform(0, 2 * np.pi, count)
    points = np.array([[float(x) for x in point] for point in mission.path])
    legs = np.diff(points, axis=0)
    ends, angles = np.cumsum(np.linalg.norm(legs, axis=1)), np.arctan2(legs[:, 1], legs[:, 0])
    thrust = commanded(loop, state, psi)
    leg, shares, steps = 0, np.zeros(count), int(np.ceil(ends[-1] / v / PERIOD))
    for k in range(steps):
        time = k * PERIOD
        while leg < len(ends) - 1 and v * time >= ends[leg]:
            turn = angles[leg + 1] - angles[leg]
            back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
            late = v * time - ends[leg]  # the target is on the next leg, not on the prolonged one
            state[:, :2] = (state[:, :2] + [late, 0]) @ back.T - [late, 0]
            state[:, 2:], psi, leg = state[:, 2:] @ back.T, psi - turn, leg + 1
        swing = np.sin(pace * time + phase)
        r = rate * np.where(kind == 0, 0, np.where(kind == 1, np.sign(swing), swing))
        command = commanded(loop, state.astype(np.float32), psi.astype(np.float32)).astype(float) if held else None
        if command is not None:
            thrust = command + (thrust - command) * np.exp(-PERIOD / lag) if lag else command
        state = step(loop, boat, state, psi, r, thrust if held else None)
        psi = psi + PERIOD * r
        shares = np.maximum(shares, np.hypot(state[:, 0], state[:, 1]) / float(mission.tube[leg]))
    goal = np.hypot(state[:, 0], state[:, 1]) / float(mission.goal)
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
    print(
        "| mission | vehicle | begins | stated: start, tube, end | commands | motions | leave | tube used | end used |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    left = 0
    for case in cases:
        whole = proved(case)
        start, motion = whole["claim"]["start"], whole["claim"]["motion"]
        stated = f"{start['within_m'][1]:.3g} m, {max(motion['tube_m']):.3g} m, {motion['goal_m']:.3g} m"
        ways = (("as stated", False, 0.0), ("held, single precision", True, 0.0), (f"held, lag {LAG:g} s", True, LAG))
        for words, held, lag in ways[:2] if options.quick else ways:
            many = count if not held else max(count // 10, 20)
            rng = np.random.default_rng(options.seed)
            out, tube, goal = flown(whole, many, rng, held=held, lag=lag)
            left += out if not lag else 0
            begins = "at rest" if case.at_rest else "at cruise"
            print(f"| {case.name} at {case.cruise:g} m/s | {case.vehicle} | {begins} | {stated} | {words} | {many} | "
                  f"{out} | {tube:.1%} | {goal:.1%} |", flush=True)  # fmt: skip
    return int(left > 0)


if __name__ == "__main__":
    sys.exit(main())
