"""Study 29: regions of attraction of vehicles with unequal masses, and simulated motions from their boundaries.

    python analysis/29_vehicle_regions/run.py [--quick] [--out FOLDER] [CLAIM:VEHICLE…]

Prints Markdown; the times are the processor's, of this process. Ends with 0 when every claim of the table is proved,
its certificate accepted and no simulated motion leaves the region, else with 1; with 2 for a bad option. `--quick` does
not prove anything: it checks one recorded certificate and simulates 64 motions. `--out` writes the certificates as
CLAIM-VEHICLE.json.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import check_document
from surctl.control import load_gains
from surctl.vehicle import load_vehicle
from surctl.verification.region import REGION_CLAIMS, prove_statement

Array = NDArray[np.float64]

RECORDED = Path(__file__).parents[2] / "tests" / "certcheck"
PAIRS = (
    ("region-turning", "bluerov2-vonbenzon"),
    ("region-turning", "bluerov2-wu"),
    ("region-turning-20", "bluerov2-vonbenzon"),
    ("region-turning-20", "bluerov2-wu"),
    ("region-turning-20", "sur540-flooded"),
    ("region-turning-20-rest", "bluerov2-vonbenzon"),
    ("region-turning-20-rest", "bluerov2-wu"),
    ("region-turning-20-scale", "sur540-flooded"),
)
MOTIONS, SECONDS, STEP = 2_400, 40.0, 0.02
HEADS = ("claim", "vehicle", "y_e from", "at rest", "settles", "Munk moment", "proof", "check", "size",
         "largest V/bound", "escapes")  # fmt: skip


class Motions(NamedTuple):
    """Largest V/max(e^(−a t), floor) of all motions at all times, and the number of motions that leave V ≤ 1."""

    ratio: float
    escapes: int


class Plant:
    """True vehicles (n) and the law, written for this study alone: equations in the body frame with Coriolis forces."""

    def __init__(self, claim: Mapping[str, Any], count: int, rng: np.random.Generator) -> None:
        self.law, vehicle = claim["law"], claim["vehicle"]
        self.limit = vehicle["thrust_n"]

        def factors(key: str) -> Array:
            # numbers in [least, largest] that differ by at most the asymmetry: between t and ratio t
            low, high = vehicle[f"{key}_factor"]
            share = vehicle[f"{key}_asymmetry"]
            ratio = (2 + share) / (2 - share)
            least = np.exp(rng.uniform(np.log(low), np.log(max(high / ratio, low)), size=(count, 1)))
            least = np.where(rng.uniform(size=(count, 1)) < 0.5, rng.choice([low, max(high / ratio, low)]), least)
            inside = rng.uniform(size=(count, 2))
            inside = np.where(rng.uniform(size=(count, 2)) < 0.6, np.round(inside), inside)
            return np.asarray(np.minimum(least * ratio**inside, high))

        self.mass = factors("mass") * self.law["mass_kg"]
        linear, quadratic = factors("drag"), factors("drag")
        self.linear, self.quadratic = linear * self.law["linear_drag"], quadratic * self.law["quadratic_drag"]
        self.means = linear.mean(axis=1) - 1, quadratic.mean(axis=1) - 1

    def rate(self, state: Array, r: Array) -> Array:
        """Return d/dt of (x_e, y_e, psi, u, v) (5, n) for the yaw rate r (n,)."""
        x_e, y_e, psi, u, v = state
        law, c, s = self.law, np.cos(psi), np.sin(psi)
        slant = np.hypot(1, y_e / law["lookahead"])
        along = np.minimum(np.maximum(law["cruise"] - law["k1"] * x_e, 0), law["cap"] / slant)
        desired = along, -along * y_e / law["lookahead"]
        in_body = c * desired[0] + s * desired[1], c * desired[1] - s * desired[0]
        forces = []
        for k, (w, n) in enumerate(zip(in_body, (u, v), strict=True)):
            hat, hat2, mass = law["linear_drag"][k], law["quadratic_drag"][k], law["mass_kg"][k]
            free = hat * w + hat2 * np.abs(w) * w + mass * law["k_v"] * (w - n)
            drag = self.linear[:, k] * n + self.quadratic[:, k] * np.abs(n) * n
            forces.append(np.clip(free, -self.limit[k], self.limit[k]) - drag)
        m1, m2 = self.mass.T
        turned = (forces[0] + m2 * v * r) / m1, (forces[1] - m1 * u * r) / m2
        return np.stack([c * u - s * v - law["cruise"], s * u + c * v, r, *turned])


def simulated(document: Mapping[str, Any], count: int, seconds: float, *, seed: int = 1) -> Motions:
    """Simulate motions from the boundary V = 1 with a greedy (half of them) or a random yaw rate within its limit."""
    claim, proof, rng = document["claim"], document["proof"], np.random.default_rng(seed)
    P = np.array([[proof["P"][max(i, j)][min(i, j)] for j in range(4)] for i in range(4)])
    plant, law, most = Plant(claim, count, rng), claim["law"], claim["vehicle"]["yaw_rate_rad_per_s"]
    omega = sum(slope * mean for slope, mean in zip(proof["trim"], plant.means, strict=True))
    xi = rng.normal(size=(count, 4)) @ np.linalg.inv(np.linalg.cholesky(P))
    xi /= np.sqrt(np.einsum("ni,ij,nj->n", xi, P, xi))[:, None]
    psi = rng.uniform(-np.pi, np.pi, size=count)
    along, across = xi[:, 2] + law["cruise"], xi[:, 3]
    c, s = np.cos(psi), np.sin(psi)
    state = np.stack([xi[:, 0] - omega / law["k1"], xi[:, 1], psi, c * along + s * across, c * across - s * along])
    shift = omega / law["k1"]

    def level(at: Array) -> Array:
        c, s = np.cos(at[2]), np.sin(at[2])
        z = np.stack([at[0] + shift, at[1], c * at[3] - s * at[4] - law["cruise"], s * at[3] + c * at[4]], axis=1)
        return np.asarray(np.einsum("ni,ij,nj->n", z, P, z))

    greedy, r = np.arange(count) % 2 == 0, rng.choice([-most, most], size=count)
    ratio, left = 0.0, np.zeros(count, dtype=bool)
    for k in range(1, int(seconds / STEP) + 1):
        if k % 5 == 1:
            # greedy: the yaw rate with the larger V a short time later
            ahead = [level(state + 0.1 * plant.rate(state, np.full(count, one))) for one in (-most, most)]
            switched = np.where(rng.uniform(size=count) < 0.1, rng.uniform(-most, most, size=count), r)
            r = np.where(greedy, np.where(ahead[1] > ahead[0], most, -most), switched)
        a = plant.rate(state, r)
        b = plant.rate(state + STEP / 2 * a, r)
        d = plant.rate(state + STEP / 2 * b, r)
        state = state + STEP / 6 * (a + 2 * b + 2 * d + plant.rate(state + STEP * d, r))
        now = level(state)
        bound = max(np.exp(-claim["motion"]["rate_per_s"] * k * STEP), proof["floor"])
        ratio = max(ratio, float(now.max()) / bound)
        left |= now > 1
    return Motions(ratio, int(left.sum()))


def row(
    name: str, vehicle: str, document: Mapping[str, Any], took: float | None, motions: Motions, checked: float
) -> str:
    """Return a row of the table."""
    motion, size = document["claim"]["motion"], len(json.dumps(document, separators=(",", ":"))) + 1
    rest = "–" if motion["rest_offset_m"] is None else f"{motion['rest_offset_m']:.3f} m"
    x, y = motion["ultimate_bound_m"]
    return (
        f"| `{name}` | {vehicle} | {motion['offset_m']:.3f} m | {rest} | {x:.3f}, {y:.3f} m "
        f"| {document['claim']['vehicle']['munk_moment_nm']:.3f} N m | {'–' if took is None else f'{took:.0f} s'} "
        f"| {checked:.2f} s | {size} B | {motions.ratio:.3f} | {motions.escapes} |"
    )


def main(arguments: list[str]) -> int:
    """Run the study, print the results, and return the exit status."""
    arguments, out = list(arguments), None
    if "--out" in arguments[:-1]:
        at = arguments.index("--out")
        out = Path(arguments[at + 1])
        out.mkdir(parents=True, exist_ok=True)
        del arguments[at : at + 2]
    quick = "--quick" in arguments
    names = [tuple(a.split(":")) for a in arguments if a != "--quick"]
    wrong = [":".join(one) for one in names if one not in PAIRS]
    if wrong:
        known = ", ".join(":".join(pair) for pair in PAIRS)
        print(f"{wrong[0]}: unknown option or claim; --quick, or {known}", file=sys.stderr)
        return 2
    print(f"| {' | '.join(HEADS)} |\n|{'---|' * len(HEADS)}")
    good = True
    for name, vehicle in names or (PAIRS[:1] if quick else PAIRS):
        took = None
        if quick:
            document = json.loads((RECORDED / f"{name}.json").read_text())
        else:
            began = time.process_time()
            proof = prove_statement(REGION_CLAIMS[name], load_vehicle(vehicle), load_gains("default"))
            took = time.process_time() - began
            if proof.verdict != "proved":
                good = False
                print(f"| `{name}` | {vehicle} | **{proof.reason}** |" + " |" * 8, flush=True)
                continue
            document = proof.document
            if out is not None:
                proof.write(out / f"{name}-{vehicle}.json")
        began = time.process_time()
        again = check_document(document)
        checked = time.process_time() - began
        motions = simulated(document, 64, 4.0) if quick else simulated(document, MOTIONS, SECONDS)
        good = good and again.accepted and not motions.escapes and motions.ratio <= 1 + 1e-6
        print(row(name, vehicle, document, took, motions, checked), flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
