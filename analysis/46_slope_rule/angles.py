"""Study 46, third part: does the slope rule on many boxes (`cells.py`) accept a decrease that is false?

    python analysis/46_slope_rule/angles.py [--quick] [--systems N] [--seed N]

Dynamics of 1 to 3 states are drawn, with an angle and a parameter, both in cells, and with a pair of parameters in a
polytope; their values at x = 0 need not vanish. The largest level below which the rule shows the decrease of V is
compared with the least level at which a search finds a state where V does not decrease. Prints Markdown. The exit
status is 1 if a decrease is shown that a state contradicts, or if too few are shown, and 2 for a bad option.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from cells import Cells, Decrease, Form
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_lyapunov

from surctl.certcheck import Rejected
from surctl.verification.formula import parse, values_of, variable

Array = NDArray[np.float64]

TERMS = (
    "{a}*{c}*{z}", "{a}*{c}*{s}*{z}", "{a}*{c}*({c}*{z} + {s}*{y})*abs({c}*{z} + {s}*{y})", "{a}*p*{c}^2*{z}",
    "{a}*{s}*max(-{b}, min({b}, {c}*{z} - {s}*{y}))", "{a}*(p - u)*{s}*({c}*{z} + {s}*{y})", "{a}*{z}*{y}",
    "{a}*{c}*min({z}, {b} + 0.3*{y}^2)", "{a}*p*p*{z}", "{a}*{z}/p", "{a}*{s}*tanh({z} + {b}*{c})*p",
    "{a}*u*{z}*abs({z})", "{a}*abs({c}*{b} + {z}) - {a}*abs({c}*{b})", "{a}*{c}*{z}*(u + w)", "{a}*sin({z})*{s}",
    "{a}*({c}*{z} + {b})*abs({c}*{z} + {b}) - {a}*{b}*{b}",
)  # fmt: skip
TRIM = ("{a}*{c}", "{a}*{s}*(p - 1)", "{a}*{c}^2*(u - w)", "{a}*{s}^3*p", "{a}*{c}*{s}*p*p*u", "{a}*(u*w - 1)")
P_ENDS, PAIR = (0.85, 1.2), np.array([[0.9, 0.9], [0.9, 1.0], [1.0, 0.9], [1.1, 1.1], [1.1, 1.0], [1.0, 1.1]])
RATE, LOWEST, SHELLS = 0.05, 0.2, 3
GROWTHS = tuple(np.geomspace(2.0, 0.02, 9))
SAMPLES, STEPS, KEPT = 40_000, 12, 400


@dataclass(frozen=True)
class System:
    """Drawn dynamics with P of V = xᵀ P x, and the range of the angle."""

    rates: tuple[str, ...]
    p: Array
    angle: tuple[float, float]
    cells: int

    @property
    def names(self) -> list[str]:
        """The states, then the parameters."""
        return [*(f"x{k}" for k in range(len(self.p))), "psi", "p", "u", "w"]

    def shown(self, level: float) -> bool:
        """Return whether the rule shows V' < −rate V between the lowest share of a level and the level."""
        levels = level * np.geomspace(LOWEST, 1.0, SHELLS + 1)
        edges = np.linspace(*self.angle, self.cells + 1)
        halves = ((P_ENDS[0], 1.0), (1.0, P_ENDS[1]))
        each = [(one, two) for one in pairwise(edges) for two in halves]
        count = len(each) * SHELLS
        ends = np.repeat(np.array(each), SHELLS, axis=0)
        box = [(ends[:, k, 0], ends[:, k, 1]) for k in (0, 1)] + [(np.full(count, 0.9), np.full(count, 1.1))] * 2
        same = np.repeat(np.arange(len(each)), SHELLS)
        inverse, high = np.linalg.inv(self.p), np.tile(levels[1:], len(each))
        try:
            rows = Cells(self.names, self.rates, inverse, high, box, {("u", "w"): PAIR}, same)
            decrease = Decrease(rows, [Form(self.p, np.zeros_like(self.p))], self.p)
        except Rejected:
            return False
        boxes = np.arange(len(each)) * SHELLS
        return all(decrease.growth(boxes + k, RATE, levels[k], GROWTHS) is not None for k in reversed(range(SHELLS)))

    def excess(self, x: Array, parameters: Array) -> tuple[Array, Array]:
        """Return V and (V' + rate V)/V (N,) at states (n, N) and parameters (4, N)."""
        at = dict(zip(self.names, (*x, *parameters), strict=True))
        f = values_of([parse(text, {name: variable(name) for name in at}) for text in self.rates], at)
        v = np.einsum("in,ij,jn->n", x, self.p, x)
        return v, (2 * np.einsum("in,ij,jn->n", f, self.p, x) + RATE * v) / v

    def contradicted(self, level: float, seed: int) -> bool:
        """Return whether a search finds a state with V between the shares of the level where V does not decrease."""
        random, n = np.random.default_rng(seed), len(self.p)
        change = np.linalg.inv(np.linalg.cholesky(self.p)).T
        y = random.normal(size=(n, SAMPLES))
        y *= np.sqrt(level * random.uniform(LOWEST, 1, SAMPLES)) / np.linalg.norm(y, axis=0)
        weights = random.dirichlet(np.full(len(PAIR), 0.3), SAMPLES)
        low = np.array([self.angle[0], P_ENDS[0], 0.0, 0.0])
        high = np.array([self.angle[1], P_ENDS[1], 0.0, 0.0])
        for step in range(STEPS):
            share = random.random((2, y.shape[1]))
            if step == 0:
                inner = low[:2, None] + (high - low)[:2, None] * np.clip(1.4 * share - 0.2, 0, 1)
            parameters = np.vstack([inner, (weights @ PAIR).T])
            v, excess = self.excess(change @ y, parameters)
            inside = (v >= LOWEST * level) & (v <= level)
            if np.any(excess[inside] >= 0):
                return True
            best = np.argsort(np.where(inside, -excess, np.inf))[:KEPT]
            best = np.repeat(best, 20)
            scale = 0.5 ** (step + 1)
            y = y[:, best] * (1 + scale * random.normal(size=(1, len(best)))) + scale * np.sqrt(level) * random.normal(
                size=(n, len(best))
            )
            size = np.linalg.norm(y, axis=0)
            y *= np.clip(size, np.sqrt(LOWEST * level), np.sqrt(level)) / size * (1 - 1e-12)
            inner = np.clip(
                inner[:, best] + scale * (high - low)[:2, None] * random.normal(size=(2, len(best))),
                low[:2, None],
                high[:2, None],
            )
            weights = weights[best]
        return False


def drawn(seed: int) -> System:
    """Return drawn dynamics that are stable, with V of their mean linear part."""
    random = np.random.default_rng(seed)
    n = int(random.integers(1, 4))
    names = [f"x{k}" for k in range(n)]
    a = random.normal(size=(n, n))
    a -= (np.linalg.eigvals(a).real.max() + random.uniform(0.5, 1.5)) * np.eye(n)
    sides = [("cos(psi)", "sin(psi)"), ("sin(psi)", "cos(psi)")]
    rates = []
    for row in a:
        text = " + ".join(f"({x:.3g})*{name}" for x, name in zip(row, names, strict=True))
        for terms, size in ((TERMS, 0.25), (TERMS, 0.25), (TRIM, 0.02)):
            c, s = sides[int(random.integers(2))]
            text += " + " + str(random.choice(terms)).format(
                a=f"({size * random.normal():.3g})", b=f"{random.uniform(0.2, 2):.2g}", c=c, s=s,
                z=random.choice(names), y=random.choice(names),
            )  # fmt: skip
        rates.append(text)
    p = solve_continuous_lyapunov(a.T, -np.eye(n))
    first, width = random.uniform(-4, 4), random.choice([0.1, 1.0, 2 * np.pi])
    return System(tuple(rates), (p + p.T) / 2, (first, first + width), int(np.ceil(width / 0.2)))


def largest(system: System, levels: Array) -> float:
    """Return the largest of some levels that the rule shows; 0 for none."""
    return float(next((level for level in levels[::-1] if system.shown(level)), 0.0))


def main(words: list[str] | None = None) -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few systems")
    parser.add_argument("--systems", type=int, default=100, help="number of drawn systems")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(words)
    count = 5 if given.quick else given.systems
    levels, shown, wrong, shares = np.geomspace(1e-3, 100.0, 26), 0, 0, list[float]()
    for k in range(count):
        system = drawn(given.seed + k)
        level = largest(system, levels)
        shown += level > 0
        if level and system.contradicted(level, k):
            wrong += 1
            print(f"wrong: {system} at level {level:g}", file=sys.stderr)
        above = next((one for one in levels if one > level and system.contradicted(one, k)), np.inf)
        if level and np.isfinite(above):
            shares.append((level / above) ** 0.5)
    print("| systems | with a decrease | contradicted | median share of the extent |\n|---|---|---|---|")
    print(f"| {count} | {shown} | {wrong} | {np.median(shares or [0.0]):.0%} |")
    return int(wrong > 0 or 2 * shown < count)


if __name__ == "__main__":
    sys.exit(main())
