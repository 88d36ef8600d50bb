"""Write a vehicle in a scenario for MuJoCo: the model, and the force of the water as C."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from surctl.files import prepare_folder, write_file
from surctl.ir import emit_block
from surctl.marine.engine.fluid import body_of, environment, fluid_program
from surctl.marine.engine.mjcf import ACTUATORS, mjcf
from surctl.marine.engine.options import EngineOptions
from surctl.marine.simulation import build_world

if TYPE_CHECKING:
    from surctl.marine.simulation import Scenario
    from surctl.marine.vehicle import Vehicle

__all__ = ["write_mjcf"]

_TEXT = """/* The force of the water on {vehicle} in {scenario}, for the MuJoCo model scene.xml beside this file.
 *
 *   cc -std=c99 -O2 -shared -fPIC -I INCLUDE water.c -o water.so -lm      (INCLUDE: the folder above mujoco/mujoco.h)
 *
 * In C: mjcb_passive = surctl_water. In Python, where INCLUDE is the folder include of the package:
 *
 *   mujoco.set_mjcb_passive(ctypes.CDLL("./water.so").surctl_water)
 *
 * The water moves with the current below. Obstacles are mocap bodies; a program that knows their paths moves them.
 */
#include <math.h>
#include <string.h>
#include <mujoco/mujoco.h>

{block}
static const double parameters[] = {{{parameters}}};

/* current (3) [m/s]; outer force (3) [N] in the world and yaw moment [N m]; hull radius [m]; share of the missing
 * buoyancy; z at which the hull is ballasted to float [m]; mass [kg] and moments of inertia [kg m^2] of the
 * model; length, width and height [m] of a hull that is a box, else 0 */
double surctl_environment[] = {{{environment}}};

/* index of a name in a table of the model; it calls no function of MuJoCo, so that the library needs no linking */
static int index_of(const mjModel *m, const int *addresses, int count, const char *name)
{{
    for (int k = 0; k < count; ++k) {{
        if (strcmp(m->names + addresses[k], name) == 0) {{
            return k;
        }}
    }}
    return -1;
}}

void surctl_water(const mjModel *m, mjData *d);
void surctl_water(const mjModel *m, mjData *d)
{{
    const int joint = index_of(m, m->name_jntadr, (int)m->njnt, "{joint}");
    const int actuator = index_of(m, m->name_actuatoradr, (int)m->nu, "{actuator}");
    double force[{dof}];
    if (joint < 0 || actuator < 0) {{
        return; /* another model */
    }}
    surctl_fluid(d->qpos + m->jnt_qposadr[joint], d->qvel + m->jnt_dofadr[joint], {thrust}, parameters,
                 surctl_environment, force);
    for (int k = 0; k < {dof}; ++k) {{
        d->qfrc_passive[m->jnt_dofadr[joint] + k] += force[k];
    }}
}}
"""


def write_mjcf(
    scenario: Scenario, vehicle: Vehicle, folder: Path, *, options: EngineOptions | None = None
) -> list[Path]:
    """Write the MuJoCo model `scene.xml` and the force of the water `water.c` to a folder, and return both paths.

    Raises:
        InputError: the options need what the vehicle file does not state, the hull starts inside an obstacle, or the
            folder cannot be written.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.engine import write_mjcf
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> files = write_mjcf(load_scenario("tank-static"), load_vehicle("sur540-tilting"), Path("model"))
        >>> [file.name for file in files]
        ['scene.xml', 'water.c']
    """
    build_world(scenario, vehicle, seed=0)  # refuses a start inside an obstacle
    prepare_folder(folder)
    body = body_of(vehicle, options or EngineOptions())
    lagged = vehicle["thrust_lag"] > 0
    text = _TEXT.format(
        vehicle=vehicle.name,
        scenario=scenario.name,
        block=emit_block(fluid_program(body), symbol="surctl_fluid", folded=True),
        parameters=_numbers(body.parameters.tolist()),
        environment=_numbers(environment(body, scenario, vehicle["radius"]).tolist()),
        joint="free" if body.options.dof == 6 else "x",
        actuator=ACTUATORS[0],
        thrust="d->act + m->actuator_actadr[actuator]" if lagged else "d->ctrl + actuator",
        dof=body.options.dof,
    )
    model = mjcf(scenario, vehicle, options=body.options)
    return [write_file(folder / "scene.xml", model), write_file(folder / "water.c", text)]


def _numbers(values: list[float]) -> str:
    return ", ".join(repr(float(value)) for value in values)
