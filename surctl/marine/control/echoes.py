"""Perception of a law without a map; obstacle points are known obstacles, unexplained sonar echoes, and walls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from surctl.ir import Port
from surctl.marine.guidance import Contact, disc_contacts, point_contact, wall_contacts
from surctl.marine.sensing import ContactMemory, SensorFilter, SonarArray, expected_range, sonar_contacts

__all__ = ["Perception", "perceive", "perception_ports"]

_ARRAY = SonarArray()
_FILTER = SensorFilter(array=_ARRAY)


def perception_ports(dt: float, *, sonar: bool = True) -> tuple[Port, ...]:
    """Return the state entries of the sonar filters for control period `dt` [s]; empty for a law without sonars."""
    if not sonar:
        return ()
    return (*_FILTER.ports("sonar_"), *ContactMemory(dt=dt).ports("sonar_"))


@dataclass(frozen=True)
class Perception:
    """The obstacle points around the robot, and the next state of the sonar filters.

    Attributes:
        known: obstacles known from the base station.
        echoes: one obstacle point per sonar; empty without sonars. Its clearance is `FAR` if there is no echo, or if a
            wall or a known obstacle explains the echo.
        walls: the site's four walls.
        ranges: filtered ranges (4, 1) [m]; the maximum range without sonars.
        state: next values of the state entries by name.
    """

    known: list[Contact]
    echoes: list[Contact]
    walls: list[Contact]
    ranges: ca.SX
    state: dict[str, ca.SX]

    @property
    def all(self) -> list[Contact]:
        """Return all obstacle points in one list."""
        return [*self.known, *self.echoes, *self.walls]


def perceive(x: Mapping[str, ca.SX], u: Mapping[str, ca.SX], p: Mapping[str, ca.SX], *, dt: float) -> Perception:
    """Filter the sonar ranges, remove echoes that walls or known obstacles explain, and return all obstacle points.

    Without input `contacts` no obstacle is known; without input `samples` the law has no sonars.

    Args:
        x: state entries by name, including those of `perception_ports`.
        u: inputs of the law by name; the function uses `eta`, `contacts`, `samples` and `fresh`.
        p: parameters by name; the function uses the gains `lambda1`, `lms_step` and `beta_max`, the model's `hull` and
            the mission's `walls`.
        dt: control period [s].
    """
    position, hull, rows = u["eta"][:2], p["hull"], u.get("contacts", ca.SX.zeros(0, 6))
    known = disc_contacts(position, hull, rows)
    walls = wall_contacts(position, hull, p["walls"])
    if "samples" not in u:
        return Perception(known, [], walls, ca.SX.ones(_ARRAY.size) * _ARRAY.maximum, {})
    psi = u["eta"][3]
    heading = ca.vertcat(ca.cos(psi), ca.sin(psi))
    gains = {"sonar_lambda1": p["lambda1"], "sonar_relaxation": p["lms_step"], "sonar_beta_max": p["beta_max"]}
    filtered = _FILTER.update(x, u["samples"], fresh=u["fresh"], gains=gains, prefix="sonar_")
    expected = [
        expected_range(
            position,
            heading,
            walls=p["walls"],
            discs=rows[:, :3],
            valid=rows[:, 5],
            azimuth=azimuth,
            hull_radius=hull,
            half_angle=_ARRAY.half_angle,
            maximum=_ARRAY.maximum,
        )
        for azimuth in _ARRAY.azimuths
    ]
    contacts = sonar_contacts(
        _ARRAY, filtered.range_hat, position=position, heading=heading, hull_radius=hull, expected=ca.vertcat(*expected)
    )
    memory, standing = ContactMemory(dt=dt).update(x, contacts, fresh=u["fresh"] * filtered.healthy, prefix="sonar_")
    echoes = [point_contact(position, hull, standing.points[i, :].T, standing.valid[i]) for i in range(_ARRAY.size)]
    return Perception(known, echoes, walls, filtered.range_hat, {**filtered.state, **memory})
