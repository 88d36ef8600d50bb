"""A braking certificate's claim once more, in floating point and by brute force: what an alteration must not break."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Document = Mapping[str, Any]

_FINE = 4000


def drag(document: Document, through: Vector, *, ahead: float = 1.0) -> Vector:
    """The drag that helps least at a speed through the water [N]."""
    vehicle = document["claim"]["vehicle"]
    linear, quadratic = vehicle["linear_drag"], vehicle["quadratic_drag"]
    share = ahead if vehicle["drag"] == "along" else ahead * sqrt(0.5)
    forward = linear[0] * through + share * quadratic[0] * through**2
    return np.where(through >= 0, forward, linear[1] * through - quadratic[1] * through**2)


def pushed(document: Document, through: float) -> float:
    """All that pushes beside the drag of the speed along the direction [N]."""
    vehicle, met = document["claim"]["vehicle"], document["claim"]["encounter"]
    w, (low, high), (low2, high2) = met["sideways_m_per_s"], vehicle["linear_drag"], vehicle["quadratic_drag"]
    if vehicle["drag"] == "along":
        side = high2 * through * (sqrt(through**2 + w**2) - through)  # exactly; what is stated is never less
    else:
        side = (high - low) * w / 2 + sqrt(2) * high2 * through * w + (2 * high2 - low2) * w**2 / sqrt(27)
    turned = met["turn_rad_per_s"] * vehicle["lag_s"]
    return float(met["disturbance_n"] + side + turned**2 * max(vehicle["most_n"], vehicle["brake_n"]))


def swing(document: Document) -> float:
    """q [N s]."""
    v, met = document["claim"]["vehicle"], document["claim"]["encounter"]
    return float(v["lag_s"] * (v["most_n"] + v["brake_n"]) + met["turn_rad_per_s"] * v["lag_s"] ** 2 * v["side_n"])


def way(document: Document, closing: float, obstacle: float) -> float:
    """Least way [m] that the proof's argument allows, by fine sums; inf where nothing is left."""
    through = obstacle + document["claim"]["encounter"]["current_m_per_s"]
    found = []
    for mass in document["claim"]["vehicle"]["mass_kg"]:
        top = max(closing + swing(document) / mass, 0.0)
        z = np.linspace(0.0, top, _FINE)
        left = document["claim"]["vehicle"]["brake_n"] - pushed(document, through) + drag(document, z - through)
        if left.min() <= 0:
            return np.inf
        found.append(mass * float(np.trapezoid(np.maximum.accumulate(z / left), z)))
    return max(found)


def needed(document: Document, speed: float, obstacle: float, *, since: float) -> float:
    """Range needed [m] at a measured own speed."""
    claim = document["claim"]
    vehicle, watch, current = claim["vehicle"], claim["watch"], claim["encounter"]["current_m_per_s"]
    e, period = watch["speed_error_m_per_s"], watch["period_s"]
    closing, astern = speed + e + obstacle, max(obstacle + current, current + e - speed)
    worst = vehicle["linear_drag"][1] * astern + vehicle["quadratic_drag"][1] * astern**2
    gain = (vehicle["most_n"] + pushed(document, astern) + worst) / vehicle["mass_kg"][0]
    late = max(since + e + obstacle, 0.0) * watch["age_s"]
    travelled = max(closing * period + gain * period**2 / 2, 0.0)
    return watch["range_error_m"] + late + travelled + way(document, closing + gain * period, obstacle)


def kept(law: Document, bound: float, obstacle: float, period: float) -> float:
    """Distance [m] at which the law's bound is that speed, by bisection of the bound itself."""
    limit = allowed(law, obstacle, period)
    low, high = -5.0, 20.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if limit(middle) < bound else (low, middle)
    return high


def allowed(law: Document, obstacle: float, period: float) -> Callable[[float], float]:
    """The law's bound [m/s] of a distance [m] beyond its margin."""
    force = law["brake"] * law["limit_n"]
    if law["barrier"] == "simple":
        a, t = force / max(law["mass_kg"]), law["reaction_s"]

        def simple(distance: float) -> float:
            h = distance - t * obstacle
            return (h / t if h < 0 else -a * t + sqrt((a * t) ** 2 + 2 * a * h)) - obstacle

        return simple
    stop = law["stopping"]
    dragged = stop["linear_drag"] * obstacle + stop["quadratic_drag"] * obstacle**2
    gain = (stop["most_n"] + dragged) / stop["lightest_kg"]

    def inertia(distance: float) -> float:
        found = []
        for m in (stop["lightest_kg"], stop["heaviest_kg"]):
            k, lost = m / (2 * (force - dragged)), stop["lag_s"] * (stop["most_n"] + force) / m
            room, slope = distance + gain * period**2 / 2 - k * lost**2, period + 2 * k * lost
            found.append(2 * room / (slope + sqrt(slope**2 + 4 * k * max(room, 0.0))))
        return min(found) - obstacle - gain * period

    return inertia


def excess(document: Document, bound: float) -> float:
    """Speed over the bound [m/s] at which the loop asks for the braking force."""
    law, w, v = document["claim"]["law"], document["claim"]["encounter"]["sideways_m_per_s"], max(bound, 0.0)
    forward = max(law["linear_drag"]) * v + max(law["quadratic_drag"]) * (v**2 + 0.385 * v * w + 0.7071 * w**2)
    loop = min(law["mass_kg"]) * law["k_v_per_s"] * (1 + law["gain"])
    return float((document["claim"]["vehicle"]["brake_n"] + forward) / loop)


def lacking(document: Document, obstacle: float) -> float:
    """Most [m] by which the range needed exceeds what the law keeps, wherever it does not brake."""
    claim, law = document["claim"], document["claim"]["law"]
    fastest, period, margin = claim["encounter"]["fastest_m_per_s"], claim["watch"]["period_s"], law["margin_m"]
    sure = claim["watch"]["range_error_m"] + claim["watch"]["age_s"] * (fastest + obstacle)
    worst = -np.inf
    for bound in np.linspace(-obstacle - 0.3, fastest, 60):
        held = max(margin + kept(law, float(bound), obstacle, period), sure)
        speed = min(float(bound) + excess(document, float(bound)), fastest)
        worst = max(worst, needed(document, speed, obstacle, since=fastest) - held)
    return worst
