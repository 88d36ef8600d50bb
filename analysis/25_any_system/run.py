"""Study 25: a closed loop of one's own, simulated by surctl, scipy and python-control to the same accuracy.

    python analysis/25_any_system/run.py            # two minutes
    python analysis/25_any_system/run.py --quick    # fewer and shorter runs; speed is not judged

Prints Markdown. Processor time of a run on one thread; contenders take turns. Status 0 if every bar holds, else 1.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import median

import casadi as ca
import control
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from surctl.ir import Layout, Port
from surctl.system import Action, Controller, Plant, System, linearise, simulate_system

Array = NDArray[np.float64]

LEAST_RATIO = 1000.0
MOST_ERROR = 1e-6  # largest difference of a final state from a solution with tolerance 1e-11


@dataclass(frozen=True)
class Case:
    """A system, its right-hand side and law in NumPy, where it starts and for how long it runs."""

    name: str
    system: System
    rate: Callable[[Array, Array], Array]
    law: Callable[[Array, Array], tuple[Array, Array]]
    start: Array
    seconds: float


def pendulum() -> Case:
    """A pendulum about its upper rest with saturated linear-quadratic feedback."""
    k_angle, k_rate = np.asarray(control.lqr([[0, 1], [9.81, -0.1]], [[0], [1]], np.eye(2), [[1]])[0])[0]
    angle, rate = Port("angle", (1,), "rad", "from upright"), Port("rate", (1,), "rad/s", "angular rate")
    torque = Port("torque", (1,), "N m", "at the pivot")
    plant = Plant(
        "pendulum", Layout((angle, rate)), Layout((torque,)),
        lambda x, f, d, p: {"angle": x["rate"], "rate": 9.81 * ca.sin(x["angle"]) - 0.1 * x["rate"] + f["torque"]},
    )  # fmt: skip
    law = Controller(
        "state_feedback", 0.02, Layout((angle, rate)), Layout((torque,)),
        lambda x, u, p: ca.fmax(-5, ca.fmin(5, -p["k_angle"] * u["angle"] - p["k_rate"] * u["rate"])),
        gains=Layout(
            (Port("k_angle", (1,), "N m", "", float(k_angle)), Port("k_rate", (1,), "N m s", "", float(k_rate)))
        ),
    )  # fmt: skip
    return Case(
        "pendulum, 2 states",
        System(plant, law, substeps=2),
        lambda x, f: np.array([x[1], 9.81 * np.sin(x[0]) - 0.1 * x[1] + f[0]]),
        lambda x, z: (np.clip([-k_angle * x[0] - k_rate * x[1]], -5, 5), z),
        np.array([0.4, 0.0]),
        2.0,
    )


_M = np.array([[25.8, 0, 0], [0, 33.8, 1.0948], [0, 1.0948, 2.76]])
_THRUSTERS = np.array([[1.0, 1, 0, 0], [0, 0, 1, 1], [-0.1, 0.1, 0.5, -0.5]])
_MOST = np.array([2.0, 2.0, 1.0, 1.0])


def ship() -> Case:
    """CyberShip II (Skjetne, Smogeli and Fossen 2004) held at a place by proportional-integral-derivative control.

    Its inertia matrix, Coriolis terms and damping are coupled; four assumed thrusters with limits.
    """
    eta, nu = Port("eta", (3,), "m, m, rad", "place in {n}"), Port("nu", (3,), "m/s, m/s, rad/s", "velocity in {b}")
    thrust = Port("thrust", (4,), "N", "of the thrusters")
    inverse, spread = np.linalg.inv(_M), np.linalg.pinv(_THRUSTERS)

    def dynamics(eta: ca.SX, nu: ca.SX, force: ca.SX) -> tuple[ca.SX, ca.SX]:
        u, v, r = ca.vertsplit(nu)
        c13, c23 = -33.8 * v - 1.0948 * r, 25.8 * u
        coriolis = ca.vertcat(c13 * r, c23 * r, -c13 * u - c23 * v)
        damping = ca.vertcat(
            (0.72253 + 1.32742 * ca.fabs(u) + 5.86643 * u * u) * u,
            (0.88965 + 36.47287 * ca.fabs(v) + 0.805 * ca.fabs(r)) * v
            + (7.25 + 0.845 * ca.fabs(v) + 3.45 * ca.fabs(r)) * r,
            (-0.0313 - 3.95645 * ca.fabs(v) - 0.13 * ca.fabs(r)) * v
            + (1.9 - 0.08 * ca.fabs(v) + 0.75 * ca.fabs(r)) * r,
        )
        c, s = ca.cos(eta[2]), ca.sin(eta[2])
        moved = ca.vertcat(c * u - s * v, s * u + c * v, r)
        return moved, ca.mtimes(ca.DM(inverse), ca.mtimes(ca.DM(_THRUSTERS), force) - coriolis - damping)

    def ode(x: dict[str, ca.SX], f: dict[str, ca.SX], d: object, p: object) -> dict[str, ca.SX]:
        return dict(zip(("eta", "nu"), dynamics(x["eta"], x["nu"], f["thrust"]), strict=True))

    def command(eta: ca.SX, nu: ca.SX, total: ca.SX) -> tuple[ca.SX, ca.SX]:
        c, s = ca.cos(eta[2]), ca.sin(eta[2])
        error = ca.vertcat(c * eta[0] + s * eta[1], -s * eta[0] + c * eta[1], eta[2])
        wrench = -(0.15 * error + 0.6 * nu) * ca.DM([25, 33, 2.7]) - total
        return ca.fmax(-ca.DM(_MOST), ca.fmin(ca.DM(_MOST), ca.mtimes(ca.DM(spread), wrench))), error

    def law(x: dict[str, ca.SX], u: dict[str, ca.SX], p: object) -> Action:
        force, error = command(u["eta"], u["nu"], x["total"])
        return Action(force, {"total": x["total"] + 0.05 * 0.5 * error})

    plant = Plant("ship", Layout((eta, nu)), Layout((thrust,)), ode)
    total = Layout((Port("total", (3,), "N, N, N m", "integral action"),))
    hold = Controller("hold", 0.05, Layout((eta, nu)), Layout((thrust,)), law, state=total)
    x, f, z = ca.SX.sym("x", 6), ca.SX.sym("f", 4), ca.SX.sym("z", 3)
    fast = ca.Function("rate", [x, f], [ca.vertcat(*dynamics(x[:3], x[3:], f))])
    force, error = command(x[:3], x[3:], z)
    act = ca.Function("act", [x, z], [force, z + 0.05 * 0.5 * error])
    return Case(
        "CyberShip II, 6 states, integral, 4 thrusters",
        System(plant, hold, substeps=2),
        lambda x, f: np.array(fast(x, f)).ravel(),
        lambda x, z: tuple(np.array(v).ravel() for v in act(x, z)),  # type: ignore[return-value]
        np.array([1.0, -0.5, 0.4, 0, 0, 0]),
        30.0,
    )


def by_scipy(case: Case, rtol: float) -> Array:
    """Final state by `solve_ivp`, period by period with the command held."""
    x, z, dt = case.start, np.zeros(case.system.controller.state.size), case.system.dt
    for _ in range(round(case.seconds / dt)):
        f, z = case.law(x, z)
        x = solve_ivp(lambda _, y, f=f: case.rate(y, f), (0, dt), x, rtol=rtol, atol=rtol / 10).y[:, -1]
    return x


def by_control(case: Case, rtol: float) -> Array:
    """Final state by python-control: the plant as a nonlinear system, `input_output_response` for each period."""
    n, m = len(case.start), case.system.plant.inputs.size
    plant = control.nlsys(lambda t, x, u, p: case.rate(x, u), None, inputs=m, states=n, outputs=n)
    x, z, dt = case.start, np.zeros(case.system.controller.state.size), case.system.dt
    for _ in range(round(case.seconds / dt)):
        f, z = case.law(x, z)
        span = np.array([0.0, dt])
        held = np.tile(f[:, None], 2)
        options = {"rtol": rtol, "atol": rtol / 10}
        x = control.input_output_response(plant, span, held, x, solve_ivp_kwargs=options).states[:, -1]
    return x


def measure(case: Case, *, runs: int, rounds: int) -> list[tuple[str, float, float]]:
    """(contender, processor time of a run [s], largest error of the final state), each the median of its turns."""
    exact = by_scipy(case, 1e-11)
    simulate_system(case.system, case.seconds)  # compiled once, before the clock runs
    values = {"start." + port.name: np.tile(case.start[case.system.plant.state.slice(port.name)], (runs, 1))
              for port in case.system.plant.state}  # fmt: skip
    contenders: dict[str, Callable[[], Array]] = {
        "surctl": lambda: simulate_system(case.system, case.seconds, values).state[-1],
        "scipy `solve_ivp`": lambda: by_scipy(case, 1e-7),
        "python-control `input_output_response`": lambda: by_control(case, 1e-7),
    }
    spent: dict[str, list[float]] = {name: [] for name in contenders}
    errors = dict.fromkeys(contenders, 0.0)
    for _ in range(rounds):
        for name, contender in contenders.items():
            began = time.process_time()
            final = contender()
            spent[name].append((time.process_time() - began) / (runs if name == "surctl" else 1))
            errors[name] = max(errors[name], float(np.abs(final - exact).max()))
    return [(name, median(times), errors[name]) for name, times in spent.items()]


def main() -> int:
    """Print the table and the bars; 1 if one is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="256 shorter runs and one round instead of 4,096 and five")
    quick = parser.parse_args().quick
    warnings.simplefilter("ignore")
    good = True
    print("| system | contender | processor time of a run | of a simulated second | error | times surctl |")
    print("|---|---|---|---|---|---|")
    for case in (pendulum(), ship()):
        if quick:
            case = replace(case, seconds=case.seconds / 10)
        figures = measure(case, runs=256 if quick else 4096, rounds=1 if quick else 5)
        own = figures[0][1]
        for name, seconds, error in figures:
            ratio = seconds / own
            print(
                f"| {case.name} | {name} | {1e3 * seconds:.4g} ms | {1e6 * seconds / case.seconds:.3g} µs "
                f"| {error:.1e} | {ratio:,.0f} |"
            )
            good = good and error <= MOST_ERROR and (quick or name == "surctl" or ratio >= LEAST_RATIO)
        poles = np.abs(linearise(case.system).poles())
        print(f"| | linearised, sampled | | | | largest pole {poles.max():.4f} |")
    bars = f"Every contender within {MOST_ERROR:g} of the exact solution"
    bars += "" if quick else f", surctl at least {LEAST_RATIO:,.0f} times as fast"
    print(f"\n{bars}: {'met' if good else '**missed**'}.")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
