"""Verification of claims: a claim is proved with a certificate, refuted with a counterexample, or left open."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.verification.claim import Claim, Motion, Variable
    from surctl.verification.claim_file import load_claim
    from surctl.verification.counterexample import Counterexample, evaluate, replay
    from surctl.verification.decide import decide
    from surctl.verification.falsifier import falsify
    from surctl.verification.loops import LoopMargins
    from surctl.verification.proving import Proof, prove
    from surctl.verification.sampled_margins import LoopCorners, system_corners, system_disk_margin, system_margins
    from surctl.verification.setting import Setting, setting_from
    from surctl.verification.verdict import Inapplicable, Verdict

__all__ = [
    "Claim", "Counterexample", "Inapplicable", "LoopCorners", "LoopMargins", "Motion", "Proof", "Setting", "Variable",
    "Verdict", "decide", "evaluate", "falsify", "load_claim", "prove", "replay", "setting_from", "system_corners",
    "system_disk_margin", "system_margins",
]  # fmt: skip

load_at_first_use(__name__)
