"""`surctl sweep FILE.py:FUNCTION`: costs of a system of the user's own over a grid of gains and parameters."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surctl.cli.activity import doing, progress
from surctl.cli.output import Stopped, finish, interrupted, saving
from surctl.cli.system_option import OwnSystem, command_line, load_system

if TYPE_CHECKING:
    from surctl.system import Runs
    from surctl.tuning.design import Design

__all__ = ["best_line", "best_points", "grid_of", "sweep_system"]

_SHOWN = 40  # largest number of points in the text output
_MOST_JSON = 100_000  # largest number of points printed as JSON
_MOST_REPEATED = 20_000  # largest number of control periods of a run that is repeated in Python
_SO_FAR = "sweep-so-far.csv"
_PARTS, _LEAST_PART, _PATIENCE = 50, 64, 10.0  # of a sweep: parts, runs of a part, and seconds between two files
_NAMED = 5  # largest number of points that a line names


def sweep_system(words: Sequence[str], *, seconds: float | None, workers: int | None, out: Path, as_json: bool) -> None:
    """Simulate a run at each point of the grid in compiled code; print each cost's range and best point."""
    from surctl.assessment.assessment import assess
    from surctl.assessment.closed_loop import ClosedLoop
    from surctl.errors import InputError
    from surctl.files import prepare_folder
    from surctl.recorded_write import write_csv
    from surctl.system import LOST

    own = load_system(words)
    duration = own.seconds(seconds)
    design = grid_of(own, own.settings)
    if as_json and len(design.points) > _MOST_JSON:
        problem = f"would print {len(design.points)} points"
        raise InputError(problem, key="--json", remedy="drop this option and read sweep.csv")
    prepare_folder(out)
    runs = _simulated(own, design, duration, threads=workers or 2, file=out / _SO_FAR)
    files: dict[str, Path | None] = {"table": None, "netCDF": None}
    with saving("table"):
        files["table"] = write_csv(out / "sweep.csv", _columns(own, design, runs))
        (out / _SO_FAR).unlink(missing_ok=True)
    with saving("netCDF"):
        files["netCDF"] = _write_dataset(own, design, runs, out / "sweep.nc", seconds=duration)
    best = best_points(own, design, runs)
    loops = {name: assess(ClosedLoop(own.system, row["at"])) for name, row in best.items()}
    best = {name: row | {"assessment": loops[name].to_dict()} for name, row in best.items()}
    lost = [k for k, stopped in enumerate(runs.stopped) if stopped == LOST]
    lines = [f"{own.title}: {len(design.points)} runs of {duration:g} s, control period {own.system.dt:g} s"]
    lines += _rows(own, design, runs)
    for name, row in best.items():
        lines += [best_line(own, name, row), *(f"  {line.mark} {line.text}" for line in loops[name].lines)]
    if lost:
        named = "; ".join(_point(design, k) for k in lost[:_NAMED])
        lines.append(f"{len(lost)} of {len(design.points)} runs are not finite: {named}{'; …' * (len(lost) > _NAMED)}")
        lines += [f"  in the first of them: {name}" for name in [_lost_number(own, design, runs, lost[0])] if name]
    written = [f"{name} {file}" for name, file in files.items() if file]
    lines += [", ".join(written)] if written else []
    pictures = _pictures(own, design, runs, out)
    lines += [f"plot  {picture}" for picture in pictures]
    data = {
        **own.names,
        "seconds": duration,
        "axes": {name: sorted(set(design.points[:, k].tolist())) for k, name in enumerate(design.names)},
        "units": {name: cost.unit for name, cost in own.system.costs.items()},
        "results": [_result(design, runs, k) for k in range(len(design.points))] if as_json else [],
        "best": best,
        "not_finite": [_at(design, k) for k in lost],
        **{name.lower(): file and str(file) for name, file in files.items()},
        "pictures": [str(picture) for picture in pictures],
    }
    then = []
    if best:
        at = next(iter(best.values()))["at"]
        then = [command_line("simulate", own, *(f"{n}={v!r}" for n, v in at.items()), "--seconds", f"{duration:g}")]
    finish(data, lines, as_json=as_json, passed=bool(best), then=then)


def _simulated(own: OwnSystem, design: Design, seconds: float, *, threads: int, file: Path) -> Runs:
    """Simulate all points in parts; the finished points are in the file after the first part, and every 10 s."""
    import numpy as np

    from surctl.recorded_write import write_csv
    from surctl.system import Runs, simulate_system
    from surctl.system.values import run_numbers

    run_numbers(own.system, {name: design.points[:, k] for k, name in enumerate(design.names)})
    count, parts, done = len(design.points), list[Runs](), 0
    size, written = max(_LEAST_PART, -(-count // _PARTS)), -math.inf
    progress(f"{count} runs of {seconds:g} s")

    def whole() -> Runs:
        figures = {name: np.concatenate([part[name] for part in parts]) for name in parts[0].figures}
        return Runs(
            figures, *(np.concatenate([getattr(part, n) for part in parts]) for n in ("stopped", "time", "state"))
        )

    def keep() -> None:
        write_csv(file, _columns(own, replace(design, points=design.points[:done]), whole()))

    try:
        while done < count:
            points = design.points[done : done + size]
            values = {name: points[:, k] for k, name in enumerate(design.names)}
            parts.append(simulate_system(own.system, seconds, values, threads=threads))
            done += len(points)
            doing(f"{done} of {count} runs")
            if done < count and time.monotonic() - written > _PATIENCE:
                keep()
                written = time.monotonic()
    except (Exception, KeyboardInterrupt) as error:
        if not interrupted(error):
            raise
        if parts:
            keep()
        raise Stopped(
            f"{done} of {count} runs are in {file}" if parts else f"none of {count} runs is finished"
        ) from None
    return whole()


def _pictures(own: OwnSystem, design: Design, runs: Runs, out: Path) -> list[Path]:
    """Write a heat map of each cost if two axes have several values; return the files."""
    import numpy as np

    swept = [(name, np.unique(design.points[:, k])) for k, name in enumerate(design.names) if design.shape[k] > 1]
    if len(swept) != 2:
        return []
    from surctl.system.values import unit_of

    axes = {f"{name} [{unit_of(own.system, name)}]": values for name, values in swept}
    files = list[Path]()
    with saving("heat maps"):
        from surctl.report.cost_map import plot_cost_map
        from surctl.report.theme import save_figure

        for name, cost in own.system.costs.items():
            table = runs[name].reshape([len(values) for _, values in swept])
            figure = plot_cost_map(axes, table, f"{name} [{cost.unit}]").figure.figure
            files.append(save_figure(figure, out, ("sweep", *(axis for axis, _ in swept), name)))
    return files


def grid_of(own: OwnSystem, axes: Sequence[str]) -> Design:
    """Return the grid of a sweep.

    Raises:
        InputError: the system has no costs, an axis is not valid, or its name is not that of one number.
    """
    from surctl.errors import InputError
    from surctl.system.values import check_scalar
    from surctl.tuning.axes import parse_axis
    from surctl.tuning.design import make_design

    if not own.system.costs:
        raise InputError("has no costs", key="system", value=own.label, remedy="give System(..., costs={...})")
    design = make_design("grid", [parse_axis(text) for text in axes])
    for name in design.names:
        check_scalar(own.system, name)
    return design


def _lost_number(own: OwnSystem, design: Design, runs: Runs, k: int) -> str:
    """Return the number of point k that is not finite, from a run in Python; "" if that run would take too long."""
    from surctl.system import run_system

    periods = round(float(runs.time[k]) / own.system.dt) + 2
    return run_system(own.system, periods * own.system.dt, _at(design, k)).lost if periods < _MOST_REPEATED else ""


def _at(design: Design, k: int) -> dict[str, float]:
    return dict(zip(design.names, design.points[k].tolist(), strict=True))


def _point(design: Design, k: int) -> str:
    return ", ".join(f"{name}={value:.6g}" for name, value in _at(design, k).items())


def _result(design: Design, runs: Runs, k: int) -> dict[str, Any]:
    costs = {name: float(values[k]) for name, values in runs.figures.items()}
    return {"at": _at(design, k), "costs": costs, "stopped": str(runs.stopped[k]), "duration_s": float(runs.time[k])}


def _columns(own: OwnSystem, design: Design, runs: Runs) -> dict[str, list[Any]]:
    """Return the columns of the table: axes, costs with units, why each run ended, and its duration."""
    columns: dict[str, list[Any]] = {name: design.points[:, k].tolist() for k, name in enumerate(design.names)}
    for name, cost in own.system.costs.items():
        columns[f"{name} [{cost.unit}]"] = runs[name].tolist()
    return columns | {"stopped": runs.stopped.tolist(), "duration [s]": runs.time.tolist()}


def _write_dataset(own: OwnSystem, design: Design, runs: Runs, path: Path, *, seconds: float) -> Path:
    """Write axes (as dimensions), costs, durations, and reasons of the ends of runs as netCDF; return the path."""
    import numpy as np

    from surctl.recorded_write import Column, write_netcdf
    from surctl.system.record_file import identity
    from surctl.system.values import unit_of

    axes = [np.unique(design.points[:, k]) for k in range(len(design.names))]
    columns = {
        name: Column(values, unit_of(own.system, name), name) for name, values in zip(design.names, axes, strict=True)
    }
    for name, cost in own.system.costs.items():
        columns[name] = Column(runs[name], cost.unit, cost.meaning or name)
    columns["run.stopped"] = Column(runs.stopped, "", "why the run ended")
    columns["run.duration"] = Column(runs.time, "s", "duration of the run")
    sizes = dict(zip(design.names, design.shape, strict=True))
    attributes = identity(own.system) | own.origin | {"seconds": seconds}
    return write_netcdf(path, columns, sizes=sizes, attributes=attributes)


def _rows(own: OwnSystem, design: Design, runs: Runs) -> list[str]:
    rows, units = [], {name: cost.unit for name, cost in own.system.costs.items()}
    for k in range(min(len(design.points), _SHOWN)):
        figures = {name: float(values[k]) for name, values in runs.figures.items()}
        costs = "  ".join(f"{name}={value:.6g} {units[name]}" for name, value in figures.items())
        costs = "no costs" if all(map(math.isnan, figures.values())) else costs
        rows.append(f"  {_point(design, k)}: {costs}{_ended(str(runs.stopped[k]), float(runs.time[k]))}")
    more = len(design.points) - _SHOWN
    return [*rows, f"  ... and {more} more points in the table"] if more > 0 else rows


def _ended(stopped: str, time: float) -> str:
    from surctl.system import ENDED

    return "" if stopped == ENDED else f"  ({stopped} at {time:.6g} s)"


def best_points(own: OwnSystem, design: Design, runs: Runs) -> dict[str, Any]:
    """Return the point with the least value of each cost, and the range of its finite values."""
    import numpy as np

    best: dict[str, Any] = {}
    for name, values in runs.figures.items():
        if not np.isfinite(values).any():
            continue
        k = int(np.nanargmin(values))
        finite = values[np.isfinite(values)]
        best[name] = _result(design, runs, k) | {"least": float(finite.min()), "largest": float(finite.max())}
    return best


def best_line(own: OwnSystem, name: str, row: dict[str, Any]) -> str:
    """Return one line with the least value of a cost, where it is, and the range of the cost."""
    unit = own.system.costs[name].unit
    at = ", ".join(f"{key}={value:.6g}" for key, value in row["at"].items())
    return (
        f"least {name}: {row['least']:.6g} {unit} at {at}{_ended(row['stopped'], row['duration_s'])}, "
        f"range {row['least']:.6g} … {row['largest']:.6g} {unit}"
    )
