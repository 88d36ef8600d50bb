"""Study 16: size of the certified regions of attraction, comparison with the largest possible, and time of the proofs.

    python analysis/16_cruise_regions/run.py [--quick] [CLAIM…]

Prints Markdown; the times are the processor's, of this process. Ends with 0 when every claim is proved, its certificate
accepted and the bars that it names are met, else with 1; with 2 for a bad option. `--quick` proves `region-cruise-20`
only.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

from surctl.certcheck import check_document
from surctl.marine.control import load_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.region import REGION_CLAIMS, RegionProof, prove_statement

VEHICLE, GAINS = "sur540-flooded", "default"
LEVEL = 0.9  # share of the smaller of the falsifier's level and the saturation level, for every claim that has both
HEADS = ("claim", "rate", "y_e from", "at its rest", "extent", "settles", "of falsifier", "of thrust", "proof", "check",
         "size", "bar")  # fmt: skip


class Bar(NamedTuple):
    """A requirement on a region as text, and whether a proof meets it within the given times of proof and check."""

    text: str
    met: Callable[[RegionProof, float, float], bool]


def beside(proof: RegionProof) -> float:
    """Return |y_e| [m] at the equilibrium, or at x_e = 0 without one."""
    return float(proof.document["claim"]["motion"].get("beside_m", proof.offset))


BARS: Mapping[str, Bar] = {
    "region-cruise-20": Bar(
        "y_e ≥ 0.34 m in ≤ 60 s, check ≤ 5 s, ≤ 50 kB",
        lambda p, proof, check: p.offset >= 0.34 and proof <= 60 and check <= 5 and len(p.text()) <= 50_000,
    ),
    "region-cruise-20-soft": Bar("y_e ≥ 0.34 m", lambda p, *_: p.offset >= 0.34),
    "region-cruise-current": Bar("y_e ≥ 0.15 m", lambda p, *_: p.offset >= 0.15),
}


def main(arguments: list[str]) -> int:
    """Run the study, print the results, and return the exit status."""
    quick = "--quick" in arguments
    names = [a for a in arguments if a != "--quick"]
    wrong = [name for name in names if name not in REGION_CLAIMS]
    if wrong:
        print(f"{wrong[0]}: unknown option or claim; --quick, or {', '.join(REGION_CLAIMS)}", file=sys.stderr)
        return 2
    names = names or (["region-cruise-20"] if quick else list(REGION_CLAIMS))
    vehicle, gains = load_vehicle(VEHICLE), load_gains(GAINS)
    print(f"| {' | '.join(HEADS)} |\n|{'---|' * len(HEADS)}")
    good = True
    for name in names:
        began = time.process_time()
        proof = prove_statement(REGION_CLAIMS[name], vehicle, gains)
        took = time.process_time() - began
        if proof.verdict != "proved":
            good = False
            print(f"| `{name}` | **not proved**: {proof.reason} |" + " |" * 10, flush=True)
            continue
        began = time.process_time()
        again = check_document(proof.document)
        checked = time.process_time() - began
        good = good and again.accepted
        bar = BARS.get(name)
        met = bar is None or bar.met(proof, took, checked)
        ratios = proof.ratios
        high = ratios is None or max(ratios) >= LEVEL
        good = good and met and high
        shown = "–" if bar is None else f"{bar.text}: {'met' if met else '**missed**'}"
        told = ("–", "–") if ratios is None else (f"{ratios.falsifier:.2f}", f"{ratios.thrust:.2f}")
        shown += "" if high else f"; **level below {LEVEL}**"
        print(
            f"| `{name}` | {proof.claim.rate:g}/s | {proof.offset:.3f} m | {beside(proof):.3f} m "
            f"| {proof.extent:.3f} m | {proof.ultimate_bound[0]:.3f}, {proof.ultimate_bound[1]:.3f} m "
            f"| {told[0]} | {told[1]} | {took:.1f} s | {checked:.2f} s | {len(proof.text())} B | {shown} |",
            flush=True,
        )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
