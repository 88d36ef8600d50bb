"""Study 16: size of the certified regions of attraction, comparison with the largest possible, and time of the proofs.

    python analysis/16_cruise_regions/run.py [--quick] [CLAIM…]

Prints Markdown; the times are the processor's, of this process. Ends with 0 when every claim is proved, its certificate
accepted and the bars that it names are met, else with 1; with 2 for a bad option. `--quick` proves `region-heading-20`
only and gives codac 2 s.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from surctl.certcheck import check_document
from surctl.marine.control import load_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.region import REGION_CLAIMS, RegionProof, prove_statement

VEHICLE, GAINS = "sur540-flooded", "default"
LEVEL = 0.9  # share of the smaller of the falsifier's level and the saturation level, for every claim that has both
CODAC_SECONDS = 30.0
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
    "region-heading-20": Bar(
        "y_e ≥ 0.34 m in ≤ 10 s, check ≤ 1 s, ≤ 10 kB",
        lambda p, proof, check: p.offset >= 0.34 and proof <= 10 and check <= 1 and len(p.text()) <= 10_000,
    ),
    "region-heading-20-slow": Bar("y_e ≥ 0.65 m, saturated", lambda p, *_: p.offset >= 0.65),
    "region-heading-ranges": Bar("y_e ≥ 0.29 m in ≤ 60 s", lambda p, proof, _: beside(p) >= 0.29 and proof <= 60),
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
    names = names or (["region-heading-20"] if quick else list(REGION_CLAIMS))
    vehicle, gains = load_vehicle(VEHICLE), load_gains(GAINS)
    print(f"| {' | '.join(HEADS)} |\n|{'---|' * len(HEADS)}")
    good = True
    eight: tuple[RegionProof, float, float] | None = None
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
        eight = (proof, took, checked) if name == "region-heading-20" else eight
    if eight is not None:
        limit = 0.5 if quick else CODAC_SECONDS
        print(f"\nThe loop of 8 states: {against_codac(*eight, limit)}")
    return 0 if good else 1


def against_codac(proof: RegionProof, took: float, checked: float, limit: float) -> str:
    """Return how long codac takes to show V̇ < −a V on 0.05 ≤ V ≤ 1 for the same V, for the nominal vehicle alone."""
    began = time.perf_counter()
    try:
        done = subprocess.run(
            [sys.executable, __file__, "--codac"], input=proof.text(), text=True, capture_output=True, timeout=limit
        )
    except subprocess.TimeoutExpired:
        return (
            f"codac is stopped after {limit:g} s, open; the proof over all ranges took {took:.1f} s "
            f"(at least {limit / took:.0f} times less), its check {checked:.2f} s "
            f"(at least {limit / checked:.0f} times less)."
        )
    if done.returncode:
        return f"codac skipped: {done.stderr.strip().splitlines()[-1]}"
    return f"codac: {done.stdout.strip()} in {time.perf_counter() - began:.1f} s."


def codac_alone(document: Mapping[str, object]) -> str:
    """Run codac on the certificate's V with nominal parameters and without thrust limits: easier than the proved
    claim.
    """
    import codac

    claim, proof = document["claim"], document["proof"]
    law, a = claim["law"], claim["motion"]["rate_per_s"]
    boat = {key: sum(pair) / 2 for key, pair in claim["vehicle"].items() if key != "limits"}
    lower = proof["P"]
    P = np.array([[lower[max(i, j)][min(i, j)] for j in range(6)] for i in range(6)])
    z = codac.VectorVar(8)
    xi = [z[k] for k in range(6)]
    v, push, ahead = law["cruise"], law["mass_kg"] * law["k"], law["lookahead"]
    c, s = codac.cos(xi[2]), codac.sin(xi[2])
    u, w = c * (v + xi[3]) + s * xi[4], -s * (v + xi[3]) + c * xi[4]
    q = codac.sqrt(codac.sqr(xi[1]) + ahead**2)
    fed = law["linear_drag"] * v + law["quadratic_drag"] * v * v
    f = push * ((v - law["k1"] * xi[0]) * q / ahead - u) + fed
    f = f - boat["surge_linear"] * u - boat["surge_quadratic"] * u * codac.abs(u)
    g = -push * w - boat["sway_linear"] * w - boat["sway_quadratic"] * w * codac.abs(w)
    n = -law["yaw_inertia_kg_m2"] * law["k_r"] * (xi[5] + law["k_psi"] * (xi[2] + codac.atan(xi[1] / ahead)))
    n = n - boat["yaw_linear"] * xi[5] - boat["yaw_quadratic"] * xi[5] * codac.abs(xi[5])
    m, inertia = boat["mass_kg"], boat["yaw_inertia_kg_m2"]
    heave = -law["heave_mass_kg"] * law["k"] * (z[7] + law["k_z"] * z[6]) - boat["heave_quadratic"] * z[7] * codac.abs(
        z[7]
    )
    rates = [xi[3], xi[4], xi[5], (c * f - s * g) / m, (s * f + c * g) / m, n / inertia]
    vertical = proof["P_z"]
    V = vertical[0][0] * codac.sqr(z[6]) + 2 * vertical[1][0] * z[6] * z[7] + vertical[1][1] * codac.sqr(z[7])
    grow = 2 * (vertical[0][0] * z[6] + vertical[1][0] * z[7]) * z[7]
    grow = grow + 2 * (vertical[1][0] * z[6] + vertical[1][1] * z[7]) * heave / boat["heave_mass_kg"]
    for i in range(6):
        for j in range(6):
            if P[i, j]:
                V = V + float(P[i, j]) * (xi[i] * xi[j])
                grow = grow + 2 * float(P[i, j]) * (xi[i] * rates[j])
    function = codac.AnalyticFunction([z], codac.vec(grow + a * V, V))
    wanted = codac.IntervalVector([[0, codac.oo], [0.05, 1]])
    ends = np.sqrt(np.diag(np.linalg.inv(P)))
    high = np.linalg.inv(np.array([[vertical[0][0], vertical[1][0]], [vertical[1][0], vertical[1][1]]]))
    box = codac.IntervalVector([[-float(e), float(e)] for e in (*ends, *np.sqrt(np.diag(high)))])
    left = codac.pave(box, codac.CtcInverse(function, wanted), 1e-2).boxes(codac.PavingOut.outer)
    return "proved" if not left else f"{len(left)} boxes open at a width of 0.01"


if __name__ == "__main__":
    if sys.argv[1:] == ["--codac"]:
        import json

        print(codac_alone(json.load(sys.stdin)))
        sys.exit(0)
    sys.exit(main(sys.argv[1:]))
