"""`surctl sweep`: results over gains and other parameters, files and pictures; of a system, its best points."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli import lib
from surctl.cli.application import to_application
from surctl.cli.options import FOLDER, Count, option, options
from surctl.cli.output import as_json, finish, progress, same_command, saving, stoppable
from surctl.cli.subject import OwnSystem, is_system, load_system, seconds_option
from surctl.errors import InputError, check_known

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray


_SHOWN = 40  # largest number of points in the text output; the file holds all points
_MOST_JSON = 100_000  # largest number of points printed as JSON


@dataclass(frozen=True, eq=False, repr=False)
class SweepOptions:
    """The options about the points of a sweep of any subject, and about what computes it."""

    design: str = option("--design", "Points: grid (default), lhs (Latin hypercube) or sobol.", "grid", metavar="NAME")
    points: int | None = option("--points", "Number of points of --design lhs or sobol.", type=Count(1))
    sensitivity: str | None = option(
        "--sensitivity",
        "Compute Sobol' indices of a cost from N (d + 2) points: d swept parameters, N = --points (default 64).",
        metavar="COST",
    )
    seeds: int = option(
        "--seeds", "Simulate each point with the seeds 0 to N-1 (default 1).", 1, type=Count(1, 1_000_000)
    )
    workers: int | None = option("--workers", "Number of processes or threads (default 2).", type=Count(1))
    dask: str | None = option("--dask", "Run on the Dask scheduler at ADDRESS, not locally.", metavar="ADDRESS")
    out: Path = option(
        "--out",
        "Folder for sweep.nc (default surctl-out). The same command continues an interrupted sweep.",
        Path("surctl-out"),
        type=FOLDER,
    )

    def executor(self) -> lib.Executor:
        """Return what computes the chunks."""
        if self.workers is not None and self.dask is not None:
            raise click.UsageError("--workers and --dask exclude each other")
        return lib.LocalExecutor(self.workers or 2) if self.dask is None else lib.DaskExecutor(self.dask)


@click.command
@click.argument(
    "words", nargs=-1, required=True, metavar="[FILE.py:FUNCTION] PARAMETER=V1,V2,...|LOW..HIGH[:COUNT][:log] ..."
)
@seconds_option
@options(options=SweepOptions)
@as_json
def sweep(words: tuple[str, ...], options: SweepOptions, seconds: float | None, as_json: bool, **_: Any) -> None:
    """Compute costs over values of parameters, and select the best point."""
    if options.sensitivity is not None and options.design != "grid":
        problem = "chooses its own points"
        raise InputError(problem, key="--sensitivity", value=options.sensitivity, remedy="drop --design")
    executor = None if options.dask is None and is_system(words) else options.executor()
    job = _own(words, options, seconds) if is_system(words) else to_application(words)
    _run(job, executor, options, as_json=as_json)


def _run(job: SweepJob, executor: lib.Executor | None, options: SweepOptions, *, as_json: bool) -> None:
    """Run the sweep, write its tables and pictures, and end the command."""
    out, sensitivity = options.out, options.sensitivity
    if as_json and job.count > _MOST_JSON:
        problem, remedy = f"would print {job.count} {job.counted}", f"drop this option and read {job.file}"
        raise InputError(problem, key="--json", remedy=remedy)
    lib.prepare_folder(out)
    with stoppable(f"the finished {job.counted} are in {out}; to continue: {same_command()}"):
        table = lib.sweep(job.subject, job.design, executor=executor, out=out, progress=progress)
    sobol = None if sensitivity is None else lib.sobol_indices(job.design, table.mean(sensitivity), sensitivity)
    summary = job.summary(table, sobol, out, as_json)
    pictures = _pictures(job, table, sobol, out, summary.pictures)
    where = [f"{name} {path}" for name, path in summary.files.items()]
    lines = [*summary.lines, *where, *(f"plot  {picture}" for picture in pictures)]
    data = {
        **summary.data,
        "accepted": summary.passed,
        "sensitivity": None if sobol is None else sobol.to_dict(),
        "pictures": [str(picture) for picture in pictures],
    }
    brief = [*([sobol.headline()] if sobol is not None else []), *summary.brief]
    finish(data, lines, as_json=as_json, passed=summary.passed, then=summary.then, brief=brief, files=where)


@dataclass(frozen=True)
class SweepSummary:
    """What a sweep prints: lines, data, next commands (`then`), files by what they are, further pictures."""

    lines: list[str]
    brief: list[str]
    data: dict[str, Any]
    passed: bool
    then: list[str]
    files: dict[str, Path]
    pictures: dict[tuple[str, ...], Callable[[], Figure | Axes]]


@dataclass(frozen=True)
class SweepJob:
    """What the command line asks for; `plotted` are the columns in pictures, `mapped` those of heat maps."""

    subject: lib.SweepSubject
    design: lib.Design
    count: int
    counted: str
    file: str
    plotted: Sequence[str]
    mapped: Sequence[str]
    titles: Mapping[str, str]
    summary: Callable[[lib.SweepTable, lib.SobolIndices | None, Path, bool], SweepSummary]


def _pictures(
    job: SweepJob,
    table: lib.SweepTable,
    sobol: lib.SobolIndices | None,
    out: Path,
    more: Mapping[tuple[str, ...], Callable[[], Figure | Axes]],
) -> list[Path]:
    pictures = list[Path]()
    with saving("plots"):
        figures: dict[tuple[str, ...], Callable[[], Figure | Axes]] = {}
        if sobol is not None:
            figures["sensitivity", sobol.column] = sobol.plot
        elif table.axes:
            plotted = [name for name in job.plotted if name in table.columns]
            figures["sweep", "parallel"] = partial(lib.plot_parallel, table, plotted, titles=job.titles)
            names = [axis.name for axis in table.axes[:2]]
            for column in job.mapped if table.is_grid and len(names) > 1 else ():
                figures["sweep", *names, column] = partial(lib.plot_heat_map, table, column, titles=job.titles)
        for words, draw in (figures | dict(more)).items():
            with saving(" ".join(words)):
                if (stem := Path(str(table.path)).stem) != "sweep":  # the folder's sweep.nc is of another request
                    words = (stem, *words[words[0] == "sweep" :])
                pictures.append(lib.save_figure(draw(), out, words))
    return pictures


_MOST_REPEATED = 20_000  # largest number of control periods of a run that is repeated in Python
_NAMED = 5  # largest number of points that a line names


def _own(words: Sequence[str], options: SweepOptions, seconds: float | None) -> SweepJob:
    """Return the sweep of a system that the words and options ask for."""
    own = load_system(words)
    duration, costs = own.seconds(seconds), list(own.costs)
    design = options.design if options.sensitivity is None else "saltelli"
    if options.sensitivity is not None:
        check_known(options.sensitivity, costs, "is not a cost of the system", key="--sensitivity")
    axes = [lib.parse_axis(text) for text in own.settings]
    chosen, draws = lib.choices_and_draws(own.system, axes, design=design, points=options.points, seeds=options.seeds)
    threads = options.workers or (2 if options.dask is None else 1)
    subject = lib.SystemSweep(own.system, duration, draws, threads=threads, about=own.origin, source=own.word)
    count, summary = len(chosen.points) * max(map(len, draws.values()), default=1), partial(_run_summary, own, duration)
    return SweepJob(subject, chosen, count, "runs", "sweep.csv", costs, costs, {}, summary)


def _run_summary(
    own: OwnSystem, duration: float, table: lib.SweepTable, sobol: lib.SobolIndices | None, out: Path, as_json: bool
) -> SweepSummary:
    system, runs, at = own.system, lib.runs_of(table, own.system), table.numbers()
    count, files = len(runs.time), dict[str, Path]()
    with saving("table"):
        columns: dict[str, Sequence[Any]] = {name: values.tolist() for name, values in at.items()}
        columns |= {f"{name} [{c.unit}]": runs[name].tolist() for name, c in system.costs.items()}
        columns |= {"stopped": runs.stopped.tolist(), "duration [s]": runs.time.tolist()}
        files["table"] = lib.write_csv(Path(str(table.path)).with_suffix(".csv"), columns)
    files["netCDF"] = Path(str(table.path))
    choices = lib.chosen_points(table, system)
    best = best_points(table, system, choices)
    lost = [k for k, stopped in enumerate(runs.stopped) if stopped == lib.LOST]
    head = f"{system.title}: {count} runs of {duration:g} s, control period {system.dt:g} s"
    lines = [head, *(point_rows(table, list(system.costs), runs) if sobol is None else sobol.lines())]
    best_lines = [best_line(table, system, name, row, choices[name]) for name, row in best.items()]
    for name, line in zip(best, best_lines, strict=True):
        marked = [one for one in choices[name].assessment.lines if one.about]
        lines += [line, *(f"  {one.mark} {one.text}" for one in marked)]
    named = "; ".join(_numbers(_at(at, k)) for k in lost[:_NAMED]) + "; …" * (len(lost) > _NAMED)
    infinite = [f"{len(lost)} of {count} runs are not finite: {named}"] * bool(lost)
    lines += infinite
    lines += [f"  in the first of them: {name}" for k in lost[:1] if (name := _lost_number(system, runs, at, k))]
    steps = dict.fromkeys(text for one in choices.values() for text in one.assessment.decisive(lib.STEP))
    failures = [f"FAIL for the least {name}: {t}" for name, one in choices.items() for t in one.assessment.failures]
    data = {
        **own.names,
        "seconds": duration,
        "axes": {axis.name: sorted(set(axis.values.tolist())) for axis in table.axes},
        "random": list(table.draws),
        "units": {name: unit for name, unit in table.units.items() if not name.startswith("run.")},
        "runs_per_point": table.each,
        "results": [_result(runs, k) | {"at": _at(at, k)} for k in range(count)] if as_json else [],
        "best": best,
        "not_finite": [_at(at, k) for k in lost],
        "table": str(files["table"]) if "table" in files else None,
        "netcdf": str(files["netCDF"]),
    }
    then = []
    for row in list(best.values())[:1]:
        numbers = [f"{name}={value!r}" for name, value in (row["at"] | row["random"]).items()]
        then = [own.command("simulate", *numbers, "--seconds", f"{duration:g}")]
    return SweepSummary(
        lines, [head, *best_lines, *failures, *infinite, *steps], data,
        passed=bool(best) and all(choice.assessment.accepted() for choice in choices.values()), then=then, files=files,
        pictures={} if table.axes else {("sweep", "runs"): runs.plot},
    )  # fmt: skip


def _lost_number(system: lib.System, runs: lib.Runs, at: Mapping[str, NDArray[np.float64]], k: int) -> str:
    """Return the number of run k that is not finite, from a run in Python; "" if that run would take too long."""
    periods = round(float(runs.time[k]) / system.dt) + 2
    return lib.run_system(system, periods * system.dt, _at(at, k)).lost if periods < _MOST_REPEATED else ""


def _at(numbers: Mapping[str, NDArray[np.float64]], k: int) -> dict[str, float]:
    return {name: float(values[k]) for name, values in numbers.items()}


def _numbers(at: dict[str, float]) -> str:
    return ", ".join(f"{name}={value:.6g}" for name, value in at.items())


def _result(runs: lib.Runs, k: int) -> dict[str, Any]:
    costs = {name: float(values[k]) for name, values in runs.figures.items()}
    return {"costs": costs, "stopped": str(runs.stopped[k]), "duration_s": float(runs.time[k])}


def point_rows(table: lib.SweepTable, columns: Iterable[str], runs: lib.Runs | None = None) -> list[str]:
    """Return a line for each of the first points, with its parameters and the named columns."""
    rows, each, count = list[str](), table.each, math.prod(table.shape)
    known = {name: (table.worst(name).ravel(), table.mean(name).ravel()) for name in columns if name in table.columns}
    units = {name: f" {unit}" * (unit != "1") for name, unit in table.units.items()}
    for point in range(min(count, _SHOWN)):
        texts = [
            f"{name}={worst[point]:.6g}" + f" (mean {mean[point]:.6g})" * (each > 1) + units[name]
            for name, (worst, mean) in known.items()
        ]
        finite = any(math.isfinite(worst[point]) for worst, _ in known.values())
        stopped, k = "", point * each
        if runs is not None and each > 1:
            stopped = _ends(runs.stopped[k : k + each])
        elif runs is not None:
            stopped = _ended(str(runs.stopped[k]), float(runs.time[k]))
        at = _numbers(table.at(table.index(point))) or "all runs"
        rows.append(f"  {at}: {'  '.join(texts) if finite else 'no costs'}{stopped}")
    if each > 1:
        rows.insert(0, f"the worst of {each} runs at each point, which differ in {', '.join(table.draws)}:")
    return [*rows, f"  ... and {count - _SHOWN} more points in the table"] if count > _SHOWN else rows


def _ended(stopped: str, time: float) -> str:
    return "" if stopped == lib.ENDED else f"  ({stopped} at {time:.6g} s)"


def _ends(stopped: NDArray[np.str_]) -> str:
    """Return how many runs of a point ended early, with an upper bound of the probability."""
    ends = Counter(stopped.tolist())
    early = len(stopped) - ends.pop(lib.ENDED, 0)
    reasons = ", ".join(f"{count} {reason}" for reason, count in sorted(ends.items())) or "0 ended early"
    return f"  ({reasons}; at most {100 * lib.Share(early, len(stopped)).at_most():.3g} % at 95 % confidence)"


def best_points(table: lib.SweepTable, system: lib.System, choices: Mapping[str, lib.Choice]) -> dict[str, Any]:
    """Return, for each cost, the chosen point, its assessment, and the range of finite values.

    `costs`, `stopped` and `duration_s` are of the worst run, whose random numbers are `random`.
    """
    import numpy as np

    best, runs = dict[str, Any](), lib.runs_of(table, system)
    for name, choice in choices.items():
        worst = table.worst(name)
        finite = worst[np.isfinite(worst)]
        means = {other: float(table.mean(other).reshape(-1)[choice.point]) for other in system.costs}
        at, random = lib.run_at(table, choice.run)
        best[name] = _result(runs, choice.run) | {
            "at": at, "random": random, "mean": means,
            "least": float(finite.min()), "largest": float(finite.max()), "passed_over": choice.passed_over,
            "accepted": choice.assessment.accepted(), "assessment": choice.assessment.to_dict(),
        }  # fmt: skip
    return best


def best_line(table: lib.SweepTable, system: lib.System, name: str, row: dict[str, Any], choice: lib.Choice) -> str:
    """Return one line with the chosen point of a cost, its value, the range of the cost, and what fails."""
    count = math.prod(table.shape)
    unit, end = system.costs[name].unit, _ended(row["stopped"], row["duration_s"])
    at = f" at {_numbers(row['at'])}" if row["at"] else ""
    spread = f"{row['least']:.6g} … {row['largest']:.6g} {unit}"
    value, random = f"{row['costs'][name]:.6g} {unit}", f" ({_numbers(row['random'])}{end})"
    mean = f", mean {row['mean'][name]:.6g} {unit}"
    if table.each == 1:
        text = f"least {name}: {value}{at}{end}, range {spread}"
    elif count == 1:
        text = f"worst {name} of {table.each} runs: {value}{random}{mean}"
    else:
        text = f"least {name} in the worst of {table.each} runs: {value}{at}{random}{mean}; "
        text += f"range of the worst over the points {spread}"
    if choice.passed_over:
        text += "; lower, but not with the margins and the bounds of the costs: "
        text += f"{choice.passed_over} of {count} points"
    if failures := choice.assessment.failures:
        text += f"; no point meets the margins and the bounds of the costs: here, {'; '.join(failures)}"
    return text
