"""Loss of the bounded fallback against the exact one: rows and task, on hard problems and in simulated runs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.ir import compile_block
from surctl.marine.control import Law, build_law, load_gains
from surctl.marine.simulation import load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from surctl.priority import Fallback, safe_step
from surctl.priority.solver.fallback import BOUNDED
from tests.oracles.distance_trials import Trials, draw_trials

__all__ = ["flights", "quality"]

Array = NDArray[np.float64]

_LADDERS: tuple[Fallback, Fallback] = ("exact", "bounded")
_RUNGS = {1: "task and rows hold", 2: "task as well as the rows allow", 3: "rows opened"}
# problems in which rows contradict each other or the task
_FLIGHTS = (("pool-behind", "predict"), *((f"pool-speed-{speed}", "barrier") for speed in ("015", "020", "025")))


def quality(*, quick: bool) -> list[str]:
    """Return violations of rows and task beyond those of the exact solution, for problems that need the bounded
    fallback.
    """
    trials = draw_trials(500 if quick else 4_000, n=4, p=2, m=24, seed=0)
    exact, found = (compile_block(safe_step(4, 2, 24, fallback=ladder))(*trials.arrays) for ladder in _LADDERS)
    low, high = trials.box[:, :4], trials.box[:, 4:]
    near = np.clip(trials.target, low, high)
    least = np.maximum(exact[3][:, 0], 0.0)
    answers = {
        "bounded": found[0],
        "zero velocity": np.clip(0.0 * near, low, high),
        "the target clipped to the box": near,
    }
    best = _task(trials, exact[0])
    lines = [
        "| result of the exact fallback | problems | answer | hard rows missed, max | soft rows missed beyond it, "
        "mean / 95 % / max | task missed beyond it, mean / 95 % |",
        "|---|---|---|---|---|---|",
    ]
    for rung, told in _RUNGS.items():
        chosen = (exact[4][:, 0] == rung) & (found[4][:, 0] == BOUNDED)
        for name, v in answers.items():
            hard, soft = (part[chosen] for part in _missed(trials, v))
            beyond, task = np.maximum(soft - least[chosen], 0.0), (_task(trials, v) - best)[chosen]
            lines.append(
                f"| {told} | {chosen.sum()} | {name} | {hard.max():.2g} "
                f"| {beyond.mean():.3f} / {np.quantile(beyond, 0.95):.3f} / {beyond.max():.2f} "
                f"| {task.mean():.3f} / {np.quantile(task, 0.95):.3f} |"
            )
    return lines


def _missed(trials: Trials, v: Array) -> tuple[Array, Array]:
    """Return the largest violation of a hard row and of a soft row of length 1, (N,) each."""
    A, lower, upper, soft = trials.unit()
    value = np.einsum("kij,kj->ki", A, v)
    missed = np.maximum(np.maximum(value - upper, lower - value), 0.0)
    return np.where(soft, 0.0, missed).max(axis=1), np.where(soft, missed, 0.0).max(axis=1)


def _task(trials: Trials, v: Array) -> Array:
    """Return ‖J v − x‖ (N,), with the longest row of J scaled to length 1."""
    J = trials.J.reshape(len(v), -1, v.shape[1])
    longest = np.linalg.norm(J, axis=2).max(axis=1)
    off = np.linalg.norm(np.einsum("kij,kj->ki", J, v) - trials.x, axis=1)
    return np.asarray(off / np.where(longest > 0.0, longest, 1.0))


def flights(*, quick: bool) -> list[str]:
    """Simulate the same missions with both fallbacks."""
    lines = [
        "| run, law guarded in mode projected | movers | exact: time, least clearance | bounded: the same "
        "| steps, degraded |",
        "|---|---|---|---|---|",
    ]
    gains = load_gains("default")
    for name, movers in _FLIGHTS[:1] if quick else _FLIGHTS:
        mission = load_scenario(name)
        told: list[Any] = []
        for ladder in _LADDERS:
            law: Law = build_law("guarded", mode="projected", movers=movers, fallback=ladder)  # type: ignore[arg-type]
            run = simulate(mission, load_vehicle(mission.vehicle), gains=gains, law=law, seed=0)
            told.append((run.metrics, (run.record.status.astype(int) & 4 > 0).sum(), len(run.record.status)))
        cells = [f"{m.stopped_because} at {m.time_s:.2f} s, {m.min_clearance_m:.3f} m" for m, *_ in told]
        lines.append(f"| {name} | {movers} | {' | '.join(cells)} | {told[1][2]}, {told[0][1]} and {told[1][1]} |")
    return lines
