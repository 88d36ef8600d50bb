"""The claims of the library in words without formulas, and what each claim does not cover."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from surctl.verification.claim import Claim

__all__ = ["ClaimWords", "claim_words"]


class ClaimWords(NamedTuple):
    """A claim of the library in words without formulas.

    Attributes:
        clause: what the claim says, worded to follow "It is proved that".
        beyond: what the claim does not cover, in addition to the limits that all claims of its kind share.
    """

    clause: str
    beyond: str = ""


_SHRINKS = "the distance to the obstacle's anti-collision circle never grows"
_WORDS: Mapping[str, ClaimWords] = {
    "v1-printed": ClaimWords(
        "the tracking error never grows when the surge command may be negative", "corrected form: v1-corrected"
    ),
    "v1-corrected": ClaimWords(
        "the tracking error decreases at a stated rate when the surge command is kept at 0 or above", "a speed limit"
    ),
    "v1-speed-cap": ClaimWords(
        "the tracking error never grows under the speed limit, however far behind the robot is",
        "corrected form: v1-speed-cap-region",
    ),
    "v1-speed-cap-region": ClaimWords(
        "the tracking error never grows under the speed limit while the robot is at most as far behind as in this set",
        "robots farther behind the target",
    ),
    "course-printed": ClaimWords(
        "the cross-track error never grows when the law steers the heading, for any sway velocity",
        "corrected form: course-corrected",
    ),
    "course-corrected": ClaimWords(
        "the cross-track error decreases when the law steers the course, so that the heading compensates the sideslip",
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
        f"{_SHRINKS} for a static obstacle, for any offset delta of 0 or above", "corrected form: v2-static"
    ),
    "v2-static": ClaimWords(
        f"{_SHRINKS} for a static obstacle where the offset delta and the distance e2 have the same sign",
        "moving obstacles",
    ),
    "v2-obstacle": ClaimWords(
        f"{_SHRINKS} for a moving obstacle that is slower than the robot", "corrected form: clearance-corrected"
    ),
    "v2-clockwise": ClaimWords(
        f"{_SHRINKS} for a static obstacle when the bearing is measured clockwise, as printed",
        "corrected form: v2-static",
    ),
    "clearance-printed": ClaimWords(
        "the clearance to a static obstacle shrinks no faster than the barrier allows, with the course as printed",
        "corrected form: clearance-corrected",
    ),
    "clearance-corrected": ClaimWords(
        "the clearance to an obstacle shrinks no faster than the barrier allows while the robot is faster than the "
        "obstacle by kappa times the stand-off or more",
        "faster obstacles; several obstacles at once",
    ),
}


def claim_words(claim: Claim) -> ClaimWords:
    """Return the claim in words; a claim that is not in the library is described by its own statement."""
    return _WORDS.get(claim.name, ClaimWords(claim.statement))
