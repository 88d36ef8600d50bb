"""One small study's worth of real data, shared by the report's tests."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from surctl.assessment import Assessment, Line
from surctl.marine.control import build_law, load_gains
from surctl.marine.report import ReportData
from surctl.marine.simulation import Run, load_scenario, simulate
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.verification import claims, law_corners, law_loop
from surctl.tuning import SweepTable
from surctl.verification import Verdict, falsify

COLUMNS = {
    "path_error_m": "m",
    "min_clearance_m_worst": "m",
    "delay_margin_s": "s",
    "score": "1",
    "feasible": "1",
}
SPEEDS = (0.15, 0.22)  # [m/s] cruise and cap of the runs
GAINS = load_gains("default")


def vehicle() -> Vehicle:
    return load_vehicle("sur540-flooded")


@cache
def run(scenario: str = "pool-behind", sensing: str = "truth", limit: float = 60.0) -> Run:
    loaded = replace(load_scenario(scenario), time_limit=limit)
    return simulate(loaded, load_vehicle(loaded.vehicle), gains=GAINS, sensing=sensing)  # type: ignore[arg-type]


@cache
def verdict(name: str) -> Verdict:
    at_hand = {**GAINS.values, "speed": SPEEDS[0], "speed_max": SPEEDS[1]}
    return falsify(claims(at_hand, [name])[0], samples=256, starts=4)


def sweep(*, picked: tuple[int, int] | None = (1, 1)) -> SweepTable:
    """A finished sweep with an infeasible point, a NaN and an infinite number in it."""
    rng = np.random.default_rng(3)
    table = {name: rng.uniform(0.1, 1.0, (3, 2)) for name in COLUMNS}
    table["feasible"] = np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 1.0]]) if picked else np.zeros((3, 2))
    table["path_error_m"][0, 1] = np.nan
    table["delay_margin_s"][2, 0] = np.inf
    if picked:
        table["score"][picked] = 0.05
    return swept({"lookahead": (0.6, 0.9, 1.2), "k_v": (1.0, 2.0)}, table)


def swept(
    axes: Mapping[str, Sequence[float]], table: Mapping[str, NDArray[np.float64]], design: str = "grid"
) -> SweepTable:
    """A sweep of these columns."""
    where = tuple(axes) if design == "grid" else ("point",)
    about = {"design": design, "axes": json.dumps(list(axes)), "draws": "[]", "gains": json.dumps(asdict(GAINS))}
    texts = {name: (COLUMNS.get(name, "1"), name, where) for name in table}
    for name, unit in zip(axes, ("m", "1/s", "kg", "s"), strict=False):
        texts[name] = (unit, name, (name,) if design == "grid" else where)
    texts["case"] = ("", "case", ("case",))
    values = {**table, **axes, "case": ["pool-behind/sur400/truth"]}
    return SweepTable(about, texts, lambda name, at: np.asarray(values[name])[at])


def said(*lines: Line) -> Assessment:
    """An assessment of these lines."""
    return Assessment("study", {}, (), {}).with_lines(lines)


@cache
def report() -> ReportData:
    return ReportData(
        title="Study default",
        command="surctl study",
        version="0.1.0",
        vehicle=vehicle(),
        gains=GAINS,
        speeds=SPEEDS,
        linear=law_corners(build_law("guarded"), vehicle(), GAINS, cruise=0.15),
        loops={"0.15 m/s": law_loop(build_law("guarded"), vehicle(), GAINS, cruise=0.15).linear},
        verdicts=(verdict("v1-printed"), verdict("m-norm-printed"), verdict("v1-corrected")),
        runs=(run(), run(sensing="sonar")),
        sweep=sweep(),
        seconds={"sweep": 1.5, "runs": 0.25},
        assessment=said(Line(True, "margins suffice"), Line(None, "sonar does not decide", counts=False)),
    )
