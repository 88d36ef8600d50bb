"""`surctl sweep FILE.py:FUNCTION`: costs of a system of the user's own at points of a design, over random runs."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surctl.cli.activity import progress
from surctl.cli.output import finish, same_command, saving, stoppable
from surctl.cli.system_option import OwnSystem, command_line, load_system

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from surctl.tuning import Axis, Design, Executor, Span, SystemSweep

__all__ = ["best_line", "best_points", "choices_and_draws", "sweep_own_system"]

_SHOWN = 40  # largest number of points in the text output
_MOST_JSON = 100_000  # largest number of runs printed as JSON
_MOST_REPEATED = 20_000  # largest number of control periods of a run that is repeated in Python
_NAMED = 5  # largest number of points that a line names


def sweep_own_system(
    words: Sequence[str],
    *,
    seconds: float | None,
    design: str,
    points: int | None,
    sensitivity: str | None,
    seeds: int,
    threads: int,
    executor: Executor | None,
    out: Path,
    as_json: bool,
) -> None:
    """Simulate the runs of all points in compiled code; print each cost's range and best point."""
    from surctl.assessment import ClosedLoop, assess
    from surctl.errors import InputError, nearest
    from surctl.files import prepare_folder
    from surctl.recorded_write import write_csv
    from surctl.system import LOST
    from surctl.tuning import parse_axis, sobol_indices, sweep_system

    own = load_system(words)
    duration = own.seconds(seconds)
    if sensitivity is not None and sensitivity not in own.system.costs:
        remedy = nearest(sensitivity, own.system.costs)
        raise InputError("is not a cost of the system", key="--sensitivity", value=sensitivity, remedy=remedy)
    axes = [parse_axis(text) for text in own.settings]
    chosen, draws = choices_and_draws(
        own, axes, design=design if sensitivity is None else "saltelli", points=points, seeds=seeds
    )
    count = len(chosen.points) * max(map(len, draws.values()), default=1)
    if as_json and count > _MOST_JSON:
        problem = f"would print {count} runs"
        raise InputError(problem, key="--json", remedy="drop this option and read sweep.csv")
    prepare_folder(out)
    with stoppable(f"the finished runs are in {out}; to continue: {same_command()}"):
        swept = sweep_system(
            own.system, chosen, duration,
            draws=draws, threads=threads, out=out, about=own.origin, source=own.word, executor=executor,
            progress=progress,
        )  # fmt: skip
    runs = swept.runs
    table = None
    with saving("table"):
        table = write_csv(out / "sweep.csv", swept.table())
    best = best_points(swept)
    loops = {name: assess(ClosedLoop(own.system, row["at"] | row["random"])) for name, row in best.items()}
    best = {name: row | {"assessment": loops[name].to_dict()} for name, row in best.items()}
    indices = None if sensitivity is None else sobol_indices(chosen, swept.mean(sensitivity), sensitivity)
    lost = [k for k, stopped in enumerate(runs.stopped) if stopped == LOST]
    lines = [f"{own.title}: {len(runs.time)} runs of {duration:g} s, control period {own.system.dt:g} s"]
    lines += _rows(swept) if indices is None else indices.lines()
    for name, row in best.items():
        lines += [best_line(swept, name, row), *(f"  {line.mark} {line.text}" for line in loops[name].lines)]
    if lost:
        named = "; ".join(_numbers(_at(swept, k)) for k in lost[:_NAMED])
        lines.append(f"{len(lost)} of {len(runs.time)} runs are not finite: {named}{'; …' * (len(lost) > _NAMED)}")
        lines += [f"  in the first of them: {name}" for name in [_lost_number(swept, lost[0])] if name]
    lines.append(", ".join([*([f"table {table}"] if table else []), f"netCDF {swept.path}"]))
    pictures = _pictures(swept, out)
    lines += [f"plot  {picture}" for picture in pictures]
    data = {
        **own.names,
        "seconds": duration,
        "axes": {name: sorted(set(chosen.points[:, k].tolist())) for k, name in enumerate(chosen.names)},
        "random": list(draws),
        "units": {name: cost.unit for name, cost in own.system.costs.items()},
        "runs_per_point": swept.each,
        "results": [_result(swept, k) for k in range(len(runs.time))] if as_json else [],
        "best": best,
        "sensitivity": None if indices is None else indices.to_dict(),
        "not_finite": [_at(swept, k) for k in lost],
        "table": table and str(table),
        "netcdf": str(swept.path),
        "pictures": [str(picture) for picture in pictures],
    }
    then = []
    if best:
        row = next(iter(best.values()))
        numbers = [f"{n}={v!r}" for n, v in (row["at"] | row["random"]).items()]
        then = [command_line("simulate", own, *numbers, "--seconds", f"{duration:g}")]
    finish(data, lines, as_json=as_json, passed=bool(best), then=then)


def choices_and_draws(
    own: OwnSystem, axes: Sequence[Axis | Span], *, design: str = "grid", points: int | None = None, seeds: int = 1
) -> tuple[Design, dict[str, NDArray[np.float64]]]:
    """Return the points of a sweep, and the numbers of the runs at each point.

    Seeds are numbers of runs. If a grid has several runs at each point, a range without a count is random as well,
    unless it is that of a gain.

    Raises:
        InputError: the system has no costs or nothing random, an axis is not valid, or its name is not that of one
            number.
    """
    import numpy as np

    from surctl.errors import InputError
    from surctl.system.values import check_scalar
    from surctl.tuning.axes import SEED, Axis, Span
    from surctl.tuning.design import ONE_POINT, make_design, random_draws, saltelli

    if not own.system.costs:
        raise InputError("has no costs", key="system", value=own.label, remedy="give System(..., costs={...})")
    for axis in axes:
        check_scalar(own.system, axis.name)
    listed = [axis for axis in axes if axis.name == SEED]
    if listed and (seeds > 1 or not isinstance(listed[0], Axis)):
        problem = "is given twice" if seeds > 1 else "is a range without a count"
        raise InputError(problem, key="axis seed", remedy="write --seeds N for the seeds 0 to N-1")
    numbers = np.array(listed[0].values if listed and isinstance(listed[0], Axis) else range(seeds), dtype=float)
    random = [a for a in axes if isinstance(a, Span) and design == "grid" and len(numbers) > 1 and "." in a.name]
    others = [axis for axis in axes if axis not in random and axis not in listed]
    draws = {SEED: numbers} if own.system.blocks.noise and (listed or seeds > 1) else {}
    draws |= random_draws(random, count=len(numbers)) if random else {}
    if seeds > 1 and not draws:
        problem, remedy = "has no noise", "draw a number as well: plant.NAME=LOW..HIGH or start.NAME=LOW..HIGH"
        raise InputError(problem, key="--seeds", value=seeds, remedy=remedy)
    if design == "saltelli":
        return saltelli(others, base=64 if points is None else points), draws
    if draws and not others and points is None:
        return ONE_POINT, draws
    return make_design(design, others, count=points), draws


def _pictures(swept: SystemSweep, out: Path) -> list[Path]:
    """Write how costs are distributed at a single point, or a heat map of each if two axes have several values."""
    import numpy as np

    design, system = swept.design, swept.system
    if not design.names:
        with saving("plot"):
            from surctl.report.theme import save_figure

            return [save_figure(swept.runs.plot(), out, ("sweep", "runs"))]
    axes = [(name, np.unique(design.points[:, k])) for k, name in enumerate(design.names)]
    axes = [(name, values) for name, values in axes if len(values) > 1]
    if len(axes) != 2 or design.kind != "grid":
        return []
    from surctl.system.values import unit_of

    labels = {f"{name} [{unit_of(system, name)}]": values for name, values in axes}
    files = list[Path]()
    with saving("heat maps"):
        from surctl.report.cost_map import plot_cost_map
        from surctl.report.theme import save_figure

        for name, cost in system.costs.items():
            table = swept.worst(name).reshape([len(values) for _, values in axes])
            title = f"{name} [{cost.unit}]" + (f", worst of {swept.each} runs" if swept.each > 1 else "")
            figure = plot_cost_map(labels, table, title).figure.figure
            files.append(save_figure(figure, out, ("sweep", *(axis for axis, _ in axes), name)))
    return files


def _lost_number(swept: SystemSweep, k: int) -> str:
    """Return the number of run k that is not finite, from a run in Python; "" if that run would take too long."""
    from surctl.system import run_system

    system = swept.system
    periods = round(float(swept.runs.time[k]) / system.dt) + 2
    return run_system(system, periods * system.dt, _at(swept, k)).lost if periods < _MOST_REPEATED else ""


def _at(swept: SystemSweep, k: int) -> dict[str, float]:
    return {name: float(values[k]) for name, values in swept.swept.items()}


def _numbers(at: dict[str, float]) -> str:
    return ", ".join(f"{name}={value:.6g}" for name, value in at.items())


def _result(swept: SystemSweep, k: int) -> dict[str, Any]:
    runs = swept.runs
    costs = {name: float(values[k]) for name, values in runs.figures.items()}
    return {"at": _at(swept, k), "costs": costs, "stopped": str(runs.stopped[k]), "duration_s": float(runs.time[k])}


def _rows(swept: SystemSweep) -> list[str]:
    costs, runs, rows = swept.system.costs, swept.runs, list[str]()
    count = len(swept.design.points)
    for point in range(min(count, _SHOWN)):
        texts = []
        for name, cost in costs.items():
            worst = swept.worst(name)[point]
            mean = f" (mean {swept.mean(name)[point]:.6g})" if swept.each > 1 else ""
            texts.append(f"{name}={worst:.6g}{mean} {cost.unit}")
        known = any(math.isfinite(swept.worst(name)[point]) for name in costs)
        k = point * swept.each
        end = _ended(str(runs.stopped[k]), float(runs.time[k])) if swept.each == 1 else _ends(swept, point)
        at = _numbers(swept.at(point)) or "all runs"
        rows.append(f"  {at}: {'  '.join(texts) if known else 'no costs'}{end}")
    if swept.each > 1:
        rows.insert(0, f"the worst of {swept.each} runs at each point, which differ in {', '.join(swept.draws)}:")
    return [*rows, f"  ... and {count - _SHOWN} more points in the table"] if count > _SHOWN else rows


def _ended(stopped: str, time: float) -> str:
    from surctl.system import ENDED

    return "" if stopped == ENDED else f"  ({stopped} at {time:.6g} s)"


def _ends(swept: SystemSweep, point: int) -> str:
    """Return how many runs of a point ended early, with an upper bound of the probability."""
    from surctl.system import ENDED
    from surctl.tuning.share import Share

    ends = Counter(swept.runs.stopped[point * swept.each : (point + 1) * swept.each].tolist())
    early = swept.each - ends.pop(ENDED, 0)
    reasons = ", ".join(f"{count} {reason}" for reason, count in sorted(ends.items())) or "0 ended early"
    return f"  ({reasons}; at most {100 * Share(early, swept.each).at_most():.3g} % at 95 % confidence)"


def best_points(swept: SystemSweep) -> dict[str, Any]:
    """Return, for each cost, the point whose worst run has the least value, and the range of finite values.

    `costs`, `stopped` and `duration_s` are of the worst run, whose random numbers are `random`.
    """
    import numpy as np

    best: dict[str, Any] = {}
    for name in swept.system.costs:
        point = swept.best(name)
        if point is None:
            continue
        worst, k = swept.worst(name), swept.worst_run(name, point)
        finite = worst[np.isfinite(worst)]
        means = {other: float(swept.mean(other)[point]) for other in swept.system.costs}
        best[name] = _result(swept, k) | {
            "at": swept.at(point), "random": swept.random_of(k), "mean": means,
            "least": float(finite.min()), "largest": float(finite.max()),
        }  # fmt: skip
    return best


def best_line(swept: SystemSweep, name: str, row: dict[str, Any]) -> str:
    """Return one line with the least value of a cost, where it is, and the range of the cost."""
    unit, end = swept.system.costs[name].unit, _ended(row["stopped"], row["duration_s"])
    at = f" at {_numbers(row['at'])}" if row["at"] else ""
    if swept.each == 1:
        return (
            f"least {name}: {row['least']:.6g} {unit}{at}{end}, range {row['least']:.6g} … {row['largest']:.6g} {unit}"
        )
    if len(swept.design.points) == 1:
        mean = f"mean {row['mean'][name]:.6g} {unit}"
        return f"worst {name} of {swept.each} runs: {row['least']:.6g} {unit} ({_numbers(row['random'])}{end}), {mean}"
    return (
        f"least {name} in the worst of {swept.each} runs: {row['least']:.6g} {unit}{at} "
        f"({_numbers(row['random'])}{end}), mean {row['mean'][name]:.6g} {unit}; "
        f"range of the worst over the points {row['least']:.6g} … {row['largest']:.6g} {unit}"
    )
