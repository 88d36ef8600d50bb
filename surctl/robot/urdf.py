"""URDF files: links, joints, masses and collision geometry of a robot; what is refused, which shapes are left out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias, cast, get_args
from xml.etree.ElementTree import Element

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_known, check_number, mistakes_in, nearest
from surctl.recorded import LARGEST_XML, file_bytes, xml_root
from surctl.units import as_numbers

# Capsules (and spheres) around the links of a robot, and the distance between two of them


Array: TypeAlias = NDArray[np.float64]

_PARALLEL = 1e-10  # squared sine of the angle below which two axes count as nearly parallel


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within `radius` of the segment from `start` to `end`; a sphere if both ends are equal.

    Attributes:
        start, end: ends (3,) of the axis in the frame of the link [m].
        radius: radius [m], greater than 0.

    Raises:
        InputError: an end is not three finite numbers, or the radius is not positive.
    """

    start: Array | Sequence[float]
    end: Array | Sequence[float]
    radius: float

    def __post_init__(self) -> None:
        for field in ("start", "end"):
            object.__setattr__(self, field, as_numbers(getattr(self, field), key=f"capsule.{field}", size=3))
        check_number("capsule.radius", self.radius, unit="m")

    @property
    def axis(self) -> Array:
        """Return the vector (3,) from start to end [m]."""
        along: Array = np.asarray(self.end) - np.asarray(self.start)
        return along

    def contains(self, other: Capsule) -> bool:
        """Return whether another capsule in the same frame is inside, to 1e-9 m."""
        inside = []
        for point in (other.start, other.end):
            along = np.asarray(point) - np.asarray(self.start)
            s = min(1.0, max(0.0, float(along @ self.axis) / self.length**2)) if self.length > 0.0 else 0.0
            inside.append(float(np.linalg.norm(along - s * self.axis)) + other.radius <= self.radius + 1e-9)
        return all(inside)  # both are convex

    @property
    def length(self) -> float:
        """Return the length of the axis [m]."""
        return math.sqrt(float(self.axis @ self.axis))


def _capsule_around(kind: str, size: Array, rotation: Array, position: Array) -> Capsule:
    """Return the capsule that contains a shape of a URDF file, in the frame of the link.

    Args:
        kind: "sphere", "cylinder", "capsule" or "box".
        size: radius (1,); radius and length (2,); or the edges (3,) of a box [m].
        rotation, position: frame of the shape in the frame of the link; the axis of a cylinder is z.
    """
    along, radius = np.zeros(3), float(size[0])
    if kind in ("cylinder", "capsule"):
        along[2] = size[1] / 2.0
    elif kind == "box":
        longest = int(np.argmax(size))
        along[longest] = size[longest] / 2.0
        radius = float(np.sqrt((np.delete(size, longest) ** 2).sum())) / 2.0
    return Capsule(position - rotation @ along, position + rotation @ along, radius)


def closest_points(
    start: ca.SX, along: ca.SX, other: ca.SX, beside: ca.SX, lengths: tuple[float, float]
) -> tuple[ca.SX, ca.SX]:
    """Return the closest points (3,) of two segments.

    The solution is that of Ericson (2005), section 5.1.9. For nearly parallel segments, the points are continuous in
    the configuration, and their distance is larger than the least by a negligible amount.

    Args:
        start, along: start (3,) of the first segment and vector (3,) to its end [m].
        other, beside: the same of the second segment.
        lengths: lengths of the segments [m]; 0 for a point.
    """
    a, e = lengths[0] ** 2, lengths[1] ** 2
    between = start - other
    c, f, b = ca.dot(along, between), ca.dot(beside, between), ca.dot(along, beside)
    if a == 0.0 and e == 0.0:
        return start, other
    if a == 0.0:
        return start, other + beside * _share(f / e)
    if e == 0.0:
        return start + along * _share(-c / a), other
    # the second share is the best one for the first, and then the first is the best one for the second
    first = _share((b * f - c * e) / (a * e * (1.0 + _PARALLEL) - b * b))
    second = _share((b * first + f) / e)
    return start + along * _share((b * second - c) / a), other + beside * second


def _share(value: ca.SX) -> ca.SX:
    return ca.fmin(ca.fmax(value, 0.0), 1.0)


JointType: TypeAlias = Literal["fixed", "revolute", "continuous", "prismatic", "planar", "floating"]

_INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_ROUNDED = 1e-12  # kg, kg m²; public files have inertias of -5e-20
_SNAP = 1e-12  # sines and cosines this near to 0 or ±1 come from rounding of a right angle


@dataclass(frozen=True)
class Mimic:
    """A joint whose position follows another joint: multiplier · position of `joint` + offset."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint between a parent and a child link.

    Attributes:
        rotation, position: rotation matrix (3, 3) and position (3,) [m] of the joint frame in the frame of the parent.
        axis: unit vector (3,) in the joint frame.
        lower, upper: position limits [rad or m]; None if the file has none.
        velocity: largest speed [rad/s or m/s]; None if the file has none.
        mimic: the joint that this joint follows, or None.
    """

    name: str
    type: JointType
    parent: str
    child: str
    rotation: Array
    position: Array
    axis: Array
    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    mimic: Mimic | None = None


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid body.

    Attributes:
        mass: mass [kg]; 0 without inertial data.
        centre: centre of mass (3,) in the frame of the link [m].
        shapes: collision geometry as capsules that contain it, without those inside another.
        meshes: whether the link has collision meshes, which are not read.
    """

    name: str
    mass: float
    centre: Array
    shapes: tuple[Capsule, ...]
    meshes: bool


@dataclass(frozen=True, eq=False)
class Urdf:
    """A checked URDF file: a tree of links with one root.

    Attributes:
        path: the file. name: name of the robot. root: name of the root link.
        links: the links by name. joints: the joints, each after the joint that moves its parent.
    """

    path: Path
    name: str
    root: str
    links: dict[str, Link]
    joints: tuple[Joint, ...]


def read_urdf(path: str | Path) -> Urdf:
    """Read and check a URDF file.

    Raises:
        InputError: the file is not readable XML, has a document type or entities, is larger than 20 MB, or does not
            describe a tree of links with finite numbers. The message names the file and the link or joint.

    Example:
        >>> from pathlib import Path
        >>> from surctl.robot import read_urdf
        >>> links = '<link name="base"/><link name="arm"/>'
        >>> joint = '<joint name="hinge" type="continuous"><parent link="base"/><child link="arm"/></joint>'
        >>> _ = Path("hinge.urdf").write_text(f'<robot name="door">{links}{joint}</robot>')
        >>> urdf = read_urdf("hinge.urdf")
        >>> urdf.root, [joint.name for joint in urdf.joints]
        ('base', ['hinge'])
    """
    path = Path(path)
    root = read_xml(path, "robot")
    with mistakes_in(path):
        links: dict[str, Link] = {}
        for element in root.findall("link"):
            link = _link(element)
            if link.name in links:
                raise InputError("is the name of two links", key="link", value=link.name, remedy="rename one of them")
            links[link.name] = link
        joints: dict[str, Joint] = {}
        for element in root.findall("joint"):
            joint = _joint(element)
            if joint.name in joints:
                raise InputError("is the name of two joints", key="joint", value=joint.name, remedy="rename one")
            joints[joint.name] = joint
        base = _check_tree(links, joints)
        _check_mimics(joints)
        return Urdf(path, root.get("name", ""), base, links, tuple(_ordered(base, joints)))


def read_xml(path: Path, tag: str) -> Element:
    """Return the root element of an XML file, whose tag must be `tag`; see `xml_root`.

    Raises:
        InputError: the file cannot be read or parsed, or is too large.
    """
    root = xml_root(
        file_bytes(path, remedy="give a URDF or SRDF file", most=LARGEST_XML), file=path, remedy="correct it"
    )
    if root.tag != tag:
        raise InputError(f"begins with <{root.tag}>", file=path, remedy=f"give a file that begins with <{tag}>")
    return root


def _name(element: Element) -> str:
    name = element.get("name")
    if not name or not name.strip():
        raise InputError("has no name", key=element.tag, remedy=f'write <{element.tag} name="…">')
    return name


def _one(element: Element, tag: str, key: str) -> Element | None:
    """Return the part of an element with a tag; None if it has none."""
    parts = element.findall(tag)
    if len(parts) > 1:
        raise InputError(f"has {len(parts)} elements <{tag}>", key=key, remedy="remove all but one")
    return parts[0] if parts else None


def _numbers(element: Element | None, attribute: str, default: str, count: int, key: str) -> Array:
    text = default if element is None else element.get(attribute, default)
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        what = "a finite number" if count == 1 else f"{count} finite numbers"
        raise InputError(f"is not {what}", key=f"{key}: {attribute}", value=text, remedy=_remedy(text, "correct it"))
    return np.array(numbers)


def _remedy(text: str, otherwise: str) -> str:
    return "expand the file with xacro" if "${" in text else otherwise


def _bound(element: Element | None, attribute: str, key: str) -> float | None:
    """Return a limit; None if it is absent or infinite."""
    text = None if element is None else element.get(attribute)
    if text is None:
        return None
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if math.isnan(number):
        remedy = _remedy(text, "give a number")
        raise InputError("is not a number", key=f"{key}: limit {attribute}", value=text, remedy=remedy)
    return number if math.isfinite(number) else None


def _origin(element: Element, key: str) -> tuple[Array, Array]:
    origin = _one(element, "origin", key)
    roll, pitch, yaw = _numbers(origin, "rpy", "0 0 0", 3, f"{key}: origin")
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw))
    rotation = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    whole = np.round(rotation)
    return np.where(abs(rotation - whole) < _SNAP, whole, rotation), _numbers(
        origin, "xyz", "0 0 0", 3, f"{key}: origin"
    )


def _link(element: Element) -> Link:
    name = _name(element)
    key = f"link {name}"
    mass, centre = 0.0, np.zeros(3)
    inertial = _one(element, "inertial", key)
    if inertial is not None:
        mass = float(_numbers(_one(inertial, "mass", key), "value", "0", 1, f"{key}: mass")[0])
        inertia = _one(inertial, "inertia", key)
        moments = [float(_numbers(inertia, name, "0", 1, f"{key}: inertia")[0]) for name in _INERTIA]
        for what, value, unit in (("mass", mass, "kilograms"), ("inertia", min(moments[:3]), "kg m²")):
            if value < -_ROUNDED:
                raise InputError("is negative", key=f"{key}: {what}", value=value, remedy=f"give {unit}")
        centre = _origin(inertial, key)[1]
    shapes, meshes = [], False
    for collision in element.findall("collision"):
        geometry = collision.find("geometry")
        shape = geometry[0] if geometry is not None and len(geometry) else None
        if shape is None:
            raise InputError("has no geometry", key=f"{key}: collision", remedy="give a sphere, cylinder, box or mesh")
        if shape.tag == "mesh":
            meshes = True
            continue
        at = f"{key}: {shape.tag}"
        if shape.tag == "box":
            size = _numbers(shape, "size", "", 3, at)
        elif shape.tag in ("sphere", "cylinder", "capsule"):
            attributes = ("radius",) if shape.tag == "sphere" else ("radius", "length")
            size = np.concatenate([_numbers(shape, attribute, "", 1, at) for attribute in attributes])
        else:
            known = ("box", "capsule", "cylinder", "mesh", "sphere")
            raise InputError("is not known", key=f"{key}: geometry", value=shape.tag, remedy=nearest(shape.tag, known))
        if (size <= 0.0).any():
            raise InputError("has a size that is not positive", key=at, value=size.tolist(), remedy="give metres")
        shapes.append(_capsule_around(shape.tag, size, *_origin(collision, at)))
    # such as the spheres at the ends of a cylinder
    outer = [
        shape
        for k, shape in enumerate(shapes)
        if not any(o.contains(shape) and (j < k or not shape.contains(o)) for j, o in enumerate(shapes) if j != k)
    ]
    return Link(name, mass, centre, tuple(outer), meshes)


def _joint(element: Element) -> Joint:
    name = _name(element)
    key = f"joint {name}"
    kind = element.get("type", "")
    check_known(kind, get_args(JointType), "is not a joint type", key=f"{key}: type")
    ends = []
    for tag in ("parent", "child"):
        end = _one(element, tag, key)
        link = None if end is None else end.get("link")
        if not link:
            raise InputError(f"has no {tag} link", key=key, remedy=f'write <{tag} link="…"/>')
        ends.append(link)
    axis = np.array([0.0, 0.0, 1.0]) if kind in ("fixed", "floating") else _axis(element, kind, key)
    limit = _one(element, "limit", key)
    lower, upper, velocity = (_bound(limit, attribute, key) for attribute in ("lower", "upper", "velocity"))
    if lower is not None and upper is not None and lower > upper:
        remedy = "give lower <= upper"
        raise InputError("allow no position", key=f"{key}: limits", value=[lower, upper], remedy=remedy)
    if velocity is not None and velocity < 0.0:
        remedy = "give a largest speed"
        raise InputError("is negative", key=f"{key}: limit velocity", value=velocity, remedy=remedy)
    follows = _one(element, "mimic", key)
    mimic = None
    if follows is not None and kind != "fixed":
        if kind in ("planar", "floating"):
            raise InputError(f"is {kind}, so it cannot mimic a joint", key=key, remedy="remove <mimic>")
        multiplier, offset = (
            float(_numbers(follows, attribute, default, 1, f"{key}: mimic")[0])
            for attribute, default in (("multiplier", "1"), ("offset", "0"))
        )
        mimic = Mimic(follows.get("joint", ""), multiplier, offset)
    rotation, position = _origin(element, key)
    bounded = kind != "continuous"
    if not bounded and lower is not None and upper is not None and 0.0 < upper - lower < 2.0 * math.pi:
        remedy = "write revolute, or remove its lower and upper limits"
        raise InputError("is continuous, but has limits", key=key, value=[lower, upper], remedy=remedy)
    return Joint(
        name, cast(JointType, kind), ends[0], ends[1], rotation, position, axis,
        lower if bounded else None, upper if bounded else None, velocity, mimic,
    )  # fmt: skip


def _axis(element: Element, kind: str, key: str) -> Array:
    axis = _numbers(_one(element, "axis", key), "xyz", "1 0 0", 3, f"{key}: axis")
    length = float(np.sqrt(axis @ axis))
    if length < 1e-9:
        raise InputError("has length 0", key=f"{key}: axis", value=axis.tolist(), remedy="give a direction")
    if kind == "planar" and abs(axis / length - [0.0, 0.0, 1.0]).max() > _SNAP:
        remedy = "turn the origin instead, and write 0 0 1"
        raise InputError("of a planar joint is not z", key=f"{key}: axis", value=axis.tolist(), remedy=remedy)
    return axis / length


def _check_tree(links: dict[str, Link], joints: dict[str, Joint]) -> str:
    """Return the root link; raise InputError if links and joints do not form one tree."""
    if not links:
        raise InputError("has no link", key="robot", remedy='write <link name="…"/>')
    parents: dict[str, Joint] = {}
    for joint in joints.values():
        for tag, link in (("parent", joint.parent), ("child", joint.child)):
            check_known(link, links, "is not the name of a link", key=f"joint {joint.name}: {tag}")
        if joint.child in parents:
            problem = f"is the child of joints {parents[joint.child].name} and {joint.name}"
            raise InputError(problem, key=f"link {joint.child}", remedy="a robot is a tree: remove one of the joints")
        parents[joint.child] = joint
    roots = [name for name in links if name not in parents]
    if len(roots) > 1:
        shown = ", ".join(roots[:4]) + (", …" if len(roots) > 4 else "")
        raise InputError(f"has {len(roots)} root links: {shown}", key="robot", remedy="connect them by fixed joints")
    reached = {joint.child for joint in _ordered(roots[0], joints)} | set(roots) if roots else set()
    for name in links:
        if name not in reached:
            cycle, at = [], name
            while at not in cycle:
                cycle.append(at)
                at = parents[at].parent
            shown = " → ".join([*cycle[cycle.index(at) :][:4], "…"])
            raise InputError(f"has a cycle of links: {shown}", key="robot", remedy="a robot is a tree: remove a joint")
    return roots[0]


def _ordered(root: str, joints: dict[str, Joint]) -> Iterator[Joint]:
    """Yield the joints from the root outwards, depth first, in the order of the file."""
    below: dict[str, list[Joint]] = {}
    for joint in joints.values():
        below.setdefault(joint.parent, []).append(joint)
    waiting = below.get(root, [])[::-1]
    while waiting:
        joint = waiting.pop()
        yield joint
        waiting += below.get(joint.child, [])[::-1]


def _check_mimics(joints: dict[str, Joint]) -> None:
    for joint in joints.values():
        passed, at = [joint.name], joint
        while at.mimic is not None:
            key = f"joint {at.name}: mimic"
            check_known(at.mimic.joint, joints, "no such joint", key=key)
            at = joints[at.mimic.joint]
            if at.type in ("planar", "floating"):
                raise InputError(f"is {at.type}", key=key, value=at.name, remedy="mimic a joint with one position")
            if at.name in passed:
                raise InputError("leads back to the joint itself", key=key, value=at.name, remedy="remove one mimic")
            passed.append(at.name)
