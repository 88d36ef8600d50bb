"""Rows of the scenarios: arrival and collisions of every seed, the time against the paper's, and E_p of both series.

No verdict is written down: a row is as expected when every run arrived and none touched anything. A time that differs
is told with what was measured, and does not count against the row.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from surctl.reproduction.flights import Factors, Flights, scenario_names
from surctl.reproduction.row import Found, Item, agrees, differs
from surctl.reproduction.scenario_errata import PRINTED_HULL
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


def scenario_items(flights: Flights) -> list[Item]:
    """Every scenario with true positions and through the sonars."""
    return [
        Item(
            f"{name}{ending}",
            "scenarios",
            f"{flights.scenario(name).title}, {words}",
            flights.scenario(name).paper.result,
            None,
            partial(_flown, flights, name, sensing),
            f"surctl reproduce {name}{ending} --seeds {flights.seeds}",
        )
        for sensing, ending, words in _SENSINGS
        for name in scenario_names()
    ]


def hull_items(flights: Flights) -> list[Item]:
    """The pool with the hull of the paper's size, reported as it comes out: no way through is guaranteed (E15)."""
    return [
        Item(
            f"{name}-printed-hull",
            "scenarios",
            f"{flights.scenario(name).title}, true positions, by {PRINTED_HULL}",
            flights.scenario(name).paper.result,
            None,
            partial(_hull, flights, name),
            f"surctl reproduce {name}-printed-hull --seeds {flights.seeds}",
        )
        for name in scenario_names()
        if flights.scenario(name).vehicle != PRINTED_HULL
    ]


def limit_items(flights: Flights) -> list[Item]:
    """Which number of the vehicle decides how long the slowest scenario takes through the sonars."""
    scenario, name = flights.scenario(_LIMITED), f"{_LIMITED}-sonar-limit"
    return [
        Item(
            name,
            "scenarios",
            f"{scenario.title}, through the sonars: what decides the time",
            scenario.paper.result,
            None,
            partial(_limit, flights),
            f"surctl reproduce {name} --seeds {flights.seeds}",
        )
    ]


def position_items(flights: Flights) -> list[Item]:
    """E_p of the tank's scenarios together and of the pool's, by both ways of sensing."""
    items = []
    for series, where in _SERIES:
        names = [name for name in scenario_names() if name.startswith(series)]
        paper = flights.scenario(names[0]).paper
        for sensing, ending, words in _SENSINGS:
            name = f"position-error-{series}{ending}"
            items.append(
                Item(
                    name,
                    "position errors",
                    f"E_p of all {where} in the {series}, {words}",
                    f"VI-B: {paper.position_error_kind} {paper.position_error_m} m",
                    None,
                    partial(_position_error, flights, names, sensing),
                    f"surctl reproduce {name} --seeds {flights.seeds}",
                )
            )
    return items


def time_verdict(ours: float, paper: float, kind: str) -> tuple[bool, str]:
    """Whether a time [s] agrees with the paper's of that kind, and by how much it does not, in words."""
    off = ours / paper - 1
    if kind == "less than":
        return ours < paper, f"{ours:.2f} s is {100 * off:.1f} % above {paper:g} s"
    return abs(off) <= ABOUT, f"{ours:.2f} s is {100 * abs(off):.1f} % {'above' if off > 0 else 'below'} {paper:g} s"


def _flown(flights: Flights, name: str, sensing: Sensing) -> Found:
    flown, scenario = flights.batch(name, sensing), flights.scenario(name)
    times, collided = flights.arrived(name, sensing, "time_s"), int(flown.column("collided").sum())
    reached, runs = len(times), flown.runs
    told, lost = _ended(reached, collided, runs)
    error = _mean(flights.arrived(name, sensing, "path_error_m"))
    numbers = {"runs": float(runs), "reached": float(reached), "collided": float(collided), "path_error_m": error}
    numbers["min_clearance_m"] = float(flown.column("min_clearance_m").min())
    if reached:
        numbers |= {"time_s": float(times.mean()), "time_sd_s": float(times.std())}
        told += f", {times.mean():.2f} ± {times.std():.2f} s, E_p {error:.3f} m"
    if collided or reached < runs:
        return Found(told, "differs", lost, numbers, safe=False)
    paper = scenario.paper
    if paper.time_s is None:
        return Found(told, "agrees", numbers=numbers, safe=True)
    ours = _judged_time(flights, name, sensing)
    good, off = time_verdict(ours, paper.time_s, paper.time_kind)
    if good:
        return Found(told, "agrees", numbers=numbers, safe=True)
    length = float(flown.column("length_m").mean())
    straight = scenario.path.length
    why = (
        f"{off}: it flew {length:.2f} m at {length / times.mean():.3f} m/s on average; the path of {straight:.2f} m "
        f"takes {straight / scenario.cruise:.1f} s at the cruise speed of {scenario.cruise:g} m/s"
    )
    return Found(told, "differs", why, numbers, safe=True)


def _hull(flights: Flights, name: str) -> Found:
    """Decides nothing: `safe` is left open."""
    flown = flights.batch(name, "truth", PRINTED_HULL)
    reached, collided, runs = int(flown.column("reached").sum()), int(flown.column("collided").sum()), flown.runs
    told, lost = _ended(reached, collided, runs)
    numbers = {"runs": float(runs), "reached": float(reached), "collided": float(collided)}
    if reached == runs:
        return agrees(told, **numbers)
    least = float(flown.column("min_clearance_m").min())
    return differs(told, f"{lost}, least clearance {least:.3f} m", **numbers)


def _limit(flights: Flights) -> Found:
    """Decides nothing: `safe` is left open."""
    took = {
        what: _mean(flights.arrived(_LIMITED, "sonar", "time_s", factors))
        for what, factors in (("the vehicle as it is", ()), *_LIMITS)
    }
    usual, *changed = took
    best = min(changed, key=lambda what: np.nan_to_num(took[what], nan=np.inf))  # NaN: none arrived
    told = "; ".join(f"{what} {seconds:.1f} s" for what, seconds in took.items())
    return differs(
        told,
        f"of the vehicle's numbers one decides: with {best} it takes {took[usual] - took[best]:.1f} s less",
        **{f"{what.replace(' ', '_')}_s": seconds for what, seconds in took.items()},
    )


def _ended(reached: int, collided: int, runs: int) -> tuple[str, str]:
    """How many runs ended well, and how many did not, in words."""
    told = f"{reached} of {runs} arrived, {collided} collided"
    return told, f"{collided} of {runs} runs collided and {runs - reached - collided} did not arrive"


def _judged_time(flights: Flights, name: str, sensing: Sensing) -> float:
    """The time [s] that the paper's figure is about: a mean, that of a series, or the longest of every run."""
    paper = flights.scenario(name).paper
    if paper.time_of == "series":
        return float(flights.arrived(name, sensing, "time_s").max())
    if paper.time_of == "run":
        return float(flights.arrived(name, sensing, "time_s").mean())
    series = [other for other in scenario_names() if flights.scenario(other).paper == paper]
    return _mean([flights.arrived(other, sensing, "time_s").mean() for other in series])


def _position_error(flights: Flights, names: Sequence[str], sensing: Sensing) -> Found:
    paper = flights.scenario(names[0]).paper
    runs = {name: flights.arrived(name, sensing, "path_error_m") for name in names}
    kept = {name: errors[np.isfinite(errors)] for name, errors in runs.items() if np.isfinite(errors).any()}
    if not kept:
        return differs("nothing", "no run arrived with a part of its way outside avoidance")
    each = {name: float(errors.mean()) for name, errors in kept.items()}
    most = max(kept, key=lambda name: float(kept[name].max()))
    ours, largest = _mean(list(each.values())), float(kept[most].max())
    told = f"{ours:.4f} m on average, at most {largest:.4f} m ({most})"
    numbers = {"path_error_m": ours, "largest_m": largest, **each}
    judged = largest if paper.position_error_of == "series" else ours  # of every run, or of the mean
    bound = (paper.position_error_m or np.inf) * (1 + ABOUT if paper.position_error_kind == "about" else 1)
    if judged < bound:
        return agrees(told, **numbers)
    above = [name for name in kept if float(kept[name].max()) >= bound]
    return differs(told, f"above {bound:.3g} m in {', '.join(above)}", **numbers)


def _mean(values: Sequence[float] | np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    """Mean of the values that are numbers; NaN if none is."""
    array = np.asarray(values, dtype=float)
    kept = array[np.isfinite(array)]
    return float(kept.mean()) if kept.size else float("nan")
