"""HTML parts of the design page, computed for a request of the page."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from surctl.errors import InputError, SurctlError, nearest
from surctl.report.design_bench import DesignBench, Slider, View
from surctl.report.loop_views import default_step, goal_panels, locus_panel, loop_panels
from surctl.report.panel import panel_svg
from surctl.report.theme import png
from surctl.system import LinearLoop
from surctl.tuning.loop_scores import judge_loops
from surctl.verification.sampled_margins import quick_margins

__all__ = ["page", "respond"]

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
    loop = first_loop(bench)
    start, end = default_step(loop)
    about = {
        "sliders": [_slider(one) for one in bench.sliders],
        "points": list(bench.points),
        "token": token,
        "goals": bool(bench.goals),
    }
    names = loop.names
    sources = [*(f"reference.{n}" for n in names.references), *(f"disturbance.{n}" for n in names.disturbances),
               *(f"measured.{n}" for n in names.outputs), *(f"command.{n}" for n in names.commands)]  # fmt: skip
    ends = [*(f"measured.{n}" for n in names.outputs), *(f"command.{n}" for n in names.commands)]
    parts = {
        "title": escape(bench.title),
        "style": (_TEMPLATES / "design.css").read_text(encoding="utf-8"),
        "script": (_TEMPLATES / "design.js").read_text(encoding="utf-8"),
        "nonce": nonce,
        "data": json.dumps(about).replace("<", "\\u003c"),
        "openings": _options(loop.channels()),
        "sources": _options(sources, start),
        "ends": _options(ends, end),
        "gains": _options([one.name for one in bench.sliders]),
        "points": "".join(
            f'<label class="check"><input type="checkbox" name="point" value="{escape(p, quote=True)}"'
            f"{' checked' if k < 3 else ''}> {escape(p)}</label>"
            for k, p in enumerate(bench.points)
        ),
    }
    text = (_TEMPLATES / "design.html").read_text(encoding="utf-8")
    for name, value in parts.items():
        text = text.replace(f"@{name}@", value)
    return text


def first_loop(bench: DesignBench) -> LinearLoop:
    """Return the loop at the first operating point with the initial gains."""
    return bench.loop({one.name: one.value for one in bench.sliders}, bench.points[0])


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
        if point not in bench.points:
            raise InputError(
                "is not an operating point", key="points", value=point, remedy=nearest(str(point), bench.points)
            )
    sets = [request["values"], request.get("compared")]
    return [None if k and one is None else _loops(bench, _values(bench, one), chosen) for k, one in enumerate(sets)]


def _linear(bench: DesignBench, request: Request) -> dict[str, Any]:
    loops, compared = _both(bench, request)
    assert loops is not None
    panels = loop_panels(loops, request["opening"], source=request["source"], end=request["end"], compared=compared)
    return {"html": "".join(map(panel_svg, panels)) + _command(bench, request, "loop")}


def _goals(bench: DesignBench, request: Request) -> dict[str, Any]:
    named = {p for goal in bench.goals for p in goal.points or bench.points}  # also those that are not drawn elsewhere
    every = tuple(point for point in bench.points if point in named)
    loops, compared = _both(bench, request, every)
    scores, others = (None if one is None else judge_loops(bench.goals, one) for one in (loops, compared))
    assert scores is not None
    worst = max((score.judgement.normalised for score in scores.scores), default=0.0)
    panels = "".join(map(panel_svg, goal_panels(scores, compared=others)))
    return {"html": panels, "worst": _number(worst)}


def _details(bench: DesignBench, request: Request) -> dict[str, Any]:
    loops, _ = _both(bench, request)
    assert loops is not None
    rows = []
    for point, loop in loops.items():
        for m in quick_margins(loop, *loop.names.commands):
            cells = (point, m.name, _margin(m.gain_margin), _margin(m.phase_margin_deg), _margin(m.delay_margin_s),
                     _margin(m.disk_margin), _margin(m.crossover_rad_s))  # fmt: skip
            rows.append(cells if m.stable else (point, m.name, "unstable", "", "", "", ""))
    head = (
        "operating point",
        "opened at",
        "gain margin",
        "phase [deg]",
        "delay [s]",
        "disk margin of this loop alone",
        "crossover [rad/s]",
    )
    name, values = request["locus"], _values(bench, request["values"])
    slider = {one.name: one for one in bench.sliders}[name]
    grid = _positions(slider, _LOCUS)
    point = next(iter(loops))
    swept = [bench.loop({**values, name: float(value)}, point) for value in grid]
    locus = locus_panel(f"Poles over {name}, {point}", grid, swept, loops[point])
    return {"margins": _table(head, rows), "locus": panel_svg(locus)}


def _run(bench: DesignBench, request: Request) -> dict[str, Any]:
    before = getattr(bench, "version", 0)
    view = bench.run(_values(bench, request["values"]), request["points"] or bench.points[:1])
    cells = "".join(
        f'<tr><td>{escape(label)}</td><td><span id="{escape(name, quote=True)}" class="{mark}">{escape(text)}</span>'
        "</td></tr>"
        for label, text, name, mark in view.rows
    )
    table = (
        '<div class="scroll" tabindex="0" role="region" aria-label="Figures of the run"><table>'
        f'<thead><tr><th scope="col">figure</th><th scope="col">value</th></tr></thead><tbody>{cells}</tbody>'
        "</table></div>"
    )
    html = "".join(map(panel_svg, view.panels)) + _picture(view.picture) + _command(bench, request, "run")
    return {"table": table, "html": html, "moved": getattr(bench, "version", 0) != before}


def _slow(bench: DesignBench, request: Request) -> dict[str, Any]:
    view = bench.decide(_values(bench, request["values"]))
    lines = "".join(f'<li class="{mark}">{escape(text)}</li>' for text, mark in view.lines)
    return {"html": f'<ul class="lines">{lines}</ul>{_picture(view.picture)}{_command(bench, request, "decision")}'}


def _command(bench: DesignBench, request: Request, view: View) -> str:
    words = bench.command(_values(bench, request["values"]), view)
    first = " (after the gains are saved in gains.toml)" if "gains.toml" in words else ""
    return f'<p class="note command">On the command line{first}: <code>{escape(words)}</code></p>'


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


def _options(names: Sequence[str], chosen: str = "") -> str:
    return "".join(f"<option{' selected' if name == chosen else ''}>{escape(name)}</option>" for name in names)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    top = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    return (
        '<div class="scroll" tabindex="0" role="region" aria-label="Margins"><table>'
        f"<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _margin(value: float) -> str:
    return "none" if np.isinf(value) else f"{value:.3g}"


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _picture(picture: tuple[Figure, str] | None) -> str:
    if picture is None:
        return ""
    figure, text = picture
    data = base64.b64encode(png(figure, Software=getattr(figure, "maker", None))).decode()
    said = escape(text, quote=True)
    return f'<figure class="panel wide"><img alt="{said}" src="data:image/png;base64,{data}"></figure>'
