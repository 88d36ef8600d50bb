"""Rendering of the report of a study as one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from pathlib import Path

from surctl.files import write_file
from surctl.marine.report.evidence_sections import claims_section, decisive_section, runs_section
from surctl.marine.report.sections import (
    ReportData,
    export_section,
    gains_section,
    loops_section,
    sweep_section,
    time_section,
    vehicle_section,
)
from surctl.marine.verification.linear import LinearSide
from surctl.report.document import Cell, Paragraph, Section, Table, marked, outcome_cell, render_sections
from surctl.report.evidence import claim_words
from surctl.report.theme import interval, number
from surctl.verification import Claim, Inapplicable, LoopMargins, Verdict

__all__ = ["findings_section", "render_page", "write_page"]

_Row = tuple[Cell | str, ...]
_LINEAR = "thrust saturation; large errors; avoidance; curved paths"
_WIDTHS = (12, 11, 34, 27, 16)  # [%]
_LEADS = {"proved": "It is proved that", "refuted": "It is not true that"}


def findings_section(data: ReportData) -> Section:
    """Return a table section with one row for single loops, one for each analysis of all loops, one for each claim."""
    rows = [_loops_row(data)] if data.margins else []
    rows += [_together_row(data, side) for side in data.linear]
    rows += [_claim_row(data, verdict) for verdict in data.verdicts]
    rows += [_inapplicable_row(data, one) for one in data.inapplicable]
    rows += [_region_row(data, one) for one in data.regions]
    text = (
        "Margins concern the loop linearised about straight cruise. The paper's claims concern the kinematic loop, "
        "in which velocities follow their commands without delay. Some claims are expected to be refuted as printed."
    )
    heads = ("loop or claim", "verdict", "what holds", "vehicle, speed and set", "not covered")
    table = Table("What holds, for which vehicle, speed and set", heads, tuple(rows), _WIDTHS)
    return Section("margins", "Margins and claims", (Paragraph(text), table))


def _where(data: ReportData, vehicle: str) -> str:
    if data.speeds is None:
        return vehicle
    cruise, cap = data.speeds
    return f"{vehicle}; cruise speed {number(cruise)} m/s, speed limit {number(cap)} m/s"


def _loops_row(data: ReportData) -> _Row:
    stable = all(m.stable for m in data.margins)
    return (
        Cell("each loop alone", anchor="loops"),
        outcome_cell(stable, "stable", "UNSTABLE"),
        _loops_sentence(data.margins) if stable else "At least one closed loop is unstable and has no margin.",
        f"{_where(data, data.vehicle.name)}; small deviations from straight cruise.",
        f"Errors in several loops at once; {_LINEAR}.",
    )


def _loops_sentence(margins: Sequence[LoopMargins]) -> str:
    delay = min(margins, key=lambda m: m.delay_margin_s)
    gain = min(margins, key=lambda m: m.gain_margin)
    phase = min(margins, key=lambda m: m.phase_margin_deg)
    disk = min(margins, key=lambda m: m.disk_margin)
    return (
        f"Each of the {len(margins)} loops stays stable with {number(delay.delay_margin_s, digits=3)} s of extra delay "
        f"(least: {delay.name}), {number(gain.gain_margin, digits=3)} times its gain (least: {gain.name}) or "
        f"{number(phase.phase_margin_deg, digits=3)} deg of phase lag (least: {phase.name}); the least disk margin is "
        f"{number(disk.disk_margin, digits=3)} ({disk.name})."
    )


def _together_row(data: ReportData, side: LinearSide) -> _Row:
    disk = min(side.disks[:2], key=lambda d: d.guaranteed)
    low, high = (number(v, digits=3) for v in disk.gain)
    held = (
        f"All loops together stay stable with gain factors from {low} to {high}, or with phase errors up to "
        f"{number(disk.phase_deg, digits=3)} deg. Sampled every {number(side.sampled.period_s)} s, the loop stays "
        f"stable with up to {side.sampled.delay_periods} periods of delay."
    )
    return (
        Cell("all loops together", anchor="loops"),
        outcome_cell(side.stable, "stable", "UNSTABLE"),
        held if side.stable else "The closed loop is unstable and has no margin.",
        f"{_where(data, side.of)}; small deviations from straight cruise.",
        f"{_LINEAR[0].upper()}{_LINEAR[1:]}.",
    )


def _claim_row(data: ReportData, v: Verdict) -> _Row:
    words = claim_words(v.claim)
    lead = _LEADS.get(v.verdict, "It is not known whether")
    count = f"; {number(100 * v.fraction, digits=3)} % of the samples in this set violate it"
    share = count if v.verdict == "refuted" else ""
    expected = "as expected" if v.as_expected else "NOT expected"
    return (
        Cell(v.claim.name, code=True, anchor=f"claims-{v.claim.name}"),
        Cell(f"{v.verdict}, {expected}", "good" if v.as_expected else "bad"),
        f"{lead} {words.clause}{share}.",
        f"{_where(data, data.vehicle.name)}; {_domain(v.claim)}.",
        _beyond(v, words.beyond),
    )


def _beyond(v: Verdict, beyond: str) -> str:
    # for a refuted claim, `beyond` names the corrected claim
    if v.verdict == "refuted":
        return f"{beyond[0].upper()}{beyond[1:]}." if beyond else "–"
    dynamics = "dynamics, thrust limits, current" if v.claim.paper else "all other steps of the safety argument"
    return f"Points outside this set; {'; '.join(filter(None, (beyond, dynamics)))}."


def _domain(claim: Claim) -> str:
    # variables with equal intervals are listed together
    same: dict[str, list[str]] = {}
    for x in claim.variables:
        unit = "" if x.unit == "1" else f" {x.unit}"
        any_angle = x.unit == "rad" and x.upper - x.lower >= 2 * pi
        span = "any" if any_angle else f"{interval(x.lower, x.upper)}{unit}"
        same.setdefault(span, []).append(x.name)
    return "; ".join(f"{', '.join(names)} {span}" for span, names in same.items())


def _inapplicable_row(data: ReportData, one: Inapplicable) -> _Row:
    reason = f"{one.sentence[0].upper()}{one.sentence[1:]}."
    return (
        Cell(one.claim, code=True),
        Cell("not applicable", "note"),
        reason,
        f"{_where(data, data.vehicle.name)}.",
        "This claim does not count towards the result.",
    )


def _region_row(data: ReportData, one: Inapplicable) -> _Row:
    return (
        Cell(one.claim, code=True),
        Cell("not provable", "note"),
        f"Not provable for {one.to}, because {one.because}.",
        f"{_where(data, data.vehicle.name)}.",
        "No region of attraction of the dynamic loop; this does not count towards the result.",
    )


def render_page(data: ReportData, *, runs: Section | None = None) -> str:
    """Return the report as one HTML text without links to the network; all text is escaped.

    Args:
        data: the contents of the report.
        runs: result of `runs_section` for `data`, if it was rendered before.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import ReportData, render_page
        >>> from surctl.marine.vehicle import load_vehicle
        >>> data = ReportData(
        ...     title="Pool",
        ...     command="",
        ...     version="1.0",
        ...     vehicle=load_vehicle("sur400"),
        ...     gains=load_gains("default"),
        ...     summary=((True, "margins suffice"),),
        ... )
        >>> page = render_page(data)
        >>> "margins suffice" in page, "https://" in page
        (True, False)
    """
    return render_sections(
        title=data.title,
        subject=_subject(data),
        version=data.version,
        command=data.command,
        outcome=_outcome(data),
        summary=data.summary,
        sections=_sections(data, runs),
    )


def _sections(data: ReportData, runs: Section | None) -> tuple[Section, ...]:
    # decisive run, margins and claims, folded details, parameters
    decisive = decisive_section(data)
    sections = [] if decisive is None else [decisive]
    if data.margins or data.linear or data.verdicts or data.inapplicable:
        sections.append(findings_section(data))
    if data.margins or data.loops:
        sections.append(loops_section(data))
    if data.verdicts:
        sections.append(claims_section(data))
    if data.runs:
        sections.append(runs or runs_section(data))
    if data.sweep is not None:
        sections.append(sweep_section(data, data.sweep))
    if data.export is not None:
        sections.append(export_section(data.export))
    if data.seconds:
        sections.append(time_section(data))
    return (*sections, vehicle_section(data), gains_section(data))


def _subject(data: ReportData) -> str:
    speeds = ""
    if data.speeds is not None:
        cruise, cap = data.speeds
        speeds = f", cruise speed {number(cruise)} m/s, speed limit {number(cap)} m/s"
    return f"Vehicle {data.vehicle.name}, gains {data.gains.name}{speeds}."


def _outcome(data: ReportData) -> tuple[str, str]:
    failed = sum(line[0] is False for line in data.summary)
    words = {
        False: f"{failed} {'check fails' if failed == 1 else 'checks fail'}.",
        None: "No check counts towards the result.",
        True: "All checks hold.",
    }
    return marked(data.passed, data.banner or words[data.passed])


def write_page(data: ReportData, path: Path | str, *, runs: Section | None = None) -> Path:
    """Render the report with `render_page` and write it; the file is replaced in one step or stays unchanged.

    Returns:
        The path of the written file.

    Raises:
        InputError: the folder cannot be written.
    """
    return write_file(Path(path), render_page(data, runs=runs))
