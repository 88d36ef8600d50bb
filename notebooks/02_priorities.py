import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium", app_title="Priorities")


@app.cell
def _():
    import marimo as mo

    return (mo,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    # Priorities: null-space-based behaviours with and without limits

    Several tasks compete for one velocity command. The paper's law (16) fulfils the first task, and each further task
    acts in the null space of the tasks above it. This notebook shows where the law equals strict priority, where it
    does not, and how limits on the velocity change it. It takes a few seconds.

    ## 1. Three tasks

    A task is an expression σ(η) with a target. surctl computes its Jacobian by differentiation.
    """)
    return


@app.cell
def _():
    import casadi as ca
    import matplotlib.pyplot as plt
    import numpy as np

    from surctl.priority import assemble, solve
    from surctl.priority.diagnosis import diagnose
    from surctl.tasks import Barrier, Stack, Task, VelocityBox, line_of_sight_task, position_task

    eta = ca.SX.sym("eta", 4)  # x, y, z [m], psi [rad]
    buoy = [1.0, 0.3]
    keep_off = Task(name="keep_off", eta=eta, sigma=ca.norm_2(eta[:2] - ca.DM(buoy)), target=0.8, gain=0.5, unit="m")
    go = position_task(eta, [2.0, 0.0], gain=0.2, name="go")
    look = line_of_sight_task(eta, buoy, gain=0.6, name="look")

    return Barrier, Stack, VelocityBox, assemble, buoy, diagnose, eta, go, keep_off, look, np, plt, solve


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 2. Is the law strict priority?

    Where the commutators of the projectors vanish, the law fulfils each level as well as the levels above allow: this
    is strict priority. `diagnose` examines the commutators symbolically first, then numerically over a region, and
    names poses at which a Jacobian loses rank.
    """)
    return


@app.cell
def _(Stack, diagnose, go, keep_off, look):
    region = ([-1.0, -1.0, -0.5, -3.0], [3.0, 1.0, 0.0, 3.0])
    print(diagnose(Stack((keep_off, go, look)), region=region))
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. A plot of the null space

    In the horizontal plane, `keep_off` determines the velocity along the line to the buoy. The velocity across this
    line is free, and `go` can use only this component. The arrows show the velocity of the whole stack. The colour
    shows the residual of `go`.
    """)
    return


@app.cell
def _(Stack, assemble, buoy, eta, go, keep_off, np, plt, solve):
    assembly = assemble(Stack((keep_off, go)), [], inputs={"eta": eta})
    _x, _y = np.meshgrid(np.linspace(-0.6, 2.6, 22), np.linspace(-0.9, 1.3, 16))
    _v, _lost = np.zeros((2, *_x.shape)), np.zeros(_x.shape)
    for _k in np.ndindex(_x.shape):
        _solution = solve(assembly.problem({"eta": [_x[_k], _y[_k], -0.15, 0.0]}), mode="nsb")
        _v[:, *_k], _lost[_k] = _solution.v[:2], _solution.residuals["go"]
    _, _ax = plt.subplots(figsize=(8.0, 4.6), layout="constrained")
    _map = _ax.pcolormesh(_x, _y, _lost, cmap="Blues", shading="nearest")
    _ax.quiver(_x, _y, *_v, angles="xy")
    _ax.add_patch(plt.Circle(buoy, 0.8, fill=False, linestyle="--"))
    _ax.plot(2.0, 0.0, "k*", markersize=12)
    _ax.set_xlabel("x [m]")
    _ax.set_ylabel("y [m]")
    _ax.set_aspect("equal")
    plt.colorbar(_map, ax=_ax, label="residual of go [m/s]")
    _ax
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    Inside the dashed circle, `keep_off` moves the robot outwards. Since this task is an equality, outside the circle it
    moves the robot *towards* the circle. The sonar sub-tasks of the paper's (17)–(20) have the same property, so they
    must be switched off far from obstacles. A barrier needs no switching.

    ## 4. Limits

    This example adds bounds on the velocity and a wall at x = 1.5 m. The mode `nsb` ignores these limits. `projected`
    fulfils each level as well as the limits and the levels above allow, by one sweep of projections. `lexicographic`
    solves a cascade of least-squares problems. `filter` takes the velocity within the limits that is
    nearest to that of `nsb`.
    """)
    return


@app.cell
def _(mo):
    pull = mo.ui.slider(0.1, 1.0, 0.1, value=0.6, label="gain of go [1/s]", show_value=True)
    pull

    return (pull,)


@app.cell
def _(Barrier, Stack, VelocityBox, assemble, eta, keep_off, look, mo, pull, solve):
    from surctl.tasks import position_task as _position_task

    _go = _position_task(eta, [2.0, 0.0], gain=pull.value, name="go")
    _box = VelocityBox([-0.22, -0.22, -0.1, -0.5], [0.22, 0.22, 0.1, 0.5])
    _wall = Barrier("wall", eta, h=1.5 - eta[0], alpha=0.5)
    bounded = assemble(Stack((keep_off, _go, look)), [_box, _wall], inputs={"eta": eta})
    _rows = ["| mode | u | v | r | keep_off | go | look | |", "|---|---|---|---|---|---|---|---|"]
    for _mode in ("nsb", "filter", "projected", "lexicographic"):
        _solution = solve(bounded.problem({"eta": [1.4, -0.4, -0.15, 0.0]}), mode=_mode)
        _left = " | ".join(f"{_solution.residuals[name]:.3f}" for name in ("keep_off", "go", "look"))
        _u, _v, _, _r = _solution.v
        _rows.append(f"| {_mode} | {_u:.3f} | {_v:.3f} | {_r:.3f} | {_left} | {_solution.explain()} |")
        print(f"{_mode}: {_solution.explain()}")
    mo.md("\n".join(_rows))

    return (bounded,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 5. Compiled

    The same stack can be compiled. A control step then takes a few microseconds and allocates no memory. Closed-loop
    simulations and the exported C use this compiled step.
    """)
    return


@app.cell
def _(bounded, solve):
    step = bounded.step("projected")
    step.inputs["eta"][:] = [1.4, -0.4, -0.15, 0.0]
    step.solve()
    _slow = solve(bounded.problem({"eta": [1.4, -0.4, -0.15, 0.0]}), mode="projected")
    print(f"compiled and interpreted agree to {max(abs(step.v - _slow.v).max(), 1e-12):.0e}")
    print("binding:", ", ".join(name for name, _ in step.binding()))
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    Next: [which stability claims hold](03_stability_claims.py). `analysis/choosing.md` explains how to choose a mode.
    """)
    return


if __name__ == "__main__":
    app.run()
