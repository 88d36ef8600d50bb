"""Frama-C's Eva on whole laws with known obstacle positions, in every priority mode."""

from __future__ import annotations

from dataclasses import replace

from surctl.export.prove import gain_box, prove_bundle
from surctl.ir import Real
from surctl.marine.control import build_law, load_gains
from surctl.marine.export import build_bundle, closed_form, operating_envelope
from surctl.marine.simulation import law_numbers, load_scenario
from surctl.marine.vehicle import load_vehicle

__all__ = ["whole_laws"]

_SCENARIO = "pool-ahead"
_LAWS: tuple[tuple[str, Real, bool], ...] = (
    ("projected", "float32", True),
    ("projected, bounded", "float32", True),
    ("nsb", "float32", True),
    ("nsb", "float32", False),
    ("nsb", "float64", True),
    ("filter", "float32", True),
    ("lexicographic", "float32", True),
)


def whole_laws(*, quick: bool) -> tuple[list[str], bool]:
    """Return lines of the README, and whether no alarm remains."""
    lines = ["| law guarded, mode | numbers | gains | alarms | properties | s |", "|---|---|---|---|---|---|"]
    proved = True
    mission, tuned = load_scenario(_SCENARIO), load_gains("default")
    vehicle = load_vehicle(mission.vehicle)
    for name, real, constant in _LAWS[:1] if quick else _LAWS:
        mode, ladder = name.split(",")[0], "bounded" if "bounded" in name else "exact"
        law = build_law("guarded", mode=mode, fallback=ladder, **({"contacts": 1, "moving": False} if quick else {}))  # type: ignore[arg-type]
        numbers = law_numbers(mission, tuned, vehicle)
        shipped = closed_form(law, real=real, constants=numbers if constant else None)
        within = operating_envelope(law, mission, vehicle, shipped.gains)
        if not constant:
            within = replace(within, gains=gain_box(law, numbers, tuned.ranges))
        bundle = build_bundle(shipped, {} if constant else law.gains.unpack(numbers), real=real, envelope=within)
        report = prove_bundle(shipped, bundle, vehicle.thrust_limit)
        proved = proved and report.proved
        gains = "constants" if constant else "any in their ranges"
        row = (name, real, gains, len(report.alarms), report.properties, f"{report.seconds:.0f}")
        lines.append(f"| {' | '.join(map(str, row))} |")
    return [*lines, "", f"Proved: {report.claim}."], proved
