"""The report of a study as one HTML file; its table of figures and claims, with claims that do not apply."""

from __future__ import annotations

from math import pi
from pathlib import Path

from surctl.files import read_toml
from surctl.marine.report.evidence_sections import claims_section, decisive_section, runs_section
from surctl.marine.report.sections import (
    ReportData,
    gains_section,
    loops_section,
    picked_section,
    vehicle_section,
)
from surctl.report.document import Cell, Paragraph, Section, Table
from surctl.report.study_page import figures_table, study_page
from surctl.report.theme import interval, number
from surctl.verification import Claim, Inapplicable, Verdict

_Row = tuple[Cell | str, ...]
_WIDTHS = (12, 11, 34, 27, 16)  # [%]
_WORDS = read_toml(Path(__file__).with_name("claims.toml"))  # of the library's claims, without formulas
_LEADS = {"proved": "It is proved that", "refuted": "It is not true that"}


def findings_section(data: ReportData) -> Section:
    """Return a section with the figures of the assessment, and a table with one row for each claim."""
    rows = [_claim_row(data, verdict) for verdict in data.verdicts]
    rows += [_inapplicable_row(data, one) for one in data.inapplicable]
    rows += [_region_row(data, one) for one in data.regions]
    text = (
        "Margins concern the loop linearised about straight cruise; they do not cover thrust saturation, large errors, "
        "avoidance and curved paths. The paper's claims concern the kinematic loop, in which velocities follow their "
        "commands without delay. Some claims are expected to be refuted as printed."
    )
    figures = (figures_table(data.assessment),) if data.assessment.figures else ()
    heads = ("claim", "verdict", "what holds", "vehicle, speed and set", "not covered")
    table = Table("What holds, for which vehicle, speed and set", heads, tuple(rows), _WIDTHS)
    tables = (*figures, *((table,) if rows else ()))
    return Section("margins", "Margins and claims", (Paragraph(text), *tables))


def _where(data: ReportData, vehicle: str) -> str:
    if data.speeds is None:
        return vehicle
    cruise, cap = data.speeds
    return f"{vehicle}; cruise speed {number(cruise)} m/s, speed limit {number(cap)} m/s"


def _claim_row(data: ReportData, v: Verdict) -> _Row:
    words = _WORDS[v.claim.name] if v.claim.paper else {"clause": v.claim.statement, "beyond": ""}
    lead = _LEADS.get(v.verdict, "It is not known whether")
    count = f"; {number(100 * v.fraction, digits=3)} % of the samples in this set violate it"
    share = count if v.verdict == "refuted" else ""
    expected = "as expected" if v.as_expected else "NOT expected"
    good = v.as_expected and v.verdict == "proved"  # a refuted claim does not have the colour of a proof
    return (
        Cell(v.claim.name, code=True, anchor=f"claims-{v.claim.name}"),
        Cell(f"{v.verdict}, {expected}", "good" if good else "note" if v.as_expected else "bad"),
        f"{lead} {words['clause']}{share}.",
        f"{_where(data, data.vehicle.name)}; {_domain(v.claim)}.",
        _beyond(v, words["beyond"]),
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
    names = one.claim.split(", ")
    several = f"{len(names)} claims, from {names[0]} to {names[-1]}"
    return (
        Cell(several if len(names) > 3 else one.claim, code=True),
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
        >>> from surctl.assessment import Assessment, Line
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import ReportData, render_page
        >>> from surctl.marine.vehicle import load_vehicle
        >>> data = ReportData(
        ...     title="Pool",
        ...     command="",
        ...     version="1.0",
        ...     vehicle=load_vehicle("sur400"),
        ...     gains=load_gains("default"),
        ...     assessment=Assessment("pool", {}, (Line(True, "margins suffice"),), {}),
        ... )
        >>> page = render_page(data)
        >>> "margins suffice" in page, "https://" in page
        (True, False)
    """
    evidence = [one for one in (decisive_section(data),) if one is not None]
    if data.linear or data.verdicts or data.inapplicable:
        evidence.append(findings_section(data))
    if data.linear or data.loops:
        evidence.append(loops_section(data))
    if data.verdicts:
        evidence.append(claims_section(data))
    if data.runs:
        evidence.append(runs or runs_section(data))
    return study_page(
        title=data.title,
        about=_subject(data),
        command=data.command,
        version=data.version,
        assessment=data.assessment,
        evidence=evidence,
        sweep=None if data.sweep is None else picked_section(data, data.sweep),
        export=data.export,
        seconds=data.seconds,
        numbers=[vehicle_section(data), gains_section(data)],
    )


def _subject(data: ReportData) -> str:
    speeds = ""
    if data.speeds is not None:
        cruise, cap = data.speeds
        speeds = f", cruise speed {number(cruise)} m/s, speed limit {number(cap)} m/s"
    return f"Vehicle {data.vehicle.name}, gains {data.gains.name}{speeds}."
