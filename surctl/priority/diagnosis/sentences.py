"""Sentences that describe the findings of the diagnosis of a task stack."""

from __future__ import annotations

import math

from surctl.priority.diagnosis.findings import Equality, LevelReport, Pair, Residual, Singularity
from surctl.priority.diagnosis.region import pose_text

__all__ = ["say_equality", "say_level", "say_pair", "say_singularity"]


def say_equality(equality: Equality, *, levels: int, samples: int) -> str:
    """Return the sentence on whether NSB equals strict priority."""
    if levels == 1:
        return "With one task, NSB equals strict priority."
    if equality.verdict == "everywhere":
        return "NSB equals strict priority everywhere: all commutators vanish as expressions."
    if equality.where is None:
        return (
            f"NSB equals strict priority on all {samples} samples (largest commutator {equality.largest:.1g}), "
            "which is not a proof."
        )
    at = pose_text(equality.where)
    return f"NSB differs from strict priority at `{equality.task}`: commutator {equality.largest:.2g} at {at}."


def say_pair(pair: Pair) -> str:
    """Return the sentence on how two tasks affect each other."""
    both = f"`{pair.first}` and `{pair.second}`"
    if pair.smallest is None or pair.largest is None or pair.where is None:
        return f"{both} are never active together."
    at = pose_text(pair.where)
    equal = "" if pair.equal == "differs" else ", and NSB treats these two as strict priority does"
    if pair.kind == "orthogonal":
        where = "everywhere" if pair.structural else "on all samples"
        return f"{both} are orthogonal {where}: neither disturbs the other."
    if pair.kind == "dependent everywhere":
        return f"{both} share {_directions(pair.shared)} at every sample{equal}."
    if pair.kind == "dependent somewhere":
        return (
            f"{both} nearly share a direction at some poses: angle between {_degrees(pair.smallest)} and "
            f"{_degrees(pair.largest)}, smallest at {at}."
        )
    return (
        f"{both} are coupled: angle between {_degrees(pair.smallest)} and {_degrees(pair.largest)}, "
        f"smallest at {at}{equal}."
    )


def say_singularity(singularity: Singularity) -> str:
    """Return the sentence on where a level loses rank, and why."""
    at = pose_text(singularity.poses[0])
    more = f" ({len(singularity.poses) - 1} more poses found)" if len(singularity.poses) > 1 else ""
    if singularity.kind == "algorithmic":
        cause = "".join(f", where `{name}` is singular itself" for name in singularity.also_singular[:1])
        return (
            f"`{singularity.task}` loses a direction to the tasks above it{cause} (algorithmic singularity, sine "
            f"{singularity.value:.2g}): the velocity of strict priority is unbounded near {at}{more}."
        )
    reason = (
        f"a step of {singularity.value:.2g} [m or rad] may reverse a row of its Jacobian"
        if singularity.symptom == "turning"
        else f"its Jacobian loses rank (smallest singular value {singularity.value:.2g} of its usual size)"
    )
    return f"`{singularity.task}` is singular by itself (kinematic singularity): {reason} near {at}{more}."


def say_level(level: LevelReport) -> str:
    """Return the sentence on whether a level is met, and if not, why."""
    name = f"`{level.task}`"
    if level.met == "by both laws":
        text = f"{name} is met by both laws at all samples"
    elif level.met == "by strict priority only":
        text = f"{name} is met by strict priority only: NSB leaves {_residual(level.nsb, level.unit)}"
    else:
        text = (
            f"{name} cannot be met: strict priority leaves {_residual(level.strict, level.unit)}, "
            f"NSB leaves {_residual(level.nsb, level.unit)}"
        )
    return text + _why(level) + "."


def _why(level: LevelReport) -> str:
    if level.rank == 0:
        return "; it is inactive at all samples"
    whole = _directions(level.rank)
    dependent = f"; it shares {level.dependent} of its {whole} with tasks above it" if level.dependent else ""
    spent = f"; the tasks above it leave no freedom at {level.exhausted:.0%} of the samples" if level.exhausted else ""
    return dependent + spent


def _residual(residual: Residual, unit: str) -> str:
    named = f" {unit}" if unit else ""
    return (
        f"{residual.median:.2g}{named} (median) and at most {residual.largest:.2g}{named}, "
        f"at {pose_text(residual.where)}"
    )


def _directions(count: int) -> str:
    return "1 direction" if count == 1 else f"{count} directions"


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.3g}°"
