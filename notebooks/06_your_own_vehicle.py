import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium", app_title="A vehicle of your own")


@app.cell
def _():
    import marimo as mo

    return (mo,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    # A vehicle of your own: a BlueROV2, from its data to C code

    This notebook describes a vehicle that is not a sphere, from published data, and a new mission. It tunes the gains,
    proves claims about the loop, and exports C. From the library it uses only the default gains and goals. It takes
    about a minute.

    ## 1. The vehicle

    Masses (with added mass) and drag are those identified by Wu (2018). The thesis gives no ranges, so ±15 % is our
    choice; another identification of the same vehicle differs by more.
    """)
    return


@app.cell
def _():
    import tempfile
    from pathlib import Path

    import matplotlib.pyplot as plt

    from surctl.vehicle import load_vehicle

    folder = Path(tempfile.mkdtemp())
    _known = {
        "inertia": {"m11": (17.0, "kg"), "m22": (24.2, "kg"), "m33": (26.07, "kg"), "m44": (0.28, "kg m^2")},
        "drag": {
            **{"Xu": (4.03, "N s/m"), "Yv": (6.22, "N s/m"), "Zw": (5.18, "N s/m"), "Nr": (0.07, "N m s")},
            **{"Xuu": (18.18, "N s^2/m^2"), "Yvv": (21.66, "N s^2/m^2"), "Zww": (36.99, "N s^2/m^2")},
            "Nrr": (1.55, "N m s^2"),
        },
    }
    _lines = ['kind = "vehicle"', 'name = "my-bluerov2"', "[hull]", 'provenance = "tape measure"', 'radius = "25 cm"']
    for _table, _numbers in _known.items():
        _lines += [f"[{_table}]", 'provenance = "Wu 2018, Flinders University; ranges: plus and minus 15 %, chosen"']
        for _key, (_value, _unit) in _numbers.items():
            _ends = f"[{0.85 * _value:.4g}, {1.15 * _value:.4g}]"
            _lines.append(f'{_key} = {{ value = {_value}, unit = "{_unit}", range = {_ends} }}')
    _lines += ["[thrust]", 'provenance = "four of eight thrusters, derated"', 'thrust_lag = "0.2 s"']
    _lines += [f'{_axis} = "4 kgf"' for _axis in ("Fu_max", "Fv_max", "Fw_max")] + ['Fr_max = "8 N m"']
    (folder / "my-bluerov2.toml").write_text("\n".join(_lines) + "\n", encoding="utf-8")
    rov = load_vehicle(str(folder / "my-bluerov2.toml"))
    print(f"{rov.name}: {rov['m11']:g} kg ahead, {rov['m22']:g} kg abeam, thrust {rov['Fu_max']:.1f} N")

    return folder, plt, rov


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    This vehicle has different masses in surge and sway. When it turns while moving ahead, a sideways force acts on the
    hull. The claims about regions of attraction assume equal masses, so section 5 reports them as not applicable.

    ## 2. The mission, and a check of the scenario file
    """)
    return


@app.cell
def _(folder, rov):
    from surctl.simulation import findings, load_scenario

    (folder / "basin.toml").write_text(
        """
    kind = "scenario"
    name = "basin"
    title = "Past a pillar and a swimmer"
    provenance = "made up"
    vehicle = "VEHICLE"
    path_m = [[1.0, 2.0], [9.0, 2.0]]
    depth_m = -1.0
    cruise_m_per_s = 0.2
    cap_m_per_s = 0.3
    launch_m = 0.3
    time_limit_s = 90.0

    [site]
    length_m = 10.0
    width_m = 4.0
    depth_m = 2.5

    [[obstacles]]
    name = "pillar"
    shape = "box"
    centre_m = [4.0, 1.8]
    size_m = [0.4, 0.4]

    [[obstacles]]
    name = "swimmer"
    shape = "moving"
    radius_m = 0.25
    centre_m = [8.0, 3.2]
    to_m = [5.0, 0.8]
    speed_m_per_s = 0.1

    [paper]
    result = "arrives"
    """.replace("VEHICLE", str(folder / "my-bluerov2.toml").replace("\\", "/")),
        encoding="utf-8",
    )
    basin = load_scenario(str(folder / "basin.toml"))
    _findings = findings(basin, rov)
    print("\n".join(f"{f.level}: {f.text}" for f in _findings) or "no problem found")

    return (basin,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. The default gains on this vehicle

    The default gains were chosen for a hull five times as heavy. This cell computes the least margins of the loops for
    masses and drag off by up to 15 %.
    """)
    return


@app.cell
def _(rov):
    from surctl.control import load_gains
    from surctl.verification import worst_margins

    start = load_gains("default")

    def margins(values):
        """Return the least delay margin [s] and disk margin over loops and ±15 %, and whether all loops are stable."""
        _all = worst_margins(rov, values, uncertainty=0.15, cruise=0.2, dt=0.05)
        return min(m.delay_margin_s for m in _all), min(m.disk_margin for m in _all), all(m.stable for m in _all)

    _delay, _disk, _stable = margins(start.values)
    print(f"default gains: {'stable' if _stable else 'UNSTABLE'}, delay {_delay:.2f} s, disk margin {_disk:.2f}")

    return load_gains, margins, start


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. Tune

    The hard goals are: arrive without a collision for every sampled vehicle, and sufficient margins for the nominal
    vehicle. The soft goals are a short time and little thrust.
    """)
    return


@app.cell
def _(basin, margins, rov, start):
    from surctl.report import goal_bars, plot_goal_bars
    from surctl.tuning import (
        TUNED,
        Request,
        build_cases,
        conditions,
        gain_ranges,
        load_goals,
        summary,
        tune,
        tuned_gains,
    )

    _cases = build_cases([basin], [rov], gains=start)
    _ranges = gain_ranges(start, dict.fromkeys(TUNED))
    _request = Request(load_goals("default"), conditions(_cases, seeds=range(2)), start, _ranges)
    tuning = tune(_request, trials=32, rounds=2, runs=20)
    gains = tuned_gains(tuning)
    print("\n".join(summary(tuning)))
    _delay, _disk, _stable = margins(gains.values)
    print(f"tuned gains: {'stable' if _stable else 'UNSTABLE'}, delay {_delay:.2f} s, disk margin {_disk:.2f}")
    plot_goal_bars(goal_bars(tuning))

    return (gains,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 5. Which claims can be proved

    The region claim and the braking claim assume equal masses in surge and sway. They report that they are not
    applicable to this hull, and why. The linear analysis shows the effect of unequal masses: the Munk moment turns the
    hull, and above the bearable speed the loop is unstable. The claim `v1-corrected` does not depend on the mass and is
    proved: path following converges if the velocity equals its command.
    """)
    return


@app.cell
def _(basin, gains, rov):
    from surctl.certcheck import check_document
    from surctl.errors import NotApplicable
    from surctl.verification import claims, prove
    from surctl.verification.braking import braking_claim_named
    from surctl.verification.linear import slowest_mode
    from surctl.verification.region import region_statement

    for _name, _build in (
        ("region-cruise-20", lambda: region_statement("region-cruise-20").claim(rov, gains)),
        ("braking-rule-20", lambda: braking_claim_named("braking-rule-20", rov, gains)),
    ):
        try:
            _build()
        except NotApplicable as _reason:
            print(f"{_name}: {_reason}")
    print("\n".join(slowest_mode(rov, gains.values, cruise=basin.cruise, dt=0.05).lines()))
    [_claim] = claims({**gains.values, "speed": basin.cruise, "speed_max": basin.cap}, ["v1-corrected"])
    _certificate = prove(_claim).certificate
    print(f"v1-corrected: proved; the checker accepts it: {check_document(_certificate).accepted}")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    Simulations examine what the proofs do not cover: here masses and drag are drawn at random.
    """)
    return


@app.cell
def _(basin, gains, plt, rov):
    import numpy as np

    from surctl.report import plot_run
    from surctl.simulation import Case, simulate, simulate_batch

    _rng = np.random.default_rng(1)
    _drawn = {f"plant.{k}": rov[k] * _rng.uniform(0.85, 1.15, 200) for k in ("m11", "m22", "m44", "Xuu", "Yvv", "Nrr")}
    _runs = simulate_batch(Case(basin, rov, gains), _drawn, seeds=np.arange(200))
    _least = _runs.column("min_clearance_m").min()
    print(f"200 random vehicles: {int(_runs.column('reached').sum())} arrive, least clearance {_least:.3f} m")
    run = simulate(basin, rov, gains=gains, sensing="truth", seed=0)
    plot_run(run, ax=plt.subplots(figsize=(8.0, 4.4), layout="constrained")[1])

    return (run,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 6. Code

    This cell exports the simulated law in float32, and compares the C with Python over the recorded run.
    """)
    return


@app.cell
def _(folder, run):
    import shutil

    from surctl.control import build_law
    from surctl.export import Records, build_bundle, closed_form, software_in_the_loop, write_bundle

    law = build_law()
    _shipped = closed_form(law, real="float32")
    _records = Records(run.record.law_state, run.record.law_input, run.record.law_parameters)
    _bundle = build_bundle(_shipped, law.gains.unpack(run.record.law_parameters), real="float32")
    _written = write_bundle(_bundle, folder / "code")
    _size = sum(len(_bundle.files[file]) for file in _bundle.sources)
    print(f"{len(_written)} files, the controller has {_size // 1000} kB of source")
    _report = software_in_the_loop(law, _records)
    print(f"SIL {_report.steps} steps: {'passed' if _report.passed else 'FAILED'}, difference {_report.tau.mixed:.1e}")
    shutil.rmtree(folder)
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    These guides do the same with commands: [add a vehicle](guides/add-a-vehicle.md), [tune](guides/tune.md),
    [verify](guides/verify.md), [export](guides/export.md).
    """)
    return


if __name__ == "__main__":
    app.run()
