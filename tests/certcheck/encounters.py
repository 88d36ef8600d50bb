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
    linear, quadratic = weighted(vehicle, "linear_drag"), weighted(vehicle, "quadratic_drag")
    share = ahead if vehicle["drag"] == "along" else ahead * sqrt(0.5)
    forward = linear[0] * through + share * quadratic[0] * through**2
    return np.where(through >= 0, forward, linear[1] * through - quadratic[1] * through**2)


def weighted(vehicle: Document, key: str) -> tuple[float, float]:
    """The drag coefficients of an equal mass: masses that differ weight the axes."""
    ratio = vehicle["mass_ratio"] if vehicle["drag"] == "axes" else 1.0
    return vehicle[key][0] / ratio, vehicle[key][1] * ratio


def push(document: Document) -> float:
    """Most thrust towards the obstacle [N], by a search over what the loop may be asked for in any direction."""
    claim, law = document["claim"], document["claim"]["law"]
    if law is None:
        return float(claim["vehicle"]["most_n"])
    met, cap = claim["encounter"], law["cap_m_per_s"]
    beside, at = np.hypot(cap, met["sideways_m_per_s"]), np.linspace(0, 1, 101)
    speed = (1 - at) * cap + at * beside  # from what is wanted to what brakes alone
    error = (1 - at) * (cap + met["fastest_m_per_s"] + claim["watch"]["speed_error_m_per_s"])
    force = max(law["mass_kg"]) * law["k_v_per_s"] * error
    force = force + max(law["linear_drag"]) * speed + max(law["quadratic_drag"]) * speed**2
    return float(min(claim["vehicle"]["most_n"], force.max()))


def pushed(document: Document, through: float) -> float:
    """All that pushes beside the drag of the speed along the direction [N]."""
    vehicle, met = document["claim"]["vehicle"], document["claim"]["encounter"]
    w, ratio = met["sideways_m_per_s"], vehicle["mass_ratio"]
    (low, high), (low2, high2) = weighted(vehicle, "linear_drag"), weighted(vehicle, "quadratic_drag")
    if vehicle["drag"] == "along":
        side = high2 * through * (sqrt(through**2 + w**2) - through)  # exactly; what is stated is never less
    else:
        side = (high - low) * w / 2 + sqrt(2) * high2 * through * w + (2 * high2 - low2) * w**2 / sqrt(27)
    turned = met["turn_rad_per_s"] * vehicle["lag_s"]
    lost = ratio * turned**2 * max(push(document), vehicle["brake_n"])
    if ratio > 1:
        coupled, most = (ratio - 1) / (2 * sqrt(ratio)), max(through, met["fastest_m_per_s"])
        lost += (coupled + ratio * turned) * vehicle["side_n"]
        fast = most * (ratio + 1) / (2 * sqrt(ratio)) + w
        lost += met["turn_rad_per_s"] * vehicle["mass_kg"][1] * (ratio - 1) * fast
    return float(met["disturbance_n"] + side + lost)


def swing(document: Document) -> float:
    """q [N s]."""
    v, met = document["claim"]["vehicle"], document["claim"]["encounter"]
    return float(v["lag_s"] * (push(document) + v["brake_n"]) + met["turn_rad_per_s"] * v["lag_s"] ** 2 * v["side_n"])


def way(document: Document, closing: float, obstacle: float, *, more: float = 0.0) -> float:
    """Least way [m] that the proof's argument allows, by fine sums; inf where nothing is left."""
    met, ratio = document["claim"]["encounter"], document["claim"]["vehicle"]["mass_ratio"]
    through, largest, found = obstacle + met["current_m_per_s"], met["fastest_m_per_s"] + obstacle, []
    for mass in document["claim"]["vehicle"]["mass_kg"]:
        top = max(closing + (swing(document) + more) / mass, 0.0)
        z = np.linspace(0.0, top, _FINE)
        z_or = np.minimum(z, largest)  # no closing speed is larger
        left = document["claim"]["vehicle"]["brake_n"] - pushed(document, through) + drag(document, z_or - through)
        if left.min() <= 0:
            return np.inf
        found.append(mass * float(np.trapezoid(ratio * np.maximum.accumulate(z_or / left), z)))
    return max(found)


def gained(document: Document, speed: float, obstacle: float, thrust: float) -> float:
    """Acceleration towards the obstacle [m/s²] under a thrust."""
    claim, current = document["claim"], document["claim"]["encounter"]["current_m_per_s"]
    e, fastest = claim["watch"]["speed_error_m_per_s"], claim["encounter"]["fastest_m_per_s"]
    astern = max(obstacle + current, current + min(e - speed, fastest))
    worst = -float(drag(document, np.array([-astern]))[0])
    return float((thrust + pushed(document, astern) + worst) / claim["vehicle"]["mass_kg"][0])


def needed(document: Document, speed: float, obstacle: float, *, since: float, loop: float | None = None) -> float:
    """Range needed [m] at a measured own speed, for any thrust or for the one that the loop commands."""
    claim = document["claim"]
    watch, vehicle, met = claim["watch"], claim["vehicle"], claim["encounter"]
    e, period, ratio = watch["speed_error_m_per_s"], watch["period_s"], vehicle["mass_ratio"]
    closing, gain = speed + e + obstacle, gained(document, speed, obstacle, push(document))
    before = watch["range_error_m"] + max(since + e + obstacle, 0.0) * watch["age_s"]
    before += max(closing * period + gain * period**2 / 2, 0.0)
    if loop is None:
        return before + way(document, min(closing + gain * period, met["fastest_m_per_s"] + obstacle), obstacle)
    aside = ratio * met["turn_rad_per_s"] * vehicle["lag_s"] * vehicle["side_n"]
    angle = met["turn_rad_per_s"] * np.linspace(0, period, 101)  # a command held in axes of the hull turns with it
    turned = np.sin(angle) * vehicle["most_n"] + (1 - np.cos(angle)) * vehicle["brake_n"]
    aside += float(np.trapezoid(turned, dx=1 / 100))
    rise = max(gained(document, speed, obstacle, max(loop, -vehicle["brake_n"]) + aside), 0.0)
    return before + way(document, closing, obstacle, more=rise * period * vehicle["mass_kg"][0])


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


def commanded(document: Document, bound: float, over: float) -> float:
    """Most force along n [N] that the loop commands at a speed over its bound."""
    law, w = document["claim"]["law"], document["claim"]["encounter"]["sideways_m_per_s"]
    wanted = bound - law["gain"] * over
    (low, high), (low2, high2) = sorted(law["linear_drag"]), sorted(law["quadratic_drag"])
    v, a = max(wanted, 0.0), max(-wanted, 0.0)
    aside = (high - low) * w / 2 + (2 * high2 - low2) * w**2 / sqrt(27)
    fed = high * v + high2 * (v**2 + sqrt(2) * v * w) + aside - low * a - low2 * a**2 / sqrt(2)
    if low == high and low2 == high2 and not a:
        fed = min(fed, high * v + high2 * (v**2 + 0.385 * v * w + 0.7071 * w**2))
    fed += (max(law["mass_kg"]) - min(law["mass_kg"])) * law["k_v_per_s"] * w
    return float(fed - min(law["mass_kg"]) * law["k_v_per_s"] * (1 + law["gain"]) * over)


def excess(document: Document, bound: float) -> float:
    """Speed over the bound [m/s] at which the loop asks for the braking force."""
    low, high = 0.0, 10.0
    for _ in range(50):
        middle = (low + high) / 2
        enough = commanded(document, bound, middle) <= -document["claim"]["vehicle"]["brake_n"]
        low, high = (low, middle) if enough else (middle, high)
    return high


def lacking(document: Document, obstacle: float, *, bounds: int = 60) -> float:
    """Most [m] by which the range needed exceeds what the law keeps, wherever it does not brake."""
    claim, law = document["claim"], document["claim"]["law"]
    fastest, period, margin = claim["encounter"]["fastest_m_per_s"], claim["watch"]["period_s"], law["margin_m"]
    sure = claim["watch"]["range_error_m"] + claim["watch"]["age_s"] * (fastest + obstacle)
    worst = -np.inf
    for bound in np.linspace(-obstacle - 0.3, fastest, bounds):
        at, over = float(bound), excess(document, float(bound))
        if at + over < -fastest:
            continue
        held = max(margin + kept(law, at, obstacle, period), sure)
        least = needed(document, min(at + over, fastest), obstacle, since=fastest)
        if least > held:
            quick = [
                needed(document, speed, obstacle, since=fastest, loop=commanded(document, at, speed - at))
                for speed in np.clip(at + over * np.linspace(0, 1, 9), -fastest, fastest).tolist()
            ]
            least = min(least, max(quick))
        worst = max(worst, least - held)
    return worst
