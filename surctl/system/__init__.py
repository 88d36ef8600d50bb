"""Closed loops of any plant and any sampled controller, for simulation, parameter sweeps and linearisation."""

from surctl.system.controller import (
    NONFINITE,
    Action,
    Controller,
    ControllerStep,
    SampledController,
    Step,
    command_ports,
)
from surctl.system.linear import Linearisation, Operating, find_equilibrium, linearise
from surctl.system.loop import Cost, Signals, System
from surctl.system.parts import entry_labels, entry_units
from surctl.system.plant import Parts, Plant
from surctl.system.record import Record, run_system
from surctl.system.runs import ENDED, LOST, Runs, periods, simulate_system

__all__ = [
    "ENDED",
    "LOST",
    "NONFINITE",
    "Action",
    "Controller",
    "ControllerStep",
    "Cost",
    "Linearisation",
    "Operating",
    "Parts",
    "Plant",
    "Record",
    "Runs",
    "SampledController",
    "Signals",
    "Step",
    "System",
    "command_ports",
    "entry_labels",
    "entry_units",
    "find_equilibrium",
    "linearise",
    "periods",
    "run_system",
    "simulate_system",
]
