"""Table of margins and claims, with what holds, for which vehicle, speed and set, and what is not covered."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

from surctl.marine.report.data import ReportData
from surctl.marine.verification.linear import LinearSide
from surctl.report.claim_words import claim_words
from surctl.report.document import Cell, Paragraph, Section, Table, outcome_cell
from surctl.report.numbers import interval, number
from surctl.verification import Claim, Inapplicable, LoopMargins, Verdict

__all__ = ["findings_section"]

Row = tuple[Cell | str, ...]
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


def _loops_row(data: ReportData) -> Row:
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


def _together_row(data: ReportData, side: LinearSide) -> Row:
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


def _claim_row(data: ReportData, v: Verdict) -> Row:
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


def _inapplicable_row(data: ReportData, one: Inapplicable) -> Row:
    reason = f"{one.sentence[0].upper()}{one.sentence[1:]}."
    return (
        Cell(one.claim, code=True),
        Cell("not applicable", "note"),
        reason,
        f"{_where(data, data.vehicle.name)}.",
        "This claim does not count towards the result.",
    )


def _region_row(data: ReportData, one: Inapplicable) -> Row:
    return (
        Cell(one.claim, code=True),
        Cell("not provable", "note"),
        f"Not provable for {one.to}, because {one.because}.",
        f"{_where(data, data.vehicle.name)}.",
        "No region of attraction of the dynamic loop; this does not count towards the result.",
    )
