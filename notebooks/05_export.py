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

    The controller that flew becomes C99 that gives the same bytes: on this machine under any compiler, and on an
    emulated Cortex-M4F that runs the scenario itself. Here with the law `closed_form`, in float32. It takes half a
    minute, and needs a C compiler; the last part also QEMU and an ARM compiler.

    ## 1. From the symbolic law to instructions

    The gains become constants, the mathematical library is replaced by exact polynomials, and the law is a list of
    operations.
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

    def fly(stepper=None):
        """The mission with true positions, by the law itself or by whatever steps in its place."""
        return simulate(mission, vehicle, gains=gains, law=law, sensing="truth", seed=0, stepper=stepper)

    for _name, _file in files.items():
        print(f"{_file.sha256[:12]}  {_file.path.stat().st_size:>7} bytes  {_name}")

    return board, box, bundle, files, fly, folder, law, p, shipped, shutil


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    The C is meant to be read: literals are exact, nothing is allocated, and a guard stands around the step.
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

    A whole flight, replayed through the compiled C on its own state, step by step against Python in the same
    precision; then NaN and infinity in every state and input, one after another. A negative status and zero thrust is
    the only right answer to those.
    """)
    return


@app.cell
def _(bundle, fly, folder, shipped):
    from surctl.export import Records, as_records, build_controller, compare_runs

    run = fly()
    _empty = run.record.law_parameters[:0]
    flight = as_records(shipped, Records(run.record.law_state, run.record.law_input, _empty))
    controller = build_controller(shipped, bundle, folder / "sil")
    (_report,) = compare_runs(controller, [flight])
    print(_report.summary().replace(str(folder), "."))

    return controller, flight, run


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. The same bytes, whatever compiles it

    The flight and hundreds of steps around it, under two levels of optimisation of one compiler; `surctl export
    --check` does it with gcc, clang, three Cortex-M and 100,000 steps.
    """)
    return


@app.cell
def _(controller, flight):
    from surctl.export import TARGETS, check_builds

    checked = check_builds(controller, [flight], [TARGETS["gcc-O0"], TARGETS["gcc-O3"]], steps=500)
    for _build in checked.builds:
        print(f"{_build.target}: {_build.differing} differing steps")

    return (checked,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. Processor in the loop

    The bundle, compiled for a Cortex-M4F and started in QEMU. Python simulates the water and the robot, the processor
    answers with thrust, and each answer is compared with Python in float32 to the last bit.
    """)
    return


@app.cell
def _(board, box, checked, fly, folder, law, p, run, shutil):
    from surctl.export import LinkedLaw, LinkFaults, emulated, emulated_target

    if checked.passed and shutil.which("qemu-system-arm") and shutil.which("arm-none-eabi-gcc"):
        with emulated(board, emulated_target("cortex-m4f"), folder / "board") as _line:
            _linked = LinkedLaw(law, p, _line, LinkFaults(), box)
            _flown = fly(_linked)
            _said = _linked.report()
        print(f"{_flown.metrics.stopped_because} after {_said.answered} steps on the processor")
        print(f"{_said.differing} of them differ from Python; it took {run.metrics.time_s:.2f} s there, too")
    else:
        print("no QEMU or no ARM compiler: this part was left out")
    shutil.rmtree(folder)
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    Next: [a vehicle of your own](06_your_own_vehicle.py); in detail: [the guide](guides/export.md).
    """)
    return


if __name__ == "__main__":
    app.run()
