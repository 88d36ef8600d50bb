"""Study 46, second part: would the slope rule prove the regions of a cruise, which have a rule of their own?

    python analysis/46_slope_rule/cruise.py [--quick] [--cells N…]

The loop of each claim without held commands is written as one text, with the heading as a parameter whose range is cut
into cells; the current, the disturbance force and the errors of measurement are variables with a gain. Slopes, and
their ranges, are those of the slope rule; V is that of the recorded certificate. The largest level is printed at which
V decays at the claimed rate between 0.82 times this level and the level, by vertices and trim errors that are drawn: an
estimate that may be too large, and no proof. Prints Markdown. The exit status is 2 for a bad option.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.enclosure import span
from surctl.certcheck.region_exact import inverse
from surctl.certcheck.slope_rows import Number, Rows
from surctl.certcheck.turning import triangle
from surctl.verification.formula import parse, values_of, variable

Array = NDArray[np.float64]
Pair = tuple[str, str]

RECORDED = Path(__file__).parents[2] / "tests" / "certcheck"
CLAIMS = (
    "region-turning", "region-turning-20", "region-turning-20-scale", "region-turning-20-curved",
    "region-turning-20-curved-fast", "region-turning-20-current", "region-turning-lag", "region-turning-20-lag",
    "region-cruise-20", "region-cruise-20-soft", "region-cruise-ranges", "region-cruise-20-force",
    "region-cruise-20-noise", "region-cruise-current",
)  # fmt: skip
QUICK = "region-cruise-20"
SHELL = 0.82  # ratio of the two levels between which V decays
LEVELS = (1.0, 0.97, 0.94, 0.9, 0.85, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
GROWTHS = np.geomspace(2e-3, 0.6, 22)  # 1/s
DRAWN, VERTICES, WORST = 60_000, 15_000, 500  # trim errors; vertices; those whose growth is searched
MORE = 1.03  # bound of the trim errors, relative to the largest drawn one


@dataclass
class Loop:
    """A loop as texts: rates of the states, ranges of the parameters, and pairs of disturbances with their radius.

    The states are deviations from the steady cruise in the path frame: position, velocity and, with thrust lag, thrust.
    """

    states: tuple[str, ...] = ("x", "y", "p", "q")
    rates: list[str] = field(default_factory=list)
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)
    discs: dict[Pair, float] = field(default_factory=dict)

    def factors(self, name: str, ends: Sequence[float], apart: float) -> Pair:
        """Return the factors of a parameter in surge and sway."""
        if ends[0] == ends[1]:
            return repr(ends[0]), repr(ends[0])
        self.ranges[name] = ends[0], ends[1]
        if not apart:
            return name, name
        self.ranges[f"{name}_apart"] = -apart / 2, apart / 2
        return f"({name}*(1 + {name}_apart))", f"({name}*(1 - {name}_apart))"

    def disc(self, names: Pair, radius: float) -> Pair:
        """Return a disturbance of at most this size in any direction; zeros if the size is 0."""
        if not radius:
            return "0", "0"
        self.discs[names] = radius
        self.ranges |= dict.fromkeys(names, (-radius, radius))
        return names


def cruise(claim: Mapping[str, Any], proof: Mapping[str, Any]) -> Loop:
    """Return the loop of a claim without held commands."""
    loop, law, vehicle = Loop(), claim["law"], claim["vehicle"]
    v, ahead, k1, masses, limits = law["cruise"], law["lookahead"], law["k1"], law["mass_kg"], vehicle["thrust_n"]
    drag = [loop.factors(n, vehicle["drag_factor"], vehicle["drag_asymmetry"]) for n in ("linear", "quadratic")]
    means = [f"(({one} + {two})/2 - 1)" for one, two in drag]
    factors = loop.factors("mass", vehicle["mass_factor"], vehicle["mass_asymmetry"])
    mass = [f"({m}*{f})" for m, f in zip(masses, factors, strict=True)]
    current = loop.disc(("c_x", "c_y"), vehicle["current_m_per_s"])
    force = loop.disc(("f_x", "f_y"), vehicle["force_n"])
    place = loop.disc(("e_x", "e_y"), vehicle["place_error_m"])
    speed = loop.disc(("e_p", "e_q"), vehicle["velocity_error_m_per_s"])
    # the steady command, and the position there
    moved = " + ".join(f"{slope}*{mean}" for slope, mean in zip(proof["trim"], means, strict=True))
    away = "0"
    if "flow" in proof:
        along, across = (f"({a} + {b}*{means[0]} + {c}*{means[1]})" for a, b, c in zip(*proof["flow"], strict=True))
        moved = f"{moved} - {along}*{current[0]}"
        away = f"{ahead}*{across}*{current[1]}/({v} + {moved})"
    x, y, velocity = f"(x - ({moved})/{k1})", f"(y + {away})", (f"({v} + p)", "q")
    seen = [f"({a} + {b})" for a, b in zip((x, y, *velocity), (*place, *speed), strict=True)]
    pace = f"min(max({v} - {k1}*{seen[0]}, 0), {law['cap']}/sqrt(1 + ({seen[1]}/{ahead})^2))"
    wanted, measured = in_body((pace, f"(-({pace})*{seen[1]}/{ahead})")), in_body(seen[2:])
    water = in_body([f"({a} - {b})" for a, b in zip(velocity, current, strict=True)])
    model = list(zip(masses, law["linear_drag"], law["quadratic_drag"], strict=True))
    commands, pulled = list[str](), list[str]()
    for i, (m, a, b) in enumerate(model):
        command = f"{a}*{wanted[i]} + {b}*({wanted[i]}*abs({wanted[i]}))"
        command += f" + {m * law['k_v']}*({wanted[i]} - {measured[i]})"
        commands.append(f"min(max({command}, -{limits[i]}), {limits[i]})")
        pulled.append(f"{a}*{drag[0][i]}*{water[i]} + {b}*{drag[1][i]}*({water[i]}*abs({water[i]}))")
    thrust = commands
    rate = vehicle["yaw_rate_rad_per_s"]
    if lag := vehicle["lag_s"][1]:
        loop.states += ("h", "k")
        loop.ranges["r"] = -rate, rate
        after, steady = in_body(("h", "k")), f"({v} + {moved})"
        share, turned = in_body(("1", "0")), ("(-sin(psi))", "(-cos(psi))")  # of the path, and how it changes
        trim, change = list[str](), list[str]()
        for (m, a, b), n, by_turn in zip(model, share, turned, strict=True):
            force_ahead = f"({m * law['k_v']}*({moved}) + {a}*{steady})"
            trim.append(f"({force_ahead}*{n} + {b}*{steady}^2*({n}*abs({n})))")
            change.append(f"r*({force_ahead} + {2 * b}*{steady}^2*abs({n}))*{by_turn}/{m}")
        thrust = [f"({m}*{one} + {own})" for m, one, own in zip(masses, after, trim, strict=True)]
        late = zip(masses, commands, trim, change, strict=True)
        pace_of = in_path([f"(({new} - {own})/{lag * m} - {by})" for m, new, own, by in late])
        late_rates = [f"{pace_of[0]} - h/{lag} - r*k", f"{pace_of[1]} - k/{lag} + r*h"]
    acting = zip(thrust, in_body(force), pulled, mass, strict=True)
    loop.rates = ["p", "q", *in_path([f"(({t} + {f} - ({d}))/{m})" for t, f, d, m in acting])]
    if masses[0] != masses[1] or vehicle["mass_asymmetry"]:
        loop.ranges["r"] = -rate, rate
        munk = in_path([f"(r*(1 - {mass[1]}/{mass[0]})*{water[1]})", f"(r*({mass[0]}/{mass[1]} - 1)*{water[0]})"])
        loop.rates[2:] = [f"{own} - ({term})" for own, term in zip(loop.rates[2:], munk, strict=True)]
    if bend := claim["motion"]["curvature_per_m"] * v:
        loop.ranges["bend"] = -bend, bend
        turns = (f"bend*{y}", f"-bend*{x}", f"bend*{velocity[1]}", f"-bend*{velocity[0]}")
        loop.rates = [f"{own} + {term}" for own, term in zip(loop.rates, turns, strict=True)]
    loop.rates += late_rates if lag else []
    return loop


def in_body(vector: Sequence[str]) -> Pair:
    """Return a vector of the path frame in the frame of the body."""
    x, y = vector
    return f"(cos(psi)*{x} + sin(psi)*{y})", f"(cos(psi)*{y} - sin(psi)*{x})"


def in_path(vector: Sequence[str]) -> Pair:
    """Return a vector of the body frame in the frame of the path."""
    x, y = vector
    return f"(cos(psi)*{x} - sin(psi)*{y})", f"(sin(psi)*{x} + cos(psi)*{y})"


def trim_errors(loop: Loop, box: Mapping[str, tuple[float, float]], random: np.random.Generator) -> Array:
    """Return bounds (n,) of the rates at the steady cruise without disturbances, by drawn parameters."""
    still = {name for pair in loop.discs for name in pair}
    at = dict.fromkeys((*loop.states, *still), np.zeros(DRAWN))
    for name, (low, high) in box.items():
        if name not in still:
            ends = random.choice([low, high], DRAWN)
            at[name] = np.where(random.random(DRAWN) < 0.7, ends, random.uniform(low, high, DRAWN))
    values = values_of([parse(rate, {name: variable(name) for name in at}) for rate in loop.rates], at)
    return np.asarray(MORE * np.abs(values).max(axis=1))


def drawn_vertices(rows: Rows, random: np.random.Generator) -> Array:
    """Return matrices (B, n, m) of the slopes in states and disturbances, at drawn vertices of their ranges."""
    slopes = np.array(rows.slopes, dtype=float)
    at = np.where(random.random((VERTICES, len(slopes))) < 0.5, *slopes.T)
    out = np.zeros((VERTICES, len(rows.rows), len(rows.linear)))
    for i, row in enumerate(rows.rows):
        for j, entry in enumerate(row):
            for term, number in entry.poly.items() if isinstance(entry, Number) else ():
                out[:, i, j] += float(number) * at[:, list(term)].prod(axis=1)
    return out


def weighed(parts: Sequence[Array]) -> Array:
    """Return a bound of (Σ w)(Σ w)ᵀ (B, n, n) for parts w, of which w wᵀ (B, n, n) are given."""
    sizes = [float(np.sqrt(np.median(np.trace(part, axis1=1, axis2=2)))) for part in parts]
    return np.asarray(sum(sum(sizes) / size * part for size, part in zip(sizes, parts, strict=True) if size))


def largest(document: Mapping[str, Any], cells: int, cell: int) -> tuple[float, int, float]:
    """Return the largest level in one cell of headings, the number of slopes there, and the time for them [s]."""
    claim, proof, random = document["claim"], document["proof"], np.random.default_rng(cell)
    loop, rate = cruise(claim, proof), claim["motion"]["rate_per_s"]
    n, p = len(loop.states), triangle(proof["P"], len(loop.states), "P")
    cover, exact = inverse(p), np.array(p, dtype=float)
    change = np.linalg.inv(np.linalg.cholesky(exact))
    box = {"psi": (np.pi / 2 * cell / cells, np.pi / 2 * (cell + 1) / cells), **loop.ranges}
    errors = trim_errors(loop, box, random)
    corners = np.array(list(product(*((e, -e) if e > 1e-12 else (0.0,) for e in errors)))) @ exact @ change.T
    free = [name for pair in loop.discs for name in pair]
    count, seconds = 0, 0.0
    for level in LEVELS:
        ends = [np.sqrt(float(cover[k][k]) * level) * 1.001 for k in range(n)]
        whole = [span(-float(end), float(end)) for end in ends] + [span(*map(float, pair)) for pair in box.values()]
        began = time.process_time()
        names = [*loop.states, *box]
        rows = Rows(names, whole, loop.rates, [cover], [Fraction(0)] * n, Fraction(level), free)
        count, seconds = len(rows.slopes), time.process_time() - began
        moved = change @ exact @ drawn_vertices(rows, random)
        half, order = moved[:, :, :n] @ change.T, [names[place] for place in rows.linear]
        losses = -(half + half.swapaxes(1, 2))
        discs = []
        for pair, radius in loop.discs.items():
            side = radius * moved[:, :, [order.index(name) for name in pair]]
            discs.append(side @ side.swapaxes(1, 2))
        rough = sum(discs, np.zeros_like(losses)) / (0.05 * level)
        few = np.unique([np.argsort(np.linalg.eigvalsh(one)[:, 0])[:WORST] for one in (losses, losses - rough)])
        pushes = [
            weighed([np.broadcast_to(np.outer(corner, corner), (len(few), n, n)), *(one[few] for one in discs)])
            for corner in corners
        ]
        for growth in GROWTHS:
            left = losses[few] - (rate + growth) * np.eye(n)
            if all(np.linalg.eigvalsh(left - push / (growth * SHELL * level)).min() > 0 for push in pushes):
                return level, count, seconds
    return 0.0, count, seconds


def main(words: list[str] | None = None) -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one claim and one cell")
    parser.add_argument("--cells", type=int, nargs="+", default=[48, 96], help="cells of a quarter turn")
    given = parser.parse_args(words)
    counts, names = ([48], (QUICK,)) if given.quick else (given.cells, CLAIMS)
    heads = "".join(f" {count} cells |" for count in counts)
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
