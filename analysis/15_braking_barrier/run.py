"""Study 15: proofs of the braking barrier, certificates of its tables, and adversarial runs within its assumptions.

    python analysis/15_braking_barrier/run.py [--quick | --unequal]

With --unequal, only the vehicles with unequal masses, with the margins that their claims need. Prints Markdown. The
exit status is 0 if every claim is proved as expected, no run within the assumptions collides,
and every weakened rule collides; otherwise 1; it is 2 for a bad option.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.marine.control import load_gains
from surctl.marine.guidance.braking import Watch
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.braking import BRAKING_CLAIMS, BrakingClaim, braking_claim_named, prove_braking
from tests.oracles.braking_episodes import Rule, rule_of, run_episodes

VEHICLES = ("sur540-flooded", "sur400")
NOT_PROVED = {("sur400", "braking-inertia-20-axes")}
"""Its file states no ranges, so its law assumes exact parameters: a margin of 0.05 m is too small for ±20 %."""
UNEQUAL = ("bluerov2-heavy", "bluerov2-vonbenzon", "bluerov2-wu")
"""Vehicles whose masses in surge and sway differ."""
UNKNOWN = {
    *((vehicle, "braking-simple-20") for vehicle in UNEQUAL),
    ("bluerov2-heavy", "braking-inertia-20"),
    ("bluerov2-vonbenzon", "braking-inertia-20"),
    ("bluerov2-wu", "braking-inertia-20"),
    ("bluerov2-wu", "braking-inertia-20-axes"),
}
"""Claims about the law that the margin of the default gains is too small for."""
HIGHEST, FINEST = 0.2, 1e-3  # [m] of the margins that are tried
RUNS, QUICK, FEW = 10_000, 300, 40
SEED = 7


@dataclass(frozen=True)
class Wrong:
    """A weakened rule: its error, its claim, and the speed of the obstacle [m/s]."""

    what: str
    claim: str
    obstacle: float


WRONG = (
    Wrong("a way shorter by a tenth", "braking-rule-20", 0.10),
    Wrong("no lag", "braking-rule-20", 0.10),
    Wrong("age and errors forgotten", "braking-rule-20", 0.10),
    Wrong("no margin", "braking-simple-20", 0.0),
    Wrong("counts on half as much thrust again", "braking-inertia-ranges", 0.0),
)


def main(arguments: Sequence[str]) -> int:
    """Run the study, print the results, and return the exit status."""
    unknown = [a for a in arguments if a not in ("--quick", "--unequal")]
    if unknown:
        print(f"{unknown[0]}: unknown option; the only ones are --quick and --unequal", file=sys.stderr)
        return 2
    if "--unequal" in arguments:
        return 0 if unequal(QUICK, lacking=True) else 1
    runs = QUICK if "--quick" in arguments else RUNS
    good = proofs()
    margins()
    return 0 if all([good, flights(runs), wrong(runs), unequal(FEW if runs == QUICK else QUICK)]) else 1


def claims() -> Iterator[tuple[str, BrakingClaim]]:
    """Return every claim of the library for every vehicle."""
    gains = load_gains("default")
    for name in VEHICLES:
        for claim in BRAKING_CLAIMS:
            yield name, braking_claim_named(claim, load_vehicle(name), gains)


def proofs() -> bool:
    """Print verdicts, times and sizes, then the certified ranges."""
    print("| vehicle | claim | verdict | proof and check | check | certificate |\n|---|---|---|---|---|---|")
    good, tables = True, []
    for vehicle, claim in claims():
        proof = prove_braking(claim)
        expected = "unknown" if (vehicle, claim.name) in NOT_PROVED else "proved"
        good &= proof.verdict == expected
        told = proof.verdict if proof.verdict == expected else f"**{proof.verdict}**"
        times = f"{1e3 * proof.seconds:.0f} ms | {1e3 * proof.check_seconds:.0f} ms"
        print(f"| {vehicle} | `{claim.name}` | {told} | {times} | {len(proof.text())} B |")
        if claim.law is None and proof.document:
            tables.append((vehicle, claim, proof.document["claim"]))
    heads = " | ".join(f"{o:.2f}" for o in tables[0][1].obstacles)
    print(f"\nRange needed in m before an obstacle at … m/s:\n\n| vehicle | claim | own speed | {heads} | limit |")
    print("|---|---|---|---|---|---|---|---|")
    for vehicle, claim, told in tables:
        for speed, row in zip(claim.speeds, told["table"]["needed_m"], strict=True):
            cells = " | ".join(f"{x:.3f}" for x in row)
            limit = told["table"]["limit_obstacle_m_per_s"]
            print(f"| {vehicle} | `{claim.name}` | {speed:.2f} | {cells} | {limit:.3f} |")
    return good


def margins() -> None:
    """Print the least margin with which each claim about a law is proved."""
    print("\nLeast margin with which a claim about a law is proved:\n")
    print("| vehicle | claim | margin needed | of the gains |\n|---|---|---|---|")
    for vehicle, claim in claims():
        if claim.law is None:
            continue
        print(f"| {vehicle} | `{claim.name}` | {least_margin(claim):.3f} m | {float(claim.law.margin):g} m |")


def least_margin(claim: BrakingClaim, *, highest: float = HIGHEST, finest: float = FINEST) -> float:
    """Return the least margin [m] with which a claim about a law is proved, by bisection."""
    assert claim.law is not None
    low, high = 0.0, highest
    while high - low > finest:
        middle = round((low + high) / 2, 4)
        proof = prove_braking(replace(claim, law=replace(claim.law, margin=Fraction(repr(middle)))))
        low, high = (low, middle) if proof.verdict == "proved" else (middle, high)
    return high


def flights(runs: int) -> bool:
    """Simulate `runs` runs of every proved claim, divided among its obstacles."""
    print(f"\n{runs} runs per claim:\n\n| vehicle | claim | collided | least clearance | within 0.1 m | braked |")
    print("|---|---|---|---|---|---|")
    hits = 0
    for vehicle, claim in claims():
        if (vehicle, claim.name) in NOT_PROVED:
            continue
        began = time.perf_counter()
        each = runs // len(claim.obstacles)
        found = [run_episodes(claim, obstacle=o, runs=each, seed=SEED + k) for k, o in enumerate(claim.obstacles)]
        touched, least = sum(f.hits for f in found), min(f.least for f in found)
        near, braked = (sum(x) / len(found) for x in ([f.near for f in found], [f.braked for f in found]))
        hits += touched
        told = f"**{touched}**" if touched else "0"
        print(f"| {vehicle} | `{claim.name}` | {told} | {least:.3f} m | {near:.0%} | {braked:.0%} |", flush=True)
        print(f"{claim.name}: {time.perf_counter() - began:.0f} s", file=sys.stderr)
    return hits == 0


def wrong(runs: int) -> bool:
    """Simulate the weakened rules: all must collide."""
    print("\n| weakened rule | of | before | collided | least clearance |\n|---|---|---|---|---|")
    good, gains, vehicle = True, load_gains("default"), load_vehicle(VEHICLES[0])
    for case in WRONG:
        claim = braking_claim_named(case.claim, vehicle, gains)
        found = run_episodes(claim, obstacle=case.obstacle, runs=runs, seed=SEED, rule=spoiled(case, claim))
        good &= found.hits > 0
        touched = str(found.hits) if found.hits else "**0**"
        print(f"| {case.what} | `{case.claim}` | {case.obstacle:g} m/s | {touched} | {found.least:.3f} m |", flush=True)
    return good


def unequal(runs: int, *, lacking: bool = False) -> bool:
    """Prove the claims for vehicles with unequal masses, and simulate runs of each claim.

    With `lacking`, print the margins that the unknown claims need.
    """
    print(f"\nUnequal masses; {runs} runs per claim:\n")
    print("| vehicle | claim | mass ratio | braking force | verdict | margin needed | collided | least clearance |")
    print("|---|---|---|---|---|---|---|---|")
    good, gains = True, load_gains("default")
    for vehicle in UNEQUAL:
        for name in (name for name in BRAKING_CLAIMS if not name.endswith("-ranges")):
            proof = prove_braking(braking_claim_named(name, load_vehicle(vehicle), gains))
            claim = proof.claim
            proved = proof.verdict == "proved"
            good &= proved == ((vehicle, name) not in UNKNOWN)
            margin = "–"
            if lacking and not proved:
                least = least_margin(claim, highest=1.0, finest=5e-3)
                margin = f"{least:.2f} m" if least < 1 else "none up to 1 m"
            each = max(runs // len(claim.obstacles), 1)
            found = [run_episodes(claim, obstacle=o, runs=each, seed=SEED + k) for k, o in enumerate(claim.obstacles)]
            touched, clear = sum(f.hits for f in found), min(f.least for f in found)
            good &= not (proved and touched) and max(f.fastest for f in found) <= claim.fastest
            row = f"| {vehicle} | `{name}` | {claim.ratio:.3f} | {claim.brakes.least:g} N | {proof.verdict} | {margin}"
            print(f"{row} | {touched} | {clear:.3f} m |", flush=True)
    return good


def spoiled(case: Wrong, claim: BrakingClaim) -> Rule:
    """Return the weakened rule."""
    at = case.obstacle
    if claim.law is not None:
        more = Fraction(3, 2) * claim.law.brake
        weak = case.what == "no margin"
        law = replace(claim.law, margin=Fraction(0)) if weak else replace(claim.law, brake=more)
        return rule_of(replace(claim, law=law), obstacle=at)
    if case.what == "age and errors forgotten":
        return rule_of(replace(claim, watch=Watch(period=claim.watch.period)), obstacle=at)
    if case.what == "no lag":
        return rule_of(replace(claim, brakes=replace(claim.brakes, lag=0.0)), obstacle=at)
    return rule_of(claim, obstacle=at, share=0.9)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
