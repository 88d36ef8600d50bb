import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium", app_title="Export and processor in the loop")


@app.cell
def _():
    import marimo as mo

    return (mo,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    # Export, and the processor in the loop

    surctl exports a controller as C99 that gives the same bytes as Python, with any compiler and on an emulated
    microcontroller. This notebook first exports a controller of your own, and then the law of the built-in robot. It
    needs a C compiler; the last part also needs QEMU and an ARM compiler.
    """)
    return


@app.cell
def _():
    import shutil
    import tempfile
    from pathlib import Path

    folder = Path(tempfile.mkdtemp())
    return folder, shutil


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 1. A controller of your own

    Any `Controller` can be exported, with or without a plant. This one holds the speed of a boat with a PI law; its
    integrator is a state, and it stops while the force is at its limit.
    """)
    return


@app.cell
def _():
    import casadi as ca

    from surctl.ir import Layout, Port
    from surctl.system import Action, Controller, Plant, System, run_system

    _speed, _goal = Port("speed", (1,), "m/s", "of the boat"), Port("goal", (1,), "m/s", "desired speed", 1.5)
    _force, _sum = Port("force", (1,), "N", "of the propeller"), Port("sum", (1,), "m", "integral of the error")

    def hold(x, u, p):
        """Return the force, at most 80 N, and the next integral."""
        error = u["goal"] - u["speed"]
        wanted = p["k_p"] * error + p["k_i"] * x["sum"]
        force = ca.fmax(-80, ca.fmin(80, wanted))
        return Action(force, {"sum": ca.if_else(force == wanted, x["sum"] + 0.1 * error, x["sum"])})

    _gains = Layout((Port("k_p", (1,), "N s/m", "", 60.0), Port("k_i", (1,), "N/m", "", 20.0)))
    _boat = Plant("boat", Layout((_speed,)), Layout((_force,)), lambda x, f, d, p: (f["force"] - 30 * x["speed"]) / 50)
    speed_law = Controller(
        "hold_speed", 0.1, Layout((_speed, _goal)), _boat.inputs, hold, Layout((_sum,)), gains=_gains
    )
    record = run_system(System(_boat, speed_law), 20.0)
    print(f"speed after 20 s: {record['speed'][-1, 0]:.2f} m/s")
    return record, speed_law


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 2. The bundle

    A bundle contains the law, a guard that checks inputs and outputs, a self-test, a README that explains how to call
    it, and a manifest with the digests. The code is readable: numbers are exact literals.
    """)
    return


@app.cell
def _(folder, speed_law):
    from surctl.export import write_bundle
    from surctl.export.bundle import build_bundle

    bundle = build_bundle(speed_law, {"k_p": 60.0, "k_i": 20.0})
    for _file in write_bundle(bundle, folder / "boat"):
        print(f"{_file.sha256[:12]}  {_file.path.stat().st_size:>6} bytes  {_file.path.name}")
    print((folder / "boat" / "hold_speed.h").read_text(encoding="utf-8")[:700])
    return (bundle,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. Software in the loop, with each compiler

    The compiled C replays the run on its own state, and each step is compared with Python in the same precision. Then
    each state and input in turn is set to NaN and to infinity: the C must return a negative status and zero force.
    The last lines compare the run and 200 varied steps at two optimisation levels; `surctl export --check` does the
    same with more compilers and processors.
    """)
    return


@app.cell
def _(bundle, folder, record, speed_law):
    from surctl.export import TARGETS, Records, build_controller, check_builds, compare_runs

    _controller = build_controller(speed_law, bundle, folder / "sil")
    _records = Records(*record.controller)
    (_report,) = compare_runs(_controller, [_records])
    print(_report.summary().replace(str(folder), "."))
    for _build in check_builds(_controller, [_records], [TARGETS["gcc-O0"], TARGETS["gcc-O3"]], steps=200).builds:
        print(f"{_build.target}: {_build.differing} differing steps")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. The robot: the law on an emulated processor

    The control law of the robot is exported in the same way. Here the C of the law `closed_form` runs on a Cortex-M4F
    in QEMU, while Python simulates the robot. Each thrust is compared with Python in float32 to the last bit.
    """)
    return


@app.cell
def _(folder, shutil):
    from surctl.export import emulated, emulated_target
    from surctl.marine.control import build_law, load_gains
    from surctl.marine.export import LinkedLaw, LinkFaults, closed_form, operating_envelope
    from surctl.marine.export import build_bundle as build_robot_bundle
    from surctl.marine.simulation import law_numbers, load_scenario, simulate
    from surctl.marine.vehicle import load_vehicle

    if shutil.which("qemu-system-arm") and shutil.which("arm-none-eabi-gcc"):
        _mission, _vehicle, _set = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
        _law = build_law("closed_form")
        _p = law_numbers(_mission, _set, _vehicle)
        _box = operating_envelope(_law, _mission, _vehicle, _law.gains)
        _board = build_robot_bundle(
            closed_form(_law, real="float32"), _law.gains.unpack(_p), real="float32", envelope=_box
        )
        with emulated(_board, emulated_target("cortex-m4f"), folder / "board") as _line:
            _linked = LinkedLaw(_law, _p, _line, LinkFaults(), _box)
            _run = simulate(_mission, _vehicle, gains=_set, law=_law, sensing="truth", seed=0, stepper=_linked)
            _answers = _linked.report()
        print(f"{_run.metrics.stopped_because} after {_answers.answered} steps on the processor")
        print(f"{_answers.differing} of them differ from Python")
    else:
        print("no QEMU or no ARM compiler: this part is skipped")
    shutil.rmtree(folder)
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    Next: [a law of your own](06_your_own_law.py). The [guide](guides/export.md) explains the export in detail.
    """)
    return


if __name__ == "__main__":
    app.run()
