"""The law with limits as C, and its least-distance step alone, on the emulated Cortex-M4F in float32."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from alone import at_bounds, counted
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.export import TARGETS, Records, build_controller, check_builds
from surctl.export.envelope import as_records
from surctl.ir import replay
from surctl.marine.control import build_law, load_gains
from surctl.marine.export import build_bundle, closed_form, operating_envelope
from surctl.marine.simulation import law_numbers, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from surctl.priority import Fallback, LevelShape, priority_step
from surctl.priority.solver.elimination import FLOAT32
from surctl.priority.solver.fallback import BOUNDED
from tests.oracles.distance_trials import Trials, draw_trials

__all__ = ["USUAL", "WORST", "laws", "ticks"]

USUAL, WORST = 6_000, 12_000
"""Limits on the instructions of a step with 24 rows and 2 equalities."""

_ROWS = 24
_RUNGS = {
    1: "task and rows hold",
    2: "task as well as the rows allow",
    3: "rows opened",
    BOUNDED: "the solution of constant cost",
}
_LAWS: tuple[tuple[str, str, Mapping[str, object], bool], ...] = (
    ("1 static obstacle, gains constant", "pool-ahead", {"contacts": 1, "moving": False}, True),
    ("4 static obstacles, gains constant", "pool-static", {"contacts": 4, "moving": False}, True),
    ("8 obstacles that may move, gains as inputs", "pool-static", {}, False),
)


@dataclass(frozen=True)
class Told:
    """Lines of the README, and figures for the limits; bound: with every loop at its limit."""

    lines: tuple[str, ...]
    title: str
    mean: float
    most: int
    same: bool
    bound: int = 0


def laws(*, quick: bool, ladder: Fallback = "exact") -> Told:
    """Measure the law guarded in mode projected over a run and over single steps; most: if bounded, with static
    obstacles.
    """
    lines = [
        "| law guarded, mode projected, with | rows | run, min / mean / max | single steps, mean / max "
        "| code, B | bytes of Python |",
        "|---|---|---|---|---|---|",
    ]
    same, means, most = True, [], 0
    for name, scenario, options, constant in _LAWS[:1] if quick else _LAWS:
        mission, gains = load_scenario(scenario), load_gains("default")
        vehicle, law = load_vehicle(mission.vehicle), build_law("guarded", mode="projected", fallback=ladder, **options)  # type: ignore[arg-type]
        numbers = law_numbers(mission, gains, vehicle)
        record = simulate(mission, vehicle, gains=gains, law=law, sensing="truth", seed=0).record
        shipped = closed_form(law, real="float32", constants=numbers if constant else None)
        P = np.zeros((len(record.law_state), 0)) if constant else record.law_parameters
        flight = as_records(shipped, Records(record.law_state, record.law_input, P))
        within = operating_envelope(law, mission, vehicle, shipped.gains)
        bundle = build_bundle(shipped, {} if constant else law.gains.unpack(numbers), real="float32", envelope=within)
        targets = [TARGETS["gcc-O0"], TARGETS["cortex-m4f"]]
        with tempfile.TemporaryDirectory() as scratch:
            built = build_controller(shipped, bundle, Path(scratch, "b"))
            flown, tried = (check_builds(built, [flight], targets, steps=n) for n in (0, 500 if quick else 4_000))
        alone, both = (report.builds[1].instructions for report in (flown, tried))
        assert alone is not None and both is not None
        fine = flown.passed and tried.passed
        same, most = same and fine, max(most, both.most) if ladder == "exact" or constant else most
        means.append(alone.mean)
        code = tried.builds[1].runtime_bytes
        lines.append(
            f"| {name} | {len(law.rows)} | {alone.least} / {alone.mean:.0f} / {alone.most} "
            f"| {both.mean:.0f} / {both.most} | {code} | {'yes' if fine else '**no**'} |"
        )
    return Told(tuple(lines), "", min(means), most, same)


def ticks(*, quick: bool, ladder: Fallback = "exact") -> Told:
    """Measure the step of that mode alone: 24 rows, a task of 2 rows and two of 1, on numerically hard problems."""
    levels = (LevelShape(2), LevelShape(1), LevelShape(1))
    tick = priority_step("projected", n=4, levels=levels, rows=_ROWS, precision=FLOAT32, fallback=ladder)
    arrays = _inputs(draw_trials(300 if quick else 4_000, n=4, p=2, m=_ROWS, seed=0))
    outputs, counts = counted(tick, arrays)
    first = [array[:100].astype(np.float32) for array in arrays]
    fine = all(
        a.tobytes() == b[:100].tobytes() for a, b in zip(replay(tick, *first, real=np.float32), outputs, strict=True)
    )
    status, iterations = outputs[4][:, 0], outputs[5][:, 0]
    lines = [
        "| what came out | problems | instructions, min / mean / 90 % / max | iterations, mean / max |",
        "|---|---|---|---|",
    ]
    held = status == 1
    groups = [(told, status == rung) for rung, told in _RUNGS.items()]
    groups.insert(0, ("of those: at most 1 iteration", held & (iterations <= 1)))
    groups[0], groups[1] = groups[1], groups[0]
    for told, chosen in groups:
        if chosen.any():
            c, k = counts[chosen], iterations[chosen]
            lines.append(
                f"| {told} | {chosen.sum()} | {c.min()} / {c.mean():.0f} / {np.quantile(c, 0.9):.0f} / {c.max()} "
                f"| {k.mean():.1f} / {k.max():.0f} |"
            )
    some = [array if ladder == "bounded" else array[:10] for array in arrays]
    _, longest = counted(at_bounds(tick), (*some, np.zeros((len(some[0]), 1))))
    lines += [
        "",
        f"With every loop at its bound {tick.operations} operations, {longest.max()} instructions when all run to it.",
    ]
    usual = counts[held & (iterations <= 1)]
    title = f"{_ROWS} rows and a task of 2, {len(counts)} numerically hard problems"
    return Told(tuple(lines), title, float(usual.mean()), int(counts.max()), fine, int(longest.max()))


def _inputs(trials: Trials) -> tuple[NDArray[np.float64], ...]:
    """Return J, lower, upper, rows, box: the task of the problems first, then heave and yaw of the target."""
    rest = np.tile([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0], (len(trials.x), 1))
    wanted = np.hstack([trials.x, trials.target[:, 2:]])
    return np.hstack([trials.J, rest]), wanted, wanted, trials.rows, trials.box
