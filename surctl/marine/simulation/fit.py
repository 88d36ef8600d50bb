"""All findings of `lint` on a mission; those on tilt, thrusters, fins and drag of a vehicle, and on its sonars."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import atan, atan2, degrees, hypot, inf, pi, tan

import numpy as np

from surctl.errors import Finding, InputError
from surctl.marine.allocation import working_flags
from surctl.marine.control import Gains, load_gains
from surctl.marine.control.ports import YAW_SHARE
from surctl.marine.sensing import SonarArray
from surctl.marine.sensing.mapping.firing import MIDDLE
from surctl.marine.sensing.mapping.local_map import LocalMap
from surctl.marine.simulation.clearance import clearance_findings
from surctl.marine.simulation.echo_fit import detection_range, echo_findings
from surctl.marine.simulation.motion import mission_findings, motion_findings, steering_findings
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import Vehicle, attainable, plant_parameters
from surctl.marine.vehicle.dynamics import trim_function
from surctl.marine.vehicle.specs import SPECS
from surctl.marine.vehicle.thruster_file import axis_ends
from surctl.units import towards

_WIDE = 15.0  # [deg] tilt above which the sonars' beams leave the depth of the path, and sin² of it costs thrust


def tilt_findings(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    """Return the findings about net buoyancy, stability of roll and pitch, and tilt at cruise and at full thrust."""
    return [*_buoyancy(vehicle), *(_tilt(scenario, vehicle) if vehicle.form.tilts else [])]


def _buoyancy(vehicle: Vehicle) -> Iterator[Finding]:
    least, most = vehicle.thrust_range[:, 2]
    up = vehicle.term("Z0") + vehicle.term("buoyancy") - vehicle.term("weight")
    if up == 0 or -most < up < -least:
        return
    limit = f"the heave thrust reaches {-least if up > 0 else most:g} N"
    text = f"{vehicle.name} {'rises' if up > 0 else 'sinks'}: {abs(up):.3g} N act on it vertically, and {limit}"
    yield Finding("error", "vehicle", f"{text}; ballast it")


def _tilt(scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    # [N m/rad] about the axes of roll and pitch
    righting = vehicle["buoyancy"] * vehicle.term("zb") - vehicle["weight"] * vehicle.term("zg")
    if righting <= 0:
        text = f"{vehicle.name} capsizes: its centre of gravity is not below its centre of buoyancy"
        yield Finding("error", "vehicle", f"{text} (zg, zb)")
        return
    height = abs(vehicle.term("zt"))
    pull = {"pitch": max(abs(vehicle.thrust_range[:, 0])), "roll": max(abs(vehicle.thrust_range[:, 1]))}
    tilts = {axis: degrees(atan2(force * height, righting)) for axis, force in pull.items()}
    axis = max(tilts, key=lambda name: tilts[name])
    if tilts[axis] > _WIDE:
        text = f"full thrust tilts {vehicle.name} by {tilts[axis]:.0f} deg in {axis}, because it acts {height:g} m from"
        remedy = "move the thrusters to the height of the centre, lower the centre of gravity, or limit the thrust"
        yield Finding("warning", "vehicle", f"{text} the centre of the hull; {remedy}")
    tilt = np.asarray(trim_function(vehicle.form)([scenario.cruise, 0, 0, 0], plant_parameters(vehicle))[1]).ravel()
    steady = degrees(hypot(*tilt[:2]))
    if not steady <= _WIDE:  # also where the vehicle has no trim
        text = f"at the cruise speed of {scenario.cruise:g} m/s {vehicle.name} is tilted by {steady:.0f} deg"
        yield Finding("warning", "cruise_m_per_s", text)


_LIMITS = {"Fu_max": "surge", "Fv_max": "sway", "Fw_max": "heave", "Fr_max": "yaw"}
_SLACK = 1e-6
_HULLS, _LEAST_DEG = 3.0, 1.0  # farthest thruster in hull radii, least deflection [deg] of a fin in earnest
_LIGHTEST = 0.01  # least plausible yaw inertia over m11 radius^2; the largest is its reciprocal


def thruster_findings(vehicle: Vehicle) -> list[Finding]:
    """Return a finding for each thrust limit that the thrusters cannot reach, alone or together with the others.

    The law limits its command on each axis to `Fu_max`, …; margins and certificates assume that every command within
    these limits reaches the plant. This holds if the box of the limits lies in the attainable set. A craft without sway
    force whose allocation keeps yaw may lose surge force while it turns: this is said as information. Fins have the
    limits of the speed `Vehicle.speed`.
    """
    results = [*_drag(vehicle), *_inertia(vehicle)]
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
                if most <= 0:
                    what, side = "moment" if word == "yaw" else "force", " one way" if max(-low, high) > 0 else ""
                    text = f"the thrusters give no {what} in {word}{side} without other forces, "
                    zero = f'set it to "0 {unit}", or ' if SPECS[key].zero_allowed else ""
                    remedy = f"{zero}add or turn a thruster to give it"
                if key == name and reverse not in vehicle.parameters and vehicle["Fv_max"] == 0 and -low < high:
                    text = f"the thrusters give {high:.4g} {unit} in {word} one way and {-low:.4g} {unit} the other, "
                    remedy = f'add {reverse} = "{-low:.4g} {unit}"' if low < 0 else "give a thruster a force in reverse"
                    if vehicle[key] > high * (1 + _SLACK) + _SLACK:
                        remedy = f"lower it to {high:.4g} {unit}, and {remedy}"
                text += f"but {key} is {vehicle[key]:g} {unit}: {remedy}"
                results.append(Finding("warning", f"thrust.{key}", text))
    share = held_share(vehicle)
    if _SLACK < share < 1 - _SLACK:  # 0: an axis without force or moment, as said above
        first, *_ = [name for name, _ in vehicle.actuators.levels]
        limits = [(name, towards(share * vehicle[name], up=False)) for name in _LIMITS if vehicle[name] > 0]
        lower = ", ".join(f'{name} = "{limit} {vehicle.parameters[name].unit}"' for name, limit in limits)
        text = (
            f"the thrusters give only {share:.0%} of Fu_max, Fv_max, Fw_max and Fr_max at once; for limits that hold "
            f"together, set in [thrust] {lower}. Beyond this share the allocation keeps {first} and gives up other "
            "forces; margins and certificates hold only within it"
        )
        turns = vehicle["Fv_max"] == 0 and vehicle.actuators.order[0] == "yaw"
        results.append(Finding("info" if turns else "warning", "thrust", text))
    return results


def _drag(vehicle: Vehicle) -> Iterator[Finding]:
    # linear drag of sway and yaw takes energy at every v and r only if its symmetric part is positive semidefinite
    yaw, sway = map(vehicle.term, ("Yr", "Nv"))
    bound = 2 * float(np.sqrt(vehicle["Yv"] * vehicle["Nr"]))
    if abs(yaw + sway) <= bound * (1 + _SLACK) + _SLACK:
        return
    text = (
        f"the linear drag adds energy at some sway speed and yaw rate: |Yr + Nv| = {abs(yaw + sway):.4g} N s is above "
        f"2 sqrt(Yv Nr) = {bound:.4g} N s. If these are not published numbers, check signs and units of Yr and Nv"
    )
    yield Finding("info", "drag.Yr" if abs(yaw) >= abs(sway) else "drag.Nv", text)


def _inertia(vehicle: Vehicle) -> Iterator[Finding]:
    share = vehicle["m44"] / (vehicle["m11"] * vehicle["radius"] ** 2)  # 0.2 to 1 for most craft
    if not _LIGHTEST < share < 1 / _LIGHTEST:
        text = f"m44 = {vehicle['m44']:.3g} kg m^2 is {share:.2g} times m11 radius^2: check the units of these three"
        yield Finding("warning", "inertia.m44", text)


def _odd(vehicle: Vehicle) -> Iterator[Finding]:
    # numbers that look like another unit
    assert vehicle.actuators is not None
    for one in vehicle.actuators.thrusters:
        distance, hull = float(np.linalg.norm(one.at)), vehicle["radius"]
        if distance > _HULLS * hull:
            text = (
                f"{one.name} is {distance:g} m from the middle, beyond {_HULLS:g} hull radii of {hull:g} m: give metres"
            )
            yield Finding("warning", f"thruster.{one.name}.at_m", text)
        if one.fin is not None and degrees(one.fin.limit) < _LEAST_DEG:
            limit = degrees(one.fin.limit)
            text = f"{one.name} deflects by {limit:.4g}° only, which looks like radians: {degrees(limit):.3g}°?"
            yield Finding("warning", f"thruster.{one.name}.fin.limit_deg", text)


def _not_simulated(vehicle: Vehicle) -> Iterator[Finding]:
    # what the file states or implies, and the plant does not contain
    assert vehicle.actuators is not None
    worst, worst_name = 0.0, ""
    point = np.array([vehicle.term(name) for name in ("xt", "yt", "zt")])
    for one in vehicle.actuators.thrusters:
        rate = None if one.swivel is None else one.swivel.rate
        if rate is not None and pi / 2 > rate * vehicle["thrust_lag"]:
            text = (
                f"a quarter turn of {one.name} takes {pi / 2 / rate:.3g} s, but simulation and margins turn joints at "
                f"once, with the lag of {vehicle['thrust_lag']:.3g} s: use a faster joint, or state a longer thrust_lag"
            )
            yield Finding("warning", f"thruster.{one.name}.swivel.rate_deg_per_s", text)
        arm = (one.columns[3:5] - np.cross(point, one.directions, axisb=0).T[:2]) @ one.corners.T
        most = float(np.linalg.norm(arm, axis=0).max())
        if vehicle.form.tilts and most > worst + _SLACK:
            worst, worst_name = most, one.name
    if worst:
        text = (
            f"the roll and pitch moment of {worst_name} is simulated by --plant mujoco only: {worst:.3g} N m beside "
            "that of its force at (xt, yt, zt); in the own plant, total force and yaw moment of the thrusters act"
        )
        yield Finding("warning", f"thruster.{worst_name}.at_m", text)


def held_share(vehicle: Vehicle, failed: Sequence[str] = ()) -> float:
    """Return the largest share of the thrust limits of a vehicle with thrusters that its thrusters give all at once.

    The sway force of a rudder belongs to its yaw moment, so axes without a limit of their own do not count.
    """
    assert vehicle.actuators is not None
    axes = tuple(np.flatnonzero(vehicle.thrust_limit > 0).tolist()) if vehicle.actuators.fins else (0, 1, 2, 3)
    working = working_flags(vehicle.actuators, failed, speed=vehicle.speed)
    return attainable(vehicle.actuators, axes).box_share(vehicle.thrust_limit, working=working)


_SAME_FLOOR = 0.1  # [m] difference between the floor that the law assumes and the site's depth


def findings(scenario: Scenario, vehicle: Vehicle, *, gains: Gains | None = None) -> list[Finding]:
    """Return all findings about a scenario and a vehicle: errors first, then warnings, then notes.

    Args:
        scenario: the mission.
        vehicle: the vehicle of the mission.
        gains: gains of the law, which determine how the vehicle turns and brakes; default: the built-in gains.

    Raises:
        InputError: the hull starts inside a still or moving obstacle.

    Example:
        >>> from surctl.marine.simulation import findings, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> first, *_ = findings(load_scenario("pool-behind"), load_vehicle("sur540-flooded"))
        >>> print(f"{first.level}, {first.key}: {first.text}")
        error, path_m: the 0.27 m hull of sur540-flooded is 0.020 m inside a wall at the target
    """
    build_world(scenario, vehicle, seed=0)
    gains = gains or load_gains("default")
    results = [*clearance_findings(scenario, vehicle, gains), *motion_findings(scenario, vehicle)]
    results += [*steering_findings(scenario, vehicle, gains), *tilt_findings(scenario, vehicle)]
    results += _sonars(scenario, vehicle, gains) if vehicle["Fv_max"] > 0 else []
    results += [*mission_findings(scenario, vehicle, gains), *thruster_findings(vehicle)]
    return sorted(results, key=lambda f: ("error", "warning", "info").index(f.level))


def _sonars(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[Finding]:
    # the law enters only water that its sonars have observed
    try:
        array = scenario.sensors.on(vehicle["radius"]).array
    except InputError as error:
        return [Finding("error", error.key or "sonar", f"on {vehicle.name}: {error.problem}")]
    split = [i for i, cones in enumerate(array.cones) if len(cones) > 1]
    if split:
        text = f"the hull of {vehicle.name} splits the beam of sensor {split[0]}; the map supports one cone per sensor"
        return [Finding("error", "sonar.mounts_m", text)]
    turning = min(gains["spin"], vehicle.steady_yaw(YAW_SHARE, scenario.cruise))
    listed = [*_unseen(array, turning), *_short(scenario, vehicle, gains), *_floor(scenario)]
    return [*listed, *echo_findings(scenario, vehicle, array)]


def _unseen(array: SonarArray, turning: float) -> list[Finding]:
    """Report directions that no sonar beam observes again before the obstacle map forgets them.

    The hull turns at the yaw rate `turning` [rad/s].

    A sonar beam marks grid cells of the map as free only in the middle part of its width (the share `MIDDLE`). After
    the time `LocalMap.memory`, the map forgets that a grid cell is free.
    """
    memory, between = LocalMap(dt=0.05).memory, turning * array.cycle
    least = min(2 * atan(MIDDLE * tan(half)) for cones in array.cones for _, half in cones)
    if between > least:
        text = (
            f"between two firings of a sensor the robot turns {degrees(between):.2g}°, but the middle of its beam, "
            f"which clears the map, is only {degrees(least):.2g}° wide: a turn leaves places ahead unobserved"
        )
        return [Finding("error", "sonar.beam_deg", text)]
    gap = _widest_gap(array)
    wait = gap / turning if turning > 0 else (inf if gap > 0 else 0.0)
    if wait <= memory:
        return []
    text = (
        f"the widest gap between two beams is {degrees(gap):.0f}°; turning at {turning:.2g} rad/s, the robot needs "
        f"{wait:.1f} s to observe it, but the map forgets after {memory:.1f} s, so places ahead stay unknown"
    )
    return [Finding("error", "sonar.azimuths_deg", text)]


def _widest_gap(array: SonarArray) -> float:
    """Return the largest angle [rad] between neighbouring sonar beams far from the hull; 0 without gaps."""
    cones = sorted(
        ((azimuth + offset) % (2 * pi), half)
        for azimuth, parts in zip(array.azimuths, array.cones, strict=True)
        for offset, half in parts
    )
    end, widest = cones[0][0] + cones[0][1], 0.0
    for middle, half in [*cones[1:], (cones[0][0] + 2 * pi, cones[0][1])]:
        widest, end = max(widest, middle - half - end), max(end, middle + half)
    return widest


def _floor(scenario: Scenario) -> Iterator[Finding]:
    floor, depth = scenario.sensors.equipment.floor, scenario.site[2]
    if floor is None or abs(floor - depth) <= _SAME_FLOOR:
        return
    how = (
        "echoes of the floor mark obstacles"
        if floor > depth
        else "echoes from the range of that floor, or from beyond, mark no obstacle"
    )
    text = f"the law assumes a floor {floor:g} m deep, but the site is {depth:g} m deep: {how}"
    yield Finding("warning", "sonar.floor_m", text)


def _short(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[Finding]:
    # stopping distance v²/(2a) + v t from the largest speed v along the path
    deceleration = gains["brake"] * float(np.min(vehicle.thrust_limit[:2]) / np.max(vehicle.mass[:2]))
    speed = scenario.fastest
    braking = speed**2 / (2 * deceleration) + speed * gains["reaction"]
    detected = detection_range(scenario)
    if detected >= braking:
        return []
    if detected < scenario.sensors.equipment.array.maximum:
        text = (
            f"from {detected:.2g} m the law takes every echo for that of the floor, but from the cruise speed of "
            f"{speed:g} m/s {vehicle.name} needs {braking:.2f} m to stop: it may collide with what it does not mark; "
            "stay higher above the floor, or point the beams less downwards"
        )
        return [Finding("error", "sonar.floor_m", text)]
    ahead = gains["brake"] * vehicle["Fu_max"] / vehicle["m11"]
    stop = speed**2 / (2 * ahead) + speed * gains["reaction"]
    text = (
        f"the sonars reach {detected:g} m; from the cruise speed of {speed:g} m/s {vehicle.name} stops "
        f"within {stop:.2f} m by surge thrust, "
    )
    if stop <= detected:
        text += (
            f"but the law plans with the weaker of surge and sway, {min(vehicle.thrust_limit[:2]):g} N, and needs "
            f"{braking:.2f} m: with sonars the law stays below the cruise speed"
        )
    else:
        text += "which exceeds this range: with sonars the law stays below the cruise speed"
    return [Finding("error", "sonar.maximum_m", text)]
