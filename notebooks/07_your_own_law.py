import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium", app_title="A law of your own")


@app.cell
def _():
    import marimo as mo

    return (mo,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    # A law of your own, and a plant of your own

    The first half writes a control law for the underwater robot: it follows a wall with four prioritised tasks. The
    second half describes another plant, a cart, with a controller of its own. Both are simulated, tuned and exported as
    C. It takes about a minute.

    ## 1. A law is a function from a situation to tasks
    """)
    return


@app.cell
def _():
    import tempfile
    from pathlib import Path
    from textwrap import dedent

    from surctl.control import law_ref, law_source

    folder = Path(tempfile.mkdtemp())
    text = """
    import casadi as ca

    from surctl.control import Decision, GainSpec, LawSource
    from surctl.tasks import Task, depth_task, heading_task

    GAINS = {
        "k_wall": GainSpec("1/s", "gain of the distance to the wall", default=0.4, range=(0.1, 1.5)),
        "stand_off": GainSpec("m", "distance of the robot's centre from the wall", default=0.8, range=(0.6, 1.2)),
    }


    def decide(s):
        x, y = s.eta[0], s.eta[1]
        keep = Task(name="distance", eta=s.eta, sigma=y, target=s.p["stand_off"], gain=s.p["k_wall"], unit="m")
        speed = ca.fmin(s.p["cruise"], s.p["k1"] * (s.p["waypoints"][-1, 0] - x))
        along = Task(name="along", eta=s.eta, sigma=x, target=x, rate=speed, unit="m")
        facing = heading_task(s.eta, -ca.pi / 2, gain=s.p["k_psi"])
        return Decision([keep, along, facing, depth_task(s.eta, s.p["depth"], gain=s.p["k2"])])


    def wall():
        return LawSource("wall_follower", decide, gains=GAINS)
    """
    (folder / "wall_law.py").write_text(dedent(text), encoding="utf-8")
    reference = law_ref("wall_law.py:wall", folder=folder)
    print(f"{law_source(reference).name}: own gains {', '.join(law_source(reference).gains)}")
    return folder, reference


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    The public check builds the law twice, evaluates it at random poses, and compares the instruction list, which is
    simulated and exported, with CasADi.

    ## 2. Simulate, and sweep its own gains in compiled code
    """)
    return


@app.cell
def _(reference):
    from dataclasses import replace

    import numpy as np

    from surctl.control import build_law, load_gains
    from surctl.control import law_source as _source
    from surctl.guidance import Path as Route
    from surctl.simulation import Case, load_scenario, simulate, simulate_batch
    from surctl.testing import check_law
    from surctl.vehicle import load_vehicle

    print(f"checked at {check_law(_source(reference)).samples} points")
    tank = load_scenario("tank-static")
    mission = replace(tank, name="wall", obstacles=(), path=Route([[1.0, 0.8], [4.0, 0.8]]), time_limit=60.0)
    robot, gains, law = load_vehicle("sur540-flooded"), load_gains("default"), build_law(reference)
    run = simulate(mission, robot, gains=gains, law=law)
    print(f"{run.metrics.stopped_because} after {run.metrics.time_s:.1f} s")
    case = Case(mission, robot, gains, reference)
    offs = np.linspace(0.7, 1.0, 7)
    runs = simulate_batch(case, {"stand_off": offs}, seeds=np.zeros(7, dtype=np.int64))
    print("least clearance [m]:", np.round(runs.column("min_clearance_m"), 2))
    return law, np, run


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. Export it, and compare the C with Python at each step of the run
    """)
    return


@app.cell
def _(law, run):
    from surctl.export import Records, software_in_the_loop

    _record = run.record
    print(software_in_the_loop(law, Records(_record.law_state, _record.law_input, _record.law_parameters)).summary())
    return Records, software_in_the_loop


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. Another plant: a cart on a rail

    `surctl.system` knows no robot. A plant is a differential equation in named ports with units, a controller a sampled
    function; costs are expressions of the signals. `at_most` bounds a cost.
    """)
    return


@app.cell
def _():
    import casadi as ca

    from surctl.ir import Layout, Port
    from surctl.system import Controller, Cost, Plant, System

    place, speed = Port("place", (1,), "m", "on the rail", 1.0), Port("speed", (1,), "m/s", "of the cart")
    force = Port("force", (1,), "N", "on the cart")
    cart = Plant(
        "cart",
        Layout((place, speed)),
        Layout((force,)),
        lambda x, f, d, p: {"place": x["speed"], "speed": (f["force"] - 0.5 * x["speed"]) / p["mass"]},
        parameters=Layout((Port("mass", (1,), "kg", "of the cart", 2.0),)),
    )
    hold = Controller(
        "hold",
        0.05,
        Layout((place, speed)),
        Layout((force,)),
        lambda x, u, p: ca.fmax(-3, ca.fmin(3, -p["k_p"] * u["place"] - p["k_d"] * u["speed"])),
        gains=Layout((Port("k_p", (1,), "N/m", "of the place", 1.0), Port("k_d", (1,), "N s/m", "of the speed", 1.0))),
    )
    system = System(
        cart,
        hold,
        costs={
            "late": Cost(lambda s: ca.fabs(s.x["place"]) - 0.02, "last_time", "s", "until the cart stays within 2 cm"),
            "peak": Cost(lambda s: ca.fabs(s.f["force"]), "max", "N", "largest force", at_most=2.5),
        },
    )
    return (system,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 5. Tune it, look at its margins, export it
    """)
    return


@app.cell
def _(Records, np, software_in_the_loop, system):
    from surctl.system import linearise, run_system
    from surctl.tuning import tune_system
    from surctl.verification import system_disk_margin, system_margins

    tuned = tune_system(
        system, 10.0, {"k_p": (0.2, 20.0), "k_d": (0.2, 20.0)}, cases={"start.place": [1.0, -0.4]}, trials=300
    )
    print(f"late: {tuned.before['late']:.2f} s before, {tuned.costs['late']:.2f} s tuned, unmet: {tuned.unmet}")
    _linear = linearise(system, tuned.gains)
    (_margins,) = system_margins(_linear, "force")
    print(f"phase margin {_margins.phase_margin_deg:.0f} deg, disk margin {system_disk_margin(_linear).guaranteed:.2f}")
    record = run_system(system, 10.0, tuned.gains)
    print(software_in_the_loop(system.controller, Records(*record.controller)).summary().splitlines()[0])
    assert np.isfinite(record["late"])
    return


if __name__ == "__main__":
    app.run()
