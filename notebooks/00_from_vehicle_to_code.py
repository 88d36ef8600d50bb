import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium", app_title="From a vehicle file to C code")


@app.cell
def _():
    import marimo as mo

    return (mo,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    # From a vehicle file to C code

    This notebook shows the complete workflow for one robot in about 20 s: read a vehicle, linearise it, stack tasks,
    add limits, refute a claim of the paper, simulate a mission, sweep two gains, and export the controller as C.

    Frames: world {E} has x along the tank, y to the left, z **up**; body {B} has x forward, y left, z up; ψ is
    counter-clockwise. The pose is η = (x, y, z, ψ), the velocity in {B} is ν = (u, v, w, r), and the thrust is τ.
    Units are SI units and radians.
    """)
    return


@app.cell
def _():
    import tempfile
    from pathlib import Path

    import casadi as ca
    import matplotlib.pyplot as plt
    import numpy as np

    return Path, ca, np, plt, tempfile


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 1. A vehicle file gives the source of each number

    The paper prints only a mass in air and a diameter. Every other number of its robot is derived or chosen, and the
    file states which; a table without `provenance` is an error. A range gives the plausible values of a number.
    """)
    return


@app.cell
def _(mo):
    from surctl.vehicle import linearise, load_vehicle, steady_speed

    vehicle = load_vehicle("sur540-flooded")
    _lines = ["| | value | unit | range | provenance |", "|---|---|---|---|---|"]
    for _name in ("radius", "m11", "m44", "Xuu", "Fu_max"):
        _p = vehicle.parameters[_name]
        _range = "–" if _p.range is None else f"{_p.range[0]:g} … {_p.range[1]:g}"
        _lines.append(f"| {_name} | {_p.value:g} | {_p.unit} | {_range} | {_p.provenance} |")
    mo.md("\n".join(_lines))
    return linearise, load_vehicle, steady_speed, vehicle


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    The top speed follows from the drag $X_u u + X_{uu} u^2$ and 5 N of thrust. The stopping distance follows from
    95 kg of mass and 5 N of thrust. It is long, since the robot is heavy: a law that ignores the inertia collides.
    """)
    return


@app.cell
def _(np, steady_speed, vehicle):
    top_speed = steady_speed(vehicle["Fu_max"], vehicle["Xu"], vehicle["Xuu"])
    u = np.linspace(0.0, 0.22, 221)
    braking = vehicle["Fu_max"] + vehicle["Xu"] * u + vehicle["Xuu"] * u**2
    stopping = np.trapezoid(vehicle["m11"] * u / braking, u)
    print(f"steady speed at full thrust: {top_speed:.3f} m/s")
    print(f"stopping distance from 0.22 m/s, full thrust and drag, no lag: {stopping:.2f} m")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    `linearise` returns a python-control `StateSpace` about trimmed motion, with named signals. The surge channel has
    two poles: one from the drag at 0.15 m/s, and one from the thrust lag of 0.3 s.
    """)
    return


@app.cell
def _(linearise, np, vehicle):
    plant = linearise(vehicle, np.array([0.15, 0.0, 0.0, 0.0]))
    surge = plant["u", "Fu_cmd"]
    print("inputs:", ", ".join(plant.input_labels))
    print("states:", ", ".join(plant.state_labels))
    rates = np.linalg.eigvals(plant.A[np.ix_([4, 8], [4, 8])])
    print("surge poles [1/s]:", np.round(np.sort(rates.real), 4))
    print(f"surge speed per newton at 0.1 rad/s: {abs(surge(0.1j)):.3f} m/s")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 2. Three tasks, one velocity

    A task is any CasADi expression σ(η) with a target and a gain; surctl computes its Jacobian by differentiation.
    The order of the tasks is their priority. The three tasks here are: keep 0.8 m away from a buoy, go to a waypoint,
    look at the buoy. The first task is written by hand; the other two come from the library.
    """)
    return


@app.cell
def _(ca):
    from surctl.tasks import Stack, Task, VelocityBox, line_of_sight_task, position_task

    eta = ca.SX.sym("eta", 4)
    buoy = [1.0, 0.3]
    keep_off = Task(name="keep_off", eta=eta, sigma=ca.norm_2(eta[:2] - ca.DM(buoy)), target=0.8, gain=0.5)
    go = position_task(eta, [2.0, 0.0], gain=0.2, name="go")
    look = line_of_sight_task(eta, buoy, gain=0.6, name="look")
    stack = Stack((keep_off, go, look))
    return VelocityBox, eta, stack


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    At a given pose the stack becomes numerical data: one level $J_i\,\nu = \dot\sigma_{i,d} + K_i\tilde\sigma_i$ for
    each task, and rows that limit ν. You can print the problem before you solve it.
    """)
    return


@app.cell
def _():
    from surctl.priority import Level, Row, build_problem, solve

    return Level, Row, build_problem, solve


@app.cell
def _(Level, ca, eta, np):
    def level_at(task, pose):
        """Return the Jacobian and the reference of a task at a pose as arrays."""
        values = ca.Function("level", [eta], [task.jacobian(), task.reference()])(pose)
        return Level(task.name, *(np.array(value) for value in values))

    return (level_at,)


@app.cell
def _(Row, VelocityBox, build_problem, ca, level_at, np, stack):
    box = VelocityBox([-0.1, -0.1, -0.1, -0.3], [0.1, 0.1, 0.1, 0.3])
    rows = [Row(r.name, r.kind, np.array(ca.DM(r.a)), float(r.lower), float(r.upper)) for r in box.rows()]
    pose = [0.4, 0.0, -0.15, 0.0]
    problem = build_problem([level_at(task, pose) for task in stack.tasks], rows)
    print(problem)
    return (problem,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    The paper's law (16), null-space-based behaviours (`nsb`), ignores limits. The mode `projected` makes the same sweep
    of projections, but a QP keeps the velocity within the limits. If no limit binds, it equals (16). Otherwise
    `explain()` names **which task is not fulfilled, by how much, and which limit is the cause**. Here the first task
    is fulfilled completely, and the lower tasks are not.
    """)
    return


@app.cell
def _(np, problem, solve):
    for _mode in ("nsb", "projected"):
        _solution = solve(problem, mode=_mode)
        print(f"{_mode:<10} nu = {np.round(_solution.v, 4)}")
        print(f"{'':<10} residuals: { ({k: round(r, 4) for k, r in _solution.residuals.items()}) }")
        print(f"{'':<10} {_solution.explain()}\n")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. A claim of the paper, refuted

    For its tracking law the paper uses $V_1 = \tfrac12(x_e^2 + y_e^2 + z_e^2)$ and claims $\dot V_1 \le 0$ everywhere.
    A claim is an inequality over a box of variables. The falsifier samples the box, and then increases the violation
    along exact gradients. It can only refute a claim. If it finds no counterexample, its verdict is `not refuted`,
    which is not a proof.
    """)
    return


@app.cell
def _():
    from surctl.verification import claims, falsify, replay

    for _claim in claims(names=["v1-printed", "v1-corrected"]):
        _verdict = falsify(_claim, samples=1024)
        print(f"{_claim.name}: {_verdict.verdict}\n  says: {_claim.statement}")
        if _verdict.counterexample is None:
            print(f"  {_verdict.remaining}")
        else:
            refuted, counterexample = _claim, _verdict.counterexample
            print(f"  fails at {counterexample.values}: margin {counterexample.margin:.3g} {_claim.unit}")
    return counterexample, refuted, replay


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    A simulation of the kinematic loop confirms the counterexample. At this point the surge command $(U_d - k_1
    x_e)\sqrt{y_e^2 + \Delta^2}/\Delta$ is negative, the robot moves backwards, and $V_1$ grows.
    """)
    return


@app.cell
def _(counterexample, plt, refuted, replay):
    confirmation = replay(refuted, counterexample)
    _first, _last = confirmation.watched[0], confirmation.watched[-1]
    print(f"confirmed: {confirmation.confirmed}; {confirmation.name} {_first:.3g} -> {_last:.3g} {confirmation.unit}")
    _, _ax = plt.subplots(figsize=(6.0, 2.6), layout="constrained")
    _ax.plot(confirmation.time, confirmation.watched)
    _ax.set_xlabel("time [s]")
    _ax.set_ylabel(f"{confirmation.name} [{confirmation.unit}]")
    _ax.grid(visible=True, alpha=0.4)
    _ax
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. Simulate a mission

    `pool-static` is the paper's pool with four drifting cylinders. The robot is a hull of 0.40 m diameter that fits
    the gaps. With `sensing="truth"` the law gets the true positions. Missions with the four sonars are harder: see
    `surctl simulate pool-static --sensing sonar`. The seed determines drift and waves.
    """)
    return


@app.cell
def _(load_vehicle):
    from surctl.control import build_law, load_gains
    from surctl.simulation import load_scenario, simulate

    scenario = load_scenario("pool-static")
    robot = load_vehicle(scenario.vehicle)
    law = build_law()
    gains = load_gains("default")
    run = simulate(scenario, robot, gains=gains, law=law, sensing="truth", seed=0)
    print(f"{run.metrics.stopped_because} at {run.metrics.time_s:.2f} s (paper: about {scenario.paper.time_s:g} s)")
    return gains, law, robot, run, scenario, simulate


@app.cell
def _(plt, run):
    from surctl.report import plot_run

    plot_run(run, ax=plt.subplots(figsize=(8.0, 6.6), layout="constrained")[1])
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    Check the definition of a metric before you use it. The least clearance is the minimum over the whole run, and this
    run *starts* with the hull 0.05 m from two walls: no gain can increase this minimum. The path error omits
    avoidance, from the avoidance command until the robot is back within 0.10 m of its path. In this run the robot is
    rarely that close to its path.
    """)
    return


@app.cell
def _(run, scenario):
    from surctl.simulation.metrics import avoidance_intervals

    away = scenario.follower().track(run.record.eta[:, :2])
    left_out = avoidance_intervals(run.telemetry("avoiding")[:, 0], away)
    print(f"clearance: {run.record.clearance[0]:.3f} m at the start, {run.metrics.min_clearance_m:.3f} m at the least")
    print(f"path error: {run.metrics.path_error_m:.3f} m, taken over {100 * (1 - left_out.mean()):.1f} % of the steps")
    print(f"largest distance to the path, avoidance included: {away.max():.2f} m")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 5. Sweep two gains

    This sweep has only four points. For each point surctl simulates the mission and computes the loop margins. A point
    is feasible if the robot arrives without a collision, with a delay margin of at least 0.2 s and a disk margin of at
    least 0.6. The sweep picks the feasible point with the smallest score. The score is the deviation from the path
    over the whole run, in hull radii, plus the ratio of the time to the ideal time. The score does not use the path
    error, since the path error omits avoidance, and the gains change the duration of avoidance. `lookahead` is the
    distance ahead on the path at which the robot aims; `k_v` is the bandwidth of its velocity loops. The study
    `analysis/02_gain_sweep` sweeps 30 points in four scenarios, and shows that the best points differ little.
    """)
    return


@app.cell
def _(gains, robot, scenario):
    from surctl.simulation import Case
    from surctl.tuning import Axis, grid, sweep

    _design = grid([Axis("lookahead", (0.6, 1.2)), Axis("k_v", (1.0, 2.0))])
    swept = sweep([Case(scenario, robot, gains)], _design)
    print("lookahead  k_v   deviation   clearance       delay        disk       score")
    for _i, _lookahead in enumerate(swept.axes[0].values):
        for _j, _k_v in enumerate(swept.axes[1].values):
            _names = ("deviation_m", "min_clearance_m_worst", "delay_margin_s", "disk_margin", "score")
            _row = "  ".join(f"{swept.column(n)[_i, _j]:10.4f}" for n in _names)
            print(f"{_lookahead:9g}  {_k_v:3g}  {_row}{'   <- picked' if (_i, _j) == swept.picked else ''}")
    print(swept.gains.provenance)
    return (swept,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 6. Export the simulated law, and check it

    The controller is one symbolic object. surctl lowers the simulated law to an instruction list and writes it as
    C99 without heap, with standard headers only. A guard turns any NaN into zero thrust and a negative status, and the
    code contains a self-test. The law of this notebook gets all positions as inputs. The command `surctl export`
    exports the law with sonars by default; `--sensing truth` exports the law of this notebook.
    """)
    return


@app.cell
def _(Path, law, robot, scenario, simulate, swept, tempfile):
    from surctl.export import Records, build_bundle, software_in_the_loop, write_bundle

    final = simulate(scenario, robot, gains=swept.gains, law=law, sensing="truth", seed=0)
    bundle = build_bundle(law, law.gains.unpack(final.record.law_parameters))
    with tempfile.TemporaryDirectory() as _folder:
        for _file in write_bundle(bundle, Path(_folder, bundle.name)):
            print(f"{_file.sha256[:12]}  {_file.path.stat().st_size:>7} bytes  {_file.path.name}")
    return Records, final, software_in_the_loop


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    Software in the loop: this cell compiles the C and loads the first state. The C then steps **on its own state**
    through the whole recorded run, and each step is compared with Python. Then each state, input and gain in turn is
    set to NaN. This cell needs a C compiler.
    """)
    return


@app.cell
def _(Records, final, law, software_in_the_loop):
    record = final.record
    report = software_in_the_loop(law, Records(record.law_state, record.law_input, record.law_parameters))
    print(report.summary())
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## Where to go from here

    - For your own robot, run `surctl list --show sur540-flooded > my-vehicle.toml`, edit the file, and run `surctl
      study my-vehicle.toml`.
    - For your own mission, write a scenario file; `surctl lint my-scenario.toml` reports problems before you simulate
      it.
    - `analysis/01_two_claims` is the full study of the claims, `analysis/02_gain_sweep` that of the sweep.
    """)
    return


if __name__ == "__main__":
    app.run()
