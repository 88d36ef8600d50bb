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

    surctl exports the simulated controller as C99. The C gives the same bytes as Python on this machine with any
    compiler, and on an emulated Cortex-M4F that controls the simulated robot. This notebook uses the law `closed_form`
    in float32. It takes half a minute and needs a C compiler; the last part also needs QEMU and an ARM compiler.

    ## 1. From the symbolic law to instructions

    The export turns the gains into constants, replaces functions of the mathematical library by polynomials in basic
    operations, and lowers the law to a list of instructions.
    """)
    return


@app.cell
def _():
    import shutil
    import tempfile
    from pathlib import Path

    from surctl.control import build_law, load_gains
    from surctl.export import build_bundle, closed_form, operating_envelope, write_bundle
    from surctl.simulation import law_numbers, load_scenario, simulate
    from surctl.vehicle import load_vehicle

    mission, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
    law = build_law("closed_form")
    p = law_numbers(mission, gains, vehicle)
    shipped = closed_form(law, real="float32", constants=p)
    within = operating_envelope(law, mission, vehicle, shipped.gains)
    bundle = build_bundle(shipped, {}, real="float32", envelope=within)
    folder = Path(tempfile.mkdtemp())
    files = {file.path.name: file for file in write_bundle(bundle, folder / bundle.name)}
    box = operating_envelope(law, mission, vehicle, law.gains)
    board = build_bundle(closed_form(law, real="float32"), law.gains.unpack(p), real="float32", envelope=box)

    def run_mission(stepper=None):
        """Simulate the mission with true positions, with the law itself or with `stepper` in its place."""
        return simulate(mission, vehicle, gains=gains, law=law, sensing="truth", seed=0, stepper=stepper)

    for _name, _file in files.items():
        print(f"{_file.sha256[:12]}  {_file.path.stat().st_size:>7} bytes  {_name}")

    return board, box, bundle, files, folder, law, p, run_mission, shipped, shutil


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    The exported C is readable: numbers are exact literals, no memory is allocated, and a guard checks the inputs and
    outputs of each step.
    """)
    return


@app.cell
def _(files):
    print("\n".join(files["surctl_closed_form_law.c"].path.read_text(encoding="utf-8").splitlines()[:24]))
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 2. Software in the loop

    The compiled C replays a whole run on its own state, and each step is compared with Python in the same precision.
    Then each state and input in turn is set to NaN and to infinity. For these values the C must return a negative
    status and zero thrust.
    """)
    return


@app.cell
def _(bundle, folder, run_mission, shipped):
    from surctl.export import Records, as_records, build_controller, compare_runs

    run = run_mission()
    _empty = run.record.law_parameters[:0]
    records = as_records(shipped, Records(run.record.law_state, run.record.law_input, _empty))
    controller = build_controller(shipped, bundle, folder / "sil")
    (_report,) = compare_runs(controller, [records])
    print(_report.summary().replace(str(folder), "."))

    return controller, records, run


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. The same bytes with each compiler

    This cell compares the recorded run and 500 steps with varied states and inputs, at two optimisation levels of one
    compiler. `surctl export --check` does the same with gcc, clang, three Cortex-M processors and 100,000 steps.
    """)
    return


@app.cell
def _(controller, records):
    from surctl.export import TARGETS, check_builds

    checked = check_builds(controller, [records], [TARGETS["gcc-O0"], TARGETS["gcc-O3"]], steps=500)
    for _build in checked.builds:
        print(f"{_build.target}: {_build.differing} differing steps")

    return (checked,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. Processor in the loop

    The exported C is compiled for a Cortex-M4F and started in QEMU. Python simulates the robot, and the emulated
    processor computes the thrust. Each thrust is compared with Python in float32 to the last bit.
    """)
    return


@app.cell
def _(board, box, checked, folder, law, p, run, run_mission, shutil):
    from surctl.export import LinkedLaw, LinkFaults, emulated, emulated_target

    if checked.passed and shutil.which("qemu-system-arm") and shutil.which("arm-none-eabi-gcc"):
        with emulated(board, emulated_target("cortex-m4f"), folder / "board") as _line:
            _linked = LinkedLaw(law, p, _line, LinkFaults(), box)
            _linked_run = run_mission(_linked)
            _report = _linked.report()
        print(f"{_linked_run.metrics.stopped_because} after {_report.answered} steps on the processor")
        print(f"{_report.differing} of them differ from Python; the run in Python also took {run.metrics.time_s:.2f} s")
    else:
        print("no QEMU or no ARM compiler: this part is skipped")
    shutil.rmtree(folder)
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    Next: [a vehicle of your own](06_your_own_vehicle.py). The [guide](guides/export.md) explains the export in detail.
    """)
    return


if __name__ == "__main__":
    app.run()
