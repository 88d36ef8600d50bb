"""False claims about drawn sampled loops: near misses of regions that are proved, refuted by simulation of a period."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_are

from surctl.certcheck import check_document, seal
from surctl.lyapunov import Dynamics, Range, State
from surctl.lyapunov.dynamics import Command, Sampling
from surctl.lyapunov.sampled import sampled_region
from surctl.verification.formula import parse, values_of, variable

Array = NDArray[np.float64]
Document = dict[str, Any]

KINDS = ("level", "period", "range", "limit", "gain", "rate")
TERMS = ("{a}*sin({z})", "{a}*{z}*abs({z})", "{a}*{z}*{y}", "{a}*{z}^3", "{a}*(1 - cos({y}))", "{a}*p*{z}",
         "{a}*{z}/(1 + {y}^2)")  # fmt: skip
SUBSTEPS, EDGE, FALSE, SECONDS = 10, 4.0, 1e-9, 20.0
_RANGE = (0.9, 1.1)


def drawn(seed: int) -> Dynamics:
    """Return a drawn plant of 1 or 2 states under a limited state feedback, with or without an integrator."""
    random = np.random.default_rng(seed)
    n, integral = int(random.integers(1, 3)), bool(random.random() < 0.5)
    period = float(random.choice([0.1, 0.2, 0.5]))
    names = [f"x{k}" for k in range(n)]
    a, b = 0.7 * random.normal(size=(n, n)).round(2), np.append(np.zeros(n - 1), 1.0)
    flow = {}
    for k, name in enumerate(names):
        text = " + ".join(f"({x})*{other}" for x, other in zip(a[k], names, strict=True))
        for _ in range(int(random.integers(0, 2))):
            z, y = (str(random.choice(names)) for _ in range(2))
            text += " + " + str(random.choice(TERMS)).format(a=f"({0.3 * random.normal():.2f})", z=z, y=y)
        flow[name] = f"{text} + {'p*' if random.random() < 0.5 else ''}u" if k == n - 1 else f"{text} + x{k + 1}"
        a[k] += np.eye(n)[(k + 1) % n] * (k < n - 1)
    own = expm(period * np.block([[a, b[:, None]], [np.zeros((1, n + 1))]]))
    q, r = own[:n, :n], own[:n, n:]
    p = solve_discrete_are(q, r, np.eye(n), np.eye(1))
    gain = random.uniform(0.7, 1.3) * np.linalg.solve(1 + r.T @ p @ r, r.T @ p @ q)[0]
    raw = " - ".join(["0", *(f"({g:.2f})*{name}" for g, name in zip(gain, names, strict=True))])
    raw += " - z" if integral else ""
    limit = f"{random.uniform(0.3, 3):.2f}"
    command = f"max(-{limit}, min({limit}, {raw}))"
    after = {"z": f"z + {period}*({random.uniform(0.05, 0.3):.2f}*x0 + 0.5*({raw} - {command}))"} if integral else {}
    bounds = [*names, *after]
    known = {name: variable(name) for name in (*bounds, "u", "p")}
    held = (Command("u", parse(command, known), Fraction(0)),)
    sampling = Sampling(
        period, {k: parse(v, known) for k, v in flow.items()}, {k: parse(v, known) for k, v in after.items()}, held
    )
    states, rates = tuple(State(name, -EDGE, EDGE) for name in bounds), (parse("0", known),) * len(bounds)
    return Dynamics(f"loop{seed}", "continuous", states, rates, (Range("p", *_RANGE),), sampling=sampling)


@dataclass(frozen=True)
class Period:
    """Simulation of one period of a certificate's loop from samples of a multiple of its region."""

    document: Document
    count: int
    seed: int

    def ratios(self, reach: float = 1.0) -> tuple[Array, Array]:
        """Return V before, and V after relative to V before, from samples with V up to reach times the level (N,)."""
        claim, random = self.document["claim"], np.random.default_rng(self.seed)
        names = [row["name"] for row in claim["states"]]
        known = {name: variable(name) for name in (*names, "u", "p")}

        def read(texts: Mapping[str, str]) -> Callable[[Array, Array, Array], dict[str, Array]]:
            nodes = [parse(text, known) for text in texts.values()]
            return lambda x, u, p: dict(
                zip(texts, values_of(nodes, dict(zip(known, (*x, u, p), strict=True))), strict=True)
            )

        flow, after = read(claim["dynamics"]), read(claim["next"])
        command, v = read({"u": claim["commands"][0]["value"]}), read({"v": claim["function"]})
        x = random.normal(size=(len(names), self.count))
        one = np.ones(self.count)
        x *= np.sqrt(reach * claim["level"] / v(x, one, one)["v"])
        x *= np.where(random.random(self.count) < 0.5, 1 - 1e-9, random.random(self.count))
        ends = [claim["parameters"][0][key] for key in ("lower", "upper")]
        before, p = v(x, one, one)["v"], random.choice(ends, self.count)
        u = command(x, one, p)["u"]
        later = after(x, u, p)
        x = np.array([later.get(name, row) for name, row in zip(names, x, strict=True)])
        h = claim["period_s"] / SUBSTEPS
        for _ in range(SUBSTEPS):
            p = np.where(random.random(self.count) < 0.3, random.choice(ends, self.count), p)

            def moved(x: Array, p: Array = p) -> Array:
                rates = flow(x, u, p)
                return np.array([rates.get(name, 0 * p) for name in names])

            first = moved(x)
            second = moved(x + h / 2 * first)
            third = moved(x + h / 2 * second)
            x = x + h / 6 * (first + 2 * second + 2 * third + moved(x + h * third))
        return before, v(x, one, one)["v"] / before


def near_misses(document: Document, false: float, worst: float, seed: int) -> Iterator[tuple[str, Document]]:
    """Yield claims that may be false by little, with the evidence of the true one.

    Args:
        document: the certificate.
        false: a level with a counterexample; infinity if none is known.
        worst: largest sampled ratio of V after and before a period.
        seed: seed of the changes.
    """
    random, claim = np.random.default_rng(seed), document["claim"]

    def changed(**entries: Any) -> Document:
        return copy.deepcopy(document) | {"claim": copy.deepcopy(claim) | entries}

    if np.isfinite(false):
        for factor in (1.001, 1.1):
            wide = [row | {"lower": 9 * row["lower"], "upper": 9 * row["upper"]} for row in claim["states"]]
            yield KINDS[0], changed(level=factor * false, states=wide)
    for _ in range(3):
        yield KINDS[1], changed(period_s=claim["period_s"] * float(random.uniform(1.1, 4)))
        ends = random.uniform(0.2, 0.9), random.uniform(1.1, 4)
        yield KINDS[2], changed(parameters=[claim["parameters"][0] | dict(zip(("lower", "upper"), ends, strict=True))])
        [row] = claim["commands"]
        parts = row["value"].partition(", ")
        limit = parts[0].removeprefix("max(-")
        for kind, value in (
            (KINDS[3], row["value"].replace(limit, f"{float(limit) * random.uniform(0.2, 0.9):.4f}")),
            (KINDS[4], f"{random.choice([random.uniform(-0.5, 0.6), random.uniform(1.5, 6)]):.3f}*({row['value']})"),
        ):
            yield kind, changed(commands=[row | {"value": value}])
    yield KINDS[5], changed(rate=float(min(1.0, 1.05 * (1 - worst) + 1e-6)))


def run(claims: int, samples: int, seed: int) -> tuple[dict[str, tuple[int, int]], tuple[int, int], list[str]]:
    """Return (false claims, accepted ones) by kind, (drawn loops, proved ones), and what is wrong.

    Args:
        claims: number of false claims.
        samples: simulated periods for a claim.
        seed: seed of the first loop.
    """
    tried, passed = dict.fromkeys(KINDS, 0), dict.fromkeys(KINDS, 0)
    loops, proved, wrong = 0, 0, list[str]()
    for number in itertools.count(seed):
        if sum(tried.values()) >= claims:
            break
        loops += 1
        region = sampled_region(drawn(number), None, time_limit=SECONDS)
        if region is None:
            continue
        proved += 1
        document = dict(region.document)
        _, ratio = Period(document, samples, number).ratios()
        worst = float(ratio.max())
        if worst >= 1:
            wrong.append(f"loop {number}: V grows by {worst} in a period of the proved region")
        v, ratio = Period(document, samples, number).ratios(9.0)
        false = float(v[~(ratio < 1 + FALSE)].min(initial=np.inf))
        for kind, miss in near_misses(document, false, worst, number):
            _, ratio = Period(miss, samples, number + 1).ratios()
            if not np.any(~(ratio < 1 - (miss["claim"]["rate"] or 0.0) + FALSE)):
                continue  # no counterexample is known
            tried[kind] += 1
            evidence = {key: miss[key] for key in ("knots", "feedbacks")}
            if check_document(seal("lyapunov", miss["claim"], evidence)).accepted:
                passed[kind] += 1
                wrong.append(f"loop {number}, {kind}: {miss['claim']}")
    return {kind: (tried[kind], passed[kind]) for kind in KINDS}, (loops, proved), wrong
