"""A torpedo with a rudder: gains that follow from the vehicle, and a mission

REMUS 100 has a propeller and a rudder: it has no sideways force, and its rudder gives no force at rest. Law, cruise
speed and gains follow from the vehicle file.
"""

from dataclasses import replace

from surctl.marine.control import default_law
from surctl.marine.guidance import Path
from surctl.marine.report import plot_run
from surctl.marine.simulation import simulate
from surctl.marine.study import scaled_missions
from surctl.marine.vehicle import load_vehicle

remus = load_vehicle("remus100")
missions, gains, derivation = scaled_missions(remus)
corner = Path([[8, 8], [33, 8], [33, 28]])
mission = replace(missions[1], name="corner", path=corner, site=(45, 36, 5))
print(f"law {default_law(remus)}, cruise speed {mission.cruise:.2f} m/s, disk margin {derivation.disk_margin:.2f}")
print("gains:", {name: float(f"{gains[name]:.3g}") for name in ("k_v", "k_r", "k_psi", "lookahead")})
run = simulate(mission, remus, gains=gains)
print(f"{mission.name}: {run.metrics.stopped_because} after {run.metrics.time_s:.0f} s")
plot_run(run).figure.savefig("rudder_mission.png")
