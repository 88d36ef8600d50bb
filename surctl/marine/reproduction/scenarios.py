"""Compare arrivals and times of each scenario, and position errors, with the paper; `--webots`, `--independent`.

These comparisons have no expected verdict: the result is as expected if every run arrived and none collided. A time
that differs from the paper is reported, but it does not make the comparison fail.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from surctl.errors import InputError
from surctl.marine.control import Gains, load_gains
from surctl.marine.reproduction.errata import PRINTED_HULL, Vector
from surctl.marine.reproduction.row import Item, Result, agrees, differs
from surctl.marine.simulation import BatchResult, Case, Run, Scenario, Sensing, load_scenario, simulate, simulate_batch
from surctl.marine.simulation.scenario import LIBRARY
from surctl.marine.vehicle import load_vehicle

Factors = tuple[tuple[str, float], ...]
"""Names of vehicle parameters, and the factor for each."""

_TILTING = {"sur400": "sur400-tilting", "sur540-flooded": "sur540-tilting"}
"""The vehicles of the scenarios with stated centres of gravity, buoyancy and thrust."""


def scenario_names() -> list[str]:
    """Return the names of the scenarios in the library."""
    return sorted(path.stem for path in LIBRARY.glob("*.toml"))


@dataclass(frozen=True)
class Simulations:
    """Simulations of the library's scenarios with the given gains; stored results are used again.

    Attributes:
        seeds: number of seeds (0, 1, …) that the compiled loop simulates, at least 1.
        independent: whether each scenario is simulated in MuJoCo, too.
        webots: whether each scenario with sonars is simulated with echoes as in the paper's simulator, too.
    """

    seeds: int = 20
    threads: int = 2
    gains: Gains = field(default_factory=lambda: load_gains("default"), repr=False)
    independent: bool = False
    webots: bool = False
    _batches: dict[tuple[str, Sensing, str, Factors], BatchResult] = field(
        default_factory=dict, repr=False, compare=False
    )
    _runs: dict[tuple[str, Sensing], Run] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.seeds < 1:
            raise InputError("must be at least 1", key="seeds", value=self.seeds)

    def scenario(self, name: str) -> Scenario:
        """Return the library's scenario with the given name, with level sonars and no assumption about the floor."""
        scenario = load_scenario(name)
        equipment = scenario.sensors.equipment
        equipment = replace(equipment, array=replace(equipment.array, pitch=0.0), floor=None)
        return replace(scenario, sensors=replace(scenario.sensors, equipment=equipment))

    def batch(self, name: str, sensing: Sensing, vehicle: str = "", factors: Factors = ()) -> BatchResult:
        """Return the metrics of the runs with all seeds; `vehicle` names another vehicle than the scenario's.

        The parameters of the vehicle are multiplied by `factors`.
        """
        key = (name, sensing, vehicle, factors)
        if key not in self._batches:
            scenario = self.scenario(name)
            robot = load_vehicle(vehicle or scenario.vehicle)
            robot = robot.with_values({number: factor * robot[number] for number, factor in factors})
            case = Case(scenario, robot, self.gains, sensing=sensing)
            self._batches[key] = simulate_batch(case, seeds=np.arange(self.seeds), threads=self.threads)
        return self._batches[key]

    def in_webots(self, name: str) -> BatchResult:
        """Return the metrics of the runs by sonar where surfaces answer within 22.5° of their normal, as in Webots."""
        scenario = self.scenario(name)
        scenario = replace(scenario, sensors=scenario.sensors.hearing("webots"))
        case = Case(scenario, load_vehicle(scenario.vehicle), self.gains, sensing="sonar")
        return simulate_batch(case, seeds=np.arange(self.seeds), threads=self.threads)

    def run(self, name: str, sensing: Sensing = "truth") -> Run:
        """Return the single run with seed 0, including the recorded signals."""
        key = (name, sensing)
        if key not in self._runs:
            scenario = self.scenario(name)
            vehicle = load_vehicle(scenario.vehicle)
            self._runs[key] = simulate(scenario, vehicle, gains=self.gains, sensing=sensing)
        return self._runs[key]

    def in_engine(self, name: str, sensing: Sensing) -> Run:
        """Return the run with seed 0 in MuJoCo, with six degrees of freedom if the library states the centres."""
        from surctl.marine.engine import mujoco_physics

        scenario = self.scenario(name)
        vehicle = load_vehicle(_TILTING.get(scenario.vehicle, scenario.vehicle))
        return simulate(scenario, vehicle, gains=self.gains, sensing=sensing, physics=mujoco_physics())

    def arrived(self, name: str, sensing: Sensing, metric: str, factors: Factors = ()) -> Vector:
        """Return the values (k,) of a metric for the k runs that arrived."""
        batch = self.batch(name, sensing, factors=factors)
        values: Vector = batch.column(metric)[batch.column("reached") > 0.5]
        return values

    def item(
        self,
        name: str,
        what: str,
        compute: Callable[[], Result],
        options: tuple[str, ...] = (),
        *,
        paper: str,
        group: str = "scenarios",
    ) -> Item:
        """Return a comparison that needs the runs with all seeds; `options` are those that add a result."""
        also = "".join(f" --{option}" for option in options if getattr(self, option))
        command = f"surctl reproduce {name} --seeds {self.seeds}{also}"
        return Item(name, group, what, paper, None, compute, command, options)


ABOUT = 0.08
"""Largest relative difference at which a number still agrees with the paper's "about"."""

_SENSINGS: tuple[tuple[Sensing, str, str], ...] = (
    ("truth", "", "true positions"),
    ("sonar", "-sonar", "with sonar perception"),
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
    """Return two comparisons for each scenario: with true positions, and with sonar perception."""
    items = []
    for sensing, ending, words in _SENSINGS:
        options = ("independent", "webots")[: 2 if sensing == "sonar" else 1]
        for scenario in map(simulations.scenario, scenario_names()):
            what, compute = f"{scenario.title}, {words}", partial(_arrivals, simulations, scenario.name, sensing)
            items.append(
                simulations.item(f"{scenario.name}{ending}", what, compute, options, paper=scenario.paper.result)
            )
    return items


def hull_items(simulations: Simulations) -> list[Item]:
    """Return comparisons for the pool and a hull of the printed size.

    Any result is valid, because no path is guaranteed for this hull (E15).
    """
    items = []
    for scenario in map(simulations.scenario, scenario_names()):
        what, compute = (
            f"{scenario.title}, true positions, vehicle {PRINTED_HULL}",
            partial(_hull, simulations, scenario.name),
        )
        if scenario.vehicle != PRINTED_HULL:
            name = f"{scenario.name}-printed-hull"
            items.append(simulations.item(name, what, compute, paper=scenario.paper.result))
    return items


def limit_items(simulations: Simulations) -> list[Item]:
    """Return the comparison that shows which vehicle parameter limits the travel time of the slowest scenario."""
    scenario, compute = simulations.scenario(_LIMITED), partial(_limit, simulations)
    what = f"{scenario.title}, with sonar perception: the vehicle parameter that limits the time"
    return [simulations.item(f"{_LIMITED}-sonar-limit", what, compute, paper=scenario.paper.result)]


def position_items(simulations: Simulations) -> list[Item]:
    """Return the comparisons of the position error E_p, for tank and pool scenarios and both kinds of sensing."""
    items = []
    for series, where in _SERIES:
        names = [name for name in scenario_names() if name.startswith(series)]
        paper = simulations.scenario(names[0]).paper
        printed = f"VI-B: {paper.position_error_kind} {paper.position_error_m} m"
        for sensing, ending, words in _SENSINGS:
            name, what = f"position-error-{series}{ending}", f"E_p of all {where} in the {series}, {words}"
            compute = partial(_position_error, simulations, names, sensing)
            items.append(simulations.item(name, what, compute, paper=printed, group="position errors"))
    return items


def time_verdict(ours: float, paper: float, kind: str) -> tuple[bool, str]:
    """Return whether a time [s] agrees with the paper's time, and a text that states the difference.

    `kind` states whether the paper's time is approximate or an upper limit.
    """
    off = ours / paper - 1
    if kind == "less than":
        return ours < paper, f"{ours:.2f} s is {100 * off:.1f} % above {paper:g} s"
    return abs(off) <= ABOUT, f"{ours:.2f} s is {100 * abs(off):.1f} % {'above' if off > 0 else 'below'} {paper:g} s"


def _arrivals(simulations: Simulations, name: str, sensing: Sensing) -> Result:
    result = _simulated(simulations, name, sensing)
    if simulations.webots and sensing == "sonar":
        batch = simulations.in_webots(name)
        times, runs = batch.column("time_s")[batch.column("reached") > 0.5], batch.runs
        text, _ = _ended(len(times), int(batch.column("collided").sum()), runs)
        text += f", {times.mean():.2f} ± {times.std():.2f} s" if len(times) else ""
        result = replace(result, webots=text, safe=result.safe is not False and len(times) == runs)
    if not simulations.independent:
        return result
    run = simulations.in_engine(name, sensing)
    m = run.metrics
    text = f"{run.plant}, seed 0: {m.stopped_because} at {m.time_s:.2f} s, clearance {m.min_clearance_m:.3f} m"
    contacts = f", contact with {', '.join(one.what for one in run.contacts)}" if run.contacts else ""
    safe = m.reached and m.min_clearance_m > 0 and not run.contacts
    return replace(
        result, independent=f"{text}, E_p {m.path_error_m:.3f} m{contacts}", safe=result.safe is not False and safe
    )


def _simulated(simulations: Simulations, name: str, sensing: Sensing) -> Result:
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
        f"{off}: the robot moved {length:.2f} m at {length / times.mean():.3f} m/s on average; the reference path of "
        f"{straight:.2f} m takes {straight / scenario.cruise:.1f} s at the cruise speed of {scenario.cruise:g} m/s"
    )
    return Result(text, "differs", why, numbers, safe=True)


def _hull(simulations: Simulations, name: str) -> Result:
    # `safe` is None, so the comparison cannot fail
    batch = simulations.batch(name, "truth", PRINTED_HULL)
    reached, collided, runs = int(batch.column("reached").sum()), int(batch.column("collided").sum()), batch.runs
    text, lost = _ended(reached, collided, runs)
    numbers = {"runs": float(runs), "reached": float(reached), "collided": float(collided)}
    if reached == runs:
        return agrees(text, **numbers)
    least = float(batch.column("min_clearance_m").min())
    return differs(text, f"{lost}, least clearance {least:.3f} m", **numbers)


def _limit(simulations: Simulations) -> Result:
    # `safe` is None, so the comparison cannot fail
    took = {
        what: _mean(simulations.arrived(_LIMITED, "sonar", "time_s", factors))
        for what, factors in (("the vehicle as it is", ()), *_LIMITS)
    }
    usual, *changed = took
    best = min(changed, key=lambda what: np.nan_to_num(took[what], nan=np.inf))  # NaN: none arrived
    text = "; ".join(f"{what} {seconds:.1f} s" for what, seconds in took.items())
    return differs(
        text,
        f"one vehicle parameter limits the time: with {best} it takes {took[usual] - took[best]:.1f} s less",
        **{f"{what.replace(' ', '_')}_s": seconds for what, seconds in took.items()},
    )


def _ended(reached: int, collided: int, runs: int) -> tuple[str, str]:
    text = f"{reached} of {runs} arrived, {collided} collided"
    return text, f"{collided} of {runs} runs collided and {runs - reached - collided} did not arrive"


def _judged_time(simulations: Simulations, name: str, sensing: Sensing) -> float:
    # mean of a scenario, mean of its series, or longest run
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
        return differs("no result", "no run arrived that has a part of its path outside avoidance")
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
    return differs(text, f"E_p is above {bound:.3g} m in {', '.join(above)}", **numbers)


def _mean(values: Sequence[float] | np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    array = np.asarray(values, dtype=float)
    finite = array[np.isfinite(array)]
    return float(finite.mean()) if finite.size else float("nan")
