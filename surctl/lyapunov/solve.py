"""Decide a problem: prove or refute its claim, after finding the function, level or barrier that it leaves open."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from surctl.lyapunov.barrier_search import find_barrier
from surctl.lyapunov.decide import Decision, decide_motion
from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.problem import Problem
from surctl.lyapunov.search import find_stability
from surctl.verification.formula import parse, text_of

__all__ = ["Solution", "solve"]

_MULTIPLIERS = ("0", "-1", "-0.1", "1", "-10")


@dataclass(frozen=True, eq=False)
class Solution:
    """The answer to a problem.

    Attributes:
        problem: the problem.
        verdict: `proved`, `refuted` or `unknown`.
        reason: why the verdict is not `proved`, in one sentence; empty if it is.
        decision: the decision on the claim that was stated or found; None if no function was found.
        falsified: least level of the function at which a counterexample is known; None if it was not searched.
        origin: how the function was found; empty if the problem states it.
        seconds: duration [s].
    """

    problem: Problem
    verdict: Literal["proved", "refuted", "unknown"]
    reason: str
    decision: Decision | None
    falsified: float | None
    origin: str
    seconds: float

    @property
    def document(self) -> Mapping[str, Any]:
        """The certificate; empty unless the verdict is `proved`."""
        return self.decision.document if self.decision is not None and self.verdict == "proved" else {}

    @property
    def counterexample(self) -> Mapping[str, float]:
        """Values of the variables where an inequality of the claim fails; empty unless the verdict is `refuted`."""
        return self.decision.counterexample if self.decision is not None and self.verdict == "refuted" else {}

    def lines(self) -> list[str]:
        """Return the lines that state the solution: verdict and claim, function, level, reason."""
        name, decision = self.problem.dynamics.name, self.decision
        if decision is None:
            return [f"{self.verdict:<8} {name}: {self.reason} ({self.seconds:.1f} s)"]
        claim = decision.claim
        letter = "B" if claim.kind == "barrier" else "V"
        lines = [
            f"{self.verdict:<8} {name}: {claim.statement} ({self.seconds:.1f} s)",
            f"  {letter} = {text_of(claim.function)}{f', from: {self.origin}' if self.origin else ''}",
        ]
        level = claim.plain().get("level")
        if self.falsified is not None and self.verdict == "proved" and level is not None:
            share = level / self.falsified
            lines.append(f"  level {level:g} is {100 * share:.1f} % of the least level with a counterexample")
        return [*lines, f"  {self.reason}"] if self.reason else lines

    @property
    def dynamics(self) -> Dynamics:
        """The dynamics of the claim in the whole box of the problem; a searched region is proved in a smaller box."""
        whole = {s.name: (s.lower, s.upper) for s in self.problem.dynamics.states}
        return self.problem.dynamics if self.decision is None else self.decision.claim.dynamics.on(whole)

    def to_dict(self) -> dict[str, Any]:
        """Return the solution as plain data for JSON."""
        decided = {} if self.decision is None else self.decision.to_dict()
        claim = {} if self.decision is None else self.decision.claim.plain()
        return {
            **decided,
            "claim": self.problem.dynamics.name,
            "verdict": self.verdict,
            "reason": self.reason or None,
            "level": claim.get("level"),
            "rate": claim.get("rate"),
            "falsified_level": self.falsified,
            "search": self.origin or None,
            "seconds": self.seconds,
        }


def solve(
    problem: Problem,
    *,
    first: bool = False,
    time_limit: float = 60.0,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Solution:
    """Prove or refute the claim of a problem, and find what the problem leaves open.

    Args:
        problem: the problem. Without `function`, a function is searched; without `level`, the largest level that can be
            proved; without `multiplier` of a stated barrier, several numbers are tried.
        first: whether the first region that is proved is enough.
        time_limit: limit of the processor time [s].
        seed: seed of the random numbers.
        progress: function that receives a line of progress from time to time.

    Raises:
        InputError: the claim cannot be checked; see `decide_motion` and `find_stability`.

    Example:
        >>> from pathlib import Path
        >>> from surctl.lyapunov import load_problem, solve
        >>> _ = Path("cubic.toml").write_text('''
        ... kind = "lyapunov"
        ... name = "cubic"
        ... function = "x^2"
        ... [states]
        ... x = { rate = "-x + x^3", lower = -2, upper = 2 }
        ... ''')
        >>> solution = solve(load_problem(Path("cubic.toml")))
        >>> solution.verdict, round(solution.falsified, 3), solution.decision.claim.level >= 0.9
        ('proved', 1.0, True)
    """
    began = time.perf_counter()
    claim = problem.claim
    if claim is not None:
        decision = decide_motion(claim, time_limit=time_limit, seed=seed, progress=progress)
        return Solution(problem, decision.verdict, decision.reason, decision, None, "", decision.seconds)
    if problem.kind == "lyapunov":
        result = find_stability(
            problem.dynamics, function=problem.function, rate=problem.rate, first=first, time_limit=time_limit,
            seed=seed, progress=progress,
        )  # fmt: skip
        falsified = None if result.falsified is None else result.falsified.level
        origin = result.label if problem.function is None else ""
        return Solution(problem, result.verdict, result.reason, result.decision, falsified, origin, result.seconds)
    if problem.function is not None:
        return _with_multiplier(problem, time_limit, seed, progress)
    barrier = find_barrier(
        problem.dynamics, problem.initial, problem.unsafe, time_limit=time_limit, seed=seed, progress=progress
    )
    verdict: Literal["proved", "unknown"] = "proved" if barrier.verdict == "proved" else "unknown"
    reason = "" if verdict == "proved" else f"no barrier was found ({', '.join(barrier.tried)})"
    seconds = time.perf_counter() - began
    return Solution(problem, verdict, reason, barrier.decision, None, "linear program over samples", seconds)


def _with_multiplier(
    problem: Problem, time_limit: float, seed: int, progress: Callable[[str], None] | None
) -> Solution:
    """Try several multipliers of a stated barrier; B' ≤ λ B fails for all of them only if the last one is refuted."""
    began = time.perf_counter()
    decision = None
    for text in _MULTIPLIERS:
        claim = replace(problem, multiplier=parse(text, {})).claim
        assert claim is not None
        decision = decide_motion(claim, time_limit=time_limit / len(_MULTIPLIERS), seed=seed, progress=progress)
        if decision.verdict == "proved":
            return Solution(problem, "proved", "", decision, None, "", time.perf_counter() - began)
        if decision.verdict == "refuted" and "change of B" not in decision.reason:
            return Solution(problem, "refuted", decision.reason, decision, None, "", time.perf_counter() - began)
    assert decision is not None
    reason = f"no multiplier of {', '.join(_MULTIPLIERS)} proves the claim; {decision.reason}"
    return Solution(problem, "unknown", reason, decision, None, "", time.perf_counter() - began)
