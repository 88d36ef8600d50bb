"""Study 14, sums of squares: claims that interval branch and bound alone does not prove, and false claims beside them.

    python analysis/14_claim_prover/squares.py [--quick]

Prints Markdown; times are processor times. --quick leaves out the claims that take longest. Ends with 0 when every true
claim is proved and its certificate accepted, and no false claim is proved, else with 1; with 2 for a bad option.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np
from scipy.linalg import solve_continuous_are

from surctl.certcheck import check_document
from surctl.verification import Claim, Variable, prove

LIMIT = 60.0
"""Limit of the processor time of a proof [s]."""
FALSE_BY = 1e-6
"""By how much the false claims exceed the truth."""


def claim_of(
    name: str, box: Mapping[str, tuple[float, float]], symbols: ca.SX, left: ca.SX, constraints: Sequence[ca.SX] = ()
) -> Claim:
    """Return the claim left <= 0 on a box where all constraints are <= 0."""
    variables = tuple(
        Variable(n, symbols[k], "1", lower, upper, "") for k, (n, (lower, upper)) in enumerate(box.items())
    )
    return Claim(
        name, name, "", (), "proved", variables, left, ca.SX(0), "1", ca.vertcat(ca.SX(0, 1), *constraints), paper=False
    )


def coupled(count: int, radius: float) -> Claim:
    """Return the claim that the energy of x_i' = -x_i + 0.1 x_(i-1) x_(i+1), in a ring, does not grow on a ball."""
    x = ca.SX.sym("x", count)
    rate = sum(x[i] * (-x[i] + 0.1 * x[i - 1 if i else count - 1] * x[(i + 1) % count]) for i in range(count))
    box = {f"x{i}": (-radius, radius) for i in range(count)}
    return claim_of(f"coupled system, {count} states", box, x, rate, (ca.sumsqr(x) - radius**2,))


def cart_pole(level: float, rate: float) -> Claim:
    """Return the claim V' <= -rate V for an inverted pendulum on a cart with LQR where V <= level."""
    cart, pole, length, gravity = 1.0, 0.1, 0.5, 9.81
    a = np.zeros((4, 4))
    a[0, 1] = a[2, 3] = 1.0
    a[1, 2], a[3, 2] = -pole * gravity / cart, (cart + pole) * gravity / (cart * length)
    b = np.array([[0.0], [1 / cart], [0.0], [-1 / (cart * length)]])
    p = np.round(solve_continuous_are(a, b, np.diag([1.0, 1.0, 10.0, 1.0]), np.eye(1)), 4)
    gain = np.round(b.T @ p, 4)
    x = ca.SX.sym("x", 4)
    sine, cosine = ca.sin(x[2]), ca.cos(x[2])
    pushed = -ca.mtimes(ca.DM(gain), x) + pole * length * x[3] ** 2 * sine
    mass = cart + pole * sine**2
    f = ca.vertcat(
        x[1],
        (pushed - pole * gravity * sine * cosine) / mass,
        x[3],
        (gravity * sine * (cart + pole) - cosine * pushed) / (length * mass),
    )
    v = ca.bilin(ca.DM(p), x, x)
    left = 2 * ca.dot(ca.mtimes(ca.DM(p), x), f) + rate * v
    half = np.ceil(np.sqrt(level * np.diag(np.linalg.inv(p))) * 1e4) / 1e4
    names = ("x", "v", "theta", "w")
    box = {n: (-float(h), float(h)) for n, h in zip(names, half, strict=True)}
    return claim_of(f"cart-pole with LQR, theta up to {half[2]:.2f} rad", box, x, left, (v - level,))


def polynomials() -> list[Claim]:
    """Return the claims that two polynomials, which are no sums of squares, are not negative on a square."""
    z = ca.SX.sym("z", 2)
    x, y = z[0], z[1]
    box = {"x": (-2.0, 2.0), "y": (-2.0, 2.0)}
    motzkin = x**4 * y**2 + x**2 * y**4 + 1 - 3 * x**2 * y**2
    robinson = x**6 + y**6 + 1 + 3 * x**2 * y**2 - (x**4 * (y**2 + 1) + y**4 * (x**2 + 1) + x**2 + y**2)
    return [claim_of("Motzkin", box, z, -motzkin), claim_of("Robinson", box, z, -robinson)]


def false_claims() -> list[Claim]:
    """Return claims that are false by `FALSE_BY` at a point, or on a curve through 0."""
    return [
        Claim(
            f"{claim.name}, false by {FALSE_BY:g}", "", "", (), "refuted", claim.variables, claim.left + FALSE_BY,
            claim.right, "1", claim.constraints, paper=False,
        )
        for claim in (*polynomials(), coupled(4, 6.0))
    ]  # fmt: skip


def main(arguments: list[str]) -> int:
    """Run the study, print the results, and return the exit status."""
    unknown = [a for a in arguments if a != "--quick"]
    if unknown:
        print(f"{unknown[0]}: unknown option; the only one is --quick", file=sys.stderr)
        return 2
    quick = "--quick" in arguments
    true = polynomials()
    if not quick:
        true += [coupled(10, 6.0), cart_pole(1.0, 0.1), cart_pole(4.0, 0.1)]
    good = True
    print("| claim | proved by | proof | check | certificate |\n|---|---|---|---|---|")
    for claim in true:
        began = time.process_time()
        proof = prove(claim, time_limit=LIMIT)
        seconds = time.process_time() - began
        if proof.certificate is None:
            good = False
            print(f"| {claim.name} | **not proved**: {proof.remaining} | {seconds:.1f} s | – | – |")
            continue
        began = time.process_time()
        accepted = check_document(proof.certificate).accepted
        checked = time.process_time() - began
        good &= accepted
        by = (
            "sums of squares"
            if any("squares" in c for c in proof.certificate["cases"])
            else f"{proof.boxes} box{'es' if proof.boxes > 1 else ''}"
        )
        size = len(json.dumps(proof.certificate)) / 1000
        print(f"| {claim.name} | {by} | {seconds:.1f} s | {checked:.2f} s | {size:.1f} kB |", flush=True)
    for claim in false_claims():
        began = time.process_time()
        proof = prove(claim, time_limit=0.25 if quick else 10.0)
        good &= proof.certificate is None
        word = "not proved" if proof.certificate is None else "**proved**"
        print(f"| {claim.name} | {word} | {time.process_time() - began:.1f} s | – | – |", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
