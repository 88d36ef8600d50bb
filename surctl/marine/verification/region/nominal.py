"""The nominal loop of a region certificate as dynamics, for pictures of the region."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from surctl.errors import InputError
from surctl.lyapunov import Dynamics, Range, State
from surctl.lyapunov.slope_search import form_of, quadratic
from surctl.verification.formula import Node, parse, variable

_EXTENT = 1.4  # half-width of the box, in half-widths of the region
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
        lower = document["proof"]["P"][:4]
        p = np.array([[lower[max(i, j)][min(i, j)] for j in range(4)] for i in range(4)])
        units, texts = _CRUISE, _cruise(claim["law"], claim["vehicle"]["thrust_n"])
    elif document.get("kind") == "lyapunov":
        units, texts = {row["name"]: row["unit"] for row in claim["states"]}, claim["dynamics"]
        ranges = tuple(Range(**row) for row in claim["parameters"])
        p = form_of(parse(claim["function"], {name: variable(name) for name in units}), list(units)) / claim["level"]
    else:
        raise InputError("is not about a region", key="certificate", value=document.get("kind"),
                         remedy="give a region certificate")  # fmt: skip
    known = {name: variable(name) for name in (*units, *(one.name for one in ranges))}
    ends = _EXTENT * np.sqrt(np.diag(np.linalg.inv(p)))
    states = tuple(State(name, -float(end), float(end), units[name]) for name, end in zip(units, ends, strict=True))
    rates = tuple(parse(texts[name], known) for name in units)
    dynamics = Dynamics("region", "continuous", states, rates, ranges)
    return dynamics, quadratic(dynamics, p)


def _cruise(law: Mapping[str, Any], limits: list[float]) -> dict[str, str]:
    """Return the rates of the deviations from the cruise of a vehicle that is the law's model."""
    v, ahead = law["cruise"], law["lookahead"]
    pace = f"min(max({v} - {law['k1']}*x_e, 0), {law['cap']}/sqrt(1 + (y_e/{ahead})^2))"
    rates = {"x_e": "along", "y_e": "across"}
    pairs = zip(law["mass_kg"], law["linear_drag"], law["quadratic_drag"], limits, strict=True)
    for (m, a, b, limit), (name, speed, desired) in zip(
        pairs, (("along", f"(along + {v})", f"({pace})"), ("across", "across", f"(-({pace})*y_e/{ahead})")), strict=True
    ):
        command = f"{a}*{desired} + {b}*{desired}*abs({desired}) + {m * law['k_v']}*({desired} - {speed})"
        thrust = f"min(max({command}, -{limit}), {limit})"
        rates[name] = f"({thrust} - {a}*{speed} - {b}*{speed}*abs({speed}))/{m}"
    return rates
