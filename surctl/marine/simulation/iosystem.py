"""The closed loop of a scenario as a nonlinear system of python-control, in discrete time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.control import Gains, Law, LawStep, build_law
from surctl.marine.guidance import MAX_WAYPOINTS
from surctl.marine.simulation.loop import SingleRun, case_of
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.thruster_faults import Thrusters
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import Vehicle
from surctl.marine.vehicle.linearise import STATE_NAMES, THRUST_NAMES, TILT_NAMES, labelled

__all__ = ["ClosedLoopSystem", "closed_loop_system"]


class ClosedLoopSystem(NamedTuple):
    """A closed loop for python-control, to simulate as `control.input_output_response(system, times, inputs, initial)`.

    Attributes:
        system: a `control.NonlinearIOSystem` whose sampling time `dt` is the control period.
        initial: state vector of the system at the scenario's start.
    """

    system: Any
    initial: NDArray[np.float64]


def closed_loop_system(
    scenario: Scenario,
    vehicle: Vehicle,
    *,
    gains: Gains,
    law: Law | None = None,
    seed: int = 0,
    model: Vehicle | None = None,
) -> ClosedLoopSystem:
    """Return the closed loop that `simulate` runs with true positions, as a system of python-control.

    With zero input the system gives the same numbers as `simulate`, to the last bit. One step of the system is one
    control period: the law computes the thrust, and the plant moves with this thrust. Unlike a run, the system
    continues after it has reached the target or collided. The world (obstacles, waves, random choices of the seed)
    depends on time, so the first time of a simulation must be a multiple of the control period.

    Args:
        scenario, vehicle, gains, seed, model: same meaning as for `simulate`.
        law: a law without sonar inputs; default: the law that `build_law` returns.

    Returns:
        The system, and its state at the start of the scenario. The inputs `Fu_cmd` … `Fr_cmd` [N, N m] are added to the
        law's command. The states are the 12 plant states, followed by the states of the law. The outputs are pose (4),
        body velocity (4), and the law's command (4).

    Raises:
        InputError: the law uses sonars, whose state this system does not contain; or the hull starts inside an
            obstacle; or the path is fed to the law (`Path.fed`).

    Example:
        >>> import control
        >>> import numpy as np
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.simulation import closed_loop_system, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, vehicle = load_scenario("pool-behind"), load_vehicle("sur400")
        >>> loop = closed_loop_system(mission, vehicle, gains=load_gains("default"), law=build_law("closed_form"))
        >>> t, added = np.arange(100) * 0.05, np.zeros((4, 100))
        >>> response = control.input_output_response(loop.system, t, added, loop.initial)
        >>> loop.system.output_labels[:2], response.outputs[:2, -1].round(2).tolist()
        (['x [m]', 'y [m]'], [1.6, 1.12])
    """
    if scenario.path.fed:
        raise InputError(
            f"has more than {MAX_WAYPOINTS} points, or speeds or depths for its legs, which this system does not have",
            file=scenario.source or None,
            key="path_m",
            remedy=f"give at most {MAX_WAYPOINTS} points, or use simulate",
        )
    import control  # this import takes seconds

    chosen = law or build_law(depths=scenario.depths is not None, actuators=vehicle.actuators)
    if "samples" in chosen.inputs:
        raise InputError(
            "uses sonars, but this system provides only the true positions of the obstacles",
            key="law",
            value=chosen.name,
            remedy="build the law with sonar=False",
        )
    build_world(scenario, vehicle, seed=seed)  # refuses a start inside an obstacle
    case = case_of(scenario, vehicle, gains=gains, law=chosen, model=model)
    run, thrusters = SingleRun(case, chosen, seed=seed), Thrusters.of(vehicle, chosen)
    start = np.concatenate([run.plant, run.law_state])
    plant = len(run.plant)

    def step(t: float, x: NDArray[np.float64], u: NDArray[np.float64]) -> tuple[Any, LawStep]:
        values = run.at(x[:plant], round(t / chosen.dt))
        step = chosen.step(x[plant:], values["u"], values["p"])
        return values, step._replace(tau=step.tau + u)

    def moved(t: float, x: NDArray[np.float64], u: NDArray[np.float64], params: Mapping[str, Any]) -> Any:
        values, decided = step(t, x, u)
        run.move(values, run.thrust(decided, thrusters, t, x)[0])
        return np.concatenate([values["plant_next"], decided.x_next])

    def output(t: float, x: NDArray[np.float64], u: NDArray[np.float64], params: Mapping[str, Any]) -> Any:
        return np.concatenate([x[:8], step(t, x, -np.zeros(4))[1].tau])

    thrust = labelled(THRUST_NAMES)
    system = control.nlsys(
        moved,
        output,
        inputs=[f"{name} added" for name in thrust],
        outputs=[*labelled(STATE_NAMES[:8]), *thrust],
        states=[*labelled((*STATE_NAMES, *TILT_NAMES)[:plant]), *(f"law_{k}" for k in range(len(start) - plant))],
        dt=chosen.dt,
        name=scenario.name,
    )
    return ClosedLoopSystem(system, start)
