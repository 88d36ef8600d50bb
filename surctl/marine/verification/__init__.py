"""The library of claims about marine laws, and the margins of their linearised loops."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.marine.verification.avoidance_claims import settling_intrusion
    from surctl.marine.verification.cruise_loop import LINEAR_GAINS, CruiseLoop, cruise_loop, loop_margins
    from surctl.marine.verification.law_loop import LawCorners, OperatingPoint, law_corners, law_loop, steady_motion
    from surctl.marine.verification.library import applicable_claims, claims
    from surctl.marine.verification.linear_table import (
        LINEAR_METRICS,
        LINEAR_PARAMETERS,
        Locus,
        linear_table,
        sweep_locus,
    )
    from surctl.marine.verification.sonar_margins import sonar_margins
    from surctl.marine.verification.speeds import (
        OverSpeeds,
        check_held,
        cruise_speeds,
        over_speeds,
        speeds_text,
        worst_text,
    )

__all__ = [
    "LINEAR_GAINS",
    "LINEAR_METRICS",
    "LINEAR_PARAMETERS",
    "CruiseLoop",
    "LawCorners",
    "Locus",
    "OperatingPoint",
    "OverSpeeds",
    "applicable_claims",
    "check_held",
    "claims",
    "cruise_loop",
    "cruise_speeds",
    "law_corners",
    "law_loop",
    "linear_table",
    "loop_margins",
    "over_speeds",
    "settling_intrusion",
    "sonar_margins",
    "speeds_text",
    "steady_motion",
    "sweep_locus",
    "worst_text",
]

load_at_first_use(__name__)
