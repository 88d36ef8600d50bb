"""Double integrator with a barrier: a cart that never crosses a line

A safety filter changes the command of an operator as little as possible, so that the cart can always still brake before
the line. The claim is proved for every command, and the run shows it at work.
"""

from pathlib import Path

import casadi as ca

from surctl.ir import Layout, Port
from surctl.lyapunov import load_problem, solve
from surctl.report import plot_record
from surctl.system import Controller, Plant, System, run_system

Path("line.toml").write_text("""
kind = "barrier"
name = "line"
barrier = "place + speed - 1"
multiplier = "-1"
initial = ["place + speed <= 0.5"]
unsafe = ["place + speed >= 1.1"]
[definitions]
force = "min(operator, 1 - place - 2*speed)"
[states]
place = { rate = "speed", lower = -3, upper = 3, unit = "m" }
speed = { rate = "force", lower = -2, upper = 2, unit = "m/s" }
[parameters]
operator = { lower = -1, upper = 1, unit = "m/s^2", meaning = "command of the operator, may vary in time" }
""")
proof = solve(load_problem(Path("line.toml")))
print(f"{proof.verdict}: place + speed stays at most 1 for every operator, so the cart never crosses 1 m")

PLACE, SPEED = Port("place", (1,), "m", "of the cart", -1.0), Port("speed", (1,), "m/s", "of the cart")
OPERATOR, FORCE = (
    Port("desired", (1,), "m/s^2", "command of the operator", 0.5),
    Layout((Port("tau", (1,), "m/s^2", ""),)),
)


def cart(x, f, d, p):
    """Time derivative of place and speed."""
    return {"place": x["speed"], "speed": f["tau"]}


def safe(x, u, p):
    """The operator's command, limited by B' <= -B with B = place + speed - 1."""
    return ca.fmin(u["desired"], 1 - u["place"] - 2 * u["speed"])


plant = Plant("cart", Layout((PLACE, SPEED)), FORCE, cart)
law = Controller("safety_filter", 0.02, Layout((PLACE, SPEED, OPERATOR)), FORCE, safe)
record = run_system(System(plant, law), 12.0)
print(f"the operator pushes on: the cart comes to {record['place'].max():.3f} m of 1 m")
plot_record(record).savefig("barrier_double_integrator.png")
