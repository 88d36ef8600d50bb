"""The laws by name or FILE.py:FUNCTION, the default law of a vehicle, and laws for which it lacks a force."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from surctl.errors import InputError, nearest
from surctl.marine.control.closing import ACCELERATION_NOISE, CALM_GAINS, CALM_PORTS, MODEL_NOISE
from surctl.marine.control.guarded import guarded_law
from surctl.marine.control.paper import CLOSED_FORM_PORTS, DAMPING, closed_form_law, known_obstacle, paper_law
from surctl.marine.control.source import AVOIDANCE, BARRIER, PATH_FOLLOWING, LawSource
from surctl.marine.control.steered import STEERED_GAINS, STEERED_PORTS, steered_law, steered_thrust
from surctl.marine.control.steering import steering_of
from surctl.marine.vehicle import Vehicle
from surctl.own_code import check_trusted, is_own, label, object_of, own_file, pinned

_FOLLOWS = frozenset({PATH_FOLLOWING})

LAWS: Mapping[str, LawSource] = MappingProxyType(
    {
        "guarded": LawSource(
            "surctl_guarded",
            guarded_law,
            options=frozenset({"barrier", "movers", "depths"}),
            gives_up=True,
            parts=_FOLLOWS | {BARRIER},
        ),
        "paper": LawSource(
            "surctl_paper", paper_law, options=frozenset({"avoidance"}), scans=False, parts=_FOLLOWS | {AVOIDANCE}
        ),
        "closed_form": LawSource(
            "surctl_closed_form",
            closed_form_law,
            state=CLOSED_FORM_PORTS,
            sensing=("truth",),
            modes=("nsb",),
            latches=False,
            slots=1,
            perceive=known_obstacle,
            damping=DAMPING,
            parts=_FOLLOWS,
        ),
        "steered": LawSource(
            "surctl_steered",
            steered_law,
            gains=STEERED_GAINS,
            state=STEERED_PORTS,
            thrust=steered_thrust,
            sensing=("truth",),
            steering=steering_of,
        ),
        "calm": LawSource(
            "surctl_calm",
            lambda s: guarded_law(s, calm=s.dt),
            gains=CALM_GAINS,
            state=CALM_PORTS,
            options=frozenset({"barrier", "movers", "depths"}),
            gives_up=True,
            model_noise=MODEL_NOISE,
            acceleration_noise=ACCELERATION_NOISE,
            # without parts: its reference is not the velocity of equations (8)-(12), which the claims are about
        ),
    }
)
"""The source of each built-in law, by name."""

LAW_NAMES: tuple[str, ...] = tuple(LAWS)

SONARLESS = (
    "the sonar map is scanned by turning the hull as it moves, and a craft without sway force heads where it goes"
)
"""Why a law that steers by heading and speed uses no sonars, as a part of a sentence."""

_KEY = "law"


def law_ref(text: str, *, file: object = None, folder: Path | None = None, trust: bool = True, key: str = _KEY) -> str:
    """Return the reference of a law: the text by which `Case`, `build_law` and recordings name the law.

    Args:
        text: name of a built-in law, or FILE.py:FUNCTION for a function that returns a `LawSource`.
        file: the file that contains the text, if any.
        folder: folder of a relative FILE.py; None: the working folder.
        trust: whether the code in FILE.py may be executed.
        key: option or file key whose value is the text, for error messages.

    Raises:
        InputError: the name is unknown; or FILE.py cannot be read or may not be executed; or the function does not
            return a `LawSource` whose name differs from the built-in laws.

    Example:
        >>> from surctl.marine.control import law_ref
        >>> law_ref("guarded")
        'guarded'
    """
    if text in LAWS:
        return text
    if not is_own(text):
        remedy = f"{nearest(text, LAW_NAMES)}; or FILE.py:FUNCTION for a law of your own"
        raise InputError("is not known", file=file, key=key, value=text, remedy=remedy)
    check_trusted(text, file=file, key=key, trust=trust)
    reference = pinned(text, key=key, folder=folder)
    law_source(reference)
    return reference


def law_source(reference: str) -> LawSource:
    """Return the source of a law by its reference (see `law_ref`).

    Example:
        >>> from surctl.marine.control import law_source
        >>> law_source("closed_form").sensing
        ('truth',)
    """
    if reference in LAWS:
        return LAWS[reference]
    if not is_own(reference):
        raise InputError("is not known", key=_KEY, value=reference, remedy=nearest(reference, LAW_NAMES))
    whole = reference if "#" in reference else pinned(reference, key=_KEY)
    source: LawSource = object_of(whole, LawSource, key=_KEY)
    if source.name in {law.name for law in LAWS.values()} or source.name in LAWS:
        problem = "is the name of a built-in law"
        raise InputError(problem, file=own_file(reference), key="name", value=source.name, remedy="choose another name")
    path, _, function = own_file(whole).rpartition(":")
    if (other := _FUNCTIONS.setdefault((path, whole.rpartition("#")[2], source.name), function)) != function:
        problem = f"is the name of two laws, those of {other} and {function}"
        remedy = "choose another name for one"
        raise InputError(problem, file=own_file(reference), key="name", value=source.name, remedy=remedy)
    return source


_FUNCTIONS: dict[tuple[str, str, str], str] = {}
"""Function that returns the law with a name, by file, its SHA-256, and name: in one file, a name denotes one law."""

_FORCES = {"Fu_max": "surge force", "Fv_max": "sway force", "Fr_max": "yaw moment"}


def default_law(vehicle: Vehicle) -> str:
    """Return the first built-in law whose forces the vehicle has: `guarded`, or `steered` without sway force.

    Example:
        >>> from surctl.marine.control import default_law
        >>> from surctl.marine.vehicle import load_vehicle
        >>> default_law(load_vehicle("sur400"))
        'guarded'
    """
    return next(name for name, source in LAWS.items() if not _lacking(source, vehicle))


def check_forces(reference: str, vehicle: Vehicle, *, key: str = _KEY) -> None:
    """Raise InputError, which names a law for this vehicle, if the vehicle lacks a force that the law needs.

    Example:
        >>> from surctl.marine.control import check_forces
        >>> from surctl.marine.vehicle import load_vehicle
        >>> check_forces("guarded", load_vehicle("sur400"))
    """
    for name in _lacking(law_source(reference), vehicle):
        problem = f"needs a {_FORCES[name]}, but {vehicle.name} has none ({name} = 0)"
        raise InputError(problem, key=key, value=label(reference), remedy=f"use law {default_law(vehicle)}")


def _lacking(source: LawSource, vehicle: Vehicle) -> list[str]:
    return [name for name in source.forces if not vehicle[name] > 0]
