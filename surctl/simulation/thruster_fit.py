"""Check whether the thrusters of a vehicle can produce the forces that its file promises."""

from __future__ import annotations

from surctl.simulation.finding import Finding
from surctl.vehicle import Vehicle, attainable

__all__ = ["thruster_findings"]

_LIMITS = {"Fu_max": "surge", "Fv_max": "sway", "Fw_max": "heave", "Fr_max": "yaw"}
_SLACK = 1e-6


def thruster_findings(vehicle: Vehicle) -> list[Finding]:
    """Return a warning for each thrust limit that the thrusters cannot reach, alone or together with the others.

    The law limits its command on each axis to `Fu_max`, …; margins and certificates assume that every command within
    these limits reaches the plant. This holds if the box of the limits lies in the attainable set.

    Example:
        >>> from surctl.simulation import thruster_findings
        >>> from surctl.vehicle import load_vehicle
        >>> greedy = load_vehicle("bluerov2-heavy").with_values({"Fr_max": 35.0})
        >>> print(thruster_findings(greedy)[0].text)
        the thrusters give at most 29.75 N m in yaw without other forces, but Fr_max is 35 N m: lower it
    """
    if vehicle.actuators is None:
        return []
    forces, results = attainable(vehicle.actuators), list[Finding]()
    for (name, axis), (low, high) in zip(_LIMITS.items(), forces.intervals().tolist(), strict=True):
        most, unit = min(-low, high), vehicle.parameters[name].unit
        if vehicle[name] > most * (1 + _SLACK) + _SLACK:
            text = f"the thrusters give at most {most:.4g} {unit} in {axis} without other forces, "
            results.append(
                Finding("warning", f"thrust.{name}", f"{text}but {name} is {vehicle[name]:g} {unit}: lower it")
            )
    share = forces.box_share(vehicle.thrust_limit)
    if share < 1 - _SLACK:
        first, *_ = [name for name, _ in vehicle.actuators.levels]
        text = (
            f"the thrusters give only {share:.0%} of Fu_max, Fv_max, Fw_max and Fr_max at once. Beyond this share the "
            f"allocation keeps {first} and gives up other forces; margins and certificates hold only within it. "
            f"Multiply the four limits by {share:.2g} for limits that hold together"
        )
        results.append(Finding("warning", "thrust", text))
    return results
