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
from surctl.lyapunov.slope_search import form_of
from surctl.marine.control import load_gains
from surctl.marine.tuning import derived_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.region import REGION_CLAIMS, prove_statement
from surctl.verification.formula import parse, values_of, variable

Array = NDArray[np.float64]

RECORDED = Path(__file__).parents[2] / "tests" / "certcheck"
CURVED, STEERED = "region-turning-20-curved", "region-steered-20"
PAIRS = (
    ("region-turning", "bluerov2-vonbenzon"),
    ("region-turning", "bluerov2-wu"),
    ("region-turning-20", "bluerov2-vonbenzon"),
    ("region-turning-20", "bluerov2-wu"),
    ("region-turning-20", "sur540-flooded"),
    ("region-turning-20-rest", "bluerov2-vonbenzon"),
    ("region-turning-20-rest", "bluerov2-wu"),
    ("region-turning-20-scale", "sur540-flooded"),
    ("region-cruise-20", "sur540-flooded"),
    ("region-cruise-20-soft", "sur540-flooded"),
    (CURVED, "sur540-flooded"),
    ("region-turning-20", "bluerov2-heavy"),
    ("region-turning-20-rest", "bluerov2-heavy"),
    ("region-turning-20", "rexrov"),
    ("region-turning-lag", "bluerov2-vonbenzon@0.15"),
    ("region-turning-20-lag", "bluerov2-heavy@0.15"),
    ("region-turning-20-sampled", "bluerov2-heavy@0.15"),
    ("region-turning-20-curved-fast", "sur540-flooded"),
    ("region-turning-20-current", "sur540-flooded"),
    (STEERED, "otter"),
    (STEERED, "remus100"),
    (STEERED, "remus100@1.0"),
    (STEERED, "remus100@1.25"),
    (STEERED, "remus100@1.5"),
)
OWN = {"bluerov2-vonbenzon@0.15": 0.15, "bluerov2-heavy@0.15": 0.15,
       "bluerov2-heavy": 0.17, "rexrov": 0.95, "otter": 1.1, "remus100": 0.87,
       "remus100@1.0": 1.0, "remus100@1.25": 1.25, "remus100@1.5": 1.5}  # fmt: skip
"""Vehicles with gains derived at their cruise speed [m/s]; the others have the gains `default` at 0.15 m/s."""

MOTIONS, SECONDS, STEP = 10_000, 40.0, 0.02
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

        self.terms = vehicle["terms"]
        ends = {key: (*vehicle[f"{key}_factor"], 1.0) for key in ("mass", "drag")}
        self.inert, self.rough = (rng.choice(ends[key], size=count) for key in ("mass", "drag"))
        self.mass = factors("mass") * self.law["mass_kg"]
        linear, quadratic = factors("drag"), factors("drag")
        self.linear, self.quadratic = linear * self.law["linear_drag"], quadratic * self.law["quadratic_drag"]
        self.means = linear.mean(axis=1) - 1, quadratic.mean(axis=1) - 1
        self.lag = vehicle.get("lag_s", [0.0, 0.0])[1]
        angle = rng.uniform(0, 2 * np.pi, size=count) if vehicle.get("current_m_per_s") else np.zeros(count)
        self.flow = vehicle.get("current_m_per_s", 0.0) * np.stack([np.cos(angle), np.sin(angle)])

    def term(self, name: str) -> Array:
        """Return a term beside equation (3) of every vehicle (n,); 0 if the vehicle does not have it."""
        return np.asarray((self.inert if name[0] == "m" else self.rough) * self.terms.get(name, 0.0))

    def commanded(self, state: Array) -> Array:
        """Return the thrust (2, n) that the law commands for the velocity over ground."""
        x_e, y_e, psi, u, v = state[:5]
        law, c, s = self.law, np.cos(psi), np.sin(psi)
        slant = np.hypot(1, y_e / law["lookahead"])
        along = np.minimum(np.maximum(law["cruise"] - law["k1"] * x_e, 0), law["cap"] / slant)
        desired = along, -along * y_e / law["lookahead"]
        in_body = c * desired[0] + s * desired[1], c * desired[1] - s * desired[0]
        thrusts = []
        for k, (w, n) in enumerate(zip(in_body, (u, v), strict=True)):
            hat, hat2, mass = law["linear_drag"][k], law["quadratic_drag"][k], law["mass_kg"][k]
            free = hat * w + hat2 * np.abs(w) * w + mass * law["k_v"] * (w - n)
            thrusts.append(np.clip(free, -self.limit[k], self.limit[k]))
        return np.stack(thrusts)

    def rate(self, state: Array, r: Array, other: Array, held: Array | None = None) -> Array:
        """Return d/dt of (x_e, y_e, psi, u, v, thrust X, thrust Y) (7, n) for the yaw rate r (n,).

        `other` holds heave velocity and acceleration, yaw acceleration and turn rate of the path frame (4, n), and
        `held` the commands (2, n), by default the present ones. Without lag, the thrust is the command, and does not
        change.
        """
        _, y_e, psi, u, v, *thrust = state
        x_e, (w, w_rate, r_rate, bend) = state[0], other
        law, c, s = self.law, np.cos(psi), np.sin(psi)
        command = self.commanded(state) if held is None else held
        thrust = np.stack(thrust) if self.lag else command
        over_ground = c * u - s * v, s * u + c * v
        u, v = u - c * self.flow[0] - s * self.flow[1], v + s * self.flow[0] - c * self.flow[1]  # through the water
        forces = []
        for k, n in enumerate((u, v)):
            drag = self.linear[:, k] * n + self.quadratic[:, k] * np.abs(n) * n
            forces.append(thrust[k] - drag)
        m1, m2 = self.mass.T
        m12, m13, m14, m23, m24 = (self.term(f"m{k}") for k in (12, 13, 14, 23, 24))
        for k, letter in enumerate("XY"):
            forces[k] = forces[k] + self.term(f"{letter}0")
            for name in [name for name in self.terms if name[0] == letter and name[1:].isalpha()]:
                first, *second = ({"u": u, "v": v, "w": w, "r": r}[axis] for axis in name[1:])
                forces[k] = forces[k] - self.term(name) * (np.abs(first) * second[0] if second else first)
        p_x, p_y = m1 * u + m12 * v + m13 * w + m14 * r, m2 * v + m12 * u + m23 * w + m24 * r
        a = forces[0] + p_y * r - m13 * w_rate - m14 * r_rate
        b = forces[1] - p_x * r - m23 * w_rate - m24 * r_rate
        turned = (m2 * a - m12 * b) / (m1 * m2 - m12**2), (m1 * b - m12 * a) / (m1 * m2 - m12**2)
        along, across = over_ground
        # a constant current turns at -r in the body
        turned = (
            turned[0] + r * (s * self.flow[0] * -1 + c * self.flow[1]),
            turned[1] - r * (c * self.flow[0] + s * self.flow[1]),
        )
        late = (command - thrust) / self.lag if self.lag else np.zeros_like(command)
        return np.stack([along - law["cruise"] + bend * y_e, across - bend * x_e, r - bend, *turned, *late])


def simulated(document: Mapping[str, Any], count: int, seconds: float, *, seed: int = 1) -> Motions:
    """Simulate motions from the boundary V = 1 with a greedy (half of them) or a random yaw rate within its limit."""
    claim, proof, rng = document["claim"], document["proof"], np.random.default_rng(seed)
    size = len(proof["P"])
    P = np.array([[proof["P"][max(i, j)][min(i, j)] for j in range(size)] for i in range(size)])
    plant, law, most = Plant(claim, count, rng), claim["law"], claim["vehicle"]["yaw_rate_rad_per_s"]
    vehicle = claim["vehicle"]
    omega = sum(slope * mean for slope, mean in zip(proof["trim"], plant.means, strict=True))
    gains = np.stack([np.ones(count), *plant.means]).T @ np.array(proof.get("flow", np.zeros((3, 2))))
    drawn = -gains.T * plant.flow  # the steady command shifts with the current
    omega = omega + drawn[0]
    aside = -law["lookahead"] * drawn[1] / (law["cruise"] + omega)
    xi = rng.normal(size=(count, len(P))) @ np.linalg.inv(np.linalg.cholesky(P))
    xi /= np.sqrt(np.einsum("ni,ij,nj->n", xi, P, xi))[:, None]
    psi = rng.uniform(-np.pi, np.pi, size=count)
    along, across = xi[:, 2] + law["cruise"], xi[:, 3]
    c, s = np.cos(psi), np.sin(psi)
    state = np.stack(
        [xi[:, 0] - omega / law["k1"], xi[:, 1] + aside, psi, c * along + s * across, c * across - s * along]
    )
    masses, shift, hold = np.array(law["mass_kg"])[:, None], omega / law["k1"], law.get("period_s", 0.0)

    def trim(psi: Array) -> Array:
        c, s = np.cos(psi), np.sin(psi)
        at = [-shift, aside + 0 * psi, psi, c * law["cruise"], -s * law["cruise"]]
        return plant.commanded(np.stack(at))

    if plant.lag:  # the last two entries of ξ are the thrust minus that of the steady cruise, over the mass in the law
        force = np.stack([c * xi[:, 4] + s * xi[:, 5], c * xi[:, 5] - s * xi[:, 4]])
        state = np.concatenate([state, trim(psi) + masses * force])
    else:
        state = np.concatenate([state, plant.commanded(state)])
    step = hold / 3 if hold else STEP

    def level(at: Array, phase: float = 0.0) -> Array:
        # with held commands, V = ξᵀ P ξ + q (1 − σ)/σ |D|² at the share σ of a period
        c, s = np.cos(at[2]), np.sin(at[2])
        z = np.stack(
            [at[0] + shift, at[1] - aside, c * at[3] - s * at[4] - law["cruise"], s * at[3] + c * at[4]], axis=1
        )
        if plant.lag:
            f_x, f_y = (at[5:] - trim(at[2])) / masses
            z = np.hstack([z, np.stack([c * f_x - s * f_y, s * f_x + c * f_y], axis=1)])
        value = np.asarray(np.einsum("ni,ij,nj->n", z, P, z))
        if held is not None and phase:
            late = np.square((held - plant.commanded(at)) / masses).sum(axis=0)
            value = value + proof["thrust"]["weight"] * (1 - phase) / phase * late
        return value

    most_other = [vehicle[key] for key in ("heave_m_per_s", "heave_m_per_s2", "yaw_rad_per_s2")]
    bounds = np.array([*most_other, law["cruise"] * claim["motion"]["curvature_per_m"]])[:, None]
    other = bounds * rng.choice([-1.0, 1.0], size=(4, count))
    greedy, r = np.arange(count) % 2 == 0, rng.choice([-most, most], size=count)
    ratio, left, held = 0.0, np.zeros(count, dtype=bool), None
    for k in range(1, int(seconds / step) + 1):
        if hold and k % 3 == 1:
            held = plant.commanded(state)
        if k % 5 == 1:
            # greedy: the yaw rate with the larger V a short time later
            ahead = [level(state + 0.1 * plant.rate(state, np.full(count, one), other)) for one in (-most, most)]
            other = np.where(
                rng.uniform(size=(4, count)) < 0.05, bounds * rng.choice([-1.0, 1.0], size=(4, count)), other
            )
            switched = np.where(rng.uniform(size=count) < 0.1, rng.uniform(-most, most, size=count), r)
            r = np.where(greedy, np.where(ahead[1] > ahead[0], most, -most), switched)
        a = plant.rate(state, r, other, held)
        b = plant.rate(state + step / 2 * a, r, other, held)
        d = plant.rate(state + step / 2 * b, r, other, held)
        state = state + step / 6 * (a + 2 * b + 2 * d + plant.rate(state + step * d, r, other, held))
        now = level(state, ((k - 1) % 3 + 1) / 3)
        bound = max(np.exp(-claim["motion"]["rate_per_s"] * k * step), proof["floor"])
        ratio = max(ratio, float(now.max()) / bound)
        left |= now > 1
    return Motions(ratio, int(left.sum()))


def steered(document: Mapping[str, Any], count: int, seconds: float, *, seed: int = 1) -> Motions:
    """Simulate the heading loop of a craft without sway force from the boundary of its region, by the stated text.

    The parameters lie at ends of their ranges; the surge speeds change to another end from time to time.
    """
    claim, rng = document["claim"], np.random.default_rng(seed)
    names, ends = [row["name"] for row in claim["states"]], claim["parameters"]
    low, high = (np.array([row[key] for row in ends])[:, None] for key in ("lower", "upper"))
    speeds = np.array([[row["name"] in ("u", "u_model", "share")] for row in ends])
    known = {name: variable(name) for name in (*names, *(row["name"] for row in ends))}
    roots = [parse(claim["dynamics"][name], known) for name in names]
    P = form_of(parse(claim["function"], known), names) / claim["level"]
    w = np.where(rng.random((len(ends), count)) < 0.5, low, high)

    def rate(state: Array) -> Array:
        return values_of(roots, dict(zip(known, np.vstack([state, w]), strict=True)))

    xi = rng.normal(size=(len(names), count))
    state = xi / np.sqrt(np.einsum("in,ij,jn->n", xi, P, xi))
    ratio, left = 0.0, np.zeros(count, dtype=bool)
    for k in range(1, int(seconds / STEP) + 1):
        w = np.where(speeds & (rng.random(w.shape) < 0.01), np.where(rng.random(w.shape) < 0.5, low, high), w)
        a = rate(state)
        b = rate(state + STEP / 2 * a)
        d = rate(state + STEP / 2 * b)
        state = state + STEP / 6 * (a + 2 * b + 2 * d + rate(state + STEP * d))
        now = np.einsum("in,ij,jn->n", state, P, state)
        ratio = max(ratio, float(now.max()) / np.exp(-claim["rate"] * k * STEP))
        left |= now > 1
    return Motions(ratio, int(left.sum()))


def motion_of(claim: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a certificate states about the motion, by the names of the regions by cells of headings."""
    if "motion" in claim:
        return {"rest_offset_m": None, "ultimate_bound_m": (0.0, 0.0), **claim["motion"]}
    names = [row["name"] for row in claim["states"]]
    form = form_of(parse(claim["function"], {name: variable(name) for name in names}), names) / claim["level"]
    return {"rest_offset_m": None, "ultimate_bound_m": (0.0, 0.0), "offset_m": 1 / np.sqrt(form[0, 0])}


def row(
    name: str, vehicle: str, document: Mapping[str, Any], took: float | None, motions: Motions, checked: float
) -> str:
    """Return a row of the table."""
    motion, size = motion_of(document["claim"]), len(json.dumps(document, separators=(",", ":"))) + 1
    moment = document["claim"].get("vehicle", {}).get("munk_moment_nm")
    settles = "{:.3f}, {:.3f} m".format(*motion["ultimate_bound_m"])
    rest = "–" if motion["rest_offset_m"] is None else f"{motion['rest_offset_m']:.3f} m"
    return (
        f"| `{name}` | {vehicle} | {motion['offset_m']:.3f} m | {rest} | {settles} "
        f"| {'–' if moment is None else f'{moment:.3f} N m'} | {'–' if took is None else f'{took:.0f} s'} "
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
            robot, cruise = load_vehicle(vehicle.partition("@")[0]), OWN.get(vehicle)
            gains = load_gains("default") if cruise is None else derived_gains(robot, cruise=cruise)
            cap = None if cruise is None else round(cruise * 0.22 / 0.15, 9)
            proof = prove_statement(REGION_CLAIMS[name], robot, gains, cruise=cruise, cap=cap)
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
        simulate = steered if document["kind"] == "lyapunov" else simulated
        motions = simulate(document, 64, 4.0) if quick else simulate(document, MOTIONS, SECONDS)
        good = good and again.accepted and not motions.escapes and motions.ratio <= 1 + 1e-6
        print(row(name, vehicle, document, took, motions, checked), flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
