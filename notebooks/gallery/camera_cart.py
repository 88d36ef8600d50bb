"""Cart seen by a camera: sampled sensors, noise, a late radio link and lost messages

A camera at 50 Hz measures the position, a radio link delivers it 40 ms later and loses messages, and the controller
runs at 10 Hz. The margins are those of the whole chain; a seed selects the noise of a run.
"""

import numpy as np

from surctl.ir import Layout, Port
from surctl.report import plot_runs
from surctl.system import Controller, Cost, Plant, Sampled, System, linearise, message, simulate_system
from surctl.verification import system_disk_margin

POSITION, SPEED = Port("position", (1,), "m", "of the cart"), Port("speed", (1,), "m/s", "of the cart")
FORCE, TARGET = Port("force", (1,), "N", "on the cart"), Port("target", (1,), "m", "of the cart", 1.0)

cart = Plant(
    "cart",
    state=Layout((POSITION, SPEED)),
    inputs=Layout((FORCE,)),
    parameters=Layout((Port("mass", (1,), "kg", "of the cart", 2.0),)),
    ode=lambda x, f, d, p: {"position": x["speed"], "speed": f["force"] / p["mass"]},
)
law = Controller(
    "pd",
    dt=0.1,
    inputs=Layout((POSITION, SPEED, TARGET)),
    command=Layout((FORCE,)),
    gains=Layout((Port("k", (1,), "N/m", "stiffness", 6.0), Port("c", (1,), "N s/m", "damping", 6.0))),
    law=lambda x, u, p: -p["k"] * (u["position"] - u["target"]) - p["c"] * u["speed"],
)
camera = Sampled(
    "camera",
    period=0.02,
    inputs=Layout((POSITION,)),
    outputs=Layout((POSITION,)),
    parameters=Layout((Port("deviation", (1,), "m", "standard deviation of a picture", 0.02),)),
    normal=Layout((Port("noise", (1,), "1", "of a picture"),)),
    step=lambda x, u, p, w: {"position": u["position"] + p["deviation"] * w["noise"]},
)
radio = message("radio", Layout((POSITION,)), period=0.02, samples_late=2, loss=0.2)
error = Cost(lambda s: s.x["position"] - s.r["target"], "rms", "m", "position error")
settled = Cost(lambda s: (s.x["position"] - s.r["target"]) ** 2 - 0.05**2, "last_time", "s", "time to within 5 cm")

for name, sensors in (("true position", ()), ("camera and radio", (camera, radio))):
    linear = linearise(System(cart, law, sensors=sensors))
    print(f"{name}: disk margin {system_disk_margin(linear, 'position', 'speed').guaranteed:.2f} at the measurements")

system = System(cart, law, sensors=(camera, radio), costs={"error": error, "settled": settled})
for loss in (0.0, 0.2, 0.8):
    runs = simulate_system(system, 10.0, {"seed": np.arange(1000), "radio.loss": loss})
    late = np.percentile(runs["settled"], 95)
    print(f"{100 * loss:.0f} % of the messages lost, 1,000 runs: 95 % settle within {late:.1f} s")
plot_runs(runs).savefig("camera_cart.png")
