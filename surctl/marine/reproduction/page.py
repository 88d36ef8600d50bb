"""Write the reproduction as a self-contained HTML page, with the paper's figures drawn from simulated runs."""

from __future__ import annotations

from pathlib import Path

from surctl import __version__
from surctl.files import write_file
from surctl.marine.report import plot_coordinates, plot_position_errors, plot_run, plot_series
from surctl.marine.reproduction.reproduction import Reproduction
from surctl.marine.reproduction.row import Row
from surctl.marine.reproduction.scenarios import scenario_names
from surctl.marine.simulation import Run
from surctl.report import render_sections
from surctl.report.document import Block, Cell, Pictures, Section, Table, outcome_cell, picture

__all__ = ["write_reproduction"]

_SERIES = ("tank-speed", "pool-speed")


def write_reproduction(done: Reproduction, path: Path, *, command: str) -> Path:
    """Write an HTML page with one table for each group of comparisons.

    If scenarios are among the comparisons, the page also shows figures of one run for each scenario.

    The figures show runs with true positions and seed 0.

    Args:
        done: the computed comparisons.
        path: path of the HTML page.
        command: the command line that created the HTML page.

    Raises:
        InputError: if the folder cannot be written.
    """
    failing = [row.item.id for row in done.rows if not row.as_expected]
    failing += [f"{name} (missing)" for name in done.missing]
    outcome = (
        ("bad", f"✗ Not as expected: {', '.join(failing)}.") if failing else ("good", "✓ Every row is as expected.")
    )
    groups = list(dict.fromkeys(row.item.group for row in done.rows))
    sections = [_table(group, [row for row in done.rows if row.item.group == group]) for group in groups]
    if {"scenarios", "position errors"} & set(groups):
        runs = [done.simulations.run(name) for name in scenario_names()]
        sections += [_trajectories(runs), _series(runs), _errors(runs)]
    counts = [
        (
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
        outcome=outcome,
        summary=counts,
        sections=sections,
    )
    return write_file(path, text)


def _table(group: str, rows: list[Row]) -> Section:
    further = [
        (head, texts)
        for head, texts in (
            ("independent engine", [row.result.independent for row in rows]),
            ("echoes as in Webots", [row.result.webots for row in rows]),
        )
        if any(texts)
    ]
    heads = (
        "row",
        "what",
        "paper",
        "ours",
        *(head for head, _ in further),
        "verdict",
        "as expected",
        "command",
        "time [s]",
    )
    cells: tuple[tuple[Cell | str, ...], ...] = tuple(
        (
            Cell(row.item.id, code=True),
            row.item.what,
            row.item.paper,
            row.result.ours,
            *(texts[k] for _, texts in further),
            Cell(row.result.verdict, "good" if row.result.word == "agrees" else "note"),
            outcome_cell(row.as_expected, "yes", "NO"),
            Cell(row.item.command, code=True),
            Cell(f"{row.seconds:.2f}", number=True),
        )
        for k, row in enumerate(rows)
    )
    return Section(group.replace(" ", "-"), group.capitalize(), (Table(group.capitalize(), heads, cells),))


def _trajectories(runs: list[Run]) -> Section:
    # as in Figs. 6, 8, 11, 13, 15
    blocks: list[Block] = []
    for run in runs:
        name, m = run.scenario.name, run.metrics
        result = f"{m.stopped_because} after {m.time_s:.1f} s, least clearance {m.min_clearance_m:.3f} m"
        command = f"surctl simulate {name}"
        plan = picture(
            plot_run(run), alt=f"Plan view of {name}: {result}", caption=f"{name}: {result}.", command=command
        )
        over_time = picture(
            plot_coordinates([run], title=f"{name}: coordinates over time"),
            alt=f"x, y and z of {name} over time",
            caption="Coordinates x, y and z in m over time in s.",
            command=command,
        )
        blocks.append(Pictures((plan, over_time)))
    return Section("trajectories", "Trajectories and coordinates", tuple(blocks))


def _series(runs: list[Run]) -> Section:
    # as in Figs. 17 and 19
    blocks: list[Block] = []
    for series in _SERIES:
        chosen = [run for run in runs if run.scenario.name.startswith(series)]
        command = "surctl simulate " + " ".join(run.scenario.name for run in chosen)
        plan = picture(
            plot_series(chosen, title=f"{series}: paths"),
            alt=f"Paths of {series} at four speeds of the obstacle",
            caption="Paths of the robot at four speeds of the obstacle.",
            command=command,
        )
        over_time = picture(
            plot_coordinates(chosen, title=f"{series}: coordinates over time"),
            alt=f"x, y and z of {series} over time",
            caption="Coordinates x, y and z in m over time in s.",
            command=command,
        )
        blocks.append(Pictures((plan, over_time)))
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
        pictures.append(
            picture(
                plot_position_errors(chosen, title=f"position error, {where}", bound=bound),
                alt=f"Distance to the path over time, {where}",
                caption="Distance to the path, including intervals of avoidance; E_p excludes these intervals.",
                command="surctl simulate " + " ".join(names),
            )
        )
    return Section("errors", "Position errors over time", (Pictures(tuple(pictures)),))
