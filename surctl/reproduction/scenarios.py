"""Rows of the scenarios: arrival and collisions of every seed, the time against the paper's, and E_p of both series.

No verdict is written down: a row is as expected when every run arrived and none touched anything. A time that differs
is told with what was measured, and does not count against the row.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from surctl.reproduction.row import Item, Result, agrees, differs
from surctl.reproduction.scenario_errata import PRINTED_HULL
from surctl.reproduction.simulations import Factors, Simulations, scenario_names
from surctl.simulation import Sensing

__all__ = ["ABOUT", "hull_items", "limit_items", "position_items", "scenario_items", "time_verdict"]

ABOUT = 0.08
"""Share by which a figure that the paper gives as "about" may be off."""

_SENSINGS: tuple[tuple[Sensing, str, str], ...] = (
    ("truth", "", "true positions"),
    ("sonar", "-sonar", "through the sonars"),
)
_SERIES = (("tank", "simulation"), ("pool", "experiments"))

_LIMITED = "pool-static"
_LIMITS: tuple[tuple[str, Factors], ...] = (
    ("a hull of 0.7 its radius", (("radius", 0.7),)),
    ("twice the thrust", (("Fu_max", 2.0), ("Fv_max", 2.0))),
    ("half the mass", (("m11", 0.5), ("m22", 0.5))),
    ("half the drag", (("Xu", 0.5), ("Yv", 0.5), ("Xuu", 0.5), ("Yvv", 0.5))),
)


def scenario_items(simulations: Simulations) -> list[Item]:
    """Every scenario with true positions and through the sonars."""
    return [
        Item(
            f"{name}{ending}",
            "scenarios",
            f"{simulations.scenario(name).title}, {words}",
            simulations.scenario(name).paper.result,
            None,
            partial(_arrivals, simulations, name, sensing),
            f"surctl reproduce {name}{ending} --seeds {simulations.seeds}",
        )
        for sensing, ending, words in _SENSINGS
        for name in scenario_names()
    ]


def hull_items(simulations: Simulations) -> list[Item]:
    """The pool with the hull of the paper's size, reported as it comes out: no way through is guaranteed (E15)."""
    return [
        Item(
            f"{name}-printed-hull",
            "scenarios",
            f"{simulations.scenario(name).title}, true positions, by {PRINTED_HULL}",
            simulations.scenario(name).paper.result,
            None,
            partial(_hull, simulations, name),
            f"surctl reproduce {name}-printed-hull --seeds {simulations.seeds}",
        )
        for name in scenario_names()
        if simulations.scenario(name).vehicle != PRINTED_HULL
    ]


def limit_items(simulations: Simulations) -> list[Item]:
    """Which number of the vehicle decides how long the slowest scenario takes through the sonars."""
    scenario, name = simulations.scenario(_LIMITED), f"{_LIMITED}-sonar-limit"
    return [
        Item(
            name,
            "scenarios",
            f"{scenario.title}, through the sonars: what decides the time",
            scenario.paper.result,
            None,
            partial(_limit, simulations),
            f"surctl reproduce {name} --seeds {simulations.seeds}",
        )
    ]


def position_items(simulations: Simulations) -> list[Item]:
    """E_p of the tank's scenarios together and of the pool's, by both ways of sensing."""
    items = []
    for series, where in _SERIES:
        names = [name for name in scenario_names() if name.startswith(series)]
        paper = simulations.scenario(names[0]).paper
        for sensing, ending, words in _SENSINGS:
            name = f"position-error-{series}{ending}"
            items.append(
                Item(
                    name,
                    "position errors",
                    f"E_p of all {where} in the {series}, {words}",
                    f"VI-B: {paper.position_error_kind} {paper.position_error_m} m",
                    None,
                    partial(_position_error, simulations, names, sensing),
                    f"surctl reproduce {name} --seeds {simulations.seeds}",
                )
            )
    return items


def time_verdict(ours: float, paper: float, kind: str) -> tuple[bool, str]:
    """Whether a time [s] agrees with the paper's of that kind, and by how much it does not, in words."""
    off = ours / paper - 1
    if kind == "less than":
        return ours < paper, f"{ours:.2f} s is {100 * off:.1f} % above {paper:g} s"
    return abs(off) <= ABOUT, f"{ours:.2f} s is {100 * abs(off):.1f} % {'above' if off > 0 else 'below'} {paper:g} s"


def _arrivals(simulations: Simulations, name: str, sensing: Sensing) -> Result:
    batch, scenario = simulations.batch(name, sensing), simulations.scenario(name)
    times, collided = simulations.arrived(name, sensing, "time_s"), int(batch.column("collided").sum())
    reached, runs = len(times), batch.runs
    text, lost = _ended(reached, collided, runs)
    error = _mean(simulations.arrived(name, sensing, "path_error_m"))
    numbers = {"runs": float(runs), "reached": float(reached), "collided": float(collided), "path_error_m": error}
    numbers["min_clearance_m"] = float(batch.column("min_clearance_m").min())
    if reached:
        numbers |= {"time_s": float(times.mean()), "time_sd_s": float(times.std())}
        text += f", {times.mean():.2f} ± {times.std():.2f} s, E_p {error:.3f} m"
    if collided or reached < runs:
        return Result(text, "differs", lost, numbers, safe=False)
    paper = scenario.paper
    if paper.time_s is None:
        return Result(text, "agrees", numbers=numbers, safe=True)
    ours = _judged_time(simulations, name, sensing)
    good, off = time_verdict(ours, paper.time_s, paper.time_kind)
    if good:
        return Result(text, "agrees", numbers=numbers, safe=True)
    length = float(batch.column("length_m").mean())
    straight = scenario.path.length
    why = (
        f"{off}: it flew {length:.2f} m at {length / times.mean():.3f} m/s on average; the path of {straight:.2f} m "
        f"takes {straight / scenario.cruise:.1f} s at the cruise speed of {scenario.cruise:g} m/s"
    )
    return Result(text, "differs", why, numbers, safe=True)


def _hull(simulations: Simulations, name: str) -> Result:
    """Decides nothing: `safe` is left open."""
    batch = simulations.batch(name, "truth", PRINTED_HULL)
    reached, collided, runs = int(batch.column("reached").sum()), int(batch.column("collided").sum()), batch.runs
    text, lost = _ended(reached, collided, runs)
    numbers = {"runs": float(runs), "reached": float(reached), "collided": float(collided)}
    if reached == runs:
        return agrees(text, **numbers)
    least = float(batch.column("min_clearance_m").min())
    return differs(text, f"{lost}, least clearance {least:.3f} m", **numbers)


def _limit(simulations: Simulations) -> Result:
    """Decides nothing: `safe` is left open."""
    took = {
        what: _mean(simulations.arrived(_LIMITED, "sonar", "time_s", factors))
        for what, factors in (("the vehicle as it is", ()), *_LIMITS)
    }
    usual, *changed = took
    best = min(changed, key=lambda what: np.nan_to_num(took[what], nan=np.inf))  # NaN: none arrived
    text = "; ".join(f"{what} {seconds:.1f} s" for what, seconds in took.items())
    return differs(
        text,
        f"of the vehicle's numbers one decides: with {best} it takes {took[usual] - took[best]:.1f} s less",
        **{f"{what.replace(' ', '_')}_s": seconds for what, seconds in took.items()},
    )


def _ended(reached: int, collided: int, runs: int) -> tuple[str, str]:
    """How many runs ended well, and how many did not, in words."""
    text = f"{reached} of {runs} arrived, {collided} collided"
    return text, f"{collided} of {runs} runs collided and {runs - reached - collided} did not arrive"


def _judged_time(simulations: Simulations, name: str, sensing: Sensing) -> float:
    """The time [s] that the paper's figure is about: a mean, that of a series, or the longest of every run."""
    paper = simulations.scenario(name).paper
    if paper.time_of == "series":
        return float(simulations.arrived(name, sensing, "time_s").max())
    if paper.time_of == "run":
        return float(simulations.arrived(name, sensing, "time_s").mean())
    series = [other for other in scenario_names() if simulations.scenario(other).paper == paper]
    return _mean([simulations.arrived(other, sensing, "time_s").mean() for other in series])


def _position_error(simulations: Simulations, names: Sequence[str], sensing: Sensing) -> Result:
    paper = simulations.scenario(names[0]).paper
    runs = {name: simulations.arrived(name, sensing, "path_error_m") for name in names}
    finite = {name: errors[np.isfinite(errors)] for name, errors in runs.items() if np.isfinite(errors).any()}
    if not finite:
        return differs("nothing", "no run arrived with a part of its way outside avoidance")
    each = {name: float(errors.mean()) for name, errors in finite.items()}
    most = max(finite, key=lambda name: float(finite[name].max()))
    ours, largest = _mean(list(each.values())), float(finite[most].max())
    text = f"{ours:.4f} m on average, at most {largest:.4f} m ({most})"
    numbers = {"path_error_m": ours, "largest_m": largest, **each}
    judged = largest if paper.position_error_of == "series" else ours  # of every run, or of the mean
    bound = (paper.position_error_m or np.inf) * (1 + ABOUT if paper.position_error_kind == "about" else 1)
    if judged < bound:
        return agrees(text, **numbers)
    above = [name for name in finite if float(finite[name].max()) >= bound]
    return differs(text, f"above {bound:.3g} m in {', '.join(above)}", **numbers)


def _mean(values: Sequence[float] | np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    """Mean of the values that are numbers; NaN if none is."""
    array = np.asarray(values, dtype=float)
    finite = array[np.isfinite(array)]
    return float(finite.mean()) if finite.size else float("nan")
