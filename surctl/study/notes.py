"""The summary of a study, line by line (notes): a note passes, fails, or does not count towards the result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from surctl.export import SilReport
from surctl.own_code import label
from surctl.simulation import Run, findings
from surctl.study.loops import Loops
from surctl.study.plan import Plan
from surctl.tuning import SweepTable
from surctl.verification import Inapplicable, LawCorners, Verdict, speeds_text
from surctl.verification.linear import Mode

__all__ = ["Note", "left_out", "summary", "unstable_text"]


@dataclass(frozen=True)
class Note:
    """One line of the study's summary; it concerns one part of the report.

    `passed` is None if the line does not count towards the result; `about` names the part of the report.
    """

    passed: bool | None
    text: str
    about: str = ""


def summary(
    plan: Plan,
    swept: SweepTable,
    loops: Loops,
    verdicts: Sequence[Verdict | Inapplicable],
    runs: Sequence[tuple[Run, bool]],
    sil: Sequence[SilReport],
) -> tuple[Note, ...]:
    """Return the lines that summarise the results of a study.

    Args:
        plan: the plan of the study.
        swept: the parameter sweep of the study.
        loops: linear analysis of the control loops; empty if the law has no linear model.
        verdicts: verdicts on the claims of the study.
        runs: runs of the study, each with a flag that says whether the run counts towards the result.
        sil: software-in-the-loop (SIL) reports, one report for each run that the exported law replayed.
    """
    notes = []
    feasible = int((swept.column("feasible") > 0.5).sum())
    points = swept.column("feasible").size
    if swept.picked is None:
        notes.append(Note(False, f"sweep: none of {points} points is feasible; the gains stay unchanged", "sweep"))
    else:
        at = list(zip(swept.axes, swept.picked, strict=True))
        chosen = ", ".join(f"{a.name} = {a.values[k]:g} {a.unit}" for a, k in at)
        edges = [a.name for a, k in at if len(a.values) > 1 and k in (0, len(a.values) - 1)]
        edge = f" (on the edge of the grid in {' and '.join(edges)}: extend the grid there)" if edges else ""
        notes.append(Note(True, f"sweep: {feasible} of {points} points are feasible; picked {chosen}{edge}", "sweep"))
    speed = max(leg.scenario.cruise for leg in plan.deciding)
    notes += _loop_notes(plan, loops, speed)
    decided = [v for v in verdicts if isinstance(v, Verdict)]
    unexpected = [v.claim.name for v in decided if not v.as_expected]
    counts = Counter(v.verdict for v in decided)
    text = f"claims at {speed:g} m/s: {', '.join(f'{n} {word}' for word, n in sorted(counts.items()))}, "
    text += "all as expected" if not unexpected else f"unexpected: {unexpected}"
    if decided:
        notes.append(Note(not unexpected, text, f"claims-{unexpected[0]}" if unexpected else "claims"))
    else:
        notes.append(Note(None, f"claims: none was decided for law {label(plan.law)}", "claims"))
    notes += [
        Note(False if plan.claims else None, f"claim {one.claim}: {one.sentence}", "claims")
        for one in verdicts
        if isinstance(one, Inapplicable)
    ]
    for place, (run, decides) in enumerate(runs, start=1):
        m = run.metrics
        good = m.reached and m.min_clearance_m > 0
        line = f"{run.scenario.name} by {run.vehicle.name}, {run.sensing}: {m.stopped_because} at {m.time_s:.1f} s"
        line += f", least clearance {m.min_clearance_m:.3f} m"
        notes.append(Note(good if decides else None, line, f"runs-{place}"))
    for leg in plan.legs:
        if leg.exclusion or leg.misfit:
            reason = leg.exclusion or leg.misfit
            notes.append(Note(None, f"{leg.scenario.name} does not count towards the result: {reason}"))
    worst = max((max(r.tau.mixed, r.state.mixed, r.telemetry.mixed) for r in sil), default=0.0)
    steps, cases = sum(r.steps for r in sil), sum(r.fault_cases for r in sil)
    passed = bool(sil) and all(r.conclusive for r in sil)
    replays = f"{len(sil)} {'' if plan.unheard else 'sonar '}run{'s' * (len(sil) != 1)}"
    which = "that takes obstacle positions" if plan.unheard else "with perception"
    text = f"export of the law {which}: C and Python agree to {worst:.1e} over {steps} steps of {replays}; "
    notes.append(Note(passed, text + f"{cases} inputs with NaN or infinity tested", "export"))
    notes += [Note(None, f"no sonars are simulated, because {plan.unheard}")] if plan.unheard else []
    return tuple(notes + _limits(plan, runs))


def _limits(plan: Plan, runs: Sequence[tuple[Run, bool]]) -> list[Note]:
    """Return what the craft of the plan can and cannot do, for a craft without sway force."""
    if plan.vehicle["Fv_max"] > 0:
        return []
    crab = max((run.metrics.max_crab_angle_deg for run, decides in runs if decides), default=float("nan"))
    scenario = plan.deciding[0].scenario
    texts = [f.text for f in findings(scenario, plan.vehicle, gains=plan.gains) if f.level == "info"]
    return [Note(None, f"limit: {text}") for text in texts] + [
        Note(None, f"largest crab angle of the runs that count, outside avoidance: {crab:.1f} deg", "runs")
    ]


def _loop_notes(plan: Plan, loops: Loops, speed: float) -> list[Note]:
    margins, over, mode, notes = loops.margins, loops.over, loops.mode, list[Note]()
    if loops.law is not None:
        return [_law_note(loops.law, speed)]
    if not margins:
        return [
            Note(
                None,
                f"margins: not judged, because law {label(plan.law)} has no linear model or steady motion",
                "margins",
            )
        ]
    least = min(margins, key=lambda m: m.delay_margin_s)
    if mode is not None and not mode.stable:
        margin_text = f"the linear loop at {speed:g} m/s is unstable (loop {mode.loop}): {unstable_text(mode)}"
    else:
        margin_text = f"margins at {speed:g} m/s: least delay margin {least.delay_margin_s:.2f} s ({least.name}), "
        margin_text += f"least disk margin {min(m.disk_margin for m in margins):.2f}"
    notes.append(Note(loops.stable, margin_text, "margins"))
    caps = {leg.scenario.cap for leg in plan.deciding}
    if mode is not None and max(caps) > mode.bearable:
        text = f"the speed cap, {max(caps):g} m/s, exceeds the bearable speed, {mode.bearable:.3g} m/s; lower the cap"
        notes.append(Note(None, text, "margins"))
    if over is not None:
        names = {"delay_margin_s": "delay margin {:.2f} s", "disk_margin": "disk margin {:.2f}"}
        margin_text = ", ".join(
            f"least {word.format(value)} (at {at:g} m/s)"
            for word, (value, at) in ((word, over.worst(name)) for name, word in names.items())
        )
        poles = over.figures["slowest_pole_per_s"]
        held = bool((poles < 0).all())
        if not held:
            lost = [u for u, pole in zip(over.cruise, poles.tolist(), strict=True) if not pole < 0]
            bearable = "" if mode is None else f" (bearable speed {mode.bearable:.3g} m/s)"
            margin_text = f"the linear loop is unstable at {speeds_text(lost)}{bearable}; {margin_text}"
        notes.append(Note(held, f"margins at {speeds_text(over.cruise)}: {margin_text}", "margins"))
    return notes


def _law_note(law: LawCorners, speed: float) -> Note:
    if not law.stable:
        where = "" if not law.nominal.stable else f" at the corner {law.corner}"
        return Note(False, f"the sampled loop {_at(law, speed)} is unstable{where}; lower the cruise speed", "margins")
    least = min(law.nominal.margins, key=lambda m: m.delay_margin_s)
    text = f"margins {_at(law, speed)}: least delay margin {least.delay_margin_s:.2f} s ({least.name}), disk margin of "
    text += f"all thrust loops {law.nominal.disk.guaranteed:.2f}, {law.disk:.2f} at the worst of {law.text}"
    return Note(True, text, "margins")


def _at(law: LawCorners, speed: float) -> str:
    return f"about {law.nominal.place}" if law.nominal.place else f"at {speed:g} m/s"


def unstable_text(mode: Mode) -> str:
    """Return the dominant states of an unstable mode, its pole, and what stabilises the loop, as text."""
    states = ", ".join(f"{name} {share:.0%}" for name, share in list(mode.participation.items())[:3])
    return f"pole {mode.real:.3g} 1/s, dominant states {states}; stable {mode.remedy}"


def left_out(runs: Sequence[Run]) -> tuple[Note, ...]:
    """Return summary lines on runs that were not replayed, because their sensors are not those of the exported law."""
    text = "has other sensors than the exported law and is not replayed"
    return tuple(Note(None, f"{run.scenario.name} by {run.vehicle.name}, sonar, {text}", "export") for run in runs)
