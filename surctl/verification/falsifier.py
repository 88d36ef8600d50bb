"""The falsifier searches for a point where a claim fails, by sampling and by local optimisation with exact gradients.

The falsifier can refute a claim but never prove one.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.errors import EmptyDomain, InputError
from surctl.verification.claim import Claim
from surctl.verification.counterexample import Counterexample, Oracle, build_oracle
from surctl.verification.verdict import Verdict

_APART = 0.1  # least distance between two starting points in the unit box, divided by the root of the dimension


@dataclass(frozen=True, eq=False)
class Search:
    """The result of the falsifier.

    Attributes:
        verdict: `refuted`, with the worst point as counterexample, or `not refuted`.
        violating: (n, k) all k evaluated points at which the margin exceeds the threshold, in the variables' units; the
            worst point is first.
        points: (n, m) all m evaluated points of the domain, the worst first.
    """

    verdict: Verdict
    violating: NDArray[np.float64]
    points: NDArray[np.float64]


def falsify(claim: Claim, *, samples: int = 4096, starts: int = 16, seed: int = 0) -> Verdict:
    """Search for a point of the domain where the claim fails.

    The falsifier evaluates scrambled Sobol samples, whose number is rounded up to a power of two. Local searches then
    start from the worst samples that are far enough apart. They maximise the margin, in coordinates scaled to the unit
    box, with L-BFGS-B, or with SLSQP if the domain has constraints.

    Args:
        claim: the claim.
        samples: number of samples in the box, at least 2.
        starts: largest number of local searches, at least 1.
        seed: seed of the samples; equal seeds give equal verdicts.

    Raises:
        EmptyDomain: no sample lies in the domain.
        InputError: there are fewer than 2 samples or fewer than 1 start, or the margin is not finite at a point of the
            domain.

    Example:
        >>> from surctl.marine.verification import claims
        >>> from surctl.verification import falsify
        >>> [claim] = claims(names=["v1-printed"])
        >>> found = falsify(claim, samples=256, starts=2)
        >>> found.verdict, round(found.counterexample.margin, 3), found.counterexample.unit
        ('refuted', 4.8, 'm^2/s')
    """
    return search(claim, samples=samples, starts=starts, seed=seed).verdict


def search(claim: Claim, *, samples: int, starts: int, seed: int) -> Search:
    """Run the falsifier and return every violating point with the verdict; see `falsify` for the arguments."""
    began = time.perf_counter()
    if samples < 2 or starts < 1:
        raise InputError("needs at least 2 samples and 1 start", key=claim.name, value=(samples, starts))
    oracle = build_oracle(claim)
    unit = sobol(len(claim.variables), samples, seed)
    margin, size, inside = oracle.evaluate(oracle.place(unit))
    _require_finite(oracle, unit, margin, inside)
    begin = _choose_starts(oracle, unit, margin, inside, starts)
    maxima = _climb(oracle, begin)
    points = np.hstack([oracle.place(unit[:, inside]), maxima])
    if points.shape[1] == 0:
        key = f"claim {claim.name}"
        if oracle.inside(oracle.place(unit)).any():
            raise EmptyDomain(
                "has no finite value in double precision at any sample", key=key, remedy="scale the claim"
            )
        raise EmptyDomain("no sample lies in its domain", key=key, remedy="widen the bounds or the constraints")
    scale = max(np.max(size[inside], initial=0), np.max(oracle.evaluate(points)[1]))
    threshold = claim.tolerance * float(scale)
    witnesses = _weigh(oracle)
    counterexample, worst = _worst(oracle, points, witnesses, threshold)
    violates = margin[inside] > threshold
    verdict = Verdict(
        claim,
        "not refuted" if counterexample is None else "refuted",
        counterexample,
        worst,
        threshold,
        float(violates.mean()) if violates.size else 0.0,
        int(violates.size),
        begin.shape[1],
        witnesses,
        time.perf_counter() - began,
    )
    points = np.column_stack([points, *(claim.point(w.values) for w in witnesses)])
    margin = oracle.evaluate(points)[0]
    order = np.argsort(-margin, kind="stable")
    points = points[:, order]
    return Search(verdict, points[:, margin[order] > threshold], points)


def sobol(dimension: int, samples: int, seed: int) -> NDArray[np.float64]:
    """Return samples (dimension, number) of the unit box; their number is rounded up to a power of two."""
    from scipy.stats import qmc

    sample = qmc.Sobol(dimension, seed=seed).random_base2(int(np.ceil(np.log2(samples))))
    return np.ascontiguousarray(np.asarray(sample, dtype=float).T)


def _require_finite(
    oracle: Oracle, unit: NDArray[np.float64], margin: NDArray[np.float64], inside: NDArray[np.bool_]
) -> None:
    # every comparison with NaN is false, so that a point with margin NaN would look as if the claim held
    broken = np.flatnonzero(inside & ~np.isfinite(margin))
    if broken.size:
        where = oracle.claim.values(oracle.place(unit[:, broken[0]]))
        problem = "is not finite inside its domain"
        remedy = "exclude this part of the domain"
        raise InputError(problem, key=f"claim {oracle.claim.name}", value=where, remedy=remedy)


def _choose_starts(
    oracle: Oracle, unit: NDArray[np.float64], margin: NDArray[np.float64], inside: NDArray[np.bool_], starts: int
) -> NDArray[np.float64]:
    """Return the worst samples (n, ≤ starts) that are far enough apart.

    Samples outside the domain come last, those nearest to the domain first.
    """
    outside = np.flatnonzero(~inside)[: 8 * starts]
    miss = [-float(np.min(oracle.slack(unit[:, i]), initial=0)) for i in outside]
    order = np.append(np.flatnonzero(inside)[np.argsort(-margin[inside], kind="stable")], outside[np.argsort(miss)])
    chosen: list[NDArray[np.float64]] = []
    left = unit[:, order.astype(int)]
    while left.size and len(chosen) < starts:
        chosen.append(left[:, 0])
        left = left[:, np.linalg.norm(left - left[:, :1], axis=0) >= _APART * np.sqrt(len(unit))]
    return np.column_stack(chosen)


def _climb(oracle: Oracle, starts: NDArray[np.float64]) -> NDArray[np.float64]:
    # end points (n, k) in the variables' units, without the searches that end outside the domain
    ends = np.column_stack([oracle.place(_ascend(oracle, start)) for start in starts.T])
    margin, _, inside = oracle.evaluate(ends)
    return ends[:, inside & np.isfinite(margin)]


def _ascend(oracle: Oracle, start: NDArray[np.float64]) -> NDArray[np.float64]:
    # start and end point lie in the unit box
    from scipy.optimize import minimize

    slope = float(np.max(np.abs(oracle.gradient(start))))
    scale = slope if slope > 0 else 1.0  # scaled to a slope of 1 per box width, so that the stopping rules apply
    constrained = oracle.claim.constraints.numel() > 0
    rows = [{"type": "ineq", "fun": oracle.slack, "jac": oracle.slack_jacobian}] if constrained else ()
    run = minimize(
        lambda p: min(-oracle.margin(p) / scale, 1e6),  # finite even if the margin is not
        start,
        jac=lambda p: -oracle.gradient(p) / scale,
        bounds=[(0.0, 1.0)] * start.size,
        constraints=rows,
        method="SLSQP" if constrained else "L-BFGS-B",
        options={"maxiter": 100, "ftol": 1e-12},
    )
    return np.asarray(run.x, dtype=float)


def _weigh(oracle: Oracle) -> tuple[Counterexample, ...]:
    claim, weighed = oracle.claim, []
    for witness in claim.witnesses:
        point = claim.point(witness)
        margin, _, inside = oracle.evaluate(point[:, None])
        if inside[0]:
            weighed.append(Counterexample(claim.values(point), float(margin[0]), claim.unit, "witness"))
    return tuple(weighed)


def _worst(
    oracle: Oracle, points: NDArray[np.float64], witnesses: tuple[Counterexample, ...], threshold: float
) -> tuple[Counterexample | None, float]:
    """Return the worst point and the largest margin; None as the point if the margin is within the threshold."""
    margin = oracle.evaluate(points)[0]
    best = int(np.argmax(margin))
    worst = max([float(margin[best]), *(w.margin for w in witnesses)])
    if margin[best] > threshold:
        return _shorten(oracle, points[:, best]), worst
    refuting = [w for w in witnesses if w.margin > threshold]
    return (refuting[0] if refuting else None), worst


def _shorten(oracle: Oracle, point: NDArray[np.float64]) -> Counterexample:
    """Round a point to the fewest decimals with which it stays in the domain and keeps at least 90 % of its margin."""
    claim = oracle.claim
    full = float(oracle.evaluate(point[:, None])[0][0])
    for decimals in range(1, 8):
        with np.errstate(over="ignore", invalid="ignore"):  # of the largest doubles
            rounded = np.round(point, decimals) + 0.0  # + 0.0: no negative zeros
        margin, _, inside = oracle.evaluate(rounded[:, None])
        if inside[0] and np.isfinite(margin[0]) and margin[0] >= 0.9 * full:
            return Counterexample(claim.values(rounded), float(margin[0]), claim.unit)
    return Counterexample(claim.values(point), full, claim.unit)
