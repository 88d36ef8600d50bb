"""What is proved about dynamics where a claim is not: a lower level, a lower rate, narrower ranges, a smaller box."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from surctl.lyapunov.claims import every_digit
from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.equilibrium import linearisation
from surctl.lyapunov.problem import Problem
from surctl.lyapunov.search import find_stability

__all__ = ["NextStep", "next_step"]


class NextStep(NamedTuple):
    """What is proved instead of a claim, as entries of its file, and what is not proved either."""

    instead: str
    tried: tuple[str, ...]


def next_step(problem: Problem, *, seconds: float, seed: int = 0) -> NextStep:
    """Return the first weaker claim about a region of attraction that is proved.

    Args:
        problem: a problem of kind `lyapunov` whose claim is not decided.
        seconds: processor time of all attempts [s].
        seed: seed of the random numbers.
    """
    if linearisation(problem.dynamics).verdict != "stable":
        return NextStep("", ())  # no quadratic function exists, so the attempts would fail too
    trials = list(_weaker(problem))
    for number, (words, one) in enumerate(trials):
        result = find_stability(
            one.dynamics, function=one.function, level=one.level, rate=one.rate, first=True,
            time_limit=seconds / len(trials), seed=seed,
        )  # fmt: skip
        if result.verdict == "proved" and result.claim is not None:
            level = f"level = {every_digit(result.claim.level)}"
            text = words if one.function is None or one.level is not None else f"{words}, {level}" if words else level
            return NextStep(text, tuple(tried for tried, _ in trials[:number]))
    return NextStep("", tuple(words or "a lower level" for words, _ in trials))


def _weaker(problem: Problem) -> Iterator[tuple[str, Problem]]:
    if problem.level is not None:
        yield "", replace(problem, level=None)
    if problem.rate is not None:
        yield f"rate = {problem.rate / 4:.4g}", replace(problem, rate=problem.rate / 4)
    d = problem.dynamics
    if any(p.lower < p.upper for p in d.parameters):
        middle = _shrunk(d)
        ranges = ", ".join(f"{p.name} in [{p.lower:.4g}, {p.upper:.4g}]" for p in middle.parameters)
        yield ranges, replace(problem, dynamics=middle)
    if problem.function is None:
        bounds = {s.name: ((s.lower + s.equilibrium) / 2, (s.upper + s.equilibrium) / 2) for s in d.states}
        box = ", ".join(f"{name} in [{low:.4g}, {high:.4g}]" for name, (low, high) in bounds.items())
        yield box, replace(problem, dynamics=d.on(bounds))


def _shrunk(d: Dynamics) -> Dynamics:
    # every parameter in the middle half of its range
    halves = [replace(p, lower=(3 * p.lower + p.upper) / 4, upper=(p.lower + 3 * p.upper) / 4) for p in d.parameters]
    return replace(d, parameters=tuple(halves))
