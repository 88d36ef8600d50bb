"""Results: one line per contender, as a Markdown table and as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from contender import Contender, Timing
from in_c import CompiledRun
from numpy.typing import NDArray

from surctl.report.theme import AVOIDING, INK, MUTED, ROBOT, dress, new_axes

__all__ = ["OFF", "Line", "compiled_lines", "draw", "lines_of", "print_bars", "print_lines", "print_rows"]

Array: TypeAlias = NDArray[np.float64]

OFF = 1e-6
"""A solution further than this from the reference [m/s, rad/s] is wrong."""


@dataclass(frozen=True)
class Line:
    """The result of a contender.

    Attributes:
        name, problem, ours: of the contender.
        typical: the number that ratios are made of [ns]: the median in Python, the mean in C.
        median, p99: of all single steps [ns]; p99 includes the influence of other programs.
        hard: 99th percentile over the steps, each with its median over the rounds [ns].
        samples: number of timed steps.
        asked, silent, off: number of steps, of steps without a solution, and of solutions off by more than `OFF`.
        gap: largest distance from it.
    """

    name: str
    problem: str
    ours: bool
    typical: float
    median: float
    p99: float
    hard: float
    samples: int
    asked: int
    silent: int
    off: int
    gap: float


def lines_of(
    contenders: Sequence[Contender], timings: Mapping[str, Timing], references: Mapping[str, str]
) -> list[Line]:
    """Return the results of the Python contenders, compared with the reference of their problem."""
    lines = []
    for contender in contenders:
        timing, reference = timings[contender.name], timings[references[contender.problem]].answers
        gaps = [
            float(np.abs(v - wanted).max())
            for at, v in timing.answers.items()
            if v is not None and (wanted := reference.get(at)) is not None
        ]
        silent = sum(v is None for v in timing.answers.values())
        single = timing.rounds()
        lines.append(_line(contender, float(np.median(single)), single, silent, gaps))
    return lines


def compiled_lines(runs: Sequence[CompiledRun], references: Mapping[str, Array]) -> list[Line]:
    """Return the results of the contenders in C, compared with the reference solutions (count, n) of their problem."""
    lines = []
    for run in runs:
        distance = np.abs(run.answers - references[run.problem]).max(axis=1)
        gaps = [float(gap) for gap in distance if not np.isnan(gap)]
        silent = int(np.isnan(run.answers[:, 0]).sum())
        lines.append(_line(run, run.mean(), np.array(run.single), silent, gaps))
    return lines


def _line(who: Contender | CompiledRun, typical: float, single: Array, silent: int, gaps: list[float]) -> Line:
    return Line(
        name=who.name,
        problem=who.problem,
        ours=who.ours,
        typical=typical,
        median=float(np.median(single)),
        p99=float(np.percentile(single, 99)),
        hard=float(np.percentile(np.median(single, axis=0), 99)),
        samples=single.size,
        asked=single.shape[1],
        silent=silent,
        off=sum(not gap <= OFF for gap in gaps),
        gap=max(gaps, default=float("nan")),
    )


def print_rows(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A Markdown table."""
    print("\n| " + " | ".join(header) + " |\n" + "|---" * len(header) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |")


def print_lines(lines: Sequence[Line], *, ours: Mapping[str, str], mean: bool) -> None:
    """Print times in µs, and ratios to the contender that `ours` names for each problem."""
    typical = {line.name: line.typical for line in lines}
    rows = []
    for line in lines:
        ratio = typical[ours[line.problem]] / line.typical
        times = [*([line.typical] if mean else []), line.median, line.hard, line.p99]
        counts = (f"{line.gap:.1e}", f"{line.off} of {line.asked}", str(line.silent), str(line.samples))
        figures = map(_number, (*(time / 1e3 for time in times), ratio, 1.0 / ratio))
        rows.append([line.name, line.problem, *figures, *counts])
    heads = [*(["mean µs"] if mean else []), "median µs", "p99 of steps µs", "p99 of all µs", "ours / it", "it / ours"]
    print_rows(["who", "problem", *heads, "largest difference", f"off by > {OFF:.0e}", "no answer", "samples"], rows)


def _number(value: float) -> str:
    """Three digits."""
    return f"{value:.0f}" if value >= 100 else f"{value:#.3g}".rstrip(".")


def print_bars(bars: Sequence[tuple[str, float | None, float, bool]]) -> bool:
    """Print (statement, figure or None, limit, whether the figure must be below); return whether all measured limits
    hold.
    """
    rows, good = [], True
    for text, figure, bar, below in bars:
        holds = figure is None or (figure <= bar if below else figure >= bar)
        good = good and holds
        word = "not measured" if figure is None else "holds" if holds else "**missed**"
        rows.append([text, "" if figure is None else _number(figure), f"{'≤' if below else '≥'} {bar:g}", word])
    print_rows(["bar", "measured", "required", ""], rows)
    return good


def draw(lines: Sequence[Line], path: Path) -> None:
    """Draw medians as dots and 99th percentiles as bars on a logarithmic axis, fastest first."""
    shown = sorted(lines, key=lambda line: -line.median)
    ax = new_axes(10.0, 0.9 + 0.27 * len(shown))
    for at, line in enumerate(shown):
        colour = ROBOT if line.ours else AVOIDING
        ax.plot([line.median / 1e3, line.hard / 1e3], [at, at], color=MUTED, linewidth=0.8, zorder=1)
        ax.plot(line.hard / 1e3, at, marker="|", markersize=8, color=colour)
        ax.plot(line.median / 1e3, at, marker="o" if line.ours else "s", markersize=5, color=colour)
    ax.set_xscale("log")
    dress(ax, title="One step: median and 99th percentile", x="µs")
    ax.set_yticks(range(len(shown)), [f"{line.name} · {line.problem}" for line in shown], fontsize=7.5, color=INK)
    ax.figure.figure.savefig(path)
