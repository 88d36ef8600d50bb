"""Prove a claim by cases, exact rewriting, interval branch and bound and sums of squares, and write the certificate."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import check_document, seal
from surctl.certcheck.rules import DIMENSIONS, Rules
from surctl.errors import InputError
from surctl.verification.claim import Claim
from surctl.verification.formula import FUNCTIONS, Statement, ordered, text_of
from surctl.verification.proving.forms import (
    Case,
    Form,
    as_written,
    cases_of,
    forms_of,
    statement_of,
    substituted,
)
from surctl.verification.proving.search import BoxTask, SearchResult, corners, search
from surctl.verification.proving.squares import prove_by_squares
from surctl.verification.proving.tape import Tape, build_tape
from surctl.verification.proving.touching import excluded, touches

_ROUNDS = ((100, 0.0), (400, 1e-4), (2_000, 1.0), (20_000, 1.0), (10_000_000, 1.0))
"""The rounds of the search: for each round, the largest number of boxes and the share of the slack that it may use. The
first round tries an exact proof; all forms are tried in short rounds before the last round uses the remaining time."""

_EXACT_ROUNDS = ((100, 0.0), (3_000, 0.0), (10_000_000, 0.0))
"""The rounds without slack: every round repeats the boxes of the one before, so there are few."""

_SHORT, _EXACT_SHORT, _SHARE = 3, 1, 0.5
"""Number of rounds before sums of squares are tried, with and without slack; their share of the remaining time."""

_SIMPLE = 3  # identities by which a polynomial is proved without boxes: without weights, with constraints, and bounds

_FEW = 3  # variables up to which boxes are tried longer, if the claim is not a polynomial

_MANY, _MOST_OF_IT = 1, 0.9
"""With more variables and equality at a point, all boxes around the point are hard: number of boxes to try first, and
share of the remaining time for sums of squares."""

_MOST_SHOWN = 500  # largest number of open boxes that are stored for plots


@dataclass(frozen=True, eq=False)
class Cases:
    """The cases of a proof, or what is left open.

    Attributes:
        cases: entries `cases` of the certificate; empty if the proof is incomplete.
        slack: amount by which the left side may exceed the right side, in the claim's unit; 0 if the proof is exact.
        remaining: description of the part of the domain that the proof does not cover; empty if it is complete.
        open_boxes: the largest unproved boxes; a box is a mapping from variable names to (lower, upper).
        boxes: number of boxes of the proof; if it is incomplete, number of boxes in all attempts at the case that
            failed.
    """

    cases: tuple[dict[str, Any], ...]
    slack: float
    remaining: str
    open_boxes: tuple[dict[str, list[float]], ...] = ()
    boxes: int = 0


@dataclass(frozen=True, eq=False)
class Proof(Cases):
    """The result of an attempted proof.

    Attributes:
        certificate: the certificate for `surctl.certcheck`; None if the proof is incomplete.
        seconds: duration of the attempt [s].
    """

    certificate: dict[str, Any] | None = None
    seconds: float = 0.0


def prove(
    claim: Claim, *, time_limit: float = 20.0, slack: float = 0.0, progress: Callable[[str], None] | None = None
) -> Proof:
    """Try to prove left ≤ right on the claim's whole domain.

    The numbers of the claim have exactly the values of their decimal notation; fractions of π are exact. The prover
    first tries to prove the inequality exactly. If the exact proof fails, the prover tries to prove left ≤ right +
    `slack`, and the certificate states this slack.

    Args:
        claim: the claim.
        time_limit: limit of the processor time [s]; other load on the machine therefore does not change the verdict.
        slack: largest excess of the left side over the right side that counts as rounding, in the claim's unit.
        progress: function that receives a line of progress from time to time.

    Raises:
        InputError: the time limit is not positive, or the slack is negative or not finite.

    Example:
        >>> from surctl.marine.verification import claims
        >>> from surctl.verification import prove
        >>> [claim] = claims(names=["m-norm-corrected"])
        >>> proof = prove(claim)
        >>> print(claim.statement)
        V̇1 ≤ −λ_min(M)‖e‖² ≤ 0 where U_h ≥ 0
        >>> proof.certificate["kind"], proof.slack, proof.remaining
        ('interval', 0.0, '')
    """
    began = time.perf_counter()
    if not (time_limit > 0 and slack >= 0 and np.isfinite(slack)):
        raise InputError("needs a time above 0 and a slack of at least 0", key=claim.name, value=(time_limit, slack))
    try:
        statement = statement_of(claim)
        texts = [text_of(part) for part in statement.parts]
    except InputError as error:  # an expression is too long, or has an operation that the grammar lacks
        return Proof((), 0.0, error.problem, seconds=time.perf_counter() - began)
    shown = prove_cases(statement, claim.name, time_limit=time_limit, slack=slack, progress=progress)
    units = [v.unit for v in claim.variables]
    about = {"name": claim.name, "statement": claim.statement, "unit": claim.unit}
    certificate = None if shown.remaining else _certificate(statement, texts, shown, about, units)
    return Proof(**vars(shown), certificate=certificate, seconds=time.perf_counter() - began)


def prove_cases(
    statement: Statement,
    name: str,
    *,
    time_limit: float,
    slack: float = 0.0,
    progress: Callable[[str], None] | None = None,
    simply: bool = False,
) -> Cases:
    """Try to prove a statement as `prove`.

    With `simply`, only what takes milliseconds is tried: the whole box, and small sums of squares for polynomials. The
    checker has not confirmed them.
    """
    worked = time.process_time()
    if len(statement.names) > len(DIMENSIONS):
        return Cases((), 0.0, f"more than {len(DIMENSIONS)} variables")
    try:
        parts = substituted(statement)
        cases = [replace(case, touching=statement.touching) for case in cases_of(parts)]
    except InputError as error:
        return Cases((), 0.0, error.problem)
    written = build_tape(statement.names, parts)
    for with_squares in (True, False):
        shown: list[dict[str, Any]] = []
        needed, boxes = 0.0, 0
        for number, case in enumerate(cases):
            share = (time_limit - (time.process_time() - worked)) / (len(cases) - number)
            report = _reporter(f"{name}, case {number + 1} of {len(cases)}", progress)
            try:
                task = _Attempt(case, statement, written, slack)
                done = (task.outside() if case.choice else None) or (
                    task.simple(share) if simply else task.show(share, with_squares=with_squares, report=report)
                )
            except OverflowError:
                return Cases((), 0.0, "a number of the claim is larger than any double: scale the claim")
            boxes += done.result.boxes
            if not done.result.closed:
                return _left_open(statement, written, case, done, boxes)
            needed = max(needed, done.slack)
            shown.append(_written(case, done))
        whole = Cases(tuple(shown), needed, "", (), boxes)
        if simply or not any("squares" in case for case in shown) or _holds(statement, whole):
            return whole
    raise AssertionError("a proof without sums of squares needs no second attempt")


def prove_by_boxes(statement: Statement, *, time_limit: float) -> Cases:
    """Try to prove a statement as it is written, by interval boxes alone: fast for expressions with many branches."""
    box, (left, right, *rows) = (statement.lower, statement.upper), substituted(statement)
    case = Case("", left - right, tuple(rows))
    bound, limits, written = (build_tape(statement.names, p) for p in ([case.margin], rows, [left, right, *rows]))
    with np.errstate(all="ignore"):  # ranges that are not known yet
        result = search(BoxTask(Rules(bound, limits, 0.0), written, box), deadline=time.process_time() + time_limit)
    shown = _Shown(as_written(case), result, 0.0)
    if not result.closed:
        return _left_open(statement, written, case, shown, result.boxes)
    return Cases((_written(case, shown) | {"numerator": None},), 0.0, "", (), result.boxes)


def _holds(statement: Statement, shown: Cases) -> bool:
    """Return whether the checker accepts a proof; facts about functions come from samples, so the checker decides."""
    texts, about = [text_of(part) for part in statement.parts], {"name": "", "statement": "", "unit": "1"}
    return check_document(_certificate(statement, texts, shown, about, ["1"] * len(statement.names))).accepted


def certain_excess(claim: Claim, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a lower bound (k,) of left − right at each point; −inf if the point may lie outside the domain.

    Args:
        claim: the claim.
        points: points (n, k) in the variables' units.

    Raises:
        InputError: the claim has an operation that the claim grammar lacks.
    """
    statement = statement_of(claim)
    within = np.all((statement.lower[:, None] <= points) & (points <= statement.upper[:, None]), axis=0)
    read = build_tape(statement.names, [statement.left - statement.right, *statement.constraints]).run((points, points))
    for jet in read.jets[1:]:
        within &= jet.value[1] <= 0
    for fine in read.defined:
        within &= fine
    return np.where(within, read.jets[0].value[0], -np.inf)


@dataclass(frozen=True, eq=False)
class _Shown:
    """The form and the slack that prove a case, or the best attempt; `squares` if sums of squares prove it."""

    form: Form
    result: SearchResult
    slack: float
    squares: Mapping[str, Any] = field(default_factory=dict)
    tried: str = ""


class _Attempt:
    """A case to prove, with the claim's statement, the instruction list as written, and the slack."""

    def __init__(self, case: Case, statement: Statement, written: Tape, slack: float) -> None:
        self.case, self.statement, self.written, self.slack = case, statement, written, slack
        self.names, self.box = statement.names, (statement.lower, statement.upper)
        self.root = statement.lower[:, None], statement.upper[:, None]
        self.constraints = build_tape(self.names, case.constraints)
        self.plain = as_written(case)

    @cached_property
    def everywhere(self) -> bool:
        """Whether the claim is defined in the whole box."""
        return self.written.total or all(fine[0] for fine in self.written.run(self.root).defined)

    @cached_property
    def polynomial(self) -> bool:
        chosen = ordered(self.case.margin, *self.case.constraints) if self.case.choice else self.written.nodes
        return not any(n.op in FUNCTIONS for n in chosen)

    def show(self, seconds: float, *, with_squares: bool, report: Callable[[int, int], None] | None) -> _Shown:
        """Return the first form and slack that prove the case; otherwise the attempt with the least unproved volume.

        The result of a failed proof counts the boxes of all attempts and gives the reason why the last attempt stopped.
        """
        began = time.process_time()
        case, names, root = self.case, self.names, self.root
        looked, tried = 0, ""
        best: tuple[Form, SearchResult, float] | None = None
        usable = [form for form in forms_of(case, names, root) if _usable(form, names, root)]
        rounds, before = (_ROUNDS, _SHORT) if self.slack else (_EXACT_ROUNDS, _EXACT_SHORT)
        portion = _SHARE
        if not self.slack and case.touching:
            if excluded(case.constraints, case.touching, names, root):
                before = len(rounds) - 1  # without equality, boxes decide sooner than sums of squares
            elif len(names) <= _FEW and not self.polynomial:
                before = _EXACT_SHORT + 1  # sums of squares with sines are large, and few dimensions have few boxes
            elif len(names) > _FEW:
                rounds, portion = ((_MANY, 0.0), *_EXACT_ROUNDS[1:]), _MOST_OF_IT
            usable = [form for form in usable if touches(form.numerator, case.touching, names, root)] or usable
        for number, (most, part) in enumerate(rounds):
            if number == before and with_squares and self.everywhere:
                rest = portion * max(seconds - (time.process_time() - began), 0.0)
                squares = prove_by_squares(case, names, self.box, seconds=rest)
                if squares.form is not None:
                    return _Shown(squares.form, self._leaf("", looked), 0.0, squares.squares)
                tried = squares.tried
            if len(usable) == 1 and before <= number < len(rounds) - 1 and not self.slack:
                continue  # nothing to choose: the last round alone
            volumes = []
            for k, form in enumerate(usable):
                bound = build_tape(names, [form.numerator, *form.denominators])
                rules = Rules(bound, self.constraints, part * self.slack)
                task = BoxTask(rules, self.written, self.box)
                rest = max(seconds - (time.process_time() - began), 0.0)
                # the last round divides the remaining time among the forms
                share = rest / (len(usable) - k if most == rounds[-1][0] else 8 if number == 0 else max(len(usable), 4))
                result = search(task, deadline=time.process_time() + share, most=most, progress=report)
                looked += result.boxes
                if result.closed:
                    return _Shown(form, result, rules.slack)
                volumes.append(_volume(result))
                if best is None or volumes[-1] <= _volume(best[1]):
                    best = form, result, rules.slack
            # the next round begins with the form that left least
            usable = [usable[k] for k in sorted(range(len(usable)), key=lambda k: volumes[k])]
        assert best is not None  # the form as written is always usable
        return _Shown(best[0], replace(best[1], boxes=looked, reason=result.reason), best[2], tried=tried)

    def simple(self, seconds: float) -> _Shown:
        """Return a proof without bisection, or what the whole box leaves open."""
        bound = build_tape(self.names, [self.plain.numerator])
        if self.everywhere and bound.run(self.root).jets[0].value[1][0] <= 0:
            return _Shown(self.plain, self._leaf("n", 1), 0.0)
        if self.everywhere and self.polynomial:
            squares = prove_by_squares(self.case, self.names, self.box, seconds=seconds, most=_SIMPLE)
            if squares.form is not None:
                return _Shown(squares.form, self._leaf("", 1), 0.0, squares.squares)
        return self._whole_box(bound)

    def outside(self) -> _Shown | None:
        """Return the proof of a case whose branches occur nowhere in the box; None unless one box shows it."""
        read = self.constraints.run(self.root)
        if not any(fine[0] and jet.value[0][0] > 0 for jet, fine in zip(read.jets, read.defined, strict=True)):
            return None
        return self._whole_box(self.constraints)

    def _whole_box(self, bound: Tape) -> _Shown:
        task = BoxTask(Rules(bound, self.constraints, 0.0), self.written, self.box)
        return _Shown(self.plain, search(task, deadline=np.inf, most=1), 0.0)

    def _leaf(self, tree: str, looked: int) -> SearchResult:
        return SearchResult(tree, (), (self.root[0][:, :0], self.root[1][:, :0]), looked, "")


def _reporter(label: str, progress: Callable[[str], None] | None) -> Callable[[int, int], None] | None:
    if progress is None:
        return None
    last = [time.perf_counter()]

    def report(looked: int, left: int) -> None:
        if time.perf_counter() - last[0] > 1.0:
            last[0] = time.perf_counter()
            progress(f"{label}: {looked} boxes, {left} open")

    return report


def _usable(form: Form, names: tuple[str, ...], root: tuple[NDArray[np.float64], NDArray[np.float64]]) -> bool:
    read = build_tape(names, [*form.denominators, *form.multipliers]).run(root)
    count = len(form.denominators)
    positive = all(jet.value[0][0] > 0 for jet in read.jets[:count])
    not_negative = all(jet.value[0][0] >= 0 for jet in read.jets[count:])
    return bool(positive and not_negative and all(fine[0] for fine in read.defined))


def _volume(result: SearchResult) -> float:
    return float(np.sum(np.prod(np.maximum(result.remaining[1] - result.remaining[0], 1e-12), axis=0)))


def _written(case: Case, shown: _Shown) -> dict[str, Any]:
    proof = {"tree": shown.result.tree, "points": [list(p) for p in shown.result.points]}
    return {
        "choice": case.choice,
        "numerator": text_of(shown.form.numerator),
        "denominators": [text_of(d) for d in shown.form.denominators],
        "multipliers": [text_of(m) for m in shown.form.multipliers],
        **({"squares": shown.squares} if shown.squares else proof),
    }


def _certificate(
    statement: Statement, texts: Sequence[str], shown: Cases, about: Mapping[str, str], units: Sequence[str]
) -> dict[str, Any]:
    each = zip(statement.names, units, statement.lower.tolist(), statement.upper.tolist(), strict=True)
    variables = [dict(zip(("name", "unit", "lower", "upper"), one, strict=True)) for one in each]
    sides = {"left": texts[0], "right": texts[1], "constraints": texts[2:], "slack": shown.slack}
    return seal("interval", {**about, "variables": variables, **sides}, {"cases": list(shown.cases)})


def _left_open(statement: Statement, written: Tape, case: Case, shown: _Shown, boxes: int) -> Cases:
    result = shown.result
    some = corners(result.remaining, statement.names, most=_MOST_SHOWN)
    count = result.remaining[0].shape[1]
    text = f"{result.reason} after {result.boxes} boxes: {count} open"
    if case.choice:
        text += f" in case {case.choice}"
    if some:
        low, high = result.remaining
        at, trouble = written.trouble((low, high))
        box = corners((low[:, [at]], high[:, [at]]), statement.names)[0] if trouble else some[0]
        where = ", ".join(f"{name} in [{ends[0]:.4g}, {ends[1]:.4g}]" for name, ends in box.items())
        text += f", one at {where}" + (f"; {trouble}" if trouble else "")
    if shown.tried:
        text += f"; {shown.tried}"
    return Cases((), 0.0, text, tuple(some), boxes)
