"""Runs of one case with many seeds, in one process or in several."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any

from surctl.errors import InputError
from surctl.simulation import OwnPhysics, simulate

if TYPE_CHECKING:
    from surctl.simulation import Case, PhysicsMaker, Run, ThrusterFault

__all__ = ["Flight", "simulate_seeds"]


@dataclass(frozen=True)
class Flight:
    """What a process needs to simulate a case.

    Attributes:
        case: scenario, vehicle, gains and law.
        fallback: fallback of the law, as for `build_law`.
        thruster_faults: failures of thrusters.
        physics: makes the physics of a run.
    """

    case: Case
    physics: PhysicsMaker = OwnPhysics
    fallback: str = "exact"
    thruster_faults: tuple[ThrusterFault, ...] = ()


_law: Any = None  # of this process


def simulate_seeds(flight: Flight, seeds: Sequence[int], *, processes: int = 1) -> Iterator[Run]:
    """Yield the runs of a case with the given seeds in their order; each process builds the law once.

    The runs do not depend on the number of processes.

    Args:
        flight: the case and its physics.
        seeds: seeds of the runs.
        processes: number of processes.

    Example:
        >>> from surctl.control import load_gains
        >>> from surctl.engine import Flight, mujoco_physics, simulate_seeds
        >>> from surctl.simulation import Case, load_scenario
        >>> from surctl.vehicle import load_vehicle
        >>> case = Case(load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default"))
        >>> runs = simulate_seeds(Flight(case, mujoco_physics()), [0, 1])
        >>> [(run.seed, run.metrics.reached) for run in runs]
        [(0, True), (1, True)]
    """
    if processes < 1:
        raise InputError("must be at least 1", key="processes", value=processes, remedy="give 1 or more")
    law = _build(flight)
    if processes == 1 or len(seeds) == 1:
        for seed in seeds:
            yield _simulated(flight, law, seed)
        return
    # started afresh: a copy of this process would share its threads' locks and its connection to the display
    pool = ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_begin, initargs=(flight,))
    with pool:
        for run in pool.map(partial(_in_process, flight), seeds):
            yield replace(run, law=law)


def _build(flight: Flight) -> Any:
    law: Callable[[], Any] = flight.case.build
    if flight.fallback == "exact":
        return law()
    from surctl.control import build_law

    case = flight.case
    return build_law(
        case.law, avoidance=case.avoidance, mode=case.mode, sonar=case.sensing == "sonar", guidance=case.guidance,
        equipment=case.scenario.sensors.on(case.vehicle["radius"]), barrier=case.barrier, movers=case.movers,
        fallback=flight.fallback, depths=case.scenario.depths is not None, actuators=case.vehicle.actuators,
    )  # fmt: skip


def _begin(flight: Flight) -> None:
    global _law
    _law = _build(flight)


def _in_process(flight: Flight, seed: int) -> Run:
    return replace(_simulated(flight, _law, seed), law=None)  # type: ignore[arg-type]  # a law cannot be sent


def _simulated(flight: Flight, law: Any, seed: int) -> Run:
    case = flight.case
    return simulate(
        case.scenario,
        case.vehicle,
        gains=case.gains,
        law=law,
        sensing=case.sensing,
        seed=seed,
        model=case.model,
        thruster_faults=flight.thruster_faults,
        physics=flight.physics,
    )
