"""Errata of the experiments: clearance in the pool (E15) and the hull at the surface (E16)."""

from __future__ import annotations

from dataclasses import replace

from surctl.marine.reproduction.row import Result, agrees, differs, wrong_in_print
from surctl.marine.simulation import Finding, findings, load_scenario
from surctl.marine.vehicle import load_vehicle

__all__ = ["e15", "e16"]

PRINTED_HULL = "sur540-flooded"  # the paper's hull of 540 mm


def erratum_findings(scenario: str, erratum: str) -> list[Finding]:
    """Return the `findings` that concern one erratum in a scenario with the printed hull, without the erratum's id."""
    results = findings(load_scenario(scenario), load_vehicle(PRINTED_HULL))
    return [replace(f, text=f.text.replace(f" ({erratum})", "")) for f in results if f"({erratum})" in f.text]


def e15() -> Result:
    """Return the result for erratum E15: walls and obstacles too close to the hull of 0.27 m radius in the pool."""
    reported = erratum_findings("pool-static", "E15")
    distances = [(f.key == "path_m", f.clearance_m) for f in reported if f.clearance_m is not None]
    inside = [-clearance for at_wall, clearance in distances if at_wall and clearance < 0]
    near = [clearance for at_wall, clearance in distances if not at_wall]
    ours = "; ".join(f.text for f in reported) or "no finding"
    if not inside or not near:
        return agrees(ours)
    return wrong_in_print(
        f"the hull is {max(inside):.3f} m inside a wall and {min(near):.3f} m from an obstacle; "
        f"{len(reported)} findings",
        ours,
        inside_wall_m=max(inside),
        off_obstacle_m=min(near),
    )


def e16() -> Result:
    """Return the result for erratum E16: the height of the hull above the water at the printed depth."""
    scenario, vehicle = load_scenario("tank-static"), load_vehicle(PRINTED_HULL)
    above, reported = scenario.depth + vehicle["radius"], erratum_findings("tank-static", "E16")
    ours = f"the top of the hull is {above:.2f} m above the water"
    if above <= 0 or not reported:
        return agrees(ours, above_m=above)
    return differs(ours, reported[0].text, above_m=above)
