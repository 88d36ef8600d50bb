"""Overhead crane: a region for the sampled controller with its force limit

A trolley carries a hanging load whose mass is known to 10 %. The controller runs at 10 Hz, with an integrator that
stops at the force limit of 10 N; the force is held for a period. From a box of the states, surctl finds and proves a
region in which every solution converges, at the instants and in between. The limit acts inside the region.
`surctl verify crane.py:build` proves such a region too.
"""

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from surctl.ir import Layout, Port
from surctl.lyapunov import find_stability, sampled_dynamics
from surctl.system import Action, Controller, Plant, System, run_system

LIMIT, ROPE, GRAVITY, PERIOD = 10.0, 1.5, 9.81, 0.1  # N, m, m/s^2, s
POS, VEL = Port("pos", (1,), "m", "of the trolley", 0.0), Port("vel", (1,), "m/s", "of the trolley")
ANG, RATE = Port("ang", (1,), "rad", "of the load from the vertical", 0.0), Port("rate", (1,), "rad/s", "of the load")
FORCE = Port("force", (1,), "N", "on the trolley")
WITHIN = {"pos": (-1.2, 1.2), "vel": (-1.2, 1.2), "ang": (-0.5, 0.5), "rate": (-1.5, 1.5), "controller.z": (-20, 20)}


def ode(x, f, d, p):
    """Time derivative of the state."""
    s, c, m = ca.sin(x["ang"]), ca.cos(x["ang"]), p["load"]
    push = f["force"] - 5.0 * x["vel"] + m * ROPE * x["rate"] ** 2 * s + m * GRAVITY * s * c
    a = push / (20.0 + m * s**2)
    return {"pos": x["vel"], "vel": a, "ang": x["rate"], "rate": -(a * c + GRAVITY * s) / ROPE - 0.05 * x["rate"]}


def law(x, u, p):
    """State feedback with an integrator, which follows the limited force."""
    raw = -51.0 * u["pos"] - 52.0 * u["vel"] + 2.4 * u["ang"] - 9.3 * u["rate"] + x["z"]
    force = ca.fmin(ca.fmax(raw, -LIMIT), LIMIT)
    return Action(command={"force": force}, state={"z": x["z"] + PERIOD * (force - raw - 8.8 * u["pos"])})


def build():
    """Return the system, with the range of the load."""
    state, force = Layout((POS, VEL, ANG, RATE)), Layout((FORCE,))
    plant = Plant("crane", state, force, ode, parameters=Layout((Port("load", (1,), "kg", "hanging mass", 10.0),)))
    integral = Layout((Port("z", (1,), "N", "integral force"),))
    controller = Controller("crane_control", PERIOD, state, force, law, state=integral)
    return System(plant, controller, ranges={"plant.load": (9.0, 11.0)}, within=WITHIN)


if __name__ == "__main__":
    system = build()
    result = find_stability(sampled_dynamics(system, WITHIN))
    claim = result.claim
    print(f"{result.verdict}: {claim.statement}")
    for name, low, high in zip(claim.dynamics.names, *claim.dynamics.box, strict=True):
        print(f"  {name} from {low:.2f} to {high:.2f}")
    # starts on the border in the plane of position and speed, with the controller's state at 0
    turn = np.linspace(0, 2 * np.pi, 97)
    x = np.zeros((len(claim.dynamics.names), len(turn)))
    x[:2] = np.cos(turn), np.sin(turn)
    x *= np.sqrt(claim.level / np.asarray(claim.dynamics.compiled(claim.function)(x, np.full((1, len(turn)), 10.0))))
    plt.plot(*x[:2], lw=2)
    ends = []
    for k, (pos, vel) in enumerate(x[:2, ::12].T):
        run = run_system(system, 30.0, {"start.pos": pos, "start.vel": vel, "plant.load": 9.0 if k % 2 else 11.0})
        plt.plot(run["pos"][:, 0], run["vel"][:, 0], color="0.6", lw=0.8)
        ends.append(abs(run["pos"][-1, 0]))
    print(f"{len(ends)} runs from the border: after 30 s, at most {1e3 * max(ends):.1f} mm from the target")
    plt.xlabel("pos [m]")
    plt.ylabel("vel [m/s]")
    plt.title("border of the proved region, and solutions from it")
    plt.savefig("crane.png")
