"""Plots of goals: how well each goal is met, the Pareto front of a tuning, and a metric over time with its bound."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.marine.control import Gains
from surctl.marine.simulation import Run, simulate
from surctl.marine.tuning import Goal, SweepTable, SweptAxis, figures
from surctl.marine.vehicle import Vehicle
from surctl.report.cost_map import draw_cells, draw_frame, value_range
from surctl.report.theme import (
    AVOIDING,
    BAD,
    GOOD,
    INK,
    MUTED,
    OBSTACLE,
    ROBOT,
    curve,
    dress,
    finite,
    legend_above,
    legend_below,
    new_axes,
    printable,
)
from surctl.tuning import Condition, Pool, Tuning
from surctl.tuning.pool import scope

# Plots of sweeps over any number of axes: heat maps and parallel coordinates


COLUMN_TITLES = {
    "score": "score (low is good)",
    "deviation_m": "deviation from the path over the whole run (low is good)",
    "path_error_m": "path error outside avoidance (low is good)",
    "time_s": "time to the target (low is good)",
    "min_clearance_m_worst": "least clearance (high is good)",
    "effort_n": "mean thrust (low is good)",
    "delay_margin_s": "least delay margin (high is good)",
    "disk_margin": "disk margin at the worst corner (high is good)",
    "feasible": "feasible (1) or not (0)",
}


def plot_heat_map(
    table: SweepTable, column: str, ax: Axes | None = None, *, over: tuple[str, str] | None = None
) -> Axes:
    """Plot one column of a sweep grid over two axes; all other parameters are fixed at their selected or middle value.

    Args:
        table: a parameter sweep over a grid of two or more axes; infeasible cells are hatched.
        column: name of the column.
        ax: axes to draw in.
        over: (horizontal axis, vertical axis) by name; by default the first two axes of the sweep.

    Raises:
        InputError: the sweep has no such column or axis, or is not a grid of at least two axes.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import plot_heat_map
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases, sweep
        >>> from surctl.tuning import grid, parse_axis
        >>> cases = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> table = sweep(cases, grid([parse_axis("k_v=1,2"), parse_axis("lookahead=0.4,0.8,1.2")]))
        >>> ax = plot_heat_map(table, "disk_margin")
        >>> ax.get_title("left"), ax.get_xlabel(), ax.get_ylabel()
        ('disk margin at the worst corner (high is good)', 'k_v [1/s]', 'lookahead [m]')
    """
    names = [axis.name for axis in table.axes]
    if not table.is_grid or len(names) < 2:
        raise InputError("needs a grid of at least two axes", key="heat map", remedy="plot parallel coordinates")
    across, up = over or (names[0], names[1])
    for name in (across, up):
        if name not in names:
            raise InputError("no such axis", key="heat map", value=name, remedy=nearest(name, names))
    if across == up:
        raise InputError(
            "is given for both axes of the plot", key="heat map", value=across, remedy="name two different axes"
        )
    at = table.picked or tuple(n // 2 for n in table.shape)
    measured = _slice(table.column(column), names, at, across, up)  # (rows = vertical axis, columns = horizontal one)
    feasible = _slice(table.column("feasible"), names, at, across, up) > 0.5
    values = finite(measured)
    ax = ax or new_axes(5.1, 3.9)
    one, other = (table.axes[names.index(name)] for name in (across, up))
    fixed = [f"{a.name} = {a.values[k]:.4g}" for a, k in zip(table.axes, at, strict=True) if a.name not in (across, up)]
    dress(ax, title=_column_title(table, column), x=axis_title(one), y=axis_title(other))
    if fixed:
        ax.set_title(f"{ax.get_title(loc='left')}\nat {printable(', '.join(fixed))}", loc="left", parse_math=False)
    draw_cells(ax, values, one.values, other.values, written=measured, hatched=~feasible)
    if table.picked is not None:
        i, j = at[names.index(across)], at[names.index(up)]
        draw_frame(ax, i, j)
    return ax


def axis_title(axis: SweptAxis) -> str:
    """Return the name of a swept parameter with its unit."""
    return axis.name + _in(axis.unit)


def _column_title(table: SweepTable, column: str) -> str:
    """Return the title of a column of the sweep with its unit."""
    return COLUMN_TITLES.get(column, column) + _in(table.units.get(column, "1"))


def _in(unit: str) -> str:
    return "" if unit == "1" else f" [{unit}]"


def _slice(
    values: NDArray[np.float64], names: list[str], at: tuple[int, ...], across: str, up: str
) -> NDArray[np.float64]:
    place = tuple(slice(None) if name in (across, up) else k for name, k in zip(names, at, strict=True))
    plane = values[place]
    return plane.T if names.index(across) < names.index(up) else plane


_SHOWN = ("deviation_m", "time_s", "min_clearance_m_worst", "effort_n", "delay_margin_s", "disk_margin", "score")
_LINES = 2000  # largest number of lines drawn, because more lines would merge


def plot_parallel(table: SweepTable, columns: Sequence[str] | None = None, ax: Axes | None = None) -> Axes:
    """Plot a sweep in parallel coordinates: one line for each point, one scale for each parameter and metric.

    Feasible points are drawn over infeasible points, and the selected point on top. The line of a point has a gap at a
    metric without a value. If there are very many points, an evenly spaced selection is drawn.

    Args:
        table: a sweep of any kind.
        columns: names of the columns; by default those columns of a standard list that the sweep contains.
        ax: axes to draw in.

    Raises:
        InputError: the sweep has no such column.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import plot_parallel
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases, sweep
        >>> from surctl.tuning import grid, parse_axis
        >>> cases = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> table = sweep(cases, grid([parse_axis("k_v=1,2"), parse_axis("lookahead=0.4,0.8,1.2")]))
        >>> ax = plot_parallel(table, ["time_s", "disk_margin"])
        >>> ax.get_title("left"), [label.get_text() for label in ax.get_xticklabels()[:2]]
        ('6 points, 6 feasible', ['k_v [1/s]', 'lookahead [m]'])
    """
    names = [name for name in _SHOWN if name in table.columns] if columns is None else list(columns)
    scales, titles = [], []
    for k, axis in enumerate(table.axes):
        place = [1] * len(table.shape)
        place[k if table.is_grid else 0] = len(axis.values)
        scales.append(np.broadcast_to(axis.values.reshape(place), table.shape).reshape(-1))
        titles.append(axis_title(axis))
    for name in names:
        scales.append(table.column(name).reshape(-1))
        titles.append(_column_title(table, name))
    ax = ax or new_axes(1.35 * len(scales) + 1.0, 4.2)
    ends = [value_range(values) for values in scales]
    lines = np.stack([(v - low) / (high - low) for v, (low, high) in zip(scales, ends, strict=True)], axis=1)
    feasible = table.column("feasible").reshape(-1) > 0.5
    shown = np.unique(np.linspace(0, len(lines) - 1, min(len(lines), _LINES)).astype(int))
    good, bad = shown[feasible[shown]], shown[~feasible[shown]]
    dress(ax, title=f"{len(lines)} points, {int(feasible.sum())} feasible")
    ax.grid(visible=False)
    strength = float(np.clip(25 / max(len(shown), 1), 0.06, 0.8))
    for chosen, colour, width in ((bad, OBSTACLE, 0.6), (good, ROBOT, 1.0)):
        ax.add_collection(_collection(lines[chosen], colour, width, strength))
    if table.picked is not None:
        picked = int(np.ravel_multi_index(table.picked, table.shape))
        ax.add_collection(_collection(lines[[picked]], AVOIDING, 2.6, 1.0))
    _upright(ax, titles, ends)
    handles = [Line2D([], [], color=ROBOT, label="feasible"), Line2D([], [], color=OBSTACLE, label="not feasible")]
    if table.picked is not None:
        handles.append(Line2D([], [], color=AVOIDING, linewidth=2.6, label="picked"))
    legend_below(ax, columns=3, handles=handles)
    return ax


def _collection(lines: NDArray[np.float64], colour: str, width: float, strength: float) -> LineCollection:
    x = np.arange(lines.shape[1], dtype=float)
    segments = [np.column_stack([x, np.where(np.isfinite(line), line, np.nan)]) for line in lines]
    return LineCollection(segments, colors=colour, linewidths=width, alpha=strength)


def _upright(ax: Axes, titles: Sequence[str], ends: Sequence[tuple[float, float]]) -> None:
    # end values on the scale, name below
    ax.set_xlim(-0.3, len(titles) - 0.7)
    ax.set_ylim(-0.09, 1.09)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    ax.spines["bottom"].set_visible(False)
    for k, (low, high) in enumerate(ends):
        ax.axvline(k, 0.09 / 1.18, 1.09 / 1.18, color=MUTED, linewidth=1.0, zorder=0)
        for text, y, side in ((low, -0.015, "top"), (high, 1.015, "bottom")):
            ax.text(k, y, f"{text:.3g}", ha="center", va=side, fontsize=8, color=INK)
    ax.set_xticks(range(len(titles)), [_lines(title) for title in titles], fontsize=8)
    ax.tick_params(length=0)


def _lines(text: str) -> str:
    # short enough to fit beside the neighbouring titles
    words, lines = text.split(), [""]
    for word in words:
        if lines[-1] and len(lines[-1]) + 1 + len(word) > 15:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return "\n".join(printable(line) for line in lines)


_MOST = 2.0  # largest normalised value shown; longer bars are cut and labelled with their value


@dataclass(frozen=True, eq=False)
class GoalBars:
    """Normalised values of m goals for two gain sets.

    Attributes:
        names: (m,) names of the goals, hard goals first.
        hard: (m,) whether the goal is hard.
        hand, tuned: (m,) normalised values of the goals, `hand` with the hand-tuned gains, `tuned` with the tuned
            gains.
        speed: (m,) cruise speed [m/s] at which the tuned gains are worst; NaN if the goal names no speeds.
    """

    names: tuple[str, ...]
    hard: tuple[bool, ...]
    hand: NDArray[np.float64]
    tuned: NDArray[np.float64]
    speed: NDArray[np.float64]


def goal_bars(tuning: Tuning) -> GoalBars:
    """Return the normalised goals of a tuning, hard goals first."""
    goals = tuning.request.goals
    order = sorted(range(len(goals)), key=lambda j: goals[j].kind != "hard")
    hand, tuned = tuning.hand.evaluation.normalised[0], tuning.tuned.evaluation.normalised[0]
    names = tuple(goals[j].name for j in order)
    speed = tuning.tuned.evaluation.place[0][order]
    return GoalBars(names, tuple(goals[j].kind == "hard" for j in order), hand[order], tuned[order], speed)


def plot_goal_bars(data: GoalBars, ax: Axes | None = None) -> Axes:
    """Plot two bars for each goal, one for each gain set, with a line at 1, the largest value that meets the goal.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import plot_goal_bars
        >>> from surctl.marine.report.goals import goal_bars
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, Request, build_cases, conditions, gain_ranges
        >>> from surctl.tuning import tune
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> goals = (Goal("soon", "time_s", "s", 20.0), Goal("clear", "min_clearance_m", "m", 0.08, "at least", "hard"))
        >>> tuning = tune(Request(goals, runs, gains, gain_ranges(gains, ["k_v"])), trials=8, rounds=1, runs=0)
        >>> ax = plot_goal_bars(goal_bars(tuning))
        >>> ax.get_title("left"), [label.get_text() for label in ax.get_yticklabels()]
        ('normalised goals: at most 1 is met', ['clear (hard)', 'soon (soft)'])
    """
    count = len(data.names)
    ax = ax or new_axes(7.0, 1.7 + 0.52 * count)
    dress(ax, title="normalised goals: at most 1 is met", x="normalised value [1]")
    ax.grid(visible=False, axis="y")
    at = np.arange(count)[::-1]
    right = min(_MOST, max(1.25, 1.1 * _largest(data)))
    ax.axvspan(1.0, right, color=BAD, alpha=0.08, zorder=0)
    ax.axvline(1.0, color=BAD, linewidth=1.4, zorder=3)
    for values, colour, shift in ((data.hand, MUTED, 0.18), (data.tuned, ROBOT, -0.18)):
        lengths = np.clip(np.nan_to_num(values, nan=np.inf), 0.0, right)
        ax.barh(at + shift, lengths, height=0.32, color=colour, zorder=2)
        for y, value, length in zip(at + shift, values, lengths, strict=True):
            text = f"{value:.3g}" if np.isfinite(value) else "not met"
            inside = length > 0.8 * right
            ax.text(
                length - 0.01 * right if inside else length + 0.01 * right,
                y,
                text,
                ha="right" if inside else "left",
                va="center",
                fontsize=8,
                color="white" if inside else INK,
                zorder=4,
            )
    worst = ["" if np.isnan(speed) else f", worst at {speed:g} m/s" for speed in data.speed]
    kinds = [("hard" if hard else "soft") + at for hard, at in zip(data.hard, worst, strict=True)]
    ax.set_yticks(at, [f"{name} ({kind})" for name, kind in zip(data.names, kinds, strict=True)], parse_math=False)
    ax.set_xlim(0.0, right)
    ax.set_ylim(-0.6, count - 0.4)
    legend_below(ax, columns=2, handles=[Patch(color=MUTED, label="start gains"), Patch(color=ROBOT, label="tuned")])
    return ax


def _largest(data: GoalBars) -> float:
    both = np.concatenate([data.hand, data.tuned])
    return float(np.max(both[np.isfinite(both)], initial=1.0))


_WIDE = 70  # characters of a line of the legend
_SCORE = "score [1]: worst soft goal over its limit or its start (lower is better)"
_HARD = "largest hard goal over its limit [1] (lower is better)"


def plot_front(tuning: Tuning, ax: Axes | None = None) -> Axes:
    """Plot score and mean thrust of the Pareto-optimal gain sets, with the start gains and the tuned gains marked.

    Without soft goals, the largest normalised hard goal takes the place of the score. A hollow mark is a set that
    misses hard goals; the legend has their normalised values, because neither axis shows them.
    """
    soft = any(goal.kind == "soft" for goal in tuning.request.goals)
    ax = dress(
        ax or new_axes(5.6, 4.6),
        title="what the tuning found",
        x=_SCORE if soft else _HARD,
        y="mean thrust [N] (lower is better)",
    )
    start = tuning.hand.evaluation.normalised[0]

    def places(pool: Pool) -> NDArray[np.float64]:
        return pool.score(start) if soft else pool.evaluation.normalised.max(axis=1, initial=0.0)

    order = np.argsort(places(tuning.front), kind="stable")
    score, effort = places(tuning.front)[order], tuning.front.evaluation.effort[order]
    ax.plot(score, effort, "o", color=GOOD, markersize=5, label="undominated", zorder=2)
    for pool, mark, colour, label in ((tuning.hand, "s", MUTED, "start gains"), (tuning.tuned, "D", AVOIDING, "tuned")):
        at, thrust = float(places(pool)[0]), float(pool.evaluation.effort[0])
        if np.isfinite([at, thrust]).all():
            missed = _hard_misses(pool)
            text = f"{label} (hard goals missed: {', '.join(missed)})" if missed else label
            face = "none" if missed else colour
            ax.plot(
                at, thrust, mark, color=colour, markerfacecolor=face, markersize=8,
                label=fill(printable(text), _WIDE), linestyle="none", zorder=3,
            )  # fmt: skip
    ax.axvline(1.0, color=BAD, linewidth=1.0, zorder=0)
    ax.margins(0.1)
    legend_below(ax, columns=1, handles=ax.get_legend_handles_labels()[0])
    return ax


def _hard_misses(pool: Pool) -> list[str]:
    # of the first set
    shares = zip(pool.evaluation.goals, pool.evaluation.normalised[0], strict=True)
    return [f"{goal.name} {share:.3g}" for goal, share in shares if goal.kind == "hard" and not share <= 1] + [
        "a claim" for over in pool.claims[0] if not over <= 0
    ][:1]


@dataclass(frozen=True, eq=False)
class GoalView:
    """The metric of a goal over time, in the run that is worst for the goal.

    Attributes:
        goal: the goal.
        label: name of the run.
        course: name of the metric with its unit.
        time: (k,) times [s], by label of the gain set.
        values: (k,) values of the metric, by label of the gain set.
    """

    goal: Goal
    label: str
    course: str
    time: dict[str, NDArray[np.float64]]
    values: dict[str, NDArray[np.float64]]


_OVER_TIME = {
    "min_clearance_m": "clearance [m]",
    "deviation_m": "deviation so far, rms [m]",
    "max_deviation_m": "distance from the path [m]",
    "effort_n": "thrust so far, mean [N]",
    "time_s": "distance to the target [m]",  # the bound applies to the time axis
}


def goal_views(tuning: Tuning, goals: Iterable[Goal]) -> Iterator[GoalView]:
    """Yield the view of each goal whose metric is a function of time, for start gains and tuned gains.

    It is of the worst run of the tuned gains. A run that several goals show is simulated once.
    """
    conditions, base = tuning.request.conditions, tuning.request.base
    sets = {"start gains": base, "tuned": base.with_values(tuning.result.gains)}
    tuned = {name: np.array([value]) for name, value in tuning.result.gains.items()}
    runs: dict[tuple[int, str], Run] = {}
    for goal in goals:
        if goal.metric not in _OVER_TIME:
            continue
        own = scope(goal, conditions)
        measured = figures([goal], [conditions[k] for k in own], tuned)[goal.metric][0]
        worst = own[int(goal.normalised(measured).argmax())]
        time, values = {}, {}
        for label, gains in sets.items():
            if (worst, label) not in runs:
                runs[worst, label] = _simulated(conditions[worst], gains)
            time[label], values[label] = _course(runs[worst, label], goal.metric)
        yield GoalView(goal, conditions[worst].label, _OVER_TIME[goal.metric], time, values)


def _simulated(condition: Condition, gains: Gains) -> Run:
    case = condition.case
    return simulate(
        case.scenario,
        _actual_vehicle(case.vehicle, condition),
        gains=gains,
        law=case.build(),
        sensing=case.sensing,
        seed=condition.seed,
        model=case.model or case.vehicle,
    )


def _course(run: Run, metric: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    record = run.record
    away = run.scenario.follower().track(record.eta[:, :2])
    counted = np.arange(1, len(away) + 1)
    course = {
        "min_clearance_m": record.clearance,
        "deviation_m": np.sqrt(np.cumsum(away**2) / counted),  # the metric is the last value of the curve
        "max_deviation_m": away,
        "effort_n": np.cumsum(np.hypot(record.tau[:, 0], record.tau[:, 1])) / counted,
        "time_s": np.hypot(*(record.eta[:, :2] - run.scenario.target).T),
    }[metric]
    return record.time, np.asarray(course, dtype=float)


def _actual_vehicle(vehicle: Vehicle, condition: Condition) -> Vehicle:
    return vehicle.with_values({name.removeprefix("plant."): value for name, value in condition.plant.items()})


def plot_goal_view(data: GoalView, ax: Axes | None = None) -> Axes:
    """Plot the metric of a goal over time; the side of the bound on which the goal is missed is shaded."""
    goal = data.goal
    ax = ax or new_axes(6.4, 3.9)
    dress(ax, title=goal.name, x="time [s]", y=data.course)
    for k, label in enumerate(data.time):
        curve(ax, data.time[label], data.values[label], label=label, k=k)
    # the goal of arrival bounds the time axis, every other goal bounds the axis of its metric
    bounded_values, shade, line, bounded, free = (
        (data.time, ax.axvspan, ax.axvline, ax.set_xlim, ax.set_ylim)
        if goal.metric == "time_s"
        else (data.values, ax.axhspan, ax.axhline, ax.set_ylim, ax.set_xlim)
    )
    ends = np.concatenate([*bounded_values.values(), [goal.limit]])
    known = ends[np.isfinite(ends)]
    spread = max(float(np.ptp(known)), 1e-6)
    low, high = min(0.0, float(known.min())) - 0.02 * spread, float(known.max()) + 0.12 * spread
    above = goal.bad_side() == "above"
    shade(goal.limit if above else low, high if above else goal.limit, color=BAD, alpha=0.10, zorder=0)
    line(goal.limit, color=BAD, linewidth=1.4, zorder=1, label=f"{goal.sense} {goal.limit:g} {goal.unit}")
    bounded(low, high)
    free(0.0)
    legend_above(ax, columns=3)
    label = fill(printable(data.label), 100)
    ax.set_xlabel(f"{ax.get_xlabel()}\n\n{label}", fontsize=8, color=INK, parse_math=False)
    return ax
