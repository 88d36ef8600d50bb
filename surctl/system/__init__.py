"""Closed loops of any plant and any sampled controller, for simulation, parameter sweeps and linearisation."""

from surctl.system.controller import NONFINITE, Action, Controller, ControllerStep, SampledController
from surctl.system.from_control import from_control, to_control
from surctl.system.linear import Linearisation, Operating, find_equilibrium, linearise, linearise_plant
from surctl.system.linear_loop import LinearLoop
from surctl.system.loop import LOST, Cost, System, periods
from surctl.system.parts import Parts, entry_labels, entry_units
from surctl.system.plant import Plant
from surctl.system.record import Record, run_system, save_record
from surctl.system.runs import Runs, simulate_system
from surctl.system.sampled import Sampled, message
from surctl.system.values import every_combination

__all__ = [
    "LOST", "NONFINITE", "Action", "Controller", "ControllerStep", "Cost", "LinearLoop", "Linearisation", "Operating",
    "Parts", "Plant", "Record", "Runs", "Sampled", "SampledController", "System", "entry_labels", "entry_units",
    "every_combination", "find_equilibrium", "from_control", "linearise", "linearise_plant", "message", "periods",
    "run_system", "save_record", "simulate_system", "to_control",
]  # fmt: skip
