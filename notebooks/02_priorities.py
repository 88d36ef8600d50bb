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
    # Priorities: several tasks, one velocity

    Several tasks compete for one velocity command. The first task is fulfilled first, and each further task may use
    only the freedom that the tasks above it leave. Limits come before all tasks. This notebook begins with a robot
    arm, and then uses the same functions for the velocity of the built-in robot, with the law of the paper.
    """)
    return


@app.cell
def _():
    import casadi as ca
    import matplotlib.pyplot as plt
    import numpy as np

    from surctl.priority import assemble, solve
    from surctl.tasks import Barrier, Stack, Task, VelocityBox

    return Barrier, Stack, Task, VelocityBox, assemble, ca, np, plt, solve


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 1. Tasks of your own

    A task is an expression σ of the configuration with a target and a gain; surctl computes its Jacobian by
    differentiation. Here the configuration is the three joint angles of a planar arm with links of 1 m. The tip shall
    move to a point, and with less priority the middle joint shall be straight.
    """)
    return


@app.cell
def _(Stack, Task, ca):
    q = ca.SX.sym("q", 3)  # joint angles [rad]
    _angles = ca.cumsum(q)
    tip = ca.vertcat(ca.sum1(ca.cos(_angles)), ca.sum1(ca.sin(_angles)))
    to_point = Task(name="tip", eta=q, sigma=tip, target=ca.DM([2.3, 1.5]), gain=1.0, unit="m")
    straight = Task(name="straight", eta=q, sigma=q[1], target=0.0, gain=1.0, unit="rad")
    arm = Stack((to_point, straight))
    return arm, q, tip


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 2. Limits

    Each joint turns at most 0.3 rad/s, and the tip may not cross a wall at x = 2.1 m. `nsb` is the null-space-based
    law of the paper; it ignores limits. `projected` fulfils each task as well as the limits and the tasks above
    allow, by one sweep of projections; `lexicographic` solves a cascade of least-squares problems; `filter` takes the
    velocity within the limits that is nearest to that of `nsb`. Each solution says which task is not fulfilled, by
    how much, and why.
    """)
    return


@app.cell
def _(Barrier, VelocityBox, arm, assemble, np, q, solve, tip):
    arm_limits = [VelocityBox([-0.3] * 3, [0.3] * 3), Barrier("wall", q, h=2.1 - tip[0], alpha=1.0)]
    assembly = assemble(arm, arm_limits, inputs={"q": q})
    for _mode in ("nsb", "filter", "projected", "lexicographic"):
        _solution = solve(assembly.problem({"q": [0.1, 0.7, 0.4]}), mode=_mode)
        print(f"{_mode}: {np.round(_solution.v, 3)} rad/s. {_solution.explain()}")
    return (assembly,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. A motion, and which limit is active when

    The loop follows the velocity of each step. The timeline shows how much each task gives up over time, and which
    limits bind. The wall stops the tip at x = 2.1 m; the speed of single joints restricts the second task during the
    first two seconds.
    """)
    return


@app.cell
def _(assembly, ca, np, q, solve, tip):
    from surctl.marine.report import plot_priority
    from surctl.priority import PriorityTimeline

    _time, _q, _solutions = np.arange(0.0, 6.0, 0.1), np.array([0.1, 0.7, 0.4]), []
    for _ in _time:
        _solutions.append(solve(assembly.problem({"q": _q}), mode="lexicographic"))
        _q = _q + 0.1 * _solutions[-1].v
    print("tip at the end [m]:", np.round(np.array(ca.Function("tip", [q], [tip])(_q)).ravel(), 2))
    plot_priority(PriorityTimeline.of(_time, _solutions), title="arm of three joints: tip and elbow")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. The robot: three tasks of the pose

    For the robot the configuration is the pose (x, y, z, ψ), and the solution is the body velocity (u, v, w, r).
    `diagnose` examines whether the law of the paper equals strict priority: where the projectors of the tasks do not
    commute, it does not. It also names poses at which a Jacobian loses rank.
    """)
    return


@app.cell
def _(Stack, Task, ca):
    from surctl.priority.diagnosis import diagnose
    from surctl.tasks import line_of_sight_task, position_task

    eta, buoy = ca.SX.sym("eta", 4), [1.0, 0.3]
    keep_off = Task(
        name="keep_off",
        eta=eta,
        sigma=ca.norm_2(eta[:2] - ca.DM(buoy)),
        target=0.8,
        gain=0.5,
        unit="m",
        kinematics="vehicle",
    )
    go = position_task(eta, [2.0, 0.0], gain=0.6, name="go")
    look = line_of_sight_task(eta, buoy, gain=0.6, name="look")
    robot = Stack((keep_off, go, look))
    print(diagnose(robot, region=([-1.0, -1.0, -0.5, -3.0], [3.0, 1.0, 0.0, 3.0])))
    return buoy, eta, go, keep_off, look, position_task


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 5. A plot of the null space

    In the horizontal plane, `keep_off` determines the velocity along the line to the buoy. The velocity across this
    line is free, and `go` can use only this component. The arrows show the velocity, the colour the residual of `go`.
    As an equality, `keep_off` also pulls the robot *towards* the circle from outside; a barrier does not.
    """)
    return


@app.cell
def _(Stack, assemble, buoy, eta, go, keep_off, np, plt, solve):
    _two = assemble(Stack((keep_off, go)), [], inputs={"eta": eta})
    _x, _y = np.meshgrid(np.linspace(-0.6, 2.6, 17), np.linspace(-0.9, 1.3, 12))
    _v, _lost = np.zeros((2, *_x.shape)), np.zeros(_x.shape)
    for _k in np.ndindex(_x.shape):
        _solution = solve(_two.problem({"eta": [_x[_k], _y[_k], -0.15, 0.0]}), mode="nsb")
        _v[:, *_k], _lost[_k] = _solution.v[:2], _solution.residuals["go"]
    _figure, _ax = plt.subplots(figsize=(8.0, 4.6), layout="constrained")
    _map = _ax.pcolormesh(_x, _y, _lost, cmap="Blues", shading="nearest")
    _ax.quiver(_x, _y, *_v, angles="xy")
    _ax.add_patch(plt.Circle(buoy, 0.8, fill=False, linestyle="--"))
    _ax.plot(2.0, 0.0, "k*", markersize=12)
    _ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    _figure.colorbar(_map, ax=_ax, label="residual of go [m/s]")
    _ax
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 6. The same limits for the robot

    A wall stands at x = 1.5 m. Change the gain of `go` with the slider.
    """)
    return


@app.cell
def _(mo):
    pull = mo.ui.slider(0.1, 1.0, 0.1, value=0.6, label="gain of go [1/s]", show_value=True)
    pull
    return (pull,)


@app.cell
def _(
    Barrier,
    Stack,
    VelocityBox,
    assemble,
    eta,
    keep_off,
    look,
    position_task,
    pull,
    solve,
):
    _go = position_task(eta, [2.0, 0.0], gain=pull.value, name="go")
    _box = VelocityBox([-0.22, -0.22, -0.1, -0.5], [0.22, 0.22, 0.1, 0.5])
    _wall = Barrier("wall", eta, h=1.5 - eta[0], alpha=0.5, kinematics="vehicle")
    _problem = assemble(Stack((keep_off, _go, look)), [_box, _wall], inputs={"eta": eta})
    for _mode in ("nsb", "projected"):
        _solution = solve(_problem.problem({"eta": [1.4, -0.4, -0.15, 0.0]}), mode=_mode)
        print(f"{_mode}: {_solution.explain()}")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    `assemble(…).step("projected")` compiles such a step to C that allocates no memory; simulations and the exported
    law use it. `analysis/choosing.md` explains how to choose a mode. Next: [which stability claims
    hold](03_stability_claims.py).
    """)
    return


if __name__ == "__main__":
    app.run()
