"""Plots of linear loops and their goals (Bode, Nyquist, steps, poles, root locus); replies of the design page."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, SurctlError, check_known
from surctl.report.design_bench import DesignBench, Slider, View
from surctl.report.document import template
from surctl.report.panel import Curve, Panel, Shade, draw_panel, draw_panels, panel_svg
from surctl.report.theme import BAD, dress, legend_above, new_axes, png
from surctl.system import LinearLoop
from surctl.tuning.loop_goals import LoopScores, LoopView, Score, judge_loops
from surctl.tuning.loop_responses import frequencies, rates, response, step_series
from surctl.verification.linear import LEAST_DISK_MARGIN
from surctl.verification.sampled_margins import system_margins

Array = NDArray[np.float64]
Loops = Mapping[str, LinearLoop]

_CIRCLE = np.linspace(0, 2 * np.pi, 97)
_NEAR = (2 - LEAST_DISK_MARGIN) / (2 + LEAST_DISK_MARGIN)  # where the disk meets the real axis: -1/_NEAR and -_NEAR
_FORBIDDEN = (
    -(1 / _NEAR + _NEAR) / 2 + (1 / _NEAR - _NEAR) / 2 * np.cos(_CIRCLE),
    (1 / _NEAR - _NEAR) / 2 * np.sin(_CIRCLE),
)
"""The disk that the Nyquist curve must avoid for the least disk margin (skew 0)."""
_FACTORS = np.geomspace(0.05, 20, 61)  # on the loop gain, of the root locus
_HERE = 30  # index of the factor 1
_REST = 0.01  # of the range of a response: smaller changes are not shown
_FAST = 12.0  # poles further left than this multiple of the median are outside of the picture


def _loop_panels(
    loops: Loops, opening: str, *, source: str = "", end: str = "", compared: Loops | None = None
) -> list[Panel]:
    """Return the panels of loops at several operating points.

    Args:
        loops: loops by name of the operating point.
        opening: label of the command or measured output at which the loop is opened.
        source, end: signals of the step response, as in `LinearLoop.transfer`; empty: no step response.
        compared: loops of another set of gains, which are drawn thin.
    """
    each = [*((name, loop, k, False) for k, (name, loop) in enumerate(loops.items()))]
    each += [(f"{name}, B", loop, k, True) for k, (name, loop) in enumerate((compared or {}).items())]
    names = ("gain", "phase", "S", "T", "nyquist", "steps", "poles")
    by_kind: dict[str, list[Curve]] = {name: [] for name in names}
    gain, phase, S, T, nyquist, steps, poles = (by_kind[name] for name in names)
    for name, loop, k, faint in each:
        omega = frequencies(loop, [opening])
        L = response(loop.opened(opening), omega, loop.dt)[:, 0, 0]
        gain.append(Curve(omega, _db(np.abs(L)), name, k, faint=faint))
        phase.append(Curve(omega, np.rad2deg(np.unwrap(np.angle(L))), name, k, faint=faint))
        nyquist.append(Curve(np.concatenate([L.real, [np.nan], L.real]), np.concatenate([L.imag, [np.nan], -L.imag]),
                             name, k, faint=faint))  # fmt: skip
        s = rates(loop)
        poles.append(Curve(s.real, s.imag, name, k, "poles", faint))
        if loop.stable:
            S.append(Curve(omega, _db(np.abs(1 / (1 + L))), name, k, faint=faint))
            T.append(Curve(omega, _db(np.abs(L / (1 + L))), name, k, faint=faint))
            if source and end:
                time, value, _ = step_series(loop, source, end)
                steps.append(Curve(time, value, name, k, "line", faint))
    w = "frequency [rad/s]"
    nyquist.append(Curve(np.cos(_CIRCLE), np.sin(_CIRCLE), "", 4, faint=True))
    panels = [
        Panel(f"Loop gain |L|, opened at {opening}", w, "|L| [dB]", gain, log_x=True),
        Panel(f"Phase of L, opened at {opening}", w, "phase [deg]", phase, log_x=True),
        Panel("Sensitivity |S|", w, "|S| [dB]", S, log_x=True, limits=(None, (-40.0, 12.0)), note=_unstable(loops)),
        Panel("Complementary sensitivity |T|", w, "|T| [dB]", T, log_x=True, limits=(None, (-40.0, 12.0))),
        Panel("Nyquist curve", "real part of L", "imaginary part of L", nyquist,
              marks=[(-1.0, 0.0, "-1")], limits=((-3.0, 1.5), (-2.0, 2.0)), equal=True, regions=[_FORBIDDEN],
              note=f"in the shaded disk, the disk margin of this loop is below {LEAST_DISK_MARGIN:g}"),
    ]  # fmt: skip
    if source and end:
        span = _until_rest(steps)
        panels.append(Panel(f"Step from {source} to {end}", "time [s]", end, steps, limits=(span, None)))
    panels.append(_pole_panel("Poles of the closed loop", poles))
    name, loop = next(iter(loops.items()))
    panels.append(_pole_panel(f"Root locus: gain at {opening} times 0.05 to 20, {name}", _root_locus(loop, opening)))
    return panels


def _locus_panel(title: str, loops: Sequence[LinearLoop], marked: Loops, label: str = "") -> Panel:
    """Return the poles of the loops over the values of a number, and of some of them by their text in the legend."""
    every = np.concatenate([rates(loop) for loop in loops] or [np.zeros(0, dtype=complex)])
    curves = [Curve(every.real, every.imag, label, 0, "dots")]
    for k, (text, loop) in enumerate(marked.items(), start=1):
        curves.append(Curve(rates(loop).real, rates(loop).imag, text, k, "poles"))
    return _pole_panel(title, curves)


def plot_locus(
    loops: Sequence[LinearLoop],
    values: ArrayLike,
    name: str,
    *,
    unit: str = "",
    picked: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot the root locus of loops over the values of a number: the poles of each, those at the picked value marked.

    Raises:
        InputError: there is no loop, or not one value for each loop.

    Example:
        >>> from surctl.report import plot_locus
        >>> from surctl.system import linearise
        >>> from surctl.testing import cart_system
        >>> gains = [1.0, 2.0, 4.0]
        >>> ax = plot_locus([linearise(cart_system(k)) for k in gains], gains, "k", unit="1/s", picked=2.0)
        >>> [line.get_label() for line in ax.lines], ax.figure.axes[-1].get_ylabel()
        (['start: 1', 'picked: 2', 'stability boundary'], 'k [1/s]')
    """
    numbers = np.asarray(values, dtype=float)
    if numbers.shape != (len(loops),) or not loops:
        raise InputError("are not as many as the loops", key="values", value=numbers, remedy="give one for each loop")
    marked = {f"start: {numbers[0]:.3g}": loops[0]}
    if picked is not None:
        at = int(np.argmin(np.abs(numbers - picked)))
        marked[f"picked: {numbers[at]:.3g}"] = loops[at]
    ax = draw_panel(_locus_panel("", loops, marked), ax or new_axes(6.4, 4.9))
    colours = np.repeat(numbers, [len(rates(loop)) for loop in loops])
    dots = ax.lines[0]
    points = ax.scatter(*dots.get_data(), s=5, c=colours, cmap="viridis", zorder=1.9)
    dots.remove()
    for line, marker in zip(ax.lines, "oD", strict=False):
        line.set(marker=marker, fillstyle="none")
    bar = ax.figure.colorbar(points, ax=ax)
    dress(bar.ax, y=f"{name} [{unit}]" if unit else name)
    ax.axvline(0.0, color=BAD, linewidth=1.2, label="stability boundary")
    legend_above(ax, columns=3)
    return ax


def _goal_panels(scores: LoopScores, *, compared: LoopScores | None = None) -> list[Panel]:
    """Return a panel for each goal with its curve at every operating point; the violated side is shaded."""
    goals: dict[str, list[Score]] = {}
    for score in scores.scores:
        goals.setdefault(score.goal.name, []).append(score)
    others: dict[str, list[Score]] = {}
    for score in () if compared is None else compared.scores:
        others.setdefault(score.goal.name, []).append(score)
    return [_goal_panel(name, own, others.get(name, [])) for name, own in goals.items()]


def _goal_panel(name: str, own: Sequence[Score], others: Sequence[Score]) -> Panel:
    worst = max(own, key=lambda score: score.judgement.normalised)
    one = worst.judgement
    unit = "" if one.unit == "1" else f" {one.unit}"
    said = f"{one.value:.3g}{unit} for {one.limit:.3g}, {one.where}" if one.value == one.value else one.where
    note = f"{'met' if one.met else 'missed'}: {one.normalised:.3g}, at {worst.point} ({said})"
    title, mark = f"{name} ({worst.goal.kind})", "good" if one.met else "bad"
    shown = [(score, k, False) for k, score in enumerate(own)] + [(score, k, True) for k, score in enumerate(others)]
    views = [(score, score.judgement.view, k, faint) for score, k, faint in shown if score.judgement.view is not None]
    if not views:
        bars = [
            Curve(np.array([0.0, min(s.judgement.normalised, 2.0)]), np.full(2, float(-k)), s.point, k)
            for s, k, _ in shown
        ]
        edge = Curve(np.ones(2), np.array([0.5, 0.5 - len(own)]), "", 4)
        return Panel(title, "normalised value [1]", "", [*bars, edge], limits=((0.0, 2.0), (0.5 - len(own), 0.5)),
                     note=note, mark=mark)  # fmt: skip
    _, view, _, _ = views[0]
    assert view is not None
    decibels = view.axis == "frequency"
    curves = [
        Curve(v.x, _db(v.y) if decibels else v.y, s.point + (", B" if faint else ""), k,
              "poles" if v.axis == "poles" else "line", faint)
        for s, v, k, faint in views if v is not None
    ]  # fmt: skip
    if view.axis == "poles":
        panel = _pole_panel(title, curves)
        return Panel(
            title, panel.x, panel.y, curves, limits=panel.limits, regions=_region(view, panel), note=note, mark=mark
        )
    shades = []
    for bound, side in ((view.upper, "above"), (view.lower, "below")):
        if bound is not None:
            shades.append(Shade(view.x, _db(bound) if decibels else bound, side))  # type: ignore[arg-type]
    quantity = view.quantity.rpartition(" [")[0] + " [dB]" if decibels else view.quantity
    x = "frequency [rad/s]" if decibels else "time [s]"
    limits = (None, _about(shades, curves)) if decibels else (_until_rest(curves, _edges(view)), None)
    return Panel(title, x, quantity, curves, shades, log_x=decibels, limits=limits, note=note, mark=mark)


def plot_loops(loops: Loops, opening: str, *, source: str = "", end: str = "") -> Figure:
    """Plot loops at several operating points: Bode, |S|, |T|, Nyquist, steps, poles and root locus.

    Example:
        >>> from surctl.report import plot_loops
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning import operating_loops
        >>> figure = plot_loops(operating_loops(cart_system(2.0), {}), "force", source="command.force", end="speed")
        >>> len(figure.axes), figure.axes[5].get_title("left")
        (8, 'Step from command.force to speed')
    """
    return draw_panels(_loop_panels(loops, opening, source=source, end=end))


def plot_loop(loop: LinearLoop, opening: str = "", *, source: str = "", end: str = "") -> Figure:
    """Plot one loop as `plot_loops`; by default opened at the first command, with the step of the first reference."""
    source, end = (source, end) if source else _default_step(loop)
    return plot_loops({"loop": loop}, opening or loop.channels()[0], source=source, end=end)


def plot_tightest(loops: Loops) -> dict[str, Figure]:
    """Plot loops opened where the first of them tolerates the least delay, as `plot_loops`.

    Returns:
        Two figures, of a command and of a measured output, by the label of the signal.
    """
    first = next(iter(loops.values()))
    command, output = (
        min(system_margins(first, *labels), key=lambda margins: margins.delay_margin_s).name
        for labels in (first.names.commands, first.names.outputs)
    )
    end = f"measured.{output}"
    return {
        command: plot_loops(loops, command, source=f"command.{command}", end=end),
        output: plot_loops(loops, output, source=end, end=end),
    }


def _default_step(loop: LinearLoop) -> tuple[str, str]:
    """Return the signals of the step response that is shown first: the first reference or setpoint, and its output."""
    names = loop.names
    end = f"measured.{names.outputs[0]}"
    if not names.references:
        return end, end
    return f"reference.{names.references[0]}", end


def plot_loop_goals(scores: LoopScores) -> Figure:
    """Plot each goal about the loop with its curve at every operating point; the violated side is shaded."""
    return draw_panels(_goal_panels(scores))


def _until_rest(curves: Sequence[Curve], least: float = 0.0) -> tuple[float, float] | None:
    # times up to which a response still moves, at least `least`; a slow mode may end much later
    ends = [least]
    for one in curves:
        away = np.abs(one.y - one.y[-1]) > _REST * max(float(np.ptp(one.y)), 1e-300)
        ends.append(1.4 * float(one.x[np.flatnonzero(away)[-1]]) if away.any() else 0.0)
    return (0.0, max(ends)) if max(ends) > 0 else None


def _edges(view: LoopView) -> float:
    # time a little after a bound begins or ends
    known = [np.isfinite(bound) for bound in (view.lower, view.upper) if bound is not None]
    changes = [float(view.x[np.flatnonzero(np.diff(mask))[-1]]) for mask in known if np.diff(mask).any()]
    return 1.3 * max(changes, default=0.0)


def _about(shades: Sequence[Shade], curves: Sequence[Curve]) -> tuple[float, float]:
    # the range about the bounds: a curve may fall to -200 dB
    bounds = np.concatenate([shade.y for shade in shades])
    highest = max(float(np.nanmax(one.y)) for one in curves)
    low = max(float(np.nanmin(bounds)) - 40.0, min(float(np.nanmin(one.y)) for one in curves) - 3.0)
    return min(low, float(np.nanmin(bounds)) - 6.0), max(highest, float(np.nanmax(bounds))) + 6.0


def _db(values: Array) -> Array:
    return np.asarray(20 * np.log10(np.maximum(values, 1e-12)), dtype=float)


def _unstable(loops: Loops) -> str:
    lost = [name for name, loop in loops.items() if not loop.stable]
    return f"not stable, so not shown: {', '.join(lost)}" if lost else ""


def _root_locus(loop: LinearLoop, opening: str) -> list[Curve]:
    A, B, C, D = loop.opened(opening)
    poles = []
    for factor in _FACTORS:
        closed = A - B @ C * (factor / (1 + factor * float(D[0, 0]))) if 1 + factor * float(D[0, 0]) else A
        z = np.linalg.eigvals(closed).astype(complex)
        poles.append(np.log(z[np.abs(z) > 1e-9]) / loop.dt)
    every, here = np.concatenate(poles), poles[_HERE]
    return [Curve(every.real, every.imag, "factor 0.05 to 20", 0, "dots"), Curve(here.real, here.imag, "1", 1, "poles")]


def _pole_panel(title: str, curves: Sequence[Curve]) -> Panel:
    x = np.concatenate([one.x for one in curves] or [np.zeros(1)])
    y = np.concatenate([one.y for one in curves] or [np.zeros(1)])
    size = np.hypot(x, y)
    near = size <= _FAST * max(float(np.median(size)), 1e-9)  # fast poles would hide the slow ones
    left = min(float(x[near].min(initial=-1e-3)) * 1.08, -1e-3)
    right = max(float(x[near].max(initial=0.0)), -0.06 * left)
    top = max(1.1 * float(np.abs(y[near]).max(initial=0.0)), -0.3 * left)
    note = "" if near.all() else f"{int((~near).sum())} faster poles are outside"
    return Panel(
        title, "real part [1/s]", "imaginary part [rad/s]", curves, limits=((left, right), (-top, top)), note=note
    )


def _region(view: LoopView, panel: Panel) -> list[tuple[Array, Array]]:
    # outlines of the parts of the s-plane outside of the region
    (left, right), (low, high) = (limits or (-1.0, 1.0) for limits in panel.limits)
    decay, damping, fastest = view.region or (0.0, 0.0, np.inf)
    far = 2 * max(-left, right, high)
    outlines = [(np.array([-decay, far, far, -decay]), np.array([low, low, high, high]) * 2)]
    if damping > 0:
        slope = np.sqrt(1 - min(damping, 0.999999) ** 2) / damping
        rise = np.array([0.0, far * slope, far * max(slope, 1.0)])
        outlines += [(np.array([0.0, -far, 0.0]), sign * rise) for sign in (1.0, -1.0)]
    if np.isfinite(fastest):
        angle = np.linspace(0, np.pi, 49)
        ring = np.concatenate([-fastest * np.sin(angle), [0, -far, -far, 0]])
        outlines.append((ring, np.concatenate([fastest * np.cos(angle), [-far, -far, far, far]])))
    return outlines


_TEMPLATES = Path(__file__).parent / "templates"
_LOCUS = 21  # values of a gain in its locus
_STEPS = 200  # positions of a slider

Request = Mapping[str, Any]


def page(bench: DesignBench, *, nonce: str, token: str) -> str:
    """Return the HTML of the page.

    Args:
        bench: the closed loop.
        nonce: value that allows the page's own script and no other.
        token: secret that the page sends with each request.
    """
    loop = bench.loop({one.name: one.value for one in bench.sliders}, bench.points[0])
    start, end = _default_step(loop)
    about = {
        "sliders": [_slider(one) for one in bench.sliders],
        "points": list(bench.points),
        "token": token,
        "goals": bool(bench.goals),
    }
    ends = [f"{kind}.{label}" for kind in ("measured", "command") for label in loop.names.of_kind(kind)]
    outer = [f"{kind}.{label}" for kind in ("reference", "disturbance") for label in loop.names.of_kind(kind)]
    return template("design.html").render(
        title=bench.title,
        style=(_TEMPLATES / "design.css").read_text(encoding="utf-8"),
        script=(_TEMPLATES / "design.js").read_text(encoding="utf-8"),
        nonce=nonce,
        data=json.dumps(about).replace("<", "\\u003c"),
        openings=loop.channels(),
        sources=[*outer, *ends],
        ends=ends,
        chosen=(start, end),
        gains=[one.name for one in bench.sliders],
        points=bench.points,
    )


def respond(bench: DesignBench, path: str, request: Request) -> dict[str, Any]:
    """Return what the page asks for: `linear`, `goals`, `details`, `run`, `slow`, `save` or `load`.

    Raises:
        InputError: the request is not one of these, or is not complete.
    """
    handlers = {"linear": _linear, "goals": _goals, "details": _details, "run": _run, "slow": _slow}
    try:
        if path == "save":
            return {"message": bench.save(_values(bench, request["values"]), str(request["file"]))}
        if path == "load":
            return {"values": bench.load(str(request["file"])), "message": f"loaded {request['file']}"}
        if path in handlers:
            return handlers[path](bench, request)
    except SurctlError as error:
        return {"error": str(error)}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"is not complete ({error})", key="request", value=path) from None
    raise InputError("is not known", key="request", value=path)


def _values(bench: DesignBench, values: Mapping[str, Any]) -> dict[str, float]:
    chosen = {one.name: float(values[one.name]) for one in bench.sliders}
    for name, value in chosen.items():
        if not np.isfinite(value):
            raise InputError("is not finite", key=name, value=value, remedy="give a number")
    return chosen


def _loops(bench: DesignBench, values: Mapping[str, float], points: Sequence[str]) -> dict[str, LinearLoop]:
    version = getattr(bench, "version", 0)
    return {point: _one_loop(bench, tuple(values.items()), point, version) for point in points}


@lru_cache(maxsize=64)
def _one_loop(bench: DesignBench, values: tuple[tuple[str, float], ...], point: str, version: int) -> LinearLoop:
    return bench.loop(dict(values), point)


def _both(bench: DesignBench, request: Request, points: Sequence[str] = ()) -> list[dict[str, LinearLoop] | None]:
    """Return the loops of the present gains, and of the compared ones if there are any."""
    chosen = points or request["points"] or bench.points[:1]
    for point in chosen:
        check_known(point, bench.points, "is not an operating point", key="points")
    sets = [request["values"], request.get("compared")]
    return [None if k and one is None else _loops(bench, _values(bench, one), chosen) for k, one in enumerate(sets)]


def _linear(bench: DesignBench, request: Request) -> dict[str, Any]:
    loops, compared = _both(bench, request)
    assert loops is not None
    panels = _loop_panels(loops, request["opening"], source=request["source"], end=request["end"], compared=compared)
    return {"html": "".join(map(panel_svg, panels)) + _command(bench, request, "loop")}


def _goals(bench: DesignBench, request: Request) -> dict[str, Any]:
    named = {p for goal in bench.goals for p in goal.points or bench.points}  # also those that are not drawn elsewhere
    every = tuple(point for point in bench.points if point in named)
    loops, compared = _both(bench, request, every)
    scores, others = (None if one is None else judge_loops(bench.goals, one) for one in (loops, compared))
    assert scores is not None
    worst = max((score.judgement.normalised for score in scores.scores), default=0.0)
    panels = _goal_panels(scores, compared=others)
    strip = _html("strip", [(panel.title.rpartition(" (")[0], panel.note, panel.mark) for panel in panels])
    return {"html": "".join(map(panel_svg, panels)), "worst": worst if np.isfinite(worst) else None, "strip": strip}


def _details(bench: DesignBench, request: Request) -> dict[str, Any]:
    loops, _ = _both(bench, request)
    assert loops is not None
    rows = []
    for point, loop in loops.items():
        for m in system_margins(loop, *loop.names.commands):
            cells = (point, m.name, _margin(m.gain_margin), _margin(m.phase_margin_deg), _margin(m.delay_margin_s),
                     _margin(m.disk_margin), _margin(m.crossover_rad_s))  # fmt: skip
            rows.append(cells if m.stable else (point, m.name, loop.stability.lower(), "", "", "", ""))
    name, values = request["locus"], _values(bench, request["values"])
    slider = {one.name: one for one in bench.sliders}[name]
    grid = _positions(slider, _LOCUS)
    point = next(iter(loops))
    swept = [bench.loop({**values, name: float(value)}, point) for value in grid]
    there = f"{grid[0]:.3g} to {grid[-1]:.3g}"
    locus = _locus_panel(f"Poles over {name}, {point}", swept, {"now": loops[point]}, there)
    return {"margins": _html("margins", rows), "locus": panel_svg(locus)}


def _run(bench: DesignBench, request: Request) -> dict[str, Any]:
    before = getattr(bench, "version", 0)
    view = bench.run(_values(bench, request["values"]), request["points"] or bench.points[:1])
    html = "".join(map(panel_svg, view.panels)) + _picture(view.picture) + _command(bench, request, "run")
    shown = [(name.removeprefix("goal ").removeprefix("cost "), text, mark) for _, text, name, mark in view.rows]
    table, strip = _html("figures", view.rows), _html("strip", shown)
    return {"table": table, "html": html, "strip": strip, "moved": getattr(bench, "version", 0) != before}


def _slow(bench: DesignBench, request: Request) -> dict[str, Any]:
    view = bench.decide(_values(bench, request["values"]))
    return {"html": _html("lines", view.lines) + _picture(view.picture) + _command(bench, request, "decision")}


def _html(part: str, *contents: object) -> str:
    return str(getattr(template("design_parts.html").module, part)(*contents))


def _command(bench: DesignBench, request: Request, view: View) -> str:
    return _html("command", bench.command(_values(bench, request["values"]), view))


def _slider(one: Slider) -> dict[str, Any]:
    positions = _positions(one, _STEPS + 1).tolist()
    nearest = int(np.argmin(np.abs(np.array(positions) - one.value)))
    positions[nearest] = one.value
    return {"name": one.name, "unit": one.unit, "meaning": one.meaning, "value": one.value, "positions": positions}


def _positions(one: Slider, count: int) -> Any:
    # on a logarithmic scale if the range is positive
    spaced = np.geomspace if one.low > 0 else np.linspace
    inner = [float(f"{value:.4g}") for value in spaced(one.low, one.high, count)[1:-1]]
    return np.array([one.low, *inner, one.high])


def _margin(value: float) -> str:
    return "none" if np.isinf(value) else f"{value:.3g}"


def _picture(picture: tuple[Figure, str] | None) -> str:
    if picture is None:
        return ""
    figure, text = picture
    data = base64.b64encode(png(figure, Software=getattr(figure, "maker", None))).decode()
    return _html("picture", text, data)
