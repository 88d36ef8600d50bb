"""The summary of a study, line by line (notes): a note passes, fails, or does not count towards the result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from surctl.assessment import Assessment, Line
from surctl.export import SilReport
from surctl.marine.simulation import Run, findings
from surctl.marine.study.loops import Loops
from surctl.marine.study.plan import Plan
from surctl.marine.tuning import SweepTable
from surctl.marine.verification import speeds_text
from surctl.verification import Inapplicable, Verdict

__all__ = ["left_out", "summary"]


def summary(
    plan: Plan,
    swept: SweepTable,
    assessment: Assessment,
    loops: Loops,
    verdicts: Sequence[Verdict | Inapplicable],
    runs: Sequence[Run],
    sil: Sequence[SilReport],
) -> Assessment:
    """Return the assessment of a study with the lines of its sweep, claims, runs and export.

    Args:
        plan: the plan of the study.
        swept: the parameter sweep of the study.
        assessment: what is assessed of the vehicle with the gains of the sweep.
        loops: linear analysis of the control loops; empty if the law has no linear model.
        verdicts: verdicts on the claims of the study.
        runs: runs of the study.
        sil: software-in-the-loop (SIL) reports, one report for each run that the exported law replayed.
    """
    notes = list[Line]()
    feasible = int((swept.column("feasible") > 0.5).sum())
    points = swept.column("feasible").size
    if swept.picked is None:
        notes.append(Line(False, f"sweep: none of {points} points is feasible; the gains stay unchanged", "sweep"))
    else:
        at = list(zip(swept.axes, swept.picked, strict=True))
        chosen = ", ".join(f"{a.name} = {a.values[k]:g} {a.unit}" for a, k in at)
        edges = [a.name for a, k in at if len(a.values) > 1 and k in (0, len(a.values) - 1)]
        edge = f" (on the edge of the grid in {' and '.join(edges)}: extend the grid there)" if edges else ""
        notes.append(Line(True, f"sweep: {feasible} of {points} points are feasible; picked {chosen}{edge}", "sweep"))
    speed = max(leg.scenario.cruise for leg in plan.deciding)
    notes += _speed_notes(loops)
    decided = [v for v in verdicts if isinstance(v, Verdict)]
    unexpected = [v.claim.name for v in decided if not v.as_expected]
    counts = Counter(v.verdict for v in decided)
    text = f"claims at {speed:g} m/s: {', '.join(f'{n} {word}' for word, n in sorted(counts.items()))}, "
    text += "all as expected" if not unexpected else f"unexpected: {unexpected}"
    if decided:
        notes.append(Line(not unexpected, text, f"claims-{unexpected[0]}" if unexpected else "claims"))
    notes += [
        Line(False, f"claim {one.claim}: {one.sentence}", "claims", counts=bool(plan.claims))
        for one in verdicts
        if isinstance(one, Inapplicable)
    ]
    for leg in plan.legs:
        if leg.exclusion or leg.misfit:
            reason = leg.exclusion or leg.misfit
            notes.append(_remark(f"{leg.scenario.name} does not count towards the result: {reason}"))
    worst = max((max(r.tau.mixed, r.state.mixed, r.telemetry.mixed) for r in sil), default=0.0)
    steps, cases = sum(r.steps for r in sil), sum(r.fault_cases for r in sil)
    passed = bool(sil) and all(r.conclusive for r in sil)
    replays = f"{len(sil)} {'' if plan.unheard else 'sonar '}run{'s' * (len(sil) != 1)}"
    which = "that takes obstacle positions" if plan.unheard else "with perception"
    text = f"export of the law {which}: C and Python agree to {worst:.1e} over {steps} steps of {replays}; "
    notes.append(Line(passed, text + f"{cases} inputs with NaN or infinity tested", "export"))
    notes += [_remark(f"no sonars are simulated, because {plan.unheard}")] if plan.unheard else []
    return assessment.with_lines(notes + _limits(plan, runs))


def _remark(text: str, about: str = "") -> Line:
    return Line(None, text, about, counts=False)


def _limits(plan: Plan, runs: Sequence[Run]) -> list[Line]:
    """Return what the craft of the plan can and cannot do, for a craft without sway force."""
    if plan.vehicle["Fv_max"] > 0:
        return []
    crab = max((run.metrics.max_crab_angle_deg for run in runs), default=float("nan"))
    scenario = plan.deciding[0].scenario
    texts = [f.text for f in findings(scenario, plan.vehicle, gains=plan.gains) if f.level == "info"]
    return [_remark(f"limit: {text}") for text in texts] + [
        _remark(f"largest crab angle of the runs, outside avoidance: {crab:.1f} deg", "runs")
    ]


def _speed_notes(loops: Loops) -> list[Line]:
    over, mode, notes = loops.over, loops.analysis.mode, list[Line]()
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
        notes.append(Line(held, f"margins at {speeds_text(over.cruise)}: {margin_text}", "margins"))
    return notes


def left_out(runs: Sequence[Run]) -> tuple[Line, ...]:
    """Return summary lines on runs that were not replayed, because their sensors are not those of the exported law."""
    text = "has other sensors than the exported law and is not replayed"
    return tuple(_remark(f"{run.scenario.name} by {run.vehicle.name}, sonar, {text}", "export") for run in runs)
