"""Missions as the subject of a sweep: metrics of closed-loop runs and of the linear loops at every point."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from itertools import product
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from surctl import __version__
from surctl.errors import InputError, check_known, check_once, nearest
from surctl.marine.control import Gains, GainSpec, build_law, law_options, law_ref
from surctl.marine.guidance.tracking import check_guidance
from surctl.marine.simulation import METRICS, Case, Scenario, Sensing, simulate_batch, vehicle_law
from surctl.marine.simulation.batch.case import case_parameters, check_speeds
from surctl.marine.simulation.metrics import MetricSpec
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.verification import LINEAR_METRICS, linear_table
from surctl.marine.verification.cruise_loop import has_cruise_loop
from surctl.marine.verification.linear_table import LINEAR_PARAMETERS
from surctl.marine.verification.speeds import check_held, cruise_speeds
from surctl.own_code import label
from surctl.priority import Mode
from surctl.recorded_write import Column
from surctl.tuning.chunked import Columns, SweepStage, chunk_size
from surctl.tuning.design import SEED, Design
from surctl.tuning.sweep import SweepSubject, SweepTable
from surctl.verification.linear import LEAST_DISK_MARGIN
from surctl.verification.loops import LEAST_DELAY_MARGIN, worst_place

Floats = NDArray[np.float64]

_WORST = "_worst"
_CRUISE = "scenario.cruise"
_MOST_RUNS = 4096  # runs in one chunk
_MOST_LINEAR = 64  # points in one chunk of linear metrics
_LEAST_LINEAR = 16  # as long as there are so many: together they take little longer than one
_OFTEN_ABSENT = ("path_error_m", "crab_angle_deg", "max_crab_angle_deg", "heading_error_deg")
# NaN here means that the run has no path error or that the law turns the hull to scan, not that the run failed


_AVERAGED = {name: spec for name, spec in METRICS.items() if spec.better is not None}  # a status code has no mean

CASE_COLUMNS: Mapping[str, MetricSpec] = {
    **{name: MetricSpec(spec.unit, f"{spec.meaning}, mean") for name, spec in _AVERAGED.items()},
    **{name + _WORST: MetricSpec(spec.unit, f"{spec.meaning}, worst") for name, spec in _AVERAGED.items()},
}
"""Closed-loop columns, for one case over its seeds and for all runs at a point: mean and worst value of every metric
for which low or high is better. In a mean all cases have the same weight. Runs without a path error do not count in its
mean; any other NaN makes the result NaN."""

RUN_COLUMNS: Mapping[str, MetricSpec] = {
    **CASE_COLUMNS,
    "strayed": MetricSpec("1", "rms horizontal distance to the path in hull radii, mean"),
    "time_ratio": MetricSpec("1", "arrival time divided by the ideal time (path length / cruise speed), worst"),
}
"""Columns over all runs at a point."""

LINEAR_COLUMNS: Mapping[str, MetricSpec] = {
    name: MetricSpec(spec.unit, f"{spec.meaning}; worst vehicle") for name, spec in LINEAR_METRICS.items()
}
"""Columns of the linearised loops at each vehicle's largest cruise speed, or the worst over the sweep's speeds."""

WORST_SPEED = {
    "disk_margin_at_m_per_s": MetricSpec("m/s", "cruise speed at which the disk margin of the loops is least")
}
"""Additional column if the sweep names cruise speeds."""


@dataclass(frozen=True)
class MissionSweep(SweepSubject):
    """Missions as the subject of `surctl.tuning.sweep`: metrics of runs, and of the linearised loops at these points.

    Attributes:
        cases: one or more simulation cases, which are simulated at every point; all of them must have equal gains.
        seeds: seeds of every case that depends on the seed; the other cases are simulated once, with the first seed.
        linear: whether to compute the linear metrics too; they are computed once for each combination of the parameters
            on which they depend.
        cruise: cruise speeds [m/s] of the linear metrics; every metric is the worst over these speeds, and the column
            `disk_margin_at_m_per_s` is the speed with the least disk margin. If empty, the linear metrics of a vehicle
            are computed at its largest cruise speed.

    Raises:
        InputError: when it is swept, if `check_request` finds an error.
    """

    cases: tuple[Case, ...]
    seeds: tuple[int, ...] = (0,)
    linear: bool = True
    cruise: tuple[float, ...] = ()

    def stages(self, design: Design) -> list[SweepStage]:
        """Return the rows of the linear metrics, then the points, after a check of the request."""
        check_request(self.cases, design, self.seeds, self.cruise)
        stages = []
        if self.linear:
            rows, _ = _linear_rows(design)
            size = max(_LEAST_LINEAR, chunk_size(len(rows), most=_MOST_LINEAR))
            width = len(self.linear_columns)
            stages.append(SweepStage(design.names, rows, size, width, "linear figures of", "sets"))
        runs = self.runs_per_point(design.names)
        size = chunk_size(len(design.points), most=max(1, _MOST_RUNS // runs))
        width = len(RUN_COLUMNS) + len(self.cases) * len(CASE_COLUMNS)
        return [*stages, SweepStage(design.names, design.points, size, width, each=runs)]

    def evaluate(self, stage: int, index: int, values: Mapping[str, Floats]) -> Floats:
        """Return the linear metrics of points, or the columns of all runs followed by those of each case."""
        count = len(next(iter(values.values())))
        return self._linear(values, count) if self.linear and stage == 0 else self._simulated(index, values, count)

    def request(self, design: Design, stages: Sequence[SweepStage]) -> str:
        """Return the SHA-256 of everything that the results, and their division into chunks, depend on."""
        linear = stages[0].size if self.linear else 0
        lines = [f"surctl {__version__}", f"columns {tuple(METRICS)} {tuple(LINEAR_METRICS) if linear else ()}"]
        lines += [] if self.has_margins or not linear else ["margins are not judged"]
        lines += [f"cruise {self.cruise}"] if self.cruise and linear else []
        lines += [f"design {design.description}", f"seeds {self.seeds}", f"chunks {linear} {stages[-1].size}"]
        for case in self.cases:
            lines.append(f"case {case.scenario!r} {_numbers(case.vehicle)} {_numbers(case.model or case.vehicle)}")
            lines.append(f"law {law_digest(case)} {case.mode} {case.sensing} {dict(case.gains.values)!r}")
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()

    def quantity(self, name: str) -> tuple[str, str]:
        """Return unit and meaning of a parameter."""
        if name == SEED:
            return "1", "seed of every run"
        parameter = next(table[name] for table in map(case_parameters, self.cases) if name in table)
        return parameter.unit, parameter.meaning

    def labels(self) -> Mapping[str, Column]:
        """Return the names of the cases."""
        return {"case": Column(np.array([c.name for c in self.cases]), "", "scenario, vehicle and sensing", ("case",))}

    def columns(self, design: Design, stored: Columns, dimensions: Sequence[str]) -> Iterator[tuple[str, Column]]:
        """Yield the columns of results; each is read from the stored chunks only when it is written."""
        inputs: dict[str, Floats] = {}
        inverse, point = _linear_rows(design)[1], tuple(dimensions)

        def described(quantity: MetricSpec, values: Floats, *, by_case: bool = False) -> Column:
            meaning = quantity.meaning + ", by case" * by_case
            return Column(values, quantity.unit, meaning, ("case", *point) if by_case else point)

        def of_runs(k: int) -> Floats:
            return stored(int(self.linear), k)

        def of_loops(k: int) -> Floats:
            return np.asarray(stored(0, k)[inverse])

        for k, (name, quantity) in enumerate(RUN_COLUMNS.items()):
            yield name, described(quantity, of_runs(k))
        for k, (name, quantity) in enumerate(self.linear_columns.items() if self.linear else ()):
            yield name, described(quantity, of_loops(k))
        for name in ("strayed", "time_ratio", "reached_worst", "min_clearance_m_worst"):
            inputs[name] = of_runs(list(RUN_COLUMNS).index(name))
        for name in ("delay_margin_s", "disk_margin") if self.linear and self.has_margins else ():
            inputs[name] = of_loops(list(LINEAR_COLUMNS).index(name))
        verdict = judged(inputs)
        meaning = "mean deviation in hull radii plus worst time ratio"
        yield "score", described(MetricSpec("1", meaning), verdict["score"])
        meaning = "1 if the point may be picked, otherwise 0"
        yield "feasible", described(MetricSpec("1", meaning), verdict["feasible"])
        count = len(self.cases)
        for k, (name, quantity) in enumerate(CASE_COLUMNS.items()):
            places = [len(RUN_COLUMNS) + c * len(CASE_COLUMNS) + k for c in range(count)]
            yield f"case_{name}", described(quantity, np.concatenate([of_runs(p) for p in places]), by_case=True)

    def origin(self, design: Design) -> dict[str, Any]:
        """Return the cases, the digests of their laws, and their gains."""
        gains = self.cases[0].gains
        cases = [
            {"name": c.name, "law": label(c.law), "priority_mode": c.mode}
            | {"seeds": list(self.seeds_of(c, design.names))}
            | ({} if c.model is None else {"model": c.model.name})
            for c in self.cases
        ]
        own = {"own": {name: asdict(spec) for name, spec in gains.own.items()}} if gains.own else {}
        known = {"name": gains.name, "values": dict(gains.values), "provenance": gains.provenance}
        return {
            "title": f"surctl sweep over {', '.join(design.names)}",
            "source": f"surctl {__version__}",
            "cases": json.dumps(cases),
            "law_sha256": ", ".join(dict.fromkeys(law_digest(c) for c in self.cases)),
            "gains": json.dumps({**known, "source": gains.source, **own}),
        }

    @property
    def linear_columns(self) -> Mapping[str, MetricSpec]:
        """Columns of results that describe the linearised loops."""
        return {**LINEAR_COLUMNS, **(WORST_SPEED if self.cruise else {})}

    @property
    def has_margins(self) -> bool:
        """Whether the loop of every case has a linear model; if not, margins are NaN and are not checked."""
        return all(has_cruise_loop(case.law, case.guidance) for case in self.cases)

    def runs_per_point(self, names: Sequence[str]) -> int:
        """Return the number of closed-loop runs at each point of a sweep over these parameters."""
        return sum(len(self.seeds_of(case, names)) for case in self.cases)

    def seeds_of(self, case: Case, names: Sequence[str]) -> tuple[int, ...]:
        """Return the seeds with which a case is simulated at each point of a sweep over these parameters."""
        gentle = all(name in case.gains.values or name.startswith(("vehicle.", "plant.")) for name in names)
        depends = case.scenario.seeded or case.sensing != "truth" or not gentle  # other parameters may add waves
        return self.seeds if depends else self.seeds[:1]

    def _simulated(self, index: int, values: Mapping[str, Floats], count: int) -> Floats:
        # processes that begin with chunks side by side begin with different cases, so each compiles another loop
        order = [(index + k) % len(self.cases) for k in range(len(self.cases))]
        done = {at: self._runs(self.cases[at], values, count) for at in order}
        by_case = [done[at] for at in range(len(self.cases))]
        strayed, ratios = [], []
        for case, one in zip(self.cases, by_case, strict=True):
            radius = _own(values, ("plant.radius", "vehicle.radius"), case.vehicle["radius"])
            cruise = _own(values, (_CRUISE,), case.scenario.cruise)
            strayed.append(one["deviation_m"] / radius)
            ratios.append(one["time_s"] / (case.scenario.path.length / cruise))
        together = {name: np.concatenate([one[name] for one in by_case], axis=1) for name in _AVERAGED}
        of_all = [np.concatenate(strayed, axis=1).mean(axis=1), np.concatenate(ratios, axis=1).max(axis=1)]
        return np.stack([*_summary(together), *of_all, *(c for one in by_case for c in _summary(one))], axis=1)

    def _runs(self, case: Case, values: Mapping[str, Floats], count: int) -> dict[str, Floats]:
        # each metric of a case (points, seeds)
        seeds = self.seeds_of(case, tuple(values))
        known = case_parameters(case)
        numbers = np.repeat(values[SEED], len(seeds)) if SEED in values else np.tile(seeds, count)
        done = simulate_batch(
            case,
            {name: np.repeat(v, len(seeds)) for name, v in values.items() if name in known},
            seeds=numbers.astype(np.int64),
        )
        # a run without seeds is repeated, so that every case has the same weight in a mean
        often = len(self.seeds) // len(seeds)
        return {name: np.tile(done.column(name).reshape(count, len(seeds)), (1, often)) for name in _AVERAGED}

    def _linear(self, values: Mapping[str, Floats], count: int) -> Floats:
        if not self.has_margins:  # the linear metrics of another law would mislead
            return np.full((count, len(self.linear_columns)), np.nan)
        best = [-np.inf if spec.better == "low" else np.inf for spec in LINEAR_METRICS.values()]
        table = np.tile(best, (count, 1))
        margins = []
        for case, cruise in product(_fastest(self.cases), self.cruise or (None,)):
            metrics = linear_table(
                case.vehicle,
                values,
                base=case.gains.values,
                cruise=case.scenario.cruise if cruise is None else cruise,
                dt=vehicle_law(case.vehicle, case.law).dt,
                model=case.model,
                law=case.law,
            )
            margins.append(metrics["disk_margin"])
            for k, (name, spec) in enumerate(LINEAR_METRICS.items()):
                worst = np.maximum if spec.better == "low" else np.minimum  # NaN (no linear model) stays NaN
                table[:, k] = worst(table[:, k], metrics[name])
        if not self.cruise:
            return table
        place = worst_place(-np.array(margins)) % len(self.cruise)
        return np.column_stack([table, np.array(self.cruise)[place]])


def build_cases(
    scenarios: Sequence[Scenario],
    vehicles: Sequence[Vehicle] = (),
    *,
    gains: Gains,
    law: str = "",
    mode: str = "nsb",
    sensing: str = "truth",
    guidance: str = "los",
) -> tuple[Case, ...]:
    """Return a case for every scenario and every vehicle; without vehicles, each scenario has its own vehicle.

    Raises:
        InputError: the law, the mode, the sensing or the guidance is unknown.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases
        >>> missions = [load_scenario("pool-behind"), load_scenario("tank-static")]
        >>> [case.name for case in build_cases(missions, gains=load_gains("default"))]
        ['pool-behind/sur400/truth', 'tank-static/sur540-flooded/truth']
    """
    check_guidance(guidance)
    for key, value, known in (("priority-mode", mode, get_args(Mode)), ("sensing", sensing, get_args(Sensing))):
        check_known(value, known, key=key)
    kind: dict[str, Any] = {"law": law and law_ref(law), "mode": mode, "sensing": sensing, "guidance": guidance}
    return tuple(
        Case(scenario, vehicle, gains, **kind)
        for scenario in scenarios
        for vehicle in vehicles or (load_vehicle(scenario.vehicle),)
    )


def check_column(name: str) -> None:
    """Raise InputError, with the nearest known name, if a sweep with linear metrics has no column of this name."""
    check_known(name, (*RUN_COLUMNS, *LINEAR_COLUMNS, "score", "feasible"), "no such column", key="column")


def check_request(cases: Sequence[Case], design: Design, seeds: Sequence[int], cruise: Sequence[float] = ()) -> None:
    """Check the request of a sweep before any run.

    Raises:
        InputError: there is no case, a case occurs twice, or the cases have different gains; seeds are missing,
            negative or repeated, or several seeds are given although the seed is an axis; no case has the parameter of
            an axis, or a value is out of its bounds; cruise speeds are given although the cruise speed is an axis,
            exceed a speed cap, or need too much thrust.
    """
    if not cases:
        raise InputError("has nothing to simulate", key="sweep", remedy="name at least one scenario")
    check_once((case.name for case in cases), "occurs twice", key="case", remedy="name each case once")
    if any(case.gains.values != cases[0].gains.values for case in cases):
        raise InputError("cases have different gains", key="gains", remedy="give all cases the same gains")
    if not seeds or min(seeds) < 0 or len(set(seeds)) < len(seeds):
        raise InputError(
            "must be different whole numbers, at least 0", key="seeds", value=tuple(seeds), remedy="write 0,1,2,..."
        )
    if SEED in design.names and len(seeds) > 1:
        raise InputError("is an axis already", key="seeds", value=len(seeds), remedy="omit --seeds or the axis")
    if cruise and _CRUISE in design.names:
        raise InputError("is an axis already", key="--cruise", value=list(cruise), remedy="omit --cruise or the axis")
    for case in cases if cruise else ():
        check_held(cruise_speeds(cruise, key="--cruise"), case.vehicle, cap=case.scenario.cap, key="--cruise")
    known = [case_parameters(case) for case in cases]
    for k, name in enumerate(design.names):
        if name == SEED:
            continue
        of_cases = [table[name] for table in known if name in table]
        if not of_cases:
            every = {SEED, *(n for table in known for n in table)}
            raise InputError("no such parameter", key="axis", value=name, remedy=_nearest_parameter(name, every))
        for parameter in of_cases:
            parameter.check(np.array([design.points[:, k].min(), design.points[:, k].max()]))
    for case in cases:
        check_speeds(case, {name: design.points[:, k] for k, name in enumerate(design.names)})


def judged(columns: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """Return the columns of score and feasibility, which are computed from the given columns.

    The path error is not part of the score, because it covers only the time outside avoidance, and the gains change
    this time.
    """
    feasible = (columns["reached_worst"] > 0.5) & (columns["min_clearance_m_worst"] > 0)
    if "delay_margin_s" in columns:
        feasible &= (columns["delay_margin_s"] >= LEAST_DELAY_MARGIN) & (columns["disk_margin"] >= LEAST_DISK_MARGIN)
    return {"score": columns["strayed"] + columns["time_ratio"], "feasible": feasible.astype(float)}


def _linear_rows(design: Design) -> tuple[Floats, NDArray[np.int64]]:
    """Return the points that differ in what the linear metrics depend on, and of each point of the design its row."""
    matter = [k for k, name in enumerate(design.names) if name in LINEAR_PARAMETERS]
    different, inverse = np.unique(design.points[:, matter], axis=0, return_inverse=True)
    rows = np.tile(design.points[:1], (len(different), 1))  # the values of the other axes do not matter
    rows[:, matter] = different
    return rows, inverse.reshape(-1)


def picked_gains(table: SweepTable) -> Gains:
    """Return the gains of a sweep of missions with the values of its picked point.

    Without a choice of points, these are the gains that the cases had before the sweep varied them.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import MissionSweep, build_cases, picked_gains
        >>> from surctl.tuning import grid, parse_axis, sweep
        >>> cases = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> table = sweep(MissionSweep(cases, linear=False), grid([parse_axis("k_v=1,2")]))
        >>> picked_gains(table)["k_v"] == table.at(table.picked)["k_v"]
        True
    """
    stored = json.loads(table.attributes["gains"])
    own = {name: GainSpec(**spec) for name, spec in stored.pop("own", {}).items()}
    base = Gains(**stored, own=own)
    if table.picked is None or np.prod(table.shape) == 1:
        return base
    chosen = table.at(table.picked)
    what = ", ".join(f"{name} = {value:g}" for name, value in chosen.items())
    return base.with_values(
        {name: value for name, value in chosen.items() if name in base.values},
        provenance=f"{base.provenance}; picked by a {table.attributes['design']} sweep: {what}",
        how="picked",
    )


def law_digest(case: Case) -> str:
    """Return a digest of the control law's instructions, without those of the solver of the priority mode."""
    return _law_digest(case.law, **{**law_options(case), "mode": "nsb"})


@cache
def _law_digest(law: str, **options: Any) -> str:
    return build_law(law, **options).stages.closed.digest()


def _numbers(vehicle: Vehicle) -> str:
    thrusters = "" if vehicle.actuators is None else f" {vehicle.actuators.text()}"
    return f"{vehicle.name} {[(name, p.value) for name, p in vehicle.parameters.items()]!r}{thrusters}"


def _nearest_parameter(name: str, known: set[str]) -> str:
    group, _, word = name.partition(".")
    masses = sorted(k for k in known if re.fullmatch(rf"{re.escape(group)}\.m(11|22|33)", k)) if word == "mass" else []
    if masses:
        return "the masses are " + ", ".join(masses)
    hint = nearest(name, known)
    if hint.startswith("did you mean"):
        return hint
    groups = sorted({k.partition(".")[0] + ".…" if "." in k else k for k in known})
    return "known: " + ", ".join(groups)


def _own(values: Mapping[str, Floats], names: Sequence[str], nominal: float) -> Floats:
    # (points, 1), or the nominal value (1, 1) if the sweep varies none of the parameters
    return next((values[name][:, None] for name in names if name in values), np.full((1, 1), nominal))


def _summary(metrics: Mapping[str, Floats]) -> list[Floats]:
    # metrics (points, runs)
    means, worst = [], []
    for name, spec in _AVERAGED.items():
        runs = metrics[name]
        there = np.isfinite(runs) if name in _OFTEN_ABSENT else np.full(runs.shape, True)
        count = there.sum(axis=1)
        total = np.where(there, runs, 0.0).sum(axis=1)
        means.append(np.where(count > 0, total / np.maximum(count, 1), np.nan))
        ill = np.where(there, runs, -np.inf if spec.better == "low" else np.inf)
        extreme = ill.max(axis=1) if spec.better == "low" else ill.min(axis=1)
        worst.append(np.where(count > 0, extreme, np.nan))
    return means + worst


def _fastest(cases: Sequence[Case]) -> list[Case]:
    fastest: list[Case] = []
    for case in sorted(cases, key=lambda c: -c.scenario.cruise):
        if not any((case.vehicle, case.model, case.law) == (k.vehicle, k.model, k.law) for k in fastest):
            fastest.append(case)
    return fastest
