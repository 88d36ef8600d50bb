"""Check whether the thrusters of a vehicle can produce the forces that its file promises."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees, pi

import numpy as np

from surctl.marine.allocation import working_flags
from surctl.marine.simulation.finding import Finding
from surctl.marine.vehicle import Vehicle, attainable, axis_ends

__all__ = ["held_share", "thruster_findings"]

_LIMITS = {"Fu_max": "surge", "Fv_max": "sway", "Fw_max": "heave", "Fr_max": "yaw"}
_SLACK = 1e-6
_HULLS, _LEAST_DEG = 3.0, 1.0  # farthest thruster in hull radii, least deflection [deg] of a fin in earnest


def thruster_findings(vehicle: Vehicle) -> list[Finding]:
    """Return a finding for each thrust limit that the thrusters cannot reach, alone or together with the others.

    The law limits its command on each axis to `Fu_max`, …; margins and certificates assume that every command within
    these limits reaches the plant. This holds if the box of the limits lies in the attainable set. A craft without sway
    force whose allocation keeps yaw may lose surge force while it turns: this is said as information. Fins have the
    limits of the speed `Vehicle.speed`.

    Example:
        >>> from surctl.marine.simulation import thruster_findings
        >>> from surctl.marine.vehicle import load_vehicle
        >>> greedy = load_vehicle("bluerov2-heavy").with_values({"Fr_max": 35.0})
        >>> print(thruster_findings(greedy)[0].text)
        the thrusters give at most 29.75 N m in yaw without other forces, but Fr_max is 35 N m: lower it
    """
    results = _drag(vehicle)
    if vehicle.actuators is None:
        return results
    results += [*_odd(vehicle), *_not_simulated(vehicle)]
    for axis, (name, word) in enumerate(_LIMITS.items()):
        reverse, unit = name.replace("_max", "_reverse"), vehicle.parameters[name].unit
        low, high = axis_ends(vehicle.actuators, vehicle.speed)[axis].tolist()
        stated = {name: high, reverse: -low} if reverse in vehicle.parameters else {name: min(-low, high)}
        for key, most in stated.items():
            if vehicle[key] > most * (1 + _SLACK) + _SLACK:
                text = f"the thrusters give at most {most:.4g} {unit} in {word} without other forces, "
                remedy = "lower it"
                if key == name and reverse not in vehicle.parameters and vehicle["Fv_max"] == 0 and -low < high:
                    text = f"the thrusters give {high:.4g} {unit} in {word} one way and {-low:.4g} {unit} the other, "
                    remedy = f'add {reverse} = "{-low:.4g} {unit}"' if low < 0 else "give a thruster a force in reverse"
                    if vehicle[key] > high * (1 + _SLACK) + _SLACK:
                        remedy = f"lower it to {high:.4g} {unit}, and {remedy}"
                text += f"but {key} is {vehicle[key]:g} {unit}: {remedy}"
                results.append(Finding("warning", f"thrust.{key}", text))
    share = held_share(vehicle)
    if share < 1 - _SLACK:
        first, *_ = [name for name, _ in vehicle.actuators.levels]
        text = (
            f"the thrusters give only {share:.0%} of Fu_max, Fv_max, Fw_max and Fr_max at once. Beyond this share the "
            f"allocation keeps {first} and gives up other forces; margins and certificates hold only within it. "
            f"Multiply the four limits by {share:.2g} for limits that hold together"
        )
        turns = vehicle["Fv_max"] == 0 and vehicle.actuators.order[0] == "yaw"
        results.append(Finding("info" if turns else "warning", "thrust", text))
    return results


def _drag(vehicle: Vehicle) -> list[Finding]:
    # linear drag of sway and yaw takes energy at every v and r only if its symmetric part is positive semidefinite
    yaw, sway = (vehicle[name] if name in vehicle.parameters else 0.0 for name in ("Yr", "Nv"))
    bound = 2 * float(np.sqrt(vehicle["Yv"] * vehicle["Nr"]))
    if abs(yaw + sway) <= bound * (1 + _SLACK) + _SLACK:
        return []
    text = (
        f"the linear drag adds energy at some sway speed and yaw rate: |Yr + Nv| = {abs(yaw + sway):.4g} N s is above "
        f"2 sqrt(Yv Nr) = {bound:.4g} N s. If these are not published numbers, check signs and units of Yr and Nv"
    )
    return [Finding("info", "drag.Yr" if abs(yaw) >= abs(sway) else "drag.Nv", text)]


def _odd(vehicle: Vehicle) -> list[Finding]:
    # numbers that look like another unit
    assert vehicle.actuators is not None
    results = []
    for one in vehicle.actuators.thrusters:
        distance, hull = float(np.linalg.norm(one.at)), vehicle["radius"]
        if distance > _HULLS * hull:
            text = (
                f"{one.name} is {distance:g} m from the middle, beyond {_HULLS:g} hull radii of {hull:g} m: give metres"
            )
            results.append(Finding("warning", f"thruster.{one.name}.at_m", text))
        if one.fin is not None and degrees(one.fin.limit) < _LEAST_DEG:
            limit = degrees(one.fin.limit)
            text = f"{one.name} deflects by {limit:.4g}° only, which looks like radians: {degrees(limit):.3g}°?"
            results.append(Finding("warning", f"thruster.{one.name}.fin.limit_deg", text))
    return results


def _not_simulated(vehicle: Vehicle) -> list[Finding]:
    # what the file states or implies, and the plant does not contain
    assert vehicle.actuators is not None
    results, worst, worst_name = [], 0.0, ""
    point = np.array([vehicle[name] if name in vehicle.parameters else 0.0 for name in ("xt", "yt", "zt")])
    for one in vehicle.actuators.thrusters:
        rate = None if one.swivel is None else one.swivel.rate
        if rate is not None and pi / 2 > rate * vehicle["thrust_lag"]:
            text = (
                f"a quarter turn of {one.name} takes {pi / 2 / rate:.3g} s, but simulation and margins turn joints at "
                f"once, with the lag of {vehicle['thrust_lag']:.3g} s: use a faster joint, or state a longer thrust_lag"
            )
            results.append(Finding("warning", f"thruster.{one.name}.swivel.rate_deg_per_s", text))
        arm = (one.columns[3:5] - np.cross(point, one.directions, axisb=0).T[:2]) @ one.corners.T
        most = float(np.linalg.norm(arm, axis=0).max())
        if vehicle.form.tilts and most > worst + _SLACK:
            worst, worst_name = most, one.name
    if worst:
        text = (
            f"the roll and pitch moment of {worst_name} is simulated by --plant mujoco only: {worst:.3g} N m beside "
            "that of its force at (xt, yt, zt); in the own plant, total force and yaw moment of the thrusters act"
        )
        results.append(Finding("warning", f"thruster.{worst_name}.at_m", text))
    return results


def held_share(vehicle: Vehicle, failed: Sequence[str] = ()) -> float:
    """Return the largest share of the thrust limits of a vehicle with thrusters that its thrusters give all at once.

    The sway force of a rudder belongs to its yaw moment, so axes without a limit of their own do not count.

    Example:
        >>> from surctl.marine.simulation import held_share
        >>> from surctl.marine.vehicle import load_vehicle
        >>> heavy = load_vehicle("bluerov2-heavy")
        >>> held_share(heavy) >= 1.0, held_share(heavy, ["T2"]) >= 1.0
        (True, False)
    """
    assert vehicle.actuators is not None
    axes = tuple(np.flatnonzero(vehicle.thrust_limit > 0).tolist()) if vehicle.actuators.fins else (0, 1, 2, 3)
    working = working_flags(vehicle.actuators, failed, speed=vehicle.speed)
    return attainable(vehicle.actuators, axes).box_share(vehicle.thrust_limit, working=working)
