"""What the studies of many fits print at their end: which statements hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

__all__ = ["concluded"]

_RATES = 3  # statements about rates come first; a quick run has too few fits to judge them


def concluded(statements: Mapping[str, bool], seconds: Sequence[float], *, quick: bool) -> int:
    """Print the statements and the median time of a fit [s]; return 1 if a judged one does not hold, else 0."""
    print("\n| statement | holds |\n|---|---|")
    for text, holds in statements.items():
        print(f"| {text} | {'holds' if holds else '**does not hold**'} |")
    print(f"\nA fit took {np.median(seconds):.2g} s.")
    judged = list(statements.values())[_RATES if quick else 0 :]
    return 0 if all(judged) else 1
