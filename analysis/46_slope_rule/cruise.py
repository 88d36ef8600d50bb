"""Study 46, second part: would the slope rule prove the regions of a cruise, which have a rule of their own?

    python analysis/46_slope_rule/cruise.py [--quick] [--cells N…]

The loop of each claim, without thrust lag, held commands, current and disturbances, is written as one text, with the
heading as a parameter whose range is cut into cells. Slopes, and their ranges, are those of the slope rule; V is that
of the recorded certificate. The largest level is printed at which V decays at the claimed rate between 0.82 times this
level and the level, by vertices and trim errors that are drawn: an estimate that may be too large, and no proof. Prints
Markdown. The exit status is 2 for a bad option.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from fractions import Fraction
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.enclosure import span
from surctl.certcheck.region_claim import triangle
from surctl.certcheck.region_exact import inverse
from surctl.certcheck.slope_rows import Number, Rows
from surctl.verification.formula import parse, values_of, variable

Array = NDArray[np.float64]

RECORDED = Path(__file__).parents[2] / "tests" / "certcheck"
CLAIMS = (
    "region-turning",
    "region-turning-20",
    "region-turning-20-curved",
    "region-cruise-20",
    "region-cruise-20-soft",
)
STATES = ("x", "y", "p", "q")
SHELL = 0.82  # ratio of the two levels between which V decays
LEVELS = (1.0, 0.97, 0.94, 0.9, 0.85, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
GROWTHS = np.geomspace(2e-3, 0.6, 22)  # 1/s
DRAWN, VERTICES, WORST = 60_000, 15_000, 500  # trim errors; vertices; those whose growth is searched
MORE = 1.03  # bound of the trim errors, relative to the largest drawn one


def cruise(claim: Mapping[str, Any], trim: Sequence[float]) -> tuple[list[str], dict[str, tuple[float, float]]]:
    """Return the rates of the deviations from the steady cruise, and the parameters but the heading, with their ranges.

    The states are the deviations in the path frame: of the position, x and y, and of the velocity, p and q.
    """
    law, vehicle = claim["law"], claim["vehicle"]
    v, ahead, masses, limits = law["cruise"], law["lookahead"], law["mass_kg"], vehicle["thrust_n"]
    ranges: dict[str, tuple[float, float]] = {}

    def factors(name: str, ends: Sequence[float], apart: float) -> tuple[str, str]:
        if ends[0] == ends[1]:
            return repr(ends[0]), repr(ends[0])
        ranges[name] = ends[0], ends[1]
        if not apart:
            return name, name
        ranges[f"{name}_apart"] = -apart / 2, apart / 2
        return f"({name}*(1 + {name}_apart))", f"({name}*(1 - {name}_apart))"

    linear, quadratic = (factors(n, vehicle["drag_factor"], vehicle["drag_asymmetry"]) for n in ("linear", "quadratic"))
    means = (f"(({one} + {two})/2 - 1)" for one, two in (linear, quadratic))
    moved = " + ".join(f"{slope}*{mean}" for slope, mean in zip(trim, means, strict=True))
    mass = [
        f"({m}*{f})"
        for m, f in zip(masses, factors("mass", vehicle["mass_factor"], vehicle["mass_asymmetry"]), strict=True)
    ]
    along, beside, velocity = f"(x - ({moved})/{law['k1']})", "y", (f"({v} + p)", "q")
    pace = f"min(max({v} - {law['k1']}*{along}, 0), {law['cap']}/sqrt(1 + (y/{ahead})^2))"
    wanted = in_body((pace, f"(-({pace})*y/{ahead})"))
    body, forces = in_body(velocity), []
    for i, (a, b) in enumerate(zip(law["linear_drag"], law["quadratic_drag"], strict=True)):
        command = f"{a}*{wanted[i]} + {b}*({wanted[i]}*abs({wanted[i]}))"
        command += f" + {masses[i] * law['k_v']}*({wanted[i]} - {body[i]})"
        drag = f"{a}*{linear[i]}*{body[i]} + {b}*{quadratic[i]}*({body[i]}*abs({body[i]}))"
        forces.append(f"((min(max({command}, -{limits[i]}), {limits[i]}) - ({drag}))/{mass[i]})")
    rates = ["p", "q", *in_path(forces)]
    if masses[0] != masses[1] or vehicle["mass_asymmetry"]:
        ranges["r"] = -vehicle["yaw_rate_rad_per_s"], vehicle["yaw_rate_rad_per_s"]
        munk = in_path([f"(r*(1 - {mass[1]}/{mass[0]})*{body[1]})", f"(r*({mass[0]}/{mass[1]} - 1)*{body[0]})"])
        rates[2:] = (f"{rate} - ({term})" for rate, term in zip(rates[2:], munk, strict=True))
    if bend := claim["motion"]["curvature_per_m"] * v:
        ranges["bend"] = -bend, bend
        turned = (f"bend*{beside}", f"-bend*{along}", f"bend*{velocity[1]}", f"-bend*{velocity[0]}")
        rates = [f"{rate} + {term}" for rate, term in zip(rates, turned, strict=True)]
    return rates, ranges


def in_body(vector: Sequence[str]) -> tuple[str, str]:
    """Return a vector of the path frame in the frame of the body."""
    x, y = vector
    return f"(cos(psi)*{x} + sin(psi)*{y})", f"(cos(psi)*{y} - sin(psi)*{x})"


def in_path(vector: Sequence[str]) -> tuple[str, str]:
    """Return a vector of the body frame in the frame of the path."""
    x, y = vector
    return f"cos(psi)*{x} - sin(psi)*{y}", f"sin(psi)*{x} + cos(psi)*{y}"


def trim_errors(rates: Sequence[str], box: Mapping[str, tuple[float, float]], random: np.random.Generator) -> Array:
    """Return bounds (n,) of the rates at the steady cruise, by drawn parameters."""
    at = dict.fromkeys(STATES, np.zeros(DRAWN))
    for name, (low, high) in box.items():
        ends = random.choice([low, high], DRAWN)
        at[name] = np.where(random.random(DRAWN) < 0.7, ends, random.uniform(low, high, DRAWN))
    values = values_of([parse(rate, {name: variable(name) for name in at}) for rate in rates], at)
    return np.asarray(MORE * np.abs(values).max(axis=1))


def drawn_vertices(rows: Rows, random: np.random.Generator) -> Array:
    """Return matrices (B, n, n) of the slopes at drawn vertices of their ranges."""
    slopes = np.array(rows.slopes, dtype=float)
    at = np.where(random.random((VERTICES, len(slopes))) < 0.5, *slopes.T)
    out = np.zeros((VERTICES, len(STATES), len(STATES)))
    for i, j in product(range(len(STATES)), repeat=2):
        entry = rows.rows[i][j]
        for term, number in entry.poly.items() if isinstance(entry, Number) else ():
            out[:, i, j] += float(number) * at[:, list(term)].prod(axis=1)
    return out


def largest(document: Mapping[str, Any], cells: int, cell: int) -> tuple[float, int, float]:
    """Return the largest level in one cell of headings, the number of slopes there, and the time for them [s]."""
    claim, random = document["claim"], np.random.default_rng(cell)
    p, rate = triangle(document["proof"]["P"], len(STATES), "P"), claim["motion"]["rate_per_s"]
    cover, exact = inverse(p), np.array(p, dtype=float)
    change = np.linalg.inv(np.linalg.cholesky(exact))
    rates, ranges = cruise(claim, document["proof"]["trim"])
    box = {"psi": (np.pi / 2 * cell / cells, np.pi / 2 * (cell + 1) / cells), **ranges}
    errors = trim_errors(rates, box, random)
    corners = np.array(list(product(*((e, -e) if e > 1e-12 else (0.0,) for e in errors)))) @ exact @ change.T
    pushes = corners[:, :, None] * corners[:, None, :]
    count, seconds = 0, 0.0
    for level in LEVELS:
        ends = [np.sqrt(float(cover[k][k]) * level) * 1.001 for k in range(len(STATES))]
        whole = [span(-float(end), float(end)) for end in ends] + [span(*map(float, pair)) for pair in box.values()]
        began = time.process_time()
        rows = Rows([*STATES, *box], whole, rates, [cover], [Fraction(0)] * len(STATES), Fraction(level))
        count, seconds = len(rows.slopes), time.process_time() - began
        half = change @ exact @ drawn_vertices(rows, random) @ change.T
        losses = -(half + half.swapaxes(1, 2))
        few = losses[np.argsort(np.linalg.eigvalsh(losses)[:, 0])[:WORST]]
        for growth in GROWTHS:
            left = few - (rate + growth) * np.eye(len(STATES))
            if all(np.linalg.eigvalsh(left - push / (growth * SHELL * level)).min() > 0 for push in pushes):
                return level, count, seconds
    return 0.0, count, seconds


def main(words: list[str] | None = None) -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one claim and one cell")
    parser.add_argument("--cells", type=int, nargs="+", default=[48, 96], help="cells of a quarter turn")
    given = parser.parse_args(words)
    counts, names = ([48], CLAIMS[3:4]) if given.quick else (given.cells, CLAIMS)
    heads = "".join(f" distance, {count} cells |" for count in counts)
    print(f"| claim | recorded |{heads} slopes | time for a cell |\n|---|---|{'---|' * len(counts)}---|---|")
    for name in names:
        document = json.loads((RECORDED / f"{name}.json").read_text())
        offset, shares, most, slowest = document["claim"]["motion"]["offset_m"], list[float](), 0, 0.0
        for count in counts:
            found = [largest(document, count, count * k // 4) for k in range(1 if given.quick else 4)]
            shares.append(min(level for level, *_ in found) ** 0.5)
            most = max(most, *(slopes for _, slopes, _ in found))
            slowest = max(slowest, *(seconds for *_, seconds in found))
        row = "".join(f" {share * offset:.3f} m ({share:.0%}) |" for share in shares)
        print(f"| `{name}` | {offset:.3f} m |{row} {most} | {slowest:.2f} s |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
