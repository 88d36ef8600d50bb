"""Find a Lyapunov function and a large region, and prove them; why none can be proved (jumps), another V instead."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from surctl.lyapunov.candidates import Candidate, candidates, strict_variants
from surctl.lyapunov.claims import Stability
from surctl.lyapunov.decide import Decision, decide_motion, has_any, prove_by_slopes, prove_motion
from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.equilibrium import Linear, held_parameters, inexact, linearisation
from surctl.lyapunov.falsified import Falsified, least_held_level, least_level
from surctl.lyapunov.near import Failure, fails_nearby, point_text, short, stationary_state, too_fast
from surctl.lyapunov.rays import enclosing, hugged
from surctl.lyapunov.sampled import SampledStability, sampled_region
from surctl.lyapunov.slope_search import LABEL as SLOPES
from surctl.lyapunov.slope_search import form_of, relative_volume, slope_candidate
from surctl.verification.formula import BRANCHING, Node, ordered, text_of

_SHARES = (0.005, 0.02, 0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.97, 0.99)  # of the least level with a counterexample
_FIRST, _PART = 7, 0.4  # index of the share that is tried first; share of the remaining time for one level
_SIMPLE, _EASY = 2, 1  # the same for the function that is easiest to prove, and when all larger ones failed
_HALF = 0.4  # share of the remaining time for a function that is not the last
_MOST, _WHOLE = 0.7, 0.8  # the same for the function that is easiest to prove, and share of it for its first level
_SEARCH = 0.3  # share of the time for the search of functions
_GAIN = 1.01  # least ratio of a region to the one that is proved, for which its proof is tried
_TRIED = 2  # functions with large regions whose proof is tried
_SAMPLED = 0.7  # share of the time for a region of a loop with held commands
_SLOPES, _PROOF = 0.1, 0.2  # shares of the time for the search of a function by the slope rule, and for its proofs
_SAFE = (0.98, 0.92, 0.8, 0.6)  # levels that are tried, relative to the proposed one
_FEW, _MANY = 3, 8  # states, and states and parameters, up to which other rules may prove larger regions
_SOME = 6  # states up to which the least level with a counterexample is searched after a proof by the slope rule


@dataclass(frozen=True, eq=False)
class StabilityResult:
    """The result of the search for a Lyapunov function.

    Attributes:
        verdict: `proved`, `refuted` (the equilibrium is not stable for all parameters, the stated function or rate is
            wrong close to it) or `unknown`.
        reason: why the verdict is not `proved`, in one sentence; empty if it is.
        decision: the decision on the claim with the largest proved region, or on the last claim that was tried; None if
            there is none.
        falsified: the least level of the function for which a counterexample was found; None if it was not searched.
        label: how the function was found.
        volume: estimated volume of the region relative to the box.
        counterexample: values of the variables where the stated function fails; empty if no such state is known.
        instead: a function and its level that prove a region, in words, where the stated function does not.
    """

    verdict: Literal["proved", "refuted", "unknown"]
    reason: str
    decision: Decision | None = None
    falsified: Falsified | None = None
    label: str = ""
    volume: float = 0.0
    counterexample: Mapping[str, float] = field(default_factory=dict)
    instead: str = ""

    @property
    def claim(self) -> Stability | None:
        """The claim: function, level and rate."""
        claim = None if self.decision is None else self.decision.claim
        return claim if isinstance(claim, Stability) else None

    @property
    def ratio(self) -> float:
        """The proved level relative to the least level with a counterexample; 0 if one of them is not known."""
        if self.verdict != "proved" or self.claim is None or self.falsified is None:
            return 0.0
        return self.claim.level / self.falsified.level


def find_stability(
    dynamics: Dynamics,
    *,
    function: Node | None = None,
    level: float | None = None,
    rate: float | None = None,
    degree: int = 6,
    first: bool = False,
    time_limit: float = 60.0,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> StabilityResult:
    """Find and prove a region of attraction: a Lyapunov function, and its largest provable level.

    The least level for which a counterexample exists is searched first; the proof is then tried at levels below. The
    states of a claim with a searched level have the bounds of the smallest box around the region.

    Args:
        dynamics: the dynamics, about their equilibrium.
        function: V, an expression of the states; by default it is searched. A stated function is never changed: if it
            fails close to the equilibrium, the verdict is `refuted`, and `instead` names one that proves a region.
        level: level of the region; by default it is searched.
        rate: with a number, V' ≤ −rate · V is demanded; None means any strict decrease.
        degree: largest degree of V.
        first: whether the first region that is proved is enough.
        time_limit: limit of the processor time [s].
        seed: seed of the random numbers.
        progress: function that receives a line of progress from time to time.

    Raises:
        InputError: the equilibrium is not one.

    Example:
        >>> from surctl.lyapunov import Dynamics, State, find_stability
        >>> from surctl.verification.formula import parse, variable
        >>> x = {"x": variable("x")}
        >>> cubic = Dynamics("cubic", "continuous", (State("x", -2.0, 2.0),), (parse("-x + x^3", x),))
        >>> result = find_stability(cubic, degree=2)
        >>> result.verdict, result.ratio >= 0.9
        ('proved', True)
    """
    until = time.process_time() + time_limit
    d = dynamics
    d.require_rest()
    linear = linearisation(d)
    if linear.verdict == "unstable":
        return StabilityResult("refuted", linear.reason)
    search = _Search(d, linear, rate, level, seed, progress or (lambda text: None))
    if function is not None:
        failure = search.failure(function)
        if failure is not None:
            instead = search.instead(function, until - time.process_time())
            return StabilityResult(
                "refuted", failure.reason, label="given", counterexample=failure.values, instead=instead
            )
    elif reason := too_fast(d, linear, rate):
        return StabilityResult("refuted", reason)
    elif reason := unprovable(d):
        return StabilityResult("unknown", reason)
    slopes: StabilityResult | None = None
    stated = function is not None or level is not None
    searched = not stated and linear.verdict == "stable"
    if d.sampling is not None and searched:
        held = sampled_region(d, rate, time_limit=_SAMPLED * time_limit, progress=progress)
        if held is not None:
            volume = relative_volume(d, form_of(held.claim.function, d.names) / held.document["claim"]["level"])
            assert isinstance(held.claim, SampledStability)
            share = held.claim.rate or 0.0
            bound = None if d.shifts else least_held_level(d, held.claim.function, share, seed=seed)
            return StabilityResult("proved", "", held, bound, SLOPES, volume)
        if _jumps(d.rates):
            return StabilityResult("unknown", f"no region of the sampled loop is proved, and the law {_JUMPS}")
    if d.shifts:
        moving = search.by_slopes(until - time.process_time()) if searched else None
        return moving or StabilityResult("unknown", f"{_SHIFTED}: {held_parameters(d)[1]}")
    few = len(d.states) <= _FEW
    hard = has_any(d, BRANCHING) or len(d.variables) > _MANY or inexact(d)
    if searched and hard:
        slopes = search.by_slopes(time_limit)
        if slopes is not None and (first or not few):
            return slopes
    if function is not None:
        offered: Iterator[Candidate] = iter([Candidate("given", function, 0.0)])
    else:
        offered = candidates(d, linear, degree=degree, seconds=_SEARCH * time_limit, rate=rate or 0.0, seed=seed)
    trials = []
    best: StabilityResult | None = None
    for candidate in offered:
        size = f", volume {candidate.volume:.3g} of the box" if function is None else ""
        trials.append((candidate, search.bound(candidate, size)))
        if first and function is None and len(trials) == 1:
            best = search.proved(*trials[0], _MOST * (until - time.process_time()), start=_SIMPLE, once=True)
            if best.verdict == "proved":
                return best
    if not trials and slopes is None:
        reason = "no polynomial decreases at all samples close to the equilibrium"
        if linear.verdict == "marginal":
            reason = f"{linear.reason}, which decides nothing, and {reason}"
        return StabilityResult("unknown", reason)
    simplest = trials[0]
    trials.sort(key=lambda trial: -trial[0].volume * (trial[1].level > 0))
    # first the function that is easiest to prove, then those with the largest regions, then what was not tried yet
    largest = [trial for trial in trials[:_TRIED] if trial is not simplest]
    others = [trial for trial in trials[_TRIED:] if trial is not simplest]
    tried = int(best is not None)
    for k, (candidate, bound) in enumerate([simplest, *largest, *others][tried:], start=tried):
        rest = until - time.process_time()
        if best is not None and (rest <= 0 or (best.verdict == "proved" and (first or k > len(largest)))):
            break
        if best is not None and best.verdict == "proved" and candidate.volume <= _GAIN * best.volume:
            continue  # even its whole falsified region is hardly larger than what is proved
        share = rest if k == len(largest) + len(others) else (_HALF if k else _MOST) * rest
        result = search.proved(candidate, bound, share, start=_FIRST if k else _SIMPLE, once=first)
        if best is None or (result.verdict == "proved", result.volume) > (best.verdict == "proved", best.volume):
            best = result
    assert best is not None
    rest = until - time.process_time()
    if best.verdict == "unknown" and level is None and rest > 0 and slopes is None:
        result = search.proved(*simplest, rest, start=_EASY, once=first)
        best = result if result.verdict == "proved" else best
    rest = until - time.process_time()
    if best.verdict == "unknown" and searched and not hard and rest > 0:
        slopes = search.by_slopes(rest)
    if slopes is not None and (best.verdict == "unknown" or slopes.volume > best.volume):
        best = slopes
    if function is not None and best.verdict == "unknown" and linear.verdict == "marginal":
        best = replace(best, reason=f"{best.reason}; {linear.reason}")
    return best


_CLOSE = {"flat": "V' is only semidefinite", "decrease": "V does not decrease close to the equilibrium"}
_SHIFTED = "the equilibrium moves with the parameters, and the slope rule, which serves then, finds no region"
_JUMPS = "may jump (if_else, select), for which no rule has a proof: write limits with fmin and fmax"


def unprovable(dynamics: Dynamics) -> str:
    """Return why no proof of a region can be found, whatever its function; empty if nothing is known.

    The dynamics jump between sampling instants.
    """
    d = dynamics
    flow = d.rates if d.sampling is None else tuple(d.sampling.flow.values())
    return f"the dynamics {_JUMPS}" if not d.discrete and _jumps(flow) else ""


def _jumps(expressions: tuple[Node, ...]) -> bool:
    return any(node.op == "select" for node in ordered(*expressions))


@dataclass(frozen=True, eq=False)
class _Search:
    dynamics: Dynamics
    linear: Linear
    rate: float | None
    level: float | None
    seed: int
    say: Callable[[str], None]

    def bound(self, candidate: Candidate, more: str = "") -> Falsified:
        bound = least_level(self.dynamics, candidate.function, self.rate, seed=self.seed)
        self.say(f"{candidate.label}: counterexample at level {bound.level:.4g}{more}")
        return bound

    def by_slopes(self, seconds: float) -> StabilityResult | None:
        """Return a region that the slope rule proves; None if it proves none."""
        d = self.dynamics
        candidate = slope_candidate(d, self.linear, self.rate, seconds=_SLOPES * seconds)
        if candidate is None:
            return None
        until = time.process_time() + _PROOF * seconds
        p = form_of(candidate.function, d.names)
        for wide in _SAFE:
            level = d.inner_level(p, wide)
            if not level > 0:  # nor is a smaller one
                self.say(f"{candidate.label}: no region is found that contains the equilibria of all parameters")
                break
            cover = np.asarray(np.linalg.inv(p)[None], dtype=float)
            tight = enclosing(d, cover, wide) if d.shifts else hugged(d, candidate.function, level)
            radii = {name: d.shifts[name] for name in d.names if d.shifts}
            claim = Stability(tight, candidate.function, level, self.rate, radii)
            trial = prove_by_slopes(claim, time_limit=until - time.process_time(), feedbacks=candidate.feedbacks)
            self.say(f"{candidate.label}: level {level:.4g} {trial.verdict} {trial.reason}")
            if trial.verdict == "proved":
                # only figures of a page: for many states, the search takes longer than the proof
                bound = self.bound(candidate) if len(d.states) <= _SOME and not d.shifts else None
                volume = candidate.volume * level ** (len(d.states) / 2)
                return StabilityResult("proved", "", trial, bound, candidate.label, volume)
            if time.process_time() > until:
                break
        return None

    def failure(self, function: Node) -> Failure | None:
        """Return a state close to the equilibrium at which the stated function fails, for any level."""
        failure = fails_nearby(self.dynamics, function, self.rate, self.linear)
        if failure is not None or self.rate is not None:
            return failure
        still = stationary_state(Stability(self.dynamics, function, 1e300))
        if still is None:
            return None
        reason = f"V does not change on a line through the equilibrium, such as at {point_text(still)}"
        centre = f"; {self.linear.reason}" if self.linear.verdict == "marginal" else ""
        return Failure(reason + centre, still)

    def instead(self, function: Node, seconds: float) -> str:
        """Return a function near the stated one, and its level, that prove a region, in words; empty if none does."""
        if self.linear.verdict != "stable" or too_fast(self.dynamics, self.linear, self.rate):
            return ""
        for candidate in strict_variants(self.dynamics, self.linear, function):
            bound = self.bound(candidate)
            if bound.level > 0:
                result = replace(self, level=None).proved(candidate, bound, seconds, start=_SIMPLE, once=True)
                if result.claim is not None and result.verdict == "proved":
                    return f'function = "{text_of(result.claim.function)}", level = {result.claim.level:g}'
                return ""
        return ""

    def proved(
        self, candidate: Candidate, bound: Falsified, seconds: float, *, start: int, once: bool
    ) -> StabilityResult:
        """Return the largest level that is proved, of some shares of the least level with a counterexample."""
        until, d = time.process_time() + seconds, self.dynamics
        if not bound.level > 0:
            reason = "V is not positive in the box" if bound.level < 0 else _CLOSE[bound.cause]
            return StabilityResult("unknown", reason, None, bound, candidate.label)
        stated = self.level is not None
        levels = [self.level or short(share * bound.level, digits=4) for share in ((1.0,) if stated else _SHARES)]
        decision: Decision | None = None
        proved: Decision | None = None
        low, high, k = -1, len(levels), min(start, len(levels) - 1)
        while low < k < high and (left := until - time.process_time()) > 0:
            # a proof that fails takes all its time, so each level leaves time for the next one
            part = _WHOLE if start == _SIMPLE and proved is None else _PART
            share = left if k == 0 and proved is None else part * left
            around = d if stated else hugged(d, candidate.function, levels[k])
            claim = Stability(around, candidate.function, levels[k], self.rate)
            # a level below the least one with a counterexample need not be refuted again
            # and a lower level is easier to prove than other bounds at this one
            if stated:
                trial = decide_motion(claim, time_limit=share, seed=self.seed)
            else:
                trial = prove_motion(claim, time_limit=share, seed=self.seed, most=2 if k == 0 else 1)
            self.say(f"{candidate.label}: level {levels[k]:.4g} {trial.verdict} {trial.reason}")
            if trial.verdict == "proved":
                proved, low = trial, k
                if once:
                    break
                # the largest level first, then between
                k = high - 1 if high == len(levels) else (low + high) // 2
            else:
                decision, high = trial, k
                k = k // 2 if proved is None else (low + high) // 2
        if proved is not None:
            volume = candidate.volume * (levels[low] / bound.level) ** (len(d.states) / 2)
            return StabilityResult("proved", "", proved, bound, candidate.label, volume)
        reason = "the time limit was reached before any level was tried" if decision is None else decision.reason
        refuted = stated and decision is not None and decision.verdict == "refuted"
        return StabilityResult("refuted" if refuted else "unknown", reason, decision, bound, candidate.label)
