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

    surctl chooses gains by simulated runs and loop margins together, and then tries to refute the choice with new runs.
    This notebook uses the law `closed_form` in one scenario, so that it takes seconds. `surctl sweep` and `surctl
    tune` do the same over all scenarios.

    ## 1. A grid sweep

    For each of twenty points, surctl simulates the mission with the compiled closed loop and computes the loop margins.
    """)
    return


@app.cell
def _():
    import matplotlib.pyplot as plt

    from surctl.control import load_gains
    from surctl.report import plot_heat_map
    from surctl.simulation import load_scenario
    from surctl.tuning import build_cases, grid, parse_axis, sweep
    from surctl.vehicle import load_vehicle

    gains, scenario, vehicle = load_gains("default"), load_scenario("pool-behind"), load_vehicle("sur400")
    cases = build_cases([scenario], [vehicle], gains=gains, law="closed_form")
    table = sweep(cases, grid([parse_axis("k_v=0.75..3:5"), parse_axis("lookahead=0.4..1.6:4")]))
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 3.8), layout="constrained")
    plot_heat_map(table, "time_s", ax=left)
    plot_heat_map(table, "disk_margin", ax=right)
    print("picked:", table.gains.provenance.rpartition("; ")[2])
    figure

    return cases, gains, load_gains, plt, scenario, vehicle


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    Faster velocity loops let the robot arrive sooner, but reduce the stability margin: at the right edge of the grid
    the disk margin is below 0.6. A finer grid costs more and does not remove this trade-off.

    ## 2. Where the poles go

    The plot shows the locus of the closed-loop poles over one gain, with sampling and thrust lag included. Change the
    cruise speed with the slider.
    """)
    return


@app.cell
def _(mo):
    cruise = mo.ui.slider(0.0, 0.2, 0.05, value=0.15, label="cruise [m/s]", show_value=True)
    cruise

    return (cruise,)


@app.cell
def _(cruise, gains, vehicle):
    import numpy as np

    from surctl.report import plot_locus
    from surctl.verification import sweep_locus

    _locus = sweep_locus(vehicle, gains.values, "k_v", np.linspace(0.5, 6.0, 45), cruise=cruise.value, dt=0.05)
    plot_locus(_locus, unit="1/s", picked=1.5)
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. Goals, and a search

    A goal is a metric with a limit. Hard goals must hold in every run. The search makes the values of soft goals as
    small as possible. Normalised values are 1 at the limit. The search has a seed: equal requests give equal gains.
    """)
    return


@app.cell
def _(cases, gains):
    from surctl.report import goal_bars, plot_goal_bars
    from surctl.tuning import Goal, Request, conditions, gain_ranges, summary, tune

    goals = (
        Goal("clear", "min_clearance_m", "m", 0.08, "at least", "hard"),
        Goal("robust", "disk_margin", "1", 0.6, "at least", "hard"),
        Goal("soon", "time_s", "s", 20.5),
        Goal("spare", "effort_n", "N", 3.7),
    )
    runs = conditions(cases, seeds=range(2))
    request = Request(goals, runs, gains, gain_ranges(gains, ["k_v", "k_r", "lookahead", "kappa"]))
    tuning = tune(request, trials=64, rounds=1, runs=10)
    print("\n".join(summary(tuning)))
    print(f"all hard goals met: {tuning.result.feasible}")
    plot_goal_bars(goal_bars(tuning))

    return Goal, Request, conditions, gain_ranges, runs, summary, tune, tuning


@app.cell
def _(tuning):
    from surctl.report import plot_front

    plot_front(tuning)
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. Goals that cannot be met together

    These goals require a robust loop, a fast mission, and a delay margin that no such fast loop with 0.3 s of thrust
    lag can have. The tuner does not present its best attempt as a solution. It names a minimal set of goals that cannot
    be met together.
    """)
    return


@app.cell
def _(Goal, Request, gain_ranges, gains, runs, summary, tune):
    _greedy = (
        Goal("bear delay", "delay_margin_s", "s", 0.9, "at least", "hard"),
        Goal("quick", "time_s", "s", 19.0, "at most", "hard"),
        Goal("robust", "disk_margin", "1", 0.6, "at least", "hard"),
    )
    _ranges = gain_ranges(gains, ["k_v", "k_r", "lookahead", "kappa"])
    _tuned = tune(Request(_greedy, runs, gains, _ranges), trials=32, rounds=1, runs=0)
    print(f"all hard goals met: {_tuned.result.feasible}")
    print(summary(_tuned)[-1])
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    Next: [export and processor in the loop](05_export.py). `surctl tune --page` opens a tuning page with sliders. The
    [guide](guides/tune.md) explains how to write goals.
    """)
    return


if __name__ == "__main__":
    app.run()
