"""Plots of goals: how well each goal is met, and the Pareto front of a tuning."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from numpy.typing import NDArray

from surctl.report.theme import (
    AVOIDING,
    BAD,
    GOOD,
    INK,
    MUTED,
    ROBOT,
    dress,
    legend_below,
    new_axes,
    printable,
)
from surctl.tuning import Pool, Tuning

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


SHOWN = ("deviation_m", "time_s", "min_clearance_m_worst", "effort_n", "delay_margin_s", "disk_margin", "score")
"""Columns of a sweep of missions that parallel coordinates show."""

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
