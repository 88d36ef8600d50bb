"""Decide a claim about solutions: bounds of the proof, refutation, proof of each inequality, by which rule."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import PATIENCE, check_document, seal
from surctl.errors import EmptyDomain, InputError, UnsupportedOperation
from surctl.lyapunov.claims import Bound, DynamicClaim, Inequality, Power, Safety, Stability
from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.equilibrium import inexact, linearisation
from surctl.lyapunov.falsified import least_level
from surctl.lyapunov.near import Failure, fails_nearby, inward_speeds, point_text, short, stationary_state
from surctl.lyapunov.radii import with_radii
from surctl.verification.claim import Claim
from surctl.verification.decide import confirmed
from surctl.verification.doubtful import undefined_at
from surctl.verification.falsifier import search, sobol
from surctl.verification.formula import FUNCTIONS, ordered, text_of, values_of
from surctl.verification.proving import prove_cases

Array = NDArray[np.float64]

_SAMPLES, _STARTS, _FEW = 2048, 8, 256
_POWERS = (1, 2, 3, 4)
_FIRST = 0.6  # share of the remaining time for a choice of bounds that is not the last one
_FLAT = 1e-3  # least ratio of a bound near the equilibrium to the same bound far from it
_FAR = 0.1  # least r² far from the equilibrium, relative to the largest in the region
_SHARES_TRIED = (1e-3, 0.3, 1e-6, 1e-9)  # shares of the least sampled ratio that are tried as factor of a lower bound
_SLOPES = 0.3  # share of the time for the slope rule, if it is the first one
_SIMPLE = 1.0  # largest processor time of a proof of an inequality that should take milliseconds [s]
_HARD, _EASY = 0.7, 0.5  # shares of the remaining time for the first inequality, and for one that is not the last
_STEP, _NEAR = 1e-3, (1.0, 0.3, 0.1, 0.03, 0.01, 0.003)  # of the box: second differences; samples on lines
_ALONG = np.array([t for near in _NEAR for t in (near, -near)])
_CAUSES = {"decrease": "V decreases", "face": "V on a face", "successor": "the successor of a state"}
_APART = 1e-6  # of the box: no counterexample is closer to an equilibrium that is one only up to rounding
_ROUGH = (
    "the rates are 0 at the equilibrium only up to rounding, so only secant slopes with a quadratic V are tried; for "
    "other methods, write rates that are exactly 0 there, with ratios that are 1 (i/i_0) or numbers such as 0.25"
)
_ZERO = 1e-9  # largest value of V at the equilibrium, relative to the level, that counts as rounding


@dataclass(frozen=True, eq=False)
class Decision:
    """The verdict on a claim about solutions.

    Attributes:
        claim: the claim.
        verdict: `proved` with a certificate that the checker accepts, `refuted` with a counterexample, or `unknown`.
        document: the certificate; empty unless the claim is proved.
        reason: why the claim is refuted or unknown, in one sentence; empty if it is proved.
        counterexample: values of the variables where an inequality fails; empty unless the claim is refuted.
        seconds: duration [s].
        vacuous: why a proved claim says nothing, as the checker finds; empty if it says something.
    """

    claim: DynamicClaim
    verdict: Literal["proved", "refuted", "unknown"]
    document: Mapping[str, Any]
    reason: str
    counterexample: Mapping[str, float]
    seconds: float
    vacuous: str = ""

    @property
    def rule(self) -> str:
        """By what the claim is proved, in words; empty unless it is proved."""
        if "slopes" in self.document or "knots" in self.document:
            return "secant slopes: a matrix inequality at every vertex of the ranges of the slopes"
        cases = [case for proof in self.document.get("proofs", []) for case in proof]
        squares = ["squares" in case for case in cases]
        return " and ".join(["interval boxes"] * (not all(squares)) + ["sums of squares"] * any(squares))

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as plain data for JSON."""
        return {
            "claim": self.claim.dynamics.name, "statement": self.claim.statement, "verdict": self.verdict,
            "function": text_of(self.claim.function), "certificate": dict(self.document) or None,
            "reason": self.reason or None, "counterexample": dict(self.counterexample) or None,
            "seconds": self.seconds,
        }  # fmt: skip


def decide_motion(
    claim: DynamicClaim, *, time_limit: float = 60.0, seed: int = 0, progress: Callable[[str], None] | None = None
) -> Decision:
    """Prove or refute a claim about the solutions of dynamics.

    Args:
        claim: the claim.
        time_limit: limit of the processor time of the proof [s].
        seed: seed of the falsifier.
        progress: function that receives a line of progress from time to time.

    Raises:
        InputError: the equilibrium is not one, V is not 0 there or has kinks, the level is not positive, or a rate may
            jump.

    Example:
        >>> from surctl.lyapunov import Dynamics, Stability, State, decide_motion
        >>> from surctl.verification.formula import parse, variable
        >>> x = {"x": variable("x")}
        >>> cubic = Dynamics("cubic", "continuous", (State("x", -2.0, 2.0),), (parse("-x + x^3", x),))
        >>> [decide_motion(Stability(cubic, parse("x^2", x), level)).verdict for level in (0.9, 1.1)]
        ['proved', 'refuted']
    """
    began, worked = time.perf_counter(), time.process_time()
    _require_sound(claim)
    refuted = _refutation(claim, seed)
    if refuted is not None:
        return Decision(claim, "refuted", {}, *refuted, time.perf_counter() - began)
    left = time_limit - (time.process_time() - worked)
    return replace(
        prove_motion(claim, time_limit=left, seed=seed, progress=progress), seconds=time.perf_counter() - began
    )


def prove_motion(
    claim: DynamicClaim,
    *,
    time_limit: float,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    most: int | None = None,
) -> Decision:
    """Prove a claim as `decide_motion`, without a search for counterexamples, with at most `most` choices of bounds."""
    began, worked = time.perf_counter(), time.process_time()
    if isinstance(claim, Stability) and inexact(claim.dynamics):
        decision = prove_by_slopes(claim, time_limit=time_limit)
        return decision if decision.verdict == "proved" else replace(decision, reason=f"{decision.reason}; {_ROUGH}")
    first = has_any(claim.dynamics, FUNCTIONS)
    if first and not isinstance(claim, Safety):
        decision = prove_by_slopes(claim, time_limit=_SLOPES * time_limit)
        if decision.verdict == "proved":
            return decision
    reason, refused = "", math.inf
    attempts = list(_attempts(claim))[:most]
    if not attempts:
        reason = "no strict bound exists: at some states of the region, V is not positive or does not decrease"
    for number, attempt in enumerate(attempts):
        if attempt.factor >= refused:
            continue  # a smaller bound does not hold
        rest = time_limit - (time.process_time() - worked)
        # a choice of bounds that cannot be proved leaves time for the next one
        until = time.process_time() + rest * (1.0 if number == len(attempts) - 1 else _FIRST)
        inequalities = attempt.inequalities
        proofs = {k: _simply(inequalities[k], rest) for k in attempt.places}
        doubtful = [inequalities[k] for k, proof in proofs.items() if proof is None]
        failing = next((one for one in doubtful if _refuted(one.claim, seed, few=True) is not None), None)
        if failing is not None:
            refused = attempt.factor
            reason = reason or f"{failing.name}: not by a provable margin"
            continue
        for simple in (True, False):  # what the checker rejects is proved again, with its confirmation
            reason = _prove_all(inequalities, proofs, until, progress, simple=simple)
            if reason:
                break
            shown = [proofs[k] for k in range(len(inequalities))]
            document = seal(claim.kind, claim.plain(), attempt.evidence | {"proofs": shown})
            checked = check_document(document)
            if checked.accepted:
                return Decision(claim, "proved", document, "", {}, time.perf_counter() - began, checked.vacuous)
            reason, proofs = f"the checker rejects the proof: {checked.reason}", {}
    if not (first or isinstance(claim, Safety)) and (rest := time_limit - (time.process_time() - worked)) > 0:
        decision = prove_by_slopes(claim, time_limit=rest)
        if decision.verdict == "proved":
            return replace(decision, seconds=time.perf_counter() - began)
    return Decision(claim, "unknown", {}, reason, {}, time.perf_counter() - began)


def has_any(dynamics: Dynamics, operations: Collection[str]) -> bool:
    """Return whether the rates contain one of the operations; functions cost other rules more work than slopes."""
    return any(node.op in operations for node in ordered(*dynamics.rates))


def prove_by_slopes(claim: Stability | Bound, *, time_limit: float, feedbacks: Array | None = None) -> Decision:
    """Prove a claim by the slope rule of the checker, which needs nothing but a quadratic V.

    Args:
        claim: the claim.
        time_limit: limit of the processor time [s].
        feedbacks: feedback (k, n) of each limit; None or k = 0 for a proof without them.
    """
    began = time.perf_counter()
    stated = {} if feedbacks is None or not len(feedbacks) else {"feedbacks": feedbacks.tolist()}
    reason = ""
    for trial in (lambda: claim, lambda: None if claim.dynamics.shifts else with_radii(claim)):
        if (one := trial()) is not None:
            document = seal(one.kind, one.plain(), {"slopes": stated})
            checked = check_document(document, time_limit=min(time_limit, PATIENCE))
            reason = checked.reason
            if checked.accepted:
                return Decision(one, "proved", document, "", {}, time.perf_counter() - began, checked.vacuous)
    return Decision(claim, "unknown", {}, reason, {}, time.perf_counter() - began)


def _simply(inequality: Inequality, left: float) -> list[Any] | None:
    """Return the cases of a proof that takes milliseconds; None if there is none."""
    if left <= 0:
        return None
    proof = prove_cases(inequality.exact, inequality.name, time_limit=min(_SIMPLE, left), simply=True)
    return None if proof.remaining else list(proof.cases)


def _prove_all(
    inequalities: Sequence[Inequality],
    proofs: dict[int, list[Any] | None],
    until: float,
    progress: Callable[[str], None] | None,
    *,
    simple: bool,
) -> str:
    """Add the cases of the missing proofs to `proofs`, by index; return why one of them is not proved, or nothing."""
    missing = [k for k in range(len(inequalities)) if proofs.get(k) is None]
    # the last inequality, about the change of the function, is the hardest: without it, the others are of no use
    for number, k in enumerate(missing[::-1]):
        inequality = inequalities[k]
        left = until - time.process_time()
        if left <= 0:
            return "the time limit was reached"
        if simple and k not in proofs and (proof := _simply(inequality, left)) is not None:
            proofs[k] = proof
            continue
        share = left if number == len(missing) - 1 else (_EASY if number else _HARD) * left
        shown = prove_cases(inequality.exact, inequality.name, time_limit=share, progress=progress)
        if shown.remaining:
            return f"{inequality.name}: {shown.remaining}"
        proofs[k] = list(shown.cases)
    return ""


def _refutation(claim: DynamicClaim, seed: int) -> Failure | None:
    """Return which inequality certainly fails, in words, and where; None if no counterexample was found."""
    if isinstance(claim, Stability):
        near = fails_nearby(
            claim.dynamics, claim.function, claim.rate, linearisation(claim.dynamics), level=claim.level
        )
        if near is not None:
            return near
    if isinstance(claim, Bound):
        inequalities = claim.inequalities()
    elif isinstance(claim, Safety):
        inequalities = replace(claim, stays=False).inequalities(0.0)
    else:
        nothing = Power(0.0, 1)
        if inexact(d := claim.dynamics):
            claim = replace(claim, radii={s.name: _APART * (s.upper - s.lower) for s in d.states})
        inequalities = claim.inequalities([1.0] * len(d.states), nothing, None if claim.rate is not None else nothing)
    for k, inequality in enumerate(inequalities):
        # a region has two inequalities for each state, about its boundary; few samples are enough for these
        few = not isinstance(claim, Safety) and 0 < k < len(inequalities) - 1
        point = _refuted(inequality.claim, seed, few=few)
        if point is not None:
            return _fails(inequality.name, point)
        low, high = inequality.exact.lower[:, None], inequality.exact.upper[:, None]
        undefined = undefined_at(inequality.exact, low + (high - low) * sobol(len(low), _FEW, 0))
        if undefined is not None:
            where, what = undefined
            return Failure(f"{inequality.name}: {what} is not defined at {point_text(where)}", where)
    if isinstance(claim, Stability):
        still = None if claim.rate is not None else stationary_state(claim)
        if still is not None:
            return _fails(f"{claim.dynamics.name}: V decreases", still)
        # rays see what samples miss: a region that barely touches the set where V does not decrease
        least = least_level(claim.dynamics, claim.function, claim.rate, seed=seed)
        if least.confirmed and 0 < least.level < claim.level:
            return _fails(f"{claim.dynamics.name}: {_CAUSES[least.cause]}", least.values)
    return None


def _fails(name: str, point: Mapping[str, float]) -> Failure:
    return Failure(f"{name}: fails at {point_text(point)}", point)


@dataclass(frozen=True, eq=False)
class _Attempt:
    # `factor`: size of the bounds that the proof states; if the bounds of an attempt fail, larger ones fail as well
    # `places`: indices of the inequalities that contain these bounds
    stated: Callable[[], list[Inequality]]
    evidence: dict[str, Any]
    factor: float = 0.0
    places: tuple[int, ...] = ()

    @cached_property
    def inequalities(self) -> list[Inequality]:
        return self.stated()


def _attempts(claim: DynamicClaim) -> Any:
    change = {"change": text_of(claim.dynamics.change(claim.function))}
    if isinstance(claim, Bound):
        yield _Attempt(claim.inequalities, change)
    elif isinstance(claim, Safety):
        extra: dict[str, Any] = {}
        inward = inward_speeds(claim) if claim.stays else None
        if claim.stays:
            if inward is None:
                return  # on some face, a state moves outwards
            extra = {"inward": inward or None}
        size = _largest(claim)
        for margin in (short(share * size) for share in (1e-3, 1e-6, 1e-9)):
            stated = partial(claim.inequalities, margin, inward)
            yield _Attempt(stated, change | extra | {"margin": margin}, margin, (1,))
    else:
        yield from _stability_attempts(claim, change)


def _largest(claim: Safety) -> float:
    """Return the largest |B| of samples of the box: a margin is a share of it, so that B may have any unit."""
    d = claim.dynamics
    low, high = d.box[:, :, None]
    x = low + (high - low) * sobol(len(d.states), _FEW, 0)
    [values] = values_of([claim.function], dict(zip((s.name for s in d.states), x, strict=True)))
    return float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


def _stability_attempts(claim: Stability, change: dict[str, Any]) -> Any:
    d = claim.dynamics
    scales = [short(max(s.upper - s.equilibrium, s.equilibrium - s.lower), up=True) for s in d.states]
    inside, values, loss = _sampled(claim)
    square = (((inside - d.equilibrium[:, None]) / np.array(scales)[:, None]) ** 2).sum(axis=0)
    first = _lower_bound(values, square)
    other = None if claim.rate is not None else _lower_bound(loss, square)
    if first is None or (claim.rate is None and other is None):
        return  # a proof has nothing to state
    for share in _SHARES_TRIED:
        positive = Power(short(share * first[0]), first[1])
        decrease = None if other is None else Power(short(share * other[0]), other[1])
        evidence = {
            "scales": scales, "positive": positive.to_dict(),
            "decrease": None if decrease is None else decrease.to_dict(),
        }  # fmt: skip
        stated = partial(claim.inequalities, scales, positive, decrease)
        last = 1 + 2 * len(d.states)  # two inequalities for each state, about faces or successors, lie between
        yield _Attempt(stated, change | evidence, share, (0, last))


@cache
def _sobol(dimension: int) -> Array:
    return sobol(dimension, _SAMPLES, 0)


def _sampled(claim: Stability) -> tuple[Array, Array, Array]:
    """Return samples (n, N) of the region, also close to the equilibrium, with V and its least loss there (N,)."""
    d = claim.dynamics
    low, high = d.box
    unit = _sobol(len(d.states))
    wide = low[:, None] + (high - low)[:, None] * unit
    centre = d.equilibrium[:, None]
    x = np.hstack([centre + (wide - centre) * near for near in (1.0, 0.1, 0.01)])
    both = claim.function, d.change(claim.function)
    corners = d.corners()

    def read(at: Array) -> tuple[Array, Array]:
        values, loss = np.full(at.shape[1], np.nan), np.full(at.shape[1], np.inf)
        for corner in corners.T:
            ends = np.repeat(corner[:, None], at.shape[1], axis=1)
            values, moved = values_of(both, dict(zip((v.name for v in d.variables), (*at, *ends), strict=True)))
            loss = np.minimum(loss, values - moved if d.discrete else -moved)
        return values, loss

    x = np.hstack([x, *_axes(d, read)])
    values, loss = read(x)
    inside = (values < claim.level) & np.isfinite(values) & np.isfinite(loss) & np.any(x != centre, 0)
    if not np.any(inside):
        raise InputError("lies above the level in the whole box", key=f"{d.name}.function", remedy="raise the level")
    return x[:, inside], values[inside], loss[inside]


def _axes(d: Dynamics, functions: Callable[[Array], Sequence[Array]]) -> list[Array]:
    """Return, for each function, states (n, N) on lines through the equilibrium along which it may be flat.

    The lines are parallel to the states' axes and to the main axes of the function's second derivative: samples miss
    the lines on which only a higher order counts.
    """
    n = len(d.states)
    (low, high), middle, axes = d.box, d.equilibrium, np.eye(n)
    scales, centre = np.maximum(high - middle, middle - low), middle[:, None]
    i, j = np.triu_indices(n)
    steps = scales[:, None] * (_STEP * (axes[:, i] + axes[:, j]))
    ahead, behind = np.split(np.asarray(functions(np.hstack([centre + steps, centre - steps]))), 2, axis=1)
    states = []
    for q in (a + b for a, b in zip(ahead, behind, strict=True)):
        bend = np.zeros((n, n))
        bend[i, j] = q
        own = np.diag(bend) / 4
        bend = bend + bend.T - (own[:, None] + own)
        np.fill_diagonal(bend, 2 * own)
        lines = np.hstack([axes, np.linalg.eigh(bend)[1]]) if np.all(np.isfinite(bend)) else axes
        along = (scales[:, None] * lines)[:, None, :] * _ALONG[:, None]
        states.append((centre[:, None] + along).reshape(n, -1))
    return states


def _lower_bound(values: Array, square: Array) -> tuple[float, int] | None:
    """Return factor and power of the bound of the least power that does not vanish near the equilibrium.

    The bound holds at all samples.
    """
    far = square > _FAR * square.max()
    for power in _POWERS:
        ratio = values / square**power
        least = float(ratio.min())
        # close to the equilibrium, a function of a higher order has a ratio that tends to 0
        if least > 0 and least >= _FLAT * float(ratio[far].min()):
            return least, power
    least = float((values / square).min())
    return (least, 1) if least > 0 else None


def _refuted(claim: Claim, seed: int, *, few: bool = False) -> Mapping[str, float] | None:
    """Return a point at which interval arithmetic confirms that the inequality fails, or None."""
    try:
        outcome = search(claim, samples=_FEW if few else _SAMPLES, starts=2 if few else _STARTS, seed=seed)
    except EmptyDomain:
        return None
    worst = outcome.verdict.counterexample
    sure = None if worst is None else confirmed(claim, worst, outcome.violating)
    return None if sure is None else sure.values


def _require_sound(claim: DynamicClaim) -> None:
    d = claim.dynamics
    try:
        value = float(d.compiled(claim.function)(d.equilibrium, d.corners()[:, 0]))
        d.change(claim.function)
    except UnsupportedOperation as error:
        raise InputError(error.problem, key=f"{d.name}.function", remedy=error.remedy) from None
    for s, rate in zip(d.states, d.rates, strict=True):
        if not d.discrete and any(node.op == "select" for node in ordered(rate)):
            remedy = "write continuous dynamics with min, max or abs"
            raise InputError("contains select, so that the rate may jump", key=f"{d.name}.{s.name}", remedy=remedy)
    if isinstance(claim, Safety):
        return
    if isinstance(claim, Stability):
        d.require_rest()
        if not abs(value) <= _ZERO * abs(claim.level):
            raise InputError(
                "is not 0 at the equilibrium", key=f"{d.name}.function", value=value,
                remedy="subtract its value there",
            )  # fmt: skip
    if not claim.level > 0 and isinstance(claim, Stability):
        raise InputError("is not positive", key=f"{d.name}.level", value=claim.level, remedy="give a positive level")
