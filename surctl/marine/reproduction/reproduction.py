"""`surctl reproduce`: rows for claims, Tables I and II and instants; which rows are required; its HTML page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from surctl import __version__
from surctl.assessment import Line
from surctl.errors import InputError, check_known
from surctl.files import write_file
from surctl.marine.report import plot_run
from surctl.marine.report.paper_plots import plot_coordinates, plot_position_errors, plot_series
from surctl.marine.reproduction.errata import errata_items, percent_at
from surctl.marine.reproduction.range_test import MEDIA, Medium, table_ii
from surctl.marine.reproduction.row import WORDS, Item, Result, Row, Word, agrees, differs, wrong_in_print
from surctl.marine.reproduction.scenarios import (
    ABOUT,
    Simulations,
    hull_items,
    limit_items,
    position_items,
    scenario_items,
    scenario_names,
    time_verdict,
)
from surctl.marine.sensing import SonarArray
from surctl.marine.simulation import Run
from surctl.marine.verification import claims
from surctl.marine.world import Box, Disc
from surctl.report.document import Block, Cell, Pictures, Section, Table, outcome_cell, picture, render_sections
from surctl.verification import Claim, decide
from surctl.verification.setting import Setting

FULL = 4096
"""Number of samples that the falsifier of `surctl verify` uses."""

_SPEEDS = f"--cruise {Setting.speed:g} --cap {Setting.speed_max:g}"
"""Options with the speeds of the paper; without them, `surctl verify` uses the speeds of a scenario."""


def claim_items(gains: Mapping[str, float], *, samples: int = FULL) -> list[Item]:
    """Return, for each claim of the paper, the comparison of its verdict with the expected one, for these gains.

    The falsifier takes `samples` samples per claim.
    """
    return [
        Item(
            claim.name,
            "claims",
            claim.statement,
            "; ".join([claim.equation, *claim.errata]),
            "wrong in print" if claim.expected == "refuted" else "agrees",
            partial(judged, claim, samples),
            f"surctl verify {claim.name} {_SPEEDS}" if samples == FULL else f"surctl reproduce {claim.name} --quick",
        )
        for claim in claims(gains)
        if claim.paper
    ]


def judged(claim: Claim, samples: int) -> Result:
    """Return the verdict on a claim: refuted by a counterexample, proved by a checked certificate, or undecided."""
    verdict = decide(claim, samples=samples)
    counterexample, unit = verdict.counterexample, claim.unit
    if verdict.certificate is not None:
        slack = verdict.certificate["claim"]["slack"]
        within = f" with a slack of {slack:.1g} {unit}" if slack else ""
        ours = f"proved{within} by a certificate that the checker accepts"
        return agrees(ours, worst_margin=verdict.worst_margin, slack=slack)
    if counterexample is None:
        return differs("undecided", verdict.remaining or "", worst_margin=verdict.worst_margin)
    where = ", ".join(f"{name} = {number:.4g}" for name, number in counterexample.values.items())
    share = f"the claim fails for {100 * verdict.fraction:.3g} % of the samples"
    ours = f"refuted: the bound is exceeded by {counterexample.margin:.3g} {unit}; {share}"
    return wrong_in_print(ours, f"at {where}", margin=counterexample.margin, fraction=verdict.fraction)


_APART = 1.0  # [s] a shorter interruption does not end an avoidance


def instant_items(simulations: Simulations) -> list[Item]:
    """Return a comparison for each time that the paper gives for a scenario of the library."""
    items = []
    for name in scenario_names():
        paper = simulations.scenario(name).paper
        near = ", ".join(f"{t:g}" for t in paper.transients_s)
        for what, words, printed, compute in (
            ("transients", "start times of avoidance", f"near {near} s" * bool(near), _transients),
            (
                "detected",
                "start time of avoidance of the moving obstacle",
                "" if paper.detected_s is None else f"at about {paper.detected_s} s",
                _detected,
            ),
            (
                "passed",
                "time after which no moving obstacle is ahead",
                "" if paper.passed_s is None else f"by {paper.passed_s} s",
                _passed,
            ),
        ):
            about, run = f"{words} in {name}, true positions, seed 0", partial(compute, simulations, name)
            items += [Item(f"{name}-{what}", "scenarios", about, printed, None, run)] if printed else []
    return items


def avoidances(run: Run) -> list[float]:
    """Return the start times [s] of the intervals in which the law avoids an obstacle."""
    time = run.record.time[run.telemetry("avoiding")[:, 0] > 0.5]
    return [float(t) for k, t in enumerate(time) if k == 0 or t - time[k - 1] > _APART]


def _passed_at(run: Run) -> float:
    """Return the last time [s] at which a moving obstacle is ahead of the robot; 0 if there is no such time.

    Ahead means farther in the direction from start to target.
    """
    direction = run.scenario.target - run.scenario.start
    last = 0.0
    for time, eta, bodies in zip(run.record.time, run.record.eta, run.record.obstacles, strict=True):
        for body in bodies:
            if body.moving and isinstance(body.shape, Disc | Box):
                ahead = (np.asarray(body.shape.center) - eta[:2]) @ direction
                last = float(time) if ahead > 0 else last
    return last


def _transients(simulations: Simulations, name: str) -> Result:
    ours, paper = avoidances(simulations.run(name)), simulations.scenario(name).paper.transients_s
    text = f"avoidance begins at {', '.join(f'{t:.1f}' for t in ours) or 'no time'} s"
    numbers = {f"begins_{k}_s": t for k, t in enumerate(ours)}
    off = [min((abs(t - t0) / t0 for t in ours), default=np.inf) for t0 in paper]
    if len(ours) == len(paper) and max(off) <= ABOUT:
        return agrees(text, **numbers)
    scenario, radius = simulations.scenario(name), simulations.run(name).vehicle["radius"]
    path = [(float(x), float(y)) for x, y in np.linspace(scenario.start, scenario.target, 200)]
    clearances = [min(obstacle.distance(point) for point in path) - radius for obstacle in scenario.obstacles]
    left = ", ".join(f"{clearance:.2f}" for clearance in clearances)
    why = f"{len(ours)} instead of {len(paper)}: on the straight path, the clearances to the obstacles are {left} m"
    return differs(text, why, **numbers)


def _detected(simulations: Simulations, name: str) -> Result:
    ours, paper = avoidances(simulations.run(name)), simulations.scenario(name).paper.detected_s or np.nan
    if not ours:
        return differs(
            "no avoidance was needed",
            f"the robot's path stays clear of the obstacle, so the paper's {paper:g} s has no counterpart",
        )
    good, off = time_verdict(ours[0], paper, "about")
    text, apart = f"avoidance begins at {ours[0]:.2f} s", _apart(simulations.run(name), ours[0])
    if good:
        return agrees(text, begins_s=ours[0], apart_m=apart)
    why = f"{off}: the law receives the obstacle's true position and begins to avoid at {apart:.2f} m between centres"
    return differs(text, why, begins_s=ours[0], apart_m=apart)


def _passed(simulations: Simulations, name: str) -> Result:
    ours, paper = _passed_at(simulations.run(name)), simulations.scenario(name).paper.passed_s or np.nan
    good, off = time_verdict(ours, paper, "about")
    text = f"no moving obstacle is ahead after {ours:.2f} s"
    return agrees(text, passed_s=ours) if good else differs(text, off, passed_s=ours)


def _apart(run: Run, time: float) -> float:
    # [m], between the centres of robot and moving body; inf without a moving body
    k = int(np.argmin(np.abs(run.record.time - time)))
    centres = [b.shape.center for b in run.record.obstacles[k] if b.moving and isinstance(b.shape, Disc | Box)]
    return min((float(np.hypot(*(np.asarray(c) - run.record.eta[k, :2]))) for c in centres), default=float("inf"))


def table_items() -> list[Item]:
    """Return the comparisons for Table I (range and resolution) and for Table II.

    No model uses the other quantities of Table I: size, supply and frequency.
    """
    items = [
        Item(f"table-i-{name}", "tables", what, f"Table I: {paper}", word, partial(_sensor, name, printed))
        for name, what, paper, printed, word in _SENSOR
    ]
    test = table_ii()
    for medium in MEDIA:
        for k, (distance, printed) in enumerate(
            zip(100 * test.desired, test.column(medium).printed_percent, strict=True)
        ):
            name, what = f"table-ii-{medium}-{round(distance):03d}", f"error at {distance:.0f} cm in {medium}"
            word: Word = "wrong in print" if (medium, round(distance)) == _E2 else "agrees"
            items.append(
                Item(name, "tables", what, f"Table II: {printed:.1f} %", word, partial(_percentage, medium, k))
            )
    return items


_SENSOR: tuple[tuple[str, str, str, float, Word], ...] = (
    ("minimum", "minimum range of the sensor", "0.2 m", 0.2, "agrees"),
    ("maximum", "maximum range of the sensor", "4.5 m", 4.5, "agrees"),
    ("resolution", "resolution of the sensor", "about 5 mm", 0.005, "differs"),
)
_E2 = ("water", 85)  # the row whose percentage is printed wrongly


def _sensor(name: str, printed: float) -> Result:
    # Table I, compared with the default sonar array
    ours = float(getattr(SonarArray(), "blind" if name == "minimum" else name))
    text = f"{ours:.4g} m" if name != "resolution" else f"{1e3 * ours:.2f} mm"
    # a step finer than "about 5 mm" also agrees
    if ours <= (1 + ABOUT) * printed if name == "resolution" else abs(ours - printed) <= 1e-9:
        return agrees(text, metres=ours)
    why = f"section II-B gives a conversion with {SonarArray().bits} bits over {SonarArray().maximum:g} m"
    return differs(text, why, metres=ours)


def _percentage(medium: Medium, k: int) -> Result:
    # agrees if the recomputed percentage rounds to the printed decimal
    ours, why = percent_at(medium, k)
    if k not in table_ii().disagreeing(medium):
        return agrees(f"{ours:.3f} %", percent=ours)
    return wrong_in_print(f"{ours:.3f} %", why, percent=ours)


SEEDS, QUICK_SEEDS = 20, 3
_QUICK_SAMPLES = 512


@dataclass(frozen=True, eq=False)
class Reproduction:
    """Computed comparisons of the paper with the results of this project.

    Attributes:
        rows: the computed comparisons, in order.
        missing: ids of required comparisons that nothing computes; empty if only a selection is computed.
        seeds: number of seeds (runs) of each scenario.
        simulations: the simulations of the scenarios, from which the comparisons are computed.
    """

    rows: tuple[Row, ...]
    missing: tuple[str, ...]
    seeds: int
    simulations: Simulations

    @property
    def passed(self) -> bool:
        """Whether no comparison is missing and every comparison has the expected result."""
        return not self.missing and all(row.as_expected for row in self.rows)

    @property
    def counts(self) -> str:
        """How many comparisons have which verdict, and how many are as expected."""
        by_word = Counter(row.result.word for row in self.rows)
        words = ", ".join(f"{by_word[word]} {word}" for word in WORDS if by_word[word])
        return f"{words}; {sum(row.as_expected for row in self.rows)} of {len(self.rows)} rows as expected"

    def to_dict(self) -> dict[str, Any]:
        """Return the reproduction as plain data for JSON; the writer must handle numbers that are not finite."""
        return {
            "passed": self.passed,
            "seeds": self.seeds,
            "missing": list(self.missing),
            "seconds": round(sum(row.seconds for row in self.rows), 3),
            "rows": [row.to_dict() for row in self.rows],
        }


def items(simulations: Simulations, *, samples: int = FULL) -> list[Item]:
    """Return all comparisons, not yet computed: claims, tables, errata, scenarios, position errors.

    Example:
        >>> from surctl.marine.reproduction import Simulations, items
        >>> [item] = [item for item in items(Simulations(3)) if item.id == "E12"]
        >>> print(item.what, "|", item.paper, "|", item.expected)
        the obstacle's own velocity in V̇2 | (24): omitted | wrong in print
    """
    return [
        *claim_items(simulations.gains.values, samples=samples),
        *table_items(),
        *errata_items(),
        *scenario_items(simulations),
        *hull_items(simulations),
        *limit_items(simulations),
        *instant_items(simulations),
        *position_items(simulations),
    ]


def required() -> list[str]:
    """Return the ids of all required comparisons: claims, percentages, errata, scenarios and position errors.

    Example:
        >>> from surctl.marine.reproduction import required
        >>> ids = required()
        >>> ids[0], ids[-1], [name for name in ids if name.startswith("tank-s")][:2]
        ('v1-printed', 'position-error-pool', ['tank-slalom', 'tank-speed-010'])
    """
    percentages = [f"table-ii-{medium}-{round(100 * d):03d}" for medium in MEDIA for d in table_ii().desired]
    return [
        *(claim.name for claim in claims() if claim.paper),
        *percentages,
        *(f"E{k}" for k in range(1, 22)),
        *scenario_names(),
        "position-error-tank",
        "position-error-pool",
    ]


def reproduce(
    names: Sequence[str] = (),
    *,
    quick: bool = False,
    seeds: int | None = None,
    independent: bool = False,
    webots: bool = False,
    progress: Callable[[str], None] = lambda _: None,
    done: Callable[[Row], None] = lambda _: None,
) -> Reproduction:
    """Compute the comparisons with the given ids, or all comparisons.

    Args:
        names: ids of the comparisons; an empty sequence selects all comparisons.
        quick: whether to use fewer seeds and samples.
        seeds: number of seeds of the compiled loop for each scenario; default: 20, or 3 if `quick` is true.
        independent: whether each scenario is simulated in MuJoCo, too (seed 0, six degrees of freedom).
        webots: whether each scenario with sonars is simulated with echoes as in the paper's simulator, too.
        progress: function that is called with the id of each comparison before its computation.
        done: function that is called with each comparison as soon as it is computed.

    Raises:
        InputError: an id is unknown (the error suggests the nearest known id), the number of seeds is less than 1, or
            `independent` or `webots` has no effect on any of the comparisons.
        ToolMissing: MuJoCo is requested, but it is not installed.

    Example:
        >>> from surctl.marine.reproduction import reproduce
        >>> [row] = reproduce(["E3"]).rows
        >>> print(row.item.paper, "|", row.result.ours, "|", row.result.word)
        II-C: less than 4.5 cm | largest error 3.0 cm | differs
    """
    count = seeds if seeds is not None else QUICK_SEEDS if quick else SEEDS
    simulations = Simulations(count, independent=independent, webots=webots)
    known = {item.id: item for item in items(simulations, samples=_QUICK_SAMPLES if quick else FULL)}
    for name in names:
        check_known(name, known, "no such row", key="row")
    for option, chosen, rows_with in (
        ("independent", independent, "a scenario, such as tank-static"),
        ("webots", webots, "a scenario with sonars, such as tank-static-sonar"),
    ):
        if chosen and names and not any(option in known[name].options for name in names):
            remedy = f"drop this option, or name the row of {rows_with}"
            raise InputError(f"has no effect on {', '.join(names)}", key=f"--{option}", remedy=remedy)
    if independent:
        from surctl.marine.engine.mjcf import mujoco_library

        mujoco_library()
    rows = []
    for name in names or known:
        progress(name)
        rows.append(known[name].row())
        done(rows[-1])
    missing = () if names else tuple(name for name in required() if name not in known)
    return Reproduction(tuple(rows), missing, simulations.seeds, simulations)


# Write the reproduction as a self-contained HTML page, with the paper's figures drawn from simulated runs


_SERIES = ("tank-speed", "pool-speed")


def write_reproduction(done: Reproduction, path: Path, *, command: str) -> Path:
    """Write an HTML page with one table for each group of comparisons, made by the command line `command`.

    If scenarios are among the comparisons, the page also shows figures of one run of each, with true positions and seed
    0.
    """
    failing = [row.item.id for row in done.rows if not row.as_expected]
    failing += [f"{name} (missing)" for name in done.missing]
    groups = list(dict.fromkeys(row.item.group for row in done.rows))
    sections = [_table(group, [row for row in done.rows if row.item.group == group]) for group in groups]
    if {"scenarios", "position errors"} & set(groups):
        runs = [done.simulations.run(name) for name in scenario_names()]
        sections += [_trajectories(runs), _series(runs), _errors(runs)]
    counts = [
        Line(
            all(row.as_expected for row in rows),
            f"{group}: {sum(r.as_expected for r in rows)} of {len(rows)} as expected",
        )
        for group in groups
        for rows in [[row for row in done.rows if row.item.group == group]]
    ]
    text = render_sections(
        title="The paper and our results side by side",
        subject=f"Each scenario is simulated with {done.seeds} seeds and the gain set {done.simulations.gains.name}.",
        version=__version__,
        command=command,
        passed=not failing,
        banner=f"Not as expected: {', '.join(failing)}." if failing else f"{done.counts}.",
        lines=counts,
        sections=sections,
    )
    return write_file(path, text)


def _table(group: str, rows: list[Row]) -> Section:
    further = {
        "independent engine": [row.result.independent for row in rows],
        "echoes as in Webots": [row.result.webots for row in rows],
    }
    further = {head: texts for head, texts in further.items() if any(texts)}
    heads = ("row", "what", "paper", "ours", *further, "verdict", "as expected", "command", "time [s]")
    cells: tuple[tuple[Cell | str, ...], ...] = tuple(
        (
            Cell(row.item.id, code=True),
            row.item.what,
            row.item.paper,
            row.result.ours,
            *(texts[k] for texts in further.values()),
            Cell(row.result.verdict, "good" if row.result.word == "agrees" else "note"),
            outcome_cell(row.as_expected, "yes", "NO"),
            Cell(row.item.command, code=True),
            Cell(f"{row.seconds:.2f}", number=True),
        )
        for k, row in enumerate(rows)
    )
    shares = (11, 20, 10, 18, *(12 for _ in further), 18, 8, 10, 5)
    widths = tuple(100 * share // sum(shares) for share in shares)
    return Section(group.replace(" ", "-"), group.capitalize(), (Table(group.capitalize(), heads, cells, widths),))


def _over_time(plan: Axes, runs: Sequence[Run], name: str, about: tuple[str, str]) -> Pictures:
    """Return a plan view, with its description and caption `about`, beside the coordinates over time of these runs."""
    command = "surctl simulate " + " ".join(run.scenario.name for run in runs)
    coordinates = plot_coordinates(runs, title=f"{name}: coordinates over time")
    text = "Coordinates x, y and z in m over time in s."
    return Pictures(
        (
            picture(plan, alt=about[0], caption=about[1], command=command),
            picture(coordinates, alt=f"x, y and z of {name} over time", caption=text, command=command),
        )
    )


def _trajectories(runs: list[Run]) -> Section:
    # as in Figs. 6, 8, 11, 13, 15
    blocks: list[Block] = []
    for run in runs:
        name, m = run.scenario.name, run.metrics
        result = f"{m.stopped_because} after {m.time_s:.1f} s, least clearance {m.min_clearance_m:.3f} m"
        blocks.append(_over_time(plot_run(run), [run], name, (f"Plan view of {name}: {result}", f"{name}: {result}.")))
    return Section("trajectories", "Trajectories and coordinates", tuple(blocks))


def _series(runs: list[Run]) -> Section:
    # as in Figs. 17 and 19
    blocks: list[Block] = []
    for series in _SERIES:
        chosen = [run for run in runs if run.scenario.name.startswith(series)]
        about = (
            f"Paths of {series} at four speeds of the obstacle",
            "Paths of the robot at four speeds of the obstacle.",
        )
        blocks.append(_over_time(plot_series(chosen, title=f"{series}: paths"), chosen, series, about))
    return Section("series", "Four speeds of the moving obstacle", tuple(blocks))


def _errors(runs: list[Run]) -> Section:
    # as in Fig. 20
    pictures = []
    for where, names in (
        ("simulation", ("tank-static", "tank-moving", "tank-speed-015")),
        ("pool", ("pool-static", "pool-ahead", "pool-behind")),
    ):
        chosen = [run for run in runs if run.scenario.name in names]
        bound = chosen[0].scenario.paper.position_error_m
        plot = plot_position_errors(chosen, title=f"position error, {where}", bound=bound)
        text = "Distance to the path, including intervals of avoidance; E_p excludes these intervals."
        alt, command = f"Distance to the path over time, {where}", "surctl simulate " + " ".join(names)
        pictures.append(picture(plot, alt=alt, caption=text, command=command))
    return Section("errors", "Position errors over time", (Pictures(tuple(pictures)),))
