"""One plot as data, drawn by matplotlib for files, or as SVG within a millisecond for the design page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surctl.report.theme import BAD, CYCLE, INK, curve, dress, finite, grid_of, legend_above, new_figure

Array = NDArray[np.float64]

_WIDTH, _HEIGHT = 320.0, 222.0  # [px]
_LEFT, _RIGHT, _TOP, _BOTTOM = 54.0, 8.0, 8.0, 38.0
_DASHES = ("", "7 3", "9 3 2 3", "2 3", "9 3 2 3 2 3")  # as in `theme.curve`
_MOST_POINTS = 320  # of a curve in SVG


@dataclass(frozen=True, eq=False)
class Curve:
    """A line or marks of a plot.

    Attributes:
        x, y: (n,) values.
        label: text in the legend; "" for none.
        k: number of colour and dash.
        kind: "line"; "steps" for values that hold until the next one; "poles" for crosses; "dots".
        faint: whether the line belongs to the compared set.
    """

    x: Array
    y: Array
    label: str = ""
    k: int = 0
    kind: Literal["line", "steps", "poles", "dots"] = "line"
    faint: bool = False


@dataclass(frozen=True, eq=False)
class Shade:
    """The side of a bound on which a goal is missed: above `y` or below `y`, (n,) values at x (n,)."""

    x: Array
    y: Array
    side: Literal["above", "below"]


@dataclass(frozen=True, eq=False)
class Panel:
    """One plot.

    Attributes:
        title: what it shows.
        x, y: labels of the axes, with units.
        curves: lines and marks.
        shades: violated sides of bounds.
        log_x: whether x is logarithmic; time never is.
        marks: labelled points (x, y, text).
        limits: (low, high) of x and of y; None: those of the data.
        equal: whether both axes have one scale.
        note: a sentence below the plot.
        mark: "good", "bad" or "".
    """

    title: str
    x: str
    y: str
    curves: Sequence[Curve]
    shades: Sequence[Shade] = ()
    log_x: bool = False
    marks: Sequence[tuple[float, float, str]] = ()
    limits: tuple[tuple[float, float] | None, tuple[float, float] | None] = (None, None)
    equal: bool = False
    note: str = ""
    mark: str = ""
    regions: Sequence[tuple[Array, Array]] = field(default=())  # outlines of violated regions


def draw_panel(panel: Panel, ax: Axes) -> Axes:
    """Draw a panel into matplotlib axes."""
    dress(ax, title=panel.title, x=panel.x, y=panel.y)
    if panel.log_x:
        ax.set_xscale("log")
    for one in panel.curves:
        if one.kind in ("poles", "dots"):
            style = "x" if one.kind == "poles" else "o"
            colour = CYCLE[one.k % len(CYCLE)]
            ax.plot(one.x, one.y, style, color=colour, markersize=6 if style == "x" else 2.5, label=one.label or None)
        else:
            curve(ax, one.x, one.y, label=one.label, k=one.k, faint=one.faint)
            if one.kind == "steps":
                ax.lines[-1].set_drawstyle("steps-post")
            if len(one.x) == 1:
                ax.lines[-1].set_marker("o")
    low, high = _limits(panel)[1]
    for shade in panel.shades:
        end = high if shade.side == "above" else low
        ax.fill_between(shade.x, finite(shade.y), end, color=BAD, alpha=0.12, linewidth=0)
        ax.plot(shade.x, finite(shade.y), color=BAD, linewidth=1.2)
    for x, y in panel.regions:
        ax.fill(x, y, color=BAD, alpha=0.12, linewidth=0)
    for px, py, text in panel.marks:
        ax.plot(px, py, "+", color=INK, markersize=8)
        ax.annotate(text, (px, py), textcoords="offset points", xytext=(4, 4), fontsize=8, color=INK)
    (left, right), (low, high) = _limits(panel)
    ax.set_xlim(left, right)
    ax.set_ylim(low, high)
    if panel.equal:
        ax.set_aspect("equal", adjustable="box")
    if any(one.label for one in panel.curves):
        legend_above(ax, columns=3)
    return ax


def draw_panels(panels: Sequence[Panel]) -> Figure:
    """Return a figure with several panels in a grid."""
    if not panels:
        return new_figure(5.2, 3.6)
    axes = grid_of(len(panels), most=2, size=(5.2, 3.6))
    for panel, ax in zip(panels, axes, strict=True):
        draw_panel(panel, ax)
    return axes[0].figure.figure


def panel_svg(panel: Panel) -> str:
    """Return a panel as an HTML figure with an SVG picture; colours come from the style of the page."""
    (x0, x1), (y0, y1) = _limits(panel)
    if panel.log_x:
        x0, x1 = np.log10(x0), np.log10(x1)
    wide, high = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
    if panel.equal:
        grown = (x1 - x0) / wide * high
        middle, half = (y0 + y1) / 2, max(y1 - y0, grown) / 2
        y0, y1 = middle - half, middle + half
        spread = (y1 - y0) / high * wide
        x0, x1 = (x0 + x1 - spread) / 2, (x0 + x1 + spread) / 2

    def across(values: Array) -> Array:
        at = np.log10(np.maximum(values, 1e-300)) if panel.log_x else values
        return np.asarray(_LEFT + (at - x0) / (x1 - x0) * wide, dtype=float)

    def upwards(values: Array) -> Array:
        share = np.clip((values - y0) / (y1 - y0), -1, 2)  # SVG clips what is outside
        return np.asarray(_TOP + high * (1 - share), dtype=float)

    parts = [_ticks(panel, (x0, x1), (y0, y1), wide, high), f'<svg x="{_LEFT}" y="{_TOP}" ']
    parts[-1] += f'width="{wide}" height="{high}" viewBox="{_LEFT} {_TOP} {wide} {high}">'
    for x, y in panel.regions:
        parts.append(f'<path class="miss" d="{_path(across(x), upwards(y))}Z"/>')
    for shade in panel.shades:
        known = np.isfinite(shade.y)
        if known.any():
            x, y = across(shade.x[known]), upwards(shade.y[known])
            edge = _TOP - 5 if shade.side == "above" else _TOP + high + 5
            d = _path(x, y)
            parts.append(f'<path class="miss" d="{d}L{x[-1]:.1f} {edge:.1f}L{x[0]:.1f} {edge:.1f}Z"/>')
            parts.append(f'<path class="bound" d="{d}"/>')
    parts += [_curve(_cropped(one, panel.limits[0]), across, upwards) for one in panel.curves]
    for px, py, _ in panel.marks:
        cx, cy = float(across(np.array([px]))[0]), float(upwards(np.array([py]))[0])
        parts.append(f'<path class="mark" d="M{cx - 5:.1f} {cy:.1f}h10M{cx:.1f} {cy - 5:.1f}v10"/>')
    parts.append("</svg>")
    legend = "".join(_key(one) for one in panel.curves if one.label)
    said = f"{panel.title}; {panel.y} over {panel.x}"
    note = f'<p class="note {panel.mark}">{escape(panel.note)}</p>' if panel.note else ""
    return (
        f'<figure class="panel"><figcaption>{escape(panel.title)}</figcaption><div class="keys">{legend}</div>'
        f'<svg class="chart" viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{escape(said, quote=True)}">'
        f"{''.join(parts)}</svg>{note}</figure>"
    )


def _cropped(one: Curve, limits: tuple[float, float] | None) -> Curve:
    # what is outside would take points from what is shown
    if limits is None or one.kind not in ("line", "steps") or not np.all(np.diff(one.x) >= 0):
        return one
    first, last = np.searchsorted(one.x, limits)
    part = slice(max(int(first) - 1, 0), int(last) + 1)
    return replace(one, x=one.x[part], y=one.y[part])


def _key(one: Curve) -> str:
    line = f'<path {_style(one)} d="M0 5h26" stroke-dasharray="{_dash(one)}"/>'
    return f'<span class="key"><svg width="26" height="10" aria-hidden="true">{line}</svg>{escape(one.label)}</span>'


def _style(one: Curve) -> str:
    return f'class="c{one.k % len(CYCLE)}{" faint" if one.faint else ""}"'


def _dash(one: Curve) -> str:
    return _DASHES[(one.k + one.k // len(CYCLE)) % len(_DASHES)]


def _curve(one: Curve, across: object, upwards: object) -> str:
    assert callable(across) and callable(upwards)
    x, y = np.asarray(one.x, dtype=float), finite(one.y)
    style = _style(one)
    if one.kind in ("poles", "dots"):
        px, py = across(x), upwards(y)
        size = 4 if one.kind == "poles" else 1
        cross = "".join(
            f"M{a - size:.1f} {b - size:.1f}l{2 * size} {2 * size}m0 {-2 * size}l{-2 * size} {2 * size}"
            if one.kind == "poles"
            else f"M{a - 1:.1f} {b:.1f}h2"
            for a, b in zip(px.tolist(), py.tolist(), strict=True)
            if np.isfinite(b)
        )
        return f'<path {style} d="{cross}"/>'
    if len(x) > _MOST_POINTS and one.kind == "line":
        keep = np.unique(np.linspace(0, len(x) - 1, _MOST_POINTS).astype(int))
        x, y = x[keep], y[keep]
    if one.kind == "steps":
        x, y = np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]
    px, py = across(x), upwards(y)
    return f'<path {style} stroke-dasharray="{_dash(one)}" d="{_path(px, py)}"/>'


def _path(x: Array, y: Array) -> str:
    # a new stroke begins after a gap (NaN)
    known = np.isfinite(x) & np.isfinite(y)
    pen = np.where(np.concatenate([[False], known[:-1]]), "L", "M")
    return "".join(
        f"{p}{a:.1f} {b:.1f}"
        for p, a, b, k in zip(pen.tolist(), x.tolist(), y.tolist(), known.tolist(), strict=True)
        if k
    )


def _limits(panel: Panel) -> tuple[tuple[float, float], tuple[float, float]]:
    xs, ys = (np.concatenate([np.ravel(getattr(one, axis)) for one in panel.curves] or [np.zeros(1)]) for axis in "xy")
    bounds = np.concatenate([shade.y for shade in panel.shades] or [np.zeros(0)])
    return _span(panel.limits[0], xs, margin=0.0, log=panel.log_x), _span(
        panel.limits[1], np.concatenate([ys, bounds]), margin=0.06
    )


def _span(ends: tuple[float, float] | None, values: Array, *, margin: float, log: bool = False) -> tuple[float, float]:
    if ends is not None:
        return ends
    known = values[np.isfinite(values) & ((values > 0) | (not log))]
    if not known.size:
        return (0.1, 1.0) if log else (0.0, 1.0)
    low, high = float(known.min()), float(known.max())
    if high - low <= 1e-12 * max(abs(high), 1e-12):
        pad = 0.1 * abs(high) or 1.0
        return (low / 2, high * 2) if log else (low - pad, high + pad)
    pad = margin * (high - low)
    return low - pad, high + pad


def _ticks(panel: Panel, x: tuple[float, float], y: tuple[float, float], wide: float, high: float) -> str:
    parts = []
    across = _decades(*x) if panel.log_x else _round(*x)
    for value, text in across:
        at = _LEFT + (value - x[0]) / (x[1] - x[0]) * wide
        parts.append(f'<path class="grid" d="M{at:.1f} {_TOP}v{high:.1f}"/>')
        parts.append(f'<text class="tick" x="{at:.1f}" y="{_TOP + high + 14:.1f}" text-anchor="middle">{text}</text>')
    for value, text in _round(*y):
        at = _TOP + high * (1 - (value - y[0]) / (y[1] - y[0]))
        parts.append(f'<path class="grid" d="M{_LEFT} {at:.1f}h{wide:.1f}"/>')
        parts.append(f'<text class="tick" x="{_LEFT - 5}" y="{at + 4:.1f}" text-anchor="end">{text}</text>')
    parts.append(f'<path class="axis" d="M{_LEFT} {_TOP}v{high:.1f}h{wide:.1f}"/>')
    middle = _TOP + high / 2
    parts.append(f'<text x="{_LEFT + wide / 2:.1f}" y="{_HEIGHT - 7}" text-anchor="middle">{escape(panel.x)}</text>')
    parts.append(
        f'<text transform="translate(12 {middle:.1f}) rotate(-90)" text-anchor="middle">{escape(panel.y)}</text>'
    )
    return "".join(parts)


def _decades(low: float, high: float) -> list[tuple[float, str]]:
    step = max(1, round((high - low) / 5))
    whole = range(int(np.ceil(low - 1e-9)), int(np.floor(high + 1e-9)) + 1, step)
    marks = [(float(k), f"{10.0**k:g}") for k in whole]
    return marks if len(marks) > 1 else [(at, f"{10**at:.3g}") for at in np.linspace(low, high, 4)[1:-1]]


def _round(low: float, high: float) -> list[tuple[float, str]]:
    raw = (high - low) / 5
    size = 10.0 ** np.floor(np.log10(raw))
    step = float(size * next(m for m in (1, 2, 5, 10) if m * size >= raw * 0.999))
    first = np.ceil(low / step - 1e-9)
    values = (np.arange(first, np.floor(high / step + 1e-9) + 1) * step).tolist()
    return [(value, f"{0.0 if abs(value) < step * 1e-6 else value:.6g}") for value in values]
