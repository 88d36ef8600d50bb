import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium", app_title="Plants and vehicles")


@app.cell
def _():
    import marimo as mo

    return (mo,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    # Plants and vehicles

    A plant is what you control. This notebook declares a plant of your own, then a vehicle of your own in a file, and
    then reads the vehicle file of the built-in robot. Each becomes linear models of python-control, so all its
    functions work on them.
    """)
    return


@app.cell
def _():
    import tempfile
    from pathlib import Path

    import control
    import matplotlib.pyplot as plt
    import numpy as np

    return Path, control, np, plt, tempfile


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 1. A plant of your own

    A plant is a differential equation of named signals with units, with parameters and disturbances. This one is the
    heading of a ship by Nomoto's model, with a wave that turns it. `to_control` returns it as a nonlinear system of
    python-control, `linearise_plant` as a `StateSpace`.
    """)
    return


@app.cell
def _(control, np):
    from surctl.ir import Layout, Port
    from surctl.system import Plant, linearise_plant, to_control

    _states = (Port("heading", (1,), "rad", "of the ship"), Port("rate", (1,), "rad/s", "yaw rate"))
    _rudder, _wave = Port("rudder", (1,), "rad", "rudder angle"), Port("wave", (1,), "rad/s^2", "of the sea")
    _numbers = (Port("gain", (1,), "1/s", "yaw rate per rudder", 0.08), Port("time", (1,), "s", "time constant", 12.0))
    ship = Plant(
        "ship",
        Layout(_states),
        Layout((_rudder,)),
        lambda x, f, d, p: {
            "heading": x["rate"],
            "rate": (p["gain"] * f["rudder"] - x["rate"]) / p["time"] + d["wave"],
        },
        parameters=Layout(_numbers),
        disturbances=Layout((_wave,)),
    )
    _linear = linearise_plant(ship)
    print("poles [1/s]:", np.round(np.sort(_linear.poles().real), 3))
    _time = np.linspace(0.0, 60.0, 121)
    _turn = control.input_output_response(to_control(ship), _time, [np.full(121, np.radians(10)), np.zeros(121)])
    print(f"10° of rudder turn the ship by {np.degrees(_turn.outputs[0, -1]):.0f}° in a minute")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 2. A vehicle of your own

    A vehicle is a TOML file. Each number has a unit and a source; a range states how well it is known. Numbers may
    have any unit. These masses (with added mass) and drags of a BlueROV2 are those that Wu (2018) identified; the
    ranges of ±15 % are our choice. `surctl vehicle from-geometry` writes such a file from diameter, mass and thrust.
    """)
    return


@app.cell
def _(Path, tempfile):
    from surctl.marine.vehicle import linearise, load_vehicle, steady_speed

    _inertia = {"m11": (17.0, "kg"), "m22": (24.2, "kg"), "m33": (26.07, "kg"), "m44": (0.28, "kg m^2")}
    _linear_drag = {"Xu": (4.03, "N s/m"), "Yv": (6.22, "N s/m"), "Zw": (5.18, "N s/m"), "Nr": (0.07, "N m s")}
    _drag = {axis: (value, "N s^2/m^2") for axis, value in (("Xuu", 18.18), ("Yvv", 21.66), ("Zww", 36.99))}
    _text = 'kind = "vehicle"\nname = "my-bluerov2"\n[hull]\nprovenance = "tape measure"\nradius = "25 cm"\n'
    for _table, _values in (("inertia", _inertia), ("drag", {**_linear_drag, **_drag, "Nrr": (1.55, "N m s^2")})):
        _text += f'[{_table}]\nprovenance = "Wu 2018; ranges chosen"\n'
        for _key, (_value, _unit) in _values.items():
            _range = [round(0.85 * _value, 4), round(1.15 * _value, 4)]
            _text += f'{_key} = {{ value = {_value}, unit = "{_unit}", range = {_range} }}\n'
    _text += '[thrust]\nprovenance = "derated"\nthrust_lag = "0.2 s"\nFr_max = "8 N m"\n'
    _text += "".join(f'{axis} = "4 kgf"\n' for axis in ("Fu_max", "Fv_max", "Fw_max"))
    with tempfile.TemporaryDirectory() as _folder:
        _file = Path(_folder, "my-bluerov2.toml")
        _file.write_text(_text, encoding="utf-8")
        rov = load_vehicle(str(_file))
    print(f"{rov.name}: {rov['m11']:g} kg ahead, {rov['m22']:g} kg abeam, thrust {rov['Fu_max']:.1f} N")
    print(f"steady speed at full thrust: {steady_speed(rov['Fu_max'], rov['Xu'], rov['Xuu']):.2f} m/s")
    return linearise, load_vehicle, rov


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. Linear models over speed

    `linearise` trims the vehicle at a velocity. Its masses in surge and sway differ, so the hull tends to turn across
    its motion (the Munk moment). The plot shows the fastest growing or slowest decaying yaw and sway motion over the
    speed: above zero, the hull without control turns away from its course.
    """)
    return


@app.cell
def _(linearise, load_vehicle, np, plt, rov):
    robot = load_vehicle("sur540-flooded")
    _speeds = np.linspace(0.02, 0.26, 13)

    def turning_pole(vehicle, speed):
        """Return the largest real part of the poles of sway and yaw [1/s]."""
        A = linearise(vehicle, [speed, 0, 0, 0]).A[np.ix_([5, 7], [5, 7])]
        return np.linalg.eigvals(A).real.max()

    _figure, _ax = plt.subplots(figsize=(6.5, 3.2), layout="constrained")
    for _vehicle in (rov, robot):
        _ax.plot(_speeds, [turning_pole(_vehicle, speed) for speed in _speeds], label=_vehicle.name)
    _ax.axhline(0.0, color="0.4", linewidth=1)
    _ax.set(xlabel="speed [m/s]", ylabel="pole of sway and yaw [1/s]")
    _ax.legend()
    print(
        f"at 0.26 m/s: {rov.name} {turning_pole(rov, 0.26):.3f} 1/s, {robot.name} {turning_pole(robot, 0.26):.3f} 1/s"
    )
    _ax
    return (robot,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. What thrusters can do

    If the file describes the thrusters, the forces that they can give together follow. The plot shows them for a
    BlueROV2 Heavy of the library when one thruster has failed.
    """)
    return


@app.cell
def _(load_vehicle):
    from surctl.marine.report import plot_attainable

    plot_attainable(load_vehicle("bluerov2-heavy"), failed=("T1",))
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 5. The built-in robot

    The paper prints only mass in air, diameter and speed of its robot. The file derives all other numbers and says
    how. Most of the inertia comes from water: in the hull, and around it as added mass. The stopping distance
    follows: no guidance law can avoid an obstacle that it detects later.
    """)
    return


@app.cell
def _(mo, np, robot):
    _rows = ["| | value | unit | range | provenance |", "|---|---|---|---|---|"]
    for _name in ("radius", "m11", "m44", "Xuu", "Fu_max", "thrust_lag"):
        _p = robot.parameters[_name]
        _range = "–" if _p.range is None else f"{_p.range[0]:g} … {_p.range[1]:g}"
        _rows.append(f"| {_name} | {_p.value:g} | {_p.unit} | {_range} | {_p.provenance} |")
    _u = np.linspace(0.0, 0.2, 201)
    _stop = np.trapezoid(robot["m11"] * _u / (robot["Fu_max"] + robot["Xu"] * _u + robot["Xuu"] * _u**2), _u)
    print(f"surge mass {robot['m11']:.1f} kg; from 0.2 m/s it stops after {_stop:.2f} m at the least")
    mo.md("\n".join(_rows))
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    Next: [priorities](02_priorities.py). The guide [add a vehicle](guides/add-a-vehicle.md) tunes, verifies and
    exports with a file of your own.
    """)
    return


if __name__ == "__main__":
    app.run()
