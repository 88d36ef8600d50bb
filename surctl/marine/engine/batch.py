"""Runs of one case with many seeds, in one process or in several."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any

from surctl.errors import InputError
from surctl.marine.simulation import OwnPhysics, simulate

if TYPE_CHECKING:
    from surctl.marine.control import Law
    from surctl.marine.simulation import Case, PhysicsMaker, Run, ThrusterFault

__all__ = ["BatchCase", "simulate_seeds", "simulate_with_steppers"]


@dataclass(frozen=True)
class BatchCase:
    """What a process needs to simulate a case.

    Attributes:
        case: scenario, vehicle, gains and law.
        fallback: fallback of the law, as for `build_law`.
        thruster_faults: failures of thrusters.
        physics: makes the physics of a run.
        stepper: makes what computes the control steps of a run in place of the law, for example
            `surctl.marine.export.CompiledLaw`; None: the law in Python.
    """

    case: Case
    physics: PhysicsMaker = OwnPhysics
    fallback: str = "exact"
    thruster_faults: tuple[ThrusterFault, ...] = ()
    stepper: Callable[[Law], Any] | None = None


_law: Any = None  # of this process


def simulate_seeds(batch_case: BatchCase, seeds: Sequence[int], *, processes: int = 1) -> Iterator[Run]:
    """Yield the runs of a case with the given seeds in their order; each process builds the law once.

    The runs do not depend on the number of processes.

    Args:
        batch_case: the case and its physics.
        seeds: seeds of the runs.
        processes: number of processes.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.engine import BatchCase, mujoco_physics, simulate_seeds
        >>> from surctl.marine.simulation import Case, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> case = Case(load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default"))
        >>> runs = simulate_seeds(BatchCase(case, mujoco_physics()), [0, 1])
        >>> [(run.seed, run.metrics.reached) for run in runs]
        [(0, True), (1, True)]
    """
    return (run for run, _ in simulate_with_steppers(batch_case, seeds, processes=processes, compared=False))


def simulate_with_steppers(
    batch_case: BatchCase, seeds: Sequence[int], *, processes: int = 1, compared: bool = True
) -> Iterator[tuple[Run, Any]]:
    """Yield the runs as `simulate_seeds` does, each with the report of its stepper.

    The report is None without a stepper; and if not `compared`, because it repeats each step in Python.
    """
    if processes < 1:
        raise InputError("must be at least 1", key="processes", value=processes, remedy="give 1 or more")
    law = _build(batch_case)
    if processes == 1 or len(seeds) == 1:
        for seed in seeds:
            yield _simulated(batch_case, law, compared, seed)
        return
    # started afresh: a copy of this process would share its threads' locks and its connection to the display
    pool = ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_begin, initargs=(batch_case,))
    with pool:
        for run, report in pool.map(partial(_in_process, batch_case, compared), seeds):
            yield replace(run, law=law), report


def _build(batch_case: BatchCase) -> Any:
    law: Callable[[], Any] = batch_case.case.build
    if batch_case.fallback == "exact":
        return law()
    from surctl.marine.control import build_law

    case = batch_case.case
    return build_law(
        case.law, avoidance=case.avoidance, mode=case.mode, sonar=case.sensing == "sonar", guidance=case.guidance,
        equipment=case.scenario.sensors.on(case.vehicle["radius"]), barrier=case.barrier, movers=case.movers,
        fallback=batch_case.fallback, depths=case.scenario.depths is not None, actuators=case.vehicle.actuators,
    )  # fmt: skip


def _begin(batch_case: BatchCase) -> None:
    global _law
    _law = _build(batch_case)


def _in_process(batch_case: BatchCase, compared: bool, seed: int) -> tuple[Run, Any]:
    run, report = _simulated(batch_case, _law, compared, seed)
    return replace(run, law=None), report  # type: ignore[arg-type]  # a law cannot be sent


def _simulated(batch_case: BatchCase, law: Law, compared: bool, seed: int) -> tuple[Run, Any]:
    case = batch_case.case
    stepper = None if batch_case.stepper is None else batch_case.stepper(law)
    run = simulate(
        case.scenario,
        case.vehicle,
        gains=case.gains,
        law=law,
        sensing=case.sensing,
        seed=seed,
        model=case.model,
        stepper=stepper,
        thruster_faults=batch_case.thruster_faults,
        physics=batch_case.physics,
    )
    return run, stepper.report() if stepper is not None and compared else None
