"""The loop of a region certificate as dynamics: of the nominal vehicle for pictures, of any for the falsifier.

Also how far the level is below the least one at which V decays too slowly, or a thrust saturates.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.lyapunov import Dynamics, Range, State
from surctl.lyapunov.dynamics import exact
from surctl.lyapunov.falsified import least_where
from surctl.lyapunov.slope_search import form_of, quadratic
from surctl.verification.formula import Node, number, parse, variable

Array = NDArray[np.float64]

_EXTENT = 1.4  # half-width of the box, in half-widths of the region
_WIDE = 12.0  # the same, where a counterexample is searched
_FACTORS = ("c", "mass", "linear_0", "linear_1", "quadratic_0", "quadratic_1")
_CRUISE = {"x_e": "m", "y_e": "m", "along": "m/s", "across": "m/s"}


def nominal_motion(document: Mapping[str, Any]) -> tuple[Dynamics, Node]:
    """Return the nominal loop in a box around the region V < 1 of a region certificate, and V.

    The states of a cruise are the deviations from it, in the path frame, of a vehicle that heads along the path;
    thrust lag and held commands are left out.

    Raises:
        InputError: the certificate is not about a region.
    """
    claim, ranges = document["claim"], tuple[Range, ...]()
    if document.get("kind") == "turning":
        p, units = _shape(document), _CRUISE
    elif document.get("kind") == "lyapunov":
        units = {row["name"]: row["unit"] for row in claim["states"]}
        ranges = tuple(Range(**row) for row in claim["parameters"])
        p = form_of(parse(claim["function"], {name: variable(name) for name in units}), list(units)) / claim["level"]
    else:
        raise InputError("is not about a region", key="certificate", value=document.get("kind"),
                         remedy="give a region certificate")  # fmt: skip
    known = {name: variable(name) for name in (*units, *(one.name for one in ranges))}
    ends = _EXTENT * np.sqrt(np.diag(np.linalg.inv(p)))
    states = tuple(State(name, -float(end), float(end), units[name]) for name, end in zip(units, ends, strict=True))
    if document["kind"] == "turning":
        rates, _ = _cruise(claim, known | dict.fromkeys(_FACTORS, number(1)) | {"s": number(0)})
    else:
        rates = tuple(parse(claim["dynamics"][name], known) for name in units)
    dynamics = Dynamics(claim.get("name", "cruise"), "continuous", states, rates, ranges)
    return dynamics, quadratic(dynamics, p)


def uncertain_cruise(document: Mapping[str, Any]) -> tuple[Dynamics, Node, tuple[Node, Node]]:
    """Return the loop of any vehicle in the ranges of a claim about a cruise, V, and the commands over their limits.

    The states are the deviations from the steady cruise of the vehicle, at any heading. The certificate is about equal
    masses without lag, held commands, current and disturbances.
    """
    claim, (low, high) = document["claim"], document["claim"]["vehicle"]["drag_factor"]
    apart = claim["vehicle"]["drag_asymmetry"]
    ratio = (2 + apart) / (2 - apart)
    ranges = [Range("mass", *claim["vehicle"]["mass_factor"]), Range("heading", -3.15, 3.15)]
    ranges += [Range(name, low, high) for name in ("linear", "quadratic")]
    ranges += [Range(f"{name}_ratio", 1 / ratio, ratio) for name in ("linear", "quadratic")]
    known = {name: variable(name) for name in (*_CRUISE, *(one.name for one in ranges))}
    for name in ("linear", "quadratic"):
        known[f"{name}_0"] = known[name]
        known[f"{name}_1"] = parse(f"min(max({name}*{name}_ratio, {low}), {high})", known)
    first, second = document["proof"]["trim"]
    moved = f"{first}*((linear_0 + linear_1)/2 - 1) + {second}*((quadratic_0 + quadratic_1)/2 - 1)"
    known["x_e"] = parse(f"x_e - ({moved})/{claim['law']['k1']}", known)
    known |= {"c": parse("cos(heading)", known), "s": parse("sin(heading)", known)}
    rates, loads = _cruise(claim, known)
    p = _shape(document)
    ends = _WIDE * np.sqrt(np.diag(np.linalg.inv(p)))
    states = tuple(State(name, -float(end), float(end), _CRUISE[name]) for name, end in zip(_CRUISE, ends, strict=True))
    dynamics = Dynamics("cruise", "continuous", states, rates, tuple(ranges))
    return dynamics, quadratic(dynamics, p), loads


def _shape(document: Mapping[str, Any]) -> Array:
    lower = document["proof"]["P"][:4]
    return np.array([[lower[max(i, j)][min(i, j)] for j in range(4)] for i in range(4)], dtype=float)


def _cruise(claim: Mapping[str, Any], known: Mapping[str, Node]) -> tuple[tuple[Node, ...], tuple[Node, Node]]:
    """Return the rates of the deviations from the cruise, and each thrust command over its limit.

    Args:
        claim: the claim of the certificate.
        known: the states, the cosine `c` and sine `s` of the heading, and the factors of `mass`, and of the drag of
            surge and sway: `linear_0`, `linear_1`, `quadratic_0`, `quadratic_1`.
    """
    law, names = claim["law"], dict(known)
    v, ahead = law["cruise"], law["lookahead"]

    def define(**texts: str) -> None:
        for name, text in texts.items():
            names[name] = parse(text, names)

    define(
        pace=f"min(max({v} - {law['k1']}*x_e, 0), {law['cap']}/sqrt(1 + (y_e/{ahead})^2))",
        aside=f"-pace*y_e/{ahead}", speed=f"along + {v}",
        want_0="c*pace + s*aside", want_1="c*aside - s*pace", body_0="c*speed + s*across", body_1="c*across - s*speed",
    )  # fmt: skip
    numbers = zip(law["mass_kg"], law["linear_drag"], law["quadratic_drag"], claim["vehicle"]["thrust_n"], strict=True)
    for k, (m, a, b, limit) in enumerate(numbers):
        feedback = f"{m * law['k_v']}*(want_{k} - body_{k})"
        define(**{
            f"command_{k}": f"{a}*want_{k} + {b}*want_{k}*abs(want_{k}) + {feedback}",
            f"drag_{k}": f"{a}*linear_{k}*body_{k} + {b}*quadratic_{k}*body_{k}*abs(body_{k})",
            f"rate_{k}": f"(min(max(command_{k}, -{limit}), {limit}) - drag_{k})/({m}*mass)",
            f"load_{k}": f"abs(command_{k})/{limit}",
        })  # fmt: skip
    rates = ("along", "across", "c*rate_0 - s*rate_1", "s*rate_0 + c*rate_1")
    return tuple(parse(text, names) for text in rates), (names["load_0"], names["load_1"])


class LevelRatios(NamedTuple):
    """Certified level divided by the least level where V̇ > −a V was found, and by the level of thrust saturation."""

    falsifier: float
    thrust: float

    @property
    def sentence(self) -> str:
        """Return a sentence that states both ratios."""
        return (
            f"certified level: {self.falsifier:.0%} of the smallest level with a counterexample, {self.thrust:.0%} of "
            "the level at which thrust saturates" + (", so no thrust limit acts in it" if self.thrust < 1 else "")
        )


def level_ratios(document: Mapping[str, Any]) -> LevelRatios:
    """Return the ratios of the region V ≤ 1 of a certificate without lag, held commands and disturbances.

    The search can miss counterexamples, so the true ratio of the certified level to the smallest level with a
    counterexample may be larger.
    """
    d, function, loads = uncertain_cruise(document)
    rise = d.change(function) + exact(document["claim"]["motion"]["rate_per_s"]) * function
    saturated = min(least_where(d, function, load - number(1)) for load in loads)
    # inside the certified region, level 1, there is no counterexample
    return LevelRatios(1 / least_where(d, function, rise, floor=1.0), 1 / saturated)
