"""The proof of the open chain: a package of someone else's, in a folder of its own, uses documented names alone.

It brings a plant, a controller, a law, a task and a claim of its own, and runs them through checks, simulation, sweep,
margins, tuning, proof and export.
"""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path

from surctl.marine.simulation.scenario import LIBRARY
from tests.processes import run_python
from tests.tools import need_compiler

PACKAGE = {
    "buoyant/__init__.py": '"""A third party\'s plant, law, task and claim for surctl."""\n',
    "buoyant/float_.py": '''
"""A float that changes its volume to hold a depth: plant and controller."""
import casadi as ca
from surctl.ir import Layout, Port
from surctl.system import Action, Controller, Cost, Plant, System

DEPTH, SPEED = Port("depth", (1,), "m", "below the surface", 1.0), Port("speed", (1,), "m/s", "downwards")
VOLUME = Port("volume", (1,), "m^3", "more than neutral")

def build() -> System:
    plant = Plant(
        "buoy",
        state=Layout((DEPTH, SPEED)),
        inputs=Layout((VOLUME,)),
        parameters=Layout((Port("mass", (1,), "kg", "with added mass", 20.0),)),
        ode=lambda x, f, d, p: {
            "depth": x["speed"],
            "speed": (-9810 * f["volume"] - 30 * x["speed"] * ca.fabs(x["speed"]) - 8 * x["speed"]) / p["mass"],
        },
    )
    target = Port("target", (1,), "m", "depth to hold", 2.0)
    controller = Controller(
        "hold_depth",
        dt=0.1,
        inputs=Layout((DEPTH, SPEED, target)),
        command=Layout((VOLUME,)),
        gains=Layout(
            (Port("k_p", (1,), "m^2", "of the depth", 4e-4), Port("k_d", (1,), "m^2 s", "of the speed", 2e-3))
        ),
        law=lambda x, u, p: Action(p["k_p"] * (u["depth"] - u["target"]) + p["k_d"] * u["speed"]),
    )
    late = Cost(lambda s: ca.fabs(s.x["depth"] - 2) - 0.05, "last_time", "s", "until the depth is held")
    return System(plant, controller, costs={"late": late})
''',
    "buoyant/law.py": '''
"""A law for the robot world: hold still above a point, with a task of its own."""
import casadi as ca
from surctl.marine.control import Decision, GainSpec, LawSource
from surctl.tasks import Task, depth_task

def range_task(eta: ca.SX, *, gain: float = 0.4) -> Task:
    """Distance to the origin of the site, kept at 2 m."""
    sigma = ca.sqrt(ca.sumsqr(eta[:2]) + 1e-6)
    return Task(name="range", eta=eta, sigma=sigma, target=2.0, gain=gain, unit="m", kinematics="vehicle")

def hover() -> LawSource:
    def decide(s):
        return Decision([range_task(s.eta, gain=s.p["k_range"]), depth_task(s.eta, s.p["depth"], gain=s.p["k2"])])
    gains = {"k_range": GainSpec("1/s", "of the distance", default=0.4, range=(0.1, 1.0))}
    return LawSource("hover", decide, gains=gains)
''',
    "buoyant/chain.py": '''
"""Everything that the package brings, through the whole chain."""
import sys
import zipfile
from pathlib import Path

import numpy as np

from buoyant import law
from buoyant.float_ import build
from surctl.marine.control import law_ref, load_gains
from surctl.export import Records, software_in_the_loop, write_bundle
from surctl.marine.export import build_bundle
from surctl.lyapunov import continuous_dynamics, find_stability
from surctl.marine.simulation import Case, load_scenario, simulate_batch
from surctl.system import linearise, run_system, simulate_system
from surctl.testing import check_task
from surctl.marine.testing import check_law
from surctl.tuning import tune_system
from surctl.marine.vehicle import load_vehicle
from surctl.verification import system_disk_margin, system_margins

out = Path(sys.argv[1])
system = build()
check_task(law.range_task), check_law(law.hover())
swept = simulate_system(system, 60.0, {"k_p": np.linspace(2e-4, 8e-4, 50)})
best = float(np.linspace(2e-4, 8e-4, 50)[np.argmin(swept["late"])])
record = run_system(system, 60.0, {"k_p": best})
assert record["late"] == swept["late"].min() < 30
linear = linearise(system)
assert system_disk_margin(linear).stable and all(m.stable for m in system_margins(linear))
assert not tune_system(system, 60.0, {"k_p": (2e-4, 8e-4)}, trials=8).unmet
around = {"depth": (1.0, 3.0), "speed": (-1.0, 1.0)}
region = find_stability(continuous_dynamics(system, around, values={"start.depth": 2.0, "k_p": best}), first=True)
assert region.verdict == "proved"
bundle = build_bundle(system.controller, {"k_p": np.array([best])})
write_bundle(bundle, out)
sil = software_in_the_loop(system.controller, Records(*record.controller))
assert sil.passed and sil.tau.absolute == sil.state.absolute == 0.0
print("settled", record["late"])
reference = law_ref(f"{law.__file__}:hover")
case = Case(load_scenario("tank-speed-010"), load_vehicle("sur540-flooded"), load_gains("default"), reference)
runs = simulate_batch(case, {"k_range": [0.2, 0.4]}, seeds=np.zeros(2, dtype=np.int64))
print("hovered", runs.column("time_s").tolist())
''',
    "claim.toml": """
kind = "claim"
name = "float-drag"
statement = "the drag never drives the float"
expected = "proved"
unit = "W"
left = "-(8 + 30 * abs(v)) * v * v"
right = "0"

[variables]
v = { lower = -1.0, upper = 1.0, unit = "m/s", meaning = "speed" }
""",
}


def test_the_package_uses_documented_names_only() -> None:
    for text in (text for name, text in PACKAGE.items() if name.endswith(".py")):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("surctl"):
                documented = importlib.import_module(node.module or "").__all__
                assert {alias.name for alias in node.names} <= set(documented), node.module


def test_a_package_of_a_third_party_runs_the_whole_chain(tmp_path: Path) -> None:
    need_compiler()
    site, claim = tmp_path / "site", tmp_path / "claim.toml"
    for name, text in PACKAGE.items():
        (site / name).parent.mkdir(parents=True, exist_ok=True)
        (site / name).write_text(text)
    claim.write_text(PACKAGE["claim.toml"])
    scenario = (LIBRARY / "tank-speed-010.toml").read_text()
    (tmp_path / "short.toml").write_text(re.sub("time_limit_s = .*", "time_limit_s = 5.0", scenario))
    chain = run_python(["-m", "buoyant.chain", str(tmp_path / "firmware")], cwd=site)
    assert chain.returncode == 0, chain.stderr
    settled, hovered = chain.stdout.splitlines()
    assert settled.startswith("settled ")
    assert hovered.startswith("hovered [")
    assert (tmp_path / "firmware" / "hold_depth.c").is_file()
    system, law = f"{site}/buoyant/float_.py:build", f"{site}/buoyant/law.py:hover"
    for words, line in (
        (["verify", system], "volume"),
        (["sweep", system, "k_p=2e-4..8e-4:5", "--seconds", "60", "--out", "swept"], "late"),
        (["verify", str(claim)], "proved"),
        (
            ["export", "--scenario", "short.toml", "--law", law, "--sensing", "truth", "--out", "hover"],
            "thrust 0.0e+00, state 0.0e+00",
        ),
    ):
        done = run_python(["-m", "surctl", *words], cwd=tmp_path, drawn=False)
        assert line in done.stdout, (words, done.stdout, done.stderr)
