import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium", app_title="A vehicle and its dynamics")


@app.cell
def _():
    import marimo as mo

    return (mo,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    # A vehicle and its dynamics

    This notebook shows how a vehicle file describes a vehicle, and which properties follow from its parameters before
    you design a controller. It takes a few seconds.

    ## 1. Numbers with a source and a range

    A vehicle is a TOML file. Each number has a source and a range of possible values. The paper prints mass in air,
    diameter and speed; the other numbers of this vehicle are derived.
    """)
    return


@app.cell
def _(mo):
    import matplotlib.pyplot as plt
    import numpy as np

    from surctl.vehicle import (
        build_plant,
        linearise,
        load_vehicle,
        plant_parameters,
        plant_system,
        sphere,
        steady_speed,
    )

    vehicle = load_vehicle("sur540-flooded")
    _rows = ["| | value | unit | range |", "|---|---|---|---|"]
    for _name in ("radius", "m11", "m22", "m44", "Xu", "Xuu", "Nr", "Nrr", "Fu_max", "thrust_lag"):
        _p = vehicle.parameters[_name]
        _range = "–" if _p.range is None else f"{_p.range[0]:g} … {_p.range[1]:g}"
        _rows.append(f"| {_name} | {_p.value:g} | {_p.unit} | {_range} |")
    mo.md("\n".join(_rows))

    return build_plant, linearise, np, plant_parameters, plant_system, plt, sphere, steady_speed, vehicle


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 2. Parameters from the geometry of a sphere

    Most of the inertia comes from water: the water inside the hull, and the added mass of the water around it (for a
    sphere, half the displaced water). Change the flooded fraction with the slider: the mass in air has little
    influence.
    """)
    return


@app.cell
def _(mo):
    flooded = mo.ui.slider(0.0, 1.0, 0.05, value=0.75, label="flooded fraction", show_value=True)
    flooded

    return (flooded,)


@app.cell
def _(flooded, sphere, steady_speed):
    _made = sphere("mine", diameter=0.4, dry_mass=8.0, thrust=5.0, yaw_thrust=0.5, flooded=flooded.value)
    _low, _high = _made.parameters["m11"].range
    print(f"surge mass {_made['m11']:.1f} kg, {_low:.1f} to {_high:.1f} kg; in air 8 kg")
    print(f"steady speed at full thrust: {steady_speed(_made['Fu_max'], _made['Xu'], _made['Xuu']):.3f} m/s")
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 3. The equations, as CasADi sees them

    The equation of motion is $M\dot\nu + C(\nu)\nu + D(\nu)\nu = \tau$. The thrust follows its command with a lag, and
    there may be a current. The plant is a CasADi expression, so its Jacobians are exact.
    """)
    return


@app.cell
def _(build_plant, linearise, np, plant_parameters, vehicle):
    plant, p = build_plant(), plant_parameters(vehicle)
    print("states:", ", ".join(linearise(vehicle, np.zeros(4)).state_labels))

    def rate(nu, thrust):
        """Return the time derivative of (u, v, w, r) in still water."""
        _x = np.concatenate([np.zeros(4), nu, thrust])
        return np.asarray(plant.ode(_x, thrust, 0, p)).ravel()[4:8]

    _turning = rate([0.15, 0.0, 0.0, 0.3], np.zeros(4))
    print(f"cruising at 0.15 m/s and turning at 0.3 rad/s: sway acceleration {_turning[1]:.4f} m/s²")

    return (rate,)


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    The last number is the Coriolis term: in the rotating body frame the velocity turns, and the sway thrusters must
    provide the force $m_{11} u r$. At a yaw rate of 0.18 rad/s this force is half the sway thrust of this vehicle. The
    law therefore limits the yaw rate.
    """)
    return


@app.cell
def _(np, plt, vehicle):
    _r = np.linspace(0.0, 0.5, 101)
    _force = vehicle["m11"] * 0.15 * _r
    _, _ax = plt.subplots(figsize=(6.0, 2.8), layout="constrained")
    _ax.plot(_r, _force, label="required sway thrust at 0.15 m/s")
    _ax.axhline(vehicle["Fv_max"], color="0.4", linestyle="--", label="largest sway thrust")
    _ax.set_xlabel("yaw rate [rad/s]")
    _ax.set_ylabel("force [N]")
    _ax.legend()
    _ax.grid(visible=True, alpha=0.4)
    _half = 0.5 * vehicle["Fv_max"] / (vehicle["m11"] * 0.15)
    print(f"yaw rate that needs half the sway thrust: {_half:.2f} rad/s")
    _ax
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 4. Stopping

    This cell simulates a stop from 0.2 m/s with python-control: full thrust astern, thrust lag included. For any
    guidance law, the robot must detect an obstacle at least this distance ahead.
    """)
    return


@app.cell
def _(np, plant_system, plt, vehicle):
    import control

    _system = plant_system(vehicle)
    _time = np.linspace(0.0, 6.0, 601)
    _start = np.zeros(12)
    _start[4] = 0.2
    _astern = np.zeros((4, len(_time)))
    _astern[0] = -vehicle["Fu_max"]
    _response = control.input_output_response(_system, _time, _astern, _start)
    _x, _u = _response.states[0], _response.states[4]
    _stopped = int(np.argmax(_u <= 0.0))
    print(f"from 0.2 m/s the robot stops after {_time[_stopped]:.1f} s and {_x[_stopped]:.2f} m")
    _, _ax = plt.subplots(figsize=(6.0, 2.8), layout="constrained")
    _ax.plot(_time[: _stopped + 1], _u[: _stopped + 1])
    _ax.set_xlabel("time [s]")
    _ax.set_ylabel("surge [m/s]")
    _ax.grid(visible=True, alpha=0.4)
    _ax
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    ## 5. Poles against speed

    Drag damps the vehicle more at higher speed. At rest the surge pole is slowest, and a controller tuned at cruise
    speed has the least damping there. The linear models are `StateSpace` objects with named signals, so that you can
    use all functions of python-control on them.
    """)
    return


@app.cell
def _(linearise, np, plt, vehicle):
    _speeds = np.linspace(0.0, 0.25, 26)
    _models = [linearise(vehicle, np.array([s, 0.0, 0.0, 0.0])) for s in _speeds]
    _slow = [model.A[4, 4] for model in _models]  # d(du/dt)/du: at straight motion surge is decoupled
    print(f"surge pole: {_slow[0]:.4f} 1/s at rest, {_slow[15]:.4f} 1/s at 0.15 m/s")
    _, _ax = plt.subplots(figsize=(6.0, 2.6), layout="constrained")
    _ax.plot(_speeds, _slow)
    _ax.set_xlabel("speed [m/s]")
    _ax.set_ylabel("surge pole [1/s]")
    _ax.grid(visible=True, alpha=0.4)
    _ax
    return


@app.cell(hide_code=True)
def _(mo):
    mo.md(r"""
    Next: [priorities](02_priorities.py). To add your own vehicle, read the guide [add a
    vehicle](guides/add-a-vehicle.md).
    """)
    return


if __name__ == "__main__":
    app.run()
