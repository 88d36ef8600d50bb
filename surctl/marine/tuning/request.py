"""The request of a search for gains: tuned gains and ranges, claims to hold, derived starts, provenance written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from surctl import __version__
from surctl.errors import EmptyDomain, InputError, check_known
from surctl.marine.control import PATH_FOLLOWING, Gains, law_options, law_source, write_gains
from surctl.marine.simulation import STOPS, Case, simulate_batch
from surctl.marine.tuning.derived import DEPENDENT, derive_gains
from surctl.marine.tuning.evaluation import check_goals, figures, fresh
from surctl.marine.tuning.goals import Goal
from surctl.marine.tuning.sweep import law_digest
from surctl.marine.verification.library import claims
from surctl.marine.verification.speeds import speeds_text
from surctl.tuning.cegis import Tuning
from surctl.tuning.chunked import Progress
from surctl.tuning.design import default_range
from surctl.tuning.outcome import outcome_text
from surctl.tuning.pool import ClaimPoint, Condition, SearchRange, SearchRequest, Sets, row
from surctl.verification.counterexample import evaluate
from surctl.verification.falsifier import falsify
from surctl.verification.verdict import Verdict

TUNED = ("k1", "lookahead", "k_psi", "k_v", "k_r", "kappa", "reaction", "brake")
"""Gains that are tuned if no gain is named: they shape the motion and do not describe the sensors."""


@dataclass(frozen=True)
class GainRange(SearchRange):
    """One tuned gain and its search range low … high, which includes both ends.

    `below` is the largest value that the gain may have, `zero` whether it may be 0.

    Raises:
        InputError: the ends are not 0 < low < high ≤ below, or low is 0 and the gain may not be 0.
    """

    below: float = float("inf")
    zero: bool = False

    def __post_init__(self) -> None:
        key, top = f"--gain {self.name}", self.below
        shown = f"{self.low:g}..{self.high:g}"
        if not (np.isfinite([self.low, self.high]).all() and 0 <= self.low < self.high):
            least = "0 ≤" if self.zero else "0 <"
            raise InputError("is not a range", key=key, value=shown, remedy=f"write LOW..HIGH with {least} LOW < HIGH")
        if self.low == 0 and not self.zero:
            problem = "begins at 0, and the gain must be greater"
            raise InputError(problem, key=key, value=shown, remedy="raise the lower end")
        if self.high > top:
            raise InputError(f"is above its bound of {top:.3g}", key=key, value=self.high, remedy="lower the upper end")


def gain_ranges(
    base: Gains, ranges: Mapping[str, tuple[float, float] | None] | Sequence[str] = TUNED
) -> tuple[GainRange, ...]:
    """Return the gains to tune, with their ranges.

    Args:
        base: gains that set the default ranges: a quarter of the value to four times the value, within the bounds of
            the gain.
        ranges: mapping from gain name to (low, high), or to None for the default range; or a sequence of gain names,
            which all get their default range.

    Raises:
        InputError: no gain is named, a gain is unknown, a range is not valid, or a gain of 0 has no range.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.tuning import gain_ranges
        >>> for gain in gain_ranges(load_gains("default"), {"k_v": None, "lookahead": (0.4, 1.2)}):
        ...     print(gain.name, gain.low, gain.high)
        k_v 0.375 6.0
        lookahead 0.4 1.2
    """
    table = ranges if isinstance(ranges, Mapping) else dict.fromkeys(ranges)
    if not table:
        raise InputError("nothing is tuned", key="--gain", remedy="name at least one gain")
    for name in table:
        check_known(name, base.specs, "no such gain", key="--gain")
    stated = ((name, ends or _default(name, base)) for name, ends in table.items())
    specs = base.specs
    return tuple(
        GainRange(name, low, high, specs[name].below, specs[name].zero_allowed) for name, (low, high) in stated
    )


def default_tuned(base: Gains) -> tuple[str, ...]:
    """Return the names of the gains that are tuned if no gain is named.

    If the law defines additional gains, these are tuned together with the gains of the velocity loops; otherwise the
    gains in `TUNED` are tuned.
    """
    # not what follows from the vehicle, nor a gain that may be 0, which is a choice; it is tuned if it is named
    own = [name for name in base.own if name in base.specs and base.ranges.get(name, (1.0, 1.0))[0] > 0]
    return (*own, "k_v", "k_r") if base.own else TUNED


def _default(name: str, base: Gains) -> tuple[float, float]:
    if name in base.own and name in base.ranges:
        return base.ranges[name]
    low, high = default_range(name, base[name])
    return low, min(high, base.specs[name].below)


@cache
def expected_to_hold() -> tuple[str, ...]:
    """Names of the paper's claims that should not be refuted; claims about braking need a vehicle and are omitted."""
    return tuple(claim.name for claim in claims() if claim.paper and claim.expected != "refuted")


def refuted_claims(gains: Mapping[str, float], cases: Sequence[Case], *, seed: int = 0) -> tuple[Verdict, ...]:
    """Return the verdicts of the claims that should hold but are refuted with these gains.

    The claims are about path following by equations (8)-(12): there are none if no case's law contains it.
    """
    if not any(PATH_FOLLOWING in law_source(case.law).parts and case.guidance == "los" for case in cases):
        return ()
    return _refuted(tuple(sorted(gains.items())), seed)


@lru_cache(maxsize=16)
def _refuted(gains: tuple[tuple[str, float], ...], seed: int) -> tuple[Verdict, ...]:
    # cached, because several rounds may end at the same gains and the falsifier takes seconds
    verdicts = list[Verdict]()
    for claim in claims(dict(gains), expected_to_hold()):
        with suppress(EmptyDomain):  # nothing refutes it
            verdicts.append(falsify(claim, seed=seed))
    return tuple(v for v in verdicts if v.verdict == "refuted")


def _kind(case: Case) -> tuple[str, ...]:
    """Return the options of a case that determine its control law, without those of its perception."""
    return case.law, *law_options(case).values()


@dataclass(frozen=True, eq=False)
class Request(SearchRequest):
    """The request of a search for gains of simulated missions; see `SearchRequest`.

    Attributes:
        base: the start gains; every gain outside the search space keeps its value from them.
    """

    goals: tuple[Goal, ...]
    conditions: tuple[Condition, ...]
    base: Gains
    space: tuple[GainRange, ...]

    @property
    def start(self) -> Mapping[str, float]:
        """Return the start gains by name."""
        return self.base.values

    @property
    def identity(self) -> list[str]:
        """Return lines with everything on which the figures of a gain set depend."""
        lines = [f"law {which} {law_digest(c)}" for which, c in {_kind(c): c for c in self.cases}.items()]
        for case in self.cases:
            model = None if case.model is None else dict(case.model.parameters)
            lines.append(f"case {case.name} {case.scenario!r} {dict(case.vehicle.parameters)!r} {model!r}")
            lines.append(f"law {_kind(case)} {dict(case.gains.values)!r}")
        return lines

    def check(self) -> None:
        """Raise InputError if goals do not fit the conditions."""
        check_goals(self.goals, self.conditions)

    def figures(
        self, goals: Sequence[Goal], conditions: Sequence[Condition], sets: Sets
    ) -> dict[str, NDArray[np.float64]]:
        """Return the metrics of the runs, see `figures`."""
        return figures(goals, conditions, sets, threads=self.threads)

    def ending(self, condition: Condition, gains: Mapping[str, float]) -> str:
        """Return how and when the run of a condition ends with a gain set."""
        values = {name: np.array([value]) for name, value in ({**gains, **condition.plant}).items()}
        batch = simulate_batch(condition.case, values, seeds=np.array([condition.seed]))
        stop, time = (float(np.ravel(batch.column(name))[0]) for name in ("stopped", "time_s"))
        return f"{STOPS[int(stop)]} at {time:.2f} s"

    def fresh(self, *, runs: int, first: int) -> tuple[Condition, ...]:
        """Return random runs, see `fresh`."""
        return fresh(self.cases, runs=runs, first=first, tuning=self.seed)

    def so_far(self, gains: Mapping[str, float], warning: str) -> tuple[str, str]:
        """Return name and text of the gain file of an unfinished tuning."""
        best = self.base.with_values(dict(gains), how="so-far") if gains else self.base
        return BEST, write_gains(best, warning=warning)

    def first_sets(self, progress: Progress = lambda _: None) -> list[dict[str, float]]:
        """Return the gains derived from each vehicle, as the controller knows it, within the search space.

        Gains that do not follow from a vehicle have the start values of the request.
        """
        sets = []
        for case in {c.vehicle.name: c for c in self.cases}.values():
            try:
                gains = derive_gains(case.model or case.vehicle, cruise=case.scenario.cruise, dt=case.build().dt).gains
            except InputError as error:
                # the remedies of the error are about one vehicle; the search needs none, because it has other starts
                progress(f"{case.vehicle.name}: {error.problem}; the search starts without derived gains")
                continue
            values = {**self.base.values, **{name: gains[name] for name in DEPENDENT}}
            sets.append({s.name: s.clip(values[s.name]) for s in self.space})
        return sets

    def refuted_claims(self, gains: Mapping[str, float]) -> tuple[ClaimPoint, ...]:
        """Return points at which claims that should hold fail with these gains."""
        failing = refuted_claims({**self.start, **gains}, self.cases, seed=self.seed)
        return tuple(
            ClaimPoint(v.claim.name, dict(v.counterexample.values), v.threshold) for v in failing if v.counterexample
        )

    def excess(self, sets: Sets) -> NDArray[np.float64]:
        """Return by how much the claims exceed their thresholds at their points, (n gain sets, claims)."""
        count = len(next(iter(sets.values())))
        table = np.full((count, len(self.claims)), -1.0)  # for a point outside the claim's domain
        for k in range(count if self.claims else 0):
            gains = {**self.start, **row(sets, k)}
            for j, point in enumerate(self.claims):
                margin, inside = evaluate(claims(gains, [point.name])[0], point.values)
                if inside:
                    table[k, j] = margin - point.threshold
        return table


BEST = "best-so-far.toml"
"""Name of the gain file that an unfinished tuning leaves in its folder."""


def tuned_gains(tuning: Tuning) -> Gains:
    """Return the tuned gains and, as provenance, the goals, seeds, version, rounds and result of the tuning.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, Request, build_cases, conditions, gain_ranges, tuned_gains
        >>> from surctl.tuning import tune
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> request = Request((Goal("soon", "time_s", "s", 20.0),), runs, gains, gain_ranges(gains, ["k_v"]))
        >>> tuning = tune(request, trials=8, rounds=1, runs=0)
        >>> tuned = tuned_gains(tuning)
        >>> tuned.name, tuned["k_v"] > gains["k_v"], tuned["lookahead"] == gains["lookahead"]
        ('default-tuned', True, True)
        >>> print(tuned.provenance)
        chosen by hand for the built-in law, ...; tuned by surctl ...goals: soon: ...; not verified by fresh runs
    """
    request = tuning.request
    bounds = "; ".join(
        f"{g.name}: {g.over} {g.metric} {g.sense} {g.limit:g} {g.unit} ({g.kind})"
        + (f" at {speeds_text(g.cruise)}" if g.cruise else "")
        for g in request.goals
    )
    requested = request.conditions[: tuning.requested]
    seeds = sorted({c.seed for c in requested})
    cases = ", ".join(dict.fromkeys(c.case.name for c in requested))
    text = (
        f"{request.base.provenance}; tuned by surctl {__version__} from gains {request.base.name}, "
        f"request {request.digest[:16]}, search seed {request.seed}, {len(tuning.rounds)} round(s), "
        f"{len(requested)} runs over {cases} with seeds {seeds[0]} to {seeds[-1]} and "
        f"{len(request.conditions) - tuning.requested} counterexamples; goals: {bounds}; {outcome_text(tuning)}"
    )
    base: Gains = request.base
    return base.with_values(dict(tuning.result.gains), provenance=text, how="tuned")
