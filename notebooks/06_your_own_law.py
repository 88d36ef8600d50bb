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
    # A law of your own for a vehicle

    A control law for a vehicle is a function that returns tasks in order of priority. surctl adds the priority solver
    with its limits, the velocity control, the perception and the export. This notebook writes a law that follows a
    wall, simulates it, and asks which task or limit was active when. The last part looks at the built-in law in the
    same way.
    """)
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 1. The law

    `decide` gets the symbols of one control step and returns the tasks, highest priority first. `GAINS` are the law's
    own gains, with units and ranges. The same file works with each command: `surctl simulate MISSION --law
    wall_law.py:wall`.
    """)
    return


@app.cell
def _():
    import tempfile
    from pathlib import Path
    from textwrap import dedent

    from surctl.marine.control import build_law, law_ref, law_source, load_gains

    _text = """
    import casadi as ca

    from surctl.marine.control import Decision, GainSpec, LawSource
    from surctl.tasks import Task, depth_task, heading_task

    GAINS = {
        "k_wall": GainSpec("1/s", "gain of the distance to the wall", default=0.4, range=(0.1, 1.5)),
        "stand_off": GainSpec("m", "distance of the robot's centre from the wall", default=0.8, range=(0.6, 1.2)),
    }


    def decide(s):
        x, y = s.eta[0], s.eta[1]
        off, gain = s.p["stand_off"], s.p["k_wall"]
        keep = Task(name="distance", eta=s.eta, sigma=y, target=off, gain=gain, unit="m", kinematics="vehicle")
        speed = ca.fmin(s.p["cruise"], s.p["k1"] * (s.p["waypoints"][-1, 0] - x))
        along = Task(name="along", eta=s.eta, sigma=x, target=x, rate=speed, unit="m", kinematics="vehicle")
        facing = heading_task(s.eta, -ca.pi / 2, gain=s.p["k_psi"])
        return Decision([keep, along, facing, depth_task(s.eta, s.p["depth"], gain=s.p["k2"])])


    def wall():
        return LawSource("wall_follower", decide, gains=GAINS)
    """
    folder = Path(tempfile.mkdtemp())
    (folder / "wall_law.py").write_text(dedent(_text), encoding="utf-8")
    reference = law_ref("wall_law.py:wall", folder=folder)
    law, gains = build_law(reference, mode="projected"), load_gains("default").with_own(law_source(reference).gains)
    print(f"{law_source(reference).name}: own gains {', '.join(law_source(reference).gains)}")
    return build_law, gains, law, load_gains


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 2. Simulate it

    The mission is a straight path along the wall y = 0, which begins 0.3 m too far from it.
    """)
    return


@app.cell
def _(gains, law):
    from dataclasses import replace

    from surctl.marine.guidance import Path as Route
    from surctl.marine.report import plot_run
    from surctl.marine.simulation import load_scenario, simulate
    from surctl.marine.vehicle import load_vehicle

    tank, robot = load_scenario("tank-static"), load_vehicle("sur540-flooded")
    _along = Route([[1.0, 1.1], [4.0, 0.8]])
    mission = replace(tank, name="wall", obstacles=(), path=_along, time_limit=60.0)
    run = simulate(mission, robot, gains=gains, law=law)
    print(f"{run.metrics.stopped_because} after {run.metrics.time_s:.1f} s")
    plot_run(run)
    return load_vehicle, robot, run


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. Which task or limit was active when?

    The timeline solves the priority problem of each step again. It shows how much each task gave up over time, and
    which limit was the cause.
    """)
    return


@app.cell
def _(run):
    from surctl.marine.report import plot_priority
    from surctl.marine.report.signals import relaxation_text
    from surctl.marine.simulation import priority_timeline

    _timeline = priority_timeline(run)
    print(relaxation_text(_timeline))
    plot_priority(_timeline, title="wall_follower along a wall")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. Its margins

    `steady_motion` finds the steadiest 2 s of the run, and `law_loop` linearises the sampled law there, whatever the
    law is. The result has the same margins as any other linear loop.
    """)
    return


@app.cell
def _(gains, law, robot, run):
    from surctl.marine.verification import law_loop, steady_motion

    _loop = law_loop(law, robot, gains, cruise=0.15, at=steady_motion(run))
    _least = min(_loop.margins, key=lambda m: m.disk_margin)
    print(f"stable: {_loop.stable}, least disk margin {_least.disk_margin:.2f} ({_least.name})")
    return (law_loop,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 5. The built-in law, looked at in the same way

    `closed_form` is a law of the library. It is a `LawSource` too, so each step above works with it.
    """)
    return


@app.cell
def _(build_law, law_loop, load_gains, load_vehicle):
    _own = build_law("closed_form")
    _loop = law_loop(_own, load_vehicle("sur400"), load_gains("default"), cruise=0.15)
    _least = min(_loop.margins, key=lambda m: m.disk_margin)
    print(f"closed_form: {len(_own.levels)} levels, stable: {_loop.stable}, least disk margin {_least.disk_margin:.2f}")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    `surctl sweep`, `tune` and `export` take the law too: see the guide [your own law](guides/own-law.md). For a plant
    that is no vehicle, see [from a system to C code](00_from_system_to_code.py).
    """)
    return


if __name__ == "__main__":
    app.run()
