"""Errata of the experiments: clearance in the pool (E15) and the hull at the surface (E16)."""

from __future__ import annotations

import re

from surctl.reproduction.row import Result, agrees, differs, wrong_in_print
from surctl.simulation import findings, load_scenario
from surctl.vehicle import load_vehicle

__all__ = ["e15", "e16"]

PRINTED_HULL = "sur540-flooded"  # the paper's hull of 540 mm


def erratum_findings(scenario: str, erratum: str) -> list[str]:
    """Return the texts of `findings` on one erratum for a scenario with the printed hull, without the erratum's id."""
    results = findings(load_scenario(scenario), load_vehicle(PRINTED_HULL))
    return [f.text.replace(f" ({erratum})", "") for f in results if f"({erratum})" in f.text]


def e15() -> Result:
    """Return the result for erratum E15: walls and obstacles too close to the hull of 0.27 m radius in the pool."""
    texts = erratum_findings("pool-static", "E15")
    inside = [float(m) for text in texts for m in re.findall(r"([\d.]+) m inside a wall", text)]
    near = [float(m) for text in texts for m in re.findall(r"is ([\d.]+) m off obstacle", text)]
    ours = "; ".join(texts) or "no finding"
    if not inside or not near:
        return agrees(ours)
    return wrong_in_print(
        f"the hull is {max(inside):.3f} m inside a wall and {min(near):.3f} m from an obstacle; {len(texts)} findings",
        ours,
        inside_wall_m=max(inside),
        off_obstacle_m=min(near),
    )


def e16() -> Result:
    """Return the result for erratum E16: the height of the hull above the water at the printed depth."""
    scenario, vehicle = load_scenario("tank-static"), load_vehicle(PRINTED_HULL)
    above, texts = scenario.depth + vehicle["radius"], erratum_findings("tank-static", "E16")
    ours = f"the top of the hull is {above:.2f} m above the water"
    if above <= 0 or not texts:
        return agrees(ours, above_m=above)
    return differs(ours, texts[0], above_m=above)
