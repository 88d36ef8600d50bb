"""Otter: a lawnmower survey in a current

The catamaran Otter has two propellers. The survey is a table of the scenario file; the guidance `ilos` estimates the
drift by the current and steers against it.
"""

from pathlib import Path

from surctl.marine.control import build_law, default_law
from surctl.marine.report import plot_run
from surctl.marine.simulation import load_scenario, simulate
from surctl.marine.tuning import derive_gains
from surctl.marine.vehicle import load_vehicle

Path("survey.toml").write_text("""
kind = "scenario"
name = "survey"
title = "Two lines of 20 m in a current"
provenance = "chosen"
vehicle = "otter"
path_m = [[20, 20], [30, 20]]
depth_m = -0.1
cruise_m_per_s = 0.7
cap_m_per_s = 1.0
arrival_m = 2.0
site = { length_m = 90, width_m = 60, depth_m = 5 }
disturbance = { current_m_per_s = [0.0, 0.1] }
[survey]
kind = "lawnmower"
corner_m = [30, 20]
length_m = 20
width_m = 8
spacing_m = 8
ends = "round"
""")
otter, mission = load_vehicle("otter"), load_scenario("survey.toml")
derivation = derive_gains(otter, cruise=mission.cruise)
print(f"disk margin {derivation.disk_margin:.2f} at {mission.cruise} m/s, path of {mission.path.length:.0f} m")
run = simulate(mission, otter, gains=derivation.gains, law=build_law(default_law(otter), guidance="ilos"))
print(f"{run.metrics.stopped_because} after {run.metrics.time_s:.0f} s, path error {run.metrics.path_error_m:.2f} m")
plot_run(run).figure.savefig("otter_survey.png")
