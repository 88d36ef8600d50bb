"""The library of claims about marine laws, and the margins of their linearised loops."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.marine.verification.avoidance_claims import settling_intrusion
    from surctl.marine.verification.cruise_loop import cruise_loop
    from surctl.marine.verification.law_loop import law_corners, law_loop, steady_motion
    from surctl.marine.verification.library import claims
    from surctl.marine.verification.linear_table import LINEAR_METRICS, linear_table, sweep_locus
    from surctl.marine.verification.sonar_margins import sonar_margins
    from surctl.marine.verification.speeds import over_speeds

__all__ = [
    "LINEAR_METRICS", "claims", "cruise_loop", "law_corners", "law_loop", "linear_table", "over_speeds",
    "settling_intrusion", "sonar_margins", "steady_motion", "sweep_locus",
]  # fmt: skip

load_at_first_use(__name__)
