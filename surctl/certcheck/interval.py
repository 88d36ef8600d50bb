"""Check of a certificate of kind `interval`, which claims an inequality left ≤ right + slack on a box.

The key `cases` lists the cases of the proof, which `surctl.certcheck.inequality` describes. The checker does not check
the claim's statement in words.

A number in the claim means the printed decimal. The ends of a box are rounded outward to contain both the decimal and
its double. A variable whose range has zero width equals its decimal exactly.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from surctl.certcheck.document import Rejected, record
from surctl.certcheck.expressions import RESERVED
from surctl.certcheck.inequality import DIMENSIONS, Box, Obligation, listed, number

__all__ = ["check", "printable", "variables_of"]

_CLAIM = {"name", "statement", "unit", "variables", "left", "right", "constraints", "slack"}


def check(document: Mapping[str, Any]) -> None:
    """Raise Rejected unless the certificate proves its claim."""
    claim = document["claim"]
    record(claim, _CLAIM, "claim")
    record(document, {"format", "version", "kind", "claim", "cases", "sha256"}, "the certificate")
    names, box = variables_of(claim["variables"])
    printable(claim["name"], claim["unit"])
    slack = number(claim["slack"])
    if slack < 0:
        raise Rejected("the slack is negative")
    stated = Obligation(names, box, claim["left"], claim["right"], listed(claim["constraints"]), slack)
    stated.check(document["cases"])


def variables_of(variables: object) -> tuple[list[str], Box]:
    """Return the names and bounds of a claim's variables; raise Rejected if they are not valid."""
    entries = listed(variables)
    names = [v["name"] for v in entries]
    if not names or len(set(names)) < len(names) or len(names) > len(DIMENSIONS):
        raise Rejected(f"the claim must have 1 to {len(DIMENSIONS)} variables with different names")
    for name in names:
        if not isinstance(name, str) or not re.fullmatch("[A-Za-z][A-Za-z0-9_]*", name):
            raise Rejected(f"{name!r} is not a name of a variable: use letters A-Z and a-z, digits and _ only")
        if name in RESERVED:
            raise Rejected(f"the variable {name!r} has the name of a number or a function")
    printable(*(v["unit"] for v in entries))
    for variable in entries:
        record(variable, {"name", "unit", "lower", "upper"}, "a variable")
    box = [(number(v["lower"]), number(v["upper"])) for v in entries]
    if any(low > high for low, high in box):
        raise Rejected("a variable's lower end lies above its upper end")
    return names, box


def printable(*words: object) -> None:
    """Raise Rejected unless every word is a text of printable characters."""
    for word in words:
        if not isinstance(word, str) or not word.isprintable():
            raise Rejected(f"{word!r} is not a name or unit that can be printed")
