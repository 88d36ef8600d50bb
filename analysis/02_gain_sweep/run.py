"""Study 2: the trade-off that look-ahead and velocity bandwidth set, and the point that a grid sweep picks.

    python analysis/02_gain_sweep/run.py [--quick] [--out DIR]

Prints Markdown and saves the sweep as CSV. The exit status is 0 if every statement holds, and 1 otherwise.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.files import Strict, load_model, prepare_folder
from surctl.marine.control import Gains, build_law, load_gains
from surctl.marine.simulation import Case, Run, load_scenario, simulate
from surctl.marine.simulation.metrics import avoidance_intervals
from surctl.marine.tuning import MissionSweep, picked_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import cruise_loop
from surctl.tuning import Axis, LocalExecutor, SweepTable, grid, sweep
from surctl.verification.linear import LEAST_DISK_MARGIN
from surctl.verification.loops import LEAST_DELAY_MARGIN
from surctl.verification.sampled_margins import SampledLoop

CONFIG = Path(__file__).with_name("config.toml")
SHOWN = ("deviation_m", "path_error_m", "time_s", "min_clearance_m_worst", "delay_margin_s", "disk_margin", "score")
ROUNDING = 1e-9  # margins that do not depend on k_v may differ in their last digits, depending on the machine


class Grid(Strict):
    """A grid, and the scenarios and seeds that are simulated at every point."""

    lookahead: tuple[float, ...]
    k_v: tuple[float, ...]
    scenarios: tuple[str, ...]
    seeds: tuple[int, ...]
    other_seeds: tuple[int, ...]
    left_out: str


class Config(Strict):
    """The contents of config.toml."""

    gains: str
    k_psi: float
    k_r: float
    workers: int
    knee: float
    same_clearance: float
    full: Grid
    quick: Grid


@dataclass(frozen=True)
class Flown:
    """Results of a scenario at a point over the seeds: least clearances, means, share of steps in the path error."""

    scenario: str
    lookahead: float
    k_v: float
    clearance: float
    to_obstacles: float
    time: float
    deviation: float
    path_error: float
    counted: float


@dataclass(frozen=True)
class Statement:
    """A statement of the README and whether this run confirms it; None if this grid cannot decide it."""

    text: str
    holds: bool | None
    figure: str


def main(arguments: list[str]) -> int:
    """Run the study, print the results, and return the exit status."""
    parser = argparse.ArgumentParser(
        prog="run.py", description="Sweep lookahead and k_v, and check the statements of the README."
    )
    parser.add_argument("--quick", action="store_true", help="a small grid and one scenario")
    parser.add_argument("--out", type=Path, help="folder of sweep.csv; default: a new temporary one")
    options = parser.parse_args(arguments)
    try:
        config = load_model(CONFIG, Config)
        out = prepare_folder(options.out or Path(tempfile.mkdtemp(prefix="surctl-sweep-")))
        if options.quick:  # beginning a second process takes longer than the points
            config = config.model_copy(update={"workers": 1})
        return study(config, config.quick if options.quick else config.full, out)
    except InputError as error:
        print(error, file=sys.stderr)
        return error.exit_status


def study(config: Config, grid: Grid, out: Path) -> int:
    """Sweep, print and save; return 0 if every statement holds."""
    gains = load_gains(config.gains).with_values({"k_psi": config.k_psi, "k_r": config.k_r})
    swept = run_sweep(config, grid, gains)
    print_table(swept)
    print_pick(swept, "The sweep", {"gain file": gains})
    watched = {"gain file": gains, "first pick": picked_gains(swept)}
    if grid.other_seeds:
        again = run_sweep(config, grid.model_copy(update={"seeds": grid.other_seeds}), gains)
        print_pick(again, f"With seeds {list(grid.other_seeds)}", watched)
    if grid.left_out:
        rest = tuple(name for name in grid.scenarios if name != grid.left_out)
        again = run_sweep(config, grid.model_copy(update={"scenarios": rest}), gains)
        print_pick(again, f"Without {grid.left_out}", watched)
    save(swept, out / "sweep.csv")
    flown = list(fly_cross(gains, grid))
    print_flown(flown)
    holds = print_statements(statements(config, grid, swept, flown, gains))
    print(f"\nTable: {out / 'sweep.csv'}")
    return 0 if holds and swept.picked else 1


def run_sweep(config: Config, points: Grid, gains: Gains) -> SweepTable:
    """Return the sweep of the grid; print progress on stderr."""
    axes = (Axis("lookahead", points.lookahead), Axis("k_v", points.k_v))
    scenarios = [load_scenario(name) for name in points.scenarios]
    cases = [Case(s, load_vehicle(s.vehicle), gains) for s in scenarios]
    return sweep(
        MissionSweep(tuple(cases), points.seeds), grid(axes), executor=LocalExecutor(config.workers), progress=tell
    )


def tell(line: str) -> None:
    """Print progress on stderr."""
    print(f"  {line}", file=sys.stderr)


def points(swept: SweepTable) -> Iterator[tuple[int, int, float, float]]:
    """Yield (i, j, lookahead, k_v) of every point."""
    for i, lookahead in enumerate(swept.axes[0].values):
        for j, k_v in enumerate(swept.axes[1].values):
            yield i, j, lookahead, k_v


def print_rows(header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """A Markdown table."""
    print("\n| " + " | ".join(header) + " |\n" + "|---" * len(header) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |")


def print_table(swept: SweepTable) -> None:
    """Print one row per point."""
    header = ["lookahead [m]", "k_v [1/s]", *(f"{name} [{swept.units[name]}]" for name in SHOWN), ""]
    rows = []
    for i, j, lookahead, k_v in points(swept):
        figures = [f"{swept.column(name)[i, j]:.4g}" for name in SHOWN]
        rows.append([f"{lookahead:g}", f"{k_v:g}", *figures, remark(swept, i, j)])
    print_rows(header, rows)


def remark(swept: SweepTable, i: int, j: int) -> str:
    """Return why a point is infeasible, or that it was picked."""
    if (i, j) == swept.picked:
        return "**picked**"
    reasons = {
        "touches": swept.column("min_clearance_m_worst")[i, j] <= 0,
        "does not arrive": swept.column("reached_worst")[i, j] < 0.5,
        "delay margin": swept.column("delay_margin_s")[i, j] < LEAST_DELAY_MARGIN,
        "disk margin": swept.column("disk_margin")[i, j] < LEAST_DISK_MARGIN,
    }
    return next((reason for reason, holds in reasons.items() if holds), "")


def ranking(swept: SweepTable, by: str = "score") -> list[tuple[int, int]]:
    """Return the feasible points, smallest score first."""
    feasible = [(i, j) for i, j, *_ in points(swept) if swept.column("feasible")[i, j] > 0.5]
    return sorted(feasible, key=lambda p: float(np.nan_to_num(swept.column(by)[p], nan=np.inf)))


def print_pick(swept: SweepTable, what: str, watched: Mapping[str, Gains]) -> None:
    """Print the picked and the next points, the gap of the named points, and the point that each figure would pick."""
    order, score = ranking(swept), swept.column("score")
    print(f"\n{what}: {len(order)} of {score.size} points are feasible.")
    for place, point in enumerate(order, 1):
        values = {a.name: a.values[k] for a, k in zip(swept.axes, point, strict=True)}
        named = [label for label, gains in watched.items() if values.items() <= gains.values.items()]
        if place <= 4 or named:
            behind = 100 * (score[point] / score[order[0]] - 1)
            print(f"- {place}: {name_of(swept, point)}, {behind:.2f} % more", *named, sep=", ")
    for figure in ("deviation_m", "path_error_m", "time_ratio"):
        for point in ranking(swept, figure)[:1]:
            print(f"- by {figure} alone: {name_of(swept, point)}")


def name_of(swept: SweepTable, point: tuple[int, int]) -> str:
    """Return the gains of the point with units, and the axes on whose edge it lies."""
    named = ", ".join(f"{a.name} = {a.values[k]:g} {a.unit}" for a, k in zip(swept.axes, point, strict=True))
    edges = [a.name for a, k in zip(swept.axes, point, strict=True) if k in (0, len(a.values) - 1)]
    return f"{named} (edge in {' and '.join(edges)})" if edges else named


def save(swept: SweepTable, path: Path) -> None:
    """Write the whole sweep as CSV, one line per point."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["lookahead_m", "k_v_per_s", *swept.columns, "picked"])
        for i, j, lookahead, k_v in points(swept):
            row = [repr(float(swept.column(name)[i, j])) for name in swept.columns]
            writer.writerow([lookahead, k_v, *row, int((i, j) == swept.picked)])


def fly_cross(gains: Gains, grid: Grid) -> Iterator[Flown]:
    """Return the results of each scenario along both axes through the point of the gain file."""
    lookahead, k_v = gains["lookahead"], gains["k_v"]
    cross = {(lookahead, other) for other in grid.k_v} | {(other, k_v) for other in grid.lookahead}
    for name in grid.scenarios:
        for point in sorted(cross):
            yield fly(name, *point, gains=gains, seeds=grid.seeds)


def fly(name: str, lookahead: float, k_v: float, *, gains: Gains, seeds: Sequence[int]) -> Flown:
    """Simulate one scenario with these two gains over the seeds."""
    scenario = load_scenario(name)
    vehicle, law = load_vehicle(scenario.vehicle), build_law()
    chosen = gains.with_values({"lookahead": lookahead, "k_v": k_v})
    runs = [simulate(scenario, vehicle, gains=chosen, law=law, seed=seed) for seed in seeds]
    return Flown(
        name,
        lookahead,
        k_v,
        min(r.metrics.min_clearance_m for r in runs),
        min(obstacle_clearance(r) for r in runs),
        float(np.mean([r.metrics.time_s for r in runs])),
        float(np.mean([r.metrics.deviation_m for r in runs])),
        float(np.mean([r.metrics.path_error_m for r in runs])),
        float(np.mean([counted(r) for r in runs])),
    )


def obstacle_clearance(run: Run) -> float:
    """Return the least distance from hull to obstacles [m]; unlike the metric it omits walls."""
    found = [
        body.shape.nearest(at)[0]
        for at, bodies in zip(run.record.eta[:, :2], run.record.obstacles, strict=True)
        for body in bodies
    ]
    return float(min(found, default=np.inf)) - run.vehicle["radius"]


def counted(run: Run) -> float:
    """Return the share of the steps that the path error uses: those outside avoidance intervals."""
    away = run.scenario.follower().track(run.record.eta[:, :2])
    return float(np.mean(~avoidance_intervals(run.telemetry("avoiding")[:, 0], away)))


def print_flown(flown: Sequence[Flown]) -> None:
    """Print one row per scenario and point."""
    header = ["scenario", "lookahead [m]", "k_v [1/s]", "clearance [m]", "of it to obstacles [m]", "time [s]"]
    rows = []
    for f in flown:
        row = [f.scenario, f"{f.lookahead:g}", f"{f.k_v:g}", f"{f.clearance:.4f}", f"{f.to_obstacles:.4f}"]
        rows.append([*row, f"{f.time:.2f}", f"{f.deviation:.4f}", f"{f.path_error:.4f}", f"{100 * f.counted:.1f} %"])
    print_rows([*header, "deviation [m]", "path error [m]", "steps it counts"], rows)


def statements(config: Config, grid: Grid, swept: SweepTable, flown: Sequence[Flown], gains: Gains) -> list[Statement]:
    """Return the README's statements on trends, each compared with this run; the first k_v is the slowest."""
    delay, deviation = swept.column("delay_margin_s"), swept.column("deviation_m")[:, 1:]
    beyond = delay[:, np.array(grid.k_v) >= config.knee]
    slow = f"k_v = {grid.k_v[0]:g} 1/s"
    return [
        Statement(
            f"the delay margin never rises with k_v, and from {config.knee:g} 1/s on it falls at every step",
            bool((np.diff(delay) <= ROUNDING).all()) and rising(-beyond),
            span(delay, "s"),
        ),
        limiting_loops(gains, grid),
        Statement(f"above {slow} the deviation falls with every step of k_v", rising(-deviation), span(deviation, "m")),
        Statement(
            f"above {slow} the deviation rises with every step of lookahead", rising(deviation.T), span(deviation, "m")
        ),
        along(flown, gains, "tank-static", "k_v", "to_obstacles", rises=True),
        same_clearance(config, flown, gains),
        along(flown, gains, "pool-static", "lookahead", "counted", rises=False),
    ]


def along(flown: Sequence[Flown], gains: Gains, scenario: str, axis: str, figure: str, *, rises: bool) -> Statement:
    """Check that a figure of a scenario rises, or falls, at every step along an axis through the gain file's point."""
    values = line(flown, gains, scenario, axis, figure)
    word = {"to_obstacles": "clearance to obstacles", "counted": "share of steps that the path error counts"}[figure]
    text = f"{scenario}: the {word} {'rises' if rises else 'falls'} with every step of {axis}"
    if values.size == 0:
        return Statement(text, None, "not simulated")
    return Statement(text, rising(values if rises else -values), span(values, "m" if figure == "to_obstacles" else ""))


def line(flown: Sequence[Flown], gains: Gains, scenario: str, axis: str, figure: str) -> NDArray[np.float64]:
    """Return the figure along one axis, with the other gain as in the gain file."""
    other = "k_v" if axis == "lookahead" else "lookahead"
    chosen = [f for f in flown if f.scenario == scenario and getattr(f, other) == gains[other]]
    return np.array([getattr(f, figure) for f in sorted(chosen, key=lambda f: float(getattr(f, axis)))])


def same_clearance(config: Config, flown: Sequence[Flown], gains: Gains) -> Statement:
    """Check that look-ahead has almost no effect on the clearance."""
    values = line(flown, gains, "tank-static", "lookahead", "to_obstacles")
    text = f"tank-static: lookahead moves the clearance by less than {1000 * config.same_clearance:g} mm"
    return Statement(text, bool(np.ptp(values) < config.same_clearance), f"{1000 * np.ptp(values):.3f} mm")


def limiting_loops(gains: Gains, grid: Grid) -> Statement:
    """Check which loop has the least delay margin at both ends of k_v, with the other gains as in the gain file."""
    dt, ends = build_law().dt, []
    for k_v in (grid.k_v[0], grid.k_v[-1]):
        values = gains.with_values({"k_v": k_v}).values
        margins = [
            min(
                SampledLoop(cruise_loop(load_vehicle(s.vehicle), values, cruise=s.cruise, dt=dt)).judged,
                key=lambda m: m.delay_margin_s,
            )
            for s in map(load_scenario, grid.scenarios)
        ]
        ends.append(sorted({m.name for m in margins}))
    text = "the yaw loop limits a nominal delay margin at the least k_v, the heave loop all of them at the largest"
    held = "yaw" in ends[0] and ends[1] == ["heave"]
    return Statement(text, held, f"{', '.join(ends[0])}; {', '.join(ends[1])}")


def rising(values: NDArray[np.float64]) -> bool:
    """Return whether every step along the last axis rises by more than rounding; False for a NaN."""
    return bool((np.diff(values) > ROUNDING).all())


def span(values: NDArray[np.float64], unit: str) -> str:
    """Return the first and last value of a line, or the least and largest of a table, as text."""
    ends = (values[0], values[-1]) if values.ndim == 1 else (values.min(), values.max())
    return f"{ends[0]:.4g} … {ends[1]:.4g} {unit}".strip()


def print_statements(said: Sequence[Statement]) -> bool:
    """Print one row per statement; return whether none failed."""
    words = {True: "holds", False: "**does not hold**", None: "not decided"}
    print_rows(["statement", "figure", ""], [(s.text, s.figure, words[s.holds]) for s in said])
    return all(s.holds is not False for s in said)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
