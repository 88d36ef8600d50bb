import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium", app_title="From a system to C code")


@app.cell
def _():
    import marimo as mo

    return (mo,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    # From a system to C code

    This notebook goes through the complete workflow for a system of your own: declare a plant and a controller,
    simulate them, look at the margins, prove a region of attraction, and export the controller as C. The last part
    does the same with the built-in robot. Its vehicle file declares the plant, and its control law comes from the
    library.

    surctl uses SI units and radians everywhere.
    """)
    return


@app.cell
def _():
    import casadi as ca
    import numpy as np

    from surctl.ir import Layout, Port
    from surctl.system import Controller, Plant, System, linearise, run_system

    return (
        Controller,
        Layout,
        Plant,
        Port,
        System,
        ca,
        linearise,
        np,
        run_system,
    )


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 1. Declare the system

    A plant is a differential equation of named signals with units. A controller is a function that runs once per
    control period. Both are CasADi expressions, so surctl can differentiate, compile and export them. This plant is
    an inverted pendulum with a motor of limited torque; the pendulum starts 0.3 rad from upright.
    """)
    return


@app.cell
def _(Controller, Layout, Plant, Port, System, ca):
    _angle = Port("angle", (1,), "rad", "from upright", 0.3)
    _rate = Port("rate", (1,), "rad/s", "of the angle")
    _torque = Port("torque", (1,), "N m", "of the motor")
    _gains = (Port("k_p", (1,), "N m/rad", "of the angle", 10.0), Port("k_d", (1,), "N m s/rad", "of the rate", 1.8))

    def swing(x, f, d, p):
        """Return the time derivatives of the states: 0.5 kg at the end of a massless rod of 0.7 m."""
        return {"angle": x["rate"], "rate": 14 * ca.sin(x["angle"]) + 4 * f["torque"] - 0.1 * x["rate"]}

    def balance(x, u, p):
        """Return the motor torque, at most 6 N m."""
        return ca.fmax(-6, ca.fmin(6, -p["k_p"] * u["angle"] - p["k_d"] * u["rate"]))

    plant = Plant("pendulum", Layout((_angle, _rate)), Layout((_torque,)), swing)
    law = Controller("balance", 0.01, plant.state, plant.inputs, balance, gains=Layout(_gains))
    system = System(plant, law)
    return law, system


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 2. Simulate it

    `run_system` integrates the plant between the control instants. A plot of a run has one part for each signal;
    limits that you name are drawn.
    """)
    return


@app.cell
def _(run_system, system):
    from surctl.report import plot_record

    record = run_system(system, 2.0)
    print(f"after 2 s: {record['angle'][-1, 0]:.4f} rad, largest torque {abs(record['torque']).max():.2f} N m")
    plot_record(record, limits={"torque": (-6, 6)})
    return (record,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. Look at the margins

    `linearise` returns the sampled loop at the equilibrium, with exact derivatives. Its parts are `StateSpace`
    objects of python-control. The delay margin states how late the torque may come before the loop becomes unstable.
    """)
    return


@app.cell
def _(linearise, np, system):
    from surctl.verification import system_disk_margin, system_margins

    loop = linearise(system)
    print("poles of the plant [1/s]:", np.round(loop.plant_system().poles().real, 2))
    (_m,) = system_margins(loop, "torque")
    print(f"phase margin {_m.phase_margin_deg:.0f}°, delay margin {1e3 * _m.delay_margin_s:.0f} ms")
    print(f"disk margin {system_disk_margin(loop, 'torque').guaranteed:.2f}")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. Prove a region of attraction

    From which states does the pendulum return to upright, with its limited torque and its sine? The claim names a
    Lyapunov function $V$, a level and a decay rate. surctl proves that $\dot V \le -V$ wherever $V < 0.5$, and writes
    a certificate. `check_document` checks the certificate without any code of the prover.
    """)
    return


@app.cell
def _(system):
    from surctl.certcheck import check_document
    from surctl.lyapunov import Stability, continuous_dynamics, decide_motion
    from surctl.verification.formula import parse, variable

    dynamics = continuous_dynamics(system, {"angle": (-0.8, 0.8), "rate": (-4, 4)})
    _function = parse("angle^2 + 0.13*angle*rate + 0.05*rate^2", {name: variable(name) for name in dynamics.names})
    _claim = Stability(dynamics, _function, level=0.5, rate=1.0)
    _decision = decide_motion(_claim)
    print(f"{_decision.verdict}; the checker accepts it: {check_document(dict(_decision.document)).accepted}")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 5. Export the controller

    surctl writes the controller as C99 without heap memory. This cell compiles the C and lets it replay the run on
    its own state; each step is compared with Python. Then each state, input and gain in turn is set to NaN.
    """)
    return


@app.cell
def _(law, record):
    from surctl.export import software_in_the_loop

    print(software_in_the_loop(law, record).summary())
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 6. The built-in robot, in the same steps

    A vehicle file states mass, drag and thrust with their sources, and declares the plant. A scenario file states the
    path and the obstacles. A control law of the library takes the place of `balance`: it turns tasks in order of
    priority into thrust. The vehicle linearises to a `StateSpace` too.
    """)
    return


@app.cell
def _():
    from surctl.marine.control import build_law, load_gains
    from surctl.marine.report import plot_run
    from surctl.marine.simulation import load_scenario, simulate
    from surctl.marine.vehicle import linearise as linearise_vehicle
    from surctl.marine.vehicle import load_vehicle

    _robot, _mission = load_vehicle("sur400"), load_scenario("pool-behind")
    _cruise = linearise_vehicle(_robot, [0.15, 0, 0, 0])
    print("inputs:", ", ".join(_cruise.input_labels), "- states:", ", ".join(_cruise.state_labels))
    run = simulate(_mission, _robot, gains=load_gains("default"), law=build_law("closed_form"), sensing="truth")
    print(f"{_mission.name}: {run.metrics.stopped_because} after {run.metrics.time_s:.2f} s")
    plot_run(run)
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## Next

    | to | read |
    |---|---|
    | describe a plant or a vehicle | [plants and vehicles](01_plants_and_vehicles.py) |
    | combine tasks and limits | [priorities](02_priorities.py) |
    | decide claims of your own | [which stability claims hold](03_stability_claims.py) |
    | choose gains | [sweep and tune](04_sweep_and_tune.py) |
    | export and check C | [export](05_export.py) |
    | write a law for a vehicle | [a law of your own](06_your_own_law.py) |
    """)
    return


if __name__ == "__main__":
    app.run()
