"""Study 46: does the slope rule of the checker accept a decrease that is false?

    python analysis/46_slope_rule/run.py [--quick] [--claims N] [--sampled N] [--seed N]

Prints Markdown. The exit status is 1 if a false claim is accepted, or too few true ones, and 2 for a bad option.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

sys.path.insert(0, str(Path(__file__).parent))
import sampled

from surctl.certcheck import Rejected
from surctl.certcheck.region_exact import inverse
from surctl.certcheck.slopes import Decrease, check_decrease, quadratic_form, require_in_box
from surctl.verification.formula import parse, values_of, variable

Array = NDArray[np.float64]

TERMS = (
    "{a}*sin({z})", "{a}*{z}*abs({z})", "max(-{b}, min({b}, {z}))", "{a}*tanh({z})", "{a}*{z}^3", "{a}*{z}*{y}",
    "{a}*{z}*cos({y})", "{a}*{z}/(1 + {y}^2)", "{a}*{z}*p", "{a}*{z}*p^2", "min({z}, {b}*p + {y})", "{a}*{z}*exp({y})",
    "{a}*(sqrt(1 + {z}^2) - 1)", "{a}*{z}/p", "{a}*atan({z})", "max({z}, -{b}/p)", "{a}*({z} + {y})^2",
    "{a}*p*{y}*sin({z})", "{a}*abs({z} - {b}) - {a}*{b}", "{a}*sin(p)*{z}", "{a}*atan2({z}, 2 + cos({y}))",
    "p*max(-{b}, min({b}, 2*{z} - {y}))",
    "{a}*p*{z}*abs({z})", "{a}*{y}*{z}*abs({z})",
)  # fmt: skip
KINDS = ("level", "level by 0.1 %", "shape", "rate", "range")
SAMPLES, RATE, EDGE = 60_000, 0.05, 3.0
MOST_FALSE = 1e-9  # of the change of V: a larger excess at a sample makes a claim false


@dataclass(frozen=True)
class Claim:
    """A claimed decrease of x' P x on a level set of drawn dynamics, with the range of the parameter p."""

    rates: tuple[str, ...]
    p: Array
    level: float
    rate: float
    ends: tuple[float, float]
    discrete: bool

    @property
    def names(self) -> list[str]:
        """The states, then the parameter."""
        return [*(f"x{k}" for k in range(len(self.p))), "p"]

    def accepted(self) -> bool:
        """Return whether the checker accepts the claim."""
        n, box = len(self.p), [(-EDGE, EDGE)] * len(self.p)
        text = " + ".join(f"({float(self.p[i, j])!r})*x{i}*x{j}" for i in range(n) for j in range(n))
        level, centre = Fraction(repr(self.level)), [Fraction(0)] * n
        try:
            p = quadratic_form(self.names[:n], text, centre)
            require_in_box(inverse(p), centre, level, box)
            needed = Decrease(p, centre, level, Fraction(repr(self.rate)), {})
            check_decrease(self.names, [*box, self.ends], self.rates, needed, discrete=self.discrete)
        except Rejected:
            return False
        return True

    def samples(self, seed: int, count: int) -> tuple[Array, Array]:
        """Return V and the excess of its change over −rate V, relative to the change, at samples of the box (N,)."""
        random, n = np.random.default_rng(seed), len(self.p)
        x = random.normal(size=(n, count))
        v = np.einsum("in,ij,jn->n", x, self.p, x)
        x *= np.sqrt(self.top() * 1.2 / v) * np.sqrt(random.random(count))
        x = x[:, np.all(np.abs(x) <= EDGE, axis=0)]
        p = random.choice(self.ends, x.shape[1])
        p = np.where(random.random(x.shape[1]) < 0.3, random.uniform(*self.ends, x.shape[1]), p)
        at = dict(zip(self.names, (*x, p), strict=True))
        f = values_of([parse(text, {name: variable(name) for name in at}) for text in self.rates], at)
        v = np.einsum("in,ij,jn->n", x, self.p, x)
        after = np.einsum("in,ij,jn->n", f if self.discrete else 2 * x, self.p, f)
        change = after - v if self.discrete else after
        return v, (change + self.rate * v) / (np.abs(change) + v)

    def top(self) -> float:
        """Return the largest level whose region lies in the box."""
        return float(EDGE**2 / np.diag(np.linalg.inv(self.p)).max()) * (1 - 1e-9)


def drawn(seed: int) -> Claim:
    """Return drawn dynamics that are stable at 0, with V of their linear part; the level is the largest in the box."""
    random = np.random.default_rng(seed)
    n, discrete = int(random.integers(1, 4)), bool(random.random() < 0.3)
    names = [f"x{k}" for k in range(n)]
    a = random.normal(size=(n, n))
    if discrete:
        a *= random.uniform(0.3, 0.9) / np.abs(np.linalg.eigvals(a)).max()
    else:
        a -= (np.linalg.eigvals(a).real.max() + random.uniform(0.3, 1.5)) * np.eye(n)
    rates = []
    for row in a:
        text = " + ".join(f"({x:.3g})*{name}" for x, name in zip(row, names, strict=True))
        for _ in range(int(random.integers(0, 3))):
            mixed = f"({random.normal():.2g}*{random.choice(names)} + {random.normal():.2g}*{random.choice(names)})"
            z = mixed if random.random() < 0.5 else random.choice(names)
            factor = f"({(0.1 if discrete else 0.4) * random.normal():.2g})"
            term = str(random.choice(TERMS)) if not discrete else f"{factor}*({random.choice(TERMS)})"
            text += " + " + term.format(a=factor, b=f"{random.uniform(0.2, 2):.2g}", z=z, y=random.choice(names))
        rates.append(text)
    one = np.eye(n)
    p = solve_discrete_lyapunov(a.T, one) if discrete else solve_continuous_lyapunov(a.T, -one)
    p = np.array([[float(f"{x:.5g}") for x in row] for row in (p + p.T) / 2])
    claim = Claim(tuple(rates), p, 1.0, RATE, (0.8, 1.25), discrete)
    return replace(claim, level=float(f"{claim.top():.6g}") * 0.999)


def largest(claim: Claim) -> float:
    """Return the largest of a few levels that the checker accepts; 0 if it accepts none."""
    return next((level for share in (1.0, 0.7, 0.4, 0.2, 0.08, 0.03, 0.01)
                 if replace(claim, level=(level := float(f"{share * claim.level:.6g}"))).accepted()), 0.0)  # fmt: skip


def near_misses(claim: Claim, false: float, seed: int) -> Iterator[tuple[str, Claim]]:
    """Yield claims that may be false by little; `false` is a level with a counterexample."""
    random = np.random.default_rng(seed)
    yield KINDS[0], replace(claim, level=float(f"{1.1 * false:.6g}"))
    yield KINDS[1], replace(claim, level=float(f"{1.001 * false:.6g}"))
    noise, size = random.uniform(-0.15, 0.15, claim.p.shape), np.sqrt(np.diag(claim.p))
    skewed = claim.p + np.outer(size, size) * (noise + noise.T)
    if np.linalg.eigvalsh(skewed)[0] > 0:
        yield KINDS[2], replace(claim, p=skewed.round(6), level=float(f"{0.99 * false:.6g}"))
    yield KINDS[3], replace(claim, rate=1.3 * RATE, level=float(f"{0.99 * false:.6g}"))
    yield KINDS[4], replace(claim, ends=(0.8, 1.5), level=float(f"{0.99 * false:.6g}"))


def main(words: list[str] | None = None) -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="8 false claims of each sort, fewer samples")
    parser.add_argument("--claims", type=int, default=5000, help="number of false claims")
    parser.add_argument("--sampled", type=int, default=2000, help="number of false claims about sampled loops")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first dynamics")
    given = parser.parse_args(words)
    count, samples = (8, 6000) if given.quick else (given.claims, SAMPLES)
    held, periods = (8, 500) if given.quick else (given.sampled, 3000)
    tried, passed = dict.fromkeys(KINDS, 0), dict.fromkeys(KINDS, 0)
    systems, proved, wrong, shares = 0, 0, list[str](), list[float]()
    for seed in itertools.count(given.seed):
        if sum(tried.values()) >= count:
            break
        claim = drawn(seed)
        v, excess = claim.samples(seed, samples)
        false = float(v[excess > MOST_FALSE].min(initial=np.inf))
        systems += 1
        level = largest(claim)
        if level:
            proved += 1
            shares.append(level / min(false, claim.level))
            if level > false:
                wrong.append(f"seed {seed}, level {level}: {claim}")
        if not false < claim.level / 1.1:
            continue  # the region is limited by the box
        for kind, one in near_misses(claim, false, seed):
            v, excess = one.samples(seed + 1, samples)
            if not np.any(excess[v <= one.level] > MOST_FALSE):
                continue  # no counterexample is known
            tried[kind] += 1
            if one.accepted():
                passed[kind] += 1
                wrong.append(f"seed {seed}, {kind}: {one}")
    share = np.median(shares or [0.0])
    print(f"{systems} drawn systems: the largest of 7 levels is proved for {proved}; {len(wrong)} claims are wrong at "
          f"one of {samples} samples. Median of the proved level, relative to the least false one or the largest "
          f"in the box: {share:.2f}.\n\n| false by | claims | accepted |\n|---|---|---|")  # fmt: skip
    print("\n".join(f"| {kind} | {tried[kind]} | {passed[kind]} |" for kind in KINDS))
    print(f"| all | {sum(tried.values())} | {sum(passed.values())} |")
    kinds, (loops, regions), others = sampled.run(held, periods, given.seed)
    print(f"\n{loops} drawn sampled loops: a region is proved for {regions}; {len(others)} claims are wrong.\n\n"
          "| false by | claims | accepted |\n|---|---|---|")  # fmt: skip
    print("\n".join(f"| {kind} | {tries} | {passes} |" for kind, (tries, passes) in kinds.items()))
    print("\n".join(f"\nfalse: {text}" for text in (*wrong, *others)), file=sys.stderr)
    return int(bool(wrong or others) or 2 * proved < systems or 2 * regions < loops)


if __name__ == "__main__":
    sys.exit(main())
