"""Solve a problem: what its file leaves open, the time limit, a weaker claim instead, the extent of a region."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from surctl.errors import InputError
from surctl.lyapunov.barrier_search import decide_safety, find_barrier
from surctl.lyapunov.claims import Bound, Safety, Stability, every_digit
from surctl.lyapunov.decide import Decision, decide_motion
from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.equilibrium import at_equilibrium, equilibria, linearisation
from surctl.lyapunov.from_system import HELD_COMMANDS, NOT_COVERED
from surctl.lyapunov.problem import Problem
from surctl.lyapunov.rays import farthest
from surctl.lyapunov.sampled import SampledStability
from surctl.lyapunov.search import find_stability, unprovable
from surctl.verification.formula import parse, text_of, values_of
from surctl.verification.formula.parser import LONGEST, clipped, decimal_text

# What is proved about dynamics where a claim is not: a lower level, a lower rate, narrower ranges, a smaller box


def _next_step(problem: Problem, *, seconds: float, seed: int = 0) -> tuple[str, list[str]]:
    """Return the first weaker claim about a region of attraction that is proved, and those that are not.

    Args:
        problem: a problem of kind `lyapunov` whose claim is not decided.
        seconds: processor time of all attempts [s].
        seed: seed of the random numbers.
    """
    if linearisation(problem.dynamics).verdict != "stable":
        return "", []  # no quadratic function exists, so the attempts would fail too
    trials = list(_weaker(problem))
    for number, (words, one) in enumerate(trials):
        result = find_stability(
            one.dynamics, function=one.function, level=one.level, rate=one.rate, first=True,
            time_limit=seconds / len(trials), seed=seed,
        )  # fmt: skip
        if result.verdict == "proved" and result.claim is not None:
            level = f"level = {every_digit(result.claim.level)}"
            text = words if one.function is None or one.level is not None else f"{words}, {level}" if words else level
            return text, [tried for tried, _ in trials[:number]]
    return "", [words or "a lower level" for words, _ in trials]


def _weaker(problem: Problem) -> Iterator[tuple[str, Problem]]:
    if problem.level is not None:
        yield "", replace(problem, level=None)
    if problem.rate is not None:
        yield f"rate = {problem.rate / 4:.4g}", replace(problem, rate=problem.rate / 4)
    d = problem.dynamics
    if any(p.lower < p.upper for p in d.parameters):
        # every parameter in the middle half of its range
        ends = [((3 * p.lower + p.upper) / 4, (p.lower + 3 * p.upper) / 4) for p in d.parameters]
        halves = [replace(p, lower=low, upper=high) for p, (low, high) in zip(d.parameters, ends, strict=True)]
        middle = replace(d, parameters=tuple(halves))
        ranges = ", ".join(f"{p.typed or p.name} in [{p.lower:.4g}, {p.upper:.4g}]" for p in middle.parameters)
        yield ranges, replace(problem, dynamics=middle)
    if problem.function is None:
        smaller = d.on({s.name: ((s.lower + s.equilibrium) / 2, (s.upper + s.equilibrium) / 2) for s in d.states})
        box = ", ".join(f"{s.typed or s.name} in [{s.lower:.4g}, {s.upper:.4g}]" for s in smaller.states)
        yield box, replace(problem, dynamics=smaller)


_HELD = 1e-9  # largest distance of a state that is held in a proof from its value there
_HELP, _HELP_MOST = 0.2, 10.0  # share of the time limit for weaker claims, and the most [s]
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
        counterexample: values of the variables where a condition of the claim fails; empty unless the verdict is
            `refuted`, or if the linearisation refutes it.
        instead: what is proved in the place of a refuted function or an undecided claim, as entries of the file; empty
            if nothing is known.
    """

    problem: Problem
    verdict: Literal["proved", "refuted", "unknown"]
    reason: str
    decision: Decision | None
    falsified: float | None
    origin: str
    seconds: float
    counterexample: Mapping[str, float] = field(default_factory=dict)
    instead: str = ""
    cause: str = ""

    @property
    def document(self) -> Mapping[str, Any]:
        """The certificate; empty unless the verdict is `proved`."""
        return self.decision.document if self.decision is not None and self.verdict == "proved" else {}

    @property
    def level(self) -> float | None:
        """Level of the claim about a region; None if no function was found, or the claim has no level."""
        return None if self.decision is None else self.decision.claim.plain().get("level")

    @property
    def sampled(self) -> bool:
        """Whether the claim is about a sampled loop, with held commands, and not about the law in continuous time."""
        return self.decision is not None and isinstance(self.decision.claim, SampledStability)

    @property
    def fallback(self) -> bool:
        """Whether the claim is about the law in continuous time, because none about the sampled loop is proved."""
        stated = self.problem.dynamics.sampling is None or self.problem.function or self.problem.level
        return self.decision is not None and self.about.startswith(NOT_COVERED) and not stated

    @property
    def about(self) -> str:
        """What the claim is about, and what it does not cover."""
        return HELD_COMMANDS if self.sampled else self.problem.dynamics.source

    @property
    def vacuous(self) -> str:
        """Why a proved claim says nothing, as the checker finds; empty if it says something."""
        return self.decision.vacuous if self.decision is not None and self.verdict == "proved" else ""

    def lines(self) -> list[str]:
        """Return the lines that state the solution: verdict and claim, what the claim is about, reason."""
        name, decision = self.problem.dynamics.name, self.decision
        if decision is not None and self.about.startswith(NOT_COVERED):
            remedy = " (try to prove the sampled loop: smaller box or shorter control period)" * self.fallback
            name += f", law in continuous time, without sampling{remedy}"
        then = [f"  a region is proved with {self.instead}"] if self.instead else []
        if decision is None:
            lines = [f"{self.verdict:<8} {name}: {self.reason} ({self.seconds:.1f} s)"]
            if self.problem.function is not None:
                lines.append(f"  {'B' if self.problem.kind == 'barrier' else 'V'} = {text_of(self.problem.function)}")
            return [*lines, *stated_lines(self.problem.dynamics, self.problem.kind), *then]
        claim, first = decision.claim, decision.claim.statement
        letter = "B" if claim.kind == "barrier" else "V"
        pairs = zip(self.extent.items(), self.problem.dynamics.states, strict=False)
        if reached := ", ".join(_range_text(label, *ends, s.unit) for (label, ends), s in pairs):
            name += f" ({reached})"
        if self.verdict != "proved":
            fate = "is refuted" if self.verdict == "refuted" else "is neither proved nor refuted"
            first = f"the claim that {first} {fate}{f': {self.reason}' * bool(self.reason)}"
        elif self.vacuous:
            first = f"vacuous, because {self.vacuous}: {first}"
        origin = f", from: {self.origin}" if self.origin else ""
        lines = [
            f"{self.verdict:<8} {name}: {first} ({self.seconds:.1f} s)",
            f"  {letter} = {clipped(text_of(claim.function), LONGEST)}{origin}",
            *stated_lines(claim.dynamics, claim.kind, sampled=self.sampled, radii=getattr(claim, "radii", None)),
        ]
        if self.falsified is not None and self.verdict == "proved" and self.level is not None:
            share = self.level / self.falsified
            least = "at which the region leaves the box" if self.cause == "face" else "with a counterexample"
            lines.append(f"  level {self.level:g} is {100 * share:.1f} % of the least level {least}")
        if decision.rule and self.verdict == "proved":
            lines.append(f"  proved by {decision.rule}")
        return [*lines, *then]

    @cached_property
    def extent(self) -> Mapping[str, tuple[float, float]]:
        """Least and largest value of each state in a proved region, by label; empty without a region."""
        claim = self.decision.claim if self.decision is not None and self.document and not self.vacuous else None
        if not isinstance(claim, Stability | Bound):
            return {}
        d = claim.dynamics
        ends = d.equilibrium + np.array([[-1.0], [1.0]]) * farthest(d, claim.function, claim.level)
        return {s.typed or s.name: (low, high) for s, low, high in zip(d.states, *ends.tolist(), strict=True)}

    def value(self, state: ArrayLike) -> float:
        """Return V of a system's region at a state of plant and controller, flat; NaN if its loop is not known.

        The value is infinite outside the box, and where a state that is held in the proof has another value.
        """
        about = self.problem.dynamics.about
        if self.decision is None or not about:
            return float("nan")
        claim, entries = self.decision.claim, [*about["plant_state"], *about["controller_state"]]
        pairs = list(zip(entries, np.ravel(state).tolist(), strict=True))
        at = {entry: x for entry, x in pairs if isinstance(entry, str)}
        value = float(values_of([claim.function], {name: np.array([x]) for name, x in at.items()})[0, 0])
        held = all(abs(x - entry) <= _HELD for entry, x in pairs if entry not in at)
        inside = all(s.lower <= at[s.name] <= s.upper for s in self.problem.dynamics.states)
        return value if held and inside else float("inf")

    @property
    def dynamics(self) -> Dynamics:
        """The dynamics of the claim in the whole box of the problem; a searched region is proved in a smaller box.

        Only those of a claim about a sampled loop have its sampled form.
        """
        whole = {s.name: (s.lower, s.upper) for s in self.problem.dynamics.states}
        d = self.problem.dynamics if self.decision is None else self.decision.claim.dynamics.on(whole)
        return d if self.sampled else replace(d, sampling=None)

    def to_dict(self) -> dict[str, Any]:
        """Return the solution as plain data for JSON."""
        decided = {} if self.decision is None else self.decision.to_dict()
        claim = {} if self.decision is None else self.decision.claim.plain()
        return {
            **decided,
            "claim": self.problem.dynamics.name,
            "verdict": self.verdict,
            "reason": self.reason or None,
            "counterexample": dict(self.counterexample) or None,
            "instead": self.instead or None,
            "vacuous": self.vacuous or None,
            "rule": self.decision.rule or None if self.decision is not None else None,
            "equilibrium": {s.name: s.equilibrium for s in self.problem.dynamics.states},
            "radius": claim.get("radius"),
            "level": claim.get("level"),
            "extent": {label: list(pair) for label, pair in self.extent.items()} or None,
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
        time_limit: limit of the processor time [s]. The last fifth of it, at most 10 s, is for weaker claims, if one
            about a region is not decided, to name one that is proved.
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
    helped = min(_HELP * time_limit, _HELP_MOST) if problem.kind == "lyapunov" else 0.0
    solution = _solved(problem, first, time_limit - helped, seed, progress)
    if solution.verdict != "unknown" or problem.kind != "lyapunov":
        return solution
    if why := unprovable(solution.problem.dynamics):
        return replace(solution, reason=why)
    began = time.perf_counter()
    instead, tried = _next_step(solution.problem, seconds=helped, seed=seed)
    reason = solution.reason
    if tried:
        reason += f"; not proved either: {'; '.join(tried)}"
    if not instead:
        reason += f"; the search may take {time_limit:g} s of processor time"
    seconds = solution.seconds + time.perf_counter() - began
    return replace(solution, reason=reason, instead=instead, seconds=seconds)


def _solved(
    problem: Problem, first: bool, time_limit: float, seed: int, progress: Callable[[str], None] | None
) -> Solution:
    began = time.perf_counter()
    if problem.sought:
        problem = replace(problem, dynamics=at_equilibrium(problem.dynamics, seed=seed))
    if problem.kind == "lyapunov" and (moving := _moving(problem.dynamics)):
        rest = {s.name: float(s.equilibrium) for s in problem.dynamics.states}
        return Solution(problem, "refuted", moving, None, None, "", time.perf_counter() - began, rest)
    claim = problem.claim
    if claim is not None:
        if isinstance(claim, Safety):
            decision = decide_safety(claim, time_limit=time_limit, seed=seed, progress=progress)
        else:
            decision = decide_motion(claim, time_limit=time_limit, seed=seed, progress=progress)
        return _solution(problem, decision, decision.seconds)
    if problem.kind == "lyapunov":
        result = find_stability(
            problem.dynamics, function=problem.function, rate=problem.rate, first=first, time_limit=time_limit,
            seed=seed, progress=progress,
        )  # fmt: skip
        falsified, cause = (None, "") if result.falsified is None else (result.falsified.level, result.falsified.cause)
        origin = result.label if problem.function is None else ""
        return Solution(
            problem, result.verdict, result.reason, result.decision, falsified, origin, time.perf_counter() - began,
            result.counterexample or (result.decision.counterexample if result.decision else {}), result.instead, cause,
        )  # fmt: skip
    if problem.function is not None:
        return _with_multiplier(problem, time_limit, seed, progress)
    barrier = find_barrier(
        problem.dynamics, problem.initial, problem.unsafe, time_limit=time_limit, seed=seed, progress=progress
    )
    verdict: Literal["proved", "unknown"] = "proved" if barrier.verdict == "proved" else "unknown"
    tried = ", ".join(barrier.tried) or "at the samples, no polynomial of degree 4 or lower meets the conditions"
    limit = f"the search may take {time_limit:g} s of processor time"
    reason = "" if verdict == "proved" else f"no barrier was found: {tried}; {limit}"
    seconds = time.perf_counter() - began
    return Solution(problem, verdict, reason, barrier.decision, None, "linear program over samples", seconds)


def _solution(problem: Problem, decision: Decision, seconds: float) -> Solution:
    return Solution(problem, decision.verdict, decision.reason, decision, None, "", seconds, decision.counterexample)


def _moving(d: Dynamics) -> str:
    """Return why the equilibrium is none, with those of the box; empty if it is one up to rounding."""
    d.require_equilibrium()
    try:
        d.require_rest()
    except InputError as error:
        if "is not an equilibrium" not in error.problem:
            raise
        at = ", ".join(f"{s.name} = {s.equilibrium:g}" for s in d.states)
        others = "; ".join(", ".join(f"{n} = {v:.9g}" for n, v in zip(d.names, x, strict=True)) for x in equilibria(d))
        known = f"; in the box, equilibria are {others}" if others else ""
        return f"{at} is not an equilibrium: the largest rate there is {error.value}{known}"
    return ""


def _range_text(label: str, low: float, high: float, unit: str) -> str:
    """Return a range with three digits of its width."""
    decimals = 2 - int(np.floor(np.log10(high - low)))
    return f"{label} {round(low, decimals):.10g} to {round(high, decimals):.10g}{f' {unit}' * (unit != '1')}"


def stated_lines(
    d: Dynamics, kind: str, *, sampled: bool = False, radii: Mapping[str, float] | None = None
) -> list[str]:
    """Return the dynamics, the box and the equilibrium as the certificate states them, as indented lines."""
    sign = "+" if d.discrete else "'"
    rows = [(f"{s.name}{sign}", rate) for s, rate in zip(d.states, d.rates, strict=True)]
    if sampled and d.sampling is not None:
        rows = [(command.name, command.value) for command in d.sampling.commands]
        rows += [(f"{name}+", node) for name, node in d.sampling.next.items()]
        rows += [(f"{name}'", node) for name, node in d.sampling.flow.items()]
    lines = [f"  {name} = {clipped(text_of(node))}" for name, node in rows]
    ranges = ", ".join(f"{v.name} in [{every_digit(v.lower)}, {every_digit(v.upper)}] {v.unit}" for v in d.variables)
    lines.append(f"  where {ranges}")
    if kind == "lyapunov":
        near = {name: f" ± {radius:g}" for name, radius in (radii or {}).items()}
        texts = (f"{s.name} = {clipped(decimal_text(s.rest))}{near.get(s.name, '')}" for s in d.states)
        lines.append(f"  equilibrium {', '.join(texts)}")
    return lines


def _with_multiplier(
    problem: Problem, time_limit: float, seed: int, progress: Callable[[str], None] | None
) -> Solution:
    """Try several multipliers of a stated barrier; B' ≤ λ B fails for all of them only if the last one is refuted."""
    began = time.perf_counter()
    decision = None
    for text in _MULTIPLIERS:
        claim = replace(problem, multiplier=parse(text, {})).claim
        assert isinstance(claim, Safety)
        decision = decide_safety(claim, time_limit=time_limit / len(_MULTIPLIERS), seed=seed, progress=progress)
        refutes = decision.verdict == "refuted" and "change of B" not in decision.reason
        if decision.verdict == "proved" or refutes:
            return _solution(problem, decision, time.perf_counter() - began)
    assert decision is not None
    reason = f"no multiplier of {', '.join(_MULTIPLIERS)} proves the claim; {decision.reason}"
    return Solution(problem, "unknown", reason, decision, None, "", time.perf_counter() - began)
