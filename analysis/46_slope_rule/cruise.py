"""Study 46, second part: would the slope rule prove the regions of a cruise, which have a rule of their own?

    python analysis/46_slope_rule/cruise.py [--quick] [--cells N] [--claim NAME…]

The loop of each claim is written as one text, with the heading as a parameter whose range, a
quarter turn, is cut into cells; the current, the disturbance force and the errors of measurement are parameters too. V,
its levels and the coefficients of the steady command are those of the recorded certificate. The slope rule on many
boxes at once (`cells.py`) decides whether V decays in all cells between the recorded floor and a level. Prints the
largest level in Markdown. The exit status is 1 if the claim of the quick form is not proved, 2 for a bad option.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from cells import Cells, Decrease, Form, held
from numpy.typing import NDArray

from surctl.certcheck.region_exact import inverse, largest_eigenvalue, root_up
from surctl.certcheck.turning import triangle
from surctl.certcheck.turning_claim import axis_pairs, read_claim
from surctl.certcheck.turning_terms import coupled_mass, coupling_of, other_forces

Array = NDArray[np.float64]
Pair = tuple[str, str]

RECORDED = Path(__file__).parents[2] / "tests" / "certcheck"
CLAIMS = (
    "region-turning", "region-turning-20", "region-turning-20-rest", "region-turning-20-scale",
    "region-turning-20-curved", "region-turning-20-curved-fast", "region-turning-20-current", "region-turning-lag",
    "region-turning-20-lag", "region-turning-20-rexrov", "region-cruise-20", "region-cruise-20-soft",
    "region-cruise-ranges", "region-cruise-20-force", "region-cruise-20-noise", "region-cruise-current",
    "region-cruise-20-sampled", "region-turning-20-sampled",
)  # fmt: skip
QUICK = "region-cruise-20"
LEVELS = (1.0, 0.97, 0.94, 0.9, 0.85, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
LEAST = 0.97  # largest ratio of the levels of the outermost shell
LOWEST = 0.4  # a decay down to this share of the level counts
PULL = 5.0  # 1/s
WIDER = 1 + 1e-12
FACTORS = (1.0, 0.8, 1.25, 0.6, 1.6, 0.45, 2.2)  # of the recorded growths


@dataclass
class Loop:
    """A loop as texts: rates of the states, ranges of the parameters, and pairs of disturbances with their radius.

    The states are deviations from the steady cruise in the path frame: position, velocity and, with thrust lag, thrust;
    with held commands, then position and velocity at the last sampling instant.
    """

    states: tuple[str, ...] = ("x", "y", "p", "q")
    rates: list[str] = field(default_factory=list)
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)
    polytopes: dict[Pair, Array] = field(default_factory=dict)

    def factors(self, name: str, ends: Sequence[float], apart: float) -> Pair:
        """Return the factors of a parameter in surge and sway."""
        if ends[0] == ends[1]:
            return repr(ends[0]), repr(ends[0])
        if not apart:
            self.ranges[name] = ends[0], ends[1]
            return name, name
        pair = f"{name}_1", f"{name}_2"
        self.ranges |= dict.fromkeys(pair, (ends[0], ends[1]))
        self.polytopes[pair] = np.array(axis_pairs((ends[0], ends[1]), apart))
        return pair

    def disc(self, names: Pair, radius: float) -> Pair:
        """Return a disturbance of at most this size in any direction; zeros if the size is 0."""
        if not radius:
            return "0", "0"
        turns = np.arange(8) * np.pi / 4
        self.polytopes[names] = radius / np.cos(np.pi / 8) * (1 + 1e-12) * np.array([np.cos(turns), np.sin(turns)]).T
        self.ranges |= dict.fromkeys(names, (-radius, radius))
        return names


def cruise(claim: Mapping[str, Any], proof: Mapping[str, Any]) -> Loop:
    """Return the loop of a claim that does not have both held commands and thrust lag."""
    loop, law, vehicle = Loop(), claim["law"], claim["vehicle"]
    turn, rotated, slow = vehicle["yaw_rate_rad_per_s"] * law["period_s"], unturned, ""
    if turn:
        # psi is the heading at the sampling instant; t and co are tangent and cosine of the turn since the instant.
        # What is turned also has a factor co: in the drag, and in 1/mass, whose range is wider by that
        loop.ranges |= {"t": (-np.tan(turn) * WIDER, np.tan(turn) * WIDER), "co": (np.cos(turn) / WIDER, 1.0)}
        rotated, slow = turned_by_t, "co*"
        vehicle = dict(
            vehicle, mass_factor=[vehicle["mass_factor"][0], vehicle["mass_factor"][1] / np.cos(turn) * WIDER]
        )
    v, ahead, k1, masses, limits = law["cruise"], law["lookahead"], law["k1"], law["mass_kg"], vehicle["thrust_n"]
    drag = [loop.factors(n, vehicle["drag_factor"], vehicle["drag_asymmetry"]) for n in ("linear", "quadratic")]
    means = [f"(({one} + {two})/2 - 1)" for one, two in drag]
    terms = terms_of(claim, proof)
    lightest = vehicle["mass_factor"][0] * terms.remaining
    factors = loop.factors("mass", (lightest, vehicle["mass_factor"][1]), vehicle["mass_asymmetry"])
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
        steady = f"({v} + {moved})"
        away = f"({ahead}*{across}*{current[1]}/{steady})"

    def placed(x: str, y: str, p: str, q: str) -> tuple[str, str, Pair]:
        return f"({x} - ({moved})/{k1})", f"({y} + {away})", (f"({v} + {p})", q)

    sampled = ("x0", "y0", "p0", "q0") if law["period_s"] else loop.states
    x, y, velocity = placed(*loop.states)
    x_seen, y_seen, velocity_seen = placed(*sampled)
    seen = [f"({a} + {b})" for a, b in zip((x_seen, y_seen, *velocity_seen), (*place, *speed), strict=True)]
    pace = f"min(max({v} - {k1}*{seen[0]}, 0), {law['cap']}/sqrt(1 + ({seen[1]}/{ahead})^2))"
    sideways = f"(-({pace})*({seen[1]} - {away})/{ahead})"
    if current[1] != "0":  # the steady command across the path is −across c_y, in which the speed cancels
        sideways = f"({sideways} - {across}*{current[1]}*(1 + (({pace}) - {steady})/{steady}))"
    wanted, measured = in_body((pace, sideways)), in_body(seen[2:])
    water = rotated(in_body([f"({a} - {b})" for a, b in zip(velocity, current, strict=True)]), "-")
    model = list(zip(masses, law["linear_drag"], law["quadratic_drag"], strict=True))
    commands, pulled = list[str](), list[str]()
    for i, (m, a, b) in enumerate(model):
        command = f"{a}*{wanted[i]} + {b}*({wanted[i]}*abs({wanted[i]}))"
        command += f" + {m * law['k_v']}*({wanted[i]} - {measured[i]})"
        commands.append(f"min(max({command}, -{limits[i]}), {limits[i]})")
        linear, quadratic = f"{a}*({slow}{drag[0][i]})", f"{b}*({slow}{slow}{drag[1][i]})"
        pulled.append(f"{linear}*{water[i]} + {quadratic}*({water[i]}*abs({water[i]}))")
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
            trim.append(f"({force_ahead}*{n} + {b}*({steady}*{steady})*({n}*abs({n})))")
            change.append(f"r*({force_ahead} + {2 * b}*({steady}*{steady})*abs({n}))*{by_turn}/{m}")
        thrust = [f"({m}*{one} + {own})" for m, one, own in zip(masses, after, trim, strict=True)]
        late = zip(masses, commands, trim, change, strict=True)
        pace_of = in_path([f"(({new} - {own})/{lag * m} - {by})" for m, new, own, by in late])
        late_rates = [f"{pace_of[0]} - h/{lag} - r*k", f"{pace_of[1]} - k/{lag} + r*h"]
    others = [
        loop.factors(name, (-bound, bound), 0.0)[0] for name, bound in zip(("d_1", "d_2"), terms.forces, strict=True)
    ]
    acting = zip(thrust, in_body(force), others, pulled, strict=True)
    forces = [f"({t} + {f} + {other} - ({d}))" for t, f, other, d in acting]
    pushed = [f"({one}/{m})" for one, m in zip(forces, mass, strict=True)]
    if terms.cross:
        loop.ranges["cross"] = -terms.cross, terms.cross
        pushed = [f"({own} + cross*{other})" for own, other in zip(pushed, forces[::-1], strict=True)]
    loop.rates = ["p", "q", *in_path(rotated(pushed))]
    if masses[0] != masses[1] or vehicle["mass_asymmetry"]:
        loop.ranges["r"] = -rate, rate
        apart, (least, most) = vehicle["mass_asymmetry"], vehicle["mass_factor"]
        largest = min((2 + apart) / (2 - apart), most / least) * WIDER
        first, second = masses[1] / masses[0], masses[0] / masses[1]
        if terms.cross:
            grown = largest * terms.growth
            loop.ranges |= {"by_2": (1 - first * grown, 1 - first / largest), "own": (-terms.turned, terms.turned)}
            loop.ranges["by_1"] = second / largest - 1, second * grown - 1
            by_turn = f"(r*by_2*{water[1]} + own*{water[0]})", f"(r*by_1*{water[0]} - own*{water[1]})"
        else:
            ratio = loop.factors("ratio", (1 / largest, largest) if apart else (1.0, 1.0), 0.0)[0]
            by_turn = f"(r*(1 - {first!r}*{ratio})*{water[1]})", f"(r*({second!r}/{ratio} - 1)*{water[0]})"
        munk = in_path(rotated(by_turn))
        loop.rates[2:] = [f"{own} - ({term})" for own, term in zip(loop.rates[2:], munk, strict=True)]
    if bend := claim["motion"]["curvature_per_m"] * v:
        loop.ranges["bend"] = -bend, bend
        turns = (f"bend*{y}", f"-bend*{x}", f"bend*{velocity[1]}", f"-bend*{velocity[0]}")
        loop.rates = [f"{own} + {term}" for own, term in zip(loop.rates, turns, strict=True)]
    loop.rates += late_rates if lag else []
    if law["period_s"]:
        loop.states += sampled
        loop.rates += ["0"] * 4
    return loop


@dataclass(frozen=True)
class Terms:
    """What an inertia with m12, and the vehicle's terms beside equation (3) of the paper, add to the loop.

    With c = m12 and ρ² = c²/(m11 m22), M⁻¹ has the diagonal 1/(m (1 − ρ²)), and −c/(m11 m22 (1 − ρ²)) beside it. In a
    turn at the rate r, r M⁻¹ S M − r S has −c (m11 + m22)/(m11 m22 (1 − ρ²)) on its diagonal, and beside it
    1 − (m22² + c²)/(m11 m22 (1 − ρ²)) and (m11² + c²)/(m11 m22 (1 − ρ²)) − 1.

    Attributes:
        remaining: least 1 − ρ².
        cross: largest entry of M⁻¹ beside its diagonal [1/kg].
        turned: largest entry on the diagonal in a turn [1/s].
        growth: largest (1 + c²/m²)/(1 − ρ²).
        forces: largest further forces on both axes of the body [N].
    """

    remaining: float = 1.0
    cross: float = 0.0
    turned: float = 0.0
    growth: float = 1.0
    forces: tuple[float, float] = (0.0, 0.0)


def terms_of(claim: Mapping[str, Any], proof: Mapping[str, Any]) -> Terms:
    """Return what the terms of a claim add; all of it is rounded to the safe side."""
    if not claim["vehicle"]["terms"]:
        return Terms()
    stated, covariance = read_claim(claim), inverse(triangle(proof["P"], 4, "P"))
    fastest = stated.cruise + stated.current + root_up(largest_eigenvalue([row[2:4] for row in covariance[2:4]]))
    c, coupling = coupled_mass(stated), coupling_of(stated)
    least = [stated.mass_factor[0] * mass for mass in stated.mass]
    turned = stated.yaw_rate * c * sum(1 / mass for mass in least) / coupling.remaining
    growth = (1 + (c / min(least)) ** 2) / coupling.remaining
    first, second = (float(bound) * WIDER for bound in other_forces(stated, fastest))
    more = [float(number) * WIDER for number in (coupling.cross, turned, growth)]
    return Terms(float(coupling.remaining) / WIDER, *more, (first, second))


def unturned(vector: Sequence[str], sign: str = "+") -> Pair:
    """Return a vector."""
    return vector[0], vector[1]


def turned_by_t(vector: Sequence[str], sign: str = "+") -> Pair:
    """Return a vector that is turned by the angle with the tangent t, or backward (−), divided by its cosine."""
    x, y = vector
    other = "-" if sign == "+" else "+"
    return f"({x} {other} t*{y})", f"({y} {sign} t*{x})"


def in_body(vector: Sequence[str]) -> Pair:
    """Return a vector of the path frame in the frame of the body."""
    x, y = vector
    return f"(cos(psi)*{x} + sin(psi)*{y})", f"(cos(psi)*{y} - sin(psi)*{x})"


def in_path(vector: Sequence[str]) -> Pair:
    """Return a vector of the body frame in the frame of the path."""
    x, y = vector
    return f"(cos(psi)*{x} - sin(psi)*{y})", f"(sin(psi)*{x} + cos(psi)*{y})"


def check(document: Mapping[str, Any], cells: int, level: float) -> tuple[float, int]:
    """Return the level down to which V is shown to decay from a level in all cells, and the corners of a matrix."""
    claim, proof = document["claim"], document["proof"]
    loop, rate = cruise(claim, proof), claim["motion"]["rate_per_s"]
    p = np.array(triangle(proof["P"], 6 if claim["vehicle"]["lag_s"][1] else 4, "P"), dtype=float)
    shells, low = list[tuple[float, float, float]](), proof["floor"]
    for shell in proof["shells"]:
        if low < LEAST * level:
            shells.append((low, min(shell["level"], level), shell["growth"]))
        low = shell["level"]
    count = len(shells)
    edges = np.linspace(0, np.pi / 2, cells + 1)
    box = [(np.repeat(edges[:-1], count), np.repeat(edges[1:], count))]
    box += [(np.full(cells * count, low), np.full(cells * count, high)) for low, high in loop.ranges.values()]
    names, levels = [*loop.states, "psi", *loop.ranges], np.tile([high for _, high, _ in shells], cells)
    same = np.repeat(np.arange(cells), count)
    n, period = len(p), claim["law"]["period_s"]
    forms, scale, groups = [Form(p, np.zeros_like(p))], p, [n]
    if period:
        scale, groups = np.zeros((n + 4, n + 4)), [n, 4]
        scale[:n, :n], scale[n:, n:] = p, p[:4, :4]
        forms = held(p, 4, period, PULL)
    rows = Cells(names, loop.rates, np.linalg.inv(scale), levels, box, loop.polytopes, same, groups)
    decrease, boxes = Decrease(rows, forms, scale), np.arange(cells) * count
    for k, (low, high, growth) in reversed(list(enumerate(shells))):
        if decrease.growth(boxes + k, rate, low, [growth * factor for factor in FACTORS]) is None:
            return high, decrease.corners
    return proof["floor"], decrease.corners


def main(words: list[str] | None = None) -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one claim")
    parser.add_argument("--cells", type=int, default=48, help="cells of a quarter turn")
    parser.add_argument("--claim", choices=CLAIMS, nargs="+", default=CLAIMS)
    given = parser.parse_args(words)
    print("| claim | recorded | proved | settles | proved | corners | time |\n|---|---|---|---|---|---|---|")
    for name in [QUICK] if given.quick else given.claim:
        document = json.loads((RECORDED / f"{name}.json").read_text())
        offset, floor = document["claim"]["motion"]["offset_m"], document["proof"]["floor"]
        for level in (one for one in LEVELS if LEAST * one > floor):
            began = time.process_time()
            low, corners = check(document, given.cells, level)
            seconds = time.process_time() - began
            if low <= max(floor, LOWEST * level):
                break
        else:
            level, low = 0.0, np.nan
        beside = document["claim"]["motion"]["ultimate_bound_m"][1]
        proved = (
            f"{level**0.5 * offset:.3f} m ({level**0.5:.0%}) | {beside:.3f} m | {beside * (low / floor) ** 0.5:.3f} m"
        )
        if not level:
            proved = f"0.000 m (0%) | {beside:.3f} m | –"
        print(f"| `{name}` | {offset:.3f} m | {proved} | {corners} | {seconds:.1f} s |", flush=True)
    return int(given.quick and level < 1)


if __name__ == "__main__":
    sys.exit(main())
