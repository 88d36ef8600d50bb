"""Deliberately wrong versions of the exported C (wrong sign, gain, operator or guard), to test the checks."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from surctl.errors import SurctlError
from surctl.export.bundle import Bundle
from surctl.export.check import check_builds
from surctl.export.contract import Exportable
from surctl.export.emulated import TARGETS
from surctl.export.envelope import Records
from surctl.export.process import build_controller
from surctl.export.prove import prove_bundle
from surctl.export.sil import compare_runs

__all__ = ["Mutant", "caught_by", "mutants"]

_TRIALS = 40_000
_LEAST = 2e-3  # smaller constants only keep divisors from zero: a change of 1 % has no effect


@dataclass(frozen=True)
class Mutant:
    """A bundle with one deliberate error in its C text.

    Attributes:
        kind: what is wrong: sign, operator, gain, guard (input check) or memory.
        file: name of the changed C file.
        line: number of the changed line, from 1.
        old, new: `old` is the text before the change, `new` the text after the change.
        bundle: the changed bundle.
    """

    kind: str
    file: str
    line: int
    old: str
    new: str
    bundle: Bundle


def mutants(bundle: Bundle, *, each: int = 6) -> tuple[Mutant, ...]:
    """Return up to `each` mutants of each kind, spread evenly over the C text; the choice is not random."""
    by_kind: dict[str, list[Mutant]] = {}
    for mutant in _all(bundle):
        by_kind.setdefault(mutant.kind, []).append(mutant)
    chosen: list[Mutant] = []
    for group in by_kind.values():
        picks = np.unique(np.linspace(0, len(group) - 1, min(each, len(group))).round().astype(int))
        chosen += [group[k] for k in picks]
    return tuple(chosen)


_LAW: Sequence[tuple[str, str, str]] = (
    ("sign", r" \+ (?!\d+;)", " - "),
    ("sign", r"(?<=\w) - ", " + "),
    ("operator", r"min_of\(", "max_of("),
    ("operator", r"max_of\(", "min_of("),
    ("operator", r" / ", " * "),
    ("operator", r" < ", " >= "),
)
_GUARD: Sequence[tuple[str, str, str]] = (
    ("guard", r"if \(!\(.*\)\) \{ return 0; \}", ""),
    ("guard", r"if \(!\(.*\)\) \{ return 1; \}", ""),
    ("guard", r"\(gap == 0U\) \|\| ", ""),
    ("guard", r"\(gap == 0U\) \|\| \(gap > 0x7fffffffU\)", "gap == 0U"),
    ("guard", r" \|\| \(output == NULL\)", ""),
    ("guard", r"\(state == NULL\) \|\| ", ""),
    ("guard", r"to->tau\[k\] = 0\.0f?;", ""),
    ("memory", r"state->x\[\d+\] = state->next\[\d+\];", ""),
    ("memory", r"state->last\[.*?\] = input->.*?;", ";"),
    ("memory", r"state->sample = input->sample;", ""),
    ("memory", r"state->counted = 1U;", ""),
)


def _all(bundle: Bundle) -> Iterator[Mutant]:
    for file in bundle.sources:
        yield from _of_file(bundle, file)


def _of_file(bundle: Bundle, file: str) -> Iterator[Mutant]:
    lines = bundle.files[file].split("\n")
    inside = ""
    for at, line in enumerate(lines):
        opened = re.match(rf"(?:static )?\w+ (?:{bundle.name}_)?(\w+)\(", line)
        inside = opened.group(1) if opened else ("" if line == "}" else inside)
        if opened or line.lstrip().startswith(("*", "/*", "#")):
            continue
        rules = _LAW if inside == "law" else (_GUARD if inside in ("inside", "jumped", "step", "refuse") else ())
        for kind, pattern, new in rules:
            for match in re.finditer(pattern, line):
                yield _mutant(bundle, file, lines, kind, at, match, new)
        if inside == "law":
            for match in re.finditer(r"(?<![\w.])0x1\.[0-9a-f]+p[+-]\d+f?(?![\w.])", line):
                if float.fromhex(match.group(0).rstrip("f")) >= _LEAST:
                    new = f"({match.group(0)} * 1.01{_tail(bundle)})"
                    yield _mutant(bundle, file, lines, "gain", at, match, new)


def _tail(bundle: Bundle) -> str:
    return "" if bundle.real == "float64" else "f"


def _mutant(bundle: Bundle, file: str, lines: list[str], kind: str, at: int, match: re.Match[str], new: str) -> Mutant:
    changed = lines[at][: match.start()] + new + lines[at][match.end() :]
    text = "\n".join([*lines[:at], changed, *lines[at + 1 :]])
    files = MappingProxyType({**bundle.files, file: text})
    return Mutant(kind, file, at + 1, match.group(0), new, replace(bundle, files=files))


def caught_by(
    law: Exportable, mutant: Mutant, recording: Records, folder: Path, *, limit: NDArray[np.float64] | None = None
) -> str | None:
    """Return the first check that detects the mutant: "compiler", "SIL", "single steps" or "proof"; None if undetected.

    Args:
        law: the exported law.
        mutant: the changed bundle.
        recording: a recorded run of the law.
        folder: scratch folder for this mutant only.
        limit: largest thrust (n_tau,) [N, N m] for the proof; None skips the proof.
    """
    try:
        controller = build_controller(law, mutant.bundle, folder)
    except SurctlError:
        return "compiler"
    try:
        (report,) = compare_runs(controller, [recording])
    except SurctlError:  # the program crashes, or ends early
        return "SIL"
    if not report.conclusive:
        return "SIL"
    if not check_builds(controller, [recording], [TARGETS["gcc-O1"]], steps=_TRIALS).passed:
        return "single steps"
    if limit is not None and not prove_bundle(law, mutant.bundle, limit).proved:
        return "proof"
    return None
