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
    # Priorities: null-space behaviours, and what limits do to them

    Several tasks want the one velocity there is. The paper's law (16) gives the first its way and lets each next one
    act in what is left, its null space. This notebook shows where that is strict priority, where it is not, and what
    changes when velocity is limited. It takes a few seconds.

    ## 1. Three tasks

    A task is an expression σ(η) with a target; Jacobians come from differentiation.
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
    ## 2. Is it strict priority?

    Commutators of the projectors answer: where they vanish, each level is served as well as the levels above allow.
    `diagnose` tries it as expressions first, then over a region, and names where a Jacobian loses rank.
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
    ## 3. The null space, drawn

    In the plane of x and y: what `keep_off` asks is along the line to the buoy; what it leaves free is across. `go`
    keeps only that part. Arrows: the velocity of the whole stack; behind them, how much of `go` is given up.
    """)
    return


@app.cell
def _(Stack, assemble, buoy, eta, go, keep_off, np, plt, solve):
    assembly = assemble(Stack((keep_off, go)), [], inputs={"eta": eta})
    _x, _y = np.meshgrid(np.linspace(-0.6, 2.6, 22), np.linspace(-0.9, 1.3, 16))
    _v, _lost = np.zeros((2, *_x.shape)), np.zeros(_x.shape)
    for _k in np.ndindex(_x.shape):
        _found = solve(assembly.problem({"eta": [_x[_k], _y[_k], -0.15, 0.0]}), mode="nsb")
        _v[:, *_k], _lost[_k] = _found.v[:2], _found.residuals["go"]
    _, _ax = plt.subplots(figsize=(8.0, 4.6), layout="constrained")
    _map = _ax.pcolormesh(_x, _y, _lost, cmap="Blues", shading="nearest")
    _ax.quiver(_x, _y, *_v, angles="xy")
    _ax.add_patch(plt.Circle(buoy, 0.8, fill=False, linestyle="--"))
    _ax.plot(2.0, 0.0, "k*", markersize=12)
    _ax.set_xlabel("x [m]")
    _ax.set_ylabel("y [m]")
    _ax.set_aspect("equal")
    plt.colorbar(_map, ax=_ax, label="given up by go [m/s]")
    _ax
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    Inside the dashed circle `keep_off` pushes out. It is an equality, however: far from the buoy it pulls *towards*
    the circle. That is what the paper's (17)–(20) does with each sonar sub-task, and why it must be switched; a
    barrier need not be.

    ## 4. Limits

    A box on the velocity and a wall at x ≤ 1.5 m. `nsb` does not know of them. `projected` serves each level within
    them; `lexicographic` is the same by a cascade of least-squares problems; `filter` moves the null-space answer as
    little as it must.
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
        _found = solve(bounded.problem({"eta": [1.4, -0.4, -0.15, 0.0]}), mode=_mode)
        _left = " | ".join(f"{_found.residuals[name]:.3f}" for name in ("keep_off", "go", "look"))
        _u, _v, _, _r = _found.v
        _rows.append(f"| {_mode} | {_u:.3f} | {_v:.3f} | {_r:.3f} | {_left} | {_found.explain()} |")
        print(f"{_mode}: {_found.explain()}")
    mo.md("\n".join(_rows))

    return (bounded,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 5. Compiled

    The same stack as a tick of a few microseconds, without allocation: what the loops fly and what is exported as C.
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
    Next: [which stability claims hold](03_stability_claims.py); how to choose a mode: `analysis/choosing.md`.
    """)
    return


if __name__ == "__main__":
    app.run()
