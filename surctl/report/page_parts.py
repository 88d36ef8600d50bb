"""HTML parts of the tuning page: metrics, goals, verdicts and pictures, legible in light and dark themes."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from io import BytesIO

import numpy as np
from matplotlib.figure import Figure

from surctl.errors import SurctlError
from surctl.report.bench import Bench
from surctl.simulation import METRICS, Run
from surctl.tuning import Evaluation
from surctl.verification import LINEAR_METRICS, Inapplicable, OverSpeeds, Verdict

__all__ = [
    "LINEAR",
    "attempt",
    "figures",
    "goals",
    "head",
    "message",
    "pair",
    "picture",
    "run_text",
    "sliders",
    "speeds",
    "verdicts",
]

_STYLE = """<style>
.sur{overflow-x:auto;max-width:100%} .sur table{border-collapse:collapse;font-size:.9rem}
.sur td,.sur th{padding:.2rem .7rem .2rem 0;text-align:left;vertical-align:top}
.picture{max-width:min(100%,44rem);height:auto;background:#fff;border-radius:6px}
.one{font-size:1.7rem;font-weight:700;margin:0} .two{font-size:1.15rem;font-weight:700;margin:.6rem 0 .3rem}
.sliders{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(22rem,100%),1fr));gap:.6rem 2rem}
.pair>div{flex:1 1 20rem;min-width:0} .pair{display:flex;flex-wrap:wrap;gap:1rem}
.good{color:light-dark(#00664f,#5fd3b4)} .bad{color:light-dark(#a3201a,#ff9a92)} .none{color:light-dark(#555,#bbb)}
.good,.bad{font-weight:600} .line{overflow-wrap:anywhere}
:root{color-scheme:light} .dark{color-scheme:dark}
</style>"""
_RUN_FIGURES = ("time_s", "min_clearance_m", "deviation_m", "effort_n")
LINEAR = ("gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin", "slowest_pole_per_s",
           "settling_time_s.surge_speed", "overshoot.surge_speed")  # fmt: skip

BY_SPEED = (*LINEAR, "sensitivity_peak", "settling_time_s.cross_track")


def head(bench: Bench) -> str:
    """Return HTML with the title, and one line with the tuned vehicle, the scenario and the gains."""
    what = f"{bench.vehicle.name} in {bench.scenario.name}, true positions, seed 0, gains from {bench.gains.name}"
    return f'{_STYLE}<h1 class="one">Tune</h1><p class="line">{escape(what)}</p>'


def message(text: str) -> str:
    """Return an HTML line about the effect of a button; errors are coloured, and screen readers read the line aloud."""
    mark = "bad" if text.startswith("error:") else "good"
    return f'<p role="status" id="message" class="line {mark}">{escape(" ".join(text.split()))}</p>'


def attempt(make: Callable[[], str]) -> str:
    """Return the result of `make`, or one line that says why `make` fails with the present gains."""
    try:
        return make()
    except SurctlError as error:
        return f'<p class="line bad">{escape(str(error))}</p>'


def picture(figure: object, text: str) -> str:
    """Return a figure as an HTML image with its alternative text."""
    assert isinstance(figure, Figure)
    buffer = BytesIO()
    figure.savefig(buffer, format="png")
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<img class="picture" alt="{escape(text, quote=True)}" src="data:image/png;base64,{data}">'


def run_text(run: Run) -> str:
    """Describe the plan view of a run in words, for screen readers."""
    m = run.metrics
    return f"Trajectory in {run.scenario.name}: {m.stopped_because} at {m.time_s:.2f} s"


def sliders(shown: Iterable[object]) -> str:
    """Arrange the sliders in as many columns as fit the width of the page."""
    return '<h2 class="two">Gains</h2><div class="sliders">' + "".join(f"<div>{s}</div>" for s in shown) + "</div>"


def pair(*parts: str) -> str:
    """Arrange HTML parts side by side, or one below the other on a narrow page."""
    return '<div class="pair">' + "".join(f"<div>{part}</div>" for part in parts) + "</div>"


def _heading(text: str) -> str:
    return f'<h2 class="two">{escape(text)}</h2>'


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    cells = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    top = "".join(f'<th scope="col">{escape(h)}</th>' for h in head)
    return f'<div class="sur"><table><thead><tr>{top}</tr></thead><tbody>{cells}</tbody></table></div>'


def _number(name: str, value: float, unit: str) -> str:
    shown = f"{value:.4g}" if np.isfinite(value) else ("none" if np.isnan(value) else "unlimited")
    unit = "" if unit == "1" else f" {unit}"
    return f'<span id="{escape(name)}" data-value="{float(value)!r}">{shown}{unit}</span>'


def figures(run: Run, linear: Mapping[str, float]) -> str:
    """Return an HTML table with the metrics of the run and the least margins."""
    m = run.metrics
    mark = "good" if m.reached else "bad"
    rows = [("how the run ended", f'<span id="outcome" class="{mark}">{escape(m.stopped_because)}</span>')]
    shown = [(name, METRICS[name], float(getattr(m, name))) for name in _RUN_FIGURES]
    shown += [(name, LINEAR_METRICS[name], linear[name]) for name in LINEAR]
    rows += [(escape(spec.meaning), _number(name, value, spec.unit)) for name, spec, value in shown]
    return _heading("This run, and the loops") + _table(("figure", "value"), rows)


def speeds(table: OverSpeeds) -> str:
    """Return a table of linear metrics at each cruise speed, with each metric's worst speed; "" for one speed."""
    if len(table.cruise) < 2:
        return ""
    rows = []
    for name, values in table.figures.items():
        spec = LINEAR_METRICS[name]
        cells = [_number(f"{name} at {u:g}", v, spec.unit) for u, v in zip(table.cruise, values.tolist(), strict=True)]
        rows.append((escape(spec.meaning), *cells, table.worst_at(name)))
    return _heading("The loops by cruise speed") + _table(
        ("figure", *(f"{u:g} m/s" for u in table.cruise), "worst at"), rows
    )


def goals(evaluation: Evaluation) -> str:
    """Return an HTML table of goals: whether each goal is met, and its metric for the worst plant and cruise speed."""
    rows = []
    shown = zip(evaluation.goals, evaluation.figure[0], evaluation.normalised[0], evaluation.speed[0], strict=True)
    for goal, figure, share, speed in shown:
        met = share <= 1
        word = f'<span class="{"good" if met else "bad"}">{"met" if met else "missed"}</span>'
        bound = f"{goal.sense} {goal.limit:g}" + ("" if goal.unit == "1" else f" {goal.unit}")
        bound += f", worst at {speed:g} m/s" if goal.cruise else ""
        rows.append((escape(goal.name), goal.kind, word, _number(f"goal {goal.name}", figure, goal.unit), bound))
    text = (
        "<p>Checked in this scenario with the nominal plant and, if a goal includes them, the corners of the vehicle's "
        "ranges.</p>"
    )
    return _heading("Goals") + text + _table(("goal", "kind", "status", "figure", "bound"), rows)


def verdicts(results: Sequence[Verdict | Inapplicable] | None) -> str:
    """Return a table of claims and verdicts; `results` is None until the user requests verdicts for these gains."""
    title = _heading("Claims")
    if results is None:
        return title + '<p id="verdicts">Not checked for these gains: press the button (about ten seconds).</p>'
    marks = {"proved": "good", "refuted": "bad"}
    rows = [
        (escape(v.claim), f'<span class="none">{escape(v.sentence)}</span>')
        if isinstance(v, Inapplicable)
        else (escape(v.claim.name), f'<span class="{marks.get(v.verdict, "none")}">{escape(v.verdict)}</span>')
        for v in results
    ]
    return title + '<div id="verdicts">' + _table(("claim", "verdict"), rows) + "</div>"
