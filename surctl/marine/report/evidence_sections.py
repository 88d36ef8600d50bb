"""Sections of the HTML report with the evidence: the decisive run, the claims, and all closed-loop runs."""

from __future__ import annotations

import shlex
from contextlib import suppress
from pathlib import Path

from surctl.errors import InputError
from surctl.marine.control import LIBRARY as GAIN_LIBRARY
from surctl.marine.control import Gains, load_gains
from surctl.marine.report.animation import player
from surctl.marine.report.plan_view import describe, plot_run
from surctl.marine.report.sections import ReportData
from surctl.marine.report.signals import plot_priority, plot_run_signals, relaxation_text
from surctl.marine.simulation import LIBRARY as SCENARIO_LIBRARY
from surctl.marine.simulation import Run, priority_timeline
from surctl.marine.vehicle import LIBRARY as VEHICLE_LIBRARY
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.own_code import label, own_file
from surctl.report.document import (
    Block,
    Cell,
    Heading,
    Paragraph,
    Picture,
    Pictures,
    Section,
    Table,
    outcome_cell,
    picture,
)
from surctl.report.evidence import margin_slice, plot_counterexample, plot_slice
from surctl.report.theme import number
from surctl.verification import Counterexample, Verdict


def _gains_argument(gains: Gains, gains_file: str) -> str | None:
    """Return the value of `--gains`: `gains_file`, or the file of unchanged gains; None if neither has these gains."""
    try:
        for source in filter(None, (gains_file, gains.source)):
            if load_gains(source).values == gains.values:
                return _short(source, GAIN_LIBRARY)
    except InputError:
        return None
    return None


def simulate_command(run: Run, gains: str | None) -> str | None:
    """Return the command that repeats and plots the run; None if no command line reproduces it completely."""
    vehicle = _vehicle_argument(run.vehicle)
    law = own_file(run.law.ref)
    if gains is None or vehicle is None:
        return None
    words = ["surctl", "simulate", _short(run.scenario.source, SCENARIO_LIBRARY) or run.scenario.name]
    words += ["--vehicle", vehicle, "--gains", gains, "--law", law, "--avoidance", run.law.avoidance]
    words += [] if run.law.guidance == "los" else ["--guidance", run.law.guidance]
    words += ["--priority-mode", run.law.mode]
    words += [] if run.law.fallback == "exact" else ["--fallback", run.law.fallback]
    if (run.law.barrier, run.law.movers) != ("simple", "predict"):
        words += ["--barrier", run.law.barrier, "--movers", run.law.movers]
    words += ["--sensing", run.sensing, "--seed", str(run.seed), "--out", "plots"]
    return shlex.join(words)


def _verify_command(
    claim: str, gains: str | None, vehicle: Vehicle, speeds: tuple[float, float] | None = None
) -> str | None:
    """Return the command that repeats the proof of the claim for the vehicle and (cruise speed, speed limit) [m/s]."""
    robot = _vehicle_argument(vehicle)
    if gains is None or robot is None:
        return None
    words = ["surctl", "verify", claim, "--vehicle", robot, "--gains", gains]
    if speeds is not None:
        words += ["--cruise", f"{speeds[0]:g}", "--cap", f"{speeds[1]:g}"]
    return shlex.join(words)


def _vehicle_argument(vehicle: Vehicle) -> str | None:
    try:
        same = bool(vehicle.source) and load_vehicle(vehicle.source).parameters == vehicle.parameters
    except InputError:
        return None
    return _short(vehicle.source, VEHICLE_LIBRARY) if same else None


def _short(source: str, library: Path) -> str:
    # bare name of a built-in file
    path = Path(source)
    return path.stem if path.parent == library else source


_BUDGET = 3_600_000  # [byte] approximate total size of run pictures; keeps the page below 6 MB


def claims_section(data: ReportData) -> Section:
    """Return a section with a table of all verdicts, then each claim with its counterexample or its unproved part."""
    text = (
        "A claim is an inequality left ≤ right on a domain. A refuted claim comes with a point where it fails. A "
        "proved claim comes with a certificate that an independent checker has accepted. For an unknown claim, the "
        "text says which part is still open."
    )
    rows = tuple(_verdict_row(v) for v in data.verdicts)
    heads = (
        "claim", "equation", "errata", "expected", "verdict", "as expected", "worst left − right", "unit",
        "share of failing samples [%]", "time [s]",
    )  # fmt: skip
    blocks: list[Block] = [Paragraph(text), Table("Verdicts", heads, rows)]
    gains = _gains_argument(data.gains, data.gains_file)
    for verdict in data.verdicts:
        command = _verify_command(verdict.claim.name, gains, data.vehicle, data.speeds)
        blocks += _claim_blocks(verdict, command or data.command)
    return Section("claims", "Evidence for each claim", tuple(blocks), folded=True)


def _verdict_row(v: Verdict) -> tuple[Cell | str, ...]:
    return (
        Cell(v.claim.name, code=True),
        v.claim.equation,
        ", ".join(v.claim.errata) or "–",
        v.claim.expected,
        v.verdict,
        outcome_cell(v.as_expected, "yes", "NO"),
        Cell(number(v.worst_margin, digits=3), number=True),
        v.claim.unit,
        Cell(number(100 * v.fraction, digits=3), number=True),
        Cell(number(v.seconds, digits=2), number=True),
    )


def _claim_blocks(v: Verdict, command: str) -> list[Block]:
    outcome = f"{v.verdict[0].upper()}{v.verdict[1:]}, {'as expected' if v.as_expected else 'which was NOT expected'}."
    blocks: list[Block] = [
        Heading(v.claim.name, f"claims-{v.claim.name}"),
        Paragraph(f"Claim {v.claim.equation}: {v.claim.statement}."),
        Paragraph(outcome, "good" if v.as_expected else "bad"),
    ]
    if v.remaining:
        blocks.append(Paragraph(f"{v.remaining[0].upper()}{v.remaining[1:]}."))
    if v.counterexample is not None:
        blocks += [_counterexample_table(v, v.counterexample), Pictures(_counterexample_pictures(v, command))]
    return blocks


def _counterexample_table(v: Verdict, counterexample: Counterexample) -> Table:
    rows = [
        (
            Cell(x.name, code=True), Cell(number(counterexample.values[x.name], digits=8), number=True), x.unit,
            f"{number(x.lower)} to {number(x.upper)}", x.meaning,
        )
        for x in v.claim.variables
    ]  # fmt: skip
    rows.append(
        (
            Cell("left − right"),
            Cell(number(counterexample.margin, digits=6), number=True),
            counterexample.unit,
            "at most 0",
            "margin of the claim",
        )
    )
    caption = f"Counterexample to {v.claim.name}, found by {counterexample.origin}"
    return Table(caption, ("quantity", "value", "unit", "domain (same unit)", "meaning"), tuple(rows))


def _counterexample_pictures(v: Verdict, command: str) -> tuple[Picture, ...]:
    motion, plots = v.claim.motion, []
    if motion is not None:
        alt = f"Replay of the counterexample to {v.claim.name}: {motion.name} over time"
        caption = f"Replay from the counterexample: {motion.name} violates the bound of the claim."
        plots.append((plot_counterexample(v), alt, caption))
    with suppress(InputError):  # a claim in one variable has no plane to plot
        cut = margin_slice(v)
        names = f"{cut.one.name} and {cut.other.name}"
        alt = f"Margin of {v.claim.name} over {names} through the counterexample"
        caption = f"Region in which the claim fails over {names}; all other variables as in the counterexample."
        plots.append((plot_slice(cut), alt, caption))
    return tuple(picture(plot, alt=alt, caption=caption, command=command) for plot, alt, caption in plots)


def decisive_section(data: ReportData) -> Section | None:
    """Return a section with the animated decisive run; None if no run counts towards the result.

    The decisive run is the first counted run that does not arrive, or the first counted run if all arrive.
    """
    played = _to_play(data)
    if played is None:
        return None
    place, run = played
    plan = _plan_picture(run, _simulate_command(data, run))
    blocks = (*_outcome(run, decides=True, lead=f"{describe(run)}. "), player(run, plan, film=data.film))
    return Section(f"runs-{place}", "Decisive run", blocks)


def runs_section(data: ReportData) -> Section:
    """Return a section with a table of runs, then plan view and signals of runs; the decisive run has signals only."""
    rows = tuple(_run_row(run, decides) for run, decides in zip(data.runs, data.decides, strict=True))
    heads = (
        "scenario", "vehicle", "law", "sensing", "seed", "reached", "stopped because", "counts",
        "time [s]", "paper's time [s]", "least clearance [m]", "path error [m]", "length [m]", "mean thrust [N]",
    )  # fmt: skip
    text = (
        "Clearance is the distance from the hull to the nearest obstacle or wall; a wall is touched once the hull has "
        "been clear of it. The path error is the rms distance to the path outside avoidance. Sensing: with sonar, the "
        "law detects the obstacles by sonar; with truth, it receives their true positions. The column “counts” says "
        "whether the run counts towards the result."
    )
    blocks: list[Block] = [Paragraph(text), Table("Closed-loop runs", heads, rows), *_surface_notes(data)]
    chosen, used, left = _to_draw(data), 0, 0
    played = _to_play(data)
    for place, run, decides in chosen:
        if used > _BUDGET:
            left += 1
            continue
        command = _simulate_command(data, run)
        if played is not None and place == played[0]:  # the section with the player has its plan and its anchor
            title = Heading(f"Decisive run, {describe(run)}")
            pictures = (_signals_picture(run, command), *_priority_picture(run, command))
        else:
            title = Heading(describe(run), f"runs-{place}")
            pictures = (_plan_picture(run, command), _signals_picture(run, command))
        used += sum(len(one.uri) for one in pictures)
        blocks += [title, *_outcome(run, decides), Pictures(pictures)]
    left += len(data.runs) - len(chosen)
    if left:
        blocks.append(Paragraph(f"{left} more runs are only in the table.", "note"))
    return Section("runs", "Closed-loop runs", tuple(blocks), folded=True)


def _simulate_command(data: ReportData, run: Run) -> str:
    same = run.gains.values == data.gains.values
    gains = _gains_argument(data.gains, data.gains_file) if same else _gains_argument(run.gains, "")
    return simulate_command(run, gains) or data.command


def _run_row(run: Run, decides: bool) -> tuple[Cell | str, ...]:
    m = run.metrics
    contact = m.min_clearance_m <= 0
    return (
        Cell(run.scenario.name, code=True),
        run.vehicle.name,
        f"{label(run.law.ref)}, {run.law.mode}",
        run.sensing,
        Cell(str(run.seed), number=True),
        outcome_cell(m.reached, "yes", "NO"),
        m.stopped_because,
        "yes" if decides else "no",
        Cell(number(m.time_s), number=True),
        Cell(number(run.scenario.paper.time_s), number=True),
        Cell(number(m.min_clearance_m, digits=3), "bad" if contact else "", number=True),
        *(Cell(number(v, digits=3), number=True) for v in (m.path_error_m, m.length_m, m.effort_n)),
    )


def _surface_notes(data: ReportData) -> list[Block]:
    # the hull would stand out of the water, but the model has no buoyancy (erratum E16)
    heights = {}
    for run in data.runs:
        above = run.scenario.depth + run.vehicle["radius"]
        if above > 1e-9:
            heights[run.vehicle.name, run.scenario.depth] = above
    return [
        Paragraph(
            f"At z = {number(depth)} m the hull of {name} stands {number(above, digits=3)} m out of the water; the "
            "model in four degrees of freedom has no buoyancy.",
            "note",
        )
        for (name, depth), above in heights.items()
    ]


def _to_draw(data: ReportData) -> list[tuple[int, Run, bool]]:
    # the first run of each kind, and all runs that do not arrive; (number, run, whether the run counts)
    kinds, chosen = set(), []
    for place, (run, decides) in enumerate(zip(data.runs, data.decides, strict=True), start=1):
        kind = (run.scenario.name, run.vehicle.name, run.law.ref, run.law.mode, run.sensing)
        if kind not in kinds or not run.metrics.reached:
            chosen.append((place, run, decides))
        kinds.add(kind)
    return chosen


def _to_play(data: ReportData) -> tuple[int, Run] | None:
    deciding = [(place, run) for place, run, decides in _to_draw(data) if decides]
    return min(deciding, key=lambda one: one[1].metrics.reached, default=None)


def _priority_picture(run: Run, command: str) -> tuple[Picture, ...]:
    timeline = priority_timeline(run)
    if not timeline.eventful:
        return ()
    summary = relaxation_text(timeline)
    explained = f"{command} --explain" if command.startswith("surctl simulate") else command
    return (
        picture(
            plot_priority(timeline, title=describe(run)),
            alt=f"Relaxation of each priority level over time in {describe(run)}: {summary}",
            caption=f"Priority levels, highest first, and the rows that limit them. {summary[0].upper()}{summary[1:]}.",
            command=explained,
        ),
    )


def _outcome(run: Run, decides: bool, lead: str = "") -> list[Block]:
    m, paper = run.metrics, run.scenario.paper
    reported = f" The paper reports: {paper.result}." if paper.result not in ("", "none") else ""
    ended = f"{m.stopped_because[:1].upper()}{m.stopped_because[1:]} after {number(m.time_s)} s"
    text = f"{lead}{run.scenario.title}. {ended}{'' if decides else ' (does not count towards the result)'}.{reported}"
    return [Paragraph(text, "good" if m.reached and m.min_clearance_m > 0 else "bad")]


def _plan_picture(run: Run, command: str) -> Picture:
    m = run.metrics
    outcome = f"{m.stopped_because} after {number(m.time_s)} s, least clearance {number(m.min_clearance_m, digits=3)} m"
    return picture(
        plot_run(run),
        alt=f"Plan view of {describe(run)}: {outcome}",
        caption=f"Plan view: {outcome}. Numbers in hulls and moving obstacles are times in s.",
        command=command,
    )


def _signals_picture(run: Run, command: str) -> Picture:
    return picture(
        plot_run_signals(run),
        alt=f"Clearance, path error, velocity, yaw rate, thrust and yaw moment over time of {describe(run)}",
        caption="Signals over time. Dark: avoidance. Light: return to the path. The path error leaves out both.",
        command=command,
    )
