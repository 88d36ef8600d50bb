"""Stirred tank reactor: a region about an unstable operating point, with the limits of the jacket

The rate of an exothermic reaction follows Arrhenius' law, exp(-E/(R T)). At 350 K the operating point is unstable: the
heat of the reaction grows faster with the temperature than the jacket removes it. A controller sets the temperature of
the jacket every 6 s, between its limits, and stops its integrator there. From a box of the states,
surctl proves a region in which every solution converges, at the instants and in between.
`surctl export reactor.py:build` writes the controller as C.
Plant: Seborg, Edgar, Mellichamp and Doyle, Process Dynamics and Control, example 2.5.
"""

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from surctl.ir import Layout, Port
from surctl.lyapunov import find_stability, sampled_dynamics
from surctl.system import Action, Controller, Plant, System, run_system

FLOW, VOLUME, FEED, PERIOD, LIMIT = 100.0, 100.0, 350.0, 0.1, 30.0  # l/min, l, K, min, K
CONTENT, HEAT, TRANSFER = 239.0, 5e4, 5e4  # rho C_p [J/(l K)], heat of the reaction [J/mol], to the jacket [J/(min K)]
REST, JACKET = (0.5, 350.0), 300.0  # concentration [mol/l] and temperature [K] at rest; jacket [K]
STATE = Layout((Port("conc", (1,), "mol/l", "from 0.5"), Port("temp", (1,), "K", "from 350 K")))
COMMAND = Layout((Port("jacket", (1,), "K", "temperature from 300 K"),))
WITHIN = {"conc": (-0.3, 0.3), "temp": (-15, 15), "controller.z": (-40, 40)}


def ode(x, f, d, p):
    """Time derivative of the state, per minute."""
    conc, temp = REST[0] + x["conc"], REST[1] + x["temp"]
    rate = 7.2e10 * ca.exp(-8750.0 / temp) * conc  # mol/(l min)
    cooling = TRANSFER / (VOLUME * CONTENT) * (JACKET + f["jacket"] - temp)
    heating = FLOW / VOLUME * (FEED - temp) + HEAT / CONTENT * rate
    return {"conc": FLOW / VOLUME * (1.0 - conc) - rate, "temp": heating + cooling}


def law(x, u, p):
    """Proportional and integral feedback; the integrator follows the limited command."""
    raw = -p["gain"] * u["temp"] + x["z"]
    jacket = ca.fmin(ca.fmax(raw, -LIMIT), LIMIT)
    return Action({"jacket": jacket}, {"z": x["z"] + PERIOD * (jacket - raw - 1.0 * u["temp"])})


def build():
    """Return the system."""
    plant = Plant("reactor", STATE, COMMAND, ode)
    gains, integral = (
        Layout((Port("gain", (1,), "1", "proportional", 4.0),)),
        Layout((Port("z", (1,), "K", "integral"),)),
    )
    controller = Controller("jacket_control", PERIOD, STATE, COMMAND, law, gains=gains, state=integral)
    return System(plant, controller, duration=10.0, within=WITHIN)


if __name__ == "__main__":
    system = build()
    result = find_stability(sampled_dynamics(system, WITHIN))
    claim = result.claim
    print(f"{result.verdict}: {claim.statement}")
    for name, low, high in zip(claim.dynamics.names, *claim.dynamics.box, strict=True):
        print(f"  {name} from {low:.3g} to {high:.3g}")
    # starts on the border in the plane of concentration and temperature, with the integrator at rest
    turn = np.linspace(0, 2 * np.pi, 97)
    ring = np.zeros((3, len(turn)))
    ring[:2] = 0.1 * np.cos(turn), 5.0 * np.sin(turn)
    level = claim.dynamics.compiled(claim.function)
    for _ in range(8):  # the equilibrium is not exactly at 0
        ring *= np.sqrt(claim.level / np.asarray(level(ring, np.zeros((0, len(turn))))))
    plt.plot(*ring[:2], lw=2)
    ends = []
    for conc, temp in ring[:2, ::12].T:
        run = run_system(system, 10.0, {"start.conc": conc, "start.temp": temp})
        plt.plot(run["conc"][:, 0], run["temp"][:, 0], color="0.6", lw=0.8)
        ends.append(abs(run["temp"][-1, 0]))
    print(f"{len(ends)} runs from the border: after 10 min, at most {max(ends):.2g} K from the operating point")
    plt.xlabel("conc [mol/l]")
    plt.ylabel("temp [K]")
    plt.title("border of the proved region, and solutions from it")
    plt.savefig("reactor.png")
