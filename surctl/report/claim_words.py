"""The library's claims as clauses that need no formula, and what each leaves out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from surctl.verification import Claim

__all__ = ["ClaimWords", "claim_words"]


class ClaimWords(NamedTuple):
    """A claim in words.

    Attributes:
        clause: what it says, as it follows "It is proved that".
        beyond: what it does not cover, besides the assumption that all claims of its kind share.
    """

    clause: str
    beyond: str = ""


_SHRINKS = "the distance to the obstacle's anti-collision circle never grows"
_WORDS: Mapping[str, ClaimWords] = {
    "v1-printed": ClaimWords(
        "the tracking error never grows when the surge command may be negative", "corrected form: v1-corrected"
    ),
    "v1-corrected": ClaimWords(
        "the tracking error decreases at a stated rate when the surge command is kept at 0 or above", "a speed cap"
    ),
    "v1-speed-cap": ClaimWords(
        "the tracking error never grows under the speed cap, however far behind the robot is",
        "corrected form: v1-speed-cap-region",
    ),
    "v1-speed-cap-region": ClaimWords(
        "the tracking error never grows under the speed cap while the robot is no farther behind than this set allows",
        "robots farther behind the target",
    ),
    "course-printed": ClaimWords(
        "the cross-track error never grows when the heading is steered, whatever the sway",
        "corrected form: course-corrected",
    ),
    "course-corrected": ClaimWords(
        "the cross-track error decreases when the course is steered, so that the heading compensates the sideslip",
        "curved paths",
    ),
    "m-norm-printed": ClaimWords(
        "the last inequality of the paper's convergence proof holds", "corrected form: m-norm-corrected"
    ),
    "m-norm-corrected": ClaimWords(
        "the tracking error decreases at the rate of the least eigenvalue of M where the surge command is 0 or above",
        "negative surge commands",
    ),
    "v2-printed": ClaimWords(
        f"{_SHRINKS} before a static obstacle, for any offset delta of 0 or above", "corrected form: v2-static"
    ),
    "v2-static": ClaimWords(
        f"{_SHRINKS} before a static obstacle where the offset delta and the distance e2 have the same sign",
        "moving obstacles",
    ),
    "v2-obstacle": ClaimWords(
        f"{_SHRINKS} before a moving obstacle that is slower than the robot", "corrected form: clearance-corrected"
    ),
    "v2-clockwise": ClaimWords(
        f"{_SHRINKS} before a static obstacle when the bearing is taken clockwise, as printed",
        "corrected form: v2-static",
    ),
    "clearance-printed": ClaimWords(
        "the clearance to a static obstacle shrinks no faster than the barrier allows, with the printed course",
        "corrected form: clearance-corrected",
    ),
    "clearance-corrected": ClaimWords(
        "the clearance to an obstacle shrinks no faster than the barrier allows while the robot is faster than the "
        "obstacle by kappa times the stand-off or more",
        "faster obstacles; several obstacles at once",
    ),
}


def claim_words(claim: Claim) -> ClaimWords:
    """The claim's words; of a claim that is not in the library, its own statement."""
    return _WORDS.get(claim.name, ClaimWords(claim.statement))
