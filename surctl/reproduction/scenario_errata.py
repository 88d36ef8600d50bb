"""Errata of the experiments: room in the pool (E15) and the hull at the surface (E16)."""

from __future__ import annotations

import re

from surctl.reproduction.row import Result, agrees, differs, wrong_in_print
from surctl.simulation import findings, load_scenario
from surctl.vehicle import load_vehicle

__all__ = ["e15", "e16"]

PRINTED_HULL = "sur540-flooded"  # the paper's hull of 540 mm


def erratum_findings(scenario: str, erratum: str) -> list[str]:
    """What `findings` says of a scenario flown by the printed hull, of one erratum, without its mark."""
    results = findings(load_scenario(scenario), load_vehicle(PRINTED_HULL))
    return [f.text.replace(f" ({erratum})", "") for f in results if f"({erratum})" in f.text]


def e15() -> Result:
    """What stands in the way of the 0.27 m hull in the pool."""
    texts = erratum_findings("pool-static", "E15")
    inside = [float(m) for text in texts for m in re.findall(r"([\d.]+) m inside a wall", text)]
    near = [float(m) for text in texts for m in re.findall(r"is ([\d.]+) m off obstacle", text)]
    ours = "; ".join(texts) or "nothing found"
    if not inside or not near:
        return agrees(ours)
    return wrong_in_print(
        f"hull {max(inside):.3f} m inside the wall, {min(near):.3f} m off an obstacle; {len(texts)} findings",
        ours,
        inside_wall_m=max(inside),
        off_obstacle_m=min(near),
    )


def e16() -> Result:
    """How far the hull stands out of the water at the printed depth."""
    scenario, vehicle = load_scenario("tank-static"), load_vehicle(PRINTED_HULL)
    above, texts = scenario.depth + vehicle["radius"], erratum_findings("tank-static", "E16")
    ours = f"{above:.2f} m out of the water"
    if above <= 0 or not texts:
        return agrees(ours, above_m=above)
    return differs(ours, texts[0], above_m=above)
