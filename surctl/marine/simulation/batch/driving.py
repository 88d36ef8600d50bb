"""The thrust that reaches the plant for the thrust command of the law, as one instruction list."""

from __future__ import annotations

import casadi as ca

from surctl.ir import Layout, Program, lower_named
from surctl.marine.control import Law
from surctl.marine.simulation.batch.structure import Structure
from surctl.marine.simulation.thruster_faults import fin_excess
from surctl.marine.vehicle import plant_state

__all__ = ["driven"]


def driven(structure: Structure, law: Law, parameters: Layout) -> Program:
    """Return the program from a run's parameters and the law's command to the thrust, with the errors of the scenario.

    With fins, the state of the plant and the law's telemetry are inputs too: a fin gives the force of its deflection at
    the speed through the water, as in `Thrusters.achieved`.
    """
    w, known = parameters.symbols("w")
    tau, inputs = ca.SX.sym("tau", 4), dict[str, ca.SX]()
    delivered = tau
    if structure.actuators is not None and structure.actuators.fins:
        sizes = {"plant": plant_state(structure.form).size, "telemetry": law.outputs.size - 4}
        inputs = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
        forces, commands = (
            inputs["telemetry"][law.telemetry_slice(name)] for name in ("thruster_force", "thruster_command")
        )
        psi = inputs["plant"][3]
        along = ca.dot(ca.vertcat(ca.cos(psi), ca.sin(psi)), known["current"])
        speed = ca.fmax(inputs["plant"][4] - along, 0)
        delivered += fin_excess(structure.actuators, forces, commands, speed * speed)
    thrust = delivered * known["thrust_gain"] + known["thrust_bias"]
    return lower_named("drive", {"w": w, "tau": tau, **inputs}, {"thrust": thrust})
