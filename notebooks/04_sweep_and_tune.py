import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium", app_title="Sweep and tune")


@app.cell
def _():
    import marimo as mo

    return (mo,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    # Sweep and tune

    Gains are chosen by simulated runs and by the margins of the linear loop together. This notebook sweeps and tunes
    a system of your own with goals of your own, and then shows the same for the built-in robot.
    """)
    return


@app.cell
def _():
    import casadi as ca
    import numpy as np

    from surctl.ir import Layout, Port
    from surctl.system import Controller, Cost, Plant, System, simulate_system

    return (
        Controller,
        Cost,
        Layout,
        Plant,
        Port,
        System,
        ca,
        np,
        simulate_system,
    )


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 1. A system with costs

    A cart on a rail shall move to 0 with a limited force. A cost is an expression of the signals: `late` is the time
    until the cart stays within 2 cm, `peak` the largest force, with a bound of 2.5 N. The mass is a parameter of the
    plant.
    """)
    return


@app.cell
def _(Controller, Cost, Layout, Plant, Port, System, ca):
    _place, _speed = Port("place", (1,), "m", "on the rail", 1.0), Port("speed", (1,), "m/s", "of the cart")
    _force, _mass = Port("force", (1,), "N", "on the cart"), Port("mass", (1,), "kg", "of the cart", 2.0)
    _gains = (Port("k_p", (1,), "N/m", "of the place", 1.0), Port("k_d", (1,), "N s/m", "of the speed", 1.0))
    _cart = Plant(
        "cart",
        Layout((_place, _speed)),
        Layout((_force,)),
        lambda x, f, d, p: {"place": x["speed"], "speed": (f["force"] - 0.5 * x["speed"]) / p["mass"]},
        parameters=Layout((_mass,)),
    )
    _hold = Controller(
        "hold",
        0.05,
        _cart.state,
        _cart.inputs,
        lambda x, u, p: ca.fmax(-3, ca.fmin(3, -p["k_p"] * u["place"] - p["k_d"] * u["speed"])),
        gains=Layout(_gains),
    )
    _costs = {
        "late": Cost(lambda s: ca.fabs(s.x["place"]) - 0.02, "last_time", "s", "until the cart stays within 2 cm"),
        "peak": Cost(lambda s: ca.fabs(s.f["force"]), "max", "N", "largest force", at_most=2.5),
    }
    system = System(_cart, _hold, costs=_costs)
    return (system,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 2. A sweep

    `simulate_system` compiles the loop once and runs it for all rows of numbers: here 400 random gains and masses.
    The plot orders the numbers by how strongly the cost depends on them.
    """)
    return


@app.cell
def _(np, simulate_system, system):
    from surctl.report import plot_dependence

    _rng = np.random.default_rng(0)
    _values = {
        "k_p": _rng.uniform(0.5, 3, 400),
        "k_d": _rng.uniform(0.5, 6, 400),
        "plant.mass": _rng.uniform(1.5, 2.5, 400),
    }
    _runs = simulate_system(system, 15.0, _values)
    print(f"400 runs: the cart is within 2 cm after {_runs['late'].min():.1f} to {_runs['late'].max():.1f} s")
    plot_dependence(_values, _runs, "late")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. Goals, and a search

    Goals about the loop are those of MATLAB's Control System Tuner. A hard goal must hold; with soft goals, the
    largest normalised value is minimised, which is 1 at the limit. Here the first cost is minimised over two start
    positions, within the bound of the force and the hard goal about the margins. The search has a seed.
    """)
    return


@app.cell
def _(system):
    from surctl.tuning import Margins, Settling, judge_loops, operating_loops, tune_system

    ranges = {"k_p": (0.2, 20.0), "k_d": (0.2, 20.0)}
    robust = Margins(name="robust", at="force", phase_deg=60.0, kind="hard")
    tuned = tune_system(
        system, 10.0, ranges, cases={"start.place": [0.8, -0.4]}, objective="late", trials=40, goals=[robust]
    )
    print("tuned:", {name: round(value, 2) for name, value in tuned.gains.items()}, "unmet:", tuned.unmet)
    print(*tuned.lines(), sep="\n")
    judge_loops([robust], operating_loops(system, {"tuned": tuned.gains})).plot()
    return Settling, ranges, robust, tune_system


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. Goals that cannot be met together

    The search finds no gains that let the cart settle in 0.5 s with at most 2.5 N. `tune_system` does not present its
    best attempt as a solution; it names what is unmet.
    """)
    return


@app.cell
def _(Settling, ranges, robust, system, tune_system):
    _quick = Settling(name="quick", source="measured.place", end="place", at_most=0.5, kind="hard")
    _greedy = tune_system(
        system, 10.0, ranges, cases={"start.place": [0.8, -0.4]}, objective="late", trials=40, goals=[robust, _quick]
    )
    print("unmet:", ", ".join(_greedy.unmet))
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 5. The robot: where the poles go

    The velocity loops of the robot have the bandwidth `k_v`. The plot shows the closed-loop poles over this gain,
    with sampling and thrust lag. Change the cruise speed with the slider.
    """)
    return


@app.cell
def _(mo):
    cruise = mo.ui.slider(0.0, 0.2, 0.05, value=0.15, label="cruise [m/s]", show_value=True)
    cruise
    return (cruise,)


@app.cell
def _(cruise, np):
    from surctl.marine.control import load_gains
    from surctl.marine.vehicle import load_vehicle
    from surctl.marine.verification import sweep_locus
    from surctl.report import plot_locus

    robot, gains = load_vehicle("sur400"), load_gains("default")
    _values = np.linspace(0.5, 6.0, 25)
    _loops = sweep_locus(robot, gains.values, "k_v", _values, cruise=cruise.value, dt=0.05)
    plot_locus(_loops, _values, "k_v", unit="1/s", picked=gains["k_v"])
    return gains, robot


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 6. The robot: goals about runs

    `evaluate` judges gain sets by goals: here the default gains and a faster set, with a mission past a moving
    obstacle. A fast set arrives sooner, and has the smaller margin. `surctl tune` searches over all gains and
    missions, then tries to refute the choice with new runs; `surctl tune --page` opens a page with sliders.
    """)
    return


@app.cell
def _(gains, robot):
    from surctl.marine.simulation import load_scenario
    from surctl.marine.tuning import Goal, build_cases, conditions, evaluate

    _goals = (
        Goal("clear", "min_clearance_m", "m", 0.08, "at least", "hard"),
        Goal("robust", "disk_margin", "1", 0.6, "at least", "hard"),
        Goal("soon", "time_s", "s", 20.5),
    )
    _cases = build_cases([load_scenario("pool-behind")], [robot], gains=gains, law="closed_form")
    _result = evaluate(_goals, conditions(_cases, seeds=[0]), {"k_v": [gains["k_v"], 4.0]})
    for _goal, _row in zip(_goals, _result.normalised.T, strict=True):
        print(f"{_goal.name:7} {_goal.kind}: default {_row[0]:.2f}, fast {_row[1]:.2f} (1 at the limit)")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    Next: [export and processor in the loop](05_export.py). The [guide](guides/tune.md) explains how to write goals.
    """)
    return


if __name__ == "__main__":
    app.run()
