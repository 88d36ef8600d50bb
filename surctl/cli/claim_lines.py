"""The lines that `surctl verify` prints about an inequality: its verdict, and the statement as the checker reads it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    from surctl.verification import Verdict
    from surctl.verification.formula import Statement

__all__ = ["claim_line", "statement_lines"]

_SHOWN = 400  # characters of a printed expression


def statement_lines(exact: Statement, certificate: Mapping[str, Any] | None) -> list[str]:
    """Return the statement as the checker reads it: from the certificate, if there is one."""
    from surctl.verification.formula import text_of

    left, right, *constraints = map(text_of, exact.parts)
    ends = [*zip(exact.names, exact.lower.tolist(), exact.upper.tolist(), strict=True)]
    if certificate is not None:
        claim = certificate["claim"]
        left, right, constraints = claim["left"], claim["right"], claim["constraints"]
        ends = [(v["name"], v["lower"], v["upper"]) for v in claim["variables"]]
    slack = certificate["claim"]["slack"] if certificate is not None else 0.0
    bound = f"{right} + {slack!r}" if slack else right
    where = [f"{name} in [{low!r}, {high!r}]" for name, low, high in ends] + [f"{g} <= 0" for g in constraints]
    return [f"  {_clipped(left)} <= {_clipped(bound)}", f"  where {_clipped(', '.join(where))}"]


def _clipped(text: str) -> str:
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]} ... ({len(text)} characters)"


def _number(value: float, digits: str) -> str:
    return repr(value) if digits == "r" else f"{value:{digits}}"


def claim_line(verdict: Verdict) -> str:
    """Return one line for a verdict, with its counterexample, its slack or the reason why it is unknown."""
    counterexample, proof = verdict.counterexample, verdict.certificate
    where = ""
    if counterexample is not None:
        digits = "r" if counterexample.undefined else ".4g"  # beside a pole, every digit counts
        where = " at " + ", ".join(f"{k} = {_number(v, digits)}" for k, v in counterexample.values.items())
        where += f": {counterexample.sentence}"
    elif verdict.vacuous:
        where = f", but vacuous: {verdict.vacuous}"
    elif proof is not None and proof["claim"]["slack"]:
        where = f" to within {proof['claim']['slack']:.1g} {verdict.claim.unit}"
    elif verdict.open_ends:
        where = f": {verdict.open_ends}"
    mark = "ok  " if verdict.as_expected else "FAIL"
    return f"{mark} {verdict.claim.name:<22} {verdict.verdict}{where}"
