"""A vehicle from a Gazebo model: hydrodynamics and mass in SDF or URDF; what cannot be used.

The models state derivatives in the SNAME notation: added mass −X_u̇ and drag −X_u. Their axes are those of the heading
frame, x ahead, y to the left, z up, so surge, sway, heave and yaw are taken over as they are; roll and pitch are
omitted.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_known
from surctl.marine.vehicle.parameters import Parameter, Vehicle
from surctl.marine.vehicle.specs import PARAMETERS, TERMS, undamped
from surctl.recorded import LARGEST_XML, file_bytes, shown, xml_root

_AXES = (0, 1, 2, 5)  # surge, sway, heave and yaw among the six degrees of freedom
_FORCES, _RATES = "xyzkmn", "uvwpqr"
_GRAVITY = 9.81
_LEAST = 1e-3  # N, a smaller weight in water is rounding
_ADDED = ("x", "y", "z", "p", "q", "r")  # names of the added mass in an <inertial> of SDF

Array = NDArray[np.float64]


@dataclass
class _Body:
    mass: float | None = None
    inertia_z: float | None = None
    added: Array = field(default_factory=lambda: np.zeros((6, 6)))
    linear: Array = field(default_factory=lambda: np.zeros((6, 6)))
    quadratic: Array = field(default_factory=lambda: np.zeros((6, 6, 6)))  # force on i by |velocity k| velocity j
    unused: list[str] = field(default_factory=list)
    volume: float | None = None
    density: float = 1000.0
    neutral: bool = False


def gazebo_vehicle(
    path: Path,
    name: str,
    *,
    radius: float,
    thrust: float,
    yaw_thrust: float,
    sway_thrust: float | None = None,
    heave_thrust: float | None = None,
    thrust_lag: float = 0.3,
    link: str | None = None,
) -> Vehicle:
    """Return the vehicle of a Gazebo model.

    The function reads the plugin gz::sim::systems::Hydrodynamics, `fluid_added_mass` of SDF, and the hydrodynamic_model
    of uuv_simulator with type fossen. A xacro file must be expanded before: xacro FILE > robot.urdf.

    Args:
        path: an SDF or URDF file.
        radius: radius of the hull [m].
        thrust: largest force in surge [N].
        yaw_thrust: largest moment about the vertical [N m].
        sway_thrust: largest force in sway [N]; default: as in surge.
        heave_thrust: largest force in heave [N]; default: as in surge.
        thrust_lag: time constant of the thrust [s].
        link: name of the link; default: the only one with hydrodynamics.
    """
    raw = file_bytes(path, remedy="give an SDF or URDF file", most=LARGEST_XML)
    bodies = _bodies(xml_root(raw, file=path, remedy="correct that line"), path)
    chosen = _chosen(bodies, link, path)
    body = bodies[chosen]
    limits = {"Fu_max": thrust, "Fv_max": sway_thrust, "Fw_max": heave_thrust, "Fr_max": yaw_thrust}
    stated = {key: thrust if value is None else value for key, value in limits.items()}
    stated |= {"radius": radius, "thrust_lag": thrust_lag}
    values = stated | _numbers(body, chosen, path)
    parameters = {}
    for key, spec in [*PARAMETERS.items(), *((key, spec) for key, spec in TERMS.items() if values.get(key))]:
        value = values[key]
        if not spec.allows(value):
            remedy = spec.remedy + "; a hydrodynamic derivative against the motion is negative" * (spec.table == "drag")
            raise InputError(f"must be {spec.bound}", file=shown(path), key=key, value=value, remedy=remedy)
        said = "given" if key in stated else f"link {chosen} of {path.name}"
        parameters[key] = Parameter(float(value), spec.unit, None, said)
    free = undamped({key: parameter.value for key, parameter in parameters.items()})
    note = f"; no drag found in {', '.join(free)}" if free else ""
    note += f"; not used: {', '.join(body.unused)}" if body.unused else ""
    return Vehicle(name, f"from {path.name}; roll and pitch are omitted{note}", parameters)


def _numbers(body: _Body, link: str, path: Path) -> dict[str, float]:
    # the parameters of equation (3), and the optional terms, of which those that are 0 are left out
    for what, value in (("mass", body.mass), ("izz", body.inertia_z)):
        if value is None:
            raise InputError("is missing", file=shown(path), key=f"{link}.{what}", remedy="add it to <inertial>")
        if not 0 < value < np.inf:
            remedy = "give a positive number"
            raise InputError("is not positive", file=shown(path), key=f"{link}.{what}", value=value, remedy=remedy)
    mass, inertia = float(body.mass or 0.0), float(body.inertia_z or 0.0)
    rigid = np.diag([mass, mass, mass, 0.0, 0.0, inertia])
    total = (rigid + (body.added + body.added.T) / 2)[np.ix_(_AXES, _AXES)]
    linear, quadratic = body.linear[np.ix_(_AXES, _AXES)], body.quadratic[np.ix_(_AXES, _AXES, _AXES)]
    for k, axis in enumerate(_AXES):
        if total[k, k] < rigid[axis, axis]:
            remedy = "give the hydrodynamic derivative of the acceleration, which is negative"
            key, value = f"{link}, axis {_RATES[axis]}", float(total[k, k] - rigid[axis, axis])
            raise InputError("would be an added mass below 0", file=shown(path), key=key, value=value, remedy=remedy)
    values: dict[str, float] = {}
    for i, j in product(range(4), repeat=2):
        force, velocity = "XYZN"[i], "uvwr"[j]
        values[f"m{min(i, j) + 1}{max(i, j) + 1}"] = float(total[i, j])
        values[f"{force}{velocity}"] = float(linear[i, j])
        values |= {f"{force}{'uvwr'[k]}{velocity}": float(quadratic[i, j, k]) for k in range(4)}
    if body.volume is not None and not body.neutral:
        lift = _GRAVITY * (body.density * body.volume - mass)
        values["Z0"] = lift if abs(lift) > _LEAST else 0.0
    return values


def _bodies(root: ElementTree.Element, path: Path) -> dict[str, _Body]:
    links = {link.get("name", ""): link for link in root.iter("link") if link.find("inertial") is not None}
    bodies: dict[str, _Body] = {}
    for plugin in root.iter("plugin"):
        said = f"{plugin.get('name', '')} {plugin.get('filename', '')}".lower()
        if "hydrodynamics" in said:
            body = bodies.setdefault((plugin.findtext("link_name") or "").strip(), _Body())
            _gz_hydrodynamics(plugin, body, path)
        for held in plugin.findall("link"):
            model = held.find("hydrodynamic_model")
            if model is not None:
                body = bodies.setdefault(held.get("name", ""), _Body())
                _uuv(held, model, body, path)
                density = plugin.find("fluid_density")
                body.density = _number(density, path) if density is not None else 1028.0
    for name, link in links.items():
        added = link.find("inertial/fluid_added_mass")
        if added is not None:
            body = bodies.setdefault(name, _Body())
            for entry in added:
                if len(entry.tag) == 2 and set(entry.tag) <= set(_ADDED):
                    i, j = (_ADDED.index(letter) for letter in entry.tag)
                    body.added[i, j] = body.added[j, i] = _number(entry, path)
    for name, body in bodies.items():
        held_in = links.get(name, links.get(name.rpartition("/")[2]))
        if held_in is not None:
            body.mass = _of(held_in, "inertial/mass", "value", path)
            body.inertia_z = _of(held_in, "inertial/inertia/izz", "", path)
            if body.inertia_z is None:
                body.inertia_z = _of(held_in, "inertial/inertia", "izz", path)
            others = [_of(one, "inertial/mass", "value", path) or 0.0 for one in links.values() if one is not held_in]
            body.unused += [f"the mass of the other links, {sum(others):g} kg"] if any(others) else []
    return bodies


def _chosen(bodies: Mapping[str, _Body], link: str | None, path: Path) -> str:
    if not bodies:
        raise InputError(
            "has no hydrodynamics",
            file=shown(path),
            remedy="give a model with gz::sim::systems::Hydrodynamics, fluid_added_mass or a hydrodynamic_model; "
            "expand a xacro file first: xacro FILE > robot.urdf",
        )
    if link is None:
        if len(bodies) > 1:
            remedy = f"choose --link: {', '.join(sorted(bodies))}"
            raise InputError("has several links with hydrodynamics", file=shown(path), remedy=remedy)
        return next(iter(bodies))
    check_known(link, bodies, "is not a link with hydrodynamics", key="--link", file=shown(path))
    return link


def _gz_hydrodynamics(plugin: ElementTree.Element, body: _Body, path: Path) -> None:
    # xDotU, xU, xUabsV (also xUU), for all axes
    for entry in plugin:
        match = re.fullmatch(r"([xyzkmn])(Dot)?([UVWPQR])(abs)?([UVWPQR])?", entry.tag)
        if match is None:
            if entry.tag in ("water_density", "fluid_density"):
                body.density = _number(entry, path)
            continue
        i, j = _FORCES.index(match[1]), _RATES.index(match[3].lower())
        value = -_number(entry, path)
        if match[2]:
            body.added[i, j] = value
        elif match[5] is None:
            body.linear[i, j] = value
        elif match[4] or match[3] == match[5]:  # xUabsV: |v| u; before gz-sim 7, xUU is |u| u
            body.quadratic[i, j, _RATES.index(match[5].lower())] = value
        elif value:
            body.unused.append(f"{entry.tag} = {-value:g}")


def _uuv(link: ElementTree.Element, model: ElementTree.Element, body: _Body, path: Path) -> None:
    squares = np.einsum("ijj->ij", body.quadratic)  # a view
    targets = {
        "added_mass": (body.added, 1.0),
        "linear_damping": (body.linear, -1.0),
        "quadratic_damping": (squares, -1.0),
    }
    for other in model:
        if other.tag not in (*targets, "type") and re.search(r"[1-9]", other.text or ""):
            body.unused.append(f"{other.tag} = {' '.join((other.text or '').split())[:40]}")
    for name, (target, sign) in targets.items():
        entry = model.find(name)
        if entry is None:
            continue
        numbers = np.array([_parsed(word, name, path) for word in (entry.text or "").split()])
        if len(numbers) not in (6, 36):
            remedy = "give 6 numbers (the diagonal) or 36"
            raise InputError(f"has {len(numbers)} numbers", file=shown(path), key=name, remedy=remedy)
        target += sign * (np.diag(numbers) if len(numbers) == 6 else numbers.reshape(6, 6))
    volume, neutral = link.find("volume"), link.find("neutrally_buoyant")
    body.volume = None if volume is None else _number(volume, path)
    body.neutral = neutral is not None and (neutral.text or "").strip() in ("1", "true", "True")


def _of(link: ElementTree.Element, where: str, attribute: str, path: Path) -> float | None:
    entry = link.find(where)
    if entry is None:
        return None
    text = entry.get(attribute) if attribute and entry.get(attribute) is not None else entry.text
    return None if text is None or not text.strip() else _parsed(text, entry.tag, path)


def _number(entry: ElementTree.Element, path: Path) -> float:
    return _parsed(entry.text or "", entry.tag, path)


def _parsed(text: str, key: str, path: Path) -> float:
    try:
        return float(text)
    except ValueError:
        remedy = "give a number; expand a xacro file first: xacro FILE > robot.urdf"
        raise InputError("is not a number", file=shown(path), key=key, value=text.strip(), remedy=remedy) from None
