"""Claims as data, a falsifier that looks for counterexamples and replays them, and linear margins."""

from surctl.verification.avoidance_claims import settling_intrusion
from surctl.verification.cascade import CASCADE_GAINS, Cascade, build_cascade
from surctl.verification.claim import Claim, Motion, Variable, VerdictWord
from surctl.verification.counterexample import Counterexample, Replay, evaluate, replay
from surctl.verification.falsifier import falsify
from surctl.verification.library import claims
from surctl.verification.linear_table import LINEAR_KNOBS, LINEAR_METRICS, linear_table
from surctl.verification.locus import Locus, sweep_locus
from surctl.verification.margins import LoopMargins, closed_loop_poles, loop_margins, margins_of, worst_margins
from surctl.verification.setting import Setting, setting_from
from surctl.verification.verdict import Verdict

__all__ = [
    "CASCADE_GAINS",
    "LINEAR_KNOBS",
    "LINEAR_METRICS",
    "Cascade",
    "Claim",
    "Counterexample",
    "Locus",
    "LoopMargins",
    "Motion",
    "Replay",
    "Setting",
    "Variable",
    "Verdict",
    "VerdictWord",
    "build_cascade",
    "claims",
    "closed_loop_poles",
    "evaluate",
    "falsify",
    "linear_table",
    "loop_margins",
    "margins_of",
    "replay",
    "setting_from",
    "settling_intrusion",
    "sweep_locus",
    "worst_margins",
]
