"""The limits `Fu_max`, … of a vehicle file that follow from its thrusters."""

from __future__ import annotations

from collections.abc import Container, Mapping

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.vehicle.thruster_file import axis_ends
from surctl.marine.vehicle.thrusters import Actuators

__all__ = ["largest_forces"]

_NAMES = ("Fu_max", "Fv_max", "Fw_max", "Fr_max")
_ARM = 1e-6  # [m] a shorter arm gives no yaw moment


def largest_forces(actuators: Actuators, *, stated: Container[str], source: str) -> Mapping[str, float]:
    """Return `Fu_max`, `Fv_max`, `Fw_max` [N] and `Fr_max` [N m]: the largest value on each axis alone.

    All other axes are 0 meanwhile, and the force is available in both directions; a craft without sway force has
    `Fu_reverse` beside `Fu_max` if it is weaker astern. Fins count in yaw only, with their forces at 1 m/s.

    Args:
        actuators: the thrusters.
        stated: names of the limits that the file states, which are left out.
        source: name of the file in error messages.

    Raises:
        InputError: the thrusters give no surge force or no yaw moment; the message names a thruster and the remedy.
    """
    ends = axis_ends(actuators, 1.0)
    limits = dict(zip(_NAMES, np.minimum(-ends[:, 0], ends[:, 1]).tolist(), strict=True))
    astern, ahead = (-ends[0, 0]).item(), ends[0, 1].item()
    if "Fu_max" not in stated:
        _check_surge(actuators, astern, ahead, source)
        if limits["Fv_max"] == 0 and astern < ahead:
            limits |= {"Fu_max": ahead, "Fu_reverse": astern}
    if "Fr_max" not in stated and limits["Fr_max"] <= 0:
        raise _no_yaw(actuators, source)
    return {name: value for name, value in limits.items() if name not in stated}


def _check_surge(actuators: Actuators, astern: float, ahead: float, source: str) -> None:
    if astern > 0 and ahead > 0:
        return
    pushing = [k for k, one in enumerate(actuators.thrusters) if one.fin is None and abs(one.direction[0]) > _ARM]
    if not pushing:
        raise InputError(
            "no thruster pushes ahead",
            file=source,
            key="thruster",
            value=", ".join(actuators.names),
            remedy="add a [[thruster]] with push = [1, 0, 0]",
        )
    weak = next((k for k in pushing if actuators.thrusters[k].reverse == 0), pushing[0])
    where = "astern" if astern <= 0 else "ahead"
    raise _lacks(
        actuators, weak, f"leaves the craft no force {where} without another one, and the laws brake with it", source
    )


def _no_yaw(actuators: Actuators, source: str) -> InputError:
    arms: NDArray[np.float64] = np.array([float(np.abs(one.columns[5]).max()) for one in actuators.thrusters])
    turning = np.flatnonzero(arms > _ARM)
    if turning.size:
        weak = next((int(k) for k in turning if actuators.thrusters[k].reverse == 0), int(turning[0]))
        return _lacks(actuators, weak, "gives no yaw moment without surge or sway force", source)
    fins = [k for k, one in enumerate(actuators.thrusters) if one.fin is not None]
    k = fins[0] if fins else 0
    name = actuators.names[k]
    remedy = f"place {name} at x != 0" if fins else f"place {name} beside the middle, or add a rudder at x != 0"
    return InputError(
        f"{name} gives no yaw moment",
        file=source,
        key=f"thruster.{k}.at_m",
        value=list(actuators.thrusters[k].at),
        remedy=remedy,
    )


def _lacks(actuators: Actuators, k: int, problem: str, source: str) -> InputError:
    one = actuators.thrusters[k]
    return InputError(
        f"{one.name} {problem}",
        file=source,
        key=f"thruster.{k}.reverse",
        value=f"{one.reverse:g} N",
        remedy=f"give {one.name} a force in reverse, or add a thruster or rudder that gives it",
    )
