"""Verification of claims: a claim is proved with a certificate, refuted with a counterexample, or left open.

The package also computes the stability margins of the linearised loops.
"""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.verification.avoidance_claims import settling_intrusion
    from surctl.verification.cascade import CASCADE_GAINS, Cascade, build_cascade
    from surctl.verification.cascade_margins import closed_loop_poles, loop_margins, worst_margins
    from surctl.verification.claim import Claim, Motion, Variable, VerdictWord
    from surctl.verification.claim_file import load_claim, write_claim
    from surctl.verification.counterexample import Counterexample, Replay, evaluate, replay
    from surctl.verification.decide import decide
    from surctl.verification.falsifier import falsify
    from surctl.verification.law_corners import LawCorners, law_corners
    from surctl.verification.law_loop import LawLoop, law_loop
    from surctl.verification.library import applicable_claims, claims
    from surctl.verification.linear_table import LINEAR_METRICS, LINEAR_PARAMETERS, linear_table
    from surctl.verification.locus import Locus, sweep_locus
    from surctl.verification.margins import LoopMargins, margins_of
    from surctl.verification.operating_point import OperatingPoint, steady_motion
    from surctl.verification.proving import Proof, prove
    from surctl.verification.sampled_margins import system_disk_margin, system_margins
    from surctl.verification.setting import Setting, setting_from
    from surctl.verification.sonar_margins import SonarMargins, sonar_margins
    from surctl.verification.speeds import (
        OverSpeeds,
        check_held,
        cruise_speeds,
        over_speeds,
        speeds_text,
        worst_place,
        worst_text,
    )
    from surctl.verification.system_corners import SystemCorners, system_corners
    from surctl.verification.verdict import Inapplicable, Verdict

__all__ = [
    "CASCADE_GAINS",
    "LINEAR_METRICS",
    "LINEAR_PARAMETERS",
    "Cascade",
    "Claim",
    "Counterexample",
    "Inapplicable",
    "LawCorners",
    "LawLoop",
    "Locus",
    "LoopMargins",
    "Motion",
    "OperatingPoint",
    "OverSpeeds",
    "Proof",
    "Replay",
    "Setting",
    "SonarMargins",
    "SystemCorners",
    "Variable",
    "Verdict",
    "VerdictWord",
    "applicable_claims",
    "build_cascade",
    "check_held",
    "claims",
    "closed_loop_poles",
    "cruise_speeds",
    "decide",
    "evaluate",
    "falsify",
    "law_corners",
    "law_loop",
    "linear_table",
    "load_claim",
    "loop_margins",
    "margins_of",
    "over_speeds",
    "prove",
    "replay",
    "setting_from",
    "settling_intrusion",
    "sonar_margins",
    "speeds_text",
    "steady_motion",
    "sweep_locus",
    "system_corners",
    "system_disk_margin",
    "system_margins",
    "worst_margins",
    "worst_place",
    "worst_text",
    "write_claim",
]

load_at_first_use(
    __name__,
    {
        "avoidance_claims": "settling_intrusion",
        "cascade": "CASCADE_GAINS Cascade build_cascade",
        "cascade_margins": "closed_loop_poles loop_margins worst_margins",
        "claim": "Claim Motion Variable VerdictWord",
        "claim_file": "load_claim write_claim",
        "counterexample": "Counterexample Replay evaluate replay",
        "decide": "decide",
        "falsifier": "falsify",
        "law_corners": "LawCorners law_corners",
        "law_loop": "LawLoop law_loop",
        "library": "applicable_claims claims",
        "linear_table": "LINEAR_METRICS LINEAR_PARAMETERS linear_table",
        "locus": "Locus sweep_locus",
        "margins": "LoopMargins margins_of",
        "operating_point": "OperatingPoint steady_motion",
        "proving": "Proof prove",
        "sampled_margins": "system_disk_margin system_margins",
        "setting": "Setting setting_from",
        "sonar_margins": "SonarMargins sonar_margins",
        "speeds": "OverSpeeds check_held cruise_speeds over_speeds speeds_text worst_place worst_text",
        "system_corners": "SystemCorners system_corners",
        "verdict": "Inapplicable Verdict",
    },
)
